"""Reading and writing .glb, judged by other readers, by closed forms and by damaged files."""

from __future__ import annotations

import base64
import io
import json
import logging
import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from numpy.typing import NDArray
from PIL import Image

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.gltf import (
    GltfPart,
    GltfScene,
    MorphTarget,
    glb_bytes,
    read_glb,
    scene_from_glb,
    unweld,
    write_glb,
)
from facewright.core.mesh import Mesh, vertex_normals
from facewright.core.rigid import rotation_from_quaternion

_SINGLE = 2.0**-23  # relative spacing of float32
TETRAHEDRON = np.array([[0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 40]], dtype=np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


def picture(kind: str = "PNG", shade: int = 255) -> bytes:
    gradient = np.tile(np.arange(0, 256, 16, dtype=np.uint8)[:, None, None], (1, 16, 3))
    out = io.BytesIO()
    Image.fromarray(np.minimum(gradient, np.uint8(shade))).save(out, kind)
    return out.getvalue()


def turning(axis: tuple[float, float, float], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(T, 4) w x y z quaternions of turns about an axis."""
    return np.concatenate(
        [np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None] * np.array(axis)], axis=1
    )


def full_scene(n_frames: int = 12, seed: int = 3) -> GltfScene:
    """Everything that a scene can hold."""
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=60, size=(200, 3)) + (0, 30, 0)
    triangles = np.array([rng.permutation(200)[:3] for _ in range(300)], dtype=np.int32)
    normals = rng.normal(size=(200, 3))
    time_s = np.arange(n_frames) / 25
    rows = np.sort(rng.permutation(200)[:17]).astype(np.int32)
    targets = (
        MorphTarget("jawOpen", rows, rng.normal(size=(17, 3)), rng.normal(size=(17, 3))),
        MorphTarget("still", np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros((0, 3))),
        MorphTarget("all", np.arange(200, dtype=np.int32), *rng.normal(size=(2, 200, 3))),
    )
    skin = GltfPart(
        "skin",
        points,
        triangles,
        normals,
        rng.uniform(size=(200, 2)),
        np.array([0.9, 0.7, 0.6, 1.0]),
        picture(),
        picture(shade=90),
        picture(shade=30),
        roughness=0.45,
        targets=targets,
        weights=rng.uniform(size=(n_frames, 3)),
    )
    eye = GltfPart(
        "eye",
        TETRAHEDRON + (30, 20, 80),
        FACES,
        vertex_normals(TETRAHEDRON, FACES),
        base_color=np.array([1.0, 1.0, 1.0, 0.5]),
        double_sided=True,
        rotation=turning((0, 1, 0), np.linspace(-0.5, 0.7, n_frames)),
        translation=rng.normal(size=(n_frames, 3)),
        pivot=np.array([30.1, 20.2, 80.3]),
    )
    lid = replace(eye, name="lid", translation=None, base_color=np.ones(4))
    fixed = replace(lid, name="fixed", rotation=None)
    return GltfScene(
        "take 1",
        (skin, eye, lid, fixed),
        time_s,
        turning((0.6, 0.0, 0.8), np.linspace(0, 3, n_frames)),
        rng.normal(scale=100, size=(n_frames, 3)),
        {"source": "täke ✓"},
    )


def one_triangle() -> GltfPart:
    triangle = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], dtype=np.float64)
    return GltfPart("part", triangle, np.array([[0, 1, 2]]), np.tile((0.0, 0, 1), (3, 1)))


def assert_single(found: Any, truth: Any, what: str, scale: float = 1.0) -> None:
    """Equal to the precision of float32 at numbers of size `scale`."""
    if truth is None:
        assert found is None, what
        return
    assert found is not None and found.shape == truth.shape, what
    worst = np.abs(found - truth).max(initial=0.0)
    limit = _SINGLE * max(scale, float(np.abs(truth).max(initial=0.0)))
    assert worst <= limit, f"{what}: off by {worst:.3g}, float32 allows {limit:.3g}"


def document_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def pack(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


class Foreign:
    """A glTF document put together by hand, value by value."""

    def __init__(self) -> None:
        self.binary = b""
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "bufferViews": [],
            "accessors": [],
        }
        self.document["nodes"] = [{"mesh": 0}]

    def add(self, values: Any, kind: str, component: int = 5126, **more: Any) -> int:
        dtype = {5126: "<f4", 5123: "<u2", 5121: "<u1", 5122: "<i2"}[component]
        a = np.asarray(values, dtype=dtype)
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": a.nbytes}
        self.document["bufferViews"].append(view)
        self.binary += a.tobytes()
        self.document["accessors"].append(
            {
                "bufferView": len(self.document["bufferViews"]) - 1,
                "componentType": component,
                "count": len(a),
                "type": kind,
                **more,
            }
        )
        return len(self.document["accessors"]) - 1

    def mesh(self, **more: Any) -> None:
        """The tetrahedron, in metres."""
        position = self.add(TETRAHEDRON / 1000, "VEC3")
        index = self.add(FACES.ravel(), "SCALAR", 5123)
        primitive = {"attributes": {"POSITION": position}, "indices": index, **more}
        self.document["meshes"] = [{"name": "tetra", "primitives": [primitive]}]

    def animate(self, node: int, path: str, times: Any, values: Any, how: str = "LINEAR") -> None:
        kind = {"rotation": "VEC4", "translation": "VEC3", "weights": "SCALAR", "scale": "VEC3"}
        animation = self.document.setdefault("animations", [{"channels": [], "samplers": []}])[0]
        sampler = {
            "input": self.add(times, "SCALAR"),
            "output": self.add(values, kind[path]),
            "interpolation": how,
        }
        animation["samplers"].append(sampler)
        target = {"node": node, "path": path}
        channel = {"sampler": len(animation["samplers"]) - 1, "target": target}
        animation["channels"].append(channel)

    def bytes(self) -> bytes:
        self.document["buffers"] = [{"byteLength": len(self.binary)}]
        return pack(self.document, self.binary)

    def read(self) -> GltfScene:
        return scene_from_glb(self.bytes(), "foreign.glb")


# round trips


def test_a_scene_comes_back_as_it_was_to_single_precision(tmp_path: Path) -> None:
    truth = full_scene()

    write_glb(tmp_path / "head.glb", truth)
    found = read_glb(tmp_path / "head.glb")

    assert (found.name, dict(found.extras)) == (truth.name, dict(truth.extras))
    assert_single(found.time_s, truth.time_s, "time_s")
    assert_single(found.root_rotation, truth.root_rotation, "root_rotation")
    assert_single(found.root_translation, truth.root_translation, "root_translation")
    assert [p.name for p in found.parts] == [p.name for p in truth.parts]
    for a, b in zip(found.parts, truth.parts, strict=True):
        for what in ("vertices", "normals", "uv", "base_color", "weights", "rotation", "pivot"):
            assert_single(getattr(a, what), getattr(b, what), f"{b.name} {what}", 100.0)
        assert_single(a.translation, b.translation, "translation", 200.0)
        assert (a.triangles == b.triangles).all()
        assert (a.texture_png, a.double_sided) == (b.texture_png, b.double_sided)
        assert (a.normal_png, a.roughness_png) == (b.normal_png, b.roughness_png)
        assert a.roughness == b.roughness
        assert [t.name for t in a.targets] == [t.name for t in b.targets]
        for s, t in zip(a.targets, b.targets, strict=True):
            assert (s.rows == t.rows).all()
            assert_single(s.offsets, t.offsets, t.name)
            assert_single(s.normal_offsets, t.normal_offsets, t.name)


def test_a_file_read_and_written_again_has_the_same_bytes() -> None:
    once = glb_bytes(full_scene())

    assert glb_bytes(full_scene()) == once
    assert glb_bytes(scene_from_glb(once)) == once


@pytest.mark.parametrize("n_frames", [0, 1, 2])
def test_short_and_still_scenes_come_back(n_frames: int) -> None:
    part = one_triangle()
    moved = replace(part, translation=np.ones((n_frames, 3))) if n_frames else part

    found = scene_from_glb(glb_bytes(GltfScene("s", (moved,), np.arange(n_frames) / 30)))

    assert len(found.time_s) == n_frames
    assert (found.parts[0].translation is None) == (n_frames == 0)
    assert_single(found.parts[0].vertices, part.vertices, "vertices")


@pytest.mark.parametrize("n_vertices", [65535, 65536, 65537])
def test_indices_survive_around_the_limit_of_16_bits(n_vertices: int) -> None:
    points = np.zeros((n_vertices, 3))
    points[:, 0] = np.arange(n_vertices)
    last = n_vertices - 1
    triangles = np.array([[0, 1, last], [last - 2, last - 1, last]])
    rows = np.array([0, last])
    target = MorphTarget("t", rows, np.ones((2, 3)))
    part = GltfPart("p", points, triangles, np.ones((n_vertices, 3)), targets=(target,))

    data = glb_bytes(GltfScene("s", (part,)))
    found = scene_from_glb(data).parts[0]

    assert (found.triangles == triangles).all()
    assert (found.targets[0].rows == rows).all()
    restart = {5123: 65535, 5125: 2**32 - 1}  # glTF 2.0, 3.7.2.1: not allowed as an index
    document, _ = document_of(data)
    index = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    assert last < restart[index["componentType"]]


# what others read in our files


def test_open3d_reads_the_same_triangles(tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d")
    scene = GltfScene("s", (replace(full_scene().parts[0], weights=None),))
    write_glb(tmp_path / "s.glb", scene)

    mesh = open3d.io.read_triangle_mesh(str(tmp_path / "s.glb"))

    truth = scene.parts[0]
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)] * 1000
    assert np.abs(corners - truth.vertices[truth.triangles]).max() < 1e-4
    assert truth.uv is not None
    # Open3D, like us and unlike the file, counts v from the bottom
    uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2)
    assert np.abs(uv - truth.uv[truth.triangles]).max() < 1e-6


def stored(document: Any, blob: bytes, index: int) -> Any:
    """An accessor decoded as the specification tells, by pygltflib's classes."""
    a = document.accessors[index]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a.type]
    values = np.zeros((a.count, width), "<f4")
    if a.bufferView is not None:
        v = document.bufferViews[a.bufferView]
        values = np.frombuffer(blob, "<f4", a.count * width, v.byteOffset).reshape(-1, width)
    if a.sparse is not None:
        at, put = a.sparse.indices, a.sparse.values
        kind = {5123: "<u2", 5125: "<u4"}[at.componentType]
        start = document.bufferViews[at.bufferView].byteOffset
        rows = np.frombuffer(blob, kind, a.sparse.count, start)
        start = document.bufferViews[put.bufferView].byteOffset
        values = values.copy()
        values[rows] = np.frombuffer(blob, "<f4", len(rows) * width, start).reshape(-1, width)
    if a.min:
        assert (values.min(axis=0) == np.array(a.min, "f4")).all(), f"min of accessor {index}"
        assert (values.max(axis=0) == np.array(a.max, "f4")).all(), f"max of accessor {index}"
    return values


def test_vertices_stand_where_the_specification_puts_them() -> None:
    """Morph, then the node's, then the root's transform: against the definition of `GltfPart`."""
    scene = full_scene()
    document = pygltflib.GLTF2.load_from_bytes(glb_bytes(scene))
    blob = document.binary_blob()
    frame = 7

    def channel(node: int, path: str) -> Any:
        for c in document.animations[0].channels:
            if (c.target.node, c.target.path) == (node, path):
                sampler = document.animations[0].samplers[c.sampler]
                times = stored(document, blob, sampler.input)[:, 0]
                assert (times == scene.time_s.astype("f4")).all()
                rows: Any = stored(document, blob, sampler.output).reshape(len(times), -1)
                return rows[frame]
        return None

    def placed(node: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        n = document.nodes[node]
        xyzw = channel(node, "rotation")
        shift = channel(node, "translation")
        if xyzw is not None:
            x, y, z, w = (float(v) for v in xyzw)
            points = points @ rotation_from_quaternion((w, x, y, z)).T
        if shift is None:
            shift = np.array(n.translation or (0, 0, 0))
        return np.asarray(points + shift)

    assert document.nodes[0].name == "head"
    for i, part in enumerate(scene.parts, start=1):
        primitive = document.meshes[document.nodes[i].mesh].primitives[0]
        points = stored(document, blob, primitive.attributes.POSITION).astype(np.float64)
        expected = part.vertices.copy()
        weights = channel(i, "weights")
        for j, target in enumerate(part.targets):
            assert part.weights is not None
            expected[target.rows] += part.weights[frame, j] * target.offsets
            offsets = stored(document, blob, primitive.targets[j]["POSITION"])
            points += weights[j] * offsets
        found = placed(0, placed(i, points)) * 1000

        turn = (
            np.eye(3) if part.rotation is None else rotation_from_quaternion(part.rotation[frame])
        )
        shift = np.zeros(3) if part.translation is None else part.translation[frame]
        expected = (expected - part.pivot) @ turn.T + part.pivot + shift
        assert scene.root_rotation is not None and scene.root_translation is not None
        expected = expected @ rotation_from_quaternion(scene.root_rotation[frame]).T
        expected += scene.root_translation[frame]
        assert np.abs(found - expected).max() < 1e-3, part.name


def test_a_file_at_rest_shows_the_first_frame() -> None:
    scene = full_scene()
    document, _ = document_of(glb_bytes(scene))

    assert scene.root_rotation is not None and scene.parts[0].weights is not None
    root = np.roll(document["nodes"][0]["rotation"], 1)
    assert_single(root, scene.root_rotation[0], "rotation")
    assert_single(np.array(document["meshes"][0]["weights"]), scene.parts[0].weights[0], "weights")


def test_the_khronos_validator_finds_nothing(
    tmp_path: Path, khronos_issues: Callable[[Path], dict[str, Any]]
) -> None:
    write_glb(tmp_path / "head.glb", full_scene())

    issues = khronos_issues(tmp_path / "head.glb")

    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


# what the values promise


def test_quaternions_keep_their_sign_from_frame_to_frame() -> None:
    smooth = turning((0, 0, 1), np.linspace(0, 7, 40))
    flipped = smooth * np.where(np.arange(40) % 3 == 1, -2.0, 2.0)[:, None]

    found = replace(one_triangle(), rotation=flipped).rotation

    assert found is not None
    assert np.abs(found - smooth).max() < 1e-12


def test_times_count_from_the_first_frame() -> None:
    part = replace(one_triangle(), translation=np.zeros((3, 3)))

    assert GltfScene("s", (part,), np.array([5.0, 5.5, 6.0])).time_s.tolist() == [0, 0.5, 1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"triangles": np.array([[0, 1, 3]])}, "0..2"),
        ({"vertices": np.full((3, 3), np.nan)}, "finite"),
        ({"normals": np.ones((2, 3))}, "normals"),
        ({"texture_png": b"\x89PNG\r\n\x1a\n"}, "no uv"),
        ({"texture_png": b"JFIF", "uv": np.zeros((3, 2))}, "not a PNG"),
        ({"roughness": 1.5}, "0..1"),
        ({"rotation": np.zeros((2, 4))}, "length above 0"),
        ({"weights": np.zeros((2, 1))}, "no targets"),
        ({"targets": (MorphTarget("a", np.array([3]), np.zeros((1, 3))),)}, "moves vertex 3"),
        ({"targets": (MorphTarget("a", np.array([1]), np.zeros((1, 3))),) * 2}, "differ"),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(one_triangle(), **change)


def test_blendshape_rows_must_increase() -> None:
    with pytest.raises(ValueError, match="increasing"):
        MorphTarget("a", np.array([2, 1]), np.zeros((2, 3)))


def test_frames_must_be_as_many_as_times() -> None:
    part = replace(one_triangle(), translation=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="3 frames, time_s 2"):
        GltfScene("s", (part,), np.array([0.0, 1.0]))


def test_frames_too_close_for_single_precision_are_refused_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    times = np.array([0.0, 100000.0, 100000.001])
    part = replace(one_triangle(), translation=np.zeros((3, 3)))

    with pytest.raises(InputError, match="frames 1 and 2"):
        write_glb(tmp_path / "a.glb", GltfScene("s", (part,), times))

    assert list(tmp_path.iterdir()) == []


def test_unweld_doubles_vertices_only_at_seams() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0, 0], [0.5, 0], [0.5, 1], [0, 1], [0.9, 0.9]])
    uv_triangles = np.array([[0, 1, 2], [0, 4, 3]])  # vertex 2 has two places in the texture

    rows, part = unweld(Mesh(square, triangles, uv, uv_triangles))

    assert sorted(rows.tolist()) == [0, 1, 2, 2, 3]
    assert (part.vertices[part.triangles] == square[triangles]).all()
    assert part.uv is not None and (part.uv[part.triangles] == uv[uv_triangles]).all()
    assert (rows[part.triangles] == triangles).all()


