"""Reading .glb files, our own and those of others."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..mesh import vertex_normals
from .glb_document import MAX_GLB_BYTES, GlbDocument, Object
from .gltf_nodes import NodeTree, PlacedMesh, Placement
from .gltf_scene import PNG_SIGNATURE, GltfPart, GltfScene, MorphTarget

_log = logging.getLogger(__name__)
_MM_PER_METRE = 1000.0
_IDENTITY = np.eye(4)
_MAX_TEXTURE_PX = 1 << 28
_STRIPS = {5: "strip", 6: "fan"}


def read_glb(path: Path) -> GltfScene:
    """Read a .glb file.

    Files written by `write_glb` come back as they were, to single precision. Of others: all
    triangle meshes of the default scene with their blendshapes, base colour and texture, placed
    as their nodes place them, and the first animation's blendshape weights and node motions.
    Meshes that are bound whole to one joint each move with it; where any is bound to several, all
    skinned ones stand in their rest pose. Left out, with a warning in the log where it could be
    missed: other skeletal animation, animated scale, other animations, points and lines, cameras,
    lights. A JPEG texture becomes a PNG. Vertices keep their order and number.

    Raises
    ------
    FileFormatError
        If the file is damaged, needs data from outside, or an extension we do not read.
    OSError
        If it cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_GLB_BYTES:
        raise FileFormatError(path, "file", f"at most {MAX_GLB_BYTES} bytes", f"{size} bytes")
    return scene_from_glb(path.read_bytes(), path)


def scene_from_glb(data: bytes, name: Path | str = "model.glb") -> GltfScene:
    """What `read_glb` reads, from memory; `name` is what messages call it."""
    document = GlbDocument(name, data)
    try:
        return _SceneReader(document).scene()
    except FileFormatError:
        raise
    except ValueError as error:  # a check of the value types, which know no file
        raise FileFormatError(name, "scene", "a mesh that fits together", str(error)) from error


