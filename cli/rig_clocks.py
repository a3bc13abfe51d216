"""Bringing the videos of a take into step for `facewright calibrate rig`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .progress import Ticks

if TYPE_CHECKING:
    from ..capture.board_video import TimedDetections
    from ..capture.flashes import Flash
    from ..capture.synchronise import ClockFit
    from ..core.boards import Board
    from ..core.camera import Camera

#: The ways there are, as `--sync` names them.
SYNCS = ("none", "sound", "flash", "flash-light", "motion")
#: A best offset so near to the end of the search is none.
_AT_LIMIT = 0.97
_LENS_VIEWS, _MIN_LENS_VIEWS, _ROUGH_MODEL = 24, 4, "radial1"


@dataclass(frozen=True)
class Step:
    """How videos are brought into step.

    Attributes
    ----------
    by : str
        One of `SYNCS`.
    max_offset_s : float, s
        How far apart they may have begun.
    exposure_s : float, s
        Of a frame, for flashes; 0 if not known.
    """

    by: str = "none"
    max_offset_s: float = 30.0
    exposure_s: float = 0.0


def clocks_of(videos: Mapping[str, Path], step: Step) -> dict[str, ClockFit]:
    """The clock of every camera but the first, against the first, by sound or flash.

    Raises
    ------
    InputError
        If they have none in common.
    """
    if step.by == "sound":
        return clocks_by_sound(videos, step.max_offset_s)
    by_light = step.by == "flash-light"
    return clocks_by_flash(videos, step.max_offset_s, step.exposure_s, by_light=by_light)


def clocks_by_sound(videos: Mapping[str, Path], max_offset_s: float) -> dict[str, ClockFit]:
    """The clock of every camera but the first, against the first."""
    from ..capture.synchronise import synchronise_sound
    from ..core.audio import read_audio

    first, *others = videos
    reference = read_audio(videos[first])
    clocks = {}
    for name in others:
        heard = read_audio(videos[name])
        try:
            clocks[name] = synchronise_sound(reference, heard, max_offset_s=max_offset_s)
        except InputError as error:
            raise InputError(f"{videos[name]} against {first}: {error}") from error
    return clocks


def clocks_by_flash(
    videos: Mapping[str, Path], max_offset_s: float, exposure_s: float, *, by_light: bool
) -> dict[str, ClockFit]:
    """The clock of every camera but the first, against the first."""
    from ..capture.flash_match import synchronise_by_flashes

    first, *others = videos
    seen = {name: _flashes(name, path, exposure_s, by_light) for name, path in videos.items()}
    clocks = {}
    for name in others:
        try:
            clocks[name] = synchronise_by_flashes(
                seen[first], seen[name], max_offset_s=max_offset_s, by_light=by_light
            )
        except InputError as error:
            raise InputError(f"{videos[name]} against {first}: {error}") from error
    return clocks


def _flashes(name: str, path: Path, exposure_s: float, by_light: bool) -> tuple[Flash, ...]:
    from ..capture.flash_match import clear_flashes, frame_brightness
    from ..core.video import probe_video

    with Ticks(probe_video(path).n_frames, f"looking for a flash in {name}") as tick:
        seen = frame_brightness(path, on_frame=tick)
    try:
        return clear_flashes(seen, exposure_s, whole=by_light)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def clocks_by_motion(
    seen: Mapping[str, TimedDetections],
    pattern: Board,
    max_offset_s: float,
    known: Mapping[str, Camera],
) -> dict[str, ClockFit]:
    """The clock of every camera but the first, against the first.

    Parameters
    ----------
    seen : mapping from camera to TimedDetections
        Of all frames.
    pattern : Board
    max_offset_s : float
    known : mapping from camera to Camera
        Lenses; those that are not known are found from what is seen.

    Raises
    ------
    InputError
        If the motion does not tell an offset, or too little is seen for a lens.
    """
    from ..capture.board_video import motion_of
    from ..capture.synchronise import synchronise_motion

    first, *others = seen
    lenses = {n: known[n] if n in known else _rough_lens(n, s) for n, s in seen.items()}
    reference = motion_of(seen[first], pattern, lenses[first])
    clocks = {}
    for name in others:
        other = motion_of(seen[name], pattern, lenses[name])
        # half of both must overlap, or a short stretch may fit by chance
        most_s = min(max_offset_s, 0.5 * float(min(reference[0][-1], other[0][-1])))
        try:
            clock = synchronise_motion(*reference, *other, max_offset_s=most_s)
        except InputError as error:
            raise InputError(f"{name} against {first}: {error}") from error
        if abs(clock.offset_s) > _AT_LIMIT * most_s:
            raise InputError(
                f"{name} against {first}: within {most_s:.2g} s the board's motion does not tell "
                "the offset; move it faster and for longer, or say how little it can be with "
                "--max-offset"
            )
        clocks[name] = clock
    return clocks


def _rough_lens(name: str, seen: TimedDetections) -> Camera:
    """Good enough to tell where the board was."""
    from ..capture.board_views import without_blur, without_repeats
    from ..capture.lens import calibrate_board

    sharp = [d.view for d in without_blur(seen.detections) if d.view is not None]
    few, _ = without_repeats(sharp[:: max(1, len(sharp) // _LENS_VIEWS)])
    if len(few) < _MIN_LENS_VIEWS:
        raise InputError(
            f"{name} shows the board in {len(few)} different poses: too few to bring it into step "
            "by its motion; move it more, or give --lenses"
        )
    return calibrate_board(few, seen.image_size, model=_ROUGH_MODEL).camera
