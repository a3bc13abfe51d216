"""Writing C3D as a stream: as many frames as come, a piece at a time.

By hand, byte by byte (format: c3d.org): libraries want a whole take in memory. `c3d` says what of
trajectories the format keeps.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..files import atomic_path
from ..trajectories import Source, Trajectories
from .c3d_layout import BLOCK_BYTES, MAX_FRAMES, MAX_PARAMETER_BYTES, MAX_SHORT_FRAMES

#: Bytes of a marker name that all readers take.
MAX_NAME_BYTES = 127
MAX_MARKERS = 32767
MAX_STEPS = 254  # of a residual byte; 255 says that a measured sample has no residual
N_CAMERA_BITS = 7
#: The group that says that residuals are pixels.
OWN_GROUP = "FACEWRIGHT"
_MAX_TEXTS = 255  # a parameter's sizes are bytes
_INTEL = 84
_LARGEST = float(np.finfo(np.float32).max)


class C3dWriter:
    """Writes trajectories piece by piece; a context manager.

    The file appears at its path when the block ends without an error, and all frames that were
    promised have come. Nothing but the piece at hand is held in memory.

    Parameters
    ----------
    path : Path
    names : sequence of str
        The markers, in the order of the pieces.
    rate_hz : float
    n_frames : int
        How many there will be in all.
    largest_residual_px : float or None
        The take's largest residual, which sets the step in which all are kept (larger ones are
        cut); None if pieces have no residuals.

    Raises
    ------
    InputError
        If there are no markers or fewer than 2 frames, more than 16 million frames, no rate, or a
        name is empty, longer than 127 bytes, or padded with spaces.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        rate_hz: float,
        n_frames: int,
        *,
        largest_residual_px: float | None,
    ) -> None:
        _check_counts(len(names), n_frames)
        _check_names(names)
        if not 0 < rate_hz < 1e6:
            raise InputError(f"a C3D file needs frames per second above 0, got {rate_hz:g}")
        self._path, self._names, self._n_frames = path, tuple(names), n_frames
        self._scale = _residual_scale(largest_residual_px)
        unit = "none" if largest_residual_px is None else "px"
        self._head = _head(self._names, rate_hz, n_frames, float(self._scale), unit)
        self._n_written = 0
        self._stack = ExitStack()
        self._stream: BinaryIO | None = None

    def __enter__(self) -> C3dWriter:
        part = self._stack.enter_context(atomic_path(self._path))
        self._stream = self._stack.enter_context(open(part, "wb"))
        self._stream.write(self._head)
        return self

    def write(self, piece: Trajectories) -> None:
        """Append frames.

        Raises
        ------
        InputError
            If a position does not fit into 32 bits.
        ValueError
            If the markers are others than at the start, or more frames come than were promised.
        """
        assert self._stream is not None, "used outside its with block"
        if piece.names != self._names:
            raise ValueError("every piece must have the markers that the file was begun with")
        if self._n_written + len(piece.time_s) > self._n_frames:
            raise ValueError(f"more frames than the {self._n_frames} that were promised")
        self._stream.write(_point_words(piece, float(self._scale)).tobytes())
        self._n_written += len(piece.time_s)

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        assert self._stream is not None
        if kind is not None:
            self._stack.__exit__(kind, *rest)  # type: ignore[arg-type]
            return
        with self._stack:
            if self._n_written != self._n_frames:
                raise ValueError(f"{self._n_written} frames came, {self._n_frames} were promised")
            self._stream.write(bytes(-self._stream.tell() % BLOCK_BYTES))
            self._stream.flush()
            os.fsync(self._stream.fileno())


# --- Checks ---


def _check_counts(M: int, T: int) -> None:
    if not 1 <= M <= MAX_MARKERS:
        raise InputError(f"a C3D file holds 1 to {MAX_MARKERS} markers, not {M}")
    if T < 2:
        raise InputError(f"a C3D file needs a frame rate, so at least 2 frames, not {T}")
    if T > MAX_FRAMES:
        raise InputError(
            f"a C3D file holds at most {MAX_FRAMES} frames, not {T}: cut the take into pieces"
        )


def _check_names(names: Sequence[str]) -> None:
    longest = 0
    for name in names:
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(f"marker name {name!r}: C3D needs one without spaces around it")
        n_bytes = len(_bytes(name))
        if n_bytes > MAX_NAME_BYTES:
            raise InputError(
                f"marker name {name[:20]}...: C3D takes {MAX_NAME_BYTES} bytes at most"
            )
        longest = max(longest, n_bytes)
    # names are padded to the longest
    if len(names) * (longest + 2) > MAX_PARAMETER_BYTES - 20 * BLOCK_BYTES:
        raise InputError(
            f"the names of {len(names)} markers are longer than a C3D file has room for "
            f"({MAX_PARAMETER_BYTES} bytes): shorten them or write fewer markers"
        )


# --- Header and parameters ---


