"""How much of each pixel a shape covers: exact areas of polygons, and their blur before sampling.

A polygon's share of a pixel is its exact area there (each edge adds what lies to its right, and a
running sum over the row gives the shares), so a shape of many polygons (instants of an exposure,
unhidden tiles) is one sum. What blurs a picture does so before pixels sample it: shares are first
taken on a grid that is finer than the shape, spread by the blur of the lens there, and only then
gathered into pixels. Blurring pixels instead would keep what sampling has done to the centre: for
a disc of radius r pixels, an error of up to 0.03 r^-1.5 px.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: Fine pixels across the half extent of a shape, and the most of them in a pixel.
_FINE_PER_EXTENT, _MAX_FINE = 4.0, 12
_PSF_REACH = 4.5  # standard deviations
_LEAST_PSF_PX = 0.02
_LEAST_DEFOCUS_PX = 0.05
MAX_PATCH_PX = 600  # nothing larger than this is a marker


def paint_polygons(
    level: NDArray[np.float32],
    under: NDArray[np.float32],
    free: NDArray[np.float32],
    polygons: NDArray[np.float64],
    weights: NDArray[np.float64],
    light: float,
    *,
    psf_px: float = 0.0,
    defocus_px: float = 0.0,
) -> float:
    """Lay a shape of light over a picture.

    Parameters
    ----------
    level : (h, w) float32, linear light
        Changed: gains share · (light - under) in each pixel, as far as there is room.
    under : (h, w) float32
        The picture without any shape, so that shapes side by side add up.
    free : (h, w) float32
        Share of each pixel that no shape has taken yet: changed. Shapes come nearest first.
    polygons : (K, P, 2) float64, px
        Either sense of rotation. Pixel (0, 0) is centred on (0, 0).
    weights : (K,) float64
        Share of the light that comes through each polygon.
    light : float
    psf_px : float, px
        Standard deviation of the lens's Gaussian blur.
    defocus_px : float, px
        Diameter of the circle of confusion.

    Returns
    -------
    float, px
        Area that fell within the picture, in pixels, whether it was free or not.
    """
    if not len(polygons) or not np.isfinite(polygons).all():
        return 0.0
    return float(_paint(level, under, free, polygons, weights, light, psf_px, defocus_px))


@njit(cache=True, nogil=True)
def _paint(  # type: ignore[no-untyped-def]
    level, under, free, polygons, weights, light, psf, defocus
):
    h, w = level.shape
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(polygons)):
        for p in range(polygons.shape[1]):
            x0, x1 = min(x0, polygons[k, p, 0]), max(x1, polygons[k, p, 0])
            y0, y1 = min(y0, polygons[k, p, 1]), max(y1, polygons[k, p, 1])
    soft = psf > _LEAST_PSF_PX
    wide = defocus > _LEAST_DEFOCUS_PX
    reach = 1.0 + (psf * _PSF_REACH + 0.5 if soft else 0.0) + (defocus / 2 + 0.5 if wide else 0.0)
    left, top = math.floor(x0 - reach + 0.5), math.floor(y0 - reach + 0.5)
    right, bottom = math.ceil(x1 + reach - 0.5), math.ceil(y1 + reach - 0.5)
    if right < 0 or bottom < 0 or left >= w or top >= h:
        return 0.0
    if right - left >= MAX_PATCH_PX or bottom - top >= MAX_PATCH_PX:
        return 0.0
    n = 1
    if soft or wide:
        extent = min(x1 - x0, y1 - y0) / 2
        n = int(min(max(math.ceil(_FINE_PER_EXTENT / max(extent, 1e-3)), 2), _MAX_FINE))
    fine = _fine_shares(polygons, weights, left, top, right - left + 1, bottom - top + 1, n)
    if wide:
        fine = _spread(fine, _disc(defocus * n / 2))
    if soft:  # fine pixels, and those of the disc, have blurred by their own squares
        psf = math.sqrt(max(psf * psf - (2.0 if wide else 1.0) / (12.0 * n * n), 1e-4))
    share = _gathered(fine, n, psf if soft else 0.0)
    total = 0.0
    for j in range(share.shape[0]):
        y = top + j
        if y < 0 or y >= h:
            continue
        for i in range(share.shape[1]):
            x = left + i
            if 0 <= x < w:
                taken = min(share[j, i], free[y, x])
                free[y, x] -= taken
                level[y, x] += taken * (light - under[y, x])
                total += share[j, i]
    return total


@njit(cache=True, nogil=True)
def _fine_shares(polygons, weights, left, top, width, height, n):  # type: ignore[no-untyped-def]
    """Shares of the fine pixels of a patch whose top-left pixel is (left, top)."""
    sums = np.zeros((height * n, width * n + 2))
    for k in range(len(polygons)):
        corners = polygons[k]
        area = 0.0
        for p in range(len(corners)):
            q = p + 1 if p + 1 < len(corners) else 0
            area += (corners[p, 0] - corners[0, 0]) * (corners[q, 1] - corners[0, 1])
            area -= (corners[q, 0] - corners[0, 0]) * (corners[p, 1] - corners[0, 1])
        if area == 0.0:
            continue
        weight = weights[k] if area < 0 else -weights[k]  # rows grow downwards
        for p in range(len(corners)):
            q = p + 1 if p + 1 < len(corners) else 0
            _add_edge(
                sums,
                (corners[p, 0] + 0.5 - left) * n,
                (corners[p, 1] + 0.5 - top) * n,
                (corners[q, 0] + 0.5 - left) * n,
                (corners[q, 1] + 0.5 - top) * n,
                weight,
            )
    for j in range(sums.shape[0]):
        running = 0.0
        for i in range(sums.shape[1]):
            running += sums[j, i]
            sums[j, i] = running
    return sums[:, :-2]


@njit(cache=True, nogil=True)
def _add_edge(sums, x0, y0, x1, y1, weight):  # type: ignore[no-untyped-def]
    """Differences along rows of the area to the right of an edge."""
    if y0 == y1:
        return
    if y0 > y1:
        x0, y0, x1, y1, weight = x1, y1, x0, y0, -weight
    slope = (x1 - x0) / (y1 - y0)
    x = x0
    for row in range(int(y0), math.ceil(y1)):
        a, b = max(y0, float(row)), min(y1, row + 1.0)
        dy = b - a
        if dy <= 0:
            continue
        x_end = x0 + slope * (b - y0)
        low, high = min(x, x_end), max(x, x_end)
        first, last = int(low), math.ceil(high) - 1
        d = weight * dy
        if last <= first:
            inside = d * (first + 1 - (low + high) / 2)
            sums[row, first] += inside
            sums[row, first + 1] += d - inside
        else:
            per_px = d / (high - low)
            before = 0.0  # area to the right of the edge within the pixels so far
            for i in range(first, last + 1):
                u, v = max(low, float(i)), min(high, i + 1.0)
                # the edge crosses pixel i from u to v; to its left lies what entered before
                entered = per_px * (u - low)
                inside = entered + per_px * (v - u) * (i + 1 - (u + v) / 2)
                sums[row, i] += inside - before
                before = inside
            sums[row, last + 1] += d - before
        x = x_end


@njit(cache=True, nogil=True)
def _disc(radius):  # type: ignore[no-untyped-def]
    """A disc as shares of fine pixels, which sum to 1; its middle is a pixel's centre."""
    reach = math.ceil(radius + 0.5)
    n = 64
    circle = np.empty((1, n, 2))
    grown = radius * math.sqrt(2 * math.pi / n / math.sin(2 * math.pi / n))
    for p in range(n):
        circle[0, p, 0] = grown * math.cos(2 * math.pi * (p + 0.5) / n)
        circle[0, p, 1] = grown * math.sin(2 * math.pi * (p + 0.5) / n)
    size = 2 * reach + 3
    found = _fine_shares(circle, np.ones(1), -reach - 1, -reach - 1, size, size, 1)
    return found / found.sum()


