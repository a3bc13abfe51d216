"""Tsai's closed-form start: the radial alignment constraint, then focal length and depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError

Floats = NDArray[np.float64]


def is_coplanar(points: Floats) -> bool:
    """Whether points lie in a plane, to 1e-3 of their extent."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(s[2] <= 1e-3 * max(s[0], 1e-300))


def plane_frame(points: Floats) -> tuple[Floats, Floats]:
    """Axes (3, 3) as rows and origin (3,) of a frame in which coplanar points have z = 0."""
    origin = points.mean(axis=0)
    axes = np.linalg.svd(points - origin)[2]
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    return axes, origin


def tsai_start(points: Floats, pixels: Floats, centre: Floats) -> tuple[float, Floats, Floats]:
    """Focal length and pose of a camera, without distortion, in closed form.

    The direction from the principal point to a pixel does not depend on focal length, depth or
    radial distortion: Yd (r1·X + Tx) = Xd (r2·X + Ty) is linear in the first two rows of the pose.
    Solved for its null vector instead of for the ratios to Ty, so that Ty may be zero.

    Parameters
    ----------
    points : (N, 3) float64, mm, world frame
        At least 5 if coplanar, else 7.
    pixels : (N, 2) float64, px
    centre : (2,) float64, px
        Principal point.

    Returns
    -------
    f : float, px
    R : (3, 3), t : (3,) float64, mm
        Camera from world.

    Raises
    ------
    InputError
        If no camera of positive focal length has the points in front of it.

    References
    ----------
    Tsai 1987, sections II-A (eqs. 9 to 15, coplanar) and II-B (eqs. 16 to 20, non-coplanar).
    """
    axes, origin = plane_frame(points) if is_coplanar(points) else (np.eye(3), points.mean(axis=0))
    flat = is_coplanar(points)
    X = (points - origin) @ axes.T
    if flat:
        X[:, 2] = 0.0
    size = float(np.abs(X).max())
    rows = _aligned_rows(X / size, pixels - centre, flat)
    best = None
    for sign in (1.0, -1.0):
        for R, t in _complete(sign * rows, flat):
            solved = _focal_and_depth(X, pixels - centre, R, t * size)
            if solved is None:
                continue
            f, t_full, error = solved
            if best is None or error < best[0]:
                best = error, f, R @ axes, t_full - R @ axes @ origin
    if best is None:
        raise InputError(
            "no camera sees these points so: are pixels and points paired, y down in the picture "
            "and the axes right-handed?"
        )
    return best[1], best[2], best[3]


def _aligned_rows(X: Floats, uv: Floats, flat: bool) -> Floats:
    """The first two rows of [R | t] up to scale, (2, 4)."""
    used = [0, 1, 3] if flat else [0, 1, 2, 3]
    P = np.column_stack([X, np.ones(len(X))])[:, used]
    A = np.concatenate([uv[:, 1:] * P, -uv[:, :1] * P], axis=1)
    solution = np.linalg.svd(A)[2][-1].reshape(2, -1)
    rows = np.zeros((2, 4))
    rows[:, used] = solution
    return rows


def _complete(rows: Floats, flat: bool) -> list[tuple[Floats, Floats]]:
    """Rotations and (Tx, Ty, 0) from the first two rows up to a positive scale."""
    if not flat:
        scale = np.sqrt(np.linalg.norm(rows[0, :3]) * np.linalg.norm(rows[1, :3]))
        if not scale > 0:
            return []
        u, _, vt = np.linalg.svd(rows[:, :3] / scale, full_matrices=False)
        return [_with_third_row(u @ vt, rows[:, 3] / scale)]
    # r1 and r2 lack their z: their lengths and product say what it must be (Tsai eq. 11)
    a, b = rows[0, :2], rows[1, :2]
    s, d = a @ a + b @ b, a[0] * b[1] - a[1] * b[0]
    scale2 = (s + np.sqrt(max(s * s - 4 * d * d, 0.0))) / 2
    if not scale2 > 0:
        return []
    a, b, t = a / np.sqrt(scale2), b / np.sqrt(scale2), rows[:, 3] / np.sqrt(scale2)
    az, bz = np.sqrt(max(1 - a @ a, 0)), np.sqrt(max(1 - b @ b, 0))
    bz = -bz if a @ b > 0 else bz
    found = []
    for sign in (1.0, -1.0):
        first, second = np.append(a, sign * az), np.append(b, sign * bz)
        u, _, vt = np.linalg.svd(np.stack([first, second]), full_matrices=False)
        found.append(_with_third_row(u @ vt, t))
    return found


def _with_third_row(rows: Floats, txy: Floats) -> tuple[Floats, Floats]:
    return np.vstack([rows, np.cross(rows[0], rows[1])]), np.array([txy[0], txy[1], 0.0])


def _focal_and_depth(
    X: Floats, uv: Floats, R: Floats, t: Floats
) -> tuple[float, Floats, float] | None:
    """f and Tz by linear least squares without distortion (Tsai eq. 15), and the squared error."""
    p = X @ R.T + t
    A = np.concatenate([np.column_stack([p[:, i], -uv[:, i]]) for i in (0, 1)])
    f, depth = np.linalg.lstsq(A, np.concatenate([uv[:, i] * p[:, 2] for i in (0, 1)]), rcond=None)[
        0
    ]
    z = p[:, 2] + depth
    if not (f > 0 and (z > 0).all()):
        return None
    error = float(((f * p[:, :2] / z[:, None] - uv) ** 2).sum())
    return float(f), np.array([t[0], t[1], depth]), error
