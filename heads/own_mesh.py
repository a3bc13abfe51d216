"""Meshes of other makers, as they come from a file: stitched, labelled, with shapes and pictures.

Nothing of a head is known here yet. What was done to the mesh is said in `notes`.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..core.arrays import readonly
from ..core.errors import FileFormatError, InputError
from ..core.formats.glb_document import GlbDocument
from ..core.formats.gltf import GltfPart, scene_from_glb
from ..core.formats.obj import ObjMaterial, read_obj
from ..core.formats.ply import read_ply
from ..core.formats.vrm import vrm_expressions
from .srgb import srgb_from_linear

Floats = NDArray[np.float64]

#: Suffixes of files that `read_own_mesh` reads.
OWN_SUFFIXES = (".obj", ".ply", ".glb", ".vrm")
#: More vertices than any head needs; a file that has more is refused.
MAX_VERTICES = 2_000_000
_SAME_PLACE = 1e-6  # of the mesh's size
_STEPS = 1 << 20  # more than 1 / _SAME_PLACE
_SAME_SHAPE = 1e-4
_MAX_PICTURE_PX = 1 << 27
_GREY = (204, 204, 204)
#: Extensions of glTF whose absence changes nothing here.
_HARMLESS = (
    "KHR_materials_", "KHR_mesh_quantization", "KHR_lights_punctual", "KHR_texture_transform",
    "VRM", "VRMC_", "EXT_texture_webp", "KHR_xmp",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Look:
    """What a label's triangles look like.

    Attributes
    ----------
    colour : sRGB triple 0 to 255
        Multiplies the picture.
    picture : (h, w, 3) uint8, sRGB, or None
    """

    colour: tuple[int, int, int] = _GREY
    picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """A mesh from a file.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's axes and unit (of a .glb: millimetres)
    triangles : (F, 3) int32
    uv : (U, 2) float64 or None; uv_triangles : (F, 3) int32 or None
        As of `Mesh`.
    labels : tuple of str
        What the file calls its parts; `label_of_triangle` (F,) int32 are their numbers.
    looks : mapping from label to Look
    shape_names : tuple of str, length N
    shapes : (N, V, 3) float32
        Offsets, as `vertices`.
    notes : tuple of str
        What was found and done, for the user.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    labels: tuple[str, ...]
    label_of_triangle: NDArray[np.int32]
    uv: Floats | None = None
    uv_triangles: NDArray[np.int32] | None = None
    looks: Mapping[str, Look] = field(default_factory=dict)
    shape_names: tuple[str, ...] = ()
    shapes: NDArray[np.float32] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "vertices", readonly(self.vertices, (None, 3), "vertices"))
        put(self, "triangles", readonly(self.triangles, (None, 3), "triangles", np.int32))
        labels = readonly(
            self.label_of_triangle, (len(self.triangles),), "label_of_triangle", np.int32
        )
        put(self, "label_of_triangle", labels)


def read_own_mesh(path: Path) -> OwnMesh:
    """Read a mesh of any format in `OWN_SUFFIXES`, and stitch it along the seams of its texture.

    Raises
    ------
    FileFormatError
        If the file is damaged.
    InputError
        If its suffix is none of these, or it holds more than a head can need.
    OSError
        If it cannot be read.
    """
    readers = {".obj": _from_obj, ".ply": _from_ply, ".glb": _from_glb, ".vrm": _from_glb}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise InputError(f"{path}: expected a head in a file {', '.join(OWN_SUFFIXES)}")
    raw = readers[suffix](path)
    if len(raw.vertices) > MAX_VERTICES:
        raise InputError(
            f"{path}: has {len(raw.vertices)} vertices; up to {MAX_VERTICES} are taken: "
            "decimate it first"
        )
    return _stitched(raw)


def _from_obj(path: Path) -> OwnMesh:
    found = read_obj(path)
    mesh = found.mesh
    labels, of_triangle = tuple(mesh.groups), np.zeros(len(mesh.triangles), np.int32)
    for i, rows in enumerate(mesh.groups.values()):
        of_triangle[rows] = i
    looks = {name: _look_of_material(path, material) for name, material in found.materials.items()}
    return OwnMesh(
        mesh.vertices, mesh.triangles, labels, of_triangle, mesh.uv, mesh.uv_triangles, looks
    )


def _look_of_material(path: Path, material: ObjMaterial) -> Look:
    r, g, b = (round(255 * x) for x in material.colour)
    if material.picture is None:
        return Look((r, g, b))
    file = path.parent / Path(material.picture.replace("\\", "/")).name
    if not file.is_file():
        return Look((r, g, b))
    return Look((255, 255, 255), _picture(file.read_bytes(), file))


