"""Writing .glb files (glTF 2.0, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pygltflib as gltf
from numpy.typing import NDArray

from ..errors import InputError
from ..files import atomic_path
from .gltf_packer import Packer, numbers_of
from .gltf_scene import ROOT_NAME, GltfPart, GltfScene, MorphTarget
from .gltf_skin import Skeleton
from .gltf_tangents import vertex_tangents

METRES_PER_MM = 1e-3
#: Key in a node's extras: the part's pivot, which the node's animated translation hides.
PIVOT_KEY = "pivot_mm"
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
    packer = Packer()
    skeleton = Skeleton.of(scene)
    nodes = [_root_node(scene, skeleton), *(_joint_node(scene, p) for p in skeleton.parts)]
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
        meshes.append(_mesh(packer, part, len(meshes), skeleton.index(part)))
        nodes.append(_part_node(scene, part, len(meshes) - 1))
    skins = [_skin(packer, skeleton)] if skeleton.is_used else []
    shown = [0, *(i for i, node in enumerate(nodes) if node.skin is not None)]
    animation = _animation(packer, scene)
    document = gltf.GLTF2(
        asset=gltf.Asset(generator="facewright", version="2.0"),
        scene=0,
        scenes=[gltf.Scene(name=scene.name, nodes=shown, extras=dict(scene.extras))],
        nodes=nodes,
        skins=skins,
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


def _root_node(scene: GltfScene, skeleton: Skeleton) -> gltf.Node:
    first = 1 + len(skeleton.parts)
    free = [first + i for i, part in enumerate(scene.parts) if part.joint is None]
    node = gltf.Node(name=ROOT_NAME, children=[*range(1, first), *free])
    if scene.root_rotation is not None:
        node.rotation = numbers_of(_xyzw(scene.root_rotation)[0])
    places = scene.root_places()
    place = scene.root_pivot if places is None else places[0]
    if places is not None or place.any():
        node.translation = numbers_of(place * METRES_PER_MM)
    if scene.root_pivot.any():
        node.extras = {PIVOT_KEY: [float(x) for x in scene.root_pivot]}
    return node


def _part_node(scene: GltfScene, part: GltfPart, mesh: int) -> gltf.Node:
    if part.joint is not None:  # skinned: its own place counts for nothing (glTF 2.0, 3.7.3.3)
        return gltf.Node(name=part.name, mesh=mesh, skin=0)
    node = _moving_node(scene, part)
    node.name, node.mesh = part.name, mesh
    return node


def _joint_node(scene: GltfScene, part: GltfPart) -> gltf.Node:
    node = _moving_node(scene, part)
    node.name, node.extras = part.joint, {PIVOT_KEY: [float(x) for x in part.pivot]}
    return node


def _moving_node(scene: GltfScene, part: GltfPart) -> gltf.Node:
    """A node that stands at a part's pivot, in its first pose."""
    node = gltf.Node()
    if part.rotation is not None:
        node.rotation = numbers_of(_xyzw(part.rotation)[0])
    first = part.pivot if part.translation is None else part.pivot + part.translation[0]
    first = first - scene.root_pivot
    if first.any():
        node.translation = numbers_of(first * METRES_PER_MM)
    if part.pivot.any() or part.translation is not None:
        node.extras = {PIVOT_KEY: [float(x) for x in part.pivot]}
    return node


def _skin(packer: Packer, skeleton: Skeleton) -> gltf.Skin:
    binds = packer.array(skeleton.inverse_binds(), gltf.MAT4, bounds=False)
    return gltf.Skin(
        name=ROOT_NAME,
        skeleton=0,
        joints=list(range(len(skeleton.names))),
        inverseBindMatrices=binds,
    )


def _mesh(packer: Packer, part: GltfPart, material: int, joint: int | None) -> gltf.Mesh:
    vertices = part.vertices * METRES_PER_MM
    if joint is None:
        vertices = (part.vertices - part.pivot) * METRES_PER_MM
    attributes = gltf.Attributes(
        POSITION=packer.array(vertices, gltf.VEC3, target=gltf.ARRAY_BUFFER, bounds=True),
        NORMAL=packer.array(part.normals, gltf.VEC3, target=gltf.ARRAY_BUFFER, bounds=False),
    )
    if part.uv is not None:
        uv = np.stack([part.uv[:, 0], 1 - part.uv[:, 1]], axis=1)
        attributes.TEXCOORD_0 = packer.array(uv, gltf.VEC2, target=gltf.ARRAY_BUFFER, bounds=False)
    if joint is not None:
        attributes.JOINTS_0 = packer.bytes4((joint, 0, 0, 0), len(vertices), normalized=False)
        attributes.WEIGHTS_0 = packer.bytes4((255, 0, 0, 0), len(vertices), normalized=True)
    primitive = gltf.Primitive(
        attributes=attributes,
        indices=packer.indices(part.triangles, len(vertices)),
        material=material,
        targets=[_target(packer, target, len(vertices)) for target in part.targets],
    )
    if part.uv is not None and part.normal_png is not None:
        attributes.TANGENT = _tangents(packer, part, vertices, uv)
    mesh = gltf.Mesh(name=part.name, primitives=[primitive])
    if part.targets:
        rest = np.zeros(len(part.targets)) if part.weights is None else part.weights[0]
        mesh.weights = numbers_of(rest)
        mesh.extras = {"targetNames": [target.name for target in part.targets]}
    return mesh


def _tangents(
    packer: Packer, part: GltfPart, vertices: NDArray[np.float64], uv: NDArray[np.float64]
) -> int:
    """Of what is stored, in single precision, so that a file that was read is written as it was."""
    points, normals, at = (
        a.astype(np.float32).astype(np.float64) for a in (vertices, part.normals, uv)
    )
    found = vertex_tangents(points, part.triangles, normals, at)
    return packer.array(found, gltf.VEC4, target=gltf.ARRAY_BUFFER, bounds=False)


def _target(packer: Packer, target: MorphTarget, n_vertices: int) -> gltf.Attributes:
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


def _animation(packer: Packer, scene: GltfScene) -> gltf.Animation | None:
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
    ) -> None:
        if rotation is not None:
            found.append((node, "rotation", gltf.VEC4, _xyzw(rotation)))
        if translation is not None:
            found.append((node, "translation", gltf.VEC3, translation * METRES_PER_MM))

    joints = Skeleton.of(scene).parts

    def places(part: GltfPart) -> NDArray[np.float64] | None:
        if part.translation is None:
            return None
        return part.translation + part.pivot - scene.root_pivot

    add_motion(0, scene.root_rotation, scene.root_places())
    for node, part in enumerate(joints, start=1):
        add_motion(node, part.rotation, places(part))
    for node, part in enumerate(scene.parts, start=1 + len(joints)):
        if part.joint is None:
            add_motion(node, part.rotation, places(part))
        if part.weights is not None:
            found.append((node, "weights", gltf.SCALAR, part.weights.ravel()))
    return found


def _xyzw(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.roll(wxyz, -1, axis=-1)


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
