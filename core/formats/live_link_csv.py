"""ARKit weights over time as CSV, as Live Link Face and its kin write them.

The first line names the columns; each further line is a frame::

    Timecode,BlendShapeCount,EyeBlinkLeft,EyeLookDownLeft,…,TongueOut,HeadYaw,…,RightEyeRoll
    10:24:31:07.482,61,0.0312,0,…

A time code is ``hours:minutes:seconds:frames``, the frames with decimals; how many frames make a
second is not in the file. A column ``time_s``, ``time`` or ``timestamp`` (seconds) may stand in its
place. Columns are found by name, in any order and case; the nine rotations may be missing, and
columns that are none of ours are left out, with a warning.
"""

from __future__ import annotations

import logging
import math
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..clip import Clip
from ..errors import FileFormatError, InputError
from ..files import atomic_write, read_text

_log = logging.getLogger(__name__)

#: The 52 shapes, in the order in which the app writes them.
ARKIT_SHAPES = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft",
    "eyeSquintLeft", "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight",
    "eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight", "eyeWideRight", "jawForward",
    "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRight",
    "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight",
    "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft",
    "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft",
    "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft",
    "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft",
    "noseSneerRight", "tongueOut",
)  # fmt: skip
#: Rotations, radians. The axes are those of an ARKit face, which are the head's: x to the
#: subject's left, y up, z out of the face; yaw, pitch and roll are about y, x and z.
ROTATIONS = (
    "headYaw", "headPitch", "headRoll", "leftEyeYaw", "leftEyePitch", "leftEyeRoll",
    "rightEyeYaw", "rightEyePitch", "rightEyeRoll",
)  # fmt: skip
CHANNELS = (*ARKIT_SHAPES, *ROTATIONS)
#: The app's usual rate, and those that a file's time codes are taken for, frames/s.
USUAL_RATE = 60
_RATES = (24, 25, 30, 50, 60, 100, 120)
#: Frame numbers are written with three decimals.
_EVEN_FRAMES = 4e-3
_TIME_NAMES = ("timecode", "time_s", "time", "timestamp")
_COUNT_NAME = "blendshapecount"
_MAX_BYTES = 256 * 1024 * 1024
_MAX_SHOWN = 40
_DAY_S = 24 * 3600.0
_TIMECODE = re.compile(r"(\d{1,3}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d+)?)")


def read_live_link_csv(path: Path, *, timecode_rate: float | None = None) -> Clip:
    """Read a clip of ARKit weights.

    Parameters
    ----------
    path : Path
    timecode_rate : float or None
        Frames of the time code that make a second. None: the number at which the file's seconds
        end, where its frames are evenly spaced; else the app's 60, or the nearest usual rate above
        the largest frame number where the file crosses a whole second.

    Returns
    -------
    Clip
        Channels `ARKIT_SHAPES` and `ROTATIONS` that the file has, in their order; time from the
        first frame. An empty cell is not set.

    Raises
    ------
    FileFormatError
        ``take.csv, line 7: expected 63 values, found 62``. Times must increase from line to line;
        a time code may pass midnight.
    OSError
        If the file cannot be read.
    """
    lines = [
        (number, line)
        for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1)
        if line.strip(" \t\ufeff") and not line.lstrip("\ufeff").startswith("#")
    ]
    if not lines:
        raise FileFormatError(path, "file", "a line that names the columns", "none")
    first, header = lines[0]
    separator = max(",;\t", key=header.count)
    names = [cell.strip(' "\ufeff') for cell in header.split(separator)]
    time_column, columns = _columns(path, first, names)
    if len(lines) < 2:
        raise FileFormatError(path, "file", "frames", "only the line that names the columns")
    rows = []
    for number, line in lines[1:]:
        cells = [cell.strip(' "') for cell in line.split(separator)]
        if len(cells) != len(names):
            raise FileFormatError(path, f"line {number}", f"{len(names)} values", str(len(cells)))
        rows.append(cells)
    numbers = [number for number, _ in lines[1:]]
    time_s = _times(path, numbers, [row[time_column] for row in rows], timecode_rate)
    channels = tuple(c for c in CHANNELS if c in columns)
    values = np.array(
        [
            [_number(path, n, c, row[columns[c]]) for c in channels]
            for n, row in zip(numbers, rows, strict=True)
        ]
    )
    return Clip(time_s, channels, values.reshape(len(rows), len(channels)))


def _columns(path: Path, line: int, names: list[str]) -> tuple[int, dict[str, int]]:
    """Where the time stands, and each channel."""
    where = f"line {line}"
    lower = [name.lower() for name in names]
    times = [lower.index(name) for name in _TIME_NAMES if name in lower]
    if not times:
        raise FileFormatError(
            path, where, "a column Timecode (or time_s), and ARKit's shapes", _shown(names)
        )
    known = {c.lower(): c for c in CHANNELS}
    found: dict[str, int] = {}
    for i, name in enumerate(lower):
        channel = known.get(name)
        if channel in found:
            raise FileFormatError(path, where, f"one column {channel}", "two")
        if channel is not None:
            found[channel] = i
    if not found:
        raise FileFormatError(path, where, "columns named like ARKit's shapes", _shown(names))
    used = {*times, *found.values()}
    others = [n for i, n in enumerate(names) if i not in used and lower[i] != _COUNT_NAME]
    if others:
        _log.warning("%s: columns left out: %s", path, _shown(others))
    return times[0], found


