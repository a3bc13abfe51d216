"""Rolling shutters of the cameras of a take, for `facewright calibrate rig`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from .rig_sightings import Sightings, search

if TYPE_CHECKING:
    from ..capture.board_video import TimedDetections
    from ..capture.shutter_check import BoardSpeed, ShutterCheck
    from ..core.boards import Board
    from ..core.camera import Camera
    from ..core.rig import Rig

_STRETCH_FRAMES, _STRETCHES = 30, 3
#: Where so much of the stretches has been searched already, that was all there is.
_ALL_SEARCHED = 0.9


def speeds_of(seen: Sightings, rig: Rig, pattern: Board) -> dict[str, BoardSpeed]:
    """How fast the board usually went before each camera of a rig; empty for pictures."""
    from ..capture.shutter_check import usual_speed

    return {name: usual_speed(seen.looks[name], pattern, rig[name])
            for name in rig if name in seen.looks}  # fmt: skip


def shutters_of(
    seen: Sightings, rig: Rig, pattern: Board, speeds: Mapping[str, BoardSpeed]
) -> dict[str, ShutterCheck]:
    """What is known of each camera's shutter, from where the board moved most in its video."""
    found = {}
    for name, speed in speeds.items():
        found[name] = _shutter(seen, name, pattern, rig[name], speed)
    return found


def _shutter(
    seen: Sightings, name: str, pattern: Board, camera: Camera, speed: BoardSpeed
) -> ShutterCheck:
    from ..capture.shutter_check import ShutterCheck, busiest_stretches, check_shutter

    looks = seen.looks[name]
    length_s = _STRETCH_FRAMES * looks.frame_s
    stretches = busiest_stretches(looks, pattern, length_s=length_s, most=_STRETCHES)
    if not stretches:
        nan = float("nan")
        reason = f"the board is never seen for {length_s:.2g} s without a break"
        return ShutterCheck(None, reason, speed, nan, nan)
    dense = _dense(seen, name, pattern, looks, stretches)
    return check_shutter(dense, speed, pattern, camera)


def _dense(
    seen: Sightings,
    name: str,
    pattern: Board,
    looks: TimedDetections,
    stretches: Sequence[tuple[float, float]],
) -> TimedDetections:
    """Every frame of the stretches."""
    from dataclasses import replace

    is_inside = _inside(stretches)
    rows = [i for i, t in enumerate(looks.time_s) if is_inside(i, float(t))]
    if len(rows) >= _ALL_SEARCHED * _STRETCH_FRAMES * len(stretches):
        detections = tuple(looks.detections[i] for i in rows)
        return replace(looks, time_s=looks.time_s[rows], detections=detections)
    until_s = max(end for _, end in stretches)
    path = seen.videos[name]
    label = "rolling shutter of"
    return search(name, path, pattern, is_wanted=is_inside, until_s=until_s, label=label)


def _inside(stretches: Sequence[tuple[float, float]]) -> Callable[[int, float], bool]:
    return lambda _, time_s: any(a - 1e-6 <= time_s < b for a, b in stretches)
