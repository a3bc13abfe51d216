"""All spots of a picture: where each fit starts, which pixels it sees, what it leaves over."""

from __future__ import annotations

import numpy as np
from numba import njit

from .spot_fit import (
    AMP,
    BACK,
    BX,
    BY,
    CX,
    CY,
    N_SPOT,
    SHARP,
    WXX,
    WXY,
    WYY,
    centre_variance,
    fit_spot,
    model_of,
)  # fmt: skip
from .spot_scan import AREA, PEAK, SUM, X0, X1, XX, XY, Y0, Y1, YY
from .spot_scan import CX as MIDDLE_X
from .spot_scan import CY as MIDDLE_Y

#: Columns of a found spot after those of `spot_fit`, which are here in picture coordinates: pixels
#: above the level; variance of the centre for noise of variance 1 (xx, xy, yy); sum of squared
#: residuals, and of those less their products with the residuals across the centre (the odd part,
#: twice), over how many pixels; mean square of the residuals beside the spot; how many pixels are
#: at the clip; whether the fit settled; component.
S_AREA, U_XX, U_XY, U_YY, SQUARES, ODD, COUNT, BESIDE, CLIPPED, SETTLED, COMPONENT = range(
    N_SPOT, N_SPOT + 11
)
N_COLUMNS = N_SPOT + 11
MAX_PARTS = 3  # markers that touch in one component

_EDGE_PX = 2  # a component nearer to the border is cut by it
_MAX_HALF_PX = 60
_PAD_PX = 1.5
_TELLING_AREA = 8.0  # and 3 pixels above the level; how evenly fewer are filled tells no sharpness
# the window's half axes in sd: wide for a Gaussian, whose tails a slope of the skin imitates, so
# that it costs 3 π / reach⁴ of the centre's precision; beyond a disc's edge there is nothing
_REACH, _REACH_SHARP = 4.3, 3.5  # less so much times the sharpness above
_SOFT = 0.3
# beyond a component's edge: its background, to begin with, from so many places
_RING_PX, _RING_PLACES = 3.0, 20
_FAINT = 0.02  # of the amplitude: beside the spot
# a component is tried as several markers if one leaves more than this share of its light over, and
# taken as several if they leave this much less, and are alike
_POOR_FIT, _BETTER, _ALIKE_AMP, _ALIKE_AREA, _APART = 0.06, 0.4, 2.5, 4.0, 1.4
_MANY = 8
_SPLIT_ROUNDS, _LLOYD_ROUNDS = 3, 8


@njit(cache=True, nogil=True, error_model="numpy")
def fit_components(image, components, level, min_area, max_area, clip, table):  # type: ignore[no-untyped-def]
    """Fit a spot to every component of a marker's size that the border does not cut.

    Markers that touch are parted. Returns (n, N_COLUMNS) spots.
    """
    n = len(components)
    scratch = np.empty((6, (2 * _MAX_HALF_PX + 1) ** 2), np.float32)
    starts = _starts(image, components, level, max_area)
    found = np.zeros((MAX_PARTS * n, N_COLUMNS))
    near = np.empty(n, np.int64)
    large = _least_area_of_two(components, min_area, max_area)
    m, subtract = 0, n < 0  # a literal False would have `fit_one` compiled twice
    for i in range(n):
        c = components[i]
        if not _is_whole(c, image.shape, min_area, max_area):
            continue
        n_near = _neighbours(components, i, 3 * np.sqrt(c[AREA]) + 8, near)
        others = starts[near[:n_near]]
        out = found[m]
        if not fit_one(image, starts[i].copy(), others, subtract, clip, table, scratch, out):
            continue
        out[S_AREA], out[COMPONENT] = c[AREA], i
        if c[AREA] >= large and _is_poor(found[m : m + 1]):
            m += _parted(image, c, others, level, clip, table, scratch, found[m : m + MAX_PARTS])
        else:
            m += 1
    return found[:m]


