"""How long a camera takes from its first row to its last, from a board that moves before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from ..core.camera import Camera
from ..core.errors import InputError
from .lens import BoardView, board_pose
from .pose import pose_bundle, pose_jacobian

Floats = NDArray[np.float64]
_MIN_CORNERS = 6
_MIN_RUN = 4  # frames for a smooth motion
_ROUNDS = 12
_SURE = 5.0  # standard deviations at which a rolling shutter is taken as shown
#: A corner that is off by this many robust deviations does not count.
_WILD = 5.0
#: Less motion than this in all the time of one frame tells nothing, px.
_MIN_MOTION_PX = 1.0


@dataclass(frozen=True)
class Readout:
    """A camera's readout time.

    Attributes
    ----------
    readout_s, sd_s : float, s
        From the first row's exposure to the last row's; 0 for a global shutter, negative if rows
        are read from the bottom up.
    smear_px : float
        How far a corner was seen at most from where the middle row's time would have it.
    n_frames : int
        Frames that were compared.
    warnings : tuple of str
    """

    readout_s: float
    sd_s: float
    smear_px: float
    n_frames: int
    warnings: tuple[str, ...]


def estimate_readout(time_s: ArrayLike, views: Sequence[BoardView], camera: Camera) -> Readout:
    """Rolling shutter from a moving board's tracked corners.

    A pose is fitted to each frame, and a smooth motion laid through the poses. How far it carries
    a corner between the middle row's time and its own row's is taken off, for the readout found so
    far; what the poses then leave over, along that motion, corrects the readout. The part of the
    motion's effect that a pose could explain is taken out first.

    Parameters
    ----------
    time_s : (T,) float, s
        Of the frames, in order.
    views : T views
        The corners seen in each; frames with fewer than 6 are passed over.
    camera : Camera
        Its intrinsics.

    Raises
    ------
    InputError
        If fewer than four frames follow one another, or nothing moves.
    """
    t = np.asarray(time_s, dtype=float)
    if t.shape != (len(views),) or not np.isfinite(t).all():
        raise ValueError(f"expected a time for each of {len(views)} views, got {t.shape}")
    if not (np.diff(t) > 0).all():
        raise InputError("the frames' times must grow from each to the next")
    runs = _runs(t, views)
    if not runs:
        raise InputError(f"no {_MIN_RUN} frames in a row show {_MIN_CORNERS} corners of the board")
    frames = np.concatenate(runs)
    shift = {k: np.zeros_like(views[k].pixels) for k in frames}
    readout, sd, smear = 0.0, np.inf, 0.0
    for _ in range(_ROUNDS):
        poses = {k: _fitted(views[k], camera, shift[k]) for k in frames}
        effects = [
            effect
            for run in runs
            for effect in _effects(t[run], [views[k] for k in run], [poses[k] for k in run],
                                   camera, readout)
        ]  # fmt: skip
        y = np.concatenate([poses[k].left for k in frames])
        x = np.concatenate(
            [_outside(e.by_readout, poses[k].J) for k, e in zip(frames, effects, strict=True)]
        )
        motion_px = float(np.median([e.speed_px_s for e in effects])) * float(np.median(np.diff(t)))
        if motion_px < _MIN_MOTION_PX:
            raise InputError("the board hardly moves: wave it before the camera")
        change, sd = _slope(x, y, lost=6 * len(frames))
        readout += change
        # what a change of the poses' own splines would do is left to the next round
        shift = {k: e.shift + change * e.by_readout for k, e in zip(frames, effects, strict=True)}
        smear = float(max(np.linalg.norm(e.shift, axis=1).max() for e in effects))
        if abs(change) < 0.02 * sd:
            break
    return Readout(readout, sd, smear, len(frames), _warnings(readout, sd, smear))


def _warnings(readout: float, sd: float, smear: float) -> tuple[str, ...]:
    if abs(readout) <= _SURE * sd:
        return ()
    return (
        f"a rolling shutter: {1e3 * readout:.1f} ± {1e3 * sd:.1f} ms from the first row to the "
        f"last, which moved the board by up to {smear:.1f} px; hold the board still, "
        "or film with a global shutter",
    )


def _runs(t: Floats, views: Sequence[BoardView]) -> list[NDArray[np.intp]]:
    """Stretches of frames that follow one another without a gap and show enough of the board."""
    kept = np.array([k for k, v in enumerate(views) if len(v.points) >= _MIN_CORNERS], dtype=int)
    if len(kept) < _MIN_RUN:
        return []
    cuts = np.flatnonzero(np.diff(t[kept]) > 1.5 * float(np.median(np.diff(t)))) + 1
    return [run for run in np.split(kept, cuts) if len(run) >= _MIN_RUN]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A frame's pose at its middle row's time, what it leaves (2N,), and its derivatives."""

    R: Floats
    t: Floats
    left: Floats
    J: Floats  # (2N, 6)


