"""Results: tables for people on stdout, the same as JSON in a file."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.files import atomic_write

#: What stands in a cell for NaN and None: no value.
MISSING = "–"
_GAP = "  "


@dataclass(frozen=True)
class Table:
    """Rows under named columns.

    Attributes
    ----------
    columns : tuple of str
        Headings; all empty for none.
    rows : tuple of rows, each as long as `columns`
        Numbers are shown to 4 significant digits and aligned right; NaN and None as a dash.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"a row must have {len(self.columns)} cells, got {len(row)}")

    def __str__(self) -> str:
        from rich.cells import cell_len  # wide characters take two columns

        cells = [[cell_text(value) for value in row] for row in self.rows]
        headed = [list(self.columns), *cells] if any(self.columns) else cells
        if not headed:
            return ""
        widths = [max(map(cell_len, column)) for column in zip(*headed, strict=True)]
        right = [_is_numeric(column) for column in zip(*self.rows, strict=True)]
        right = right or [False] * len(self.columns)
        lines = []
        for row in headed:
            padded = [
                " " * (width - cell_len(text)) + text if to_right
                else text + " " * (width - cell_len(text))
                for text, width, to_right in zip(row, widths, right, strict=True)
            ]  # fmt: skip
            lines.append(_GAP.join(padded).rstrip())
        if any(self.columns):
            lines.insert(1, _GAP.join("─" * width for width in widths))
        return "\n".join(lines)


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], *, title: str | None = None
) -> None:
    """Print a table on stdout, the same on a terminal and into a pipe."""
    if title:
        say(title)
    say(str(Table(tuple(columns), tuple(tuple(row) for row in rows))))


def say(text: str = "") -> None:
    """Print a result; what stdout's encoding lacks becomes an escape or a plain dash, no error."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = text.replace("─", "-").replace(MISSING, "-")
        text = text.encode(encoding, "backslashreplace").decode(encoding)
    print(text)


def cell_text(value: object) -> str:
    """A value as a cell shows it."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    number = _number(value)
    if number is None:
        # a name may hold a line break; a cell may not
        return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(value))
    if isinstance(number, int):
        return str(number)
    if math.isnan(number):
        return MISSING
    return f"{number:.4g}" if abs(number) < 1e4 else f"{number:.0f}"


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON; the file appears whole or not at all.

    NumPy numbers and arrays become numbers and lists; what is not finite becomes null.
    """
    text = json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    # file names that are not valid Unicode hold lone surrogates: escape those alone
    text = "".join(c if not 0xD800 <= ord(c) < 0xE000 else f"\\u{ord(c):04x}" for c in text)
    with atomic_write(path) as stream:
        stream.write(text + "\n")


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return _plain(value.tolist())
    number = _number(value)
    if number is None:
        raise TypeError(f"cannot write {type(value).__name__} as JSON")
    return number if math.isfinite(number) else None


def _number(value: object) -> int | float | None:
    if hasattr(value, "ndim") and value.ndim == 0 and hasattr(value, "item"):
        value = value.item()  # a NumPy scalar
    return value if isinstance(value, (int, float)) else None


def _is_numeric(column: Iterable[object]) -> bool:
    known = [value for value in column if value is not None]
    return bool(known) and all(_number(v) is not None and not isinstance(v, bool) for v in known)
