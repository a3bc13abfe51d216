"""ASCII ``.fap`` files: MPEG-4 facial animation parameters, frame by frame.

::

    # comments
    2.1 NAME FPS NFRAMES
    m1 m2 … m68               mask: 1 for each FAP that is given in this frame
    FRAME v v v …             frame number, then the values of those FAPs, in their order

FAP 1 takes four values and FAP 2 six; values are in the table's units. What the wild holds and
this reader takes: names with spaces, CRLF, tabs, masks of more than 68 columns (the further ones
must be 0), frames numbered from 0, 1 or anywhere, with gaps, and a frame count in the header that
is wrong (a placeholder of 10000, often): the lines count.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..clip import Clip
from ..errors import FileFormatError, InputError
from ..files import atomic_write, read_text
from ..mpeg4 import EXPRESSION_FIELDS, N_FAPS, VISEME_FIELDS, fap_channels

#: Written where a clip of one frame has no rate of its own.
ONE_FRAME_RATE_HZ = 25.0
_VERSION = "2.1"
_VERSIONS_READ = ("2.0", "2.1", "2.2")
_STREAMING_COUNT = 10000  # the placeholder of encoders that do not know the length yet
_MAX_RATE_HZ = 100_000.0
_MAX_FRAME_NUMBER = 2**31 - 1
_MAX_VALUE = 2**31 - 1
_MAX_DECIMALS = 9
#: Fields of FAPs 1 and 2 that select something, as opposed to the amounts beside them.
_SELECTORS = frozenset((*VISEME_FIELDS, *EXPRESSION_FIELDS)) - {
    "viseme.blend",
    "expression.intensity1",
    "expression.intensity2",
}
_COMPOSED = (VISEME_FIELDS, EXPRESSION_FIELDS)

_log = logging.getLogger(__name__)


def read_fap(path: Path) -> Clip:
    """Read a FAP stream.

    Returns
    -------
    Clip
        All channels of ``core.mpeg4.fap_channels()``; NaN where the mask is 0. Times count from
        the first frame: (frame number - first) / rate.

    Raises
    ------
    FileFormatError
        ``take1.fap, line 214: expected 68 values, found 66``.
    OSError
        If the file cannot be read.
    """
    lines = list(_numbered_lines(read_text(path)))
    header = _read_header(path, lines)
    rows = lines[1:]
    if not rows:
        raise FileFormatError(path, f"line {lines[0][0]}", "frames after it", "the end of the file")
    if len(rows) % 2:
        expected = "a line with the frame's values after this mask"
        raise FileFormatError(path, f"line {rows[-1][0]}", expected, "the end of the file")
    frames, values = _read_frames(path, rows)
    if header.n_frames not in (len(frames), _STREAMING_COUNT):
        _log.warning(
            "%s: the header promises %d frames, the file holds %d",
            path,
            header.n_frames,
            len(frames),
        )
    time_s = (frames - frames[0]) / header.rate_hz
    return Clip(time_s, fap_channels(), values)


def write_fap(path: Path, clip: Clip, *, decimals: int = 0) -> None:
    """Write a FAP stream.

    The format knows a rate and frame numbers, not times: they count from the clip's first frame.
    A clip of one frame is written at 25 frames per second. The fields of FAPs 1 and 2 are always
    whole numbers.

    Parameters
    ----------
    path : Path
    clip : Clip
        Channels of ``core.mpeg4.fap_channels()`` only, uniform in time.
    decimals : int
        Digits kept after the point; 0, the format's custom, writes integers.

    Raises
    ------
    InputError
        If the clip is empty or not uniform in time, has other channels, sets some but not all
        fields of FAP 1 or 2 in a frame, selects a fraction of a viseme, or holds a value beyond
        ±2147483647.
    """
    if not 0 <= decimals <= _MAX_DECIMALS:
        raise ValueError(f"decimals must lie in 0..{_MAX_DECIMALS}, got {decimals}")
    values = _ordered_values(clip)
    rate = _rate_text(clip)
    name = "_".join(path.stem.split()) or "clip"
    with atomic_write(path) as stream:
        stream.write(f"{_VERSION} {name} {rate} {len(values)}\n")
        for number, row in enumerate(_rounded(values, decimals)):
            stream.write(_frame_text(number, row, decimals))


def _numbered_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers from 1; any line ends."""
    text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(text.split("\n"), 1):
        line = line.strip()
        if line and not line.startswith("#"):
            yield number, line


@dataclass(frozen=True)
class _Header:
    rate_hz: float
    n_frames: int


