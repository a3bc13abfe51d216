"""Rays through the samples of a picture's pixels, and the pixels that need more of them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera

Floats = NDArray[np.float32]

#: Samples of an edge pixel, px from its centre: no two in one row or column.
EDGE_SAMPLES = np.array([(-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)])
_STRIP_ROWS = 128  # of rays made at once, to spare memory
_FORWARD = (0.0, 0.0, 1.0)


def all_directions(camera: Camera, n: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Rays through a camera's samples.

    Parameters
    ----------
    camera : Camera
    n : int
        Samples along each side of a pixel.

    Returns
    -------
    (n h, n w, 3) float32
        Unit directions, world axes.
    (n h, n w) bool
        Where the lens lets a ray through; not where it folds.
    """
    width, height = camera.image_size
    x = (np.arange(n * width) + 0.5) / n - 0.5
    y = (np.arange(n * height) + 0.5) / n - 0.5
    found = np.empty((n * height, n * width, 3), np.float32)
    known = np.empty(found.shape[:2], bool)
    for start in range(0, len(y), _STRIP_ROWS):
        rows = slice(start, start + _STRIP_ROWS)
        found[rows], known[rows] = _usable(camera.ray(np.stack(np.meshgrid(x, y[rows]), axis=-1)))
    return found, known


def edge_directions(
    camera: Camera, columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.bool_]]:
    """The same for `EDGE_SAMPLES` of some pixels: (N, 4, 3) and (N, 4)."""
    pixels = np.stack([columns, rows], axis=-1)[:, None, :] + EDGE_SAMPLES
    return _usable(camera.ray(pixels))


def _usable(directions: NDArray[np.float64]) -> tuple[Floats, NDArray[np.bool_]]:
    known: NDArray[np.bool_] = np.asarray(np.isfinite(directions).all(axis=-1))
    return np.where(known[..., None], directions, _FORWARD).astype(np.float32), known


@njit(cache=True)
def edge_pixels(triangle, part, distance, hidden, slope):  # type: ignore[no-untyped-def]
    """Pixels (h, w) bool beside which another part begins, or one lies `slope` times deeper."""
    height, width = triangle.shape
    found = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            f = triangle[y, x]
            if hidden[y, x] > 0:
                found[y, x] = True
            for step in range(2):
                j, i = y + step, x + 1 - step
                if j >= height or i >= width:
                    continue
                g = triangle[j, i]
                if f == g:
                    continue
                if f == 4294967295 or g == 4294967295:
                    other = True
                else:
                    near = min(distance[y, x], distance[j, i])
                    apart = abs(distance[y, x] - distance[j, i])
                    other = part[f] != part[g] or apart > slope * near
                if other:
                    found[y, x] = True
                    found[j, i] = True
    return found
