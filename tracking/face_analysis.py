"""From a face's landmarks in ordinary video to head motion, FAPs and ARKit weights.

A head is fitted to the neutral frames (`face_fit`); in every frame its pose and expression are
found together (`face_pose`). FAPs are what the expression does to the fitted head's feature points,
in its units, and weights what moves it likewise (`face_weights`). With several calibrated cameras
all their pictures are solved at once, and depth is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..core.camera import Camera
from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.mpeg4 import ANGLE_UNIT_RAD, displacement_faps, fap_by_name, fap_table, rotation_faps
from ..core.rig import Rig
from ..core.rigid import quaternion_from_rotation
from .face_fit import FittedFace, fit_face
from .face_gaze import GAZE_FAPS, GAZE_SD, measure_gaze, with_gaze
from .face_pose import FaceSolver, FaceState, View, with_own_offsets
from .face_views import analysis_cameras, free_camera, has_eyes, start_state, views_of
from .face_weights import expression_weights
from .landmark_noise import LandmarkModel, landmark_model
from .landmark_tracks import LandmarkTracks
from .lid_closure import with_whole_blinks
from .motion_smoother import smooth_curves
from .neutral_personal import find_neutral_frames, frames_around

Floats = NDArray[np.float64]
#: FAPs that pictures of a face do not show.
DEAD = (
    "shift_tongue_tip", "raise_tongue_tip", "thrust_tongue_tip", "raise_tongue", "tongue_roll",
    "thrust_l_eyeball", "thrust_r_eyeball", "dilate_l_pupil", "dilate_r_pupil",
    "raise_l_ear", "raise_r_ear", "pull_l_ear", "pull_r_ear",
)  # fmt: skip
_FEWEST_SMOOTHED = 20  # frames of a shot: fewer do not tell noise from motion
#: FAPs along the line of sight of one camera.
DEPTH_FAPS = ("thrust_jaw", "push_b_lip", "push_t_lip")


@dataclass(frozen=True, eq=False)
class FacePerformance:
    """What a face did.

    Attributes
    ----------
    faps : Clip
        FAPs 3 to 68 but the dead ones; not set in frames without a face.
    weights : Clip
        ARKit weights.
    head_motion : HeadMotion
        World from head, smoothed without lag, with covariance. Without a camera the world is one
        in which the camera stands at the origin and looks along -z, y up.
    face : FittedFace
        The person at rest; ``face.head()`` makes the head.
    neutral_frames : (m,) int64
        Of the first camera; empty if the neutral face was given.
    dead : tuple of str
        FAPs that cannot be seen.
    fap_sd : Clip
        Stated standard deviations of the FAPs, same channels and units.
    misfit : (T,) float64
        Mean square of the whitened residuals: far above 1 something is not as the model expects.
    """

    faps: Clip
    weights: Clip
    head_motion: HeadMotion
    face: FittedFace
    neutral_frames: NDArray[np.int64]
    dead: tuple[str, ...]
    fap_sd: Clip
    misfit: Floats

    @property
    def focal_px(self) -> float:
        """The first camera's focal length, given or estimated."""
        return self.face.focal_px


