"""Surfaces cut open: their edges, cuts through triangles, and hems."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import vertex_normals

Floats = NDArray[np.float64]

#: Beyond a cut, and below the cloth's surface, mm: the profile of a hem.
_HEM_MM = ((1.0, 0.3), (1.5, 1.2), (1.2, 2.4), (-2.0, 3.0))


@dataclass(frozen=True, eq=False)
class CutSurface:
    """What is left of a surface after a cut.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        The old ones and those along the cut; some may be unused.
    triangles : (F, 3) int32
    values : (V,) float64
        A value that was carried along, at all vertices.
    loops : tuple of (n,) int64
        Closed runs of vertices along the cut, in their triangles' sense.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    values: Floats
    loops: tuple[NDArray[np.int64], ...]


def boundary_loops(triangles: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Closed runs of vertices along the edges that belong to one triangle, in its sense."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    key = np.sort(sides, axis=1).astype(np.int64)
    n = int(triangles.max()) + 1
    code = key[:, 0] * n + key[:, 1]
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    open_sides = sides[first[count == 1]]
    return _runs({int(a): int(b) for a, b in open_sides})


def cut_surface(
    vertices: Floats, triangles: NDArray[np.int32], level: Floats, values: Floats
) -> CutSurface:
    """Keep where a level lies above 0, through triangles.

    Parameters
    ----------
    vertices : (V, 3) float, mm
    triangles : (F, 3) int32
    level : (V,) float
    values : (V,) float
        Carried along.
    """
    ends: dict[tuple[int, int], int] = {}

    def cut(a: int, b: int) -> int:
        return ends.setdefault((min(a, b), max(a, b)), len(vertices) + len(ends))

    inside = (level > 0)[triangles]
    kept, after = [triangles[inside.all(axis=1)]], {}
    crossed = inside.any(axis=1) & ~inside.all(axis=1)
    for corners, is_in in zip(triangles[crossed], inside[crossed], strict=True):
        lone = int(np.argmax(is_in)) if is_in.sum() == 1 else int(np.argmin(is_in))
        a, b, c = (int(corners[(lone + k) % 3]) for k in range(3))
        p, q = cut(a, b), cut(a, c)
        if is_in[lone]:
            kept.append(np.array([[a, p, q]], dtype=np.int32))
            after[p] = q
        else:
            kept.append(np.array([[p, b, c], [p, c, q]], dtype=np.int32))
            after[q] = p
    i, j = np.array(list(ends), dtype=np.int64).reshape(-1, 2).T
    share = level[i] / (level[i] - level[j])
    return CutSurface(
        np.concatenate([vertices, vertices[i] + share[:, None] * (vertices[j] - vertices[i])]),
        np.concatenate(kept),
        np.concatenate([values, values[i] + share * (values[j] - values[i])]),
        tuple(_runs(after)),
    )


def _runs(after: dict[int, int]) -> list[NDArray[np.int64]]:
    """Closed runs of vertices, given which follows which; uses `after` up."""
    found = []
    while after:
        start = next(iter(after))
        here = after.pop(start)
        run = [start]
        while here in after:
            run.append(here)
            here = after.pop(here)
        found.append(np.array(run))
    return found


def hemmed(
    v: Floats, triangles: NDArray[np.int32], loop: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int32]]:
    """Turn the cloth over at a cut: a round edge, and a little of the inside."""
    ring = v[loop]
    for _ in range(6):
        ring = 0.5 * ring + 0.25 * (np.roll(ring, 1, axis=0) + np.roll(ring, -1, axis=0))
    v = v.copy()
    v[loop] = ring
    out = vertex_normals(v, triangles)[loop]
    for _ in range(4):
        out = 0.5 * out + 0.25 * (np.roll(out, 1, axis=0) + np.roll(out, -1, axis=0))
    on = beyond_edge(ring, out)
    rows = [loop]
    for further, deeper in _HEM_MM:
        rows.append(len(v) + np.arange(len(loop)))
        v = np.concatenate([v, ring + further * on - deeper * out])
    faces = [triangles]
    for a, b in pairwise(rows):
        a1, b1 = np.roll(a, -1), np.roll(b, -1)
        faces += [np.stack([a1, a, b], axis=1), np.stack([a1, b, b1], axis=1)]
    return v, np.concatenate(faces).astype(np.int32)


def beyond_edge(ring: Floats, out: Floats) -> Floats:
    """Unit vectors along a surface, beyond its edge: the surface lies to the ring's left."""
    along = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    found = np.cross(along, out)
    return np.asarray(found / (np.linalg.norm(found, axis=1, keepdims=True) + 1e-9))


def without_unused(
    v: Floats, triangles: NDArray[np.int32] | NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int32]]:
    """Leave out vertices that no triangle has."""
    rows, new = np.unique(triangles, return_inverse=True)
    return v[rows], new.reshape(-1, 3).astype(np.int32)
