"""Writing .glb files (glTF 2.0, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html)."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pygltflib as gltf
from numpy.typing import NDArray

from ..errors import InputError
from ..files import atomic_path
from .gltf_scene import GltfPart, GltfScene, MorphTarget

METRES_PER_MM = 1e-3
#: Name of the node that carries the head's motion and all parts.
ROOT_NAME = "head"
#: Key in a node's extras: the part's pivot, which the node's animated translation hides.
PIVOT_KEY = "pivot_mm"
_U16_LIMIT = 65535  # this index itself would restart the primitive (glTF 2.0, 3.7.2.1)
_MAX_BYTES = 2**32 - 1  # the container's length field


def write_glb(path: Path, scene: GltfScene) -> None:
    """Write a scene to a .glb file, atomically. The same scene gives the same bytes.

    Raises
    ------
    InputError
        If frames are so close that single precision cannot tell them apart, or the file would
        pass the format's 4 GiB.
    OSError
        If it cannot be written.
    """
    data = glb_bytes(scene)
    with atomic_path(path) as part:
        part.write_bytes(data)


def glb_bytes(scene: GltfScene) -> bytes:
    """What `write_glb` writes."""
    packer = _Packer()
    nodes = [_root_node(scene)]
    meshes: list[gltf.Mesh] = []
    materials: list[gltf.Material] = []
    images: list[gltf.Image] = []
    places: dict[bytes, int] = {}
    for part in scene.parts:
        for picture in (part.texture_png, part.normal_png, part.roughness_png):
            if picture is not None and picture not in places:
                places[picture] = len(images)
                images.append(gltf.Image(bufferView=packer.view(picture), mimeType="image/png"))
        materials.append(_material(part, places))
        meshes.append(_mesh(packer, part, len(meshes)))
        nodes.append(_part_node(part, len(meshes) - 1))
    animation = _animation(packer, scene)
    document = gltf.GLTF2(
        asset=gltf.Asset(generator="facewright", version="2.0"),
        scene=0,
        scenes=[gltf.Scene(name=scene.name, nodes=[0], extras=dict(scene.extras))],
        nodes=nodes,
        meshes=meshes,
        materials=materials,
        images=images,
        textures=[gltf.Texture(source=i, sampler=0) for i in range(len(images))],
        samplers=[_MIPMAPPED] if images else [],
        animations=[] if animation is None else [animation],
        accessors=packer.accessors,
        bufferViews=packer.views,
        buffers=[gltf.Buffer(byteLength=len(packer.data))],
    )
    return _container(document.to_json(separators=(",", ":"), allow_nan=False), packer.data)


_MIPMAPPED = gltf.Sampler(
    magFilter=gltf.LINEAR,
    minFilter=gltf.LINEAR_MIPMAP_LINEAR,
    wrapS=gltf.REPEAT,
    wrapT=gltf.REPEAT,
)


class _Packer:
    """Collects the binary chunk, its views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[gltf.BufferView] = []
        self.accessors: list[gltf.Accessor] = []

    def view(self, data: bytes, target: int | None = None) -> int:
        self.data.extend(bytes(-len(self.data) % 4))
        view = gltf.BufferView(
            buffer=0, byteOffset=len(self.data), byteLength=len(data), target=target
        )
        self.views.append(view)
        self.data.extend(data)
        return len(self.views) - 1

    def array(
        self, values: NDArray[np.float64], kind: str, *, target: int | None = None, bounds: bool
    ) -> int:
        """An accessor of float32 values, (n, k) or (n,)."""
        a = np.ascontiguousarray(values, dtype="<f4")
        accessor = gltf.Accessor(
            bufferView=self.view(a.tobytes(), target),
            componentType=gltf.FLOAT,
            count=len(a),
            type=kind,
        )
        if bounds:
            rows = a.reshape(len(a), -1)
            accessor.min, accessor.max = _numbers(rows.min(axis=0)), _numbers(rows.max(axis=0))
        return self._add(accessor)

    def indices(self, triangles: NDArray[np.int32], n_vertices: int) -> int:
        kind, dtype = _index_type(n_vertices, _U16_LIMIT)
        view = self.view(triangles.astype(dtype).tobytes(), gltf.ELEMENT_ARRAY_BUFFER)
        return self._add(
            gltf.Accessor(
                bufferView=view, componentType=kind, count=triangles.size, type=gltf.SCALAR
            )
        )

    def sparse(self, values: NDArray[np.float64], row_view: int, count: int) -> int:
        """An accessor of `count` 3-vectors, zero except in the rows whose indices are stored."""
        a = np.ascontiguousarray(values, dtype="<f4")
        seen = a if len(a) == count else np.concatenate([a, np.zeros((1, 3), "<f4")])
        indices = gltf.AccessorSparseIndices(
            bufferView=row_view, componentType=_index_type(count, _U16_LIMIT + 1)[0]
        )
        return self._add(
            gltf.Accessor(
                byteOffset=None,  # allowed only beside a buffer view
                componentType=gltf.FLOAT,
                count=count,
                type=gltf.VEC3,
                min=_numbers(seen.min(axis=0)),
                max=_numbers(seen.max(axis=0)),
                sparse=gltf.Sparse(
                    count=len(a),
                    indices=indices,
                    values=gltf.AccessorSparseValues(bufferView=self.view(a.tobytes())),
                ),
            )
        )

    def sparse_rows(self, rows: NDArray[np.int32], count: int) -> int:
        return self.view(rows.astype(_index_type(count, _U16_LIMIT + 1)[1]).tobytes())

    def _add(self, accessor: gltf.Accessor) -> int:
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _index_type(n_vertices: int, limit: int) -> tuple[int, str]:
    small = n_vertices <= limit
    return (gltf.UNSIGNED_SHORT, "<u2") if small else (gltf.UNSIGNED_INT, "<u4")