class _SceneReader:
    def __init__(self, document: GlbDocument) -> None:
        self._file = document
        self._tree = NodeTree(document)
        self._images: dict[int, bytes] = {}

    def scene(self) -> GltfScene:
        parts: list[GltfPart] = []
        taken: set[str] = set()
        for placed in self._tree.placed:
            for part in self._parts(placed):
                parts.append(_renamed(part, taken))
        if not parts:
            self._file.fail("scene", "a mesh of triangles", "none")
        root_rotation, root_translation = self._tree.root_motion()
        scene = self._tree.scene_object()
        extras = self._file.member(scene, "extras", "scene")
        return GltfScene(
            self._file.name_of(scene, "scene"),
            tuple(parts),
            self._tree.animation.time_s,
            root_rotation,
            root_translation,
            {key: value for key, value in extras.items() if isinstance(value, str)},
            self._tree.root_pivot,
        )

    # meshes

    def _parts(self, placed: PlacedMesh) -> list[GltfPart]:
        file = self._file
        node = file.item("nodes", placed.node, "scene")
        mesh = file.item("meshes", node["mesh"], f"node {placed.node}")
        name = file.name_of(node, file.name_of(mesh, f"node {placed.node}"))
        where = f"mesh {node['mesh']}"
        placement = self._tree.placement(placed)
        found = []
        for primitive in file.array(mesh, "primitives", where):
            if not isinstance(primitive, dict):
                file.fail(where, "primitives that are objects", primitive)
            if file.integer(primitive, "mode", where, 4) < 4:
                _log.warning("%s: points and lines of %s are left out", file.name, name)
                continue
            part = self._part(
                name, placed.node, mesh, primitive, placement, where, placed.binding is not None
            )
            found.append(part)
        return found

    def _part(
        self,
        name: str,
        node: int,
        mesh: Object,
        primitive: Object,
        placement: Placement,
        where: str,
        is_bound: bool,
    ) -> GltfPart:
        file = self._file
        attributes = file.member(primitive, "attributes", where)
        points = file.accessor(attributes.get("POSITION"), ("VEC3",), where) * _MM_PER_METRE
        count = len(points)
        triangles = self._triangles(primitive, count, where)
        if "NORMAL" in attributes:
            normals = file.accessor(attributes["NORMAL"], ("VEC3",), where, count)
        else:
            normals = vertex_normals(points, triangles)
        bone = None if is_bound else self._skinning(node, attributes, count, where)
        to_head = placement.head_from_mesh if bone is None else bone
        if to_head.ndim == 2 and np.linalg.det(to_head[:3, :3]) < 0:  # a mirror turns faces over
            triangles = triangles[:, ::-1]
        maps, set_index, look = self._material(primitive, where)
        uv = self._uv(attributes, set_index, count, where)
        texture, normal, rough = (None, None, None) if uv is None else maps
        targets = self._targets(mesh, primitive, count, to_head, where)
        weights = self._weights(node, mesh, len(targets))
        return GltfPart(
            name,
            _moved_points(points, to_head),
            triangles,
            _moved_normals(normals, to_head),
            uv,
            look.color,
            texture_png=texture,
            normal_png=normal,
            roughness_png=rough,
            roughness=look.roughness,
            double_sided=look.double_sided,
            targets=targets,
            weights=weights,
            rotation=placement.rotation,
            translation=placement.translation,
            pivot=placement.pivot,
            joint=placement.joint,
        )

    def _triangles(self, primitive: Object, count: int, where: str) -> NDArray[np.int32]:
        if "indices" in primitive:
            corners = self._file.accessor(primitive["indices"], ("SCALAR",), where, integers=True)
        else:
            corners = np.arange(count, dtype=np.float64)
        mode = self._file.integer(primitive, "mode", where, 4)
        if mode > 6 or len(corners) < 3 or (mode == 4 and len(corners) % 3):
            self._file.fail(where, "triangles", f"{len(corners)} corners in mode {mode}")
        if corners.max() >= count:
            self._file.fail(where, f"corners below {count}", int(corners.max()))
        whole = corners.astype(np.int32)
        return _as_triangles(whole, _STRIPS.get(mode))

    def _uv(
        self, attributes: Object, set_index: int, count: int, where: str
    ) -> NDArray[np.float64] | None:
        key = f"TEXCOORD_{set_index}"
        if key not in attributes:
            return None
        uv = self._file.accessor(attributes[key], ("VEC2",), where, count)
        return np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)

    def _targets(
        self,
        mesh: Object,
        primitive: Object,
        count: int,
        to_head: NDArray[np.float64],
        where: str,
    ) -> tuple[MorphTarget, ...]:
        targets = self._file.array(primitive, "targets", where)
        names = target_names(mesh, primitive, len(targets))
        has_normals = any(isinstance(t, dict) and "NORMAL" in t for t in targets)
        found = []
        for name, target in zip(names, targets, strict=True):
            if not isinstance(target, dict):
                self._file.fail(where, "targets that are objects", target)
            rows, offsets, normals = self._target(target, count, where, has_normals)
            linear = to_head[..., :3, :3]
            linear = linear[rows] if linear.ndim == 3 else linear
            if not np.array_equal(to_head, _IDENTITY):
                offsets = _turned(offsets, linear)
                normals = None if normals is None else _turned(normals, _of_normals(linear))
            found.append(MorphTarget(name, rows, offsets, normals))
        return tuple(found)

    def _target(
        self, target: Object, count: int, where: str, has_normals: bool
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64] | None]:
        """Rows, offsets (mm) and offsets of normals of one blendshape in the mesh's frame."""
        empty = (np.zeros(0, np.int32), np.zeros((0, 3)))
        rows, offsets = (
            self._file.displacements(target["POSITION"], where, count)
            if "POSITION" in target
            else empty
        )
        offsets = offsets * _MM_PER_METRE
        if not has_normals:
            return rows, offsets, None
        turned, normals = (
            self._file.displacements(target["NORMAL"], where, count)
            if "NORMAL" in target
            else empty
        )
        if np.array_equal(rows, turned):
            return rows, offsets, normals
        both = np.union1d(rows, turned).astype(np.int32)
        all_offsets, all_normals = np.zeros((len(both), 3)), np.zeros((len(both), 3))
        all_offsets[np.searchsorted(both, rows)] = offsets
        all_normals[np.searchsorted(both, turned)] = normals
        return both, all_offsets, all_normals

    def _weights(self, node: int, mesh: Object, n_targets: int) -> NDArray[np.float64] | None:
        if not n_targets or not self._tree.n_frames:
            return None
        animated = self._tree.animation.weights(node)
        if animated is not None:
            if animated.shape[1] != n_targets:
                self._file.fail(f"node {node}", f"{n_targets} weights a frame", animated.shape[1])
            return animated
        holder = self._file.item("nodes", node, "scene")
        holder = holder if "weights" in holder else mesh
        rest = self._file.numbers(holder, "weights", f"node {node}", (0.0,) * n_targets)
        self._file.spend(n_targets * self._tree.n_frames, f"node {node}")
        return np.tile(rest, (self._tree.n_frames, 1)) if rest.any() else None

    def _skinning(
        self, node: int, attributes: Object, count: int, where: str
    ) -> NDArray[np.float64] | None:
        """(V, 4, 4) rest pose of a skinned mesh's vertices; None where it has no skin."""
        holder = self._file.item("nodes", node, "scene")
        if "skin" not in holder or "JOINTS_0" not in attributes:
            return None
        file = self._file
        skin = file.item("skins", holder["skin"], f"node {node}")
        joints = file.array(skin, "joints", "skin")
        world = np.stack(
            [self._tree.head_from(self._tree.joint_chain(j), animated=False) for j in joints]
            or [_IDENTITY]
        )
        if "inverseBindMatrices" in skin:
            inverse = file.accessor(skin["inverseBindMatrices"], ("MAT4",), "skin", len(world))
            inverse = np.swapaxes(inverse.reshape(-1, 4, 4), 1, 2).copy()
            inverse[:, :3, 3] *= _MM_PER_METRE
            world = world @ inverse
        corners = file.accessor(attributes["JOINTS_0"], ("VEC4",), where, count, integers=True)
        shares = file.accessor(attributes.get("WEIGHTS_0"), ("VEC4",), where, count)
        if corners.max() >= len(world) or not (shares.sum(axis=1) > 0).all():
            file.fail(where, f"joints below {len(world)} with weights", "others")
        shares = shares / shares.sum(axis=1, keepdims=True)
        file.spend(16 * count, where)
        found = np.zeros((count, 4, 4))
        for k in range(4):
            found += shares[:, k, None, None] * world[corners[:, k].astype(np.intp)]
        return found

    # materials

    def _material(
        self, primitive: Object, where: str
    ) -> tuple[tuple[bytes | None, bytes | None, bytes | None], int, _Look]:
        """Textures (PNG) of colour, normals and roughness, their texture coordinates, the rest.

        Maps that use another set of coordinates than the first are left out.
        """
        if "material" not in primitive:
            return (None, None, None), 0, _Look(np.ones(4), 1.0, False)
        file = self._file
        material = file.item("materials", primitive["material"], where)
        where = f"material {primitive['material']}"
        surface = file.member(material, "pbrMetallicRoughness", where)
        color = file.numbers(surface, "baseColorFactor", where, (1, 1, 1, 1))
        roughness = file.number(surface, "roughnessFactor", where, 1.0)
        look = _Look(
            np.clip(color, 0, 1),
            min(max(roughness, 0.0), 1.0),
            material.get("doubleSided") is True,
        )
        found = [
            self._texture(file.member(holder, key, where), where)
            for holder, key in (
                (surface, "baseColorTexture"),
                (material, "normalTexture"),
                (surface, "metallicRoughnessTexture"),
            )
        ]
        sets = [set_index for picture, set_index in found if picture is not None]
        chosen = sets[0] if sets else 0
        texture, normal, rough = (p if n == chosen else None for p, n in found)
        return (texture, normal, rough), chosen, look

    def _texture(self, info: Object, where: str) -> tuple[bytes | None, int]:
        """A texture's picture and its set of texture coordinates; None if there is none."""
        file = self._file
        if "index" not in info:
            return None, 0
        texture = file.item("textures", info["index"], where)
        if "source" not in texture:
            return None, 0
        source = file.integer(texture, "source", where)
        if source not in self._images:
            self._images[source] = self._image(source, where)
        return self._images[source], file.integer(info, "texCoord", where, 0)

    def _image(self, index: int, where: str) -> bytes:
        file = self._file
        image = file.item("images", index, where)
        where = f"image {index}"
        if "uri" in image:
            data = file.embedded(image["uri"], where)
        else:
            data = bytes(file.view(image.get("bufferView"), where)[0])
        return data if data.startswith(PNG_SIGNATURE) else self._as_png(data, where)

    def _as_png(self, data: bytes, where: str) -> bytes:
        from PIL import Image, UnidentifiedImageError

        try:
            with Image.open(io.BytesIO(data), formats=("JPEG",)) as picture:
                if picture.width * picture.height > _MAX_TEXTURE_PX:
                    self._file.fail(where, f"at most {_MAX_TEXTURE_PX} pixels", picture.size)
                out = io.BytesIO()
                picture.convert("RGB").save(out, "PNG")
        except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
            self._file.fail(where, "a PNG or JPEG picture", error)
        return out.getvalue()


