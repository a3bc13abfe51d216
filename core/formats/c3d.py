"""C3D files: marker trajectories, as every optical system reads and writes them.

What is written, and read back: positions as float32, mm (``POINT:UNITS``); a missing sample as
(0, 0, 0) with a fourth word of -1, the format's mark; else that word holds a residual (low byte,
in steps of ``POINT:SCALE``) and a mask of cameras (high byte). So our `residual_px` keeps 1/254
of the take's largest; a residual of 0 is the format's mark for a sample that was filled in, and
a measured one is written as at least one step. C3D's residuals are lengths, ours are pixels: the
group ``FACEWRIGHT`` says so, and residuals of files without it are not taken for pixels. The mask
has seven bits; we know the number of cameras only and set that many, seven at most.
C3D holds no covariances, one rate instead of times, and no time of the first frame. It counts
frames in 16 bits; longer takes are written with ``POINT:LONG_FRAMES``, as c3d.org advises.

In files by others, a sample at exactly (0, 0, 0) without residual and cameras is missing too
(several programs write gaps like that), and samples of residual 0 count as filled only if others
in the file have one.
"""

from __future__ import annotations

import logging
import math
import os
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError, InputError
from ..files import atomic_path
from ..trajectories import Trajectories

#: As many as the 32-bit float that counts the frames of long takes tells apart.
MAX_FRAMES = 2**24
#: Bytes of a marker name that all readers take.
MAX_NAME_BYTES = 127
_MAX_SHORT_FRAMES = 65535  # C3D's own count of frames has 16 bits
_MAX_MARKERS = 32767
_MAX_BYTES = 1024**3
_BLOCK = 512
_MAX_PARAMETER_BYTES = 255 * _BLOCK
_MAGIC = 0x50
_INTEL, _DEC, _MIPS = 84, 85, 86
_MAX_STEPS = 254  # of a residual byte; 255 says that a measured sample has no residual
_N_CAMERA_BITS = 7
_GROUP = "FACEWRIGHT"
_UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

_log = logging.getLogger(__name__)


def read_c3d(path: Path) -> Trajectories:
    """Read trajectories. Names that are empty or there twice get a number added.

    Returns
    -------
    Trajectories
        Positions in mm, whatever the file's unit (a file that names none is taken to be in mm,
        and that is logged); times from the first frame. `residual_px` only from files that say
        that their residuals are pixels, `n_views` only where cameras are recorded.

    Raises
    ------
    FileFormatError
        If the file is not C3D, is damaged or cut off, has no points or no rate.
    OSError
        If it cannot be read.
    """
    layout = _read_layout(path)
    xyz, word = _read_points(path, layout)
    is_missing = (word < 0) | np.isnan(xyz).any(axis=2)
    residual = (word & 0xFF) * abs(layout.scale)
    n_views = np.bitwise_count(((word >> 8) & 0x7F).astype(np.uint8)).astype(np.int32)
    is_ours = (_GROUP, "RESIDUAL_UNIT") in layout.parameters
    if not is_ours:
        is_missing |= (xyz == 0).all(axis=2) & (word == 0)
    broken = np.argwhere(np.isinf(xyz).any(axis=2) & ~is_missing)
    if len(broken):
        where = f"frame {broken[0][0]}, point {broken[0][1]}"
        raise FileFormatError(path, where, "finite numbers", "inf")
    marks_filled = is_ours or bool((residual[~is_missing] > 0).any())
    return Trajectories(
        np.arange(layout.n_frames) / layout.rate_hz,
        _names(_labels(layout), layout.n_points),
        np.where(is_missing[..., None], np.nan, xyz * _unit_mm(path, layout)),
        is_filled=(residual == 0) & ~is_missing & marks_filled,
        residual_px=_residual_px(layout, residual, is_missing),
        n_views=np.where(is_missing, 0, n_views) if n_views[~is_missing].any() else None,
    )