# files of others


def test_a_foreign_head_is_read(real_data: Path) -> None:
    path = real_data / "heads" / "ict_random_identity.glb"
    scene = read_glb(path)
    document = pygltflib.GLTF2.load_from_bytes(path.read_bytes())
    blob = document.binary_blob()

    assert sum(len(part.vertices) for part in scene.parts) == 28151  # 26,719 before UV splits
    assert len(scene.parts) == 9 and len(scene.time_s) == 0
    for i, part in enumerate(scene.parts):
        primitive = document.meshes[i].primitives[0]
        points = stored(document, blob, primitive.attributes.POSITION) * 1000.0
        assert np.abs(part.vertices - points).max() < 1e-4
        assert len(part.targets) == 57
        for target, truth in zip(part.targets, primitive.targets, strict=True):
            dense = np.zeros_like(part.vertices)
            dense[target.rows] = target.offsets
            assert np.abs(dense - stored(document, blob, truth["POSITION"]) * 1000.0).max() < 1e-4
    names = [target.name for target in scene.parts[2].targets]
    assert names[30] == "jawOpen" and "browDown_L" in names
    jaw = scene.parts[2].targets[30]
    assert jaw.offsets[:, 1].min() < -10  # the chin goes down by more than a centimetre


def test_nested_nodes_place_a_mesh() -> None:
    foreign = Foreign()
    foreign.mesh()
    half = np.sqrt(0.5)
    foreign.document["nodes"] = [
        {"children": [1], "translation": [1, 0, 0], "scale": [2, 2, 2]},
        {"children": [2], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0.5, 1]},
        {"mesh": 0, "rotation": [half, 0, 0, half], "name": "deep"},
    ]

    part = foreign.read().parts[0]

    quarter_x = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    quarter_z = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    expected = ((TETRAHEDRON @ quarter_x.T) @ quarter_z.T + (0, 0, 500)) * 2 + (1000, 0, 0)
    assert part.name == "deep"
    assert np.abs(part.vertices - expected).max() < 1e-3
    assert np.abs(part.normals - vertex_normals(expected, FACES)).max() < 1e-6