@njit(cache=True, nogil=True)
def _spread(fine, kernel):  # type: ignore[no-untyped-def]
    found = np.zeros_like(fine)
    reach = kernel.shape[0] // 2
    h, w = fine.shape
    for y in range(h):
        for x in range(w):
            value = fine[y, x]
            if value == 0.0:
                continue
            for j in range(max(0, reach - y), min(kernel.shape[0], h + reach - y)):
                for i in range(max(0, reach - x), min(kernel.shape[1], w + reach - x)):
                    found[y + j - reach, x + i - reach] += value * kernel[j, i]
    return found


@njit(cache=True, nogil=True)
def _gathered(fine, n, psf):  # type: ignore[no-untyped-def]
    """Pixels from fine pixels: a Gaussian blur, then the mean over each pixel's square."""
    if n == 1:
        return fine
    height, width = fine.shape[0] // n, fine.shape[1] // n
    reach = math.ceil(psf * _PSF_REACH + 0.5) if psf > 0 else 0
    taps = 2 * reach + 1
    kernel = np.zeros((n, taps))  # of a fine pixel in each place within its pixel
    for phase in range(n):
        place = (phase + 0.5) / n - 0.5
        for t in range(taps):
            d = t - reach - place
            if psf > 0:
                s = psf * math.sqrt(2.0)
                kernel[phase, t] = (math.erf((d + 0.5) / s) - math.erf((d - 0.5) / s)) / 2 / n
            else:
                kernel[phase, t] = 1.0 / n
    rows = np.zeros((height, fine.shape[1]))
    for j in range(fine.shape[0]):
        y, phase = j // n, j % n
        for t in range(max(0, reach - y), min(taps, height + reach - y)):
            k = kernel[phase, t]
            for i in range(fine.shape[1]):
                rows[y + t - reach, i] += k * fine[j, i]
    found = np.zeros((height, width))
    for i in range(fine.shape[1]):
        x, phase = i // n, i % n
        for t in range(max(0, reach - x), min(taps, width + reach - x)):
            k = kernel[phase, t]
            for y in range(height):
                found[y, x + t - reach] += k * rows[y, i]
    return found