def _root_node(scene: GltfScene) -> gltf.Node:
    node = gltf.Node(name=ROOT_NAME, children=list(range(1, len(scene.parts) + 1)))
    if scene.root_rotation is not None:
        node.rotation = _numbers(_xyzw(scene.root_rotation)[0])
    if scene.root_translation is not None:
        node.translation = _numbers(scene.root_translation[0] * METRES_PER_MM)
    return node


def _part_node(part: GltfPart, mesh: int) -> gltf.Node:
    node = gltf.Node(name=part.name, mesh=mesh)
    if part.rotation is not None:
        node.rotation = _numbers(_xyzw(part.rotation)[0])
    first = part.pivot if part.translation is None else part.pivot + part.translation[0]
    if first.any():
        node.translation = _numbers(first * METRES_PER_MM)
    if part.pivot.any() or part.translation is not None:
        node.extras = {PIVOT_KEY: [float(x) for x in part.pivot]}
    return node


def _mesh(packer: _Packer, part: GltfPart, material: int) -> gltf.Mesh:
    vertices = (part.vertices - part.pivot) * METRES_PER_MM
    attributes = gltf.Attributes(
        POSITION=packer.array(vertices, gltf.VEC3, target=gltf.ARRAY_BUFFER, bounds=True),
        NORMAL=packer.array(part.normals, gltf.VEC3, target=gltf.ARRAY_BUFFER, bounds=False),
    )
    if part.uv is not None:
        uv = np.stack([part.uv[:, 0], 1 - part.uv[:, 1]], axis=1)
        attributes.TEXCOORD_0 = packer.array(uv, gltf.VEC2, target=gltf.ARRAY_BUFFER, bounds=False)
    primitive = gltf.Primitive(
        attributes=attributes,
        indices=packer.indices(part.triangles, len(vertices)),
        material=material,
        targets=[_target(packer, target, len(vertices)) for target in part.targets],
    )
    mesh = gltf.Mesh(name=part.name, primitives=[primitive])
    if part.targets:
        rest = np.zeros(len(part.targets)) if part.weights is None else part.weights[0]
        mesh.weights = _numbers(rest)
        mesh.extras = {"targetNames": [target.name for target in part.targets]}
    return mesh


def _target(packer: _Packer, target: MorphTarget, n_vertices: int) -> gltf.Attributes:
    rows, offsets, normals = target.rows, target.offsets * METRES_PER_MM, target.normal_offsets
    if not len(rows):  # sparse arrays are never empty, and some readers know no arrays of nothing
        rows, offsets = np.zeros(1, np.int32), np.zeros((1, 3))
        normals = None if normals is None else np.zeros((1, 3))
    row_view = packer.sparse_rows(rows, n_vertices)
    found = gltf.Attributes(POSITION=packer.sparse(offsets, row_view, n_vertices))
    if normals is not None:
        found.NORMAL = packer.sparse(normals, row_view, n_vertices)
    return found