def _from_ply(path: Path) -> OwnMesh:
    found = read_ply(path)
    mesh, looks = found.mesh, {}
    if found.texture is not None:
        file = path.parent / Path(found.texture.replace("\\", "/")).name
        if file.is_file():
            looks["mesh"] = Look((255, 255, 255), _picture(file.read_bytes(), file))
    if not looks and found.colour is not None:
        r, g, b = (int(c) for c in found.colour.mean(axis=0))
        looks["mesh"] = Look((r, g, b))
    none = np.zeros(len(mesh.triangles), np.int32)
    return OwnMesh(
        mesh.vertices, mesh.triangles, ("mesh",), none, mesh.uv, mesh.uv_triangles, looks
    )


def _from_glb(path: Path) -> OwnMesh:
    data = path.read_bytes()
    scene = scene_from_glb(data, path)
    document = GlbDocument(path, data)
    parts = scene.parts
    start = np.concatenate([[0], np.cumsum([len(p.vertices) for p in parts])])
    names = list(dict.fromkeys(t.name for p in parts for t in p.targets))
    shapes = np.zeros((len(names), start[-1], 3), np.float32)
    for begin, part in zip(start, parts, strict=False):
        for target in part.targets:
            shapes[names.index(target.name), begin + target.rows] = target.offsets
    names, shapes = _with_expressions(document, names, shapes)
    uv = [np.zeros((len(p.vertices), 2)) if p.uv is None else p.uv for p in parts]
    triangles = np.concatenate([p.triangles + b for b, p in zip(start, parts, strict=False)])
    has_uv = any(p.uv is not None for p in parts)
    return OwnMesh(
        np.concatenate([p.vertices for p in parts]),
        triangles,
        tuple(p.name for p in parts),
        np.repeat(np.arange(len(parts)), [len(p.triangles) for p in parts]).astype(np.int32),
        np.concatenate(uv) if has_uv else None,
        triangles if has_uv else None,
        {p.name: _look_of_part(path, p) for p in parts},
        tuple(names),
        shapes if names else None,
        _said_of_extensions(document),
    )


def _with_expressions(
    document: GlbDocument, names: list[str], shapes: NDArray[np.float32]
) -> tuple[list[str], NDArray[np.float32]]:
    """Shapes and, of an avatar, its expressions as further shapes."""
    sums = []
    added = []
    for name, weights in vrm_expressions(document).items():
        known = [target for target in weights if target in names]
        if name not in names and known:
            added.append(name)
            rows = [names.index(target) for target in known]
            amounts = np.array([weights[target] for target in known], np.float32)
            sums.append(np.tensordot(amounts, shapes[rows], axes=1))
    if not added:
        return names, shapes
    return names + added, np.concatenate([shapes, np.stack(sums)])


def _look_of_part(path: Path, part: GltfPart) -> Look:
    r, g, b = (int(x) for x in srgb_from_linear(part.base_color[None, :3].astype(np.float32))[0])
    if part.texture_png is None:
        return Look((r, g, b))
    return Look((r, g, b), _picture(part.texture_png, f"{path}, texture of {part.name}"))


def _said_of_extensions(document: GlbDocument) -> tuple[str, ...]:
    used = [str(n) for n in document.array(document.root, "extensionsUsed", "document")]
    unknown = [name for name in used if not name.startswith(_HARMLESS)]
    if not unknown:
        return ()
    return (f"the file uses extensions that are not read: {', '.join(unknown)}",)


def _picture(data: bytes, name: Path | str) -> NDArray[np.uint8]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(data)) as picture:
            if picture.width * picture.height > _MAX_PICTURE_PX:
                raise FileFormatError(
                    name, "size", f"at most {_MAX_PICTURE_PX} pixels", f"{picture.size}"
                )
            return np.array(picture.convert("RGB"))
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise FileFormatError(name, "file", "a picture", str(error)) from error


# Stitching ----------------------------------------------------------------------------------


