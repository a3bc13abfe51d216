"""From the pictures or videos of a calibration to what each camera saw of the board, and when."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.errors import FileFormatError, InputError
from ..core.video import read_frames
from .board_detection import Detection, detect_board
from .board_turns import alternatives
from .grid_order import look_alikes
from .lens import BoardView, RejectedView, unusable
from .synchronise import ClockFit

Floats = NDArray[np.float64]
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mts")
_MAX_PIXELS = 400_000_000
#: Detections this near in time to what is wanted are taken as they are.
_SAME_TIME_S = 1e-4
#: Two frames that a moment lies between may be this far apart, in usual frame distances.
_GAP_FRAMES = 1.5
_BLUR_TIMES, _BLUR_PX = 1.6, 0.4
#: Views whose points lie this near to each other's on average show the same pose.
_REPEATED_PX = 0.5


@dataclass(frozen=True)
class TakeCamera:
    """What one camera recorded: pictures, or one video.

    Attributes
    ----------
    name : str
    pictures : tuple of Path
    video : Path or None
    """

    name: str
    pictures: tuple[Path, ...] = ()
    video: Path | None = None


@dataclass(frozen=True, eq=False)
class TimedDetections:
    """What the frames of a video show of the board.

    Attributes
    ----------
    image_size : (width, height), px
    time_s : (T,) float64, s
        From the video's first frame; of the frames that were looked at.
    detections : tuple of Detection, length T
    """

    image_size: tuple[int, int]
    time_s: Floats
    detections: tuple[Detection, ...]


def find_take(folder: Path) -> tuple[TakeCamera, ...]:
    """The cameras of a folder: subfolders with pictures, or videos named after the cameras.

    Raises
    ------
    InputError
        If there are neither, both, or only one camera's.
    OSError
        If the folder cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder with a video or a folder for each camera")
    entries = sorted(folder.iterdir(), key=_natural)
    videos = [p for p in entries if p.is_file() and p.suffix.lower() in VIDEO_SUFFIXES]
    stills = []
    for entry in entries:
        if entry.is_dir():
            pictures = pictures_in(entry)
            if pictures:
                stills.append(TakeCamera(entry.name, pictures))
    if videos and stills:
        raise InputError(
            f"{folder} has videos ({videos[0].name}) and folders of pictures ({stills[0].name}): "
            "expected one or the other"
        )
    cameras = tuple(stills) or tuple(TakeCamera(v.stem, video=v) for v in videos)
    if len(cameras) < 2:
        found = f"only {cameras[0].name}" if cameras else "none"
        raise InputError(
            f"{folder}: expected two cameras or more (cam0.mp4, cam1.mp4, ... or folders "
            f"cam0/, cam1/, ... of pictures with the same names), found {found}"
        )
    names = [camera.name for camera in cameras]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{folder}: two videos are named {twice[0]}")
    return cameras


def pictures_in(folder: Path) -> tuple[Path, ...]:
    """The pictures of a folder, by name (numbers by their value)."""
    found = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in PICTURE_SUFFIXES]
    return tuple(sorted(found, key=_natural))


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in parts]