def _material(part: GltfPart, places: Mapping[bytes, int]) -> gltf.Material:
    surface = gltf.PbrMetallicRoughness(
        baseColorFactor=[float(x) for x in part.base_color],
        metallicFactor=0.0,
        roughnessFactor=float(part.roughness),
    )
    if part.texture_png is not None:
        surface.baseColorTexture = gltf.TextureInfo(index=places[part.texture_png])
    if part.roughness_png is not None:
        surface.metallicRoughnessTexture = gltf.TextureInfo(index=places[part.roughness_png])
    normals = None
    if part.normal_png is not None:
        normals = gltf.NormalMaterialTexture(index=places[part.normal_png])
    return gltf.Material(
        name=part.name,
        pbrMetallicRoughness=surface,
        normalTexture=normals,
        doubleSided=bool(part.double_sided),
        alphaMode=gltf.OPAQUE if part.base_color[3] == 1 else gltf.BLEND,
        alphaCutoff=None,
    )


def _animation(packer: _Packer, scene: GltfScene) -> gltf.Animation | None:
    """One animation of all that moves; None where nothing does."""
    curves = list(_animated(scene))
    if not curves:
        return None
    times = scene.time_s.astype("<f4")
    if len(times) > 1 and not (np.diff(times) > 0).all():
        frame = int(np.argmin(np.diff(times)))
        raise InputError(
            f"frames {frame} and {frame + 1} lie {np.diff(scene.time_s)[frame]:.3g} s apart at "
            f"{scene.time_s[frame]:g} s, less than .glb can tell: resample, or cut the take"
        )
    clock = packer.array(scene.time_s, gltf.SCALAR, bounds=True)
    samplers, channels = [], []
    for node, path, kind, values in curves:
        output = packer.array(values, kind, bounds=False)
        samplers.append(gltf.AnimationSampler(input=clock, output=output))
        target = gltf.AnimationChannelTarget(node=node, path=path)
        channels.append(gltf.AnimationChannel(sampler=len(samplers) - 1, target=target))
    return gltf.Animation(name="performance", channels=channels, samplers=samplers)


def _animated(scene: GltfScene) -> list[tuple[int, str, str, NDArray[np.float64]]]:
    """(node, path, accessor type, values) of every channel; the root is node 0."""
    found: list[tuple[int, str, str, NDArray[np.float64]]] = []

    def add_motion(
        node: int,
        rotation: NDArray[np.float64] | None,
        translation: NDArray[np.float64] | None,
        pivot: NDArray[np.float64],
    ) -> None:
        if rotation is not None:
            found.append((node, "rotation", gltf.VEC4, _xyzw(rotation)))
        if translation is not None:
            metres = (pivot + translation) * METRES_PER_MM
            found.append((node, "translation", gltf.VEC3, metres))

    add_motion(0, scene.root_rotation, scene.root_translation, np.zeros(3))
    for node, part in enumerate(scene.parts, start=1):
        add_motion(node, part.rotation, part.translation, part.pivot)
        if part.weights is not None:
            found.append((node, "weights", gltf.SCALAR, part.weights.ravel()))
    return found


def _xyzw(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.roll(wxyz, -1, axis=-1)


def _numbers(values: NDArray[np.generic] | Sequence[float]) -> list[float]:
    """Single-precision values as JSON numbers, so that they equal what the buffers hold."""
    return [float(x) for x in np.asarray(values, dtype=np.float32)]


def _container(document: str, binary: bytearray) -> bytes:
    """The .glb container: header, JSON chunk, binary chunk (glTF 2.0, 4.4)."""
    text = document.encode("utf-8")
    text += b" " * (-len(text) % 4)
    data = bytes(binary) + bytes(-len(binary) % 4)
    length = 12 + 8 + len(text) + 8 + len(data)
    if length > _MAX_BYTES:
        raise InputError(f"the animated head takes {length / 2**30:.1f} GiB, .glb holds 4: cut it")
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(data), b"BIN\0"),
            data,
        ]
    )
