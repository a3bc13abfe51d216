"""One spot of a picture: which pixels its fit sees, and what it leaves over."""

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
)

#: Columns of a found spot after those of `spot_fit`, which are here in picture coordinates: pixels
#: above the level; variance of the centre for noise of variance 1 (xx, xy, yy); sum of squared
#: residuals, and of those less their products with the residuals across the centre (the odd part,
#: twice), over how many pixels; mean square of the residuals beside the spot; how many pixels are
#: at the clip; whether the fit settled; component.
S_AREA, U_XX, U_XY, U_YY, SQUARES, ODD, COUNT, BESIDE, CLIPPED, SETTLED, COMPONENT = range(
    N_SPOT, N_SPOT + 11
)
N_COLUMNS = N_SPOT + 11
MAX_HALF_PX = 60  # of a window

_PAD_PX = 1.5
# the window's half axes in sd: wide for a Gaussian, whose tails a slope of the skin imitates, so
# that it costs 3 π / reach⁴ of the centre's precision; beyond a disc's edge there is nothing
_REACH, _REACH_SHARP = 4.3, 3.5  # less so much times the sharpness above
_SOFT = 0.3
_FAINT = 0.02  # of the amplitude: beside the spot


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
    rx, ry = min(int(rx) + 2, MAX_HALF_PX), min(int(ry) + 2, MAX_HALF_PX)
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
    settled, odd, squares = fit_spot(x, y, grey, clip, table, spot, rest)
    if not (squares < np.inf and spot[AMP] > 0 and abs(spot[CX]) <= rx and abs(spot[CY]) <= ry):
        return False
    _left_over(x, y, grey, clip, table, spot, rest, rx, ry, out)
    spot[CX] += mx
    spot[CY] += my
    for i in range(N_SPOT):
        out[i] = spot[i]
    out[U_XX], out[U_XY], out[U_YY] = centre_variance(odd)
    out[CLIPPED], out[SETTLED] = clipped, 1.0 if settled else 0.0
    return out[U_XX] > 0 and out[U_YY] > 0 and out[U_XX] * out[U_YY] > out[U_XY] ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _grown(xx, xy, yy, factor, pad):  # type: ignore[no-untyped-def]
    """Inverse matrix of an ellipse, half axes nearly ``factor · sd + pad``; its half extents."""
    small = np.sqrt(max(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy), 1e-6))
    add = 2 * factor * small * pad + pad * pad
    a, b, c = factor**2 * xx + add, factor**2 * xy, factor**2 * yy + add
    det = a * c - b * b
    return c / det, -b / det, a / det, np.sqrt(a), np.sqrt(c)


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
