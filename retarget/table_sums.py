"""Sums of displacements by a sparse table: what a frame costs."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Floats = NDArray[np.float64]

#: So many frames are summed at once, in one pass over the table, each entry for all of them.
FRAMES_AT_ONCE = 20
#: Rows whose sums are kept together until they are written, frame by frame.
_ROWS_AT_ONCE = 32
#: With fewer frames than this it is quicker to go one by one.
_LEAST_TOGETHER = 12


def table_sums(table: sparse.csr_matrix, displacements: Floats, found: Floats) -> None:
    """Fill in how far vertices move when all axes have the same table.

    The terms of each sum are added in the table's order, however many frames there are: a frame
    alone and in a batch comes out the same to the last bit.

    Parameters
    ----------
    table : (V, N) sparse float64
    displacements : (T, N, 3) float64, mm
        Of the points.
    found : (T, V, 3) float64, mm
        Filled in.
    """
    n_frames, n_points = displacements.shape[:2]
    first = 0
    while n_frames - first >= _LEAST_TOGETHER:
        last = min(first + FRAMES_AT_ONCE, n_frames)
        lanes = displacements[first:last].transpose(1, 0, 2).reshape(n_points, -1)
        _together(table.indptr, table.indices, table.data, lanes, found[first:last])
        first = last
    if first < n_frames:
        rest = np.ascontiguousarray(displacements[first:])
        _one_by_one(table.indptr, table.indices, table.data, rest, found[first:])


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _one_by_one(
    starts: NDArray[np.int32],
    columns: NDArray[np.int32],
    values: Floats,
    displacements: Floats,
    found: Floats,
) -> None:
    for frame in range(len(found)):
        d = displacements[frame]
        for row in range(len(starts) - 1):
            x = y = z = 0.0
            for k in range(starts[row], starts[row + 1]):
                w, column = values[k], columns[k]
                x += w * d[column, 0]
                y += w * d[column, 1]
                z += w * d[column, 2]
            found[frame, row, 0] = x
            found[frame, row, 1] = y
            found[frame, row, 2] = z


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _together(
    starts: NDArray[np.int32],
    columns: NDArray[np.int32],
    values: Floats,
    lanes: Floats,
    found: Floats,
) -> None:
    """Sums for some frames; `lanes` (N, 3 T) holds what a point does in all of them."""
    n_rows, n_lanes = len(starts) - 1, lanes.shape[1]
    sums = np.empty((_ROWS_AT_ONCE, n_lanes))
    for first in range(0, n_rows, _ROWS_AT_ONCE):
        n = min(_ROWS_AT_ONCE, n_rows - first)
        for r in range(n):
            own = sums[r]
            for lane in range(n_lanes):
                own[lane] = 0.0
            for k in range(starts[first + r], starts[first + r + 1]):
                w, point = values[k], lanes[columns[k]]
                for lane in range(n_lanes):
                    own[lane] += w * point[lane]
        for frame in range(len(found)):
            for r in range(n):
                for axis in range(3):
                    found[frame, first + r, axis] = sums[r, 3 * frame + axis]
