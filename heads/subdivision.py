"""Subdivision: one step of Catmull-Clark as a sparse matrix, and spheres.

The matrix applies to positions and, because the scheme is linear, to blendshape offsets too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

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


@cache
def icosphere(steps: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Unit directions (V, 3) and triangles (F, 3) of an icosahedron subdivided so many times."""
    g = (1 + 5**0.5) / 2
    v: list[tuple[float, float, float]] = [
        (-1, g, 0),
        (1, g, 0),
        (-1, -g, 0),
        (1, -g, 0),
        (0, -1, g),
        (0, 1, g),
    ]
    v += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    points = np.array(v, dtype=np.float64)
    triangles = np.array(
        [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
         (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8),
         (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)],
        dtype=np.int64,
    )  # fmt: skip
    for _ in range(steps):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, row = np.unique(edges, axis=0, return_inverse=True)
        middle = len(points) + row.reshape(-1, 3)
        points = np.concatenate([points, points[unique].mean(axis=1)])
        a, b, c = triangles.T
        ab, bc, ca = middle.T
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, triangles.astype(np.int32)
