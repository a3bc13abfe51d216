"""What the calibrations show and write alike: tables, JSON fields, the report page and its PNG."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import InputError
from ..core.files import atomic_write
from .drawing import Drawing, stacked
from .options import note
from .pictures import write_png
from .tables import Table, cell_text, say

if TYPE_CHECKING:
    from ..capture.lens import RejectedView
    from ..capture.tsai import Parameter

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1d2733;margin:0 auto;max-width:1000px;padding:24px}
h1{font-size:24px;margin:0 0 4px}h2{font-size:17px;margin:28px 0 8px}
svg{max-width:100%;height:auto;font-family:system-ui,sans-serif;display:block;margin:8px 0}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:6px 0}
th,td{padding:2px 14px 2px 0;text-align:left;border-bottom:1px solid #e3e8ee}
td.n,th.n{text-align:right}
.warning{border-left:4px solid #c8442b;background:#fdf1ee;padding:6px 12px;margin:6px 0}
.fine{border-left:4px solid #2c8a57;background:#eef8f2;padding:6px 12px;margin:6px 0}
.wide{overflow-x:auto}
"""


@dataclass(frozen=True, eq=False)
class ReportTable:
    """A table with a heading."""

    title: str
    table: Table


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """Everything that a report shows.

    Attributes
    ----------
    title : str
    summary : str
        One sentence: what was found and how sure it is.
    warnings : tuple of str
    tables : tuple of ReportTable
    drawings : tuple of Drawing
    """

    title: str
    summary: str
    warnings: tuple[str, ...]
    tables: tuple[ReportTable, ...]
    drawings: tuple[Drawing, ...]


def write_calibration_report(path: Path, report: CalibrationReport) -> Path:
    """Write the page, and its pictures as one PNG beside it, whose path is returned."""
    picture = path.with_suffix(".png")
    if report.drawings:
        write_png(picture, stacked(list(report.drawings)).image())
    with atomic_write(path) as stream:
        stream.write(_page(report))
    return picture


def _page(report: CalibrationReport) -> str:
    title = html.escape(report.title)
    said = [f'<p class="warning">{html.escape(w)}</p>' for w in report.warnings]
    said = said or ['<p class="fine">No warnings.</p>']
    tables = [
        f'<h2>{html.escape(t.title)}</h2><div class="wide">{_html_table(t.table)}</div>'
        for t in report.tables
    ]
    pictures = [f'<div class="wide">{drawing.svg()}</div>' for drawing in report.drawings]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
        f"<p>{html.escape(report.summary)}</p>{''.join(said)}"
        f"{''.join(pictures)}{''.join(tables)}</body></html>\n"
    )


def _html_table(table: Table) -> str:
    def cell(value: object, tag: str, number: bool) -> str:
        mark = ' class="n"' if number else ""
        return f"<{tag}{mark}>{html.escape(cell_text(value))}</{tag}>"

    numeric = [
        any(isinstance(row[i], float) for row in table.rows) for i in range(len(table.columns))
    ]
    head = "".join(cell(c, "th", n) for c, n in zip(table.columns, numeric, strict=True))
    rows = "".join(
        f"<tr>{''.join(cell(v, 'td', n) for v, n in zip(row, numeric, strict=True))}</tr>"
        for row in table.rows
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def parameter_table(parameters: Sequence[Parameter]) -> Table:
    """Every estimated number with its standard deviation."""
    rows = [(p.name, _digits(p.value, p.sd), _digits(p.sd, p.sd), p.unit) for p in parameters]
    return Table(("parameter", "value", "sd", "unit"), tuple(rows))


def _digits(value: float, sd: float) -> str:
    """As many digits as the standard deviation leaves, two of them uncertain."""
    import math

    if not (math.isfinite(value) and math.isfinite(sd)) or sd <= 0:
        return cell_text(value)
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    return f"{value:.{min(decimals, 10)}f}"


def parameters_json(parameters: Sequence[Parameter], prefix: str = "") -> list[dict[str, Any]]:
    """The fixed field ``parameters``."""
    return [
        {"name": prefix + p.name, "value": p.value, "sd": p.sd, "unit": p.unit} for p in parameters
    ]


def rejected_json(rejected: Sequence[RejectedView]) -> list[dict[str, str]]:
    """The fixed field ``views_rejected``."""
    return [{"name": r.name, "reason": r.reason} for r in rejected]


def rejected_table(rejected: Sequence[RejectedView]) -> Table:
    """What was not used, and why."""
    return Table(("view", "reason"), tuple((r.name, r.reason) for r in rejected))


def show_tables(report: CalibrationReport) -> None:
    """Tables on stdout, what was found last; warnings on stderr."""
    for titled in report.tables:
        say(titled.title)
        say(str(titled.table))
        say()
    say(report.summary)
    for warning in report.warnings:
        note(f"warning: {warning}")


def image_size_of(text: str) -> tuple[int, int]:
    """``"640x480"`` as (width, height).

    Raises
    ------
    InputError
        If it is no size.
    """
    import re

    found = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)
    if found is None or not (int(found[1]) and int(found[2])):
        raise InputError(f"image size {text}: expected WIDTHxHEIGHT in pixels, such as 640x480")
    return int(found[1]), int(found[2])


def one_camera(path: Path) -> Any:
    """The camera of a camera file.

    Raises
    ------
    InputError
        If it holds several.
    """
    from ..core.formats.rig_json import read_rig

    rig = read_rig(path)
    if len(rig) != 1:
        raise InputError(
            f"{path} has {len(rig)} cameras ({', '.join(rig.names)}): expected a file with one"
        )
    return rig[rig.names[0]]
