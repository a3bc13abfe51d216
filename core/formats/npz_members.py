"""Arrays out of ``.npz`` archives by strangers: no pickles, and no size that is not there."""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError

_MAX_EXPANSION = 1100  # deflate cannot shrink further: 1032 to 1
_KIND_NAMES = {"iu": "integers", "f": "floats", "U": "text", "b": "booleans"}


def read_npz_members(
    path: Path, kinds: Mapping[str, str], *, max_bytes: int
) -> dict[str, NDArray[Any]]:
    """Named arrays of an archive; what else it holds is left alone.

    Parameters
    ----------
    path : Path
    kinds : mapping from name to the kinds of dtype it may have
        ``"iu"``, ``"f"``, ``"U"`` or ``"b"``.
    max_bytes : int
        All members together, unpacked.

    Raises
    ------
    FileFormatError
        If the file is no such archive, is damaged, unpacks to more than it may, or lacks a member.
    OSError
        If it cannot be read.
    """
    if path.stat().st_size == 0:
        raise FileFormatError(path, "file", "a .npz archive", "an empty file")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(path, archive, kinds, max_bytes)
            return {name: _member(path, archive, name, kinds[name]) for name in kinds}
    except zipfile.BadZipFile as error:
        raise FileFormatError(path, "file", "a .npz archive", str(error)) from error
    except (zlib.error, EOFError, NotImplementedError, RuntimeError, struct.error) as error:
        raise FileFormatError(path, "file", "an undamaged .npz archive", str(error)) from error


def _check_sizes(
    path: Path, archive: zipfile.ZipFile, kinds: Mapping[str, str], max_bytes: int
) -> None:
    """Hold what the archive says of itself against what it can be, before it is unpacked."""
    on_disk = path.stat().st_size
    members = {info.filename: info for info in archive.infolist()}
    total = sum(info.file_size for info in members.values())
    if total > max_bytes:
        raise FileFormatError(path, "file", f"at most {max_bytes} bytes unpacked", str(total))
    for name in kinds:
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


def _member(path: Path, archive: zipfile.ZipFile, name: str, kind: str) -> NDArray[Any]:
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
    if dtype.kind not in kind or dtype.itemsize == 0:
        found = f"one of {dtype}"
        raise FileFormatError(path, name, f"an array of {_KIND_NAMES[kind]}", found)
    size, there = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    if size != there or min(shape, default=0) < 0:
        raise FileFormatError(path, name, f"{size} bytes for shape {shape}", f"{there} bytes")
    flat = np.frombuffer(data, dtype=dtype, offset=stream.tell()) if size else np.zeros(0, dtype)
    return flat.reshape(shape, order="F" if is_fortran else "C")