def test_a_mirrored_mesh_keeps_its_outside_out() -> None:
    foreign = Foreign()
    normals = vertex_normals(TETRAHEDRON, FACES)
    foreign.mesh()
    attributes = foreign.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["NORMAL"] = foreign.add(normals, "VEC3")
    foreign.document["nodes"][0]["scale"] = [-1, 1, 1]

    part = foreign.read().parts[0]

    assert np.abs(part.normals - normals * (-1, 1, 1)).max() < 1e-6
    of_faces = vertex_normals(part.vertices, part.triangles)
    assert np.abs(part.normals - of_faces).max() < 1e-6


def test_an_animated_chain_of_nodes_moves_a_mesh_rigidly() -> None:
    foreign = Foreign()
    foreign.mesh()
    foreign.document["nodes"] = [
        {"children": [1, 2], "scale": [3, 3, 3]},
        {"children": [3], "translation": [0, 0.1, 0]},
        {},
        {"mesh": 0, "translation": [0.2, 0, 0]},
    ]
    angles = np.linspace(0.3, 1.3, 5)
    wxyz = turning((0, 0, 1), angles)
    foreign.animate(1, "rotation", np.arange(5) / 10, np.roll(wxyz, -1, axis=1))

    part = foreign.read().parts[0]

    for frame in range(5):
        turn = rotation_from_quaternion(wxyz[frame])
        expected = 3 * ((TETRAHEDRON + (200, 0, 0)) @ turn.T + (0, 100, 0))
        assert part.rotation is not None and part.translation is not None
        own = rotation_from_quaternion(part.rotation[frame])
        found = (part.vertices - part.pivot) @ own.T + part.pivot + part.translation[frame]
        assert np.abs(found - expected).max() < 1e-3


