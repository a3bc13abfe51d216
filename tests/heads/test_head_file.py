"""Heads of files written by us come back as they were."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import FacewrightError
from facewright.core.formats.gltf import GltfScene, write_glb
from facewright.heads.head import Head
from facewright.heads.head_facts import FACTS_KEY
from facewright.heads.head_file import head_scene
from facewright.heads.own_head import OwnHead, read_own_head

#: Of a vertex: glTF stores metres in single precision.
ROUNDING_MM = 2e-5


@pytest.fixture(scope="module")
def scene(people: tuple[Head, ...]) -> GltfScene:
    return head_scene(people[2], lips_part=True, texture_px=128)


@pytest.fixture(scope="module")
def again(scene: GltfScene, tmp_path_factory: pytest.TempPathFactory) -> OwnHead:
    path = tmp_path_factory.mktemp("kept") / "someone.glb"
    write_glb(path, scene)
    return read_own_head(path)


def corners(head: Head, part: str) -> NDArray[np.float64]:
    return head.mesh.vertices[head.mesh.triangles[head.mesh.groups[part]]]


def test_parts_points_joints_and_regions_come_back(
    again: OwnHead, people: tuple[Head, ...]
) -> None:
    before, after = people[2], again.head

    assert again.placed == "kept"
    assert after.name == before.name
    assert again.unit_mm == 1.0
    assert set(after.mesh.groups) == set(before.mesh.groups)
    for part in before.mesh.groups:
        np.testing.assert_allclose(corners(after, part), corners(before, part), atol=ROUNDING_MM)
    assert after.points.keys() == before.points.keys()
    for name, p in before.points.items():
        np.testing.assert_allclose(after.points[name], p, atol=2e-4, err_msg=name)
    np.testing.assert_allclose(after.jaw_pivot, before.jaw_pivot, atol=1e-5)
    np.testing.assert_allclose(after.neck_pivot, before.neck_pivot, atol=1e-5)
    for side, eye in before.eyes.items():
        np.testing.assert_allclose(after.eyes[side].centre, eye.centre, atol=1e-5)
        assert abs(after.eyes[side].radius - eye.radius) < 1e-5
    assert set(after.regions) == set(before.regions)
    for name, rows in before.regions.items():  # triangles keep their order within a part
        there = after.mesh.vertices[after.mesh.triangles[after.regions[name]]]
        here = before.mesh.vertices[before.mesh.triangles[np.sort(rows)]]
        np.testing.assert_allclose(there, here, atol=ROUNDING_MM, err_msg=name)


def test_shapes_come_back_to_single_precision(again: OwnHead, people: tuple[Head, ...]) -> None:
    before, after = people[2], again.head
    assert before.shapes is not None
    furthest = np.abs(before.shapes).max(axis=(1, 2))
    moving = [n for n, d in zip(before.shape_names, furthest, strict=True) if d > 1e-3]

    assert set(after.shape_names) == set(moving)
    for shape in ("jawOpen", "eyeBlinkLeft", "mouthSmileRight"):
        for part in ("skin", "teeth_lower"):
            there = after.shaped({shape: 0.7})[after.mesh.triangles[after.mesh.groups[part]]]
            here = before.shaped({shape: 0.7})[before.mesh.triangles[before.mesh.groups[part]]]
            np.testing.assert_allclose(there, here, atol=5e-5)


def test_corrected_points_count_before_those_of_the_file(
    scene: GltfScene, people: tuple[Head, ...], tmp_path: Path
) -> None:
    write_glb(tmp_path / "someone.glb", scene)
    head = people[2]
    corner = head.mesh.vertices[head.mesh.triangles[head.mesh.groups["skin"]][0, 0]]
    wanted = {**head.points, "5.1": corner, "7.1": head.neck_pivot + (0, 3.0, 0)}

    found = read_own_head(tmp_path / "someone.glb", wanted)

    assert found.placed == "kept"
    np.testing.assert_allclose(found.head.points["5.1"], corner, atol=2e-4)
    np.testing.assert_allclose(found.head.neck_pivot, wanted["7.1"], atol=1e-9)
    np.testing.assert_allclose(found.head.points["5.2"], head.points["5.2"], atol=2e-4)


def test_a_file_whose_mesh_was_changed_is_recognised_anew(
    scene: GltfScene, people: tuple[Head, ...], tmp_path: Path
) -> None:
    wider = tuple(replace(part, vertices=part.vertices * (1.05, 1, 1)) for part in scene.parts)
    write_glb(tmp_path / "wider.glb", replace(scene, parts=wider))
    clicks = {n: people[2].points[n] * (1.05, 1, 1) for n in ("3.7", "3.8", "9.3", "8.3", "8.4")}

    found = read_own_head(tmp_path / "wider.glb", clicks)

    assert found.placed == "given"
    assert any("changed since facewright wrote it" in note for note in found.notes)
    mouth = found.head.points["8.3"] - found.head.points["8.4"]
    truth = people[2].points["8.3"] - people[2].points["8.4"]
    assert abs(np.linalg.norm(mouth) - 1.05 * np.linalg.norm(truth)) < 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 9}, "version 9"),
        ({"jaw_pivot": [0, 1]}, "3 finite numbers"),
        ({"eyes": {"left": [0, 0, 0, "wide"]}}, "ValueError"),
        ({"region_bits": "%%%"}, "Error"),
        ({"points": None}, "AttributeError"),
    ],
)
def test_damaged_facts_are_refused(
    scene: GltfScene, tmp_path: Path, change: dict[str, object], said: str
) -> None:
    facts = {**json.loads(scene.extras[FACTS_KEY]), **change}
    damaged = replace(scene, extras={FACTS_KEY: json.dumps(facts)})
    write_glb(tmp_path / "damaged.glb", damaged)

    with pytest.raises(FacewrightError, match=said):
        read_own_head(tmp_path / "damaged.glb")