@dataclass(frozen=True, eq=False)
class _Effect:
    """What the readout does to a frame's corners: pixels, and pixels a second of readout."""

    shift: Floats
    by_readout: Floats
    speed_px_s: float


def _fitted(view: BoardView, camera: Camera, shift: Floats) -> _Fitted:
    still = BoardView(view.name, view.points, view.pixels - shift)
    fit = pose_bundle(still.points, still.pixels, camera, *board_pose(still, camera))
    R, t = fit.target_rotation[0], fit.target_translation[0]
    J = pose_jacobian(view.points, camera, R, t).reshape(-1, 6)
    return _Fitted(R, t, _outside(fit.residuals, J), J)


def _effects(
    t: Floats, views: Sequence[BoardView], poses: Sequence[_Fitted], camera: Camera, readout: float
) -> list[_Effect]:
    """For each frame of one stretch."""
    places = CubicSpline(t, np.stack([p.t for p in poses]))
    turns = RotationSpline(t, Rotation.from_matrix(np.stack([p.R for p in poses])))
    last = max(camera.image_size[1] - 1, 1)
    found = []
    for time_s, view, pose in zip(t, views, poses, strict=True):
        share = view.pixels[:, 1] / last - 0.5
        step = 1e-3 * float(np.median(np.diff(t)))

        def at(
            when: Floats, X: Floats = view.points, pose: _Fitted = pose, now: float = time_s
        ) -> Floats:
            # the spline's course, but through this frame's own pose
            turn = turns(when) * turns(now).inv()
            p = turn.apply(X @ pose.R.T) + pose.t + places(when) - places(now)
            return np.asarray(camera.pixel_from_normalised(camera.distort(p[:, :2] / p[:, 2:])))

        own = time_s + readout * share
        speed = (at(own + step) - at(own - step)) / (2 * step)
        shift = at(own) - at(np.full(len(share), time_s))
        found.append(
            _Effect(shift, speed * share[:, None], float(np.linalg.norm(speed, axis=1).mean()))
        )
    return found


def _outside(values: Floats, J: Floats) -> Floats:
    """The part of (N, 2) values, flattened, that no change of the pose explains."""
    flat = values.reshape(-1)
    scale = np.linalg.norm(J, axis=0)
    basis, _ = np.linalg.qr(J / np.where(scale > 0, scale, 1.0))
    return np.asarray(flat - basis @ (basis.T @ flat))


def _slope(x: Floats, y: Floats, *, lost: int) -> tuple[float, float]:
    """Of y over x, without what is far off; and its standard deviation."""
    kept = np.ones(len(y), dtype=bool)
    slope, sd = 0.0, np.inf
    for _ in range(3):
        slope = float(x[kept] @ y[kept] / (x[kept] @ x[kept]))
        off = y - slope * x
        variance = float((off[kept] ** 2).sum()) / max(int(kept.sum()) - lost - 1, 1)
        sd = float(np.sqrt(variance / (x[kept] @ x[kept])))
        kept = np.abs(off) <= _WILD * (1.4826 * float(np.median(np.abs(off))) + 1e-12)
    return slope, sd
