"""Meshes of other makers: what a file holds, stitched along the seams of its texture.

Nothing of a head is known here yet. What was done to the mesh is said in `notes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..core.arrays import readonly
from ..core.errors import InputError
from .head_facts import HeadFacts

Floats = NDArray[np.float64]

_SAME_PLACE = 1e-6  # of the mesh's size
_STEPS = 1 << 20  # more than 1 / _SAME_PLACE
_SAME_SHAPE = 1e-4
_GREY = (204, 204, 204)


@dataclass(frozen=True, eq=False)
class Look:
    """What a label's triangles look like.

    Attributes
    ----------
    colour : sRGB triple 0 to 255
        Multiplies the picture.
    picture : (h, w, 3) uint8, sRGB, or None
    """

    colour: tuple[int, int, int] = _GREY
    picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """A mesh from a file.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's axes and unit (of a .glb: millimetres)
    triangles : (F, 3) int32
    uv : (U, 2) float64 or None; uv_triangles : (F, 3) int32 or None
        As of `Mesh`.
    labels : tuple of str
        What the file calls its parts; `label_of_triangle` (F,) int32 are their numbers.
    looks : mapping from label to Look
    shape_names : tuple of str, length N
    shapes : (N, V, 3) float32
        Offsets, as `vertices`.
    notes : tuple of str
        What was found and done, for the user.
    facts : HeadFacts or None
        What a file that we wrote ourselves says of its head.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    labels: tuple[str, ...]
    label_of_triangle: NDArray[np.int32]
    uv: Floats | None = None
    uv_triangles: NDArray[np.int32] | None = None
    looks: Mapping[str, Look] = field(default_factory=dict)
    shape_names: tuple[str, ...] = ()
    shapes: NDArray[np.float32] | None = None
    notes: tuple[str, ...] = ()
    facts: HeadFacts | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "vertices", readonly(self.vertices, (None, 3), "vertices"))
        put(self, "triangles", readonly(self.triangles, (None, 3), "triangles", np.int32))
        labels = readonly(
            self.label_of_triangle, (len(self.triangles),), "label_of_triangle", np.int32
        )
        put(self, "label_of_triangle", labels)


def stitched(mesh: OwnMesh) -> OwnMesh:
    """The mesh with vertices joined that texture seams or parts of the file keep apart.

    Only borders are joined, side to side and with opposite directions, and only where all shapes
    move both sides alike: lips that touch stay apart. Vertices without a triangle are left out.

    Raises
    ------
    InputError
        If it has no triangle with an area.
    """
    notes = list(mesh.notes)
    row = _joined_rows(mesh)
    triangles = row[mesh.triangles]
    whole = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    if not whole.any():
        raise InputError("the mesh has no triangle with an area")
    if not whole.all():
        notes.append(f"{int((~whole).sum())} triangles without an area are left out")
    used, compact = np.unique(triangles[whole], return_inverse=True)
    first = np.full(int(row.max()) + 1, len(row))
    np.minimum.at(first, row, np.arange(len(row)))
    chosen = first[used]
    n_joined = len(np.unique(mesh.triangles)) - len(used)
    if n_joined:
        notes.append(f"{n_joined} doubled vertices along seams are joined")
    n_bad = _n_bad_edges(compact.reshape(-1, 3))
    if n_bad:
        notes.append(f"{n_bad} edges have more than two triangles (a non-manifold mesh)")
    return replace(
        mesh,
        vertices=mesh.vertices[chosen],
        triangles=compact.reshape(-1, 3).astype(np.int32),
        label_of_triangle=mesh.label_of_triangle[whole],
        uv_triangles=None if mesh.uv_triangles is None else mesh.uv_triangles[whole],
        shapes=None if mesh.shapes is None else mesh.shapes[:, chosen],
        notes=tuple(notes),
    )


