"""Least-squares fit of one spot: a slanted, blurred disc over sloping skin.

The model is ``I(x, y) = B + b_x dx + b_y dy + A f_s(q)``, ``q = dᵀ W d``: background plane,
amplitude, centre, the inverse W of the spot's variance, and its sharpness s (`spot_profiles`).
Centre and slopes are odd about the centre and all else is even, so that on a window that is even
too the normal equations fall into two blocks; Gauss-Newton solves them apart (4 and 6 unknowns).
By the same symmetry an error of the shape does not move the centre: it costs precision only.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .spot_profiles import BY_SHARPNESS, N_SHARPNESS, Q_MAX, Q_STEPS, SHARPNESS_STEPS, SLOPE

#: A fitted spot: centre (from the window's corner), background and its slopes, amplitude, inverse
#: variance, sharpness.
CX, CY, BACK, BX, BY, AMP, WXX, WXY, WYY, SHARP = range(10)
N_SPOT = 10

MAX_STEPS = 12
#: Steps shrink about fivefold each: after one of this size, what is left is not felt.
_DONE_PX, _DONE_SD, _GAIN_DONE = 0.003, 0.2, 0.2
_WORSE = 1e-3  # sums are of 32 bits
_SHARP_MOST = (N_SHARPNESS - 1) / SHARPNESS_STEPS
_SHARP_PRIOR, _SHARP_SD = 0.5, 0.4  # weak: only small spots in much noise feel it
_SLOPE_SD = 0.01  # of the amplitude, per pixel: skin is shaded gently; felt in much noise only
_DAMPING = 1e-3

#: Sums may be taken in any order; there is no NaN to care for.
_FAST = {"reassoc", "contract", "nsz", "arcp"}
_S_STEPS, _S_STEP = np.float32(SHARPNESS_STEPS), np.float32(1 / SHARPNESS_STEPS)
_ROW_LENGTH = np.uint32(3 * (Q_MAX * Q_STEPS + 2))  # of the flat table
_TO_SLOPE, _TO_SHARP = (np.uint64(n * (Q_MAX * Q_STEPS + 2)) for n in (SLOPE, BY_SHARPNESS))
_NEXT = np.uint64(1)
_Q_STEPS, _LAST_PLACE = np.float32(Q_STEPS), np.float32(Q_MAX * Q_STEPS)
#: Whatever a pixel's numbers are, NaN included, no place outside the table is read.
_LAST_ROW, _LAST_COLUMN = np.uint32(N_SHARPNESS - 1), np.uint32(Q_MAX * Q_STEPS)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_spot(x, y, grey, clip, table, spot, scratch):  # type: ignore[no-untyped-def]
    """Fit one spot in place.

    Parameters
    ----------
    x, y, grey : (n,) float32
        Pixels that count, and their levels (or what neighbours leave of them).
    clip : float
        A pixel at or above this says only that there is at least as much light.
    table : as of `profile_table`
    spot : (10,) float64
        Start; becomes the fit.
    scratch : (3, >= n) float32
        Is overwritten.

    Returns
    -------
    settled : bool
    odd : (4, 4) float64
        Normal equations of centre and slopes, for noise of variance 1.
    squares : float
        Sum of squared residuals; infinite where the pixels do not determine a spot.
    """
    odd, even = np.empty((4, 4)), np.empty((6, 6))
    odd_right, even_right, step = np.empty(4), np.empty(6), np.zeros(N_SPOT)
    last, last_squares = spot.copy(), np.inf
    share, settled = 1.0, False
    squares = 0.0
    n = len(x)
    for _ in range(MAX_STEPS):
        squares = _normal_equations(
            x, y, grey, clip, table, spot, scratch, odd, odd_right, even, even_right
        )
        if squares > last_squares * (1 + _WORSE):
            share *= 0.35
            _take_step(spot, last, step, share)
            continue
        gain = last_squares - squares
        for i in range(N_SPOT):
            last[i] = spot[i]
        last_squares, share = squares, 1.0
        noise2 = squares / max(n - N_SPOT, 1)
        even[5, 5] += noise2 / _SHARP_SD**2
        even_right[5] -= (spot[SHARP] - _SHARP_PRIOR) * noise2 / _SHARP_SD**2
        for i in range(6):
            even[i, i] *= 1 + _DAMPING
        slope_prior = noise2 / (_SLOPE_SD * spot[AMP]) ** 2
        odd[2, 2] += slope_prior
        odd[3, 3] += slope_prior
        right = odd_right.copy()
        if not (_solve(odd.copy(), right) and _solve(even, even_right)):
            return False, odd, np.inf
        step[CX], step[CY] = right[0], right[1]
        step[BX], step[BY] = right[2] - spot[BX], right[3] - spot[BY]
        step[BACK] = even_right[0]
        for i in range(1, 6):
            step[AMP - 1 + i] = even_right[i]
        if not np.isfinite(step.sum()):
            return False, odd, np.inf
        _take_step(spot, last, step, 1.0)
        moved = np.hypot(step[CX], step[CY])
        noisy_px2 = noise2 / (odd[0, 0] + odd[1, 1])
        if moved**2 < max(_DONE_PX**2, _DONE_SD**2 * noisy_px2) and gain < _GAIN_DONE * squares:
            settled = True
            break
    return settled, odd, squares


@njit(cache=True, nogil=True, error_model="numpy")
def centre_variance(odd):  # type: ignore[no-untyped-def]
    """Variance of the centre (xx, xy, yy) for noise of variance 1: slopes are solved for too."""
    det = odd[2, 2] * odd[3, 3] - odd[2, 3] ** 2
    sxx, sxy, syy = odd[3, 3] / det, -odd[2, 3] / det, odd[2, 2] / det
    a, b, c, d = odd[0, 2], odd[0, 3], odd[1, 2], odd[1, 3]
    xx = odd[0, 0] - (a * a * sxx + 2 * a * b * sxy + b * b * syy)
    xy = odd[0, 1] - (a * c * sxx + (a * d + b * c) * sxy + b * d * syy)
    yy = odd[1, 1] - (c * c * sxx + 2 * c * d * sxy + d * d * syy)
    det = xx * yy - xy * xy
    return yy / det, -xy / det, xx / det


@njit(cache=True, nogil=True, error_model="numpy")
def _take_step(spot, last, step, share):  # type: ignore[no-untyped-def]
    """``spot = last + share · step``, shortened where it would leave what a spot can be."""
    trace = last[WXX] + last[WYY]
    reach = 0.7 / np.sqrt(trace)
    short = share * min(1.0, reach / max(np.hypot(step[CX], step[CY]), 1e-12))
    spot[CX] = last[CX] + short * step[CX]
    spot[CY] = last[CY] + short * step[CY]
    change = (abs(step[WXX]) + 2 * abs(step[WXY]) + abs(step[WYY])) / trace
    short = share * min(1.0, 0.5 / max(change, 1e-12))
    for i in range(BACK, N_SPOT):
        spot[i] = last[i] + short * step[i]
    while not (
        spot[WXX] > 0 and spot[WYY] > 0
        and spot[WXX] * spot[WYY] - spot[WXY] ** 2 > 1e-3 * spot[WXX] * spot[WYY]
    ):  # fmt: skip
        for i in range(WXX, SHARP):
            spot[i] = 0.5 * (spot[i] + last[i])
    spot[SHARP] = min(max(spot[SHARP], 0.0), _SHARP_MOST)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def model_of(x, y, table, spot, scratch):  # type: ignore[no-untyped-def]
    """Profile, slope by q and slope by sharpness at each pixel, into the rows of `scratch`.

    The lens blurs alike in all directions, so a slanted disc's edge is sharper along than across:
    by the blur over the length of the radius there, ``|W d| / √q``.
    """
    xx, xy, yy = np.float32(spot[WXX]), np.float32(spot[WXY]), np.float32(spot[WYY])
    cx, cy, whole = np.float32(spot[CX]), np.float32(spot[CY]), np.float32(1)
    soft = np.float32(max(1 - spot[SHARP], 1e-3))
    per_length = soft / np.sqrt(np.float32(0.5) * (xx + yy))
    half, tiny, none = np.float32(0.5), np.float32(1e-9), np.float32(0)
    most, by_soft = np.float32(_SHARP_MOST), whole / soft
    flat = table.reshape(-1)
    value, slope, by_sharp = scratch[0], scratch[1], scratch[2]
    for i in range(len(x)):  # two loops, and numbers without sign: so they become vector code
        dx, dy = x[i] - cx, y[i] - cy
        ux, uy = xx * dx + xy * dy, xy * dx + yy * dy
        q = dx * ux + dy * uy + tiny
        local = per_length * np.sqrt((ux * ux + uy * uy) / q)
        value[i] = min(max(whole - local, none), most) * _S_STEPS
        slope[i] = min(q * _Q_STEPS, _LAST_PLACE)
        by_sharp[i] = local * by_soft
    for i in range(len(x)):
        row_place, place = value[i], slope[i]
        row, column = np.uint32(row_place + half), np.uint32(place)
        row, column = min(row, _LAST_ROW), min(column, _LAST_COLUMN)
        ds = (row_place - np.float32(row)) * _S_STEP
        u = place - np.float32(column)
        k = np.uint64(row * _ROW_LENGTH + column)
        v, g, s = flat[k], flat[k + _TO_SLOPE], flat[k + _TO_SHARP]
        v += u * (flat[k + _NEXT] - v)
        s += u * (flat[k + _TO_SHARP + _NEXT] - s)
        value[i] = v + ds * s
        slope[i] = g + u * (flat[k + _TO_SLOPE + _NEXT] - g)
        by_sharp[i] = s * by_sharp[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _normal_equations(  # type: ignore[no-untyped-def]
    x, y, grey, clip, table, spot, scratch, odd, odd_right, even, even_right
):
    """Fill both blocks; the sum of squared residuals. Slopes are solved for whole, not as steps.

    One loop over numbers of 32 bits without branches, which compilers turn into vector code: it
    is where the time goes.
    """
    model_of(x, y, table, spot, scratch)
    profile, slope, by_sharp = scratch[0], scratch[1], scratch[2]
    cx, cy = np.float32(spot[CX]), np.float32(spot[CY])
    xx, xy, yy = np.float32(spot[WXX]), np.float32(spot[WXY]), np.float32(spot[WYY])
    back, bx, by = np.float32(spot[BACK]), np.float32(spot[BX]), np.float32(spot[BY])
    amp, top = np.float32(spot[AMP]), np.float32(clip)
    none, whole, two = np.float32(0), np.float32(1), np.float32(2)
    o0 = o1 = o2 = o3 = o4 = o5 = o6 = o7 = o8 = o9 = o10 = o11 = o12 = o13 = none
    e0 = e1 = e2 = e3 = e4 = e5 = e6 = e7 = e8 = e9 = e10 = e11 = e12 = e13 = none
    e14 = e15 = e16 = e17 = e18 = e19 = e20 = e21 = e22 = e23 = e24 = e25 = e26 = none
    squares = none
    for i in range(len(x)):
        dx, dy = x[i] - cx, y[i] - cy
        f, ag, g5 = profile[i], amp * slope[i], amp * by_sharp[i]
        level = back + amp * f + bx * dx + by * dy
        w = none if (grey[i] >= top) & (level >= top) else whole
        r = grey[i] - level
        r_slopes = r + bx * dx + by * dy  # what the slopes explain is left in
        wr = w * r
        squares += r * wr
        gx, gy = -two * ag * (xx * dx + xy * dy), -two * ag * (xy * dx + yy * dy)
        wgx, wgy, wx, wy = w * gx, w * gy, w * dx, w * dy
        o0 += wgx * gx
        o1 += wgx * gy
        o2 += wgx * dx
        o3 += wgx * dy
        o4 += wgy * gy
        o5 += wgy * dx
        o6 += wgy * dy
        o7 += wx * dx
        o8 += wx * dy
        o9 += wy * dy
        o10 += wgx * r_slopes
        o11 += wgy * r_slopes
        o12 += wx * r_slopes
        o13 += wy * r_slopes
        g2, g3, g4 = ag * dx * dx, two * ag * dx * dy, ag * dy * dy
        wf, w2, w3, w4, w5 = w * f, w * g2, w * g3, w * g4, w * g5
        e0 += w
        e1 += wf
        e2 += w2
        e3 += w3
        e4 += w4
        e5 += w5
        e6 += wf * f
        e7 += wf * g2
        e8 += wf * g3
        e9 += wf * g4
        e10 += wf * g5
        e11 += w2 * g2
        e12 += w2 * g3
        e13 += w2 * g4
        e14 += w2 * g5
        e15 += w3 * g3
        e16 += w3 * g4
        e17 += w3 * g5
        e18 += w4 * g4
        e19 += w4 * g5
        e20 += w5 * g5
        e21 += wr
        e22 += f * wr
        e23 += g2 * wr
        e24 += g3 * wr
        e25 += g4 * wr
        e26 += g5 * wr
    _fill(odd, (o0, o1, o2, o3, o4, o5, o6, o7, o8, o9))
    odd_right[0], odd_right[1], odd_right[2], odd_right[3] = o10, o11, o12, o13
    _fill(even, (e0, e1, e2, e3, e4, e5, e6, e7, e8, e9, e10, e11, e12, e13, e14, e15, e16, e17,
                 e18, e19, e20))  # fmt: skip
    even_right[0], even_right[1], even_right[2] = e21, e22, e23
    even_right[3], even_right[4], even_right[5] = e24, e25, e26
    return float(squares)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _fill(matrix, upper):  # type: ignore[no-untyped-def]
    """A symmetric matrix from its upper half, row by row."""
    k = 0
    for i in range(len(matrix)):
        for j in range(i, len(matrix)):
            matrix[i, j] = upper[k]
            matrix[j, i] = upper[k]
            k += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(a, b):  # type: ignore[no-untyped-def]
    """Cholesky in place; False unless positive definite."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                if not s > 1e-12 * abs(a[i, i]):
                    return False
                a[i, i] = np.sqrt(s)
            else:
                a[i, j] = s / a[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[k, i] * b[k]
        b[i] /= a[i, i]
    return True
