"""One step of Catmull-Clark subdivision as a sparse matrix.

The matrix applies to positions and, because the scheme is linear, to blendshape offsets too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Subdivision:
    """What one step does to a quad mesh.

    Attributes
    ----------
    matrix : (V', V) sparse float64
        New positions are ``matrix @ positions``. The first V rows are the old vertices.
    quads : (4 Q, 4) int32
        Quad ``4 q + c`` holds corner c of old quad q.
    """

    matrix: sparse.csr_matrix
    quads: NDArray[np.int32]


def catmull_clark(quads: NDArray[np.int32], n_vertices: int, *, smooth: bool = True) -> Subdivision:
    """Subdivide a quad mesh once.

    Parameters
    ----------
    quads : (Q, 4) int
    n_vertices : int
    smooth : bool
        False only splits (new points at the middles), which is what texture coordinates need.

    Notes
    -----
    Catmull & Clark 1978: face point = mean of corners; edge point = mean of its ends and of the
    two face points; old vertex = (F + 2 E + (n − 3) P) / n with F, E the means of the face points
    and edge middles around it and n its number of edges. Borders: edge points at the middle,
    border vertices by the cubic B-spline rule (1, 6, 1)/8 over the border.
    """
    Q, V = len(quads), n_vertices
    a, b = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    pairs = np.stack([np.minimum(a, b), np.maximum(a, b)], axis=1)
    edges, edge_of_side, sides = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    edge_of_side = edge_of_side.reshape(Q, 4)
    E = len(edges)
    face = sparse.csr_matrix(
        (np.full(4 * Q, 0.25), (np.repeat(np.arange(Q), 4), quads.ravel())), (Q, V)
    )
    middle = sparse.csr_matrix(
        (np.full(2 * E, 0.5), (np.repeat(np.arange(E), 2), edges.ravel())), (E, V)
    )
    edge, vertex = middle, sparse.identity(V, format="csr")
    if smooth:
        inner = sides == 2
        faces_of_edge = sparse.csr_matrix(
            (np.full(4 * Q, 0.5), (edge_of_side.ravel(), np.repeat(np.arange(Q), 4))), (E, Q)
        )
        smooth_edge = 0.5 * middle + 0.5 * (faces_of_edge @ face)
        edge = sparse.diags(inner * 1.0) @ smooth_edge + sparse.diags(~inner * 1.0) @ middle
        vertex = _vertex_rule(quads, edges, inner, face, middle, V)
    matrix = sparse.vstack([vertex, edge, face]).tocsr()
    e = V + edge_of_side
    f = np.broadcast_to((V + E + np.arange(Q))[:, None], (Q, 4))
    new = np.stack([quads, e, f, np.roll(e, 1, axis=1)], axis=2)
    return Subdivision(matrix, new.reshape(-1, 4).astype(np.int32))


def _vertex_rule(
    quads: NDArray[np.int32],
    edges: NDArray[np.int32],
    inner: NDArray[np.bool_],
    face: sparse.csr_matrix,
    middle: sparse.csr_matrix,
    V: int,
) -> sparse.csr_matrix:
    Q, E = len(quads), len(edges)
    at_face = sparse.csr_matrix(
        (np.ones(4 * Q), (quads.ravel(), np.repeat(np.arange(Q), 4))), (V, Q)
    )
    at_edge = sparse.csr_matrix(
        (np.ones(2 * E), (edges.ravel(), np.repeat(np.arange(E), 2))), (V, E)
    )
    n = np.maximum(np.asarray(at_edge.sum(axis=1)).ravel(), 1)
    n_faces = np.maximum(np.asarray(at_face.sum(axis=1)).ravel(), 1)
    F = sparse.diags(1 / n_faces) @ at_face @ face
    M = sparse.diags(1 / n) @ at_edge @ middle
    inside = sparse.diags(1 / n) @ F + sparse.diags(2 / n) @ M + sparse.diags((n - 3) / n)
    border_edges = at_edge @ sparse.diags(~inner * 1.0)
    n_border = np.asarray(border_edges.sum(axis=1)).ravel()
    # the two border middles weigh 1/4 each: (1, 6, 1)/8 over the ends and the vertex itself
    border = 0.25 * (border_edges @ middle) + 0.5 * sparse.identity(V)
    keep = sparse.identity(V)
    is_inside, is_border = n_border == 0, n_border == 2
    corner = ~(is_inside | is_border)
    return (
        sparse.diags(is_inside * 1.0) @ inside
        + sparse.diags(is_border * 1.0) @ border
        + sparse.diags(corner * 1.0) @ keep
    ).tocsr()


def triangles_of_quads(quads: NDArray[np.int32]) -> NDArray[np.int32]:
    """Two triangles a quad, (2 Q, 3); quad q gives triangles 2 q and 2 q + 1."""
    return np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
