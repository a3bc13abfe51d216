"""``.ply``: triangle meshes with colours and texture coordinates, as scanners write them.

Written: binary, little-endian; vertices ``x y z`` (and ``red green blue``), faces
``vertex_indices`` (and ``texcoord``: u v of each corner, origin at the bottom left). Read: text and
both binary forms, any further properties and elements (skipped), polygons (cut into fans), per
corner ``texcoord`` or texture coordinates of the vertices (``s t``, ``u v``, ``texture_u
texture_v``).

The file says no unit: lengths are millimetres, as everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import readonly
from ..errors import FileFormatError
from ..files import atomic_path
from ..mesh import Mesh
from .ply_elements import Column, read_elements

_VERTEX_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_RGB = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class PlyMesh:
    """What a ``.ply`` file holds.

    Attributes
    ----------
    mesh : Mesh
        Vertices in the file's order, none merged or dropped.
    colour : (V, 3) uint8, sRGB, or None
        Of the vertices.
    texture : str or None
        Name of the picture that the file asks for (``comment TextureFile``).
    """

    mesh: Mesh
    colour: NDArray[np.uint8] | None = None
    texture: str | None = None

    def __post_init__(self) -> None:
        if self.colour is not None:
            wanted = (len(self.mesh.vertices), 3)
            object.__setattr__(self, "colour", readonly(self.colour, wanted, "colour", np.uint8))


def write_ply(path: Path, ply: PlyMesh, *, double: bool = False) -> None:
    """Write a mesh; it appears whole or not at all.

    Groups and landmarks are not written.

    Parameters
    ----------
    path : Path
    ply : PlyMesh
    double : bool
        Coordinates with all their digits; otherwise in single precision (about 1e-5 mm).

    Raises
    ------
    ValueError
        If a vertex is not finite, or the texture's name holds a line break.
    """
    mesh = ply.mesh
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("vertices must be finite")
    if ply.texture is not None and not ply.texture.isprintable():
        raise ValueError(f"the texture's name must be printable, got {ply.texture!r}")
    number = "<f8" if double else "<f4"
    vertex: list[Any] = [(axis, number) for axis in "xyz"]
    if ply.colour is not None:
        vertex += [(name, "u1") for name in _RGB]
    face: list[Any] = [("n", "u1"), ("corners", "<i4", 3)]
    if mesh.uv is not None:
        face += [("m", "u1"), ("uv", "<f4", 6)]
    vertices = np.zeros(len(mesh.vertices), vertex)
    for k, axis in enumerate("xyz"):
        vertices[axis] = mesh.vertices[:, k]
    if ply.colour is not None:
        for k, name in enumerate(_RGB):
            vertices[name] = ply.colour[:, k]
    faces = np.zeros(len(mesh.triangles), face)
    faces["n"], faces["corners"] = 3, mesh.triangles
    if mesh.uv is not None and mesh.uv_triangles is not None:
        faces["m"], faces["uv"] = 6, mesh.uv[mesh.uv_triangles].reshape(-1, 6)
    with atomic_path(path) as part, open(part, "wb") as stream:
        stream.write(_header(ply, "double" if double else "float").encode("utf-8"))
        stream.write(vertices.tobytes())
        stream.write(faces.tobytes())


def _header(ply: PlyMesh, number: str) -> str:
    mesh = ply.mesh
    lines = ["ply", "format binary_little_endian 1.0", "comment lengths are millimetres"]
    if ply.texture is not None:
        lines.append(f"comment TextureFile {ply.texture}")
    lines.append(f"element vertex {len(mesh.vertices)}")
    lines += [f"property {number} {axis}" for axis in "xyz"]
    if ply.colour is not None:
        lines += [f"property uchar {name}" for name in _RGB]
    lines.append(f"element face {len(mesh.triangles)}")
    lines.append("property list uchar int vertex_indices")
    if mesh.uv is not None:
        lines.append("property list uchar float texcoord")
    return "\n".join([*lines, "end_header", ""])


def read_ply(path: Path) -> PlyMesh:
    """Read a triangle mesh.

    Raises
    ------
    FileFormatError
        ``head.ply, face 12: expected vertices 0 to 7, found 9``.
    OSError
        If the file cannot be read.
    """
    elements, comments = read_elements(path)
    if "vertex" not in elements:
        raise FileFormatError(path, "header", "an element vertex", "none")
    vertices = _vertices(path, elements["vertex"])
    faces = elements.get("face", {})
    lists = faces.get("vertex_indices", faces.get("vertex_index"))
    if lists is None or lists.counts is None:
        raise FileFormatError(
            path, "header", "faces with a list vertex_indices (a mesh)", "none (a point cloud?)"
        )
    _check_corners(path, lists, len(vertices))
    first, second, third = _fans(lists.counts)
    corners = lists.values.astype(np.int64)
    triangles = np.stack([corners[first], corners[second], corners[third]], axis=1)
    uv, uv_triangles = _texture_coordinates(
        path, elements["vertex"], faces, lists, np.stack([first, second, third], axis=1), triangles
    )
    mesh = Mesh(vertices, triangles.astype(np.int32), uv, uv_triangles)
    return PlyMesh(mesh, _colour(elements["vertex"]), _texture(comments))


def _vertices(path: Path, columns: Mapping[str, Column]) -> NDArray[np.float64]:
    for axis in "xyz":
        if axis not in columns or columns[axis].counts is not None:
            raise FileFormatError(path, "header", f"a number {axis} of each vertex", "none")
    found = np.stack([columns[axis].values.astype(np.float64) for axis in "xyz"], axis=1)
    bad = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if len(bad):
        x, y, z = found[bad[0]]
        raise FileFormatError(path, f"vertex {bad[0]}", "finite coordinates", f"{x:g} {y:g} {z:g}")
    return found


def _check_corners(path: Path, lists: Column, n_vertices: int) -> None:
    assert lists.counts is not None
    few = np.flatnonzero(lists.counts < 3)
    if len(few):
        found = f"{lists.counts[few[0]]}"
        raise FileFormatError(path, f"face {few[0]}", "at least 3 corners", found)
    rows = lists.values.astype(np.float64)  # some write them as numbers with a point
    wrong = np.flatnonzero(~((rows >= 0) & (rows < n_vertices)))
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(lists.counts), wrong[0], side="right"))
        raise FileFormatError(
            path, f"face {face}", f"vertices 0 to {n_vertices - 1}", f"{rows[wrong[0]]:.10g}"
        )


def _fans(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Places in the joined lists of the corners of each polygon's triangles."""
    begin = np.cumsum(counts) - counts
    face = np.repeat(np.arange(len(counts)), counts - 2)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    first = begin[face]
    return first, first + within + 1, first + within + 2