def analyse_face(
    tracks: LandmarkTracks | Sequence[LandmarkTracks],
    *,
    camera: Camera | None = None,
    rig: Rig | None = None,
    neutral: FittedFace | float | None = None,
    model: LandmarkModel | None = None,
) -> FacePerformance:
    """Head motion, FAPs and weights of a face.

    Parameters
    ----------
    tracks : LandmarkTracks, or one for each camera of `rig`, in its order
    camera : Camera, optional
        That filmed it; else its focal length is estimated.
    rig : Rig, optional
        Several cameras.
    neutral : FittedFace, or time in s, optional
        The person's neutral face, from `read_neutral`, say; or when the clip shows it. Found in
        the clip if left out.
    model : LandmarkModel, optional
        Of the landmarks' measurement, if not the package's.

    Raises
    ------
    InputError
        If no face was seen, or tracks and cameras do not fit.
    """
    each = (tracks,) if isinstance(tracks, LandmarkTracks) else tuple(tracks)
    m = landmark_model() if model is None else model
    cameras, focal_sd = analysis_cameras(each, camera, rig, neutral)
    frames = views_of(m, each, cameras)
    time_s = each[0].time_s
    if isinstance(neutral, FittedFace):
        face, neutral_frames = neutral, np.zeros(0, np.int64)
    else:
        neutral_frames = (
            find_neutral_frames(each[0], each[1:])
            if neutral is None
            else frames_around(each[0], float(neutral))
        )
        face = _fitted(m, frames, neutral_frames, cameras[0], focal_sd)
        if focal_sd:
            cameras = (free_camera(each[0], face.focal_px),)
            frames = views_of(m, each, cameras)
    states = _solved(m, frames, face, neutral_frames, set(each[0].cuts))
    if all(state is None for state in states):
        raise InputError("no frame shows a face")
    motion, front = _head_motion(each[0], states, neutral_frames, m.pose_doubt)
    expression, left, cov = _expressions(states, m)
    moved = m.corrected(
        expression - _at_rest(expression, neutral_frames), left - _at_rest(left, neutral_frames)
    )
    gaze = measure_gaze(time_s, frames, states, face, neutral_frames, each[0].cuts)
    faps, sd = _faps(m, time_s, moved, cov, face, motion, front)
    if gaze is not None:
        faps, sd = (
            with_gaze(faps, gaze),
            with_gaze(sd, np.where(np.isfinite(gaze), GAZE_SD, np.nan)),
        )
    usual = np.nanmedian(cov, axis=0) if len(cov) else np.eye(m.n_components)
    weights = expression_weights(m, time_s, moved, usual, _scores(each[0], neutral_frames))
    faps, weights = with_whole_blinks(faps, weights)
    misfit = np.array([np.nan if s is None else s.misfit for s in states])
    return FacePerformance(faps, weights, motion, face, neutral_frames, DEAD, sd, misfit)


def _fitted(
    m: LandmarkModel,
    frames: list[list[View]],
    neutral_frames: NDArray[np.int64],
    camera: Camera,
    focal_sd: float,
) -> FittedFace:
    chosen = [frames[f] for f in neutral_frames if frames[f] and has_eyes(m, frames[f][0])]
    if not chosen:
        raise InputError("no neutral frame shows both eyes: choose another neutral time")
    starts = [start_state(m, views[0]) for views in chosen]
    poses = [(s.rotation, s.translation) for s in starts]
    return fit_face(m, chosen, poses, focal_px=camera.focal_px, focal_log_sd=focal_sd)


def _solved(
    m: LandmarkModel,
    frames: list[list[View]],
    face: FittedFace,
    neutral_frames: NDArray[np.int64],
    cuts: set[int],
) -> list[FaceState | None]:
    """The state of every frame; None without a face, or until one is seen with both eyes."""
    solver = FaceSolver(m, face.landmarks)
    if max(len(views) for views in frames) > 1 and len(neutral_frames):
        starts = {int(f): _first(m, frames[f]) for f in neutral_frames}
        rest = {f: solver.solve(frames[f], s) for f, s in starts.items() if s is not None}
        frames = with_own_offsets(solver, frames, rest)
    found: list[FaceState | None] = []
    last: FaceState | None = None
    for frame, views in enumerate(frames):
        start = None if frame in cuts else last
        if start is None:
            start = _first(m, views)
        last = solver.solve(views, start) if views and start is not None else None
        found.append(last)
    return found


def _first(m: LandmarkModel, views: list[View]) -> FaceState | None:
    """Where to begin, by the first view that shows both eyes."""
    begin = next((view for view in views if has_eyes(m, view)), None)
    return None if begin is None else start_state(m, begin)


