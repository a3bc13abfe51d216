"""Connected groups of bright pixels.

Bright pixels are a few thousand of a million: they are searched for eight at a time, and what
follows looks at them only.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: Columns of a component: its box (inclusive), number of pixels, centre and second central
#: moments of its area (xx, xy, yy), sum of its grey levels, highest one.
X0, Y0, X1, Y1, AREA, CX, CY, XX, XY, YY, SUM, PEAK = range(12)
_COLUMNS = 12


def scan(
    image: NDArray[np.uint8], level: float, max_components: int
) -> tuple[NDArray[np.float64], int]:
    """Groups of pixels above a level that touch by a side or a corner.

    Parameters
    ----------
    image : (h, w) uint8
    level : float
    max_components : int

    Returns
    -------
    (n, 12) float64
        Columns as named in this module; in the order of their first pixels.
    int
        How many there are; where that is more than `max_components`, none is returned.
    """
    places = _bright_places(image, level)
    found, n = _components(image, places, image.shape[1], max_components)
    return found, int(n)


def _bright_places(image: NDArray[np.uint8], level: float) -> NDArray[np.int64]:
    """Where pixels exceed a level, counted row by row."""
    above = int(np.floor(level))
    if above < 0:
        return np.arange(image.size)
    if above >= 255:
        return np.empty(0, np.int64)
    whole = image.flags.c_contiguous and image.size % 64 == 0
    if not (whole and image.ctypes.data % 8 == 0):
        return np.flatnonzero(image > above)
    flat = image.reshape(-1)
    places = np.empty(image.size, np.int64)  # most of it is never touched
    return np.asarray(places[: _search(flat.view(np.uint64), flat, above, places)])


@njit(cache=True, nogil=True, error_model="numpy")
def _search(words, flat, above, places):  # type: ignore[no-untyped-def]
    """Fill `places`; how many. Eight pixels are compared at once, in a word of 64 bits.

    A byte v exceeds a if (v mod 128) + 127 - a carries into its top bit or v has that bit (a below
    128), or if (v mod 128) + 255 - a carries into it and v has it (a from 128).
    """
    low, top = np.uint64(0x7F7F7F7F7F7F7F7F), np.uint64(0x8080808080808080)
    is_high = above >= 128
    each = np.uint64(255 - above if is_high else 127 - above)
    add = np.uint64(0x0101010101010101) * each
    both = ~np.uint64(0) if is_high else np.uint64(0)
    n = 0
    for block in range(0, len(words), 8):
        any_above = np.uint64(0)
        for i in range(8):
            v = words[block + i]
            carried = (v & low) + add
            any_above |= ((carried & v) & both) | ((carried | v) & ~both)
        if any_above & top:
            for place in range(8 * block, 8 * block + 64):
                if flat[place] > above:
                    places[n] = place
                    n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _components(image, places, width, max_components):  # type: ignore[no-untyped-def]
    """Runs of neighbours in a row, joined to those of the row above by union-find."""
    n_runs = 0
    for i in range(len(places)):
        if i == 0 or places[i] != places[i - 1] + 1 or places[i] % width == 0:
            n_runs += 1
    begin = np.empty(n_runs, np.int64)  # of the run in its row
    end = np.empty(n_runs, np.int64)  # one past it
    row = np.empty(n_runs, np.int64)
    parent = np.arange(n_runs)
    n = 0
    for i in range(len(places)):
        if i == 0 or places[i] != places[i - 1] + 1 or places[i] % width == 0:
            begin[n], row[n] = places[i] % width, places[i] // width
            n += 1
        end[n - 1] = places[i] % width + 1
    above = 0
    for run in range(n_runs):
        while row[above] < row[run] - 1 or (row[above] == row[run] - 1 and end[above] < begin[run]):
            above += 1
        other = above
        while other < run and row[other] == row[run] - 1 and begin[other] <= end[run]:
            a, b = _root(parent, run), _root(parent, other)
            parent[max(a, b)] = min(a, b)
            other += 1
    return _summed(image, begin, end, row, parent, max_components)


@njit(cache=True, nogil=True, error_model="numpy")
def _root(parent, run):  # type: ignore[no-untyped-def]
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True, nogil=True, error_model="numpy")
def _summed(image, begin, end, row, parent, max_components):  # type: ignore[no-untyped-def]
    index = np.empty(len(begin), np.int64)
    n = 0
    for run in range(len(begin)):
        if parent[run] == run:
            index[run] = n
            n += 1
    if n > max_components:
        return np.empty((0, _COLUMNS)), n
    found = np.zeros((n, _COLUMNS))
    origin = np.empty((n, 2), np.int64)
    for run in range(len(begin)):
        root = _root(parent, run)
        i = index[root]
        c = found[i]
        x0, x1, y = begin[run], end[run], row[run]
        if run == root:
            origin[i, 0], origin[i, 1] = x0, y
            c[X0], c[Y0], c[X1], c[Y1] = x0, y, x1 - 1, y
        c[X0], c[X1], c[Y1] = min(c[X0], x0), max(c[X1], x1 - 1), max(c[Y1], y)
        dy = float(y - origin[i, 1])
        for x in range(x0, x1):
            dx, grey = float(x - origin[i, 0]), float(image[y, x])
            c[AREA] += 1.0
            c[CX] += dx
            c[CY] += dy
            c[XX] += dx * dx
            c[XY] += dx * dy
            c[YY] += dy * dy
            c[SUM] += grey
            c[PEAK] = max(c[PEAK], grey)
    for i in range(n):
        c = found[i]
        mx, my = c[CX] / c[AREA], c[CY] / c[AREA]
        c[XX] = c[XX] / c[AREA] - mx * mx
        c[XY] = c[XY] / c[AREA] - mx * my
        c[YY] = c[YY] / c[AREA] - my * my
        c[CX], c[CY] = mx + origin[i, 0], my + origin[i, 1]
    return found, n
