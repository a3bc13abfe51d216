"""Where four squares meet, to a few hundredths of a pixel: least squares on the picture itself.

Around a corner the picture is two blurred edges that cross. All pixels up to some way to the next
corner tell of it, so a model of the crossing is fitted to them: place, two directions, two blurs,
dark and bright level, and how the light falls off. The edges' bend, which the lens makes, is known
from the other corners and held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .board_map import BoardMap

Floats = NDArray[np.float64]
#: How far the window reaches, of the way to the next corner; at 0.5 it is half way.
REACH = 0.42
_N = 10  # cx, cy, angle 1, angle 2, blur 1, blur 2, dark + bright, bright - dark, light x, light y
_STEPS = 15
_TURNS = 4
_SETTLED_PX = 1e-3  # a twentieth of what the best pictures allow
_LEAST_BLUR_PX = 0.25
_MIN_PIXELS = 30
_LEAST_RADIUS_PX = 2.5
_MOST_RADIUS_PX = 40.0  # beyond it more pixels tell nothing new and cost time


@dataclass(frozen=True, eq=False)
class Saddles:
    """Corners as fitted.

    Attributes
    ----------
    centres : (N, 2) float64, px
        NaN where nothing like a corner was found within the window.
    sd_px : (N,) float64, px
        Standard deviation of a coordinate, from what the fit left over.
    blur_px : (N, 2) float64, px
        Standard deviation of the blur across the edge along the board's x, and across that
        along y.
    contrast : (N,) float64, grey levels
        Half of bright less dark; positive where the square to the upper left (towards smaller x
        and y of the board) and its opposite are bright.
    misfit : (N,) float64
        RMS of what was left over, of the contrast.
    """

    centres: Floats
    sd_px: Floats
    blur_px: Floats
    contrast: Floats
    misfit: Floats


def refine_saddles(
    image: NDArray[np.uint8],
    centres: Floats,
    points: Floats,
    board_map: BoardMap,
    *,
    step: float,
    reach: float = REACH,
    inset: float = 1.0,
) -> Saddles:
    """Fit crossings of two edges near given places.

    Parameters
    ----------
    image : (h, w) uint8
    centres : (N, 2) float, px
        Where to start, right to about a third of a square.
    points : (N, 2) float, mm, board frame
    board_map : BoardMap
        For directions, sizes and bends.
    step : float, mm
        Side of a square.
    reach : float
        Half the window, in squares.
    inset : float
        Pixels that are this far, in squares, from both edges are left out: a ChArUco marker's.

    Returns
    -------
    Saddles
    """
    along_x, along_y, bend_x, bend_y = board_map.axes(points, step)
    n = len(centres)
    found = np.full((n, _N), np.nan)
    quality = np.full((n, 2), np.nan)
    _fit_all(
        np.ascontiguousarray(image), np.ascontiguousarray(centres, dtype=np.float64),
        along_x, along_y, bend_x, bend_y, reach, inset, found, quality,
    )  # fmt: skip
    return Saddles(found[:, :2], quality[:, 0], found[:, 4:6], found[:, 7], quality[:, 1])


@njit(cache=True, nogil=True)
def _fit_all(  # type: ignore[no-untyped-def]
    image, centres, along_x, along_y, bend_x, bend_y, reach, inset, found, quality
):
    for i in range(len(centres)):
        size = min(np.hypot(along_x[i, 0], along_x[i, 1]), np.hypot(along_y[i, 0], along_y[i, 1]))
        if not size > 1.0 or not np.isfinite(centres[i, 0] + centres[i, 1] + size):
            continue
        # small squares: the smallest window that still holds a corner; large: no larger than useful
        share = max(reach, min(_LEAST_RADIUS_PX / size, 0.5))
        share = min(share, _MOST_RADIUS_PX / size)
        _fit_one(
            image, centres[i], along_x[i], along_y[i], bend_x[i], bend_y[i], share, inset,
            found[i], quality[i],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _gather(image, centre, ex, ey, reach, inset, xs, ys, values):  # type: ignore[no-untyped-def]
    """Pixels within the window, relative to `centre`; their number, -1 if it leaves the picture.

    The window is a parallelogram around the centre, so that what the model does not know acts on
    both sides alike.
    """
    h, w = image.shape
    det = ex[0] * ey[1] - ex[1] * ey[0]
    half_x = reach * (abs(ex[0]) + abs(ey[0]))
    half_y = reach * (abs(ex[1]) + abs(ey[1]))
    x0, x1 = int(np.ceil(centre[0] - half_x)), int(np.floor(centre[0] + half_x))
    y0, y1 = int(np.ceil(centre[1] - half_y)), int(np.floor(centre[1] + half_y))
    if x1 < 0 or y1 < 0 or x0 >= w or y0 >= h:
        return -1
    count, missing = 0, 0
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            dx, dy = x - centre[0], y - centre[1]
            u = (dx * ey[1] - dy * ey[0]) / det
            v = (dy * ex[0] - dx * ex[1]) / det
            if abs(u) > reach or abs(v) > reach or (abs(u) > inset and abs(v) > inset):
                continue
            if x < 0 or y < 0 or x >= w or y >= h:
                missing += 1
                continue
            if count < len(xs):
                xs[count], ys[count], values[count] = dx, dy, image[y, x]
                count += 1
    return count if missing < 0.3 * (count + missing) else -1


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _model(p, dx, dy, bend_x, bend_y, grad):  # type: ignore[no-untyped-def]
    """Grey level at (dx, dy) from the window's first centre, and its derivatives."""
    x, y = dx - p[0], dy - p[1]
    c1, s1 = math.cos(p[2]), math.sin(p[2])
    c2, s2 = math.cos(p[3]), math.sin(p[3])
    along1, along2 = c1 * x + s1 * y, c2 * x + s2 * y
    # signed distances from the edge along the board's x and from that along its y
    d1 = -s1 * x + c1 * y - 0.5 * bend_x * along1 * along1
    d2 = s2 * x - c2 * y + 0.5 * bend_y * along2 * along2
    r1, r2 = d1 / p[4], d2 / p[5]
    E1, E2 = math.erf(r1 / math.sqrt(2.0)), math.erf(r2 / math.sqrt(2.0))
    g1 = math.sqrt(2 / math.pi) * math.exp(-0.5 * r1 * r1)
    g2 = math.sqrt(2 / math.pi) * math.exp(-0.5 * r2 * r2)
    pattern = p[6] + p[7] * E1 * E2
    light = 1 + p[8] * x + p[9] * y
    by1 = light * p[7] * g1 * E2 / p[4]  # by d1
    by2 = light * p[7] * E1 * g2 / p[5]
    d1x, d1y = -s1 - bend_x * along1 * c1, c1 - bend_x * along1 * s1
    d2x, d2y = s2 + bend_y * along2 * c2, -c2 + bend_y * along2 * s2
    grad[0] = -(by1 * d1x + by2 * d2x) - pattern * p[8]
    grad[1] = -(by1 * d1y + by2 * d2y) - pattern * p[9]
    across1, across2 = -s1 * x + c1 * y, -s2 * x + c2 * y
    grad[2] = by1 * (-along1 - bend_x * along1 * across1)
    grad[3] = by2 * (along2 + bend_y * along2 * across2)
    grad[4], grad[5] = -by1 * r1, -by2 * r2
    grad[6], grad[7] = light, light * E1 * E2
    grad[8], grad[9] = pattern * x, pattern * y
    return light * pattern