def _read_header(path: Path, lines: list[tuple[int, str]]) -> _Header:
    if not lines:
        raise FileFormatError(path, "file", "a header line", "only comments and blank lines")
    number, line = lines[0]
    where = f"line {number}"
    tokens = line.split()  # from both ends: the name in the middle may hold spaces, or be missing
    if len(tokens) < 3 or tokens[0] not in _VERSIONS_READ:
        expected = f"VERSION NAME FPS NFRAMES, VERSION being {' or '.join(_VERSIONS_READ)}"
        raise FileFormatError(path, where, expected, _show(line))
    try:
        rate_hz = _number(tokens[-2])
    except ValueError as error:
        expected = "a number of frames per second"
        raise FileFormatError(path, where, expected, _show(tokens[-2])) from error
    if not 0 < rate_hz <= _MAX_RATE_HZ:
        expected = f"a rate above 0 and at most {_MAX_RATE_HZ:g} frames per second"
        raise FileFormatError(path, where, expected, _show(tokens[-2]))
    if not (tokens[-1].isascii() and tokens[-1].isdigit() and len(tokens[-1]) < 12):
        raise FileFormatError(path, where, "a number of frames", _show(tokens[-1]))
    return _Header(rate_hz, int(tokens[-1]))


def _read_frames(
    path: Path, rows: list[tuple[int, str]]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Frame numbers (T,) and values (T, C), NaN where not set, of mask and value lines."""
    n_frames = len(rows) // 2
    frames = np.zeros(n_frames, dtype=np.int64)
    values = np.full((n_frames, len(fap_channels())), np.nan)
    is_given = np.zeros(values.shape, dtype=bool)
    last_mask, columns = "", np.zeros(0, dtype=np.intp)
    for frame in range(n_frames):
        (mask_line, mask), (line, text) = rows[2 * frame], rows[2 * frame + 1]
        if mask != last_mask:  # most files repeat one mask
            columns, last_mask = _mask_columns(path, mask_line, mask), mask
        tokens = text.split()
        if len(tokens) != len(columns) + 1:
            expected = f"a frame number and {len(columns)} values"
            found = f"{_show(tokens[0])} and {len(tokens) - 1}"
            raise FileFormatError(path, f"line {line}", expected, found)
        after = int(frames[frame - 1]) if frame else -1
        frames[frame] = _frame_number(path, line, tokens[0], after)
        try:
            values[frame, columns] = [float(token) for token in tokens[1:]]
        except ValueError as error:
            bad = next(token for token in tokens[1:] if not _is_number(token))
            raise FileFormatError(path, f"line {line}", "numbers", _show(bad)) from error
        is_given[frame, columns] = True
        if "_" in text:  # Python reads 1_000 as a number; this format does not
            raise FileFormatError(path, f"line {line}", "numbers", _show(text))
    bad_frames = np.flatnonzero((is_given & ~np.isfinite(values)).any(axis=1))
    if len(bad_frames):
        line, text = rows[2 * int(bad_frames[0]) + 1]
        found = next(t for t in text.split()[1:] if not math.isfinite(float(t)))
        raise FileFormatError(path, f"line {line}", "finite values", _show(found))
    return frames, values


def _mask_columns(path: Path, line: int, mask: str) -> NDArray[np.intp]:
    """Channel indices that take values, in the order of the values."""
    bits = mask.split()
    where = f"line {line}"
    if any(bit not in ("0", "1") for bit in bits):
        bad = next(bit for bit in bits if bit not in ("0", "1"))
        raise FileFormatError(path, where, f"a mask of {N_FAPS} times 0 or 1", _show(bad))
    if len(bits) < N_FAPS:
        raise FileFormatError(path, where, f"a mask of {N_FAPS} times 0 or 1", f"{len(bits)} of it")
    if "1" in bits[N_FAPS:]:
        column = N_FAPS + bits[N_FAPS:].index("1") + 1
        raise FileFormatError(path, where, f"0 in mask column {column}: there are 68 FAPs", "1")
    found: list[int] = []
    for index in range(N_FAPS):
        if bits[index] == "1":
            found.extend(_CHANNELS_OF_FAP[index])
    return np.array(found, dtype=np.intp)


def _channels_of_faps() -> tuple[tuple[int, ...], ...]:
    """Channel indices of each of the 68 FAPs."""
    n_viseme, n_composed = len(VISEME_FIELDS), len(VISEME_FIELDS) + len(EXPRESSION_FIELDS)
    simple = tuple((n_composed + index,) for index in range(N_FAPS - 2))
    return (tuple(range(n_viseme)), tuple(range(n_viseme, n_composed)), *simple)


_CHANNELS_OF_FAP = _channels_of_faps()


def _frame_number(path: Path, line: int, token: str, after: int) -> int:
    if not (token.isascii() and token.isdigit() and len(token) < 12):
        raise FileFormatError(path, f"line {line}", "a frame number", _show(token))
    number = int(token)
    if not after < number <= _MAX_FRAME_NUMBER:
        expected = f"a frame number above {after}"
        if number > _MAX_FRAME_NUMBER:
            expected = f"a frame number of at most {_MAX_FRAME_NUMBER}"
        raise FileFormatError(path, f"line {line}", expected, token)
    return number


def _number(token: str) -> float:
    if "_" in token:
        raise ValueError(token)
    return float(token)


def _is_number(token: str) -> bool:
    try:
        _number(token)
    except ValueError:
        return False
    return True


def _show(text: str) -> str:
    return f'"{text}"' if len(text) <= 40 else f'"{text[:37]}..."'


def _rate_text(clip: Clip) -> str:
    if len(clip.time_s) == 0:
        raise InputError("a .fap file needs at least one frame; the clip has none")
    rate_hz = ONE_FRAME_RATE_HZ if len(clip.time_s) == 1 else clip.rate_hz
    if rate_hz is None:
        raise InputError(
            "a .fap file has one frame rate, but the clip's times are uneven: resample it first "
            "(Clip.resample)"
        )
    return str(int(rate_hz)) if rate_hz == int(rate_hz) else repr(rate_hz)


def _ordered_values(clip: Clip) -> NDArray[np.float64]:
    """The clip's values in the order of all FAP channels, checked: (T, 76), NaN where not set."""
    known = fap_channels()
    others = [name for name in clip.channels if name not in known]
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        raise InputError(
            f"a .fap file holds the 68 FAPs only, not {', '.join(others[:3])}{more}: "
            "convert or drop these channels first"
        )
    values = np.full((len(clip.time_s), len(known)), np.nan)
    values[:, [known.index(name) for name in clip.channels]] = clip.values
    too_large = np.argwhere(np.abs(values) > _MAX_VALUE)
    if len(too_large):
        frame, channel = too_large[0]
        raise InputError(
            f"frame {frame}, {known[channel]}: {values[frame, channel]:g} is beyond what a .fap "
            f"file is read with, ±{_MAX_VALUE}"
        )
    _check_composed(values)
    return values


def _check_composed(values: NDArray[np.float64]) -> None:
    known = fap_channels()
    for number, fields in enumerate(_COMPOSED, 1):
        columns = [known.index(name) for name in fields]
        is_set = ~np.isnan(values[:, columns])
        partial = np.flatnonzero(is_set.any(axis=1) & ~is_set.all(axis=1))
        if len(partial):
            missing = fields[int(np.argmin(is_set[partial[0]]))]
            raise InputError(
                f"frame {partial[0]}: FAP {number} needs all of {', '.join(fields)}, "
                f"but {missing} is not set"
            )
        for column, name in zip(columns, fields, strict=True):
            v = values[:, column]
            broken = np.flatnonzero(v != np.round(v)) if name in _SELECTORS else np.zeros(0, int)
            broken = broken[~np.isnan(v[broken])]
            if len(broken):
                raise InputError(
                    f"frame {broken[0]}: {name} selects by whole numbers, got {v[broken[0]]:g}"
                )


def _rounded(values: NDArray[np.float64], decimals: int) -> Iterator[NDArray[np.float64]]:
    """Rows rounded for writing, without negative zeros."""
    n_composed = len(VISEME_FIELDS) + len(EXPRESSION_FIELDS)
    for row in values:
        found = np.round(row, decimals)
        found[:n_composed] = np.round(row[:n_composed])
        yield found + 0.0


def _frame_text(number: int, row: NDArray[np.float64], decimals: int) -> str:
    n_composed = len(VISEME_FIELDS) + len(EXPRESSION_FIELDS)
    is_set = ~np.isnan(row)
    bits = [str(int(is_set[channels[0]])) for channels in _CHANNELS_OF_FAP]
    words = [str(number)]
    for channel in np.flatnonzero(is_set):
        digits = decimals if channel >= n_composed else 0
        words.append(f"{row[channel]:.{digits}f}")
    return f"{' '.join(bits)}\n{' '.join(words)}\n"
