"""Camera rigs around a face."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..core.camera import Camera
from ..core.rig import Rig
from ..core.rigid import Rigid

DISTANCE_MM = 750.0
FOCAL_PX_PER_WIDTH = 1.52  # 36° across: head and its movements fill the height
YAW_DEG = 46.0
INNER_SHARE = 0.48  # of that: the inner cameras stand far enough out to see a temple each
FRONT_DEG = 2.0  # of a single camera
LOW_DEG, HIGH_DEG = -18.0, 11.0  # under the chin and the brows; over the cheeks and the lids
_SHARES = (-1.0, -INNER_SHARE, INNER_SHARE, 1.0)


def look_at(position: ArrayLike, target: ArrayLike, roll_rad: float = 0.0) -> Rigid:
    """Pose (camera from world) of a camera at `position` that looks at `target`, +y up, mm."""
    eye, goal = np.asarray(position, dtype=np.float64), np.asarray(target, dtype=np.float64)
    z = (goal - eye) / np.linalg.norm(goal - eye)
    x = np.cross(z, (0.0, 1.0, 0.0))
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ R
    return Rigid.from_rotation(R, -R @ eye)


def face_rig(
    rng: np.random.Generator,
    *,
    n_cameras: int = 4,
    image_size: tuple[int, int] = (1280, 720),
    distortion: bool = True,
) -> Rig:
    """Cameras on an arc before the face, alternately above and below it, lenses a little unlike.

    The world frame is the neutral head's: x to the subject's left, y up, z out of the face. A
    single camera stands in front.

    Parameters
    ----------
    rng : numpy Generator
    n_cameras : int
    image_size : (width, height), px
    distortion : bool
        False makes ideal lenses.
    """
    width, height = image_size
    cameras = {}
    for i, share in enumerate(np.linspace(-1, 1, n_cameras) if n_cameras > 1 else [0.0]):
        yaw = YAW_DEG * np.interp(share, (-1, -1 / 3, 1 / 3, 1), _SHARES)
        pitch = FRONT_DEG if n_cameras == 1 else HIGH_DEG if i % 2 else LOW_DEG
        yaw_rad = np.deg2rad(yaw + rng.normal(0, 1.5))
        pitch_rad = np.deg2rad(pitch + rng.normal(0, 1.5))
        direction = np.array(
            [
                np.sin(yaw_rad) * np.cos(pitch_rad),
                np.sin(pitch_rad),
                np.cos(yaw_rad) * np.cos(pitch_rad),
            ]
        )
        target = np.array([0.0, -12.0, -10.0]) + rng.normal(0, 3.0, size=3)
        distance = DISTANCE_MM + rng.normal(0, 15.0)
        f = FOCAL_PX_PER_WIDTH * width * (1 + rng.normal(0, 0.01))
        centre = (
            (width - 1) / 2 + rng.normal(0, 0.006 * width),
            (height - 1) / 2 + rng.normal(0, 0.006 * width),
        )
        K = [[f, 0, centre[0]], [0, f * (1 + rng.normal(0, 5e-4)), centre[1]], [0, 0, 1]]
        coefficients = [
            rng.uniform(-0.15, 0.02),
            rng.uniform(-0.05, 0.15),
            *rng.normal(0, 4e-4, size=2),
            0.0,
        ]
        pose = look_at(target + distance * direction, target, float(rng.normal(0, 0.01)))
        cameras[f"cam{i}"] = Camera(
            image_size,
            np.array(K),
            pose,
            "opencv",
            np.array(coefficients) if distortion else np.zeros(5),
        )
    return Rig(cameras)
