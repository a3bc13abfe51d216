"""Projection with exact derivatives: one compiled function for every calibration.

Intrinsics are one row of 16 numbers: fx fy cx cy, then OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3
s4; or, for Tsai's model, κ1 in the place of k1 and zeros after it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.rigid import Rigid

N_INTRINSICS = 16
INTRINSIC_NAMES = (
    "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4",
)  # fmt: skip
OPENCV, TSAI = 0, 1
_NEWTON_STEPS = 40


def intrinsics_of(camera: Camera) -> tuple[NDArray[np.float64], int]:
    """A camera's intrinsics as a row of 16, and which model they belong to."""
    found = np.zeros(N_INTRINSICS)
    K = camera.matrix
    if K[0, 1]:
        raise ValueError("a camera with skew cannot be calibrated")
    found[:4] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    found[4 : 4 + len(camera.distortion)] = camera.distortion
    return found, TSAI if camera.distortion_model == "tsai" else OPENCV


def camera_of(
    row: NDArray[np.float64], model: int, image_size: tuple[int, int], pose: Rigid
) -> Camera:
    """The camera of a row of 16 intrinsics; with no more coefficients than it needs."""
    K = np.array([[row[0], 0, row[2]], [0, row[1], row[3]], [0, 0, 1.0]])
    if model == TSAI:
        return Camera(image_size, K, pose, "tsai", row[4:5])
    used = np.flatnonzero(row[4:])
    n = next(n for n in (0, 5, 8, 12) if not len(used) or used[-1] < n) if len(used) else 0
    return Camera(image_size, K, pose, "opencv" if n else "none", row[4 : 4 + n])


def selection(
    tied: Mapping[str, Mapping[str, float]],
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Which intrinsics are estimated, as names and a (16, K) matrix: Δrow = matrix @ Δparameters.

    Parameters
    ----------
    tied : mapping from parameter name to the intrinsics that move with it
        ``{"f": {"fx": 1.0, "fy": 1.0}}`` is one focal length for both axes.
    """
    matrix = np.zeros((N_INTRINSICS, len(tied)))
    for column, moves in enumerate(tied.values()):
        for name, amount in moves.items():
            matrix[INTRINSIC_NAMES.index(name), column] = amount
    return tuple(tied), matrix


@njit(cache=True, nogil=True)
def project_one(row, model, x, y, z, uv, J_row, J_point):  # type: ignore[no-untyped-def]
    """Pixel of a point in the camera frame, into `uv` (2,), with its derivatives.

    `J_row` (2, 16) is by the intrinsics, `J_point` (2, 3) by the point. False where the point is
    not in front of the camera, or Tsai's equation has no solution.

    References
    ----------
    OpenCV documentation, projectPoints; Tsai 1987, eq. 5.
    """
    if not z > 1e-9:
        return False
    a, b = x / z, y / z
    J_row[:] = 0.0
    if model == 1:
        kappa = row[4]
        r_u = np.sqrt(a * a + b * b)
        if kappa < 0 and r_u >= 2 / 3 / np.sqrt(-3 * kappa):
            return False
        r_d = r_u
        for _ in range(_NEWTON_STEPS):
            step = (r_d * (1 + kappa * r_d * r_d) - r_u) / (1 + 3 * kappa * r_d * r_d)
            r_d -= step
            if abs(step) < 1e-15:
                break
        # with g = 1 / (1 + κ r_d²): p_d = g p_u
        g = 1 / (1 + kappa * r_d * r_d)
        da, db = g * a, g * b
        # p_u = p_d (1 + κ |p_d|²): its derivative by p_d, inverted
        m00 = 1 + kappa * (3 * da * da + db * db)
        m11 = 1 + kappa * (da * da + 3 * db * db)
        m01 = 2 * kappa * da * db
        det = m00 * m11 - m01 * m01
        d00, d01, d10, d11 = m11 / det, -m01 / det, -m01 / det, m00 / det
        q = r_d * r_d
        ka = -(d00 * da + d01 * db) * q
        kb = -(d10 * da + d11 * db) * q
        J_row[0, 4], J_row[1, 4] = row[0] * ka, row[1] * kb
    else:
        r2 = a * a + b * b
        r4 = r2 * r2
        r6 = r4 * r2
        top = 1 + row[4] * r2 + row[5] * r4 + row[8] * r6
        bottom = 1 + row[9] * r2 + row[10] * r4 + row[11] * r6
        radial = top / bottom
        p1, p2 = row[6], row[7]
        da = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a) + row[12] * r2 + row[13] * r4
        db = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b + row[14] * r2 + row[15] * r4
        # derivative of the radial factor by r²
        slope = (
            (row[4] + 2 * row[5] * r2 + 3 * row[8] * r4) * bottom
            - top * (row[9] + 2 * row[10] * r2 + 3 * row[11] * r4)
        ) / (bottom * bottom)
        sx = row[12] + 2 * row[13] * r2
        sy = row[14] + 2 * row[15] * r2
        d00 = radial + 2 * a * a * slope + 2 * p1 * b + 6 * p2 * a + 2 * a * sx
        d01 = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b + 2 * b * sx
        d10 = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b + 2 * a * sy
        d11 = radial + 2 * b * b * slope + 6 * p1 * b + 2 * p2 * a + 2 * b * sy
        fx, fy = row[0], row[1]
        J_row[0, 4], J_row[1, 4] = fx * a * r2 / bottom, fy * b * r2 / bottom
        J_row[0, 5], J_row[1, 5] = fx * a * r4 / bottom, fy * b * r4 / bottom
        J_row[0, 6], J_row[1, 6] = fx * 2 * a * b, fy * (r2 + 2 * b * b)
        J_row[0, 7], J_row[1, 7] = fx * (r2 + 2 * a * a), fy * 2 * a * b
        J_row[0, 8], J_row[1, 8] = fx * a * r6 / bottom, fy * b * r6 / bottom
        f = -radial / bottom
        J_row[0, 9], J_row[1, 9] = fx * a * r2 * f, fy * b * r2 * f
        J_row[0, 10], J_row[1, 10] = fx * a * r4 * f, fy * b * r4 * f
        J_row[0, 11], J_row[1, 11] = fx * a * r6 * f, fy * b * r6 * f
        J_row[0, 12], J_row[0, 13] = fx * r2, fx * r4
        J_row[1, 14], J_row[1, 15] = fy * r2, fy * r4
    uv[0], uv[1] = row[0] * da + row[2], row[1] * db + row[3]
    J_row[0, 0], J_row[1, 1] = da, db
    J_row[0, 2], J_row[1, 3] = 1.0, 1.0
    for axis in range(2):
        f = row[0] if axis == 0 else row[1]
        ja = f * (d00 if axis == 0 else d10)
        jb = f * (d01 if axis == 0 else d11)
        J_point[axis, 0] = ja / z
        J_point[axis, 1] = jb / z
        J_point[axis, 2] = -(ja * a + jb * b) / z
    return True
