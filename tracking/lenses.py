"""Removing lens distortion from many points, fast.

`Camera.undistort` says what is right and serves any number of points at leisure; a tracker asks
for thirty at a time, thousands of times a second.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera

_STEPS = 30
_TOLERANCE = 1e-13  # normalised coordinates


def undistort(camera: Camera, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """What `Camera.undistort` gives, by Newton's method with exact derivatives, compiled.

    Parameters
    ----------
    camera : Camera
    pixels : (N, 2) float64, px

    Returns
    -------
    (N, 2) float64, dimensionless
        Ideal normalised coordinates; NaN where the distortion cannot be inverted.
    """
    if camera.distortion_model != "opencv" or not len(camera.distortion) or not len(pixels):
        return camera.undistort(pixels)
    k = np.zeros(12)
    k[: len(camera.distortion)] = camera.distortion
    return np.asarray(_undistort(camera.matrix, k, np.ascontiguousarray(pixels)), dtype=np.float64)


@njit(cache=True, nogil=True)
def _undistort(K, k, pixels):  # type: ignore[no-untyped-def]
    found = np.full(pixels.shape, np.nan)
    for n in range(len(pixels)):
        goal_y = (pixels[n, 1] - K[1, 2]) / K[1, 1]
        goal_x = (pixels[n, 0] - K[0, 2] - K[0, 1] * goal_y) / K[0, 0]
        x, y = goal_x, goal_y
        for _ in range(_STEPS):
            r2 = x * x + y * y
            top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
            bottom = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            radial = top / bottom
            d_top = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])
            d_bottom = k[5] + r2 * (2 * k[6] + 3 * r2 * k[7])
            slope = (d_top - radial * d_bottom) / bottom  # of `radial` with r²
            off_x = (
                x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
                + r2 * (k[8] + r2 * k[9]) - goal_x
            )  # fmt: skip
            off_y = (
                y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
                + r2 * (k[10] + r2 * k[11]) - goal_y
            )  # fmt: skip
            prism_x, prism_y = 2 * (k[8] + 2 * r2 * k[9]), 2 * (k[10] + 2 * r2 * k[11])
            xx = radial + 2 * x * x * slope + 2 * k[2] * y + 6 * k[3] * x + prism_x * x
            xy = 2 * x * y * slope + 2 * k[2] * x + 2 * k[3] * y + prism_x * y
            yx = 2 * x * y * slope + 2 * k[2] * x + 2 * k[3] * y + prism_y * x
            yy = radial + 2 * y * y * slope + 6 * k[2] * y + 2 * k[3] * x + prism_y * y
            det = xx * yy - xy * yx
            if not abs(det) > 1e-9:
                break
            step_x, step_y = (yy * off_x - xy * off_y) / det, (xx * off_y - yx * off_x) / det
            x, y = x - step_x, y - step_y
            if abs(step_x) < _TOLERANCE and abs(step_y) < _TOLERANCE:
                # past the radius at which distances stop growing is another, false solution
                if radial > 0 and xx > 0 and yy > 0 and det > 0:
                    found[n, 0], found[n, 1] = x, y
                break
    return found
