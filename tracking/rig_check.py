"""Whether a camera rig belongs to the dots of its take: cameras exchanged, or moved since.

A few frames tell at little cost that all is well. Only if it is not, cameras are tried in each
other's places, and `capture.marker_rig` estimates the rig anew to say which camera moved, how far
and when.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from ..capture.camera_shifts import CameraShift
from ..capture.marker_rig import RigRefinement, refine_rig
from ..capture.mid_take_moves import find_moves
from ..capture.spot_matching import SpotFrame
from ..core.errors import InputError
from ..core.rig import Rig
from .lenses import undistort
from .matching import match_pixels
from .tracker import FrameDots
from .triangulation import Views, triangulate

Floats = NDArray[np.float64]

#: If fewer of a camera's dots meet another camera's, footage and rig do not belong together.
MIN_SHARE_USED = 0.6
_HEALTHY_SHARE, _HEALTHY_PX = 0.85, 0.35
_QUICK_FRAMES, _FRAMES = 12, 48
_TOLERANCE_PX = 1.5
_BETTER = 1.25  # so much more of the dots must meet with two cameras exchanged
_NOTABLE_PX = 0.3  # of pictures moved by a camera's shift; less is told by nobody
_LEAST_DOTS = 4
#: A camera that stands farther off was not knocked: the rig is another take's.
_MAX_KNOCK_MM, _MAX_KNOCK_RAD = 40.0, np.deg2rad(4.0)


@dataclass(frozen=True, eq=False)
class RigVerdict:
    """What a stretch of footage says of its rig.

    Attributes
    ----------
    rigs : tuple of (int, Rig)
        The rig from each of these frames on, the first being frame 0: what was given, or refined.
    moved : tuple of (int, str)
        Cameras that stand elsewhere than in the rig that was given, and from which frame on.
    shifts : tuple of CameraShift
        By how much.
    notes : tuple of str
        The same in words.
    """

    rigs: tuple[tuple[int, Rig], ...]
    moved: tuple[tuple[int, str], ...] = ()
    shifts: tuple[CameraShift, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Agreement:
    """How a rig's dots meet.

    Attributes
    ----------
    share : (C,) of each camera's dots that meet another camera's
    sure_share : (C,) the same of points that three cameras see: two rays cross by chance
    rms_px : (C,) how closely those do
    n_sure : int
        Dots of such points.
    """

    share: Floats
    sure_share: Floats
    rms_px: Floats
    n_sure: int

    @property
    def is_healthy(self) -> bool:
        seen = ~np.isnan(self.share)
        return bool(
            seen.any()
            and (self.share[seen] >= _HEALTHY_SHARE).all()
            and not (self.rms_px[seen] > _HEALTHY_PX).any()
        )


def check_rig(rig: Rig, frames: Sequence[FrameDots]) -> RigVerdict:
    """Hold a rig against the dots of some footage.

    Parameters
    ----------
    rig : Rig
    frames : sequence of FrameDots
        In the order of time; some spread over them are looked at.

    Raises
    ------
    InputError
        If the dots do not meet in space, or do only with two cameras in each other's places.
    """
    fine = RigVerdict(((0, rig),))
    rows = [i for i, f in enumerate(frames) if sum(len(d) >= _LEAST_DOTS for d in f.centres) >= 2]
    if not rows:
        raise InputError(
            "no marker was seen by two cameras at once: are the rig and the videos of one take?"
        )
    quick = [frames[i] for i in _evenly(rows, _QUICK_FRAMES)]
    found = _agreement(rig, quick)
    if found.is_healthy:
        return fine
    if (found.sure_share < MIN_SHARE_USED).any():
        _refuse_exchanged(rig, quick, found)
    chosen = _evenly(rows, _FRAMES)
    verdict = _moved(rig, frames, chosen) if len(rig) > 2 else fine
    if verdict.moved or not (found.share < MIN_SHARE_USED).any():  # False for a blind camera
        return verdict
    lost = [
        f"{name} ({100 * share:.0f} %)"
        for name, share in zip(rig, found.share, strict=True)
        if share < MIN_SHARE_USED
    ]
    raise InputError(
        f"few of the dots of {', '.join(lost)} meet those of other cameras in space: is the "
        "camera rig of this take, is each video named after its camera, has a camera moved, did "
        "all videos start at the same instant?"
    )


def _evenly(rows: Sequence[int], count: int) -> list[int]:
    picked = np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(int)
    return [rows[i] for i in np.unique(picked)]


def _agreement(rig: Rig, frames: Sequence[FrameDots]) -> _Agreement:
    views, C = Views.of([rig[name] for name in rig]), len(rig)
    seen, met, sure, squares = (np.zeros(C) for _ in range(4))
    for frame in frames:
        rows = match_pixels(rig, frame.centres, frame.sd_px, _TOLERANCE_PX)
        seen += [len(d) for d in frame.centres]
        met += (rows >= 0).sum(axis=0)
        rows = rows[(rows >= 0).sum(axis=1) >= min(3, C)]
        sure += (rows >= 0).sum(axis=0)
        xy, sd = np.full((*rows.shape, 2), np.nan), np.full(rows.shape, np.nan)
        for c, camera in enumerate(views.cameras):
            own = rows[:, c] >= 0
            xy[own, c] = undistort(camera, frame.centres[c][rows[own, c]])
            sd[own, c] = 1.0  # the sure ones must not hide that they are off
        points = triangulate(views, xy, sd, tolerance_px=np.inf)
        off = (views.normalised(points.positions) - xy) * views.focal_px[:, None]
        squares += np.nansum(off**2, axis=(0, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        return _Agreement(met / seen, sure / seen, np.sqrt(squares / sure), int(sure.sum()))


def _refuse_exchanged(rig: Rig, frames: Sequence[FrameDots], given: _Agreement) -> None:
    """InputError if the dots meet much better with two cameras in each other's places."""
    names = rig.names
    best, pair = _BETTER * max(given.n_sure, 1), None
    for a, b in combinations(range(len(names)), 2):
        if rig[names[a]].image_size != rig[names[b]].image_size:
            continue
        order = list(range(len(names)))
        order[a], order[b] = b, a
        found = _agreement(rig, [_reordered(f, order) for f in frames])
        if found.n_sure > best and np.nanmin(found.sure_share) > np.nanmin(given.sure_share):
            best, pair = found.n_sure, (names[a], names[b])
    if pair is not None:
        raise InputError(
            f"the videos of {pair[0]} and {pair[1]} are exchanged: their dots meet the other "
            "cameras' only if each is taken for the other's: rename them"
        )