def _head(names: Sequence[str], rate_hz: float, n_frames: int, scale: float, unit: str) -> bytes:
    """Everything before the points; whole blocks."""
    short = min(n_frames, MAX_SHORT_FRAMES)
    floats = struct.Struct("<f").pack

    def section(data_block: int) -> bytes:
        point = [
            _parameter(1, "USED", 2, (), struct.pack("<H", len(names))),
            _parameter(1, "SCALE", 4, (), floats(-scale)),
            _parameter(1, "RATE", 4, (), floats(rate_hz)),
            _parameter(1, "DATA_START", 2, (), struct.pack("<H", data_block)),
            _parameter(1, "FRAMES", 2, (), struct.pack("<H", short)),
            _texts(1, "UNITS", ["mm"]),
        ]
        for at in range(0, len(names), _MAX_TEXTS):
            number = at // _MAX_TEXTS + 1
            label = "LABELS" if number == 1 else f"LABELS{number}"
            point.append(_texts(1, label, names[at : at + _MAX_TEXTS]))
        if n_frames > MAX_SHORT_FRAMES:
            point.append(_parameter(1, "LONG_FRAMES", 4, (), floats(float(n_frames))))
        parts = [
            _group(1, "POINT"), *point,
            _group(2, "ANALOG"), _parameter(2, "USED", 2, (), bytes(2)),
            _parameter(2, "RATE", 4, (), floats(0.0)),
            _group(3, "FORCE_PLATFORM"), _parameter(3, "USED", 2, (), bytes(2)),
            _group(4, OWN_GROUP), _texts(4, "RESIDUAL_UNIT", [unit]),
        ]  # fmt: skip
        body = b"".join(parts) + b"\0"
        n_blocks = -(-(4 + len(body)) // BLOCK_BYTES)
        whole = bytes((1, 0x50, n_blocks, _INTEL)) + body
        return whole.ljust(n_blocks * BLOCK_BYTES, b"\0")

    data_block = 2 + len(section(0)) // BLOCK_BYTES
    header = bytearray(BLOCK_BYTES)
    struct.pack_into("<BBHHHHHfHHf", header, 0, 2, 0x50, len(names), 0, 1, short, 0, -scale,
                     data_block, 0, rate_hz)  # fmt: skip
    return bytes(header) + section(data_block)


def _group(number: int, name: str) -> bytes:
    text = name.encode("ascii")
    # the 3: from this offset to the next item, over itself and an empty description
    return struct.pack("<bb", len(text), -number) + text + struct.pack("<HB", 3, 0)


def _parameter(group: int, name: str, kind: int, shape: Sequence[int], data: bytes) -> bytes:
    """Type: -1 text, 2 whole number, 4 float; a single number has no sizes."""
    body = struct.pack("<bB", kind, len(shape)) + bytes(shape) + data + b"\0"
    text = name.encode("ascii")
    return struct.pack("<bb", len(text), group) + text + struct.pack("<H", 2 + len(body)) + body


def _texts(group: int, name: str, texts: Sequence[str]) -> bytes:
    coded = [_bytes(text) for text in texts]
    width = max(len(text) for text in coded)
    data = b"".join(text.ljust(width) for text in coded)
    return _parameter(group, name, -1, (width, len(coded)), data)


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


# --- Points ---


def _residual_scale(largest_px: float | None) -> np.float32:
    """Pixels a step of the residual byte."""
    if largest_px is None:
        return np.float32(0.01)
    return np.float32(max(largest_px / MAX_STEPS, 1e-6))


def _point_words(piece: Trajectories, scale: float) -> NDArray[np.float32]:
    """(T, M, 4) little-endian floats: positions, and the word of residual and cameras."""
    xyz = np.where(piece.is_missing[..., None], 0.0, piece.positions)
    if (np.abs(xyz) > _LARGEST).any():
        raise InputError("a C3D file holds positions as 32-bit floats; one here is too large")
    words = np.empty((*piece.source.shape, 4), dtype="<f4")
    words[..., :3] = xyz
    words[..., 3] = _fourth_words(piece, scale)
    return words


def _fourth_words(piece: Trajectories, scale: float) -> NDArray[np.float64]:
    residual = piece.residual_px
    if residual is None:
        steps = np.ones(piece.source.shape)
    else:
        known = np.isfinite(residual)
        steps = np.clip(np.round(np.where(known, residual, 0) / scale), 1, MAX_STEPS)
        steps[~known] = MAX_STEPS + 1
    if piece.n_views is not None:
        n_cameras = np.clip(piece.n_views, 0, N_CAMERA_BITS)
        steps = steps + 256 * (2.0**n_cameras - 1)
    words = np.where(piece.source == Source.INTERPOLATED, 0.0, steps)
    words = np.where(piece.source == Source.RECONSTRUCTED, 256.0, words)
    return np.asarray(np.where(piece.is_missing, -1.0, words))