def _head_motion(
    tracks: LandmarkTracks,
    states: list[FaceState | None],
    neutral_frames: NDArray[np.int64],
    doubt: float,
) -> tuple[HeadMotion, Floats]:
    """Smoothed motion, and the rotation of the neutral frames (of the first, if none)."""
    known = np.array([s is not None for s in states])
    R = np.stack([np.full((3, 3), np.nan) if s is None else s.rotation for s in states])
    t = np.stack([np.full(3, np.nan) if s is None else s.translation for s in states])
    C = np.stack([np.full((6, 6), np.nan) if s is None else s.covariance[:6, :6] for s in states])
    C *= doubt**2
    chosen = neutral_frames if len(neutral_frames) else np.flatnonzero(known)[:1]
    front = Rotation.from_matrix(R[chosen]).mean().as_matrix()
    turn = np.full((len(t), 3), np.nan)
    turn[known] = Rotation.from_matrix(R[known] @ front.T).as_rotvec()
    variance = np.diagonal(C, axis1=1, axis2=2)
    for shot in tracks.shots:
        seen = np.flatnonzero(known[shot]) + shot.start
        if len(seen) < _FEWEST_SMOOTHED:
            continue
        for part, v in ((turn, variance[:, :3]), (t, variance[:, 3:])):
            smooth = smooth_curves(tracks.time_s[shot], part[shot], v[shot], most_noise=1.0)
            part[seen] = smooth.values[seen - shot.start]
    q = np.full((len(t), 4), np.nan)
    rotations = Rotation.from_rotvec(turn[known]).as_matrix() @ front
    q[known] = quaternion_from_rotation(rotations)
    return HeadMotion(tracks.time_s, q, t, C), front


def _expressions(states: list[FaceState | None], m: LandmarkModel) -> tuple[Floats, Floats, Floats]:
    """c (T, K), what is left of the landmarks (T, n, 2), covariances of c (T, K, K); NaN without
    a face."""
    K, n = m.n_components, len(m.numbers)
    c = np.stack([np.full(K, np.nan) if s is None else s.expression for s in states])
    left = np.stack([np.full((n, 2), np.nan) if s is None else s.left for s in states])
    cov = np.stack([np.full((K, K), np.nan) if s is None else s.covariance[6:, 6:] for s in states])
    return c, left, cov


def _at_rest(values: Floats, neutral_frames: NDArray[np.int64]) -> Floats:
    """The mean of the neutral frames; nothing if the neutral face was given."""
    if not len(neutral_frames):
        return np.zeros(values.shape[1:])
    return np.asarray(np.nanmean(values[neutral_frames], axis=0))


def _faps(
    m: LandmarkModel,
    time_s: Floats,
    c: Floats,
    cov: Floats,
    face: FittedFace,
    motion: HeadMotion,
    front: Floats,
) -> tuple[Clip, Clip]:
    """FAPs and their standard deviations."""
    fapu, K = face.fapu, m.n_components
    effect = displacement_faps({p: m.points[:, i] for i, p in enumerate(m.point_names)}, fapu)
    effect |= {name: m.gaze[:, eye, axis] / ANGLE_UNIT_RAD for name, eye, axis in GAZE_FAPS}
    angles = rotation_faps(front.T @ motion.rotation)
    assert motion.covariance is not None
    about = front.T @ motion.covariance[:, :3, :3] @ front
    turned = {}
    for i, fap in enumerate(fap_table()[47:50]):
        variance = about[:, i, i]  # pitch is about x, yaw about y, roll about z
        turned[fap.name] = (angles[:, i], np.sqrt(variance) / ANGLE_UNIT_RAD)
    names = [f.name for f in fap_table() if (f.name in effect or f.name in turned)]
    names = [n for n in names if n not in DEAD]
    values, sds = [], []
    for name in names:
        if name in turned:
            value, sd = turned[name]
        else:
            along = effect[name].reshape(K)
            value = c @ along
            sd = np.sqrt(np.einsum("k,tkl,l->t", along, cov, along))
        values.append(value)
        sds.append(sd)
    assert set(names) <= set(fap_by_name())
    stack = np.stack(values, axis=1)
    return Clip(time_s, tuple(names), stack), Clip(time_s, tuple(names), np.stack(sds, axis=1))


def _scores(tracks: LandmarkTracks, neutral_frames: NDArray[np.int64]) -> Floats | None:
    if tracks.scores is None or not len(neutral_frames):
        return None
    return np.asarray(tracks.scores - np.nanmean(tracks.scores[neutral_frames], axis=0))
