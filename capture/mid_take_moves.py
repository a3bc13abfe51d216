"""Cameras that were moved while a take ran: which, and between which frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..core.rig import Rig
from .camera_shifts import CameraShift, PoseSd
from .marker_rig import pose_of, refine_rig
from .rays import nearest_points
from .spot_matching import MatchSpots, SpotFrame

Floats = NDArray[np.float64]
#: A part of a take that is judged by itself has so many frames.
_LEAST_FRAMES = 6
#: What two parts of a take agree on; the same markers are seen by the same cameras in both.
_SAME = PoseSd(centre_mm=0.1, rotation_rad=1e-4)
_FAR_PX = 20.0
_CLEAR = 0.8  # of the frames on either side of a cut must be on the right side


@dataclass(frozen=True, eq=False)
class MidTakeMove:
    """A camera that was moved while a take ran.

    Attributes
    ----------
    camera : str
    index : int or None
        The first of the frames given in which it stands elsewhere; None if it did not move at once.
    before, after : str
        Names of the last frame before and the first frame after.
    shift : CameraShift
        From where it stood at the beginning to where it stands at the end.
    """

    camera: str
    index: int | None
    before: str
    after: str
    shift: CameraShift


def find_moves(
    rig: Rig, frames: Sequence[SpotFrame], match: MatchSpots, *, tolerance_px: float = 1.5
) -> tuple[MidTakeMove, ...]:
    """Cameras that stand elsewhere at the end of a take than at its beginning.

    The rig is refined by the first third of the frames, and judged again by the last third. Then
    the points that the other cameras see in a frame tell in which of its two places a moved camera
    stood. Three cameras and 18 frames are the least; with fewer nothing is found.

    Parameters
    ----------
    rig : Rig
        As it was calibrated.
    frames : sequence of SpotFrame
        In the order of time.
    match : callable
        As `spot_matching.MatchSpots` says.
    tolerance_px : float

    Raises
    ------
    InputError
        If the spots of the first or the last third do not match.
    """
    n = len(frames) // 3
    if n < _LEAST_FRAMES or len(rig) < 3:
        return ()
    first = refine_rig(rig, frames[:n], match, tolerance_px=tolerance_px).calibration.rig
    last = refine_rig(first, frames[-n:], match, pose_sd=_SAME, tolerance_px=tolerance_px)
    found = []
    for shift in last.shifts:
        if shift.is_moved:
            votes = _votes(shift.camera, first, last.calibration.rig, frames, match, tolerance_px)
            index = _step(votes)
            a, b = (0, -1) if index is None else (index - 1, index)
            found.append(MidTakeMove(shift.camera, index, frames[a].name, frames[b].name, shift))
    return tuple(sorted(found, key=lambda move: move.index or 0))


def _votes(
    camera: str,
    first: Rig,
    last: Rig,
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    tolerance_px: float,
) -> NDArray[np.int64]:
    """(T,) -1 where a camera's spots fit its first place better, 1 its last, 0 undecided."""
    c = first.names.index(camera)
    others = [i for i in range(len(first)) if i != c]
    rest = Rig({first.names[i]: first[first.names[i]] for i in others})
    poses = [pose_of(rest[n]) for n in rest]
    votes = []
    for frame in frames:
        centres = [frame.centres[i] for i in others]
        rows = match(rest, centres, [frame.sd_px[i] for i in others], tolerance_px)
        xy = np.full((*rows.shape, 2), np.nan)
        for k, name in enumerate(rest):
            seen = rows[:, k] >= 0
            xy[seen, k] = rest[name].undistort(centres[k][rows[seen, k]])
        X = nearest_points(poses, xy)
        off = [_off_px(rig[camera].project(X), frame.centres[c]) for rig in (first, last)]
        votes.append(int(np.sign(off[0] - off[1])))
    return np.array(votes)


def _off_px(expected: Floats, spots: Floats) -> float:
    """How far spots lie from expected places, each counted up to a limit."""
    known = expected[np.isfinite(expected).all(axis=1)]
    if not len(known) or not len(spots):
        return 0.0
    d, _ = cKDTree(known).query(spots)
    return float(np.minimum(d, _FAR_PX).sum())


def _step(votes: NDArray[np.int64]) -> int | None:
    """Where votes change from -1 to 1, if they do so cleanly."""
    scores = [float(votes[i:].sum() - votes[:i].sum()) for i in range(1, len(votes))]
    i = int(np.argmax(scores)) + 1
    clean = (votes[:i] < 0).mean() >= _CLEAR and (votes[i:] > 0).mean() >= _CLEAR
    return i if clean else None
