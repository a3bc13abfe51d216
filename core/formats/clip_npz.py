"""Clips as NumPy archives (``.npz``): exact, for what no exchange format holds.

Members: ``version`` (1), ``time_s`` (T,) float64, ``channels`` (C,) text, ``values`` (T, C)
float64 with NaN where a channel is not set.
"""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..clip import Clip
from ..errors import FileFormatError
from ..files import atomic_path

VERSION = 1
_MAX_BYTES = 1024**3  # of all members, unpacked
_MAX_EXPANSION = 1100  # deflate cannot shrink further: 1032 to 1
_MEMBERS = {"version": "iu", "time_s": "f", "channels": "U", "values": "f"}  # and their dtype kinds


def read_clip_npz(path: Path) -> Clip:
    """Read a clip.

    Raises
    ------
    FileFormatError
        If the file is no such archive, is damaged, or unpacks to more than it may.
    OSError
        If it cannot be read.
    """
    if path.stat().st_size == 0:
        raise FileFormatError(path, "file", "a .npz archive", "an empty file")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(path, archive)
            found = {name: _member(path, archive, name) for name in _MEMBERS}
    except zipfile.BadZipFile as error:
        raise FileFormatError(path, "file", "a .npz archive", str(error)) from error
    except (zlib.error, EOFError, NotImplementedError, RuntimeError, struct.error) as error:
        raise FileFormatError(path, "file", "an undamaged .npz archive", str(error)) from error
    if found["version"].shape != () or int(found["version"]) != VERSION:
        raise FileFormatError(path, "version", str(VERSION), str(found["version"]))
    try:
        channels = tuple(str(name) for name in found["channels"].ravel())
        return Clip(found["time_s"], channels, found["values"])
    except ValueError as error:
        raise FileFormatError(path, "contents", "a clip", str(error)) from error


def write_clip_npz(path: Path, clip: Clip) -> None:
    """Write a clip; it reads back as it was, to the last bit."""
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(
            stream,
            version=np.int64(VERSION),
            time_s=clip.time_s,
            channels=np.array(clip.channels, dtype=np.str_),
            values=clip.values,
        )


def _check_sizes(path: Path, archive: zipfile.ZipFile) -> None:
    """Hold what the archive says of itself against what it can be, before it is unpacked."""
    on_disk = path.stat().st_size
    members = {info.filename: info for info in archive.infolist()}
    total = sum(info.file_size for info in members.values())
    if total > _MAX_BYTES:
        raise FileFormatError(path, "file", f"at most {_MAX_BYTES} bytes unpacked", str(total))
    for name in _MEMBERS:
        info = members.get(f"{name}.npy")
        if info is None:
            there = ", ".join(sorted(members)[:5]) or "nothing"
            raise FileFormatError(path, "file", f"an array called {name}", there)
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            found = f"method {info.compress_type}"
            raise FileFormatError(path, name, "stored or deflated data", found)
        is_honest = 0 <= info.header_offset <= info.header_offset + info.compress_size <= on_disk
        if not is_honest or info.file_size > info.compress_size * _MAX_EXPANSION + 1024:
            found = f"{info.compress_size} bytes said to unpack to {info.file_size}"
            raise FileFormatError(path, name, "a possible size", found)


def _member(path: Path, archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """One array, without trusting its header's shape and without pickles."""
    data = archive.read(f"{name}.npy")  # checks length and CRC
    stream = io.BytesIO(data)
    try:
        major, _ = np.lib.format.read_magic(stream)
        read = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
        if major not in read:
            raise FileFormatError(path, name, "an .npy array of version 1 or 2", str(major))
        shape, is_fortran, dtype = read[major](stream)
    except FileFormatError:
        raise
    except (ValueError, SyntaxError, tokenize.TokenError) as error:  # the header is a literal
        raise FileFormatError(path, name, "an .npy array", str(error).split("\n")[0]) from error
    if dtype.kind not in _MEMBERS[name] or dtype.itemsize == 0:
        kind = {"iu": "integers", "f": "floats", "U": "text"}[_MEMBERS[name]]
        raise FileFormatError(path, name, f"an array of {kind}", f"one of {dtype}")
    size, there = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    if size != there or min(shape, default=0) < 0:
        raise FileFormatError(path, name, f"{size} bytes for shape {shape}", f"{there} bytes")
    flat = np.frombuffer(data, dtype=dtype, offset=stream.tell()) if size else np.zeros(0, dtype)
    return flat.reshape(shape, order="F" if is_fortran else "C")
