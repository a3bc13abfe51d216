"""``points.csv``: known points and where a picture shows them, columns X,Y,Z,u,v.

A header names the columns, in any order and case; without one the five are in that order. Commas,
semicolons, tabs or blanks separate them. Empty lines and lines that begin with ``#`` are skipped.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import readonly
from ..errors import FileFormatError
from ..files import read_text

COLUMNS = ("x", "y", "z", "u", "v")
_NAMES = "X,Y,Z,u,v"
_MAX_BYTES = 64 * 1024 * 1024
_MAX_SHOWN = 40


@dataclass(frozen=True, eq=False)
class PointsInPicture:
    """Points in space and in a picture.

    Attributes
    ----------
    points : (N, 3) float64, the file's units
    pixels : (N, 2) float64, px
    lines : (N,) int64
        Where each stands in the file, from 1.
    """

    points: NDArray[np.float64]
    pixels: NDArray[np.float64]
    lines: NDArray[np.int64]

    def __post_init__(self) -> None:
        n = len(self.lines)
        object.__setattr__(self, "points", readonly(self.points, (n, 3), "points"))
        object.__setattr__(self, "pixels", readonly(self.pixels, (n, 2), "pixels"))
        object.__setattr__(self, "lines", readonly(self.lines, (n,), "lines", np.int64))


def read_points(path: Path) -> PointsInPicture:
    """Read the points of one picture.

    Raises
    ------
    FileFormatError
        ``points.csv, line 7: expected 5 numbers (X,Y,Z,u,v), found "n/a"``.
    OSError
        If the file cannot be read.
    """
    order: list[int] | None = None
    rows, lines = [], []
    for number, text in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        line = text.lstrip("\ufeff").strip()
        if not line or line.startswith("#"):
            continue
        cells = _cells(line)
        if order is None:
            order = _header(path, number, cells)
            if order is not None:
                continue
            order = list(range(len(COLUMNS)))
            if len(cells) != len(order):
                found = f"{len(cells)} values: {_shown(line)}"
                raise FileFormatError(path, f"line {number}", f"5 columns {_NAMES}", found)
        rows.append(_numbers(path, number, line, cells, order))
        lines.append(number)
    if not rows:
        raise FileFormatError(path, "file", f"lines of {_NAMES}", "no point")
    table = np.array(rows)
    return PointsInPicture(table[:, :3], table[:, 3:], np.array(lines))


def _cells(line: str) -> list[str]:
    if any(mark in line for mark in ",;\t"):
        return [cell.strip().strip('"') for cell in re.split(r"[,;\t]", line)]
    return line.split()


def _header(path: Path, number: int, cells: list[str]) -> list[int] | None:
    """Where each column stands; None if the line is no header."""
    names = [cell.lower() for cell in cells]
    if not any(name in COLUMNS for name in names):
        return None
    lacking = [name for name in COLUMNS if names.count(name) != 1]
    if lacking:
        found = f"a header {_shown(','.join(cells))}"
        raise FileFormatError(path, f"line {number}", f"columns {_NAMES}, each once", found)
    return [names.index(name) for name in COLUMNS]


def _numbers(path: Path, number: int, line: str, cells: list[str], order: list[int]) -> list[float]:
    wanted = f"5 numbers ({_NAMES})"
    if len(cells) <= max(order):
        raise FileFormatError(path, f"line {number}", wanted, f"{len(cells)} values")
    found = []
    for i in order:
        try:
            value = float(cells[i])
        except ValueError:
            raise FileFormatError(path, f"line {number}", wanted, _shown(cells[i])) from None
        if not math.isfinite(value):
            raise FileFormatError(path, f"line {number}", wanted, cells[i])
        found.append(value)
    return found


def _shown(text: str) -> str:
    cut = text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"
    return f'"{cut}"'
