"""Sub-pixel centres of bright dots.

A dot is a connected component above a level half-way between skin and dot. Its centre is the
centroid of what exceeds the local background, a plane fitted to the ring around it, over the
component and a margin: every partly covered pixel counts in proportion to its coverage, so the
centroid of a disc is found without bias by the pixel grid, and a slope of the skin's shading does
not pull it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.errors import InputError

MARGIN_PX = 2  # grows a component to the faint pixels at a dot's edge
RING_PX = 3  # width of the ring beyond the margin that tells the background
_SD_LARGE_PX, _SD_SMALL, _SD_PER_SKEW, _MAX_SKEW = 0.025, 0.9, 0.3, 5.0
MAX_BLOBS = 4096  # in one picture; more is not a marker take
_LEVEL_SHARE = 0.38  # below one half: dots seen at a slant cover their pixels only in part


@dataclass(frozen=True)
class BlobSettings:
    """What counts as a dot.

    Attributes
    ----------
    level : float
        Grey level (luma) above which a pixel belongs to a dot.
    min_area_px, max_area_px : int
        Pixels above the level.
    """

    level: float
    min_area_px: int = 7
    max_area_px: int = 2500


@dataclass(frozen=True, eq=False)
class Blobs:
    """Dots in one picture.

    Attributes
    ----------
    centres : (N, 2) float64, px
    areas_px : (N,) float64
        Pixels above the level.
    contrast : (N,) float64
        Mean grey levels above the background.
    skewness : (N,) float64
        Length of the mean of z ‖z‖² over the whitened dot (Mardia's skewness vector): 0 for any
        ellipse, large where something hides a part of the dot and so pulls its centre.
    """

    centres: NDArray[np.float64]
    areas_px: NDArray[np.float64]
    contrast: NDArray[np.float64]
    skewness: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def sd_px(self) -> NDArray[np.float64]:
        """(N,) standard deviation to expect of each coordinate of a centre, px.

        Small dots are less certain; a skew dot is partly hidden, and its centre is off by a share
        of its radius. The constants were fitted on synthetic dots seen from 0 to 80° and hidden
        by 0 to 70 %; only their ratios matter to triangulation, which scales them by residuals.
        """
        radius = np.sqrt(self.areas_px / np.pi)
        hidden = _SD_PER_SKEW * radius * np.minimum(self.skewness, _MAX_SKEW)
        return np.asarray(np.sqrt(_SD_LARGE_PX**2 + (_SD_SMALL / self.areas_px) ** 2 + hidden**2))


def find_level(image: NDArray[np.uint8]) -> float:
    """A level that parts bright dots from everything else.

    Dots cover little of the picture, so the skin is taken as its 99th percentile (the dark room
    does not count) and the dots as the mean of the brightest 200 pixels; the level lies a little
    below half-way.

    Parameters
    ----------
    image : (h, w) uint8

    Raises
    ------
    InputError
        If nothing stands out: the two are less than 40 levels apart.
    """
    counts = np.bincount(image.ravel(), minlength=256)
    levels = np.arange(256)
    above = np.cumsum(counts[::-1])[::-1]
    skin = float(levels[above >= 0.01 * image.size].max())
    n_brightest = min(200, image.size)
    # of the level that reaches past them only a part counts: saturated dots share the top level
    brightest = np.clip(n_brightest - (above - counts), 0, counts)
    dots = float((brightest * levels).sum() / n_brightest)
    if dots - skin < 40:
        raise InputError(
            f"no bright dots: the brightest pixels (level {dots:.0f}) hardly exceed the rest "
            f"(level {skin:.0f})"
        )
    return skin + _LEVEL_SHARE * (dots - skin)


def find_blobs(image: NDArray[np.uint8], settings: BlobSettings) -> Blobs:
    """All dots of a picture.

    Parameters
    ----------
    image : (h, w) uint8
    settings : BlobSettings

    Raises
    ------
    InputError
        If there are more than 4096 components: the level is below the noise or the skin.
    """
    found, n = _find(
        image, settings.level, settings.min_area_px, settings.max_area_px, MARGIN_PX, RING_PX,
        MAX_BLOBS,
    )  # fmt: skip
    if n > MAX_BLOBS:
        raise InputError(
            f"more than {MAX_BLOBS} bright spots above level {settings.level:.0f}: "
            "are these bright markers on a darker face?"
        )
    return Blobs(found[:, :2], found[:, 2], found[:, 3], found[:, 4])


@njit(cache=True, nogil=True)
def _find(image, level, min_area, max_area, margin, ring, max_blobs):  # type: ignore[no-untyped-def]
    h, w = image.shape
    label = np.zeros((h, w), np.int32)
    found = np.empty((max_blobs, 5))
    boxes = np.empty((max_blobs, 4), np.int64)
    areas = np.empty(max_blobs)
    stack = np.empty(h * w, np.int64)
    n = 0
    for y in range(h):
        for x in range(w):
            if image[y, x] <= level or label[y, x]:
                continue
            if n == max_blobs:
                return found[:0], max_blobs + 1
            n += 1
            label[y, x] = n
            stack[0] = y * w + x
            top, area = 1, 0
            x0, y0, x1, y1 = x, y, x, y
            while top:
                top -= 1
                py, px = stack[top] // w, stack[top] % w
                area += 1
                x0, x1, y0, y1 = min(x0, px), max(x1, px), min(y0, py), max(y1, py)
                for ny in range(max(py - 1, 0), min(py + 2, h)):
                    for nx in range(max(px - 1, 0), min(px + 2, w)):
                        if label[ny, nx] == 0 and image[ny, nx] > level:
                            label[ny, nx] = n
                            stack[top] = ny * w + nx
                            top += 1
            boxes[n - 1, 0], boxes[n - 1, 1], boxes[n - 1, 2], boxes[n - 1, 3] = x0, y0, x1, y1
            areas[n - 1] = area
    k = 0
    for i in range(n):
        if areas[i] < min_area or areas[i] > max_area:
            continue
        x0, y0, x1, y1 = boxes[i]
        reach = margin + ring
        if x0 < reach or y0 < reach or x1 >= w - reach or y1 >= h - reach:
            continue  # cut by the border: its centroid would be wrong
        cx, cy, contrast, skew = _centre(image, label, i + 1, x0, y0, x1, y1, margin, ring)
        if np.isfinite(cx):
            found[k, 0], found[k, 1], found[k, 2], found[k, 3] = cx, cy, areas[i], contrast
            found[k, 4] = skew
            k += 1
    return found[:k], n


@njit(cache=True, nogil=True)
def _centre(image, label, own, x0, y0, x1, y1, margin, ring):  # type: ignore[no-untyped-def]
    """Centroid above a background plane, of the pixels within `margin` of component `own`."""
    reach = margin + ring
    height, width = y1 - y0 + 1 + 2 * reach, x1 - x0 + 1 + 2 * reach
    # 0 unused, 1 the dot and its margin, 2 background ring, 3 another dot's
    kind = np.zeros((height, width), np.int8)
    for j in range(height):
        for i in range(width):
            y, x = y0 - reach + j, x0 - reach + i
            near_own, near_other = reach + 1.0, reach + 1.0
            for v in range(max(y - reach, 0), min(y + reach + 1, image.shape[0])):
                for u in range(max(x - reach, 0), min(x + reach + 1, image.shape[1])):
                    if label[v, u]:
                        d = np.sqrt((u - x) ** 2 + (v - y) ** 2)
                        if label[v, u] == own:
                            near_own = min(near_own, d)
                        else:
                            near_other = min(near_other, d)
            if near_own <= margin and near_own < near_other:
                kind[j, i] = 1
            elif near_own <= reach and near_other > margin:
                kind[j, i] = 2
    # background plane a + b x + c y over the ring, by normal equations
    s = np.zeros((3, 3))
    r = np.zeros(3)
    mx, my = (width - 1) / 2, (height - 1) / 2
    count = 0
    for j in range(height):
        for i in range(width):
            if kind[j, i] == 2:
                g = image[y0 - reach + j, x0 - reach + i]
                p = np.array([1.0, i - mx, j - my])
                for a in range(3):
                    r[a] += p[a] * g
                    for b in range(3):
                        s[a, b] += p[a] * p[b]
                count += 1
    plane = np.zeros(3)
    if count >= 12 and abs(np.linalg.det(s)) > 1e-6:
        plane[:] = np.linalg.solve(s, r)
    elif count:
        plane[0] = r[0] / count
    weight = np.zeros((height, width))
    sw, sx, sy, n = 0.0, 0.0, 0.0, 0
    for j in range(height):
        for i in range(width):
            if kind[j, i] == 1:
                g = image[y0 - reach + j, x0 - reach + i]
                wgt = g - plane[0] - plane[1] * (i - mx) - plane[2] * (j - my)
                weight[j, i] = wgt
                sw += wgt
                sx += wgt * i
                sy += wgt * j
                n += 1
    if sw <= 0:
        return np.nan, np.nan, np.nan, np.nan
    cx, cy = sx / sw, sy / sw
    xx, xy, yy = 0.0, 0.0, 0.0
    for j in range(height):
        for i in range(width):
            dx, dy = i - cx, j - cy
            xx += weight[j, i] * dx * dx
            xy += weight[j, i] * dx * dy
            yy += weight[j, i] * dy * dy
    xx, xy, yy = xx / sw, xy / sw, yy / sw
    det = xx * yy - xy * xy
    if xx <= 0 or yy <= 0 or det <= 0:  # noise: not the shape of a dot
        return x0 - reach + cx, y0 - reach + cy, sw / n, np.inf
    # whiten with the inverse Cholesky factor, then the length of the vector E[z (z.z)]
    a = 1 / np.sqrt(xx)
    c = np.sqrt(xx / det)
    b = -xy / xx * c
    skew_x, skew_y = 0.0, 0.0
    for j in range(height):
        for i in range(width):
            dx, dy = i - cx, j - cy
            u, v = a * dx, b * dx + c * dy
            q = weight[j, i] * (u * u + v * v)
            skew_x += q * u
            skew_y += q * v
    return x0 - reach + cx, y0 - reach + cy, sw / n, np.hypot(skew_x, skew_y) / sw