@dataclass(frozen=True, eq=False)
class _Look:
    color: NDArray[np.float64]
    roughness: float
    double_sided: bool


def _renamed(part: GltfPart, taken: set[str]) -> GltfPart:
    """The part under a name that no part before it has."""
    name = _unused(part.name, taken)
    return part if name == part.name else replace(part, name=name)


def _unused(name: str, taken: set[str]) -> str:
    found, n = name, 1
    while found in taken:
        n += 1
        found = f"{name}.{n}"
    taken.add(found)
    return found


def target_names(mesh: Object, primitive: Object, count: int) -> list[str]:
    """Names as exporters store them: in the extras of the mesh or the primitive."""
    names: list[object] = []
    for holder in (mesh, primitive):
        extras = holder.get("extras")
        listed = extras.get("targetNames") if isinstance(extras, dict) else None
        if isinstance(listed, list) and len(listed) == count:
            names = listed
            break
    taken: set[str] = set()
    return [
        _unused(name if isinstance(name, str) and name else f"target {i}", taken)
        for i, name in enumerate(names or [None] * count)
    ]


def _as_triangles(corners: NDArray[np.int32], strip: str | None) -> NDArray[np.int32]:
    """(F, 3) from a list of corners; strips and fans as in glTF 2.0, 3.7.2.1."""
    if strip is None:
        return corners.reshape(-1, 3)
    i = np.arange(len(corners) - 2)
    if strip == "fan":
        return np.stack([corners[i + 1], corners[i + 2], np.full(len(i), corners[0])], axis=1)
    odd = i % 2
    return np.stack([corners[i], corners[i + 1 + odd], corners[i + 2 - odd]], axis=1)


