"""Markers that touch in one component, told apart."""

from __future__ import annotations

import numpy as np
from numba import njit

from .spot_fit import AMP, BACK, CX, CY, N_SPOT, SHARP, WXX, WXY, WYY
from .spot_scan import AREA, X0, X1, Y0, Y1
from .spot_scan import CX as MIDDLE_X
from .spot_scan import CY as MIDDLE_Y
from .spot_windows import BESIDE, COMPONENT, COUNT, N_COLUMNS, S_AREA, SQUARES, fit_one

MAX_PARTS = 3
# a component is tried as several markers if one leaves more than this share of its light over, and
# taken as several if they leave this much less, are alike, and lie so many sd apart
_POOR_FIT, _BETTER, _ALIKE_AMP, _ALIKE_AREA, _APART = 0.06, 0.4, 2.5, 4.0, 1.4
_ROUNDS, _LLOYD_ROUNDS = 3, 8


@njit(cache=True, nogil=True, error_model="numpy")
def parted(image, c, others, level, clip, table, scratch, found):  # type: ignore[no-untyped-def]
    """Replace the first row of `found` by several where that explains the light; how many."""
    n = 1
    parts = np.zeros((MAX_PARTS, N_COLUMNS))
    row, background = found[0, COMPONENT], found[0, BACK]
    for k in range(2, MAX_PARTS + 1):
        if not is_poor(found[:n]):
            break
        spots = _seeds(image, c, level, k, background)
        if _fit_parts(image, c, spots, others, clip, table, scratch, parts[:k]) and _is_better(
            found[:n], parts[:k]
        ):
            n = k
            _copy(parts, found, n)
    for j in range(n):
        found[j, S_AREA], found[j, COMPONENT] = c[AREA] / n, row
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _copy(source, target, n):  # type: ignore[no-untyped-def]
    for j in range(n):
        for i in range(source.shape[1]):
            target[j, i] = source[j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def is_poor(spots):  # type: ignore[no-untyped-def]
    """Whether more is left over than a spot's shape explains."""
    left, n, allowed = 0.0, 0.0, 0.0
    for spot in spots:
        left += spot[SQUARES]
        n += spot[COUNT]
        allowed = max(allowed, (_POOR_FIT * spot[AMP]) ** 2 + 2 * spot[BESIDE])
    return left > allowed * n


@njit(cache=True, nogil=True, error_model="numpy")
def is_inside(c, spot):  # type: ignore[no-untyped-def]
    return c[X0] - 1 <= spot[CX] <= c[X1] + 1 and c[Y0] - 1 <= spot[CY] <= c[Y1] + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _seeds(image, c, level, k, background):  # type: ignore[no-untyped-def]
    """Begin with k clusters of the component's pixels (Lloyd's algorithm from far apart)."""
    x0, y0 = int(c[X0]), int(c[Y0])
    width, height = int(c[X1]) - x0 + 1, int(c[Y1]) - y0 + 1
    middle = np.empty((k, 2))
    middle[0, 0], middle[0, 1] = c[MIDDLE_X], c[MIDDLE_Y]
    for j in range(k):  # the pixel farthest from those before; the first, from the middle
        farthest, best_x, best_y = -1.0, 0, 0
        for y in range(y0, y0 + height):
            for x in range(x0, x0 + width):
                if image[y, x] <= level:
                    continue
                _, d = _nearest(middle, max(j, 1), x, y)
                if d > farthest:
                    farthest, best_x, best_y = d, x, y
        middle[j, 0], middle[j, 1] = best_x, best_y
    sums = np.zeros((k, 4))
    for _ in range(_LLOYD_ROUNDS):
        for j in range(k):
            sums[j, 0] = sums[j, 1] = sums[j, 2] = sums[j, 3] = 0.0
        for y in range(y0, y0 + height):
            for x in range(x0, x0 + width):
                if image[y, x] <= level:
                    continue
                j, _ = _nearest(middle, k, x, y)
                sums[j, 0] += 1
                sums[j, 1] += x
                sums[j, 2] += y
                sums[j, 3] = max(sums[j, 3], float(image[y, x]))
        for j in range(k):
            if sums[j, 0] > 0:
                middle[j, 0], middle[j, 1] = sums[j, 1] / sums[j, 0], sums[j, 2] / sums[j, 0]
    spots = np.zeros((k, N_SPOT))
    for j in range(k):
        area = max(sums[j, 0], 1.0)
        spots[j, CX], spots[j, CY], spots[j, BACK] = middle[j, 0], middle[j, 1], background
        spots[j, AMP], spots[j, SHARP] = max(sums[j, 3] - background, 1.0), 0.6
        spots[j, WXX] = spots[j, WYY] = 4 * np.pi / area  # a disc's: variance = area / 4 π
    return spots


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(middle, n, x, y):  # type: ignore[no-untyped-def]
    best, least = 0, np.inf
    for j in range(n):
        d = (x - middle[j, 0]) ** 2 + (y - middle[j, 1]) ** 2
        if d < least:
            best, least = j, d
    return best, least


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_parts(image, c, spots, others, clip, table, scratch, parts):  # type: ignore[no-untyped-def]
    """Fit each with the light of the rest taken off, in turn."""
    k = len(spots)
    rest = np.empty((k - 1 + len(others), N_SPOT))
    for turn in range(_ROUNDS):
        for j in range(k):
            for a in range(k - 1 + len(others)):
                for i in range(N_SPOT):
                    if a < k - 1:
                        rest[a, i] = spots[a + (a >= j), i]
                    else:
                        rest[a, i] = others[a - k + 1, i]
            if not fit_one(image, spots[j], rest, turn > 0, clip, table, scratch, parts[j]):
                return False
            if not is_inside(c, parts[j]):
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _is_better(whole, parts):  # type: ignore[no-untyped-def]
    """Whether parts explain the light much better, are alike and lie apart."""
    k = len(parts)
    left, n = 0.0, 0.0
    before, n_before = 0.0, 0.0
    for spot in whole:
        before += spot[SQUARES]
        n_before += spot[COUNT]
    least_amp, most_amp, least_area, most_area = np.inf, 0.0, np.inf, 0.0
    for j in range(k):
        left += parts[j, SQUARES]
        n += parts[j, COUNT]
        det = parts[j, WXX] * parts[j, WYY] - parts[j, WXY] ** 2
        amp, area = parts[j, AMP], 1 / np.sqrt(max(det, 1e-12))
        least_amp, most_amp = min(least_amp, amp), max(most_amp, amp)
        least_area, most_area = min(least_area, area), max(most_area, area)
        for i in range(j):
            dx, dy = parts[i, CX] - parts[j, CX], parts[i, CY] - parts[j, CY]
            for p in (i, j):
                xx, xy, yy = parts[p, WXX], parts[p, WXY], parts[p, WYY]
                if dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy < _APART**2:
                    return False
    return (
        left / n < _BETTER * before / n_before
        and most_amp < _ALIKE_AMP * least_amp
        and most_area < _ALIKE_AREA * least_area
    )
