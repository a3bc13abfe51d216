"""All spots of a picture: components that may be markers, and where their fits start."""

from __future__ import annotations

import numpy as np
from numba import njit

from .spot_fit import AMP, BACK, CX, CY, N_SPOT, SHARP, WXX, WXY, WYY
from .spot_parting import MAX_PARTS, is_inside, is_poor, parted
from .spot_scan import AREA, PEAK, SUM, X0, X1, XX, XY, Y0, Y1, YY
from .spot_scan import CX as MIDDLE_X
from .spot_scan import CY as MIDDLE_Y
from .spot_windows import COMPONENT, MAX_HALF_PX, N_COLUMNS, S_AREA, fit_one

_EDGE_PX = 2  # a component nearer to the border is cut by it
_TELLING_AREA = 8.0  # and 3 pixels above the level; how evenly fewer are filled tells no sharpness
# beyond a component's edge: its background, to begin with, from so many places
_RING_PX, _RING_PLACES = 3.0, 20
_MANY = 8  # components whose median area tells that of a marker


@njit(cache=True, nogil=True, error_model="numpy")
def fit_components(image, components, level, min_area, max_area, clip, table):  # type: ignore[no-untyped-def]
    """Fit a spot to every component of a marker's size that the border does not cut.

    Markers that touch are parted. Returns (n, N_COLUMNS) spots.
    """
    n = len(components)
    scratch = np.empty((6, (2 * MAX_HALF_PX + 1) ** 2), np.float32)
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
        if not is_inside(c, out):  # fitted to something beside it
            continue
        out[S_AREA], out[COMPONENT] = c[AREA], i
        if c[AREA] >= large and is_poor(found[m : m + 1]):
            m += parted(image, c, others, level, clip, table, scratch, found[m : m + MAX_PARTS])
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
    return n