def write_c3d(path: Path, trajectories: Trajectories) -> None:
    """Write trajectories; see the module for what the format keeps.

    Raises
    ------
    InputError
        If there are no markers or fewer than 2 frames, the times are uneven, there are more than
        16 million frames, or a name is empty, longer than 127 bytes, or padded with spaces.
    """
    rate_hz = _checked_rate_hz(trajectories)
    _check_names(trajectories.names)
    words, scale = _fourth_words(trajectories)
    document = _new_document(trajectories, rate_hz, scale)
    with atomic_path(path) as part:
        # the library adds the suffix it insists on
        named = part if part.suffix == ".c3d" else part.with_name(f"{part.name}.c3d")
        try:
            document.write(str(named))
            _finish(named, words, scale)
            if named != part:
                os.replace(named, part)
        finally:
            if named != part:
                named.unlink(missing_ok=True)


# --- Reading. Our own, for the library follows whatever a damaged file says into gigabytes or a
# --- segmentation fault; every size is held against the file's own before anything is taken.


@dataclass(frozen=True)
class _Parameter:
    """One parameter as stored: its type (-1 text, 1, 2: integers, 4: floats), sizes and bytes."""

    kind: int
    shape: tuple[int, ...]
    data: bytes


@dataclass(frozen=True)
class _Layout:
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
    parameters: Mapping[tuple[str, str], _Parameter]


def _read_layout(path: Path) -> _Layout:
    """Number of points and frames, after checking that the file is as long as it says it is."""
    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(path, "file", "contents", "an empty file")
    if size > _MAX_BYTES:
        raise FileFormatError(path, "file", f"at most {_MAX_BYTES} bytes", f"{size} bytes")
    with open(path, "rb") as stream:
        header = stream.read(_BLOCK)
        if len(header) < 2 or header[1] != _MAGIC or header[0] < 2:
            found = f"{header[:2].hex(' ')} (is this a C3D file?)"
            raise FileFormatError(path, "byte 1", "50 (hexadecimal), C3D's mark", found)
        start = (header[0] - 1) * _BLOCK
        stream.seek(start)
        section = stream.read(2 * _MAX_PARAMETER_BYTES)
    if len(header) < _BLOCK or len(section) < 4:
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
) -> tuple[dict[tuple[str, str], _Parameter], int]:
    """Parameters by (group, name), and where they end; every length is checked."""
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], _Parameter] = {}
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


def _parameter(path: Path, section: bytes, at: int, start: int) -> tuple[_Parameter, int]:
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
    value = _Parameter(kind, shape, section[data_at:data_end])
    return value, data_end + 1 + section[data_end]


def _cut(path: Path, byte: int) -> FileFormatError:
    expected = "a whole parameter section"
    return FileFormatError(path, f"byte {byte}", expected, "one that is damaged or cut off")


def _checked_layout(
    path: Path,
    size: int,
    header: bytes,
    parameters: Mapping[tuple[str, str], _Parameter],
    processor: int,
) -> _Layout:
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
    offset, frame_words = (block - 1) * _BLOCK, 4 * n_points + n_analog
    frame_bytes = frame_words * (4 if scale < 0 else 2)
    there = size - offset
    if block < 2 or n_frames * frame_bytes > there:
        expected = f"{n_frames} frames of {frame_bytes} bytes"
        found = f"{max(0, there) // frame_bytes} (cut off, or a wrong header)"
        raise FileFormatError(path, "data", expected, found)
    if n_frames == _MAX_SHORT_FRAMES and there >= (n_frames + 1) * frame_bytes + _BLOCK:
        expected = "the frames of a long take in POINT:LONG_FRAMES or TRIAL:ACTUAL_END_FIELD"
        raise FileFormatError(path, "POINT:FRAMES", expected, f"{n_frames}, and more data")
    # the rate as it was meant: 59.94, where the 32-bit float is 59.93999862670898
    rate_hz = float(str(np.float32(rate_hz)))
    return _Layout(n_points, n_frames, rate_hz, scale, frame_words, offset, processor, parameters)


def _n_trial_frames(parameters: Mapping[tuple[str, str], _Parameter]) -> int:
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
    parameters: Mapping[tuple[str, str], _Parameter],
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
    found = float(_floats(np.frombuffer(parameter.data, dtype="<u2", count=2), processor)[0])
    if not math.isfinite(found):
        raise FileFormatError(path, ":".join(key), "a finite number", f"{found:g}")
    return found


def _floats(words: NDArray[np.uint16], processor: int) -> NDArray[Any]:
    """32-bit floats of pairs of 16-bit words."""
    if processor == _DEC:  # a VAX float: words swapped, exponent 2 higher
        swapped = words.reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(swapped).view("<f4").ravel() / np.float32(4)
    return words.view("<f4")


