"""Feature-point mesh deformation (Kshirsagar, Garchery & Magnenat-Thalmann 2000)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..core.errors import InputError
from ..core.mesh import SurfacePoints
from .biharmonic_weights import biharmonic_weights
from .followers import Followers
from .surface_weights import (
    NEGLIGIBLE,
    SurfaceDistances,
    displacement_table,
    interpolating,
    point_weights,
    surface_distances,
)
from .table_sums import table_sums
from .weight_smoothing import smoothed

#: Which axes (x, y, z) a point is a control point on.
Constraint = tuple[bool, bool, bool]
EVERY_AXIS: Constraint = (True, True, True)
#: How points' displacements are spread over the surface.
WEIGHTS = ("kshirsagar", "biharmonic")
#: Weights below this are rounding errors; on coarse meshes they are most of a table.
_ROUNDING = 1e-12


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
    weights : str
        ``"kshirsagar"``: by the paper. ``"biharmonic"``: the smoothest weights, see
        `biharmonic_weights`; `fade` and `smoothing` do nothing.
    reach_mm : float or None
        With biharmonic weights: vertices that are further along the surface from every point that
        moves stay where they are.

    Raises
    ------
    InputError
        If a constraint names a point that is not there.
    ValueError
        If there are no such weights.

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
        weights: str = "kshirsagar",
        reach_mm: float | None = None,
    ) -> None:
        if weights not in WEIGHTS:
            raise ValueError(f"weights must be one of {', '.join(WEIGHTS)}, got {weights!r}")
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
                control = points.select(tuple(points.names[i] for i in rows))
                if weights == "biharmonic":
                    held = _beyond(distances, rows[moving[rows]], reach_mm)
                    table = biharmonic_weights(v, triangles, control, moving[rows], held=held)
                else:
                    table = _axis_table(distances, v, at, rows, moving[rows], fade, smoothing)
                drops = smoothing or weights == "biharmonic"
                table = interpolating(table, control, moving[rows], NEGLIGIBLE if drops else 0.0)
                tables[rows.tobytes()] = _spread(table, rows[moving[rows]], len(points))
            blocks.append(tables[rows.tobytes()])
        self._finish(points, tuple(blocks))

    #: Points that follow others; None: each moves by itself.
    followers: Followers | None = None
    #: The table of all axes, where they have the same one.
    _shared: sparse.csr_matrix | None = None

    def _finish(self, points: SurfacePoints, tables: tuple[sparse.csr_matrix, ...]) -> None:
        self.points = points
        self.tables = tables
        n_vertices, n_points = tables[0].shape
        if all(t is tables[0] for t in tables):
            self._shared = tables[0].astype(np.float64)
        self._shape = (n_points, 3)
        self._n_vertices = n_vertices

    @cached_property
    def matrix(self) -> sparse.csr_matrix:
        """(3 V, 3 N) sparse: row ``3 v + axis`` from column ``3 n + axis``."""
        spread = _interleaved(self.tables)
        if self.followers is None:
            return spread
        return (spread @ self.followers.matrix(len(self.points))).tocsr()

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

    def led(self, followers: Followers) -> FeaturePointDeformer:
        """The same with points that follow others, and move besides by their own displacements."""
        found = self.joined(self.points, self.tables)
        found.followers = followers
        return found

    def displace(
        self, displacements: ArrayLike, *, out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """How far the vertices move.

        Parameters
        ----------
        displacements : (N, 3) or (T, N, 3) float, mm
            Of the points, in their order; components on axes on which a point is no control
            point do nothing.
        out : array of the result's shape, float64 and contiguous, optional
            Takes the result, and is returned: to fill one array again and again is quicker than
            to have a new one each time.

        Returns
        -------
        (V, 3) or (T, V, 3) float64, mm

        Raises
        ------
        ValueError
            If the shape is another, of either.
        """
        d = np.asarray(displacements, dtype=np.float64)
        frames, wanted = self._checked(d)
        found = np.empty(wanted) if out is None else checked_out(out, wanted)
        moved = found.reshape(len(frames), -1, 3)
        if self._shared is not None:
            table_sums(self._shared, self._followed(frames), moved)
        else:
            flat = frames.reshape(len(frames), -1)
            moved[:] = np.asarray(self.matrix @ flat.T).T.reshape(moved.shape)
        return found

    def _checked(self, d: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[int, ...]]:
        """Displacements as (T, N, 3), and the result's shape."""
        if d.ndim not in (2, 3) or d.shape[-2:] != self._shape:
            n = self._shape[0]
            raise ValueError(
                f"displacements must have shape ({n}, 3) or (T, {n}, 3), got {d.shape}"
            )
        return d.reshape(-1, *self._shape), (*d.shape[:-2], self._n_vertices, 3)

    def _followed(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return d if self.followers is None else self.followers.follow(d)


def checked_out(out: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An array that is handed in for a result of some shape.

    Raises ValueError if it has another shape, is not contiguous, or not float64.
    """
    if out.shape != shape or out.dtype != np.float64 or not out.flags.c_contiguous:
        raise ValueError(
            f"out must be contiguous float64 of shape {shape}, got {out.dtype} {out.shape}"
        )
    return out


def _beyond(
    distances: SurfaceDistances, rows: NDArray[np.int64], reach_mm: float | None
) -> NDArray[np.bool_] | None:
    """Vertices further from all points `rows` than a reach; None if there is none."""
    if reach_mm is None or not len(rows):
        return None
    return np.asarray(distances.nearest(rows)[0] > reach_mm)


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
    weights, mm = point_weights(distances, vertices, at, rows, fade=fade)
    table = displacement_table(weights, mm, fade=fade)[:, moving]
    if smoothing:
        nearest, _ = distances.nearest(rows)
        table = smoothed(table, vertices, distances.edges, nearest, smoothing)
    return table


def _spread(
    table: sparse.csr_matrix, columns: NDArray[np.int64], n_points: int
) -> sparse.csr_matrix:
    """The table with a column for every point, empty for those not among `columns`."""
    entries = table.tocoo()
    place = (entries.row, columns[entries.col])
    data = np.where(np.abs(entries.data) < _ROUNDING, 0.0, entries.data)
    found = sparse.csr_matrix((data, place), (table.shape[0], n_points))
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
