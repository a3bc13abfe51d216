"""Joints and tangents in .glb files, judged by the specification's formulas."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from facewright.core.errors import FileFormatError
from facewright.core.formats.gltf import GltfPart, GltfScene, MorphTarget, glb_bytes, scene_from_glb
from facewright.core.formats.gltf_tangents import vertex_tangents
from facewright.core.mesh import vertex_normals
from facewright.core.rigid import rotation_from_quaternion

N_FRAMES = 5
POINTS = np.array([[0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 40]], dtype=np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


def turning(axis: tuple[float, float, float], most: float) -> NDArray[np.float64]:
    angles = np.linspace(0.1, most, N_FRAMES)[:, None]
    return np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * np.array([axis])], axis=1)


NECK = np.array([0.5, -91.3, -60.7])


def jointed_scene(root_pivot: tuple[float, ...] = (0.0, 0.0, 0.0)) -> GltfScene:
    rng = np.random.default_rng(4)
    target = MorphTarget("jawOpen", np.array([1, 3], np.int32), rng.normal(size=(2, 3)))
    skin = GltfPart(
        "skin", POINTS, FACES, vertex_normals(POINTS, FACES), joint="head",
        targets=(target,), weights=rng.uniform(size=(N_FRAMES, 1)),
    )  # fmt: skip
    jaw = replace(
        skin, name="teeth", vertices=POINTS + (0, -60, 20), joint="jaw", targets=(), weights=None,
        rotation=turning((1, 0, 0), 0.5), translation=rng.normal(size=(N_FRAMES, 3)),
        pivot=np.array([0.1, -20.3, -70.7]),
    )  # fmt: skip
    tongue = replace(
        jaw, name="tongue", vertices=POINTS + (5, -50, 10), targets=(target,), weights=skin.weights
    )
    eye = replace(
        jaw, name="eye", joint="eye_left", rotation=turning((0, 1, 0), -0.4),
        translation=None, pivot=np.array([31.3, 1.0, 3.0]),
    )  # fmt: skip
    return GltfScene(
        "take", (skin, jaw, tongue, eye), np.arange(N_FRAMES) / 25,
        turning((0, 0.6, 0.8), 1.2), rng.normal(scale=50, size=(N_FRAMES, 3)),
        root_pivot=np.array(root_pivot),
    )  # fmt: skip


def assert_near(
    found: NDArray[np.float64] | None, truth: NDArray[np.float64] | None, allowed: float
) -> None:
    assert found is not None and truth is not None
    np.testing.assert_allclose(found, truth, rtol=0, atol=allowed)


def document_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def stored(document: dict[str, Any], binary: bytes, index: int) -> NDArray[np.float64]:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype = {5126: "<f4", 5123: "<u2", 5121: "<u1"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
    a = np.frombuffer(binary, dtype, accessor["count"] * width, view["byteOffset"])
    found = a.reshape(-1, width).astype(np.float64)
    return found / 255 if accessor.get("normalized") else found


def world(document: dict[str, Any], binary: bytes, frame: int) -> dict[int, NDArray[np.float64]]:
    """Global transforms of all nodes of the tree in one frame, metres."""
    animation = document["animations"][0]
    moved: dict[tuple[int, str], NDArray[np.float64]] = {}
    for channel in animation["channels"]:
        values = stored(document, binary, animation["samplers"][channel["sampler"]]["output"])
        target = channel["target"]
        moved[target["node"], target["path"]] = values.reshape(N_FRAMES, -1)[frame]
    found: dict[int, NDArray[np.float64]] = {}

    def place(index: int, above: NDArray[np.float64]) -> None:
        node = document["nodes"][index]
        matrix = np.eye(4)
        xyzw = moved.get((index, "rotation"), np.array(node.get("rotation", (0, 0, 0, 1))))
        matrix[:3, :3] = rotation_from_quaternion(np.roll(xyzw, 1))
        matrix[:3, 3] = moved.get((index, "translation"), node.get("translation", (0, 0, 0)))
        found[index] = above @ matrix
        for child in node.get("children", ()):
            place(child, found[index])

    for root in document["scenes"][0]["nodes"]:
        place(root, np.eye(4))
    return found


PIVOTS = pytest.mark.parametrize("pivot", [(0.0, 0.0, 0.0), tuple(NECK)], ids=["eyes", "neck"])


@PIVOTS
def test_skinned_vertices_stand_where_the_specification_puts_them(
    pivot: tuple[float, ...],
) -> None:
    scene = jointed_scene(pivot)
    document, binary = document_of(glb_bytes(scene))
    (skin,) = document["skins"]
    inverse = stored(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4)
    names = [document["nodes"][j]["name"] for j in skin["joints"]]
    assert names == ["head", "jaw", "eye_left"]
    assert scene.root_rotation is not None and scene.root_translation is not None

    for frame in range(N_FRAMES):
        globals_ = world(document, binary, frame)
        for part in scene.parts:
            node = next(n for n in document["nodes"] if n["name"] == part.name)
            primitive = document["meshes"][node["mesh"]]["primitives"][0]
            points = stored(document, binary, primitive["attributes"]["POSITION"])
            expected = part.vertices.copy()
            if part.weights is not None:
                for target in part.targets:
                    points[target.rows] += part.weights[frame, 0] * target.offsets / 1000
                    expected[target.rows] += part.weights[frame, 0] * target.offsets
            joints = stored(document, binary, primitive["attributes"]["JOINTS_0"]).astype(int)
            shares = stored(document, binary, primitive["attributes"]["WEIGHTS_0"])
            np.testing.assert_array_equal(shares.sum(axis=1), 1)
            matrices = np.stack(
                [globals_[j] @ m.T for j, m in zip(skin["joints"], inverse, strict=True)]
            )
            blended = np.einsum("vk,vkij->vij", shares, matrices[joints])
            found = np.einsum("vij,vj->vi", blended[:, :3, :3], points) + blended[:, :3, 3]

            if part.rotation is not None:
                turn = rotation_from_quaternion(part.rotation[frame])
                shift = 0 if part.translation is None else part.translation[frame]
                expected = (expected - part.pivot) @ turn.T + part.pivot + shift
            turn = rotation_from_quaternion(scene.root_rotation[frame])
            expected = expected @ turn.T + scene.root_translation[frame]
            assert np.abs(found * 1000 - expected).max() < 1e-4, (part.name, frame)


def test_one_channel_turns_a_joint_and_none_the_parts() -> None:
    document, _ = document_of(glb_bytes(jointed_scene()))
    targets = [
        (document["nodes"][c["target"]["node"]]["name"], c["target"]["path"])
        for c in document["animations"][0]["channels"]
    ]

    assert len(set(targets)) == len(targets)
    assert {t for t in targets if t[1] != "weights"} == {
        ("head", "rotation"), ("head", "translation"), ("jaw", "rotation"),
        ("jaw", "translation"), ("eye_left", "rotation"),
    }  # fmt: skip
    assert {n for n, path in targets if path == "weights"} == {"skin", "tongue"}


@PIVOTS
@pytest.mark.parametrize("joints", [True, False], ids=["joints", "nodes"])
def test_a_scene_comes_back_and_is_written_the_same(pivot: tuple[float, ...], joints: bool) -> None:
    truth = jointed_scene(pivot)
    if not joints:
        truth = replace(truth, parts=tuple(replace(p, joint=None) for p in truth.parts))
    data = glb_bytes(truth)

    found = scene_from_glb(data)

    expected = ["head", "jaw", "jaw", "eye_left"] if joints else [None] * 4
    assert [p.joint for p in found.parts] == expected
    for a, b in zip(found.parts, truth.parts, strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=2e-5)
        for what in ("rotation", "translation", "weights", "pivot"):
            x, y = getattr(a, what), getattr(b, what)
            assert (x is None) == (y is None), (b.name, what)
            if x is not None:
                np.testing.assert_allclose(x, y, atol=2e-5, err_msg=f"{b.name} {what}")
    assert_near(found.root_rotation, truth.root_rotation, 1e-7)
    assert_near(found.root_translation, truth.root_translation, 5e-5)
    np.testing.assert_allclose(found.root_pivot, truth.root_pivot, atol=1e-12)
    assert glb_bytes(found) == data


def channels_of(data: bytes) -> set[tuple[str, str]]:
    document, _ = document_of(data)
    return {
        (document["nodes"][c["target"]["node"]]["name"], c["target"]["path"])
        for c in document["animations"][0]["channels"]
    }


def test_a_head_that_turns_about_its_neck_is_not_shifted() -> None:
    scene = jointed_scene(tuple(NECK))
    assert scene.root_rotation is not None
    nod = NECK - rotation_from_quaternion(scene.root_rotation) @ NECK
    scene = replace(scene, root_translation=nod)
    data = glb_bytes(scene)

    found = scene_from_glb(data)

    assert ("head", "rotation") in channels_of(data)
    assert ("head", "translation") not in channels_of(data)
    assert_near(found.root_translation, nod, 5e-5)
    assert glb_bytes(found) == data


def test_eyes_that_move_in_a_still_head_come_back() -> None:
    scene = replace(jointed_scene(tuple(NECK)), root_rotation=None, root_translation=None)
    data = glb_bytes(scene)

    found = scene_from_glb(data)

    assert found.root_rotation is None and found.root_translation is None
    for a, b in zip(found.parts, scene.parts, strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=2e-5)
        assert a.joint == b.joint
    assert glb_bytes(found) == data


@PIVOTS
def test_a_head_at_rest_may_have_joints_too(pivot: tuple[float, ...]) -> None:
    scene = jointed_scene(pivot)
    still = tuple(replace(p, rotation=None, translation=None, weights=None) for p in scene.parts)

    found = scene_from_glb(glb_bytes(GltfScene("still", still, root_pivot=np.array(pivot))))

    for a, b in zip(found.parts, still, strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=2e-5)


def test_a_mesh_of_two_joints_stays_at_rest_and_takes_the_others_with_it() -> None:
    document, binary = document_of(glb_bytes(jointed_scene()))
    node = next(n for n in document["nodes"] if n["name"] == "skin")
    attributes = document["meshes"][node["mesh"]]["primitives"][0]["attributes"]
    view = document["bufferViews"][document["accessors"][attributes["JOINTS_0"]]["bufferView"]]
    spoilt = bytearray(binary)
    spoilt[view["byteOffset"]] = 1  # its first vertex goes with the jaw
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(spoilt), b"BIN\0") + bytes(spoilt)

    found = scene_from_glb(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)

    assert all(p.rotation is None and p.joint is None for p in found.parts)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": "head"}, "joint of its own"),
        ({"joint": ""}, "joint of its own"),
    ],
)
def test_a_part_that_moves_needs_its_own_joint(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(jointed_scene().parts[1], **change)


def test_parts_of_one_joint_must_move_alike() -> None:
    scene = jointed_scene()
    other = replace(scene.parts[2], pivot=np.array([0.0, 1.0, 0.0]))

    with pytest.raises(ValueError, match="teeth and tongue share joint jaw: one pivot"):
        replace(scene, parts=(*scene.parts[:2], other))


def test_a_joint_that_is_not_there_is_refused() -> None:
    document, binary = document_of(glb_bytes(jointed_scene()))
    document["skins"][0]["joints"][1] = 99
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary

    with pytest.raises(FileFormatError, match="index below"):
        scene_from_glb(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


# tangents


def test_tangents_of_a_plane_are_its_axes_mirrored_or_not() -> None:
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    normals = np.tile((0.0, 0.0, 1.0), (4, 1))
    uv = points[:, :2] / 3 * (1, -1)  # v grows downwards, as stored

    np.testing.assert_allclose(
        vertex_tangents(points, faces, normals, uv), np.tile((1, 0, 0, 1), (4, 1)), atol=1e-12
    )
    np.testing.assert_allclose(
        vertex_tangents(points, faces, normals, uv * (-1, 1)),
        np.tile((-1, 0, 0, -1), (4, 1)),
        atol=1e-12,
    )


def test_tangents_of_a_sphere_run_along_its_parallels() -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0.2, 0.8, 31))
    longitude, latitude = 2 * np.pi * u.ravel(), np.pi * (0.5 - v.ravel())
    around = np.stack([np.sin(longitude), np.zeros_like(longitude), np.cos(longitude)], axis=1)
    points = np.cos(latitude)[:, None] * around + np.sin(latitude)[:, None] * (0.0, 1.0, 0.0)
    i = np.arange(30 * 40).reshape(30, 40)
    corner = (i // 40) * 41 + i % 40
    quads = np.stack([corner, corner + 41, corner + 42, corner + 1], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)

    found = vertex_tangents(points, faces, points, np.stack([u.ravel(), v.ravel()], axis=1))

    east = np.stack([np.cos(longitude), np.zeros_like(longitude), -np.sin(longitude)], axis=1)
    inner = (found[:, :3] * east).sum(axis=1)
    assert inner.min() > 0.99
    assert (found[:, 3] == 1).all()


def test_tangents_are_perpendicular_units_whatever_the_texture() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    faces = np.array([rng.permutation(50)[:3] for _ in range(80)], dtype=np.int32)
    normals = vertex_normals(points, faces)
    normals[np.linalg.norm(normals, axis=1) == 0] = (0, 0, 1)
    for uv in (rng.uniform(size=(50, 2)), np.zeros((50, 2))):
        found = vertex_tangents(points, faces, normals, uv)
        np.testing.assert_allclose(np.linalg.norm(found[:, :3], axis=1), 1, atol=1e-9)
        assert np.abs((found[:, :3] * normals).sum(axis=1)).max() < 1e-9
        assert set(np.abs(found[:, 3]).tolist()) == {1.0}


def test_a_normal_map_brings_tangents_into_the_file() -> None:
    out = io.BytesIO()
    Image.new("RGB", (4, 4), (128, 128, 255)).save(out, "PNG")
    uv = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], dtype=np.float64)
    part = GltfPart("a", POINTS, FACES, vertex_normals(POINTS, FACES), uv)
    mapped = replace(part, normal_png=out.getvalue())

    with_map, _ = document_of(glb_bytes(GltfScene("s", (mapped,))))
    without, _ = document_of(glb_bytes(GltfScene("s", (part,))))

    assert "TANGENT" in with_map["meshes"][0]["primitives"][0]["attributes"]
    assert "TANGENT" not in without["meshes"][0]["primitives"][0]["attributes"]