def _stitched(mesh: OwnMesh) -> OwnMesh:
    """The mesh with vertices joined that texture seams or parts of the file keep apart.

    Only borders are joined, side to side and with opposite directions, and only where all shapes
    move both sides alike: lips that touch stay apart. Vertices without a triangle are left out.
    """
    notes = list(mesh.notes)
    row = _joined_rows(mesh)
    triangles = row[mesh.triangles]
    whole = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    if not whole.any():
        raise InputError("the mesh has no triangle with an area")
    if not whole.all():
        notes.append(f"{int((~whole).sum())} triangles without an area are left out")
    used, compact = np.unique(triangles[whole], return_inverse=True)
    first = np.full(int(row.max()) + 1, len(row))
    np.minimum.at(first, row, np.arange(len(row)))
    chosen = first[used]
    n_joined = len(np.unique(mesh.triangles)) - len(used)
    if n_joined:
        notes.append(f"{n_joined} doubled vertices along seams are joined")
    n_bad = _n_bad_edges(compact.reshape(-1, 3))
    if n_bad:
        notes.append(f"{n_bad} edges have more than two triangles (a non-manifold mesh)")
    return OwnMesh(
        mesh.vertices[chosen],
        compact.reshape(-1, 3).astype(np.int32),
        mesh.labels,
        mesh.label_of_triangle[whole],
        mesh.uv,
        None if mesh.uv_triangles is None else mesh.uv_triangles[whole],
        mesh.looks,
        mesh.shape_names,
        None if mesh.shapes is None else mesh.shapes[:, chosen],
        tuple(notes),
    )


def _joined_rows(mesh: OwnMesh) -> NDArray[np.int64]:
    """A number for each vertex; those that are joined have the same."""
    v, t = mesh.vertices, mesh.triangles
    used = v[np.unique(t)]
    size = float(np.ptp(used, axis=0).max())
    if not size > 0:
        raise InputError("the mesh has no extent")
    steps = np.rint((v - used.min(axis=0)) / (_SAME_PLACE * size)).astype(np.int64)
    steps[(steps < 0).any(axis=1) | (steps >= _STEPS).any(axis=1)] = 0  # without a triangle
    _, place = np.unique((steps[:, 0] * _STEPS + steps[:, 1]) * _STEPS + steps[:, 2],
                         return_inverse=True)  # fmt: skip
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    n = len(v)
    _, inverse, counts = np.unique(side_keys(sides, n), return_inverse=True, return_counts=True)
    border = sides[counts[inverse] == 1]
    a, b = _met_sides(place, border)
    links = np.concatenate([np.stack([a[:, 0], b[:, 1]], 1), np.stack([a[:, 1], b[:, 0]], 1)])
    links = links[_moved_alike(mesh.shapes, links, size)]
    graph = sparse.coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), (n, n))
    _, row = connected_components(graph, directed=False)
    return np.asarray(row, dtype=np.int64)


def _met_sides(
    place: NDArray[np.int64], border: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Pairs of border sides, (n, 2) vertices each, that run opposite ways between the same places.

    Where more than two sides meet it is not known which belong together: none is joined.
    """
    nothing = np.zeros((0, 2), np.int32)
    p = place[border]
    proper = p[:, 0] != p[:, 1]
    border, p = border[proper], p[proper]
    if not len(border):
        return nothing, nothing
    keys = side_keys(p, int(p.max()) + 1)
    _, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    in_two = order[counts[which[order]] == 2]
    first, second = in_two[0::2], in_two[1::2]
    opposite = p[first, 0] == p[second, 1]
    return border[first[opposite]], border[second[opposite]]


def _moved_alike(
    shapes: NDArray[np.float32] | None, links: NDArray[np.int32], size: float
) -> NDArray[np.bool_]:
    alike = np.ones(len(links), dtype=bool)
    for shape in () if shapes is None else shapes:
        off = np.abs(shape[links[:, 0]] - shape[links[:, 1]]).max(axis=1, initial=0.0)
        alike &= off < _SAME_SHAPE * size
    return alike


def _n_bad_edges(triangles: NDArray[np.int64]) -> int:
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, counts = np.unique(side_keys(sides, int(triangles.max()) + 1), return_counts=True)
    return int((counts > 2).sum())


def side_keys(sides: NDArray[Any], n_vertices: int) -> NDArray[np.int64]:
    """A number for each side (n, 2), the same in both directions."""
    low, high = sides.min(axis=1).astype(np.int64), sides.max(axis=1).astype(np.int64)
    return np.asarray(low * n_vertices + high)


def shells(triangles: NDArray[np.int32], n_vertices: int) -> list[NDArray[np.int32]]:
    """Triangle indices of each connected shell, the one with most triangles first."""
    a, b = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    graph = sparse.coo_matrix((np.ones(len(a)), (a, b)), (n_vertices, n_vertices))
    _, label = connected_components(graph, directed=False)
    of_triangle = label[triangles[:, 0]]
    order = np.argsort(of_triangle, kind="stable")
    _, starts = np.unique(of_triangle[order], return_index=True)
    found: Sequence[NDArray[np.int64]] = np.split(order, starts[1:])
    return sorted((rows.astype(np.int32) for rows in found), key=lambda rows: -len(rows))