def _times(
    path: Path, numbers: list[int], cells: list[str], rate: float | None
) -> NDArray[np.float64]:
    if _TIMECODE.fullmatch(cells[0]) is None:
        found = np.array([_seconds(path, n, c) for n, c in zip(numbers, cells, strict=True)])
    else:
        found = _timecodes(path, numbers, cells, rate)
    late = np.flatnonzero(np.diff(found) <= 0)
    if len(late):
        k = int(late[0]) + 1
        expected = f"a time after the line before's, {cells[k - 1]}"
        raise FileFormatError(path, f"line {numbers[k]}", expected, cells[k])
    return np.asarray(found - found[0])


def _seconds(path: Path, line: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        expected = "a time code like 10:24:31:07.482, or seconds"
        raise FileFormatError(path, f"line {line}", expected, _quoted(cell))
    return value


def _timecodes(
    path: Path, numbers: list[int], cells: list[str], rate: float | None
) -> NDArray[np.float64]:
    whole, frames = [], []
    for number, cell in zip(numbers, cells, strict=True):
        match = _TIMECODE.fullmatch(cell)
        if match is None:
            expected = "a time code like 10:24:31:07.482"
            raise FileFormatError(path, f"line {number}", expected, _quoted(cell))
        hours, minutes, seconds = (int(part) for part in match.groups()[:3])
        whole.append(3600.0 * hours + 60.0 * minutes + seconds)
        frames.append(float(match[4]))
    used = _rate(np.array(whole), np.array(frames)) if rate is None else float(rate)
    if not used > max(frames):
        k = int(np.argmax(frames))
        expected = f"a frame below {used:g}, the frames of a second"
        raise FileFormatError(path, f"line {numbers[k]}", expected, cells[k])
    found = np.array(whole) + np.array(frames) / used
    midnights = np.concatenate([[0.0], np.cumsum(np.diff(found) < -_DAY_S / 2)])
    return np.asarray(found + _DAY_S * midnights)


def _rate(whole: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    """The rate that the frame numbers speak for."""
    counted = _counted_rate(whole, frames)
    if counted is not None:
        return counted
    full = len(set(whole.tolist())) >= 3  # a whole second from its first frame to its last
    lowest = frames.max() if full else max(frames.max(), USUAL_RATE - 1)
    return float(next((r for r in _RATES if lowest < r), math.floor(lowest) + 1))


def _counted_rate(whole: NDArray[np.float64], frames: NDArray[np.float64]) -> float | None:
    """The frame number at which a second ends, where steps are even and all ends agree."""
    is_next = np.diff(whole) == 1
    steps = np.diff(frames)[np.diff(whole) == 0]
    if not is_next.any() or not len(steps) or np.ptp(steps) > _EVEN_FRAMES:
        return None
    ends = frames[:-1][is_next] + float(np.median(steps)) - frames[1:][is_next]
    for rate in (*_RATES, *(r * 1000 / 1001 for r in (24, 30, 60, 120))):
        if np.abs(ends - rate).max() < _EVEN_FRAMES:
            return float(rate)
    return None


def _number(path: Path, line: int, channel: str, cell: str) -> float:
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileFormatError(path, f"line {line}, {channel}", "a number", _quoted(cell))
    return value


def write_live_link_csv(path: Path, clip: Clip, *, rate: float | Fraction = USUAL_RATE) -> None:
    """Write a clip of ARKit weights, with 63 columns.

    Channels that the clip lacks or has not set are written as 0: the format knows no gaps. Weights
    are written as they are, with six decimals. Others of the clip's channels are not in the file.

    Parameters
    ----------
    path : Path
    clip : Clip
        Uniform at `rate`: resample it before, where it is not (`Clip.resample`).
    rate : float or Fraction
        Frames a second: those of the time code, whose frames count from 0 in every second.

    Raises
    ------
    InputError
        If the clip holds none of the format's channels, or has another rate.
    """
    if not set(clip.channels) & set(CHANNELS):
        shown = ", ".join(clip.channels[:5]) or "none"
        raise InputError(f"{path}: the clip has no ARKit weight to write; its channels are {shown}")
    grid = clip.time_s[0] + np.arange(len(clip.time_s)) / float(rate)
    if np.abs(clip.time_s - grid).max() > 1e-3:
        raise InputError(f"{path}: the clip's frames are not {float(rate):g} a second: resample it")
    values = np.zeros((len(clip.time_s), len(CHANNELS)))
    for i, channel in enumerate(CHANNELS):
        if channel in clip.channels:
            values[:, i] = np.nan_to_num(clip[channel])
    columns = [c[0].upper() + c[1:] for c in CHANNELS]
    with atomic_write(path) as stream:
        stream.write(",".join(["Timecode", "BlendShapeCount", *columns]) + "\n")
        for frame, row in enumerate(values):
            cells = [_timecode(frame, Fraction(rate)), str(len(CHANNELS))]
            stream.write(",".join([*cells, *(_short(value) for value in row)]) + "\n")


def _timecode(frame: int, rate: Fraction) -> str:
    """Frame 90 at 60 a second is ``00:00:01:30.000``."""
    second, left = divmod(Fraction(frame) / rate, 1)
    minute, second = divmod(int(second), 60)
    hour, minute = divmod(minute, 60)
    return f"{hour:02d}:{minute:02d}:{second:02d}:{float(left * rate):06.3f}"


def _short(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _quoted(text: str) -> str:
    cut = text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"
    return f'"{cut}"'


def _shown(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