@njit(cache=True, nogil=True)
def polygon_moments(polygons):  # type: ignore[no-untyped-def]
    """Area, centroid and covariance of the sum of polygons, by Green's theorem.

    Parameters
    ----------
    polygons : (K, P, 2) float64, px

    Returns
    -------
    (6,) float64
        Mean area (px²), centroid x and y (px), and the covariance xx, xy, yy (px²) of the light
        that falls through all of them for equal times. NaN for no area.
    """
    ox, oy = polygons[0, 0, 0], polygons[0, 0, 1]
    s = np.zeros(6)
    for k in range(len(polygons)):
        part = np.zeros(6)
        for p in range(polygons.shape[1]):
            q = p + 1 if p + 1 < polygons.shape[1] else 0
            x0, y0 = polygons[k, p, 0] - ox, polygons[k, p, 1] - oy
            x1, y1 = polygons[k, q, 0] - ox, polygons[k, q, 1] - oy
            cross = x0 * y1 - x1 * y0
            part[0] += cross / 2
            part[1] += cross * (x0 + x1) / 6
            part[2] += cross * (y0 + y1) / 6
            part[3] += cross * (x0 * x0 + x0 * x1 + x1 * x1) / 12
            part[4] += cross * (2 * x0 * y0 + x0 * y1 + x1 * y0 + 2 * x1 * y1) / 24
            part[5] += cross * (y0 * y0 + y0 * y1 + y1 * y1) / 12
        s += part if part[0] > 0 else -part
    found = np.full(6, np.nan)
    if not s[0] > 0:
        return found
    cx, cy = s[1] / s[0], s[2] / s[0]
    found[0] = s[0] / len(polygons)
    found[1], found[2] = ox + cx, oy + cy
    found[3] = s[3] / s[0] - cx * cx
    found[4] = s[4] / s[0] - cx * cy
    found[5] = s[5] / s[0] - cy * cy
    return found
