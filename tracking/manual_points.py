"""A face without the networks: points marked in one frame, followed by flow and templates.

``points.csv`` has a line for each point of one frame, columns frame,name,x,y (px, the centre of
the top-left pixel is 0, 0). A name is a number of the network's 478 landmarks, one of
`NAMED_LANDMARKS`, or an MPEG-4 feature point that has one (`FEATURE_POINT_LANDMARKS`).

What that can do: points on skin with some texture (brows, nose, corners of eyes and mouth, chin,
freckles) are followed for as long as they are seen, and found again after they were covered; lids
are found again once they are open. What it cannot: what changes its looks is lost meanwhile (lids
in a blink, inner lips while the mouth is open), and is then NaN; nothing finds the face again after
a cut; there are no expression scores.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import FileFormatError
from ..core.files import read_text
from ..heads.face_landmarks import N_LANDMARKS, NAMED_LANDMARKS

#: Feature points of MPEG-4 that lie where a landmark does, on the average head.
FEATURE_POINT_LANDMARKS: Mapping[str, int] = MappingProxyType(
    {
        "3.12": 33, "3.8": 133, "3.11": 362, "3.7": 263, "3.1": 386, "3.2": 159, "3.3": 374,
        "3.4": 145, "3.5": 473, "3.6": 468, "4.1": 336, "4.2": 107, "4.5": 293, "4.6": 63,
        "8.1": 0, "8.2": 17, "8.3": 291, "8.4": 61, "2.2": 13, "2.3": 14, "2.4": 308, "2.5": 78,
        "9.3": 1, "2.1": 152,
    }
)  # fmt: skip
_COLUMNS = ["frame", "name", "x", "y"]
_MAX_BYTES = 1024 * 1024
_FEWEST = 4


@dataclass(frozen=True, eq=False)
class MarkedPoints:
    """Points of a face in one frame.

    Attributes
    ----------
    frame : int
    landmarks : tuple of int
        Numbers of the landmarks they are, each once.
    points_px : (n, 2) float64, px
    """

    frame: int
    landmarks: tuple[int, ...]
    points_px: NDArray[np.float64]

    def __post_init__(self) -> None:
        numbers = tuple(int(number) for number in self.landmarks)
        if len(set(numbers)) != len(numbers) or any(not 0 <= n < N_LANDMARKS for n in numbers):
            raise ValueError("landmarks must differ and lie between 0 and 477")
        if self.frame < 0:
            raise ValueError(f"frame must be 0 or more, got {self.frame}")
        points = readonly(self.points_px, (len(numbers), 2), "points_px")
        if not np.isfinite(points).all():
            raise ValueError("points_px must be finite")
        object.__setattr__(self, "landmarks", numbers)
        object.__setattr__(self, "points_px", points)


def read_marked_points(path: Path) -> MarkedPoints:
    """Read the points that were marked in one frame.

    Raises
    ------
    FileFormatError
        ``points.csv, line 3: expected the name of a landmark, found "noze"``; also if there are
        fewer than four points, one twice, or several frames.
    OSError
        If the file cannot be read.
    """
    lines = read_text(path, _MAX_BYTES).lstrip("\ufeff").splitlines()
    rows = [(i, cells) for i, cells in enumerate(csv.reader(lines), start=1) if any(cells)]
    if not rows or [cell.strip().lower() for cell in rows[0][1]] != _COLUMNS:
        found = f'"{",".join(rows[0][1])[:40]}"' if rows else "an empty file"
        raise FileFormatError(path, "line 1", "the columns frame,name,x,y", found)
    frames: list[int] = []
    numbers: list[int] = []
    points: list[tuple[float, float]] = []
    for line, cells in rows[1:]:
        where = f"line {line}"
        if len(cells) != len(_COLUMNS):
            raise FileFormatError(path, where, "4 values", str(len(cells)))
        frames.append(_frame(path, where, cells[0]))
        numbers.append(landmark_number(path, where, cells[1].strip()))
        points.append((_number(path, where, cells[2]), _number(path, where, cells[3])))
        if frames[-1] != frames[0]:
            raise FileFormatError(path, where, f"frame {frames[0]} as above", str(frames[-1]))
        if numbers[-1] in numbers[:-1]:
            raise FileFormatError(path, where, "each point once", f"{cells[1].strip()} again")
    if len(points) < _FEWEST:
        raise FileFormatError(path, "file", f"at least {_FEWEST} points", str(len(points)))
    return MarkedPoints(frames[0], tuple(numbers), np.array(points))


def landmark_number(path: Path, where: str, name: str) -> int:
    """Which landmark a name means; FileFormatError if none."""
    if name in FEATURE_POINT_LANDMARKS:
        return FEATURE_POINT_LANDMARKS[name]
    if name in NAMED_LANDMARKS:
        return NAMED_LANDMARKS[name]
    if name.isascii() and name.isdigit() and int(name) < N_LANDMARKS:
        return int(name)
    expected = "a landmark's name (nose_tip, mouth_left, …), feature point (8.1) or number (0-477)"
    raise FileFormatError(path, where, expected, f'"{name[:40]}"')


def _frame(path: Path, where: str, text: str) -> int:
    if not text.strip().isascii() or not text.strip().isdigit():
        raise FileFormatError(path, where, "a frame's number, from 0", f'"{text[:40]}"')
    return int(text)


def _number(path: Path, where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise FileFormatError(path, where, "a number", f'"{text[:40]}"') from None
    if not math.isfinite(value):
        raise FileFormatError(path, where, "a finite number", text[:40])
    return value
