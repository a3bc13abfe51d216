"""A board in videos: found in their frames, between frames, and in step with other cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.camera import Camera
from ..core.video import read_frames
from .board_detection import Detection, detect_board
from .board_turns import alternatives
from .board_views import common_rows, mean_apart_px, without_blur
from .grid_order import look_alikes
from .lens import BoardView, board_pose, unusable
from .synchronise import ClockFit

Floats = NDArray[np.float64]
#: Detections this near in time to what is wanted are taken as they are.
_SAME_TIME_S = 1e-4
#: Two frames that a moment lies between may be this far apart, in usual frame distances.
_GAP_FRAMES = 1.5


@dataclass(frozen=True, eq=False)
class TimedDetections:
    """What the frames of a video show of the board.

    Attributes
    ----------
    image_size : (width, height), px
    time_s : (T,) float64, s
        From the video's first frame; of the frames that were looked at.
    detections : tuple of Detection, length T
    frame_s : float, s
        The usual time between frames of the video; NaN if not known.
    """

    image_size: tuple[int, int]
    time_s: Floats
    detections: tuple[Detection, ...]
    frame_s: float = float("nan")


def detect_in_video(
    path: Path,
    board: Board,
    *,
    is_wanted: Callable[[int, float], bool] | None = None,
    number_of: Callable[[int, float], int] | None = None,
    until_s: float = float("inf"),
    on_frame: Callable[[int], None] | None = None,
) -> TimedDetections:
    """Look for a board in frames of a video.

    Parameters
    ----------
    path : Path
    board : Board
    is_wanted : callable, optional
        Told number and time of each frame, says whether to look at it; by default at every one.
    number_of : callable, optional
        Told index and time of each frame, says its number, for its name; by default the index.
    until_s : float, s
        The video is not read further.
    on_frame : callable, optional
        Told the index of every frame read.
    """
    times, found, size = [], [], (0, 0)
    read_s = []
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            if frame.time_s > until_s:
                break
            if on_frame is not None:
                on_frame(frame.index)
            read_s.append(frame.time_s)
            size = frame.image.shape[1], frame.image.shape[0]
            number = frame.index if number_of is None else number_of(frame.index, frame.time_s)
            if is_wanted is not None and not is_wanted(number, frame.time_s):
                continue
            image = np.ascontiguousarray(frame.image)
            times.append(frame.time_s)
            found.append(detect_board(image, board, name=f"frame {number}", thorough=False))
    frame_s = float(np.median(np.diff(read_s))) if len(read_s) > 1 else float("nan")
    return TimedDetections(size, np.array(times), tuple(found), frame_s)


def steady_turns(found: TimedDetections, board: Board) -> TimedDetections:
    """The same, but a board that looks alike when turned is not taken to turn between frames."""
    if len(look_alikes(board)) == 1:
        return found
    last: BoardView | None = None
    steady = []
    for detection in found.detections:
        view = detection.view
        if view is not None and last is not None:
            before = last
            view = min(alternatives(view, board), key=lambda v: mean_apart_px(before, v))
        last = view if view is not None else last
        steady.append(replace(detection, view=view))
    return replace(found, detections=tuple(steady))


def looks_px_s(found: TimedDetections, board: Board, *, within_s: float) -> Floats:
    """How fast the board went through the picture, (T,) float64, px/s: each look and the next.

    The mean over the points that both show; NaN where the next look came later than `within_s`, or
    one of the two shows nothing. The last is NaN.
    """
    steady = steady_turns(found, board)
    speed = np.full(len(found.time_s), np.nan)
    for i in range(len(speed) - 1):
        a, b = steady.detections[i].view, steady.detections[i + 1].view
        took_s = float(found.time_s[i + 1] - found.time_s[i])
        if a is not None and b is not None and took_s <= within_s and len(common_rows(a, b)[0]):
            speed[i] = mean_apart_px(a, b) / took_s
    return speed


def view_at(found: TimedDetections, time_s: float, board: Board, name: str) -> BoardView | None:
    """The board as a video would have shown it at a moment, or None where that is not known.

    Between two frames each point's place is interpolated along a straight line: a hand's motion
    bends little within a frame.
    """
    times = found.time_s
    after = int(np.searchsorted(times, time_s - _SAME_TIME_S))
    if after < len(times) and abs(times[after] - time_s) <= _SAME_TIME_S:
        view = found.detections[after].view
        return None if view is None else replace(view, name=name)
    if not 0 < after < len(times):
        return None
    usual = float(np.median(np.diff(times))) if np.isnan(found.frame_s) else found.frame_s
    if times[after] - times[after - 1] > _GAP_FRAMES * usual:
        return None
    a, b = found.detections[after - 1].view, found.detections[after].view
    if a is None or b is None:
        return None
    share = float((time_s - times[after - 1]) / (times[after] - times[after - 1]))
    b = min(alternatives(b, board), key=lambda v: mean_apart_px(a, v))
    rows_a, rows_b = common_rows(a, b)
    if not len(rows_a):
        return None
    pixels = (1 - share) * a.pixels[rows_a] + share * b.pixels[rows_b]
    return BoardView(name, a.points[rows_a], pixels)


def motion_of(found: TimedDetections, board: Board, camera: Camera) -> tuple[Floats, Floats]:
    """Where the board's middle was, as a camera by itself tells, for synchronisation.

    Two cameras tell it in frames that a rigid motion takes into each other: one is a linear map of
    the other, which coordinates in pictures are not. An error of the lens leaves that nearly so.
    Boards that look alike when turned have the same middle then.

    Parameters
    ----------
    found : TimedDetections
    board : Board
    camera : Camera
        Its intrinsics.

    Returns
    -------
    time_s : (T,) float64, s
    middle : (T, 3) float64, mm, camera frame
        NaN where too little was seen.
    """
    middle = board.object_points().mean(axis=0)
    places = np.full((len(found.time_s), 3), np.nan)
    for i, detection in enumerate(found.detections):
        if detection.view is not None and not unusable(detection.view):
            R, t = board_pose(detection.view, camera)
            places[i] = R @ middle + t
    return found.time_s, places


def views_of_frames(
    found: Mapping[str, TimedDetections], *, max_views: int
) -> dict[str, list[BoardView]]:
    """Sharp views by camera; frames of the same number belong together.

    So many frames at most, evenly over time, of those in which two cameras or more see the board.
    """
    rows: dict[str, dict[str, BoardView]] = {}
    for camera, seen in found.items():
        for detection in without_blur(seen.detections):
            if detection.view is not None and not unusable(detection.view):
                rows.setdefault(detection.name, {})[camera] = detection.view
    ordered = sorted(rows.items(), key=lambda row: int(row[0].split()[1]))
    return _thinned([row for _, row in ordered], list(found), max_views)


def views_at_moments(
    found: Mapping[str, TimedDetections],
    clocks: Mapping[str, ClockFit],
    moments_s: Sequence[tuple[str, float]],
    board: Board,
    *,
    max_views: int,
) -> dict[str, list[BoardView]]:
    """Sharp views of all cameras at the same moments, interpolated between frames.

    Parameters
    ----------
    found : mapping from camera to TimedDetections
    clocks : mapping from camera to ClockFit
        Against the line on which the moments are; cameras that are left out run on it.
    moments_s : sequence of (name, time)
    board : Board
    max_views : int
        So many moments at most, evenly over time, of those that two cameras or more show.
    """
    sharp = {}
    for camera, seen in found.items():
        names = {d.name for d in without_blur(seen.detections)}
        kept = tuple(d if d.name in names else replace(d, view=None) for d in seen.detections)
        sharp[camera] = replace(seen, detections=kept)
    rows = []
    for name, time_s in moments_s:
        row = {}
        for camera, seen in sharp.items():
            at = float(clocks[camera].other_s(time_s)) if camera in clocks else time_s
            view = view_at(seen, at, board, name)
            if view is not None and not unusable(view):
                row[camera] = view
        rows.append(row)
    return _thinned(rows, list(found), max_views)


def _thinned(
    rows: Sequence[Mapping[str, BoardView]], cameras: Sequence[str], most: int
) -> dict[str, list[BoardView]]:
    shared = [row for row in rows if len(row) > 1]
    if len(shared) > most:
        picks = np.linspace(0, len(shared) - 1, most).round().astype(int)
        shared = [shared[i] for i in picks]
    return {c: [row[c] for row in shared if c in row] for c in cameras}
