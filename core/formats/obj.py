"""``.obj``: Wavefront meshes, as sculpting programs write them.

Read: vertices, texture coordinates, polygons (cut into fans), negative indices, colours behind a
vertex's coordinates (skipped), and what each polygon belongs to: object, group and material. Lines
and points, curves and normals are skipped. Of the material libraries beside the file: each
material's colour (``Kd``) and the name of its picture (``map_Kd``).

The file says no unit: numbers are taken as they are.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..files import read_text
from ..mesh import Mesh

_log = logging.getLogger(__name__)
_LARGEST = 1e30
_MAX_SHOWN = 40


@dataclass(frozen=True)
class ObjMaterial:
    """A material: sRGB colour 0 to 1, and the picture's file name as the library gives it."""

    colour: tuple[float, float, float] = (0.8, 0.8, 0.8)
    picture: str | None = None


@dataclass(frozen=True, eq=False)
class ObjMesh:
    """What an ``.obj`` file holds.

    Attributes
    ----------
    mesh : Mesh
        Vertices in the file's order and unit, none merged or dropped. Groups: one for each
        combination of object, group and material, named ``object/group/material`` without what is
        not given.
    materials : mapping from a group's name to ObjMaterial
        For the groups whose material a library beside the file describes.
    """

    mesh: Mesh
    materials: Mapping[str, ObjMaterial] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", MappingProxyType(dict(self.materials)))


def read_obj(path: Path) -> ObjMesh:
    """Read a mesh.

    Raises
    ------
    FileFormatError
        ``head.obj, line 812: expected vertices 1 to 468, found 469``.
    OSError
        If the file cannot be read.
    """
    parser = _Parser(path)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        parser.take(number, line)
    return parser.finished()


class _Parser:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._vertices: list[tuple[float, ...]] = []
        self._uv: list[tuple[float, ...]] = []
        self._triangles: list[tuple[int, int, int]] = []
        self._uv_triangles: list[tuple[int, int, int]] = []
        self._lines: list[int] = []
        self._labels = {"o": "", "g": "", "usemtl": ""}
        self._group_rows: dict[str, list[int]] = {}
        self._material_of: dict[str, str] = {}
        self._libraries: list[str] = []
        self._rows: list[int] = self._group()

    def take(self, number: int, line: str) -> None:
        """One line."""
        word, _, rest = line.strip().partition(" ")
        if word == "v":
            self._vertices.append(self._numbers(number, rest, 3, "x y z"))
        elif word == "f":
            self._face(number, rest.split())
        elif word == "vt":
            self._uv.append(self._numbers(number, rest, 2, "u v"))
        elif word in self._labels:
            self._labels[word] = rest.strip()
            self._rows = self._group()
        elif word == "mtllib":
            self._libraries.append(rest.strip())

    def _group(self) -> list[int]:
        labels = self._labels
        name = "/".join(label for label in labels.values() if label)
        self._material_of[name] = labels["usemtl"]
        return self._group_rows.setdefault(name, [])

    def _numbers(self, number: int, text: str, count: int, what: str) -> tuple[float, ...]:
        words = text.split()[:count]
        try:
            values = tuple(float(word) for word in words)
        except ValueError:
            values = ()
        if len(values) == 1 and what == "u v":  # one-dimensional textures
            values = (values[0], 0.0)
        if len(values) != count or not all(abs(x) < _LARGEST for x in values):
            raise FileFormatError(
                self._path, f"line {number}", f"{count} finite numbers {what}", _shown(text)
            )
        return values

    def _face(self, number: int, corners: list[str]) -> None:
        if len(corners) < 3:
            found = f"{len(corners)}"
            raise FileFormatError(self._path, f"line {number}", "at least 3 corners", found)
        n_vertices, n_uv = len(self._vertices), len(self._uv)
        places, coordinates = [], []
        for corner in corners:
            vertex, _, rest = corner.partition("/")
            places.append(self._index(number, vertex, n_vertices, "vertices"))
            uv = rest.partition("/")[0]
            coordinates.append(self._index(number, uv, n_uv, "texture coordinates") if uv else -1)
        for k in range(1, len(places) - 1):
            self._rows.append(len(self._triangles))
            self._triangles.append((places[0], places[k], places[k + 1]))
            self._uv_triangles.append((coordinates[0], coordinates[k], coordinates[k + 1]))

    def _index(self, number: int, text: str, count: int, what: str) -> int:
        """A row from 0; negative numbers count back from what has been read."""
        try:
            value = int(text)
        except ValueError:
            value = 0
        row = value - 1 if value > 0 else count + value
        if value == 0 or not 0 <= row < count:
            raise FileFormatError(
                self._path, f"line {number}", f"{what} 1 to {count}", _shown(text)
            )
        return row

    def finished(self) -> ObjMesh:
        """All that was read."""
        if not self._triangles:
            raise FileFormatError(self._path, "file", "lines of v and f (a mesh)", "no polygon")
        triangles = np.array(self._triangles, dtype=np.int32)
        uv_triangles = np.array(self._uv_triangles, dtype=np.int32)
        uv: NDArray[np.float64] | None = None
        if self._uv and uv_triangles.max() >= 0:
            uv = np.array(self._uv)
            if uv_triangles.min() < 0:  # some corners have none: they share a row of their own
                uv_triangles = np.where(uv_triangles < 0, len(uv), uv_triangles)
                uv = np.concatenate([uv, [[0.5, 0.5]]])
        groups = {
            name: np.array(rows, dtype=np.int32) for name, rows in self._group_rows.items() if rows
        }
        mesh = Mesh(
            np.array(self._vertices),
            triangles,
            uv,
            None if uv is None else uv_triangles,
            groups,
        )
        known = self._library()
        materials = {
            name: known[self._material_of[name]]
            for name in groups
            if self._material_of[name] in known
        }
        return ObjMesh(mesh, materials)

    def _library(self) -> dict[str, ObjMaterial]:
        found: dict[str, ObjMaterial] = {}
        for name in self._libraries:
            path = self._path.parent / Path(name.replace("\\", "/")).name
            if path.is_file():
                found.update(_read_materials(path))
            else:
                _log.warning("%s: its materials (%s) are not beside it", self._path, name)
        return found


def _read_materials(path: Path) -> dict[str, ObjMaterial]:
    found: dict[str, ObjMaterial] = {}
    name = ""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        word, _, rest = line.strip().partition(" ")
        if word == "newmtl":
            name = rest.strip()
            found[name] = ObjMaterial()
        elif word == "Kd" and name:
            try:
                r, g, b = (min(max(float(x), 0.0), 1.0) for x in rest.split()[:3])
            except ValueError:
                raise FileFormatError(
                    path, f"line {number}", "3 numbers Kd", _shown(rest)
                ) from None
            found[name] = ObjMaterial((r, g, b), found[name].picture)
        elif word == "map_Kd" and name and rest.strip():
            picture = rest.split()[-1] if rest.strip().startswith("-") else rest.strip()
            found[name] = ObjMaterial(found[name].colour, picture)
    return found


def _shown(text: str) -> str:
    cut = text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"
    return f'"{cut}"'