@njit(cache=True, nogil=True, fastmath=True)
def _normal_equations(p, n, xs, ys, values, bend_x, bend_y, A, b):  # type: ignore[no-untyped-def]
    """Fills A = JᵀJ and b = Jᵀr; the sum of squares."""
    grad = np.empty(_N)
    A[:], b[:], total = 0.0, 0.0, 0.0
    for k in range(n):
        r = values[k] - _model(p, xs[k], ys[k], bend_x, bend_y, grad)
        total += r * r
        for i in range(_N):
            b[i] += grad[i] * r
            for j in range(i, _N):
                A[i, j] += grad[i] * grad[j]
    for i in range(_N):
        for j in range(i):
            A[i, j] = A[j, i]
    return total


@njit(cache=True, nogil=True)
def _start(p, n, xs, ys, values, ex, ey):  # type: ignore[no-untyped-def]
    """Directions from the board's map; levels from the quarters of the window."""
    p[:] = 0.0
    p[2], p[3] = math.atan2(ex[1], ex[0]), math.atan2(ey[1], ey[0])
    p[4] = p[5] = 0.8
    det = ex[0] * ey[1] - ex[1] * ey[0]
    same, other, n_same, n_other = 0.0, 0.0, 0, 0
    for k in range(n):
        u = (xs[k] * ey[1] - ys[k] * ey[0]) / det
        v = (ys[k] * ex[0] - xs[k] * ex[1]) / det
        if u * v > 0:
            same += values[k]
            n_same += 1
        else:
            other += values[k]
            n_other += 1
    if n_same and n_other:
        p[6] = (same / n_same + other / n_other) / 2
        p[7] = (same / n_same - other / n_other) / 2


