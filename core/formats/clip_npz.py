"""Clips as NumPy archives (``.npz``): exact, for what no exchange format holds.

Members: ``version`` (1), ``time_s`` (T,) float64, ``channels`` (C,) text, ``values`` (T, C)
float64 with NaN where a channel is not set.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..clip import Clip
from ..errors import FileFormatError
from ..files import atomic_path
from .npz_members import read_npz_members

VERSION = 1
_MAX_BYTES = 1024**3  # of all members, unpacked
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
    found = read_npz_members(path, _MEMBERS, max_bytes=_MAX_BYTES)
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