def read_picture(path: Path) -> NDArray[np.uint8]:
    """A picture's grey values (h, w) uint8, turned as its camera noted.

    Raises
    ------
    FileFormatError
        If it is no picture, is cut off, or is absurdly large.
    OSError
        If it cannot be read.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    if path.is_dir():
        raise FileFormatError(path, "path", "a picture", "a folder")
    try:
        with Image.open(path) as opened:
            if opened.width * opened.height > _MAX_PIXELS:
                found = f"{opened.width}x{opened.height}"
                raise FileFormatError(path, "header", f"at most {_MAX_PIXELS} pixels", found)
            upright = ImageOps.exif_transpose(opened)
            if upright.mode.startswith(("I", "F")):
                return _eight_bits(np.asarray(upright, dtype=np.float64))
            return np.array(upright.convert("L"), dtype=np.uint8)
    except UnidentifiedImageError:
        found = "an empty file" if path.stat().st_size == 0 else "something else"
        raise FileFormatError(path, "file", "a picture", found) from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        if isinstance(error, FileFormatError) or getattr(error, "errno", None):
            raise  # the system's own word: not there, no permission
        raise FileFormatError(path, "file", "a whole picture", f"damage ({error})") from error


def _eight_bits(values: Floats) -> NDArray[np.uint8]:
    """Grey values of more bits, from the darkest to the brightest."""
    low, high = float(values.min()), float(values.max())
    return np.asarray(np.rint((values - low) * (255 / max(high - low, 1e-9))), np.uint8)


def check_sizes(sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    """The one size of all pictures.

    Raises
    ------
    InputError
        ``pictures of one size are needed: 12 are 640x480, but b.png is 480x640``
    """
    counts: dict[tuple[int, int], int] = {}
    for size in sizes.values():
        counts[size] = counts.get(size, 0) + 1
    usual = max(counts, key=lambda s: counts[s])
    odd = [f"{n} is {s[0]}x{s[1]}" for n, s in sizes.items() if s != usual]
    if odd:
        more = f" and {len(odd) - 4} more are not" if len(odd) > 4 else ""
        raise InputError(
            f"pictures of one size (one camera, one setting) are needed: {counts[usual]} "
            f"{'is' if counts[usual] == 1 else 'are'} {usual[0]}x{usual[1]}, but "
            f"{', '.join(odd[:4])}{more}"
        )
    return usual


def detect_in_pictures(
    paths: Iterable[Path], board: Board, *, names: Callable[[Path], str]
) -> tuple[tuple[int, int], list[Detection]]:
    """Look for a board in the pictures of one camera.

    Returns
    -------
    image_size : (width, height), px
    list of Detection
        One for each picture, named by `names`.

    Raises
    ------
    InputError
        If the pictures differ in size.
    FileFormatError
        If one is no picture.
    """
    sizes: dict[str, tuple[int, int]] = {}
    found = []
    for path in paths:
        image = read_picture(path)
        sizes[names(path)] = image.shape[1], image.shape[0]
        found.append(detect_board(image, board, name=names(path)))
    if not found:
        raise InputError("no pictures given")
    return check_sizes(sizes), found


def detect_in_video(
    path: Path,
    board: Board,
    *,
    every_s: float | None = None,
    is_wanted: Callable[[int, float], bool] | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> TimedDetections:
    """Look for a board in frames of a video.

    Parameters
    ----------
    path : Path
    board : Board
    every_s : float, optional
        Look at one frame in so long; by default at every frame.
    is_wanted : callable, optional
        Told index and time of each frame, says whether to look at it; instead of `every_s`.
    on_frame : callable, optional
        Told the index of every frame read.
    """
    times, found, size = [], [], (0, 0)
    due_s = -np.inf
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            if on_frame is not None:
                on_frame(frame.index)
            size = frame.image.shape[1], frame.image.shape[0]
            if is_wanted is not None and not is_wanted(frame.index, frame.time_s):
                continue
            if is_wanted is None and every_s is not None:
                if frame.time_s < due_s - 1e-6:
                    continue
                due_s = frame.time_s + every_s
            image = np.ascontiguousarray(frame.image)
            name = f"frame {frame.index}"
            times.append(frame.time_s)
            found.append(detect_board(image, board, name=name, thorough=False))
    return TimedDetections(size, np.array(times), tuple(found))


def without_blur(detections: Sequence[Detection]) -> list[Detection]:
    """Those with a view that is not much more blurred than the sharper ones are."""
    seen = [d for d in detections if d.view is not None]
    if not seen:
        return []
    blur = np.array([d.sharpness_px for d in seen])
    if np.isnan(blur).all():
        return seen
    usual = float(np.nanpercentile(blur, 25))
    limit = max(_BLUR_TIMES * usual, usual + _BLUR_PX)
    return [d for d, b in zip(seen, blur, strict=True) if not b > limit]


def without_repeats(views: Sequence[BoardView]) -> tuple[list[BoardView], list[RejectedView]]:
    """Views, but each way of holding the board only once.

    A picture taken twice has the same errors twice: it says nothing new of the lens, but would
    make it look surer.
    """
    kept: list[BoardView] = []
    repeated = []
    for view in views:
        same = next((k.name for k in kept if _apart(view, k) < _REPEATED_PX), None)
        if same is None:
            kept.append(view)
        else:
            reason = f"the board lies as in {same}: nothing new; move it between pictures"
            repeated.append(RejectedView(view.name, reason))
    return kept, repeated


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
    usual = float(np.median(np.diff(times)))
    if times[after] - times[after - 1] > _GAP_FRAMES * usual:
        return None
    a, b = found.detections[after - 1].view, found.detections[after].view
    if a is None or b is None:
        return None
    share = float((time_s - times[after - 1]) / (times[after] - times[after - 1]))
    b = min(alternatives(b, board), key=lambda v: _apart(a, v))
    rows_a, rows_b = _common(a, b)
    if not len(rows_a):
        return None
    pixels = (1 - share) * a.pixels[rows_a] + share * b.pixels[rows_b]
    return BoardView(name, a.points[rows_a], pixels)


def _common(a: BoardView, b: BoardView) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the points that both show."""
    at = {tuple(p): i for i, p in enumerate(np.round(b.points, 6).tolist())}
    pairs = [
        (i, at[tuple(p)]) for i, p in enumerate(np.round(a.points, 6).tolist()) if tuple(p) in at
    ]
    found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _apart(a: BoardView, b: BoardView) -> float:
    rows_a, rows_b = _common(a, b)
    if not len(rows_a):
        return float("inf")
    return float(np.linalg.norm(a.pixels[rows_a] - b.pixels[rows_b], axis=1).mean())


def motion_of(found: TimedDetections, board: Board) -> tuple[Floats, Floats]:
    """How the board moved in a video's pictures, for synchronisation.

    Returns
    -------
    time_s : (T,) float64, s
    signals : (T, K) float64, px
        The places of the board's outer points. For a board that looks alike when turned, what does
        not depend on how it was held: its points' middle and their spread (the square root of
        their covariance). NaN where it was not seen whole.
    """
    n, outer = len(board.object_points()), _outer_points(board)
    is_known = len(look_alikes(board)) == 1
    signals = np.full((len(found.time_s), 2 * len(outer) if is_known else 5), np.nan)
    for i, detection in enumerate(found.detections):
        if detection.view is None or len(detection.view.points) != n:
            continue
        pixels = detection.view.pixels
        if is_known:
            signals[i] = pixels[outer].ravel()
        else:
            values, vectors = np.linalg.eigh(np.cov(pixels.T))
            spread = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
            signals[i] = [*pixels.mean(axis=0), spread[0, 0], spread[0, 1], spread[1, 1]]
    return found.time_s, signals


def _outer_points(board: Board) -> list[int]:
    """The points that lie farthest out in each diagonal direction."""
    p = board.object_points()[:, :2]
    ways = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return [int(np.argmax(p @ way)) for way in ways]


def views_of_pictures(found: Mapping[str, Sequence[Detection]]) -> dict[str, list[BoardView]]:
    """Views by camera, named by what belongs together: the picture's name, or the frame."""
    return {c: [d.view for d in seen if d.view is not None] for c, seen in found.items()}


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
