"""How much each control point moves each vertex: the smoothest weights (biharmonic)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu

from ..core.mesh import SurfacePoints

#: Cotangents of slivers are held within this: a needle must not outweigh its neighbours.
_LEAST_COTANGENT, _LARGEST_COTANGENT = 0.02, 20.0
#: How firmly points are held, relative to the surface's own stiffness about them.
_FIRMNESS = 1e4
#: Keeps a part that hangs on a single point from turning about it: no other part notices.
_AT_REST = 1e-9
#: Beyond this distance from points the surface is a membrane rather than a plate.
TENSION_MM = 8.0


def cotangent_laplacian(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """The surface's Laplacian and the area about each vertex.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32

    Returns
    -------
    laplacian : (V, V) sparse, positive semi-definite; rows sum to 0
        Cotangents below a small positive bound are raised to it: on obtuse triangles it is then
        not exact for linear functions, but its solutions stay free of folds.
    area : (V,) float64, mm²
        A third of the triangles around; 0 where there are none.

    References
    ----------
    Pinkall, Polthier: Computing Discrete Minimal Surfaces and Their Conjugates, 1993, section 2.
    """
    n = len(vertices)
    p = vertices[triangles]
    rows, columns, values = [], [], []
    twice_area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    for corner in range(3):
        a, b = (corner + 1) % 3, (corner + 2) % 3
        dot = ((p[:, a] - p[:, corner]) * (p[:, b] - p[:, corner])).sum(axis=1)
        cotangent = dot / np.maximum(twice_area, 1e-12)
        values.append(np.clip(cotangent, _LEAST_COTANGENT, _LARGEST_COTANGENT) / 2)
        rows.append(triangles[:, a])
        columns.append(triangles[:, b])
    place = (np.concatenate(rows), np.concatenate(columns))
    half = sparse.csr_matrix((np.concatenate(values), place), (n, n))
    adjacency = half + half.T
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    area = np.bincount(triangles.ravel(), np.repeat(twice_area / 6, 3), minlength=n)
    return (sparse.diags(degree) - adjacency).tocsr(), np.asarray(area, dtype=np.float64)


def biharmonic_weights(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    points: SurfacePoints,
    moving: NDArray[np.bool_],
    *,
    held: NDArray[np.bool_] | None = None,
    tension_mm: float = TENSION_MM,
) -> sparse.csr_matrix:
    """The smoothest surface functions that are 1 at one point and 0 at all others.

    They minimise the integral of (Δu)² + |∇u|² / tension²: a thin plate under tension. Unlike
    Kshirsagar's weights they have no creases, whatever the distances between points; they are
    not bounded to [0, 1] but overshoot a little, as splines do, and the less the more tension.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32
    points : SurfacePoints
        All n control points.
    moving : (n,) bool
        Which of them have a column; the others hold the surface where it is.
    held : (V,) bool, optional
        Vertices that stay.
    tension_mm : float, mm
        Nearer to points than this the plate's stiffness prevails, farther away the tension.

    Returns
    -------
    (V, m) sparse float64
        0 on parts without a point. Points in the middle of triangles are met to about 1e-4;
        `surface_weights.interpolating` makes them exact.

    References
    ----------
    Botsch, Kobbelt: An Intuitive Framework for Real-Time Freeform Modeling, 2004, section 4;
    Jacobson et al.: Bounded Biharmonic Weights for Real-Time Deformation, 2011, eq. 3 (without
    the bounds).
    """
    n_vertices, n_points = len(vertices), len(points)
    free = _free_vertices(n_vertices, triangles, points, held)
    if not len(free) or not moving.any():
        return sparse.csr_matrix((n_vertices, int(moving.sum())))
    laplacian, area = cotangent_laplacian(vertices, triangles)
    typical = float(np.median(area[area > 0]))
    inverse_area = sparse.diags(1 / np.maximum(area, 0.01 * typical))
    plate = laplacian @ inverse_area @ laplacian + laplacian / tension_mm**2
    stiffness = plate.tocsr()[free][:, free] * (typical / 2)  # entries of about 1
    place = (np.repeat(np.arange(n_points), 3), points.corners.ravel())
    at = sparse.csr_matrix((points.barycentric.ravel(), place), (n_points, n_vertices))[:, free]
    firm = _FIRMNESS * float(stiffness.diagonal().mean())
    system = stiffness + firm * (at.T @ at) + _AT_REST * sparse.identity(len(free))
    solver = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    found = solver.solve(firm * at[moving].toarray().T)
    found[np.abs(found) < 1e-6] = 0.0
    entries = sparse.coo_matrix(found)
    return sparse.csr_matrix(
        (entries.data, (free[entries.row], entries.col)), (n_vertices, found.shape[1])
    )


def _free_vertices(
    n_vertices: int,
    triangles: NDArray[np.int32],
    points: SurfacePoints,
    held: NDArray[np.bool_] | None,
) -> NDArray[np.int64]:
    """Vertices that are not held, on parts of the surface that have a point."""
    a, b = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    graph = sparse.csr_matrix((np.ones(len(a)), (a, b)), (n_vertices, n_vertices))
    _, part = csgraph.connected_components(graph, directed=False)
    free = np.isin(part, part[points.corners.ravel()])
    if held is not None:
        free &= ~held
    return np.flatnonzero(free)
