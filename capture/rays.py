"""Points from rays, in closed form: where a least squares solution starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Rotation (3, 3) and translation (3,), mm, of a camera: x_camera = R x_world + t.
Pose = tuple[Floats, Floats]
_PARALLEL = 1e-7  # of the rays' spread in direction: then they meet nowhere


def nearest_points(poses: Sequence[Pose], xy: Floats) -> Floats:
    """The points nearest to rays, by the sum of squared distances.

    Parameters
    ----------
    poses : C poses
        Camera from world, mm.
    xy : (..., C, 2) float64
        Ideal normalised coordinates (`Camera.undistort`); NaN where unseen.

    Returns
    -------
    (..., 3) float64, mm, world frame
        NaN where fewer than two cameras see it, or the rays are parallel.
    """
    A, b = np.zeros((*xy.shape[:-2], 3, 3)), np.zeros((*xy.shape[:-2], 3))
    for c, (R, t) in enumerate(poses):
        seen = np.isfinite(xy[..., c, 0])
        d = np.concatenate([xy[..., c, :], np.ones((*xy.shape[:-2], 1))], axis=-1) @ R
        d = np.where(seen[..., None], d, (0.0, 0.0, 1.0))
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        across = (np.eye(3) - d[..., :, None] * d[..., None, :]) * seen[..., None, None]
        A += across
        b -= across @ (R.T @ t)
    known = np.linalg.eigvalsh(A)[..., 0] > _PARALLEL
    X = np.linalg.solve(np.where(known[..., None, None], A, np.eye(3)), b[..., None])[..., 0]
    return np.where(known[..., None], X, np.nan)


def normalised_from_world(pose: Pose, points: Floats) -> Floats:
    """Ideal normalised coordinates (..., 2) of points (..., 3), mm; NaN behind the camera."""
    R, t = pose
    p = points @ R.T + t
    depth = np.where(p[..., 2] > 0, p[..., 2], np.nan)
    return np.asarray(p[..., :2] / depth[..., None])
