"""A head's tables in one: how much knots count, and what vertices then do."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..core.fat import FapTable
from ..core.mesh import SurfacePoints
from ..heads.head import Head
from .deformer import FeaturePointDeformer, checked_out

Floats = NDArray[np.float64]


class KnotDeformer(FeaturePointDeformer):
    """Moves vertices by how much the knots of tables count.

    Its "points" are the knots, 0 left out, and a point's "displacement" is how much its knot
    counts, the same on all axes. A frame costs what the knots that count move: two a FAP at most,
    one where a FAP is straight on either side of 0.

    Parameters
    ----------
    head : Head
    tables : list of FapTable
        That move something.
    """

    def __init__(self, head: Head, tables: list[FapTable]) -> None:
        knots = [(table, k) for table in tables for k in np.flatnonzero(table.knots)]
        self._vertices = _joined([t.vertices for t, _ in knots], np.zeros(0, np.int32))
        self._offsets = _joined([t.offsets[k] for t, k in knots], np.zeros((0, 3), np.float32))
        self._starts = np.cumsum([0, *(len(t.vertices) for t, _ in knots)])
        self._knots = _joined([t.knots for t in tables], np.zeros(0))
        self._of_faps = np.cumsum([0, *(len(t.knots) for t in tables)])
        at = np.repeat(np.arange(len(knots)), np.diff(self._starts))
        shape = (len(head.mesh.vertices), len(knots))
        place = (self._vertices, at)
        x, y, z = (
            sparse.csr_matrix((self._offsets[:, axis].astype(np.float64), place), shape)
            for axis in range(3)
        )
        self._finish(_places_of_knots(head, knots), (x, y, z))

    def counts(self, values: Floats) -> Floats:
        """How much the knots count.

        Parameters
        ----------
        values : (T, F) float64, table units
            Of the tables' FAPs, in their order.

        Returns
        -------
        (T, N) float64, in [0, 1]
        """
        found = np.zeros((len(values), len(self.points)))
        _count(self._knots, self._of_faps, values, found)
        return found

    def displace(
        self, displacements: ArrayLike, *, out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """As `FeaturePointDeformer.displace`; knots that do not count cost nothing."""
        d = np.ascontiguousarray(displacements, dtype=np.float64)
        frames, wanted = self._checked(d)
        found = np.empty(wanted) if out is None else checked_out(out, wanted)
        found[:] = 0.0
        moved = found.reshape(len(frames), -1, 3)
        _superpose(frames, self._starts, self._vertices, self._offsets, moved)
        return found


def _joined(parts: list[Any], none: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([none, *parts])


def _places_of_knots(head: Head, knots: list[tuple[FapTable, np.intp]]) -> SurfacePoints:
    """Each where its FAP moves the mesh most."""
    triangles = head.mesh.triangles
    used, first = np.unique(triangles.ravel(), return_index=True)
    names, corners, weights = [], [], []
    for table, k in knots:
        most = table.vertices[np.abs(table.offsets).sum(axis=(0, 2)).argmax()]
        own = triangles[first[np.searchsorted(used, most)] // 3]
        names.append(f"{table.fap}.{table.knots[k]:.0f}")
        corners.append(own)
        weights.append(own == most)
    n = len(names)
    return SurfacePoints(
        tuple(names),
        np.array(corners, dtype=np.int32).reshape(n, 3),
        np.array(weights, dtype=np.float64).reshape(n, 3),
    )


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _count(knots: Floats, of_faps: NDArray[np.int64], values: Floats, counts: Floats) -> None:
    """Fill in how much knots count; those at 0 have no column."""
    for frame in range(len(values)):
        for fap in range(len(of_faps) - 1):
            first, last = of_faps[fap], of_faps[fap + 1]
            value = min(max(values[frame, fap], knots[first]), knots[last - 1])
            column = first - fap  # each FAP before has one knot at 0
            for k in range(first, last):
                if knots[k] == 0.0:
                    continue
                if k > first and knots[k - 1] <= value <= knots[k]:
                    counts[frame, column] = (value - knots[k - 1]) / (knots[k] - knots[k - 1])
                elif k < last - 1 and knots[k] <= value <= knots[k + 1]:
                    counts[frame, column] = (knots[k + 1] - value) / (knots[k + 1] - knots[k])
                column += 1


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _superpose(
    counts: Floats,
    starts: NDArray[np.int64],
    vertices: NDArray[np.int32],
    offsets: NDArray[np.float32],
    found: Floats,
) -> None:
    """Add what each knot that counts does to `found`."""
    for frame in range(len(counts)):
        for knot in range(len(starts) - 1):
            x, y, z = counts[frame, knot]
            if x == 0.0 and y == 0.0 and z == 0.0:
                continue
            for j in range(starts[knot], starts[knot + 1]):
                v = vertices[j]
                found[frame, v, 0] += x * offsets[j, 0]
                found[frame, v, 1] += y * offsets[j, 1]
                found[frame, v, 2] += z * offsets[j, 2]
