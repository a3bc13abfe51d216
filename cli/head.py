"""`facewright head`: a mesh of the user's own becomes a head that all commands take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .options import JsonOption, note, writable_folder
from .tables import print_table, write_json

if TYPE_CHECKING:
    from ..heads.own_head import OwnHead

#: What is written into the folder; `head.points.csv` is looked for beside `head.glb`.
_HEAD, _POINTS, _CHART = "head.glb", "head.points.csv", "head.chart.png"
_KEPT = "head.points.old.csv"


def head(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An .obj, .ply, .glb or .vrm.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder. Default: FILE's name, beside it."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            metavar="CSV",
            help="3 to 7 points on it, or all: columns name,x,y,z. Default: FILE's .points.csv "
            "if there is one, else the face is looked for.",
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Make a head of a mesh: recognise its parts, place the feature points, draw them on a chart.

    Writes head.glb for every --head, head.points.csv, which may be corrected by hand and is then
    used, and head.chart.png to look at.
    """
    from .heads import check_head, find_own_head

    _check_file(file)
    check_head(str(file))
    out = writable_folder(out or file.with_suffix(""))
    own = find_own_head(file, points)
    _write(out, own, file if points is None else points)
    _show(own, json_file)
    note(f"wrote {out}/ {_HEAD} {_POINTS} {_CHART}")
    note(
        f"look at the chart; correct what is wrong there in {out / _POINTS}, "
        f"and --head {out / _HEAD} uses it"
    )


def _check_file(file: Path) -> None:
    from ..heads.catalogue import BUILT_IN

    if str(file) in BUILT_IN:
        raise InputError(
            f"{file} is a built-in head, complete as it is: expected a file; facewright synth "
            f"head --head {file} --out DIR writes it"
        )


def _write(out: Path, own: OwnHead, source: Path) -> None:
    """The head, its points and the chart; points that were there and differ are kept aside."""
    from ..core.formats.gltf import write_glb
    from ..core.formats.head_points import write_head_points
    from ..heads.chart import feature_point_chart
    from ..heads.head_file import head_scene
    from .pictures import write_png

    head = own.head
    found = {"feature point": dict(head.points)}
    marks = head.mesh.landmarks
    if marks is not None:
        at = marks.at(head.mesh.vertices)
        found["landmark"] = dict(zip(marks.names, at, strict=True))
    table = out / _POINTS
    if table.is_file() and not _is_source(out, source):
        table.replace(out / _KEPT)
        note(f"{table} was there already: it is now {_KEPT}")
    write_glb(out / _HEAD, head_scene(head, lips_part=own.lips_part))
    write_head_points(table, found.items())
    write_png(out / _CHART, feature_point_chart(head))


def _is_source(out: Path, source: Path) -> bool:
    """Whether the head was read from this folder, with its points."""
    return source.resolve() in ((out / _HEAD).resolve(), (out / _POINTS).resolve())


def _show(own: OwnHead, json_file: Path | None) -> None:
    parts = {part: len(rows) for part, rows in own.head.mesh.groups.items()}
    units = own.head.fapu.as_dict()
    print_table(("part", "triangles"), [(part, n) for part, n in parts.items()])
    print_table(("unit", "mm"), [(name, round(value, 2)) for name, value in units.items()])
    if json_file is not None:
        write_json(json_file, _results(own, parts, units))


def _results(own: OwnHead, parts: dict[str, int], units: dict[str, float]) -> dict[str, Any]:
    return {
        "vertices": len(own.head.mesh.vertices),
        "unit_mm": own.unit_mm,
        "points_by": own.placed,
        "lips_part": own.lips_part,
        "triangles": parts,
        "feature_points": len(own.head.points),
        "shapes": list(own.head.shape_names),
        "fapu_mm": units,
        "notes": list(own.notes),
    }
