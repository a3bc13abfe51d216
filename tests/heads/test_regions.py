"""Regions of the skin: a partition, in one piece each, with the landmarks that belong to them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from facewright.heads.head import Head
from facewright.heads.landmarks import template_landmarks
from facewright.heads.regions import RED_LIPS, REGIONS, template_regions
from facewright.heads.template import load_template, template_feature_points


def test_regions_part_the_skin() -> None:
    regions, skin = template_regions(), load_template().groups()["skin"]

    together = np.concatenate([regions[name] for name in REGIONS])

    assert len(together) == len(np.unique(together))
    np.testing.assert_array_equal(np.sort(together), skin)
    assert set(regions) == {*REGIONS, *RED_LIPS}
    for red in RED_LIPS:
        assert set(regions[red].tolist()) < set(regions[red.removesuffix("_red")].tolist())


@pytest.mark.parametrize("name", sorted({n[:-2] for n in REGIONS if n.endswith("_l")}))
def test_left_and_right_regions_are_alike(name: str) -> None:
    template, regions = load_template(), template_regions()
    centres = [
        template.vertices[template.triangles[regions[f"{name}_{side}"]]].mean(axis=1)
        for side in "lr"
    ]
    areas = []
    for side in "lr":
        a, b, c = np.moveaxis(
            template.vertices[template.triangles[regions[f"{name}_{side}"]]], 1, 0
        )
        areas.append(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    assert centres[0][:, 0].min() > 0 > centres[1][:, 0].max()
    np.testing.assert_allclose(
        centres[0].mean(axis=0) * (-1, 1, 1), centres[1].mean(axis=0), atol=1.5
    )
    assert areas[0] == pytest.approx(areas[1], rel=0.03)


@pytest.mark.parametrize("name", REGIONS)
def test_a_region_is_one_piece_but_for_crumbs(name: str) -> None:
    triangles = load_template().triangles[template_regions()[name]]
    a, b = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    n = int(triangles.max()) + 1
    _, label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (n, n)), directed=False)
    _, sizes = np.unique(label[triangles[:, 0]], return_counts=True)

    assert sizes.max() > 0.9 * sizes.sum()


#: Landmarks and feature points → the region that must hold them, by anatomy.
HOLDS = {
    "g": "forehead", "prn": "nose", "se": "nose", "al_l": "nose", "al_r": "nose", "pg": "chin",
    "ls": "upper_lip", "li": "lower_lip", "cph_l": "upper_lip", "v": "scalp", "eu_l": "scalp",
    "sa_l": "ear_l", "sba_r": "ear_r", "ps_l": "lids_l", "pi_r": "lids_r",
    "4.1": "brow_l", "4.4": "brow_r", "5.1": "cheek_l", "5.4": "cheek_r", "2.13": "jaw_l",
    "8.1": "upper_lip", "8.2": "lower_lip", "zy_l": "cheek_l", "2.14": "jaw_r",
}  # fmt: skip


@pytest.mark.parametrize(("point", "region"), HOLDS.items())
def test_points_lie_in_their_regions(point: str, region: str) -> None:
    template = load_template()
    points = template_feature_points() if point[0].isdigit() else template_landmarks()
    corners = set(points.corners[points.index(point)].tolist())
    holding = [
        name
        for name in REGIONS
        if any(corners == set(t) for t in template.triangles[template_regions()[name]].tolist())
    ]

    assert holding == [region]


def test_cavities_are_out_of_sight() -> None:
    """Sockets and the inside of the mouth lie behind the skin that is seen from the front."""
    template, regions = load_template(), template_regions()
    for name in ("socket_l", "socket_r", "inner_mouth"):
        hidden = template.vertices[template.triangles[regions[name]]].mean(axis=1)
        assert hidden[:, 2].max() < 28.0
    face = np.concatenate([regions[n] for n in ("nose", "forehead", "chin", "cheek_l", "cheek_r")])
    normal_z = np.cross(
        *np.moveaxis(np.diff(template.vertices[template.triangles[face]], axis=1), 1, 0)
    )[:, 2]
    assert np.mean(normal_z > 0) > 0.7


def test_heads_have_the_regions_of_the_template(average_head: Head) -> None:
    assert set(average_head.regions) == {*REGIONS, *RED_LIPS}