@njit(cache=True, nogil=True)
def _fit_one(  # type: ignore[no-untyped-def]
    image, centre, ex, ey, bend_x, bend_y, reach, inset, found, quality
):
    """Levenberg-Marquardt; once settled, once more with the window around what was found."""
    size = min(np.hypot(ex[0], ex[1]), np.hypot(ey[0], ey[1]))
    room = int((2 * reach * (abs(ex[0]) + abs(ey[0])) + 3)
               * (2 * reach * (abs(ex[1]) + abs(ey[1])) + 3))  # fmt: skip
    xs, ys, values = np.empty(room), np.empty(room), np.empty(room)
    p, trial, here = np.zeros(_N), np.empty(_N), centre.copy()
    A, b, A2, b2 = np.empty((_N, _N)), np.empty(_N), np.empty((_N, _N)), np.empty(_N)
    for turn in range(_TURNS):
        # a first fit in a small window is cheap and brings the rest near
        part = 0.6 * reach if turn == 0 and reach * size > 8 else reach
        n = _gather(image, here, ex, ey, part, inset, xs, ys, values)
        if n < _MIN_PIXELS // (1 if inset >= 1 else 2):
            return
        if turn == 0:
            _start(p, n, xs, ys, values, ex, ey)
            if abs(p[7]) < 1.0:
                return
        cost = _normal_equations(p, n, xs, ys, values, bend_x, bend_y, A, b)
        damping = 1e-2 if turn == 0 else 1e-6
        for _ in range(_STEPS):
            M = A.copy()
            for i in range(_N):
                M[i, i] = A[i, i] * (1 + damping) + 1e-12
            step = np.linalg.solve(M, b)
            trial[:] = p + step
            trial[4] = max(abs(trial[4]), _LEAST_BLUR_PX)
            trial[5] = max(abs(trial[5]), _LEAST_BLUR_PX)
            if np.hypot(trial[0], trial[1]) > 0.5 * size or not np.isfinite(trial.sum()):
                damping *= 10
                if damping > 1e8:
                    return
                continue
            lower = _normal_equations(trial, n, xs, ys, values, bend_x, bend_y, A2, b2)
            if lower <= cost:
                moved = max(abs(trial[0] - p[0]), abs(trial[1] - p[1]))
                gain = cost - lower
                p[:], A[:], b[:], cost = trial, A2, b2, lower
                damping = max(damping * 0.2, 1e-9)
                if moved < _SETTLED_PX and gain <= 1e-3 * cost:
                    break
            else:
                damping *= 6
                if damping > 1e8:
                    break
        shift = np.hypot(p[0], p[1])
        here = here + p[:2]
        p[0] = p[1] = 0.0
        if np.hypot(here[0] - centre[0], here[1] - centre[1]) > 0.5 * size:
            return
        if shift < 0.25 and part == reach:
            break
    for i in range(_N):
        A[i, i] *= 1 + 1e-10
    cov = np.linalg.inv(A)
    noise2 = cost / max(n - _N, 1)
    found[:] = p
    found[:2] = here
    quality[0] = math.sqrt(max(noise2 * (cov[0, 0] + cov[1, 1]) / 2, 0.0))
    quality[1] = math.sqrt(cost / n) / max(abs(p[7]), 1e-9)