@pytest.mark.parametrize("how", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_channels_with_their_own_times_are_brought_together(how: str) -> None:
    def cubic(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(t**3 - 2 * t**2 + 0.5)

    def slope(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(3 * t**2 - 4 * t)

    foreign = Foreign()
    foreign.mesh(targets=[{}])
    keys = np.array([0.5, 1.0, 2.0])
    values = cubic(keys)
    if how == "CUBICSPLINE":  # a cubic polynomial is its own Hermite interpolant
        values = np.stack([slope(keys), values, slope(keys)], axis=1).ravel()
    foreign.animate(0, "weights", keys, values, how)
    foreign.animate(0, "translation", [0.0, 1.5, 2.5], [[0, 0, 0], [1.5, 0, 0], [2.5, 0, 0]])

    scene = foreign.read()

    assert scene.time_s.tolist() == [0, 0.5, 1, 1.5, 2, 2.5]
    weights, translation = scene.parts[0].weights, scene.parts[0].translation
    assert weights is not None and translation is not None
    middle = {
        "LINEAR": (cubic(keys)[1] + cubic(keys)[2]) / 2,
        "STEP": cubic(keys)[1],
        "CUBICSPLINE": cubic(np.array(1.5)),
    }[how]
    a, b, c = cubic(keys)
    assert np.abs(weights[:, 0] - [a, a, b, middle, c, c]).max() < 1e-6
    assert np.abs(translation[:, 0] - 1000 * scene.time_s).max() < 1e-3


def test_an_animation_that_begins_late_holds_its_first_pose() -> None:
    foreign = Foreign()
    foreign.mesh()
    foreign.animate(0, "translation", [0.5, 1.0], [[0.1, 0, 0], [0.2, 0, 0]])

    scene = foreign.read()

    part = scene.parts[0]
    assert part.translation is not None
    assert scene.time_s.tolist() == [0, 0.5, 1]
    assert np.abs((part.pivot + part.translation)[:, 0] - [100, 100, 200]).max() < 1e-4


def test_rotations_are_interpolated_on_the_shorter_arc() -> None:
    foreign = Foreign()
    foreign.mesh()
    ends = turning((0, 1, 0), np.array([0.2, 1.4])) * [[1], [-1]]
    foreign.animate(0, "rotation", [0.0, 1.0], np.roll(ends, -1, axis=1))
    foreign.animate(0, "translation", [0.0, 0.25, 1.0], np.zeros((3, 3)))

    rotation = foreign.read().parts[0].rotation

    assert rotation is not None
    expected = turning((0, 1, 0), np.array([0.2, 0.5, 1.4]))
    assert np.abs(np.abs((rotation * expected).sum(axis=1)) - 1).max() < 1e-7


def test_a_skinned_mesh_stands_in_its_rest_pose() -> None:
    foreign = Foreign()
    foreign.mesh()
    attributes = foreign.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = foreign.add([[0, 1, 0, 0]] * 4, "VEC4", 5121)
    attributes["WEIGHTS_0"] = foreign.add([[1, 0, 0, 0]] * 3 + [[0.25, 0.75, 0, 0]], "VEC4")
    inverse = np.tile(np.eye(4).ravel(), (2, 1))
    inverse[1, 14] = -1.0  # column major: z
    foreign.document["skins"] = [
        {"joints": [1, 2], "inverseBindMatrices": foreign.add(inverse, "MAT4")}
    ]
    foreign.document["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},  # ignored: glTF 2.0, 3.7.3.3
        {"translation": [0, 0.1, 0], "children": [2]},
        {"translation": [0, 0, 1.2]},
    ]
    foreign.document["scenes"] = [{"nodes": [0, 1]}]

    part = foreign.read().parts[0]

    expected = TETRAHEDRON + (0, 100, 0)
    expected[3] += (0, 0, 0.75 * 200)
    assert np.abs(part.vertices - expected).max() < 1e-3


def test_integers_normalised_and_interleaved_are_decoded() -> None:
    foreign = Foreign()
    foreign.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    foreign.mesh()
    rows = np.zeros((4, 4), np.int16)
    rows[:, :3] = np.round(TETRAHEDRON / 40 * 32767)
    position = foreign.add(rows, "VEC4", 5122)
    foreign.document["accessors"][position].update(type="VEC3", normalized=True)
    foreign.document["bufferViews"][-1]["byteStride"] = 8
    primitive = foreign.document["meshes"][0]["primitives"][0]
    primitive["attributes"]["POSITION"] = position
    foreign.document["nodes"][0]["scale"] = [0.04, 0.04, 0.04]

    assert np.abs(foreign.read().parts[0].vertices - TETRAHEDRON).max() < 1e-3


@pytest.mark.parametrize(
    ("mode", "corners", "expected"),
    [
        (5, [0, 1, 2, 3], [[0, 1, 2], [1, 3, 2]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (4, None, [[0, 1, 2]]),
    ],
)
def test_strips_fans_and_bare_vertices_become_triangles(
    mode: int, corners: list[int] | None, expected: list[list[int]]
) -> None:
    foreign = Foreign()
    foreign.mesh(mode=mode)
    primitive = foreign.document["meshes"][0]["primitives"][0]
    if corners is None:
        del primitive["indices"]
        foreign.document["accessors"][0]["count"] = 3
    else:
        primitive["indices"] = foreign.add(corners, "SCALAR", 5121)

    assert foreign.read().parts[0].triangles.tolist() == expected


def test_a_jpeg_texture_becomes_a_png_and_buffers_may_be_base64() -> None:
    foreign = Foreign()
    foreign.mesh(material=0)
    primitive = foreign.document["meshes"][0]["primitives"][0]
    primitive["attributes"]["TEXCOORD_0"] = foreign.add([[0.25, 0.125]] * 4, "VEC2")
    uri = "data:image/jpeg;base64," + base64.b64encode(picture("JPEG")).decode()
    foreign.document["images"] = [{"uri": uri}]
    foreign.document["textures"] = [{"source": 0}]
    foreign.document["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "doubleSided": True}
    ]
    foreign.bytes()
    data = "data:application/octet-stream;base64," + base64.b64encode(foreign.binary).decode()
    foreign.document["buffers"] = [{"uri": data, "byteLength": len(foreign.binary)}]

    part = scene_from_glb(pack(foreign.document, b"")).parts[0]

    assert part.texture_png is not None and part.uv is not None
    found = np.asarray(Image.open(io.BytesIO(part.texture_png)), dtype=int)
    truth = np.asarray(Image.open(io.BytesIO(picture())), dtype=int)
    assert np.abs(found - truth).max() < 20  # JPEG's loss
    assert (part.uv == (0.25, 0.875)).all()
    assert part.double_sided and part.roughness == 1


def test_primitives_names_and_rest_weights_of_others() -> None:
    foreign = Foreign()
    foreign.mesh(targets=[{}, {}])
    mesh = foreign.document["meshes"][0]
    mesh["primitives"] *= 2
    mesh["extras"] = {"targetNames": ["same", "same"]}
    mesh["weights"] = [0.0, 0.5]
    foreign.animate(0, "translation", [0.0, 1.0], np.zeros((2, 3)))

    first, second = foreign.read().parts

    assert (first.name, second.name) == ("tetra", "tetra.2")
    assert [target.name for target in first.targets] == ["same", "same.2"]
    assert first.weights is not None and first.weights.tolist() == [[0, 0.5]] * 2


def test_what_is_left_out_is_said(caplog: pytest.LogCaptureFixture) -> None:
    foreign = Foreign()
    foreign.mesh()
    foreign.animate(0, "scale", [0.0, 1.0], np.ones((2, 3)))

    with caplog.at_level(logging.WARNING):
        scene = foreign.read()

    assert len(scene.time_s) == 0
    assert "animated scale of node 0 is left out" in caplog.text


# damaged files


def spoilt(change: Callable[[dict[str, Any]], None]) -> bytes:
    document, binary = document_of(glb_bytes(full_scene()))
    change(document)
    return pack(document, binary)


def setting(*path: str | int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        place: Any = document
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value

    return change


BAD_DOCUMENTS: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "external buffer": (setting("buffers", 0, "uri", value="a.bin"), "data inside the file"),
    "compressed": (
        setting("extensionsRequired", value=["KHR_draco_mesh_compression"]),
        "KHR_draco_mesh_compression",
    ),
    "old": (setting("asset", "version", value="1.0"), "version 2"),
    "buffer too long": (setting("buffers", 0, "byteLength", value=1 << 30), "cut off"),
    "view too long": (setting("bufferViews", 1, "byteLength", value=1 << 31), "within"),
    "huge count": (setting("accessors", 0, "count", value=1 << 31), "numbers in all"),
    "huge zero accessor": (setting("accessors", 4, "count", value=1 << 31), "200 values"),
    "no view": (
        setting("accessors", 0, "bufferView", value=None),
        "index below",
    ),
    "zeros of any size": (
        setting("accessors", 0, value={"count": 1 << 26, "componentType": 5126, "type": "VEC3"}),
        "a buffer view",
    ),
    "negative": (setting("accessors", 0, "byteOffset", value=-4), "whole number"),
    "fraction": (setting("accessors", 0, "count", value=1.5), "whole number"),
    "true": (setting("nodes", 1, "mesh", value=True), "index below"),
    "wrong type": (setting("accessors", 0, "type", value="VEC2"), "VEC3"),
    "wrong component": (setting("accessors", 0, "componentType", value=1), "component type"),
    "float indices": (setting("accessors", 3, "componentType", value=5126), "whole numbers"),
    "mesh index": (setting("nodes", 1, "mesh", value=99), "index below 4 into meshes"),
    "circle": (setting("nodes", 1, "children", value=[0]), "tree"),
    "nodes a text": (setting("nodes", value="many"), "an array nodes"),
    "node a text": (setting("nodes", 1, value="many"), "an object"),
    "rotation": (setting("nodes", 0, "rotation", value=[0, 0, 0]), "4 numbers rotation"),
    "huge number": (setting("nodes", 0, "translation", value=[10**400, 0, 0]), "3 numbers"),
    "empty scene": (setting("scenes", 0, "nodes", value=[]), "a mesh of triangles"),
    "mode": (setting("meshes", 0, "primitives", 0, "mode", value=9), "triangles"),
    "image": (setting("images", 0, "bufferView", value=5), "a PNG or JPEG"),
    "sampler": (
        setting("animations", 0, "channels", 0, "sampler", value=50),
        "a sampler below",
    ),
    "interpolation": (
        setting("animations", 0, "samplers", 0, "interpolation", value="SMOOTH"),
        "CUBICSPLINE",
    ),
}


@pytest.mark.parametrize("name", BAD_DOCUMENTS)
def test_a_bad_document_is_refused_with_its_place(name: str, tmp_path: Path) -> None:
    change, message = BAD_DOCUMENTS[name]
    path = tmp_path / "bad.glb"
    path.write_bytes(spoilt(change))
    tracemalloc.start()

    with pytest.raises(FileFormatError, match=message) as caught:
        read_glb(path)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}, ")
    assert len(str(caught.value)) < 400
    assert peak < 20e6, f"{peak / 1e6:.0f} MB taken for a bad file"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "an empty file"),
        (b"PK\x03\x04" + bytes(100), "signature glTF"),
        (b"glTF", "4 bytes"),
        (struct.pack("<4sII", b"glTF", 1, 20) + bytes(8), "version 2"),
        (struct.pack("<4sII", b"glTF", 2, 20) + struct.pack("<I4s", 0, b"BIN\0"), "JSON"),
        (pack({"asset": {"version": "2.0"}}, b""), "a mesh of triangles"),
    ],
)
def test_what_is_no_glb_is_refused(data: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.glb").write_bytes(data)

    with pytest.raises(FileFormatError, match=message):
        read_glb(tmp_path / "x.glb")


@pytest.mark.parametrize("text", [b"[" * 200000, b'{"a": NaN}', b"[]", b'{"asset": 3}', b"\xff"])
def test_json_that_is_no_document_is_refused(text: bytes) -> None:
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text

    with pytest.raises(FileFormatError):
        scene_from_glb(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def test_a_file_cut_off_anywhere_is_refused() -> None:
    data = glb_bytes(full_scene())

    for length in range(0, len(data), 97):
        with pytest.raises(FileFormatError):
            scene_from_glb(data[:length])


def test_nan_in_the_buffer_is_refused() -> None:
    document, binary = document_of(glb_bytes(full_scene()))
    start = document["bufferViews"][document["accessors"][0]["bufferView"]]["byteOffset"]

    with pytest.raises(FileFormatError, match="finite"):
        scene_from_glb(pack(document, binary[:start] + b"\xff" * 4 + binary[start + 4 :]))


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(value, dict):
        return [leaf for k, v in value.items() for leaf in _leaves(v, (*path, k))] + [path]
    if isinstance(value, list):
        return [leaf for k, v in enumerate(value) for leaf in _leaves(v, (*path, k))] + [path]
    return [path]


def test_any_value_of_the_document_may_be_nonsense() -> None:
    """Every kind of member is given every kind of junk: read, or refused as a bad file."""
    document, binary = document_of(glb_bytes(full_scene(n_frames=3)))
    junk: list[Any] = [
        None,
        -1,
        0,
        3,
        2**31,
        1e300,
        "x",
        [],
        {},
        [[]],
        True,
        [None],
        [1e39],
        [{}],
        ["x"],
    ]
    n_refused = 0
    first_ones = [p for p in _leaves(document) if p and not any(k in range(2, 99) for k in p)]
    for path in first_ones:
        for value in junk:
            spoiled = json.loads(json.dumps(document))
            setting(*path, value=value)(spoiled)
            try:
                scene_from_glb(pack(spoiled, binary))
            except FileFormatError:
                n_refused += 1
    assert n_refused > 500


def test_flipped_bits_are_read_or_refused() -> None:
    rng = np.random.default_rng(0)
    data = np.frombuffer(glb_bytes(full_scene(n_frames=3)), np.uint8)
    for _ in range(400):
        spoiled = data.copy()
        at = rng.integers(0, len(data), size=3)
        spoiled[at] ^= rng.integers(1, 256, size=3).astype(np.uint8)
        try:
            scene_from_glb(spoiled.tobytes())
        except FileFormatError as error:
            assert "expected" in str(error)