@njit(cache=True, nogil=True, error_model="numpy")
def _least_area_of_two(components, min_area, max_area):  # type: ignore[no-untyped-def]
    """Two markers that touch are larger than most components of a picture, if there are many."""
    area = components[:, AREA]
    area = area[(area >= min_area) & (area <= max_area)]
    return max(2.0 * min_area, np.median(area) if len(area) >= _MANY else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _is_whole(c, shape, min_area, max_area):  # type: ignore[no-untyped-def]
    return (
        min_area <= c[AREA] <= max_area
        and c[X0] >= _EDGE_PX
        and c[Y0] >= _EDGE_PX
        and c[X1] < shape[1] - _EDGE_PX
        and c[Y1] < shape[0] - _EDGE_PX
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _starts(image, components, level, max_area):  # type: ignore[no-untyped-def]
    starts = np.zeros((len(components), N_SPOT))
    near = np.empty(len(components), np.int64)
    for i in range(len(components)):
        c = components[i]
        if c[AREA] <= max_area:
            n_near = _neighbours(components, i, 8.0, near)
            background = _background(image, components, i, near[:n_near])
            _start(c, background, level, starts[i])
        else:  # no spot, but in the way of its neighbours: an ellipse in its box
            starts[i, CX], starts[i, CY] = c[MIDDLE_X], c[MIDDLE_Y]
            starts[i, WXX] = 16 / (c[X1] - c[X0] + 3) ** 2
            starts[i, WYY] = 16 / (c[Y1] - c[Y0] + 3) ** 2
    return starts


@njit(cache=True, nogil=True, error_model="numpy")
def _start(c, background, level, spot):  # type: ignore[no-untyped-def]
    """A first guess from a component: its area's moments, and how full of light it is."""
    spot[CX], spot[CY], spot[BACK] = c[MIDDLE_X], c[MIDDLE_Y], background
    peak = max(c[PEAK] - background, 1.0)
    fill = (c[SUM] / c[AREA] - background) / peak
    cut = min(max((level - background) / peak, 0.1), 0.8)
    # exact for a Gaussian (full = 0); the powers fit the profiles' own fill and area
    gaussian_fill, gaussian_grow = (cut - 1) / np.log(cut), -2 / np.log(cut)
    full = min(max((fill - gaussian_fill) / (1 - gaussian_fill), 0.0), 0.95)
    full = min(full, (c[AREA] - 3) / _TELLING_AREA)
    grow = 0.95 + (gaussian_grow - 0.95) * (1 - full) ** 4  # variance of the light over the area's
    xx, xy, yy = grow * c[XX] + 0.1, grow * c[XY], grow * c[YY] + 0.1
    det = xx * yy - xy * xy
    spot[WXX], spot[WXY], spot[WYY] = yy / det, -xy / det, xx / det
    spot[AMP], spot[SHARP] = peak, 0.3 + 0.7 * full


@njit(cache=True, nogil=True, error_model="numpy")
def _grown(xx, xy, yy, factor, pad):  # type: ignore[no-untyped-def]
    """Inverse matrix of an ellipse, half axes nearly ``factor · sd + pad``; its half extents."""
    small = np.sqrt(max(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy), 1e-6))
    add = 2 * factor * small * pad + pad * pad
    a, b, c = factor**2 * xx + add, factor**2 * xy, factor**2 * yy + add
    det = a * c - b * b
    return c / det, -b / det, a / det, np.sqrt(a), np.sqrt(c)


@njit(cache=True, nogil=True, error_model="numpy")
def _background(image, components, i, near):  # type: ignore[no-untyped-def]
    """Mean of places around a component but not near others; the lowest if these are few."""
    h, w = image.shape
    c = components[i]
    long, turn_x, turn_y, short = _axes(c[XX] + 0.08, c[XY], c[YY] + 0.08)
    long, short = 2 * long + _RING_PX, 2 * short + _RING_PX
    total, n, lowest = 0.0, 0, 255.0
    for k in range(_RING_PLACES):
        angle = 2 * np.pi * k / _RING_PLACES
        a, b = long * np.cos(angle), short * np.sin(angle)
        x = int(np.floor(c[MIDDLE_X] + a * turn_x - b * turn_y + 0.5))
        y = int(np.floor(c[MIDDLE_Y] + a * turn_y + b * turn_x + 0.5))
        if not (0 <= x < w and 0 <= y < h):
            continue
        grey = float(image[y, x])
        lowest = min(lowest, grey)
        free = True
        for m in near:
            o = components[m]
            if o[X0] - 2 <= x <= o[X1] + 2 and o[Y0] - 2 <= y <= o[Y1] + 2:
                free = False
                break
        if free:
            total += grey
            n += 1
    return total / n if 3 * n >= _RING_PLACES else lowest


@njit(cache=True, nogil=True, error_model="numpy")
def _axes(xx, xy, yy):  # type: ignore[no-untyped-def]
    """Longer axis of a matrix as a square root, its direction, and the shorter one."""
    half, mean = np.hypot(0.5 * (xx - yy), xy), 0.5 * (xx + yy)
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.sqrt(mean + half), np.cos(turn), np.sin(turn), np.sqrt(max(mean - half, 0.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _neighbours(components, i, reach, near):  # type: ignore[no-untyped-def]
    """Fill `near` with components whose boxes come within `reach` pixels of that of i."""
    own = components[i]
    n = 0
    for k in range(len(components)):
        o = components[k]
        if (
            k != i
            and o[X0] <= own[X1] + reach
            and o[X1] >= own[X0] - reach
            and o[Y0] <= own[Y1] + reach
            and o[Y1] >= own[Y0] - reach
        ):
            near[n] = k
            n += 1
    return 1


@njit(cache=True, nogil=True, error_model="numpy")
def fit_one(image, spot, others, subtract, clip, table, scratch, out):  # type: ignore[no-untyped-def]
    """Fit a spot from a start, and fill the row `out`; False where there is none.

    Pixels that belong to `others` are left out; with `subtract`, their light is taken off too.
    """
    h, w = image.shape
    det = spot[WXX] * spot[WYY] - spot[WXY] ** 2
    if not det > 0:
        return False
    xx, xy, yy = spot[WYY] / det, -spot[WXY] / det, spot[WXX] / det
    reach = _REACH - _REACH_SHARP * max(spot[SHARP] - _SOFT, 0.0)
    exx, exy, eyy, rx, ry = _grown(xx, xy, yy, reach, _PAD_PX)
    mx, my = int(np.floor(spot[CX] + 0.5)), int(np.floor(spot[CY] + 0.5))
    rx, ry = min(int(rx) + 2, _MAX_HALF_PX), min(int(ry) + 2, _MAX_HALF_PX)
    x, y, grey = scratch[0], scratch[1], scratch[2]
    n, clipped = 0, 0
    for v in range(max(my - ry, 0), min(my + ry + 1, h)):
        dy = v - spot[CY]
        for u in range(max(mx - rx, 0), min(mx + rx + 1, w)):
            dx = u - spot[CX]
            if exx * dx * dx + 2 * exy * dx * dy + eyy * dy * dy > 1:
                continue
            if len(others) and _is_others(spot, others, u, v):
                continue
            x[n], y[n], grey[n] = u - mx, v - my, image[v, u]
            clipped += image[v, u] >= clip
            n += 1
    if n < N_SPOT + 2:
        return False
    x, y, grey, rest = x[:n], y[:n], grey[:n], scratch[3:]
    if subtract:
        for k in range(len(others)):
            other = others[k].copy()
            other[CX] -= mx
            other[CY] -= my
            model_of(x, y, table, other, rest)
            for i in range(n):
                grey[i] -= other[AMP] * rest[0, i]
    spot[CX] -= mx
    spot[CY] -= my
    settled, odd, _ = fit_spot(x, y, grey, clip, table, spot, rest)
    if not (spot[AMP] > 0 and abs(spot[CX]) <= rx and abs(spot[CY]) <= ry):
        return False
    _left_over(x, y, grey, clip, table, spot, rest, rx, ry, out)
    spot[CX] += mx
    spot[CY] += my
    for i in range(N_SPOT):
        out[i] = spot[i]
    out[U_XX], out[U_XY], out[U_YY] = centre_variance(odd)
    out[CLIPPED], out[SETTLED] = clipped, 1.0 if settled else 0.0
    return out[U_XX] > 0 and out[U_YY] > 0 and out[U_XX] * out[U_YY] > out[U_XY] ** 2


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _distance2(spot, x, y):  # type: ignore[no-untyped-def]
    dx, dy = x - spot[CX], y - spot[CY]
    return dx * dx * spot[WXX] + 2 * dx * dy * spot[WXY] + dy * dy * spot[WYY]


@njit(cache=True, nogil=True, error_model="numpy")
def _is_others(spot, others, x, y):  # type: ignore[no-untyped-def]
    """Whether a pixel is nearer to another spot, or in another's light beside its own."""
    own = _distance2(spot, x, y)
    for k in range(len(others)):
        d = _distance2(others[k], x, y)
        if d < own or (d < 9 and own > 5):
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _left_over(x, y, grey, clip, table, spot, rest, rx, ry, out):  # type: ignore[no-untyped-def]
    """Residuals: their squares, and how much of them is odd about the centre."""
    model_of(x, y, table, spot, rest)
    left = np.zeros((2 * ry + 4, 2 * rx + 4), np.float32)
    squares, count, beside, n_beside = 0.0, 0, 0.0, 0
    cx, cy = spot[CX], spot[CY]
    for i in range(len(x)):
        level = (
            spot[BACK] + spot[BX] * (x[i] - cx) + spot[BY] * (y[i] - cy) + spot[AMP] * rest[0, i]
        )
        if grey[i] >= clip and level >= clip:
            continue
        r = grey[i] - level
        left[int(y[i]) + ry + 1, int(x[i]) + rx + 1] = r
        squares += r * r
        count += 1
        if rest[0, i] < _FAINT:
            beside += r * r
            n_beside += 1
    across = 0.0
    for i in range(len(x)):
        r = left[int(y[i]) + ry + 1, int(x[i]) + rx + 1]
        u, v = 2 * cx - x[i] + rx + 1, 2 * cy - y[i] + ry + 1
        if 0 <= u < left.shape[1] - 1 and 0 <= v < left.shape[0] - 1:
            a, b = int(u), int(v)
            u -= a
            v -= b
            top = left[b, a] + u * (left[b, a + 1] - left[b, a])
            low = left[b + 1, a] + u * (left[b + 1, a + 1] - left[b + 1, a])
            across += r * (top + v * (low - top))
    out[SQUARES], out[ODD], out[COUNT] = squares, squares - across, count
    out[BESIDE] = beside / n_beside if n_beside else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _parted(image, c, others, level, clip, table, scratch, found):  # type: ignore[no-untyped-def]
    """Replace the first row of `found` by several where that explains the light; how many."""
    n = 1
    parts = np.zeros((MAX_PARTS, N_COLUMNS))
    row, background = found[0, COMPONENT], found[0, BACK]
    for k in range(2, MAX_PARTS + 1):
        if not _is_poor(found[:n]):
            break
        spots = _seeds(image, c, level, k, background)
        if _fit_parts(image, spots, others, clip, table, scratch, parts[:k]) and _is_better(
            found[:n], parts[:k]
        ):
            n = k
            _copy(parts, found, n)
    for j in range(n):
        found[j, S_AREA], found[j, COMPONENT] = c[AREA] / n, row
    return 1


@njit(cache=True, nogil=True, error_model="numpy")
def _copy(source, target, n):  # type: ignore[no-untyped-def]
    for j in range(n):
        for i in range(source.shape[1]):
            target[j, i] = source[j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _is_poor(spots):  # type: ignore[no-untyped-def]
    """Whether more is left over than a spot's shape explains."""
    left, n, allowed = 0.0, 0.0, 0.0
    for spot in spots:
        left += spot[SQUARES]
        n += spot[COUNT]
        allowed = max(allowed, (_POOR_FIT * spot[AMP]) ** 2 + 2 * spot[BESIDE])
    return left > allowed * n


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
def _fit_parts(image, spots, others, clip, table, scratch, parts):  # type: ignore[no-untyped-def]
    """Fit each with the light of the rest taken off, in turn."""
    k = len(spots)
    rest = np.empty((k - 1 + len(others), N_SPOT))
    for turn in range(_SPLIT_ROUNDS):
        for j in range(k):
            for a in range(k - 1 + len(others)):
                for i in range(N_SPOT):
                    if a < k - 1:
                        rest[a, i] = spots[a + (a >= j), i]
                    else:
                        rest[a, i] = others[a - k + 1, i]
            if not fit_one(image, spots[j], rest, turn > 0, clip, table, scratch, parts[j]):
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