def _texture_coordinates(
    path: Path,
    vertex: Mapping[str, Column],
    faces: Mapping[str, Column],
    lists: Column,
    places: NDArray[np.int64],
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.float64] | None, NDArray[np.int32] | None]:
    """Rows of texture coordinates and the triangles' corners among them."""
    given = faces.get("texcoord")
    if given is not None and given.counts is not None and lists.counts is not None:
        odd = np.flatnonzero(given.counts != 2 * lists.counts)
        if len(odd):
            raise FileFormatError(
                path,
                f"face {odd[0]}",
                f"{2 * lists.counts[odd[0]]} numbers of texcoord",
                f"{given.counts[odd[0]]}",
            )
        uv = given.values.reshape(-1, 2).astype(np.float64)
        if not np.isfinite(uv).all():
            raise FileFormatError(path, "texcoord", "finite numbers", "nan or inf")
        rows, inverse = np.unique(uv, axis=0, return_inverse=True)
        return rows, inverse.reshape(-1)[places].astype(np.int32)
    for u, v in _VERTEX_UV:
        if u in vertex and v in vertex:
            uv = np.stack([vertex[u].values, vertex[v].values], axis=1).astype(np.float64)
            if not np.isfinite(uv).all():
                raise FileFormatError(path, f"{u} {v}", "finite numbers", "nan or inf")
            return uv, triangles.astype(np.int32)
    return None, None


def _colour(vertex: Mapping[str, Column]) -> NDArray[np.uint8] | None:
    if any(name not in vertex or vertex[name].counts is not None for name in _RGB):
        return None
    values = np.stack([vertex[name].values for name in _RGB], axis=1)
    if values.dtype.kind == "f":  # some write 0 to 1
        values = np.rint(255 * np.nan_to_num(values))
    return np.asarray(np.clip(values, 0, 255).astype(np.uint8))


def _texture(comments: tuple[str, ...]) -> str | None:
    for comment in comments:
        word, _, name = comment.partition(" ")
        if word.lower() == "texturefile" and name.strip():
            return name.strip()
    return None
