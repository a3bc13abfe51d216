"""``points.csv`` of a head: named points on it, columns ``kind,name,x_mm,y_mm,z_mm``.

::

    kind,name,x_mm,y_mm,z_mm
    feature point,8.3,24.8123,-66.9010,56.1203
    landmark,en_l,16.6000,-1.9000,32.0511

``kind`` may be left out; columns may stand in any order, be called ``x``, ``y``, ``z``, and be
parted by commas, semicolons or tabs. Lines that begin with ``#`` are skipped. What frame the
coordinates are in is the caller's to know.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..files import atomic_write, read_text

_MAX_BYTES = 16 * 1024 * 1024
_MAX_SHOWN = 40
_HEADER = "name,x_mm,y_mm,z_mm (and kind)"


def read_head_points(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read named points, (3,) each, in the file's order.

    Raises
    ------
    FileFormatError
        ``head.points.csv, line 7: expected a point that is named once, found 8.3 again``.
    OSError
        If the file cannot be read.
    """
    columns: list[int] | None = None
    found: dict[str, NDArray[np.float64]] = {}
    for number, text in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        line = text.lstrip("\ufeff").strip()
        if not line or line.startswith("#"):
            continue
        cells = [cell.strip().strip('"') for cell in re.split(r"[,;\t]", line)]
        if columns is None:
            columns = _columns(path, number, cells)
            continue
        name, point = _point(path, number, cells, columns)
        if name in found:
            raise FileFormatError(
                path, f"line {number}", "a point that is named once", f"{name} again"
            )
        found[name] = point
    if not found:
        raise FileFormatError(path, "file", f"lines of {_HEADER}", "no point")
    return found


def _columns(path: Path, number: int, cells: list[str]) -> list[int]:
    """Where name, x, y and z stand."""
    names = [cell.lower().removesuffix("_mm") for cell in cells]
    wanted = ["name", "x", "y", "z"]
    if any(names.count(name) != 1 for name in wanted):
        raise FileFormatError(
            path, f"line {number}", f"a header with {_HEADER}, each once", _shown(",".join(cells))
        )
    return [names.index(name) for name in wanted]


def _point(
    path: Path, number: int, cells: list[str], columns: list[int]
) -> tuple[str, NDArray[np.float64]]:
    if len(cells) <= max(columns):
        raise FileFormatError(
            path, f"line {number}", "a name and 3 numbers", f"{len(cells)} values"
        )
    values = []
    for column in columns[1:]:
        try:
            value = float(cells[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise FileFormatError(path, f"line {number}", "3 finite numbers", _shown(cells[column]))
        values.append(value)
    return cells[columns[0]], np.array(values)


def write_head_points(
    path: Path, points: Iterable[tuple[str, Mapping[str, NDArray[np.float64]]]]
) -> None:
    """Write named points, atomically.

    Parameters
    ----------
    path : Path
    points : (kind, mapping from name to (3,) float64, mm)
        In the order to write.
    """
    with atomic_write(path) as stream:
        stream.write("kind,name,x_mm,y_mm,z_mm\n")
        for kind, named in points:
            for name, p in named.items():
                stream.write(f"{kind},{name},{p[0]:.4f},{p[1]:.4f},{p[2]:.4f}\n")


def _shown(text: str) -> str:
    cut = text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"
    return f'"{cut}"'