def _joined_rows(mesh: OwnMesh) -> NDArray[np.int64]:
    """A number for each vertex; those that are joined have the same."""
    v, t = mesh.vertices, mesh.triangles
    used = v[np.unique(t)]
    size = float(np.ptp(used, axis=0).max())
    if not size > 0:
        raise InputError("the mesh has no extent")
    steps = np.rint((v - used.min(axis=0)) / (_SAME_PLACE * size)).astype(np.int64)
    steps[(steps < 0).any(axis=1) | (steps >= _STEPS).any(axis=1)] = 0  # without a triangle
    _, place = np.unique((steps[:, 0] * _STEPS + steps[:, 1]) * _STEPS + steps[:, 2],
                         return_inverse=True)  # fmt: skip
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    n = len(v)
    _, inverse, counts = np.unique(side_keys(sides, n), return_inverse=True, return_counts=True)
    border = sides[counts[inverse] == 1]
    a, b = _met_sides(place, border)
    links = np.concatenate([np.stack([a[:, 0], b[:, 1]], 1), np.stack([a[:, 1], b[:, 0]], 1)])
    links = links[_moved_alike(mesh.shapes, links, size)]
    graph = sparse.coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), (n, n))
    _, row = connected_components(graph, directed=False)
    return np.asarray(row, dtype=np.int64)


def _met_sides(
    place: NDArray[np.int64], border: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Pairs of border sides, (n, 2) vertices each, that run opposite ways between the same places.

    Where more than two sides meet it is not known which belong together: none is joined.
    """
    nothing = np.zeros((0, 2), np.int32)
    p = place[border]
    proper = p[:, 0] != p[:, 1]
    border, p = border[proper], p[proper]
    if not len(border):
        return nothing, nothing
    keys = side_keys(p, int(p.max()) + 1)
    _, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    in_two = order[counts[which[order]] == 2]
    first, second = in_two[0::2], in_two[1::2]
    opposite = p[first, 0] == p[second, 1]
    return border[first[opposite]], border[second[opposite]]


def _moved_alike(
    shapes: NDArray[np.float32] | None, links: NDArray[np.int32], size: float
) -> NDArray[np.bool_]:
    alike = np.ones(len(links), dtype=bool)
    for shape in () if shapes is None else shapes:
        off = np.abs(shape[links[:, 0]] - shape[links[:, 1]]).max(axis=1, initial=0.0)
        alike &= off < _SAME_SHAPE * size
    return alike


def _n_bad_edges(triangles: NDArray[np.int64]) -> int:
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, counts = np.unique(side_keys(sides, int(triangles.max()) + 1), return_counts=True)
    return int((counts > 2).sum())


def with_own_vertices(
    mesh: OwnMesh, groups: Mapping[str, NDArray[np.int32]]
) -> tuple[OwnMesh, int]:
    """The mesh with vertices that parts share doubled, so that each can move alone; how many."""
    triangles, n = np.array(mesh.triangles), len(mesh.vertices)
    taken = np.zeros(n, dtype=bool)
    copies: list[NDArray[np.int32]] = []
    for rows in groups.values():
        used = np.unique(mesh.triangles[rows])
        shared = used[taken[used]]
        taken[used] = True
        if len(shared):
            row = np.arange(n)
            row[shared] = n + sum(map(len, copies)) + np.arange(len(shared))
            triangles[rows] = row[mesh.triangles[rows]]
            copies.append(shared)
    if not copies:
        return mesh, 0
    source = np.concatenate([np.arange(n), *copies])
    doubled = replace(
        mesh,
        vertices=mesh.vertices[source],
        triangles=triangles,
        shapes=None if mesh.shapes is None else mesh.shapes[:, source],
    )
    return doubled, len(source) - n


def side_keys(sides: NDArray[Any], n_vertices: int) -> NDArray[np.int64]:
    """A number for each side (n, 2), the same in both directions."""
    low, high = sides.min(axis=1).astype(np.int64), sides.max(axis=1).astype(np.int64)
    return np.asarray(low * n_vertices + high)


def shells(triangles: NDArray[np.int32], n_vertices: int) -> list[NDArray[np.int32]]:
    """Triangle indices of each connected shell, the one with most triangles first."""
    a, b = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    graph = sparse.coo_matrix((np.ones(len(a)), (a, b)), (n_vertices, n_vertices))
    _, label = connected_components(graph, directed=False)
    of_triangle = label[triangles[:, 0]]
    order = np.argsort(of_triangle, kind="stable")
    _, starts = np.unique(of_triangle[order], return_index=True)
    found: Sequence[NDArray[np.int64]] = np.split(order, starts[1:])
    return sorted((rows.astype(np.int32) for rows in found), key=lambda rows: -len(rows))
