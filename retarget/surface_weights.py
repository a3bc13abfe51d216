"""How much each control point moves each vertex (Kshirsagar et al. 2000, section 2.1).

S. Kshirsagar, S. Garchery, N. Magnenat-Thalmann: Feature Point Based Mesh Deformation Applied to
MPEG-4 Facial Animation, 2000. Equation numbers below are the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu

from ..core.mesh import SurfacePoints

#: Below this weight of its strongest point a vertex is let go gradually (option ``fade``).
FADE_BELOW = 0.5
#: Smoothed weights below this are dropped, and those up to three times as large reduced, so that
#: no step is left: 0.08 mm of a 20 mm motion at most.
NEGLIGIBLE = 4e-3
#: Added to the distance to a point when weights are smoothed, so that points make no dimples.
SMOOTHING_FLOOR_MM = 3.0
_TOUCHING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class SurfaceDistances:
    """Surface distances from every control point.

    A point in the middle of a triangle is joined to the triangle's three corners by straight
    lines, and to other points in the same triangle; everywhere else the way goes along edges.

    Attributes
    ----------
    to_vertices : (N, V) float64, mm
        inf where a vertex is on another part.
    between : (N, N) float64, mm
    edges : (E, 2) int32
    """

    to_vertices: NDArray[np.float64]
    between: NDArray[np.float64]
    edges: NDArray[np.int32]


def surface_distances(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], points: SurfacePoints
) -> SurfaceDistances:
    """Shortest ways along mesh edges from the points to all vertices."""
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
    # A length of exactly 0 would be "no edge" to the graph routines.
    lengths = np.maximum(np.concatenate([length, to_corner, across]), 1e-9)
    size = n_vertices + n_points
    graph = sparse.csr_matrix((lengths, (rows, columns)), (size, size))
    found = csgraph.dijkstra(
        graph.maximum(graph.T), directed=True, indices=n_vertices + np.arange(n_points)
    )
    return SurfaceDistances(found[:, :n_vertices], found[:, n_vertices:], edges)


def mesh_edges(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """(E, 2) int32: each edge once, the lower index first."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)


