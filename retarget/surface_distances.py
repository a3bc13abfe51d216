"""Shortest ways along a surface from points on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import SurfacePoints

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Vertices this near to a point are the point.
TOUCHING_MM = 1e-6
#: A length of exactly 0 would be no edge to a sparse matrix.
_LEAST_MM = 1e-9


@dataclass(frozen=True, eq=False)
class SurfaceDistances:
    """The ways along a surface between points on it and its vertices.

    A point in the middle of a triangle is joined to the triangle's three corners by straight
    lines, and to other points in the same triangle; everywhere else the way goes along edges.
    Ways are looked for when asked for: on large meshes ask for `nearest` and `around`, which go
    no further than they must, not for all.

    Attributes
    ----------
    ways : (V + N, V + N) sparse float64, mm
        Lengths of edges, both ways; points behind the vertices.
    n_vertices : int
    edges : (E, 2) int32
    """

    ways: sparse.csr_matrix
    n_vertices: int
    edges: NDArray[np.int32]

    @property
    def n_points(self) -> int:
        """How many points there are."""
        return int(self.ways.shape[0]) - self.n_vertices

    @property
    def to_vertices(self) -> Floats:
        """(N, V) float64, mm: from every point to every vertex; inf to vertices on other parts."""
        return self._all[:, : self.n_vertices]

    @property
    def between(self) -> Floats:
        """(N, N) float64, mm: from every point to every other."""
        return self._all[:, self.n_vertices :]

    @cached_property
    def _all(self) -> Floats:
        nobody = np.zeros(0, np.int64)
        found = np.empty((self.n_points, self.ways.shape[0]))
        for i in range(self.n_points):
            found[i] = self._grown(np.array([i]), nobody)[0]
        return found

    def nearest(self, rows: Ints | None = None) -> tuple[Floats, Ints]:
        """For each vertex the distance of the nearest of some points, and which it is.

        Parameters
        ----------
        rows : (n,) int or None
            Which of the points; None: all.

        Returns
        -------
        mm : (V,) float64
            inf where there is none on the part.
        which : (V,) int
            Numbers within `rows`; the first where several are as near; -1 where there is none.
        """
        rows = np.arange(self.n_points) if rows is None else rows
        mm, which, _ = self._grown(rows, np.zeros(0, np.int64))
        return mm[: self.n_vertices], which[: self.n_vertices].astype(np.int64)

    def around(self, row: int, others: Ints) -> tuple[Ints, Floats, Floats]:
        """The vertices that are no further from a point than the furthest of some other points.

        Parameters
        ----------
        row : int
        others : (n,) int
            Points. Without any, only vertices at the point itself are found.

        Returns
        -------
        vertices : (m,) int
        mm : (m,) float64
            Their distances from the point.
        between : (n,) float64, mm
            The other points' distances from it.
        """
        wanted = np.append(others, row)
        mm, _, order = self._grown(np.array([row]), wanted)
        vertices = order[order < self.n_vertices].astype(np.int64)
        return vertices, mm[vertices], mm[self.n_vertices + others]

    def _grown(
        self, rows: Ints, wanted: Ints
    ) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32]]:
        """Distances from the nearest of points, which it is, and vertices and points in order."""
        n = self.ways.shape[0]
        mm, which = np.full(n, np.inf), np.full(n, -1, np.int32)
        order = np.empty(n, np.int32)
        is_wanted = np.zeros(n, np.bool_)
        is_wanted[self.n_vertices + wanted] = True
        ways, sources = self.ways, (self.n_vertices + rows).astype(np.int32)
        settled = _grow(
            ways.indptr, ways.indices, ways.data, sources, is_wanted, mm, which, order
        )  # fmt: skip
        return mm, which, order[:settled]


def surface_distances(
    vertices: Floats, triangles: NDArray[np.int32], points: SurfacePoints
) -> SurfaceDistances:
    """Shortest ways along mesh edges from the points to all vertices.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32
    points : SurfacePoints
    """
    edges = mesh_edges(triangles)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    n_vertices, n_points = len(vertices), len(points)
    at = points.at(vertices)
    starts = np.repeat(np.arange(n_points), 3)
    corners = points.corners.ravel()
    to_corner = np.linalg.norm(at[starts] - vertices[corners], axis=1)
    a, b = _points_sharing_triangles(points)
    across = np.linalg.norm(at[a] - at[b], axis=1)
    rows = np.concatenate([edges[:, 0], n_vertices + starts, n_vertices + a])
    columns = np.concatenate([edges[:, 1], corners, n_vertices + b])
    lengths = np.maximum(np.concatenate([length, to_corner, across]), _LEAST_MM)
    size = n_vertices + n_points
    graph = sparse.csr_matrix((lengths, (rows, columns)), (size, size))
    return SurfaceDistances(graph.maximum(graph.T).tocsr(), n_vertices, edges)


def mesh_edges(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """(E, 2) int32: each edge once, the lower index first."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1)
    width = int(high.max(initial=0)) + 1
    keys = np.sort(low * width + high)  # faster than NumPy's own unique, which hashes
    keys = keys[np.diff(keys, prepend=-1) > 0]
    return np.stack([keys // width, keys % width], axis=1).astype(np.int32)


def _points_sharing_triangles(points: SurfacePoints) -> tuple[Ints, Ints]:
    corners = np.sort(points.corners, axis=1)
    same = (corners[:, None] == corners[None]).all(axis=2)
    a, b = np.nonzero(np.triu(same, 1))
    return a, b


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _grow(
    starts: NDArray[np.int32],
    ends: NDArray[np.int32],
    lengths: Floats,
    sources: NDArray[np.int32],
    wanted: NDArray[np.bool_],
    mm: Floats,
    which: NDArray[np.int32],
    order: NDArray[np.int32],
) -> int:
    """Dijkstra's method from all sources at once, until all that are wanted are reached.

    Where none is wanted it goes on to the end. `mm` comes as inf and `which` as -1; `order`
    takes what is settled, nearest first. Returns how many those are.
    """
    n = len(starts) - 1
    heap, place = np.empty(n, np.int32), np.full(n, -1, np.int32)
    size = settled = 0
    left = wanted.sum()
    stops = left > 0
    for i in range(len(sources)):
        s = sources[i]
        if place[s] < 0:
            mm[s], which[s] = 0.0, i
            heap[size], place[s] = s, size
            size += 1
    while size:
        u = heap[0]
        if stops and left == 0 and mm[u] > TOUCHING_MM and mm[u] > mm[order[settled - 1]]:
            break
        size -= 1
        if size:
            _down(heap, place, mm, heap[size], size)
        order[settled] = u
        settled += 1
        left -= wanted[u]
        for k in range(starts[u], starts[u + 1]):
            v, way = ends[k], mm[u] + lengths[k]
            if way < mm[v]:
                if place[v] < 0:
                    place[v] = size
                    size += 1
                mm[v], which[v] = way, which[u]
                _up(heap, place, mm, v)
            elif way == mm[v] and which[u] < which[v]:
                which[v] = which[u]
    return settled


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _up(heap: NDArray[np.int32], place: NDArray[np.int32], mm: Floats, v: int) -> None:
    """Move a member of the heap towards the top."""
    at = place[v]
    while at:
        parent = (at - 1) >> 1
        if mm[heap[parent]] <= mm[v]:
            break
        heap[at] = heap[parent]
        place[heap[at]] = at
        at = parent
    heap[at] = v
    place[v] = at


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _down(heap: NDArray[np.int32], place: NDArray[np.int32], mm: Floats, v: int, size: int) -> None:
    """Put a member at the heap's top and move it down."""
    at = 0
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and mm[heap[child + 1]] < mm[heap[child]]:
            child += 1
        if mm[heap[child]] >= mm[v]:
            break
        heap[at] = heap[child]
        place[heap[at]] = at
        at = child
    heap[at] = v
    place[v] = at
