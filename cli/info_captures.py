"""What is in the files of a capture: settings (TOML), meshes, pictures, tables."""

from __future__ import annotations

import csv
import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..core.errors import FileFormatError
from ..core.files import read_text
from .description import Description

_MAX_SETTINGS_BYTES = 64 * 1024 * 1024  # voice.toml of 100,000 voices is 40 MB
_MAX_CELL = 60

#: What a settings file describes, by keys that only it has; and its list of tables, if any.
_SETTINGS = (
    ({"board", "views"}, "shots of a calibration board", ""),
    ({"photo", "mesh"}, "photographs of a head", "photo"),
    ({"scan_from_head", "units"}, "scan of a head", ""),
    ({"voice", "version"}, "synthetic voices", "voice"),
)

#: What an archive of arrays is, by names that only it has.
_ARCHIVES = (
    ({"time_s", "marker_positions", "camera_names", "faps"}, "truth of a synthetic take"),
    ({"time_s", "marker_positions", "camera_names"}, "truth of a wand's take"),
    ({"photo_names", "exposure_stops"}, "truth of photographs"),
    ({"scan_from_head_quaternion", "landmarks_scan"}, "truth of a scan"),
    ({"range_mm", "angle_rad", "height_mm"}, "cylindrical scan"),
    ({"frame_class", "class_names", "phones"}, "truth of a synthetic voice"),
    ({"object_points", "pixels", "visible"}, "truth of a board's shots"),
)


def describe_settings(path: Path) -> Description | None:
    """What a TOML file of a synthetic capture says; None if it is of no synthetic capture.

    Raises
    ------
    FileFormatError
        If it is no TOML, or a take's settings have an unknown key or a wrong kind of value.
    InputError
        If a take's setting is out of its range.
    OSError
        If it cannot be read.
    """
    text = read_text(path, _MAX_SETTINGS_BYTES).removeprefix("\ufeff")
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise FileFormatError(path, "file", "valid TOML", str(error)) from error
    for keys, contents, table in _SETTINGS:
        if keys <= document.keys():
            return _settings(contents, document, table)
    from ..datasets_synthetic.take_settings import TakeSettings

    known = {f.name for f in dataclasses.fields(TakeSettings)}
    if isinstance(document.get("markers", {}), dict) and known & document.keys():
        return _take(path)
    return None


def _settings(contents: str, document: Mapping[str, Any], table: str) -> Description:
    facts = {key: value for key, value in _flat(document) if key not in ("version", table)}
    tables = document.get(table, []) if table else []
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        return Description(contents, facts)
    columns = list(dict.fromkeys(key for t in tables for key in t))
    items = tuple({key: _cell(t.get(key)) for key in columns} for t in tables)
    name = f"{table}s" if table else ""
    return Description(contents, {**facts, **({f"n_{name}": len(items)} if name else {})},
                       name, items)  # fmt: skip


def _take(path: Path) -> Description:
    """A take's settings: the main ones, its difficulties, and all that is not the default."""
    from ..datasets_synthetic.take_settings import TROUBLES, read_take_settings, settings_for

    found, seed = read_take_settings(path)
    plain = dict(_flat(dataclasses.asdict(settings_for(found.kind, found.markers.look))))
    values = dict(_flat(dataclasses.asdict(found)))
    items = tuple(
        {"setting": key, "value": _cell(value), "default": _cell(plain[key])}
        for key, value in values.items()
        if value != plain[key]
    )
    troubles = [
        name
        for name, changes in TROUBLES.items()
        if all(values[key] == value for key, value in changes.items())
        and any(plain[key] != value for key, value in changes.items())
    ]
    facts = {
        "kind": found.kind,
        "seed": seed,
        "duration_s": found.seconds,
        "n_cameras": found.cameras.count,
        "width_px": found.cameras.image_size[0],
        "height_px": found.cameras.image_size[1],
        "rate_hz": found.cameras.rate_hz,
        "difficulties": ", ".join(troubles) or "none",
    }
    return Description("synthetic take", facts, "settings", items)


def describe_ply(path: Path) -> Description:
    """What a ``.ply`` mesh holds."""
    import numpy as np

    from ..core.formats.ply import read_ply

    found = read_ply(path)
    mesh = found.mesh
    facts: dict[str, Any] = {
        "n_vertices": len(mesh.vertices),
        "n_triangles": len(mesh.triangles),
        "colours": found.colour is not None,
        "texture_coordinates": mesh.uv is not None,
        "texture": found.texture,
    }
    if len(mesh.vertices):
        for axis, extent in zip("xyz", np.ptp(np.asarray(mesh.vertices), axis=0), strict=True):
            facts[f"size_{axis}_mm"] = float(extent)
    return Description("mesh (PLY)", facts)


def describe_picture(path: Path) -> Description:
    """Size and kind of a picture, from its header."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            facts = {
                "width_px": picture.width,
                "height_px": picture.height,
                "format": picture.format,
                "channels": "".join(picture.getbands()),
                "bits": 16 if picture.mode.startswith("I") else 8,
                "exif_orientation": picture.getexif().get(0x0112),
            }
    # what Pillow raises on damage
    except (SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FileFormatError(path, "file", "a picture", str(error)) from error
    except OSError as error:
        if error.errno is not None:
            raise
        raise FileFormatError(path, "file", "a picture", "a damaged one") from error
    return Description("picture", facts)


def describe_table(path: Path) -> Description:
    """Columns and rows of a table with a heading (CSV).

    Raises
    ------
    FileFormatError
        If a row has not as many cells as the heading.
    OSError
        If it cannot be read.
    """
    try:
        rows = csv.reader(read_text(path).splitlines(), strict=True)
        heading = next(rows, [])
        n_rows = 0
        for row in rows:
            if len(row) != len(heading):
                where, cells = f"line {rows.line_num}", f"{len(heading)} cells"
                raise FileFormatError(path, where, cells, str(len(row)))
            n_rows += 1
    except csv.Error as error:
        raise FileFormatError(path, "file", "a table (CSV)", str(error)) from error
    if not all(cell.isprintable() and "\ufffd" not in cell for cell in heading):
        raise FileFormatError(path, "line 1", "names of columns", "junk")
    return Description("table (CSV)", {"n_rows": n_rows, "columns": ", ".join(heading)})


def archive_contents(names: set[str]) -> str:
    """What an archive with arrays of these names is, in words; ``"arrays"`` if not known."""
    return next((contents for keys, contents in _ARCHIVES if keys <= names), "arrays")


def _flat(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by their keys, ``"cameras.count"``; lists of tables are left out."""
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif not (isinstance(value, list) and value and isinstance(value[0], dict)):
            is_list = isinstance(value, list | tuple)
            yield prefix + key, _cell(tuple(value)) if is_list else value


def _cell(value: Any) -> Any:
    """A value as a cell of a table: lists as text, long texts cut."""
    if isinstance(value, list | tuple):
        value = " ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
    if isinstance(value, str) and len(value) > _MAX_CELL:
        return value[: _MAX_CELL - 1] + "…"
    return value
