"""``markers.toml``: which dot is glued where.

::

    version = 1
    name = "lab set"
    diameter_mm = 4.0              # optional: of the markers
    standoff_mm = 2.5              # optional: from the skin to the centre of a ball; 0 for dots

    [[marker]]
    label = "chin"
    feature_point = "2.1"          # an MPEG-4 feature point, "head" or "face"
    colour = "#20a040"             # optional: of a painted dot, sRGB

    [[marker]]
    label = "brow_band_left"
    feature_point = "head"         # moves with the skull only
    template_mm = [45.0, 60.0, 5.0]

    [fapu]                         # optional: the performer's units as measured, mm
    irisd = 9.5                    # between the lids' edges
    es = 62.0                      # between the pupils
    ens = 45.5                     # from the pupils' height to the base of the nose
    mns = 17.0                     # from the base of the nose to the lips' meeting line
    mw = 50.5                      # between the corners of the mouth

    [[marker]]
    label = "cheek_between"
    feature_point = "face"         # moves with the skin, shows no feature point
    template_mm = [38.0, -40.0, 62.0]

``template_mm`` is optional for feature points and needed for head and face markers.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ..errors import FileFormatError, InputError
from ..files import atomic_write, read_text
from ..markers import FACE, HEAD, Marker, MarkerSet
from ..mpeg4 import Fapu, feature_point_table

VERSION = 1
_MAX_BYTES = 4 * 1024 * 1024
_FILE_KEYS = ("version", "name", "diameter_mm", "standoff_mm", "marker", "fapu")
_FAPU_KEYS = ("irisd", "es", "ens", "mns", "mw")
_MARKER_KEYS = ("label", "feature_point", "template_mm", "colour")


def read_marker_set(path: Path) -> MarkerSet:
    """Read a marker set.

    Raises
    ------
    FileFormatError
        ``set.toml, marker "chin", feature_point: expected a feature point like "8.1", "head" or
        "face", found "99.1"``; a syntax error names line and column, an unknown key is named.
    InputError
        If the markers are each right but do not make a set (a label twice, fewer than 3 head
        markers); the message names the file.
    OSError
        If the file cannot be read.
    """
    document = _parse(path)
    _refuse_unknown(path, "file", document, _FILE_KEYS)
    version = document.get("version")
    if version != VERSION or isinstance(version, bool):
        raise FileFormatError(path, "version", str(VERSION), _show(version))
    name = _text(path, "name", document.get("name"))
    entries = document.get("marker")
    if not isinstance(entries, list) or not entries:
        raise FileFormatError(path, "file", "tables headed [[marker]]", _show(entries))
    markers = tuple(_marker(path, number, entry) for number, entry in enumerate(entries, 1))
    fapu = _fapu(path, document["fapu"]) if "fapu" in document else None
    diameter = document.get("diameter_mm")
    standoff = document.get("standoff_mm", 0.0)
    for key, value in (
        ("diameter_mm", 1.0 if diameter is None else diameter),
        ("standoff_mm", standoff),
    ):
        if not _is_length(value):
            raise FileFormatError(path, key, "a length in mm", _show(value))
    try:
        return MarkerSet(
            name, markers, fapu, None if diameter is None else float(diameter), float(standoff)
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_marker_set(path: Path, marker_set: MarkerSet) -> None:
    """Write a marker set; it reads back as it was."""
    with atomic_write(path) as stream:
        stream.write(f"version = {VERSION}\nname = {_quoted(marker_set.name)}\n")
        if marker_set.diameter_mm is not None:
            stream.write(f"diameter_mm = {float(marker_set.diameter_mm)!r}\n")
        if marker_set.standoff_mm:
            stream.write(f"standoff_mm = {float(marker_set.standoff_mm)!r}\n")
        for marker in marker_set.markers:
            stream.write(f"\n[[marker]]\nlabel = {_quoted(marker.label)}\n")
            stream.write(f"feature_point = {_quoted(marker.feature_point)}\n")
            if marker.template_mm is not None:
                numbers = ", ".join(repr(float(x)) for x in marker.template_mm)
                stream.write(f"template_mm = [{numbers}]\n")
            if marker.colour is not None:
                stream.write(f"colour = {_quoted(marker.colour)}\n")
        if marker_set.fapu is not None:
            stream.write("\n[fapu]\n")
            for key in _FAPU_KEYS:
                stream.write(f"{key} = {getattr(marker_set.fapu, key)!r}\n")


def _quoted(text: str) -> str:
    """A TOML basic string: JSON's escapes are TOML's, but for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _parse(path: Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES).removeprefix("\ufeff")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        place = re.search(r" \(at (.*)\)$", message)
        where = place.group(1) if place else "file"
        found = message[: place.start()] if place else message
        raise FileFormatError(path, where, "valid TOML", found) from error
    except (RecursionError, ValueError) as error:  # absurd nesting, an integer of 5000 digits
        raise FileFormatError(path, "file", "valid TOML", str(error)) from error


def _show(value: Any) -> str:
    if value is None:
        return "nothing"
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _text(path: Path, where: str, value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise FileFormatError(path, where, "a text in quotes", _show(value))
    return value


def _refuse_unknown(
    path: Path, where: str, entry: Mapping[str, Any], known: Collection[str]
) -> None:
    for key in entry:
        if key not in known:
            raise FileFormatError(path, where, f"only the keys {', '.join(known)}", _show(key))


def _marker(path: Path, number: int, entry: Any) -> Marker:
    where = f"marker {number}"
    if not isinstance(entry, dict):
        raise FileFormatError(path, where, "a table headed [[marker]]", _show(entry))
    label = _text(path, f"{where}, label", entry.get("label"))
    where = f'marker "{label}"'
    _refuse_unknown(path, where, entry, _MARKER_KEYS)
    point = entry.get("feature_point")
    known = (HEAD, FACE, *feature_point_table())
    if not isinstance(point, str) or point not in known:
        expected = 'a feature point like "8.1", "head" or "face"'
        raise FileFormatError(path, f"{where}, feature_point", expected, _show(point))
    colour = entry.get("colour")
    if colour is not None:
        colour = _text(path, f"{where}, colour", colour)
    return Marker(label, point, _template(path, where, entry.get("template_mm")), colour)


def _fapu(path: Path, entry: Any) -> Fapu:
    if not isinstance(entry, dict):
        raise FileFormatError(path, "fapu", "a table headed [fapu]", _show(entry))
    _refuse_unknown(path, "fapu", entry, _FAPU_KEYS)
    for key in _FAPU_KEYS:
        value = entry.get(key)
        if not _is_length(value) or value <= 0:  # type: ignore[operator]
            raise FileFormatError(path, f"fapu, {key}", "a length in mm above 0", _show(value))
    return Fapu(**{key: float(entry[key]) for key in _FAPU_KEYS})


def _template(path: Path, where: str, value: Any) -> tuple[float, float, float] | None:
    if value is None:
        return None
    is_point = isinstance(value, list) and len(value) == 3
    if not is_point or not all(_is_length(x) for x in value):
        raise FileFormatError(path, f"{where}, template_mm", "[x, y, z] in mm", _show(value))
    return float(value[0]), float(value[1]), float(value[2])


def _is_length(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and abs(value) < 1e6
