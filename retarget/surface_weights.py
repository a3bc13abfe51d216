"""How much each control point moves each vertex (Kshirsagar et al. 2000, section 2.1).

S. Kshirsagar, S. Garchery, N. Magnenat-Thalmann: Feature Point Based Mesh Deformation Applied to
MPEG-4 Facial Animation, 2000. Equation numbers below are the paper's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import SurfacePoints
from .surface_distances import TOUCHING_MM, SurfaceDistances, mesh_edges, surface_distances

__all__ = [
    "SurfaceDistances",
    "displacement_table",
    "influence_range",
    "interpolating",
    "mesh_edges",
    "point_weights",
    "region_neighbours",
    "surface_distances",
]

#: Below this weight of its strongest point a vertex is let go gradually (option ``fade``).
FADE_BELOW = 0.5
#: Smoothed weights below this are dropped, and those up to three times as large reduced, so that
#: no step is left: 0.08 mm of a 20 mm motion at most.
NEGLIGIBLE = 4e-3
#: Rows that are worked on together: as many as keep memory small.
_ROWS_AT_ONCE = 20000


def region_neighbours(distances: SurfaceDistances, rows: NDArray[np.int64]) -> list[set[int]]:
    """For each of the points `rows`: which others' regions border on its own.

    A point's region holds the vertices that are nearer to it than to any other of the points.
    Numbers count within `rows`.
    """
    _, region = distances.nearest(rows)
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
) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
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
    weights : (V, n) sparse float64, in [0, 1]
    mm : (V, n) sparse float64
        The distances that belong to them, above 0.
    """
    neighbours = region_neighbours(distances, rows)
    found: list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]] = []
    for i, point in enumerate(rows):
        others = rows[np.array(sorted(neighbours[i]), dtype=np.int64)]
        near, d_p, between = distances.around(int(point), others)
        if not fade and len(others):  # by eq. 2 a single neighbour's range has no bound
            d_p = distances.to_vertices[point]
            near = np.arange(len(vertices))
        towards = _unit(vertices[near] - at[point])
        d = influence_range(towards, _unit(at[others] - at[point]), between, fade=fade)
        inside = d_p < d
        w = np.zeros(len(near))
        w[inside] = np.sin(np.pi / 2 * (1 - d_p[inside] / d[inside]))  # eqs. 3 and 4
        w[d_p <= TOUCHING_MM] = 1.0
        kept = w > 0
        found.append((near[kept], w[kept], np.maximum(d_p[kept], TOUCHING_MM)))
    row = np.concatenate([f[0] for f in found])
    column = np.repeat(np.arange(len(found)), [len(f[0]) for f in found])
    shape = (len(vertices), len(found))
    weights, mm = (
        sparse.csr_matrix((np.concatenate([f[k] for f in found]), (row, column)), shape)
        for k in (1, 2)
    )
    return weights, mm


def displacement_table(
    weights: sparse.csr_matrix, mm: sparse.csr_matrix, *, fade: bool
) -> sparse.csr_matrix:
    """The factors of the displacements in eq. 5.

    Parameters
    ----------
    weights, mm : (V, n) sparse
        Of eqs. 3 and 4, as `point_weights` returns them.
    fade : bool
        Eq. 5 divides by the sum of the weights, however small: a vertex that only one point
        reaches moves as far as the point itself, right up to where the influence ends, and its
        neighbour beyond does not move. With `fade` the displacement goes smoothly to zero
        where the strongest weight falls below `FADE_BELOW`. Ours, not the paper's.

    Returns
    -------
    (V, n) sparse; rows sum to 1, or to less where they fade, or to 0 where nothing reaches
    """
    found, d = weights.tocoo(), mm.tocoo()
    value = found.data / d.data**2
    total = np.bincount(found.row, value, minlength=weights.shape[0])
    value = value / total[found.row]
    if fade:
        strongest = np.zeros(weights.shape[0])
        np.maximum.at(strongest, found.row, found.data)
        t = np.minimum(strongest / FADE_BELOW, 1.0)
        value = value * (t * t * (3 - 2 * t))[found.row]
    return sparse.csr_matrix((value, (found.row, found.col)), weights.shape)


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
        mixed = sparse.csr_matrix(inverse)
        parts = [
            _without(table[first : first + _ROWS_AT_ONCE] @ mixed, negligible)
            for first in range(0, table.shape[0], _ROWS_AT_ONCE)
        ]
        table = sparse.vstack(parts).tocsr()
    else:
        table = _without(table, negligible)
    left = np.eye(n)[:, moving] - (b @ table).toarray()
    correction = sparse.csr_matrix(np.linalg.pinv((b @ b.T).toarray(), rcond=1e-9) @ left)
    return (table + b.T @ correction).tocsr()


_WELL_POSED = 50.0


def _without(table: sparse.csr_matrix, negligible: float) -> sparse.csr_matrix:
    """The table without negligible entries; those little larger are reduced, so none jumps."""
    found = table.tocsr()
    if negligible:
        size = np.abs(found.data)
        found.data = found.data * np.clip((size - negligible) / (2 * negligible), 0.0, 1.0)
        found.eliminate_zeros()
    return found


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(np.divide(v, length, out=np.zeros_like(v), where=length > 0))