def _reordered(frame: FrameDots, order: Sequence[int]) -> FrameDots:
    centres, sd_px = (tuple(v[i] for i in order) for v in (frame.centres, frame.sd_px))
    return replace(frame, centres=centres, sd_px=sd_px, stamps_s=())


def _moved(rig: Rig, frames: Sequence[FrameDots], chosen: Sequence[int]) -> RigVerdict:
    """Which cameras stand elsewhere than the rig says, from the start or from some frame on."""
    spots = [_spots(frames[i], i) for i in chosen]
    cuts = sorted({0, len(spots), *_cuts(rig, spots)})
    rigs: list[tuple[int, Rig]] = []
    moved: list[tuple[int, str]] = []
    shifts: list[CameraShift] = []
    notes: list[str] = []
    standing: set[str] = set()
    for first, end in pairwise(cuts):
        found = _refined(rig, spots[first:end])
        frame = 0 if first == 0 else chosen[first]
        if found is None or not _explains(found, [frames[i] for i in chosen[first:end]]):
            rigs.append((frame, rig))
            continue
        told = [s for s in found.shifts if s.is_moved and s.picture_px >= _NOTABLE_PX]
        rigs.append((frame, found.calibration.rig if told else rig))
        for shift in told:
            if shift.camera not in standing:
                moved.append((frame, shift.camera))
                shifts.append(shift)
                notes.append(_told(shift, frames[frame].time_s if first else None))
        standing |= {s.camera for s in told}
    if not moved:
        return RigVerdict(((0, rig),))
    return RigVerdict(tuple(rigs), tuple(moved), tuple(shifts), tuple(notes))


def _cuts(rig: Rig, spots: Sequence[SpotFrame]) -> list[int]:
    try:
        moves = find_moves(rig, spots, match_pixels, tolerance_px=_TOLERANCE_PX)
    except InputError:  # a part of the footage does not match at all: judged as a whole
        return []
    return [move.index for move in moves if move.index is not None]


def _refined(rig: Rig, spots: Sequence[SpotFrame]) -> RigRefinement | None:
    try:
        return refine_rig(rig, spots, match_pixels, tolerance_px=_TOLERANCE_PX)
    except InputError:  # nothing that markers could tell; the caller says what is wrong
        return None


def _explains(found: RigRefinement, frames: Sequence[FrameDots]) -> bool:
    """Whether cameras that were merely knocked make the dots meet."""
    if any(
        s.distance_mm > _MAX_KNOCK_MM or s.angle_rad > _MAX_KNOCK_RAD
        for s in found.shifts
        if s.is_moved
    ):
        return False
    quick = [frames[i] for i in _evenly(range(len(frames)), _QUICK_FRAMES)]
    return _agreement(found.calibration.rig, quick).is_healthy


def _spots(frame: FrameDots, index: int) -> SpotFrame:
    return SpotFrame(str(index), frame.centres, frame.sd_px)


def _told(shift: CameraShift, from_s: float | None) -> str:
    when = "before the take" if from_s is None else f"about {from_s:.1f} s into the take"
    return (
        f"{shift.camera} was moved {when}: by {shift.distance_mm:.1f} ± "
        f"{shift.distance_sd_mm:.1f} mm and {np.rad2deg(shift.angle_rad):.2f} ± "
        f"{np.rad2deg(shift.angle_sd_rad):.2f}°, {shift.picture_px:.1f} px in its picture"
    )
