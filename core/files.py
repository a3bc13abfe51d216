"""Files that appear whole or not at all, and limits on what is read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from .errors import FileFormatError, InputError

#: No text file of ours is larger than this; a larger one is refused before it is read.
MAX_TEXT_BYTES = 512 * 1024 * 1024


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; renamed to `path` only if the block succeeds.

    The name keeps the suffix, for writers that choose a format by it.
    """
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def atomic_write(path: Path) -> Iterator[TextIO]:
    """Open a text file that appears at `path` only if the block succeeds."""
    with atomic_path(path) as part, open(part, "w", encoding="utf-8", newline="\n") as stream:
        yield stream
        stream.flush()
        os.fsync(stream.fileno())


def read_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """The text of a file; junk bytes become U+FFFD, so that a parser reports their line.

    Raises
    ------
    FileFormatError
        If the file is empty or larger than `max_bytes`.
    OSError
        If it cannot be read.
    """
    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(path, "file", "contents", "an empty file")
    if size > max_bytes:
        raise FileFormatError(path, "file", f"at most {max_bytes} bytes", f"{size} bytes")
    return path.read_bytes().decode("utf-8", "replace")


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder against other runs, where the system can; it is made if it is not there.

    Raises
    ------
    InputError
        If another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:  # not a POSIX system
        yield
        return
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise InputError(f"{folder}: another run is working in this folder") from None
    finally:
        os.close(lock)
