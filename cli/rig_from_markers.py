"""`calibrate rig` without a board: by a wand, or by the performer's own markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..capture.wand_track import WandTrack, at_times
from ..core.errors import InputError
from .marker_spots import SpotMoments, match_by_views, spots_of_videos
from .options import note
from .progress import Ticks
from .wand_videos import follow_wand, wand_clocks

if TYPE_CHECKING:
    from ..capture.calibration_take import TakeCamera
    from ..capture.camera_shifts import CameraShift
    from ..capture.mid_take_moves import MidTakeMove
    from ..capture.rigs import RigCalibration
    from ..capture.synchronise import ClockFit
    from ..core.camera import Camera
    from ..core.rig import Rig

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WandResult:
    """A rig from a wand, with all that its report tells.

    Attributes
    ----------
    found : RigCalibration
    balls_mm : tuple of float
    pixels : mapping from camera to (T, B, 2) float64, px
        As handed to the solver, in the order of `moments`.
    moments : tuple of str
    clocks : mapping from camera to ClockFit
        Against the first camera; empty if nothing was synchronised.
    """

    found: RigCalibration
    balls_mm: tuple[float, ...]
    pixels: Mapping[str, Floats]
    moments: tuple[str, ...]
    clocks: Mapping[str, ClockFit]


@dataclass(frozen=True, eq=False)
class MarkerResult:
    """An existing rig against the performer's markers.

    Attributes
    ----------
    found : RigCalibration
        Refined.
    before : Rig
        The cameras that the take has, as they were given.
    shifts : tuple of CameraShift
        One a camera: moved or not, by how much.
    moves : tuple of MidTakeMove
        Cameras that moved while the take ran; then the rest is of its longest part.
    moments : SpotMoments
    points : (P, 3) float64, mm, world frame
        Markers of all moments used.
    """

    found: RigCalibration
    before: Rig
    shifts: tuple[CameraShift, ...]
    moves: tuple[MidTakeMove, ...]
    moments: SpotMoments
    points: Floats


def parse_wand(text: str) -> tuple[float, ...]:
    """``"0,45,120"`` as places of a wand's balls, mm.

    Raises
    ------
    InputError
        If it is no list of growing numbers.
    """
    from ..capture.wand_detection import checked_balls

    try:
        places = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--wand {text}: expected the places of its balls along it in mm, such as 0,45,120"
        ) from None
    checked_balls(places)
    return places


def rig_by_wand(
    cameras: Sequence[TakeCamera],
    balls_mm: Sequence[float],
    lenses: Mapping[str, Camera],
    *,
    model: str | None = None,
    clocks: Mapping[str, ClockFit] | None = None,
    by_motion: bool = False,
    max_offset_s: float = 30.0,
    max_moments: int = 400,
) -> WandResult:
    """Find the wand in the videos of a take and place the cameras by it.

    Parameters
    ----------
    cameras : sequence of TakeCamera
        Videos.
    balls_mm : sequence of float
        Places of the balls along the wand.
    lenses : mapping from camera to Camera
    model : str, optional
        Refine the lenses too, with this model of `capture.lens.LENS_MODELS`.
    clocks : mapping from camera to ClockFit, optional
        Against the first camera, as found from sound or a flash. Without them (and without
        `by_motion`) videos began together.
    by_motion : bool
        Find the clocks from the wand's motion.
    max_offset_s : float
        Of that search.
    max_moments : int
        That many at most are used, evenly over those that two cameras or more show.

    Raises
    ------
    InputError, FileFormatError
        If the take has no videos, the wand is hardly seen, or a file is damaged.
    """
    from ..capture.wand_rig import calibrate_wand

    videos = _videos(cameras, "a wand is found in videos")
    lacking = [n for n in videos if n not in lenses]
    if lacking:
        raise InputError(f"no lens for {', '.join(lacking)}: a wand needs known lenses (--lenses)")
    tracks = _followed(videos, lenses, balls_mm)
    _check_seen(tracks, balls_mm)
    if by_motion:
        clocks = wand_clocks(tracks, lenses, balls_mm, max_offset_s)
    clocks = dict(clocks or {})
    times, named = _moments(tracks, clocks)
    pixels, sd = {}, {}
    for name, track in tracks.items():
        pixels[name], sd[name] = at_times(track, times[name])
    rows = _shared_rows(pixels, max_moments)
    moments = [named[i] for i in rows]
    pixels = {n: p[rows] for n, p in pixels.items()}
    found = calibrate_wand(
        pixels, lenses, balls_mm,
        refine=dict.fromkeys(videos, model) if model else None,
        spot_sd={n: s[rows] for n, s in sd.items()},
        names=moments,
    )  # fmt: skip
    return WandResult(found, tuple(balls_mm), pixels, tuple(moments), clocks)


def rig_by_markers(
    cameras: Sequence[TakeCamera],
    rig: Rig,
    *,
    max_frames: int = 60,
    span_s: tuple[float, float] | None = None,
    level: float | None = None,
) -> MarkerResult:
    """Refine a rig by the markers in the videos of a take, and say which cameras were moved.

    Parameters
    ----------
    cameras : sequence of TakeCamera
        Videos that began together, named after the rig's cameras.
    rig : Rig
        As it was calibrated.
    max_frames : int
        So many moments, evenly over the take.
    span_s : (first, last), s, optional
        Use this part of the take only.
    level : float, optional
        Grey level above which a pixel is a marker's; found by default.

    Raises
    ------
    InputError, FileFormatError
        If videos and rig do not fit, no markers are seen, or a file is damaged.
    """
    from ..capture.marker_rig import refine_rig
    from ..capture.mid_take_moves import find_moves
    from ..tracking.videos import match_videos_to_rig

    videos = _videos(cameras, "markers are found in videos")
    present, paths = match_videos_to_rig(list(videos.values()), rig)
    moments = spots_of_videos(paths, present, max_frames=max_frames, span_s=span_s, level=level)
    moves = find_moves(present, moments.frames, match_by_views)
    cuts = [m.index for m in moves if m.index is not None]
    used = _longest_part(len(moments.frames), cuts)
    refined = refine_rig(present, moments.frames[used], match_by_views)
    said = [_move_told(m, moments, used) for m in moves]
    found = replace(refined.calibration, warnings=(*said, *refined.calibration.warnings))
    return MarkerResult(found, present, refined.shifts, moves, moments, refined.points)


def _longest_part(n: int, cuts: Sequence[int]) -> slice:
    """The longest run of frames between cuts."""
    ends = [0, *sorted(cuts), n]
    first, last = max(pairwise(ends), key=lambda part: part[1] - part[0])
    return slice(first, last)


def _move_told(move: MidTakeMove, moments: SpotMoments, used: slice) -> str:
    by = f"{move.shift.distance_mm:.2g} mm and {np.rad2deg(move.shift.angle_rad):.2g}°"
    if move.index is None:
        return (
            f"{move.camera} stands {by} elsewhere at the end of the take than at its beginning, "
            "but did not move at once: fix it to its tripod, and refine shorter parts of the take"
        )
    at = float(moments.time_s[move.index - 1 : move.index + 1].mean())
    first, last = moments.time_s[used.start], moments.time_s[used.stop - 1]
    return (
        f"{move.camera} moved in mid-take, by {by} at about {at:.2f} s (between {move.before} and "
        f"{move.after}): the result is of {first:.2f} to {last:.2f} s only; track what is before "
        "and what is after with rigs of their own"
    )


def _videos(cameras: Sequence[TakeCamera], told: str) -> dict[str, Path]:
    videos = {c.name: c.video for c in cameras if c.video is not None}
    if len(videos) < len(cameras):
        raise InputError(f"{told}: this take has folders of pictures")
    if len(videos) < 2:
        raise InputError(f"{told}: two cameras at least are needed, got {len(videos)}")
    return videos


def _followed(
    videos: Mapping[str, Path], lenses: Mapping[str, Camera], balls_mm: Sequence[float]
) -> dict[str, WandTrack]:
    from ..core.video import probe_video

    tracks = {}
    for name, path in videos.items():
        with Ticks(probe_video(path).n_frames, f"looking for the wand in {name}") as tick:
            tracks[name] = follow_wand(path, lenses[name], balls_mm, on_frame=tick)
    return tracks


def _check_seen(tracks: Mapping[str, WandTrack], balls_mm: Sequence[float]) -> None:
    """Say how often the wand was found; refuse a take that never shows it."""
    shares = {name: float(track.is_seen.mean()) for name, track in tracks.items()}
    told = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items())
    if not any(shares.values()):
        places = ",".join(f"{b:g}" for b in balls_mm)
        raise InputError(
            f"no frame shows a wand of {len(balls_mm)} bright balls at {places} mm: are they "
            "brighter than all around them, and their places right?"
        )
    note(f"frames that show the wand: {told}")


def _moments(
    tracks: Mapping[str, WandTrack], clocks: Mapping[str, ClockFit]
) -> tuple[dict[str, Floats], list[str]]:
    """Each camera's time of the first camera's frames, and what those are called."""
    from ..capture.frame_stamps import match_frames

    first = next(iter(tracks))
    base = tracks[first].time_s
    names = [f"frame {i}" for i in range(len(base))]
    if clocks:
        return {n: clocks[n].other_s(base) if n in clocks else base for n in tracks}, names
    match = match_frames({name: track.time_s for name, track in tracks.items()})
    for told in (match.note, match.warning):
        if told:
            note(told)
    if match.beat_s is None:
        return dict.fromkeys(tracks, base), names
    beats = np.rint(base / match.beat_s[first])
    return {name: beats * match.beat_s[name] for name in tracks}, names


def _shared_rows(pixels: Mapping[str, Floats], most: int) -> NDArray[np.int64]:
    """Moments that two cameras or more show, so many at most, evenly."""
    seen = np.stack([np.isfinite(p[..., 0]).all(axis=1) for p in pixels.values()])
    rows = np.flatnonzero(seen.sum(axis=0) >= 2)
    picks = np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(np.int64)
    return rows[picks].astype(np.int64)
