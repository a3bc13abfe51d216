"""Where the eyes look: measured irises on the fitted head's eyeballs.

The line of sight through an iris meets the plane before the eyeball in which irises lie; how far
from the eyeball's axis it does tells the gaze. A frontal plane and a sine serve for all angles that
eyes turn by: what they get wrong is less than what the measurement does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ..core.clip import Clip
from ..core.mpeg4 import ANGLE_UNIT_RAD
from .face_fit import FittedFace
from .face_pose import FaceState, View, camera_of, view_trust

Floats = NDArray[np.float64]

_IRIS_DEPTH = 0.9  # of an iris before the centre, over the eyeball's radius
#: True turns over measured ones, yaw and pitch: the fit hides from lids, which follow the eyes
#: down, and leans to where the network sees the iris. Measured on ten takes; and where irises of
#: straight eyes were seen beside the fitted eyes' centres, mm.
GAIN, AXIS_MM = (0.93, 1.0), (0.0, -0.63)
#: Of a turn, yaw and pitch, rad.
GAZE_SD = (0.03, 0.04)
#: FAPs of the eyes: name, eye, axis.
GAZE_FAPS = (
    ("yaw_l_eyeball", 1, 0), ("yaw_r_eyeball", 0, 0),
    ("pitch_l_eyeball", 1, 1), ("pitch_r_eyeball", 0, 1),
)  # fmt: skip
_MOST_RAD = np.deg2rad(45.0)
#: Of several cameras, one that sees the face from the side takes lashes for irises.
_LEAST_TRUST = 0.3
_STEADY_S = 0.1  # measurements of a fixation: their median
#: Eyes turn up and down together, and converge little: what is left of their differences in yaw.
_APART = 0.5


def measure_gaze(
    time_s: Floats,
    frames: Sequence[Sequence[View]],
    states: Sequence[FaceState | None],
    face: FittedFace,
    neutral_frames: NDArray[np.int64],
    cuts: Sequence[int] = (),
) -> Floats | None:
    """Gaze of both eyes.

    Parameters
    ----------
    time_s : (T,) float64, s
    frames, states : T each
        What is seen at an instant, and the head's place then.
    face : FittedFace
    neutral_frames : (m,) int64
        Frames in which the eyes look straight ahead; if none are given or they show no iris,
        straight is along the fitted head's z axis.
    cuts : sequence of int

    Returns
    -------
    (T, 2, 2) float64, rad, or None
        Rows right, left; yaw to the subject's left, pitch down. Bridged while eyes are shut; NaN in
        frames without a face, and in a shot without any iris. None if no iris was measured at all.
    """
    at = _irises(face, frames, states, neutral_frames)
    if not np.isfinite(at).any():
        return None
    reach = _IRIS_DEPTH * face.eyes[0].radius
    turn = np.arcsin(np.clip(np.array(GAIN) * at / reach * (1, -1), -0.9, 0.9))
    turn = np.clip(turn, -_MOST_RAD, _MOST_RAD)
    known = np.array([s is not None for s in states])
    for first, end in pairwise((0, *cuts, len(time_s))):
        turn[first:end] = _steady(time_s[first:end], _together(turn[first:end]))
    turn[~known] = np.nan
    return np.asarray(turn)


def with_gaze(faps: Clip, gaze: Floats) -> Clip:
    """FAPs with those of the eyes replaced by a gaze (T, 2, 2) rad; NaN leaves what was there."""
    values = np.array(faps.values)
    for name, eye, axis in GAZE_FAPS:
        column = faps.channels.index(name)
        known = np.isfinite(gaze[:, eye, axis])
        values[known, column] = gaze[known, eye, axis] / ANGLE_UNIT_RAD
    return replace(faps, values=values)


def _irises(
    face: FittedFace,
    frames: Sequence[Sequence[View]],
    states: Sequence[FaceState | None],
    neutral_frames: NDArray[np.int64],
) -> Floats:
    """Irises (T, 2, 2) mm in the head's x and y from where they are in eyes that look straight:
    of each camera by itself, for each sees them from its own side; then the mean by trust."""
    T = len(frames)
    by_camera: dict[bytes, tuple[Floats, Floats]] = {}
    for frame, (views, state) in enumerate(zip(frames, states, strict=True)):
        for view in views:
            if state is None or view.irises is None:
                continue
            its_trust = view_trust(view, state.rotation, state.translation)
            if len(views) > 1 and its_trust < _LEAST_TRUST:
                continue
            at, trust = by_camera.setdefault(
                camera_of(view), (np.full((T, 2, 2), np.nan), np.zeros(T))
            )
            at[frame] = _in_head(face, view, state)
            trust[frame] = its_trust
    total, weight = np.zeros((T, 2, 2)), np.zeros((T, 2, 1))
    for at, trust in by_camera.values():
        off = at - _straight(at, neutral_frames, is_alone=len(by_camera) == 1)
        counts = np.where(np.isfinite(off[..., :1]), trust[:, None, None], 0.0)
        total += counts * np.nan_to_num(off)
        weight += counts
    return np.asarray(np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan))


def _in_head(face: FittedFace, view: View, state: FaceState) -> Floats:
    """One view's irises (2, 2) mm from the eyeballs' centres, head's x and y."""
    R = view.rotation @ state.rotation
    camera = -R.T @ (view.rotation @ state.translation + view.translation)
    assert view.irises is not None
    rays = np.column_stack([view.irises, np.ones(2)]) @ R
    found = np.empty((2, 2))
    for i, eye in enumerate(face.eyes):
        far = (eye.centre[2] + _IRIS_DEPTH * eye.radius - camera[2]) / rays[i, 2]
        found[i] = (camera + far * rays[i] - eye.centre)[:2]
    return found


def _straight(at: Floats, neutral_frames: NDArray[np.int64], *, is_alone: bool) -> Floats:
    """Where the irises (2, 2) are when the eyes look straight ahead; NaN if another camera may
    know better."""
    usual = AXIS_MM if is_alone or not len(neutral_frames) else (np.nan, np.nan)
    found = np.tile(np.array(usual, np.float64), (2, 1))
    for eye in range(2):
        seen = at[neutral_frames, eye]
        seen = seen[np.isfinite(seen[:, 0])]
        if len(seen):
            found[eye] = np.median(seen, axis=0)
    return found


def _together(turn: Floats) -> Floats:
    """Both eyes' (T, 2, 2), each by what both show."""
    sees: NDArray[np.bool_] = np.isfinite(turn[..., 0])
    turn = np.where(sees[..., None], turn, turn[:, ::-1])  # the other eye's
    middle = turn.mean(axis=1, keepdims=True)
    apart = np.where((sees[:, 0] & sees[:, 1])[:, None, None], turn - middle, 0.0)
    return np.asarray(middle + apart * (_APART, 0.0))


def _steady(time_s: Floats, turn: Floats) -> Floats:
    """Bridged where unknown, and without single strays."""
    known = np.isfinite(turn).all(axis=(1, 2))
    if not known.any():
        return turn
    flat = turn.reshape(len(turn), -1).copy()
    for column in flat.T:
        column[~known] = np.interp(time_s[~known], time_s[known], column[known])
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else _STEADY_S
    width = 2 * int(_STEADY_S / step / 2) + 1
    return np.asarray(median_filter(flat, size=(width, 1), mode="nearest").reshape(turn.shape))
