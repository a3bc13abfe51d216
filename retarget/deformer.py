"""Feature-point mesh deformation (Kshirsagar, Garchery & Magnenat-Thalmann 2000)."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..core.errors import InputError
from ..core.mesh import SurfacePoints
from .surface_weights import (
    NEGLIGIBLE,
    SurfaceDistances,
    displacement_table,
    interpolating,
    point_weights,
    smoothed,
    surface_distances,
)

#: Which axes (x, y, z) a point is a control point on.
Constraint = tuple[bool, bool, bool]
EVERY_AXIS: Constraint = (True, True, True)


class FeaturePointDeformer:
    """Moves a mesh by displacements of points on it.

    Everything but the displacements is worked out beforehand, into one sparse matrix: a frame is
    one product.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
        At rest.
    triangles : (F, 3) int32
        The surface that deforms. Vertices of no triangle, and parts with no point, stay.
    points : SurfacePoints
    constraints : mapping from point name to three bools
        The axes on which a point is a control point; along the others it is an ordinary vertex
        (section 2 of the paper). Points that are not named are ordinary on all axes.
    still : collection of str
        Control points that never move, such as the corners of the eyes: they hold the mesh
        where it is. Their columns are left out of the matrix, so displacements handed in for
        them do nothing.
    fade : bool
        Let go gradually of vertices at the edge of all influence; see `influence_range` and
        `displacement_table`. False: the equations as printed.
    smoothing : float
        Diffuse the weights over this part of the distance to the nearest point; see
        `surface_weights.smoothed`. 0: as in the paper.

    Raises
    ------
    InputError
        If a constraint names a point that is not there.

    References
    ----------
    Kshirsagar, Garchery, Magnenat-Thalmann: Feature Point Based Mesh Deformation Applied to
    MPEG-4 Facial Animation, 2000, eqs. 1 to 5.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        triangles: NDArray[np.int32],
        points: SurfacePoints,
        constraints: Mapping[str, Constraint],
        *,
        still: Collection[str] = (),
        fade: bool = False,
        smoothing: float = 0.0,
    ) -> None:
        v = np.asarray(vertices, dtype=np.float64)
        _check_names({*constraints, *still}, points)
        distances = surface_distances(v, triangles, points)
        at = points.at(v)
        moving = np.array([name not in still for name in points.names])
        tables: dict[bytes, sparse.csr_matrix] = {}
        blocks = []
        for axis in range(3):
            rows = _control_rows(points, constraints, axis)
            if rows.tobytes() not in tables:
                table = _axis_table(distances, v, at, rows, moving[rows], fade, smoothing)
                control = points.select(tuple(points.names[i] for i in rows))
                tables[rows.tobytes()] = interpolating(
                    table, control, moving[rows], NEGLIGIBLE if smoothing else 0.0
                )
            blocks.append(_spread(tables[rows.tobytes()], rows[moving[rows]], len(points)))
        self._finish(points, tuple(blocks))

    def _finish(self, points: SurfacePoints, tables: tuple[sparse.csr_matrix, ...]) -> None:
        self.points = points
        self.tables = tables
        n_vertices, n_points = tables[0].shape
        self.matrix = _interleaved(tables)
        self._shape = (n_points, 3)
        self._n_vertices = n_vertices

    @property
    def n_vertices(self) -> int:
        """How many vertices it moves."""
        return int(self._n_vertices)

    def joined(
        self, points: SurfacePoints, tables: tuple[sparse.csr_matrix, ...]
    ) -> FeaturePointDeformer:
        """The same with other points and tables, (V, N) sparse for each axis.

        For what moves along with the surface (lashes) or by rules of its own (the tongue).
        """
        found = object.__new__(FeaturePointDeformer)
        found._finish(points, tables)
        return found

    def displace(self, displacements: ArrayLike) -> NDArray[np.float64]:
        """How far the vertices move.

        Parameters
        ----------
        displacements : (N, 3) or (T, N, 3) float, mm
            Of the points, in their order; components on axes on which a point is no control
            point do nothing.

        Returns
        -------
        (V, 3) or (T, V, 3) float64, mm

        Raises
        ------
        ValueError
            If the shape is another.
        """
        d = np.asarray(displacements, dtype=np.float64)
        if d.shape == self._shape:
            found: NDArray[np.float64] = self.matrix @ d.ravel()
            return found.reshape(-1, 3)
        if d.ndim != 3 or d.shape[1:] != self._shape:
            n = self._shape[0]
            raise ValueError(
                f"displacements must have shape ({n}, 3) or (T, {n}, 3), got {d.shape}"
            )
        flat = d.reshape(len(d), -1)
        return np.ascontiguousarray((self.matrix @ flat.T).T).reshape(len(d), -1, 3)


def _check_names(names: Collection[str], points: SurfacePoints) -> None:
    unknown = sorted(set(names) - set(points.names))
    if unknown:
        raise InputError(f"no points {', '.join(unknown)} on this mesh")


def _control_rows(
    points: SurfacePoints, constraints: Mapping[str, Constraint], axis: int
) -> NDArray[np.int64]:
    rows = [i for i, n in enumerate(points.names) if n in constraints and constraints[n][axis]]
    return np.array(rows, dtype=np.int64)


def _axis_table(
    distances: SurfaceDistances,
    vertices: NDArray[np.float64],
    at: NDArray[np.float64],
    rows: NDArray[np.int64],
    moving: NDArray[np.bool_],
    fade: bool,
    smoothing: float,
) -> sparse.csr_matrix:
    """(V, n moving): the factors of eq. 5 on one axis."""
    if not moving.any():
        return sparse.csr_matrix((len(vertices), 0))
    to_vertices = distances.to_vertices[rows]
    weights = point_weights(distances, vertices, at, rows, fade=fade)
    table = displacement_table(weights, to_vertices, fade=fade)[:, moving]
    if smoothing:
        nearest = to_vertices.min(axis=0)
        table = smoothed(table, vertices, distances.edges, nearest, smoothing)
    return table


def _spread(
    table: sparse.csr_matrix, columns: NDArray[np.int64], n_points: int
) -> sparse.csr_matrix:
    """The table with a column for every point, empty for those not among `columns`."""
    entries = table.tocoo()
    place = (entries.row, columns[entries.col])
    found = sparse.csr_matrix((entries.data, place), (table.shape[0], n_points))
    found.eliminate_zeros()
    return found


def _interleaved(tables: tuple[sparse.csr_matrix, ...]) -> sparse.csr_matrix:
    """(3 V, 3 N): row 3 v + axis from column 3 n + axis."""
    n_vertices, n_points = tables[0].shape
    entries = [table.tocoo() for table in tables]
    rows = np.concatenate([3 * t.row.astype(np.int64) + a for a, t in enumerate(entries)])
    columns = np.concatenate([3 * t.col.astype(np.int64) + a for a, t in enumerate(entries)])
    data = np.concatenate([t.data for t in entries])
    found = sparse.csr_matrix((data, (rows, columns)), (3 * n_vertices, 3 * n_points))
    found.sort_indices()
    return found