def _read_points(path: Path, layout: _Layout) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (T, M, 3) in the file's unit, and each point's fourth word (T, M).

    That word is negative for a missing sample; else its high byte is the mask of cameras and its
    low byte the residual in steps of the scale.
    """
    T, M = layout.n_frames, layout.n_points
    n_halves = 2 if layout.scale < 0 else 1
    count = T * layout.frame_words * n_halves
    data = np.fromfile(path, dtype="<u2", count=count, offset=layout.offset)
    data = data.reshape(T, layout.frame_words * n_halves)[:, : 4 * M * n_halves]
    if layout.scale > 0:
        words = np.ascontiguousarray(data).view("<i2").reshape(T, M, 4)
        return words[..., :3] * layout.scale, words[..., 3].astype(np.int64)
    floats = _floats(np.ascontiguousarray(data).ravel(), layout.processor).reshape(T, M, 4)
    fourth = np.clip(np.nan_to_num(floats[..., 3], nan=-1.0), -1, 0x7FFF)
    return floats[..., :3].astype(np.float64), np.floor(fourth).astype(np.int64)


def _texts(layout: _Layout, name: str) -> list[str]:
    """The texts of a parameter of the group POINT; none if it is missing."""
    parameter = layout.parameters.get(("POINT", name))
    if parameter is None or parameter.kind != -1:
        return []
    length = parameter.shape[0] if parameter.shape else 1
    parts = [parameter.data[at : at + length] for at in range(0, len(parameter.data), length or 1)]
    return [_decoded(part).strip(" \0") for part in parts]


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _unit_mm(path: Path, layout: _Layout) -> float:
    """Millimetres in the file's unit."""
    given = {unit.lower() for unit in _texts(layout, "UNITS")} - {""}
    if not given:
        _log.warning("%s: POINT:UNITS is missing; taken to be mm", path)
        return 1.0
    if len(given) > 1 or not given <= set(_UNIT_MM):
        found = ", ".join(sorted(given))
        raise FileFormatError(path, "POINT:UNITS", f"one of {', '.join(_UNIT_MM)}", found)
    return _UNIT_MM[given.pop()]


def _labels(layout: _Layout) -> list[str]:
    found = _texts(layout, "LABELS")
    more = 2
    while ("POINT", f"LABELS{more}") in layout.parameters:  # a parameter has room for 255
        found.extend(_texts(layout, f"LABELS{more}"))
        more += 1
    return found


def _names(labels: Iterable[str], n_points: int) -> tuple[str, ...]:
    """As many names as points, all different."""
    given = list(labels)[:n_points]
    given += [""] * (n_points - len(given))
    found: list[str] = []
    taken = set(given)
    seen: set[str] = set()
    for number, name in enumerate(given, 1):
        unique = name
        count = 1 if name else number - 1
        while not unique or unique in seen or (unique != name and unique in taken):
            count += 1
            unique = f"{name or 'unnamed'}_{count}"
        seen.add(unique)
        found.append(unique)
    return tuple(found)


def _residual_px(
    layout: _Layout, residual: NDArray[Any], is_missing: NDArray[np.bool_]
) -> NDArray[np.float64] | None:
    unit = layout.parameters.get((_GROUP, "RESIDUAL_UNIT"))
    if unit is None or unit.data != b"px":
        return None
    steps = np.round(residual / abs(layout.scale))
    is_known = ~is_missing & (steps >= 1) & (steps <= _MAX_STEPS)
    return np.where(is_known, residual, np.nan)


# --- Writing, by ezc3d ---


def _checked_rate_hz(trajectories: Trajectories) -> float:
    T, M, _ = trajectories.positions.shape
    if not 1 <= M <= _MAX_MARKERS:
        raise InputError(f"a C3D file holds 1 to {_MAX_MARKERS} markers, not {M}")
    if T < 2:
        raise InputError(f"a C3D file needs a frame rate, so at least 2 frames, not {T}")
    if T > MAX_FRAMES:
        raise InputError(
            f"a C3D file holds at most {MAX_FRAMES} frames, not {T}: cut the take into pieces"
        )
    rate_hz = trajectories.rate_hz
    if rate_hz is None:
        raise InputError(
            "a C3D file has one frame rate, but the times of these trajectories are uneven: "
            "resample them first"
        )
    return rate_hz


