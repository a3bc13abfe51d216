"""Our people as other makers' heads: another topology, unit, turn and order of vertices.

For judging how heads from files are recognised: where each feature point is, is known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..core.arrays import readonly
from ..heads.head import Head
from ..heads.raycast import import_open3d

#: Vertices of the skin after decimation; the template's has about 17,500.
SKIN_VERTICES = (4_000, 12_000)
#: What a file's numbers may be, mm.
UNITS_MM = (1.0, 10.0, 100.0, 1000.0)
#: Turns of the file's axes against the head's: y up, z up, x up, facing back.
TURNS = {
    "y up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z up": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "x up": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "facing back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
}
_TILT_RAD = 0.08
_SHIFT_HEADS = 3.0
_HEAD_MM = 200.0


@dataclass(frozen=True, eq=False)
class ForeignHead:
    """A head as another maker's file would hold it.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's unit and axes
    triangles : (F, 3) int32
    unit_mm : float
    turn : (3, 3) float64
        The file's axes from the head's.
    shift : (3,) float64, the file's unit
    points : mapping from feature point to (3,) float64, the file's unit and axes
        The truth.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    unit_mm: float
    turn: NDArray[np.float64]
    shift: NDArray[np.float64]
    points: dict[str, NDArray[np.float64]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", readonly(self.vertices, (None, 3), "vertices"))
        triangles = readonly(self.triangles, (None, 3), "triangles", np.int32)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "turn", readonly(self.turn, (3, 3), "turn"))
        object.__setattr__(self, "shift", readonly(self.shift, (3,), "shift"))


def foreign_head(
    head: Head,
    rng: np.random.Generator,
    *,
    skin_vertices: int | None = None,
    unit_mm: float | None = None,
    turn: str | None = None,
    without: tuple[str, ...] = ("lashes",),
) -> ForeignHead:
    """Disguise a head; what is not given is drawn.

    The skin gets another topology (edges collapsed by quadrics, no two heads alike), all vertices
    and triangles another order; then the head is tilted by some degrees, turned, shifted and
    written in another unit.

    Parameters
    ----------
    head : Head
    rng : numpy Generator
    skin_vertices : int, optional
    unit_mm : float, optional
        One of `UNITS_MM`.
    turn : str, optional
        One of `TURNS`.
    without : tuple of str
        Parts that are left out.
    """
    wanted = skin_vertices or int(rng.integers(*SKIN_VERTICES))
    vertices, triangles, n = [], [], 0
    for part, rows in head.mesh.groups.items():
        if part in without:
            continue
        used, local = np.unique(head.mesh.triangles[rows], return_inverse=True)
        v, t = head.mesh.vertices[used], local.reshape(-1, 3).astype(np.int32)
        if part == "skin":
            v, t = _collapsed(v, t, wanted)
        vertices.append(v)
        triangles.append(t + n)
        n += len(v)
    v, t = np.concatenate(vertices), np.concatenate(triangles)
    order = rng.permutation(len(v))
    place = np.argsort(order)
    t = np.stack([np.roll(row, k) for row, k in zip(t, rng.integers(0, 3, len(t)), strict=True)])
    t = place[t[rng.permutation(len(t))]].astype(np.int32)
    unit = float(rng.choice(UNITS_MM)) if unit_mm is None else unit_mm
    word = str(rng.choice(list(TURNS))) if turn is None else turn
    tilt = Rotation.from_rotvec(rng.normal(0, _TILT_RAD, 3)).as_matrix()
    whole = np.array(TURNS[word], dtype=np.float64) @ tilt
    shift = rng.normal(0, _SHIFT_HEADS * _HEAD_MM / unit, 3)
    return ForeignHead(
        v[order] @ whole.T / unit + shift,
        t,
        unit,
        whole,
        shift,
        {name: whole @ p / unit + shift for name, p in head.points.items()},
    )


def _collapsed(
    v: NDArray[np.float64], t: NDArray[np.int32], n_vertices: int
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    o3d = import_open3d()
    full = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(v), o3d.utility.Vector3iVector(t))
    light = full.simplify_quadric_decimation(2 * n_vertices, boundary_weight=4.0)
    light.remove_unreferenced_vertices()
    return np.asarray(light.vertices), np.asarray(light.triangles).astype(np.int32)
