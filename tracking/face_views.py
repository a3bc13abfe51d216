"""Cameras of a clip, what each sees at one instant, and where to begin looking for the head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from ..heads.face_landmarks import NAMED_LANDMARKS
from .face_fit import FOCAL_LOG_SD, USUAL_FOCAL, FittedFace
from .face_pose import FaceState, View
from .landmark_noise import LandmarkModel
from .landmark_tracks import LandmarkTracks

Floats = NDArray[np.float64]
_EYES_MM = 88.0  # between the outer corners as the network sees them
_TOGETHER = 0.6  # of the frame interval: frames of cameras that are one instant


def analysis_cameras(
    each: tuple[LandmarkTracks, ...], camera: Camera | None, rig: Rig | None, neutral: object
) -> tuple[tuple[Camera, ...], float]:
    """The cameras, and how unsure the logarithm of the focal length is."""
    if rig is not None:
        if camera is not None:
            raise ValueError("give a camera or a rig, not both")
        if len(rig) != len(each):
            raise InputError(f"{len(each)} videos and {len(rig)} cameras: expected one each")
        cameras = tuple(rig[name] for name in rig)
    elif len(each) != 1:
        raise InputError("several videos need a rig: give rig.json")
    elif camera is not None:
        cameras = (camera,)
    else:
        width, height = each[0].image_size
        if isinstance(neutral, FittedFace):
            return (free_camera(each[0], neutral.focal_px),), 0.0
        return (free_camera(each[0], USUAL_FOCAL * max(width, height)),), FOCAL_LOG_SD
    for t, c in zip(each, cameras, strict=True):
        if tuple(t.image_size) != tuple(c.image_size):
            raise InputError(
                f"the video is {t.image_size[0]}x{t.image_size[1]}, its camera "
                f"{c.image_size[0]}x{c.image_size[1]}: is it another camera's?"
            )
    return cameras, 0.0


def free_camera(tracks: LandmarkTracks, focal_px: float) -> Camera:
    """A camera at the world's origin that looks along -z."""
    width, height = tracks.image_size
    K = [[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]]
    return Camera(tracks.image_size, np.array(K), Rigid(np.array([0.0, 1, 0, 0]), np.zeros(3)))


def views_of(
    model: LandmarkModel, each: tuple[LandmarkTracks, ...], cameras: tuple[Camera, ...]
) -> list[list[View]]:
    """For each frame of the first camera the views of one instant that show a face."""
    time_s = each[0].time_s
    found: list[list[View]] = [[] for _ in time_s]
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    for tracks, camera in zip(each, cameras, strict=True):
        xy = camera.undistort(tracks.points_px[:, model.numbers])
        sd = tracks.sd_px[:, model.numbers] / camera.focal_px
        pose = camera.camera_from_world
        irises = None if tracks.iris_px is None else camera.undistort(tracks.iris_px)
        nearest = np.abs(tracks.time_s[None] - time_s[:, None]).argmin(axis=1)
        for frame, row in enumerate(nearest):
            apart = abs(tracks.time_s[row] - time_s[frame])
            if apart <= _TOGETHER * step and np.isfinite(xy[row]).any():
                looks = None if irises is None else irises[row]
                found[frame].append(
                    View(xy[row], np.nan_to_num(sd[row]), pose.rotation, pose.translation, looks)
                )
    return found


def has_eyes(model: LandmarkModel, view: View) -> bool:
    """Whether the outer corners of both eyes are known, which `start_state` needs."""
    return bool(np.isfinite(view.xy[_eye_rows(model)]).all())


def _eye_rows(model: LandmarkModel) -> list[int]:
    """Rows of the right eye's and the left eye's outer corner."""
    return [
        int(np.flatnonzero(model.numbers == NAMED_LANDMARKS[name])[0])
        for name in ("eye_right_outer", "eye_left_outer")
    ]


def start_state(model: LandmarkModel, view: View) -> FaceState:
    """A face before a camera, upright in its own plane, about as far as its size tells."""
    right, left = view.xy[_eye_rows(model)]
    if not np.isfinite([right, left]).all():
        raise ValueError("a start needs the corners of both eyes: see has_eyes")
    across = left - right
    depth = _EYES_MM / float(np.linalg.norm(across))
    roll = Rotation.from_rotvec([0, 0, np.arctan2(across[1], across[0])]).as_matrix()
    R = roll @ np.diag([1.0, -1.0, -1.0])
    t = depth * np.append((right + left) / 2, 1.0) + R @ (0, 0, -20.0)
    K = model.n_components
    world, nothing = view.rotation.T, np.zeros((len(view.xy), 2))
    place = world @ (t - view.translation)
    return FaceState(world @ R, place, np.zeros(K), np.eye(6 + K), 0.0, nothing)
