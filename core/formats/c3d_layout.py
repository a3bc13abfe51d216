"""Where things stand in a C3D file: its header and parameters, all sizes checked.

Our own reader, for the library follows whatever a damaged file says into gigabytes or a
segmentation fault; every size is held against the file's own before anything is taken.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError

#: As many as the 32-bit float that counts the frames of long takes tells apart.
MAX_FRAMES = 2**24
MAX_SHORT_FRAMES = 65535  # C3D's own count of frames has 16 bits
_MAX_BYTES = 1024**3
BLOCK_BYTES = 512
MAX_PARAMETER_BYTES = 255 * BLOCK_BYTES
_MAGIC = 0x50
_INTEL, _DEC, _MIPS = 84, 85, 86


@dataclass(frozen=True)
class Parameter:
    """One parameter as stored: its type (-1 text, 1, 2: integers, 4: floats), sizes and bytes."""

    kind: int
    shape: tuple[int, ...]
    data: bytes


@dataclass(frozen=True)
class Layout:
    """Where the points stand in the file, all sizes checked.

    `frame_words` counts the points' 4 words each and the analog samples after them; `scale` is
    below 0 where words are floats, else mm (or the file's unit) per step of 16-bit integers.
    """

    n_points: int
    n_frames: int
    rate_hz: float
    scale: float
    frame_words: int
    offset: int
    processor: int
    parameters: Mapping[tuple[str, str], Parameter]


def read_layout(path: Path) -> Layout:
    """Number of points and frames, after checking that the file is as long as it says it is."""
    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(path, "file", "contents", "an empty file")
    if size > _MAX_BYTES:
        raise FileFormatError(path, "file", f"at most {_MAX_BYTES} bytes", f"{size} bytes")
    with open(path, "rb") as stream:
        header = stream.read(BLOCK_BYTES)
        if len(header) < 2 or header[1] != _MAGIC or header[0] < 2:
            found = f"{header[:2].hex(' ')} (is this a C3D file?)"
            raise FileFormatError(path, "byte 1", "50 (hexadecimal), C3D's mark", found)
        start = (header[0] - 1) * BLOCK_BYTES
        stream.seek(start)
        section = stream.read(2 * MAX_PARAMETER_BYTES)
    if len(header) < BLOCK_BYTES or len(section) < 4:
        raise FileFormatError(path, "header", "a parameter section", f"{size} bytes in all")
    processor = section[3]
    if processor not in (_INTEL, _DEC):
        found = "MIPS numbers, which are not read" if processor == _MIPS else str(processor)
        raise FileFormatError(path, f"byte {start + 3}", "processor type 84 or 85", found)
    parameters, end = _walk_parameters(path, section, start)
    layout = _checked_layout(path, size, header, parameters, processor)
    if layout.offset < end:
        found = f"byte {layout.offset}"
        raise FileFormatError(path, "POINT:DATA_START", f"data behind byte {end}", found)
    return layout


def _walk_parameters(
    path: Path, section: bytes, start: int
) -> tuple[dict[tuple[str, str], Parameter], int]:
    """Parameters by (group, name), and where they end; every length is checked."""
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Parameter] = {}
    at, end = 4, 4
    while at and section[at : at + 1] not in (b"", b"\0"):
        length, number = (
            struct.unpack_from("<bb", section, at) if at + 2 <= len(section) else (0, 0)
        )
        name_end = at + 2 + abs(length)
        if number == 0 or name_end + 3 > len(section):
            raise _cut(path, start + at)
        name = section[at + 2 : name_end].decode("latin-1").upper()
        (step,) = struct.unpack_from("<H", section, name_end)
        if number < 0:
            groups[-number] = name
            end = name_end + 3 + section[name_end + 2]
        else:
            found[number, name], end = _parameter(path, section, name_end + 2, start)
        following = name_end + step if step else 0
        if end > len(section) or (following and following < end):
            raise _cut(path, start + at)
        at = following
    if at >= len(section):  # no mark of the end
        raise _cut(path, start + at)
    by_name = {(groups.get(number, ""), name): value for (number, name), value in found.items()}
    return by_name, start + end


def _parameter(path: Path, section: bytes, at: int, start: int) -> tuple[Parameter, int]:
    """The parameter whose type stands at `at`, and where its description ends."""
    if at + 2 > len(section):
        raise _cut(path, start + at)
    kind, n_sizes = struct.unpack_from("<bB", section, at)
    shape = tuple(section[at + 2 : at + 2 + n_sizes])
    if kind not in (-1, 1, 2, 4) or len(shape) < n_sizes:
        raise _cut(path, start + at)
    data_at = at + 2 + n_sizes
    data_end = data_at + abs(kind) * math.prod(shape)
    if data_end + 1 > len(section):
        raise _cut(path, start + at)
    value = Parameter(kind, shape, section[data_at:data_end])
    return value, data_end + 1 + section[data_end]


def _cut(path: Path, byte: int) -> FileFormatError:
    expected = "a whole parameter section"
    return FileFormatError(path, f"byte {byte}", expected, "one that is damaged or cut off")


def _checked_layout(
    path: Path,
    size: int,
    header: bytes,
    parameters: Mapping[tuple[str, str], Parameter],
    processor: int,
) -> Layout:
    def number(group: str, name: str, otherwise: float) -> float:
        return _first_number(path, parameters, (group, name), processor, otherwise)

    first, last = struct.unpack_from("<HH", header, 6)
    n_points = int(number("POINT", "USED", 0))
    if n_points < 1:
        raise FileFormatError(path, "POINT:USED", "at least one point", str(n_points))
    n_frames = int(
        number("POINT", "LONG_FRAMES", 0)
        or _n_trial_frames(parameters)
        or number("POINT", "FRAMES", 0)
        or last - first + 1
    )
    if not 1 <= n_frames <= MAX_FRAMES:
        raise FileFormatError(path, "POINT:FRAMES", "at least one frame", str(n_frames))
    rate_hz = number("POINT", "RATE", 0) or struct.unpack_from("<f", header, 20)[0]
    if not 0 < rate_hz < 1e6:
        raise FileFormatError(path, "POINT:RATE", "frames per second above 0", f"{rate_hz:g}")
    scale = number("POINT", "SCALE", struct.unpack_from("<f", header, 12)[0])
    if scale == 0:
        raise FileFormatError(path, "POINT:SCALE", "a number other than 0", "0")
    n_analog = _n_analog_words(path, header, number, rate_hz)
    block = int(number("POINT", "DATA_START", 0)) or struct.unpack_from("<H", header, 16)[0]
    offset, frame_words = (block - 1) * BLOCK_BYTES, 4 * n_points + n_analog
    frame_bytes = frame_words * (4 if scale < 0 else 2)
    there = size - offset
    if block < 2 or n_frames * frame_bytes > there:
        expected = f"{n_frames} frames of {frame_bytes} bytes"
        found = f"{max(0, there) // frame_bytes} (cut off, or a wrong header)"
        raise FileFormatError(path, "data", expected, found)
    if n_frames == MAX_SHORT_FRAMES and there >= (n_frames + 1) * frame_bytes + BLOCK_BYTES:
        expected = "the frames of a long take in POINT:LONG_FRAMES or TRIAL:ACTUAL_END_FIELD"
        raise FileFormatError(path, "POINT:FRAMES", expected, f"{n_frames}, and more data")
    # the rate as it was meant: 59.94, where the 32-bit float is 59.93999862670898
    rate_hz = float(str(np.float32(rate_hz)))
    return Layout(n_points, n_frames, rate_hz, scale, frame_words, offset, processor, parameters)


def _n_trial_frames(parameters: Mapping[tuple[str, str], Parameter]) -> int:
    """Frames by the group TRIAL, which has them in 32 bits; 0 if it does not say."""
    ends = [parameters.get(("TRIAL", f"ACTUAL_{end}_FIELD")) for end in ("START", "END")]
    start, end = (
        int.from_bytes(p.data, "little")
        if p is not None and p.kind == 2 and len(p.data) == 4
        else 0
        for p in ends
    )
    return end - start + 1 if end > start > 0 else 0


def _n_analog_words(
    path: Path, header: bytes, number: Callable[[str, str, float], float], rate_hz: float
) -> int:
    """Analog samples per frame, of which the header and the parameters must say the same."""
    (in_header,) = struct.unpack_from("<H", header, 4)
    n_channels, analog_hz = number("ANALOG", "USED", 0), number("ANALOG", "RATE", 0)
    if n_channels == 0 or analog_hz == 0:
        return int(in_header) if n_channels else 0
    by_parameters = n_channels * analog_hz / rate_hz
    if not abs(by_parameters - in_header) < 0.5:
        found = f"{by_parameters:g} by ANALOG:USED and ANALOG:RATE"
        raise FileFormatError(path, "header", f"{in_header} analog samples in a frame", found)
    return int(in_header)


def _first_number(
    path: Path,
    parameters: Mapping[tuple[str, str], Parameter],
    key: tuple[str, str],
    processor: int,
    otherwise: float,
) -> float:
    """The first number of a parameter; 16-bit ones are taken without sign, as counts are."""
    parameter = parameters.get(key)
    if parameter is None or parameter.kind < 0 or not parameter.data:
        return otherwise
    if parameter.kind < 4:
        return float(int.from_bytes(parameter.data[: parameter.kind], "little"))
    words = np.frombuffer(parameter.data, dtype="<u2", count=2)
    found = float(floats_of_words(words, processor)[0])
    if not math.isfinite(found):
        raise FileFormatError(path, ":".join(key), "a finite number", f"{found:g}")
    return found


def floats_of_words(words: NDArray[np.uint16], processor: int) -> NDArray[Any]:
    """32-bit floats of pairs of 16-bit words."""
    if processor == _DEC:  # a VAX float: words swapped, exponent 2 higher
        swapped = words.reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(swapped).view("<f4").ravel() / np.float32(4)
    return words.view("<f4")
