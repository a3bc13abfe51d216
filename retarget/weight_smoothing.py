"""Weights of control points, made smooth by diffusion over the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

#: Added to the distance to a point when weights are smoothed, so that points make no dimples.
SMOOTHING_FLOOR_MM = 3.0
#: Columns that are solved for together: as many as keep memory small.
_COLUMNS_AT_ONCE = 32


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
    system = (sparse.identity(size) + laplacian).tocsc()
    # positive definite: no row needs to be exchanged, and the factors stay as sparse as they can
    solver = splu(
        system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    found, wanted = [], table[used].tocsc()
    for first in range(0, wanted.shape[1], _COLUMNS_AT_ONCE):
        dense = solver.solve(wanted[:, first : first + _COLUMNS_AT_ONCE].toarray())
        dense[np.abs(dense) < 1e-6] = 0.0
        found.append(sparse.csc_matrix(dense))
    joined = sparse.hstack(found).tocoo()
    return sparse.csr_matrix((joined.data, (used[joined.row], joined.col)), table.shape)


def _rows_about(table: sparse.csr_matrix, edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """Rows with entries, and two rings of neighbours about them."""
    reached = np.diff(table.indptr) > 0
    for _ in range(2):
        touched = reached[edges].any(axis=1)
        reached[edges[touched].ravel()] = True
    return np.flatnonzero(reached)