def _moved_points(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) points moved by one (4, 4) matrix or by one each, (V, 4, 4)."""
    if np.array_equal(matrix, _IDENTITY):
        return points
    return _turned(points, matrix[..., :3, :3]) + matrix[..., :3, 3]


def _moved_normals(
    normals: NDArray[np.float64], matrix: NDArray[np.float64]
) -> NDArray[np.float64]:
    linear = matrix[..., :3, :3]
    if np.array_equal(linear, np.eye(3)):
        return normals
    return _turned(normals, _of_normals(linear))


def _turned(vectors: NDArray[np.float64], linear: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.einsum("...ij,...j->...i", linear, vectors))


def _of_normals(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """What turns normals where `linear`, (..., 3, 3), turns points.

    The inverse transpose, scaled so that a similarity keeps lengths. Made of cofactors, which
    exist for any matrix; their sign is that of the determinant, which a mirror turns over.
    """
    a, b, c = linear[..., 0, :], linear[..., 1, :], linear[..., 2, :]
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    size = np.linalg.norm(linear, axis=(-2, -1), keepdims=True) / np.sqrt(3)
    sign = np.where(np.linalg.det(linear) < 0, -1.0, 1.0)[..., None, None]
    found = np.zeros_like(cofactors)
    np.divide(sign * cofactors, size**2, out=found, where=size > 0)
    return found
