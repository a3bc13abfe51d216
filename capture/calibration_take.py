"""The files of a calibration: which camera took what, and the board in pictures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.errors import FileFormatError, InputError
from .board_detection import Detection, detect_board
from .lens import BoardView

Floats = NDArray[np.float64]
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mts")
_MAX_PIXELS = 400_000_000


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


def views_of_pictures(found: Mapping[str, Sequence[Detection]]) -> dict[str, list[BoardView]]:
    """Views by camera, named by what belongs together: the picture's name, or the frame."""
    return {c: [d.view for d in seen if d.view is not None] for c, seen in found.items()}