def _points_sharing_triangles(
    points: SurfacePoints,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    corners = np.sort(points.corners, axis=1)
    same = (corners[:, None] == corners[None]).all(axis=2)
    a, b = np.nonzero(np.triu(same, 1))
    return a, b


def region_neighbours(distances: SurfaceDistances, rows: NDArray[np.int64]) -> list[set[int]]:
    """For each of the points `rows`: which others' regions border on its own.

    A point's region holds the vertices that are nearer to it than to any other of the points.
    Numbers count within `rows`.
    """
    to_vertices = distances.to_vertices[rows]
    region = np.argmin(to_vertices, axis=0)
    region[~np.isfinite(to_vertices.min(axis=0))] = -1
    border = region[distances.edges]
    border = border[(border[:, 0] != border[:, 1]) & (border >= 0).all(axis=1)]
    found: list[set[int]] = [set() for _ in rows]
    for a, b in np.unique(border, axis=0):
        found[a].add(int(b))
        found[b].add(int(a))
    return found


def influence_range(
    towards: NDArray[np.float64],
    neighbour_directions: NDArray[np.float64],
    d: NDArray[np.float64],
    *,
    fade: bool = False,
) -> NDArray[np.float64]:
    """The distance at which a point's influence ends, by direction: eqs. 1 and 2.

    Parameters
    ----------
    towards : (V, 3) float64
        Unit directions from the point to the vertices.
    neighbour_directions : (n, 3) float64
        Unit directions from the point to its neighbours.
    d : (n,) float64, mm
        Surface distances to the neighbours.
    fade : bool
        Where fewer than two neighbours lie within a right angle, as beyond the outermost points,
        let the influence end at a distance between that of the nearest in direction and the mean of
        all neighbours. Ours: by the paper, it ends abruptly there, or reaches without bound.

    Returns
    -------
    (V,) float64, mm
        0 where no neighbour lies within a right angle: the paper demands criterion (1) of every
        influence, so such a vertex is not moved by this point.
    """
    n = len(d)
    if n == 0:
        return np.zeros(len(towards))
    cosine = towards @ neighbour_directions.T
    order = _two_largest(cosine)
    nearest = np.take_along_axis(cosine, order, axis=1)
    weight = np.maximum(nearest, 0.0)  # eq. 1
    weighted = (weight * d[order]).sum(axis=1)
    total = weight.sum(axis=1)
    both = np.divide(weighted, total, out=np.zeros_like(total), where=total > 0)  # eq. 2
    single = (nearest > 0).sum(axis=1) == 1
    if fade:
        cosine_1 = weight[:, 0]
        outside = cosine_1 * d[order[:, 0]] + (1 - cosine_1) * d.mean()
        return np.asarray(np.where((nearest > 0).sum(axis=1) < 2, outside, both))
    alone = np.divide(d[order[:, 0]], nearest[:, 0], out=np.zeros_like(total), where=single)
    return np.asarray(np.where(single, alone, both))


def _two_largest(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """(V, 2) columns of the largest and, where there are two, the second largest of each row."""
    first = np.argmax(values, axis=1)[:, None]
    if values.shape[1] == 1:
        return np.asarray(first)
    others = values.copy()
    np.put_along_axis(others, first, -np.inf, axis=1)
    return np.concatenate([first, np.argmax(others, axis=1)[:, None]], axis=1)


def point_weights(
    distances: SurfaceDistances,
    vertices: NDArray[np.float64],
    at: NDArray[np.float64],
    rows: NDArray[np.int64],
    *,
    fade: bool = False,
) -> sparse.csr_matrix:
    """W of eqs. 3 and 4 for the control points `rows` alone.

    Parameters
    ----------
    distances : SurfaceDistances
    vertices : (V, 3) float64, mm
    at : (N, 3) float64, mm
        Where the points are.
    rows : (n,) int
        Those of the points that take part.
    fade : bool
        See `influence_range`.

    Returns
    -------
    (V, n) sparse float64, in [0, 1]
    """
    neighbours = region_neighbours(distances, rows)
    columns = []
    for i, point in enumerate(rows):
        d_p = distances.to_vertices[point]
        others = np.array(sorted(neighbours[i]), dtype=np.int64)
        towards = _unit(vertices - at[point])
        between = distances.between[point, rows[others]] if len(others) else np.zeros(0)
        directions = _unit(at[rows[others]] - at[point]) if len(others) else np.zeros((0, 3))
        d = influence_range(towards, directions, between, fade=fade)
        inside = d_p < d
        w = np.zeros(len(vertices))
        w[inside] = np.sin(np.pi / 2 * (1 - d_p[inside] / d[inside]))  # eqs. 3 and 4
        w[d_p <= _TOUCHING_MM] = 1.0
        columns.append(sparse.csc_matrix(w[:, None]))
    return sparse.hstack(columns).tocsr()


def displacement_table(
    weights: sparse.csr_matrix, to_vertices: NDArray[np.float64], *, fade: bool
) -> sparse.csr_matrix:
    """The factors of the displacements in eq. 5.

    Parameters
    ----------
    weights : (V, n) sparse
        Of eqs. 3 and 4.
    to_vertices : (n, V) float64, mm
    fade : bool
        Eq. 5 divides by the sum of the weights, however small: a vertex that only one point
        reaches moves as far as the point itself, right up to where the influence ends, and its
        neighbour beyond does not move. With `fade` the displacement goes smoothly to zero
        where the strongest weight falls below `FADE_BELOW`. Ours, not the paper's.

    Returns
    -------
    (V, n) sparse; rows sum to 1, or to less where they fade, or to 0 where nothing reaches
    """
    found = weights.tocoo()
    d = np.maximum(to_vertices[found.col, found.row], _TOUCHING_MM)
    value = found.data / d**2
    total = np.bincount(found.row, value, minlength=weights.shape[0])
    value = value / total[found.row]
    if fade:
        strongest = np.zeros(weights.shape[0])
        np.maximum.at(strongest, found.row, found.data)
        t = np.minimum(strongest / FADE_BELOW, 1.0)
        value = value * (t * t * (3 - 2 * t))[found.row]
    return sparse.csr_matrix((value, (found.row, found.col)), weights.shape)


def smoothed(
    table: sparse.csr_matrix,
    vertices: NDArray[np.float64],
    edges: NDArray[np.int32],
    nearest_mm: NDArray[np.float64],
    amount: float,
) -> sparse.csr_matrix:
    """Diffuse a table over the surface, over a length in proportion to the distance to a point.

    Solves ``(I + L) table' = table`` with a graph Laplacian whose edges weigh (length of
    diffusion / length of edge)². Ours, not the paper's: it takes away the creases where eq. 2
    changes its two neighbours, and the terraces that 1/d² leaves around points.

    Parameters
    ----------
    table : (V, n) sparse
    vertices : (V, 3) float64, mm
    edges : (E, 2) int32
    nearest_mm : (V,) float64
        Distance of each vertex from the nearest point; inf where there is none.
    amount : float
        Length of diffusion over `nearest_mm` + `SMOOTHING_FLOOR_MM`.
    """
    used = _rows_about(table, edges)
    new = np.full(len(vertices), -1)
    new[used] = np.arange(len(used))
    e = edges[(new[edges] >= 0).all(axis=1)]
    length = np.linalg.norm(vertices[e[:, 0]] - vertices[e[:, 1]], axis=1)
    reach = amount * (nearest_mm[e].mean(axis=1) + SMOOTHING_FLOOR_MM)
    weight = (reach / np.maximum(length, 0.05)) ** 2 / 6.0  # about six edges at a vertex
    a, b = new[e].T
    size = len(used)
    adjacency = sparse.coo_matrix((weight, (a, b)), (size, size)).tocsr()
    adjacency = adjacency + adjacency.T
    laplacian = sparse.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    solver = splu((sparse.identity(size) + laplacian).tocsc(), permc_spec="MMD_AT_PLUS_A")
    dense = solver.solve(table[used].toarray())
    dense[np.abs(dense) < 1e-6] = 0.0
    found = sparse.csr_matrix(dense).tocoo()
    return sparse.csr_matrix((found.data, (used[found.row], found.col)), table.shape)


def _rows_about(table: sparse.csr_matrix, edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """Rows with entries, and two rings of neighbours about them."""
    reached = np.diff(table.indptr) > 0
    for _ in range(2):
        touched = reached[edges].any(axis=1)
        reached[edges[touched].ravel()] = True
    return np.flatnonzero(reached)


def interpolating(
    table: sparse.csr_matrix,
    control: SurfacePoints,
    moving: NDArray[np.bool_],
    negligible: float = 0.0,
) -> sparse.csr_matrix:
    """Make a table exact at the points: each moves by its own displacement and by no other.

    Eq. 5 has that limit at the point itself, but a point in the middle of a triangle moves with
    the triangle's corners, which others pull at too. First the whole table is multiplied by the
    inverse of what the points do to each other; what is left is given to the corners, the
    smallest change that does it.

    Parameters
    ----------
    table : (V, m) sparse
        Columns of the moving points.
    control : SurfacePoints
        All n control points of the axis.
    moving : (n,) bool
        Which of them have a column.
    negligible : float
        Weights below this are dropped; see `NEGLIGIBLE`.
    """
    n = len(control)
    place = (np.repeat(np.arange(n), 3), control.corners.ravel())
    b = sparse.csr_matrix((control.barycentric.ravel(), place), (n, table.shape[0]))
    crosstalk = (b @ table).toarray()[moving]
    inverse = np.linalg.pinv(crosstalk, rcond=1.0 / _WELL_POSED)
    if np.linalg.matrix_rank(crosstalk, tol=1.0 / _WELL_POSED) == len(crosstalk):
        inverse[np.abs(inverse) < 1e-5] = 0.0
        table = (table @ sparse.csr_matrix(inverse)).tocsr()
    if negligible:
        size = np.abs(table.data)
        table.data *= np.clip((size - negligible) / (2 * negligible), 0.0, 1.0)
        table.eliminate_zeros()
    left = np.eye(n)[:, moving] - (b @ table).toarray()
    correction = sparse.csr_matrix(np.linalg.pinv((b @ b.T).toarray(), rcond=1e-9) @ left)
    return (table + b.T @ correction).tocsr()


_WELL_POSED = 50.0


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(np.divide(v, length, out=np.zeros_like(v), where=length > 0))
