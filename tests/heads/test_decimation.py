from __future__ import annotations

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.heads.decimation import decimate
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.heads.raycast import RayScene


@pytest.fixture(scope="module")
def full() -> Head:
    return make_head(Identity("full"))


@pytest.mark.parametrize(("n", "off_mm"), [(1257, 1.6), (6000, 0.4)])
def test_a_lighter_head_is_the_same_head(full: Head, n: int, off_mm: float) -> None:
    light = decimate(full, n)

    assert n - 3 <= len(light.mesh.vertices) <= n
    assert {"skin", "eye_left", "eye_right"} <= set(light.mesh.groups)
    assert sum(len(rows) for rows in light.mesh.groups.values()) == len(light.mesh.triangles)
    for name, place in light.points.items():
        assert np.linalg.norm(place - full.points[name]) < off_mm, name
    skin = light.mesh.triangles[light.mesh.groups["skin"]]
    rows = full.part_vertices("skin")
    at, *_ = RayScene(light.mesh.vertices, skin).closest(full.mesh.vertices[rows])
    distance = np.linalg.norm(at - full.mesh.vertices[rows], axis=1)
    assert np.sqrt((distance**2).mean()) < off_mm / 2
    for name, unit in light.fapu.as_dict().items():
        assert unit == pytest.approx(full.fapu.as_dict()[name], rel=0.05)


def test_the_neck_keeps_its_one_border(full: Head) -> None:
    light = decimate(full, 3000)
    skin = light.mesh.triangles[light.mesh.groups["skin"]]
    edges = np.sort(np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]], skin[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    border = light.mesh.vertices[unique[count == 1].ravel()]
    lowest = full.mesh.vertices[:, 1].min()
    assert len(border) and border[:, 1].max() < lowest + 0.4 * abs(lowest)


def test_impossible_sizes_are_told(full: Head) -> None:
    for n in (10, 10**6):
        with pytest.raises(InputError, match=f"not {n}"):
            decimate(full, n)
