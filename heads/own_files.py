"""Files of heads of other makers, read as they are.

Everything that is no mesh of triangles (bones, animations, lights) is left aside.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.formats.glb_document import GlbDocument
from ..core.formats.gltf import GltfPart, scene_from_glb
from ..core.formats.obj import ObjMaterial, read_obj
from ..core.formats.ply import read_ply
from ..core.formats.vrm import vrm_expressions
from .head_facts import facts_in_extras
from .own_mesh import Look, OwnMesh, stitched
from .srgb import srgb_from_linear

#: Suffixes of files that `read_own_mesh` reads.
OWN_SUFFIXES = (".obj", ".ply", ".glb", ".vrm")
#: More vertices than any head needs; a file that has more is refused.
MAX_VERTICES = 2_000_000
_MAX_PICTURE_PX = 1 << 27
#: Extensions of glTF whose absence changes nothing here.
_HARMLESS = (
    "KHR_materials_", "KHR_mesh_quantization", "KHR_lights_punctual", "KHR_texture_transform",
    "VRM", "VRMC_", "EXT_texture_webp", "KHR_xmp",
)  # fmt: skip


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
    return stitched(raw)


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
        _looks_of_parts(path, parts),
        tuple(names),
        shapes if names else None,
        _said_of_extensions(document),
        facts_in_extras(scene.extras, path),
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


def _looks_of_parts(path: Path, parts: tuple[GltfPart, ...]) -> dict[str, Look]:
    """Each part's look; parts with the same picture share it."""
    pictures: dict[bytes, NDArray[np.uint8]] = {}
    looks = {}
    for part in parts:
        linear = part.base_color[None, :3].astype(np.float32)
        r, g, b = (int(x) for x in srgb_from_linear(linear)[0])
        data = part.texture_png
        if data is not None and data not in pictures:
            pictures[data] = _picture(data, f"{path}, texture of {part.name}")
        looks[part.name] = Look((r, g, b), None if data is None else pictures[data])
    return looks


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