def _check_names(names: Sequence[str]) -> None:
    longest = 0
    for name in names:
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(f"marker name {name!r}: C3D needs one without spaces around it")
        n_bytes = len(name.encode("utf-8", "surrogateescape"))
        if n_bytes > MAX_NAME_BYTES:
            raise InputError(
                f"marker name {name[:20]}...: C3D takes {MAX_NAME_BYTES} bytes at most"
            )
        longest = max(longest, n_bytes)
    # names are padded to the longest; 2 bytes each for the unit, the rest for all else
    if len(names) * (longest + 2) > _MAX_PARAMETER_BYTES - 20 * _BLOCK:
        raise InputError(
            f"the names of {len(names)} markers are longer than a C3D file has room for "
            f"({_MAX_PARAMETER_BYTES} bytes): shorten them or write fewer markers"
        )


def _fourth_words(trajectories: Trajectories) -> tuple[NDArray[np.float32], float]:
    """Each point's fourth word, (T, M), and the scale of its residual."""
    residual, is_filled = trajectories.residual_px, trajectories.is_filled
    assert is_filled is not None
    if residual is None:
        steps, scale = np.ones(is_filled.shape), np.float32(0.01)
    else:
        known = np.isfinite(residual)
        largest = float(np.max(residual, where=known, initial=0.0))
        scale = np.float32(max(largest / _MAX_STEPS, 1e-6))
        steps = np.clip(np.round(np.where(known, residual, 0) / scale), 1, _MAX_STEPS)
        steps[~known] = _MAX_STEPS + 1
    if trajectories.n_views is not None:
        n_cameras = np.clip(trajectories.n_views, 0, _N_CAMERA_BITS)
        steps = steps + 256 * (2.0**n_cameras - 1)
    words = np.where(is_filled, 0.0, steps)
    is_missing = np.isnan(trajectories.positions[..., 0])
    return np.where(is_missing, -1.0, words).astype(np.float32), float(scale)


def _new_document(trajectories: Trajectories, rate_hz: float, scale: float) -> Any:
    import ezc3d

    T, M, _ = trajectories.positions.shape
    document = ezc3d.c3d()
    points = document["parameters"]["POINT"]
    points["RATE"]["value"] = [rate_hz]
    points["UNITS"]["value"] = ["mm"]
    points["LABELS"]["value"] = list(trajectories.names)
    points["SCALE"]["value"] = np.array([-scale])
    if T > _MAX_SHORT_FRAMES:
        document.add_parameter("POINT", "LONG_FRAMES", [float(T)])
    unit = "none" if trajectories.residual_px is None else "px"
    document.add_parameter(_GROUP, "RESIDUAL_UNIT", [unit])
    is_missing = np.isnan(trajectories.positions[..., :1])
    xyz = np.where(is_missing, 0.0, trajectories.positions)
    if (np.abs(xyz) > np.finfo(np.float32).max).any():
        raise InputError("a C3D file holds positions as 32-bit floats; one here is too large")
    document["data"]["points"] = np.concatenate([xyz, np.ones((T, M, 1))], 2).transpose(2, 1, 0)
    document["data"]["meta_points"]["residuals"] = np.where(is_missing, -1.0, 0.0).transpose(
        2, 1, 0
    )
    return document


def _finish(part: Path, words: NDArray[np.float32], scale: float) -> None:
    """Check what the library wrote (it reports no full disk), and put right what it writes wrong.

    Those are the scale in the header, and the fourth words: it swaps their bytes (its issue 386).
    """
    try:
        layout = _read_layout(part)
    except FileFormatError as error:
        raise OSError(f"{part} could not be written whole; is the disk full?") from error
    T, M = words.shape
    assert (layout.n_frames, layout.n_points, layout.frame_words) == (T, M, 4 * M)
    points = np.memmap(part, dtype="<f4", mode="r+", offset=layout.offset, shape=(T, M, 4))
    points[..., 3] = words
    points.flush()
    with open(part, "r+b") as stream:
        stream.seek(12)
        stream.write(struct.pack("<f", -scale))
