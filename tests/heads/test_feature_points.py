"""Feature points on the template: found by geometry, symmetric, and all that FAPs need."""

from __future__ import annotations

import csv
from importlib.resources import files

import numpy as np
import pytest

import facewright.heads
from facewright.core.mpeg4 import fap_table, feature_point_table
from facewright.heads.head import Head
from facewright.heads.place_feature_points import place
from facewright.heads.template import load_template, template_feature_points

NO_SKIN = {"3.5": "eye_left", "3.6": "eye_right"} | {f"6.{i}": "tongue" for i in range(1, 5)}
NO_SKIN |= {"9.8": "teeth_upper", "9.10": "teeth_upper", "9.9": "teeth_lower"}
NO_SKIN |= {"9.11": "teeth_lower"}


def at_template() -> dict[str, np.ndarray]:
    points = template_feature_points()
    return dict(zip(points.names, points.at(load_template().vertices), strict=True))


def test_points_are_mirror_images_of_each_other() -> None:
    at = at_template()
    table = feature_point_table()
    for name, p in at.items():
        mirror = table[name].mirror_id
        if mirror:
            np.testing.assert_allclose(at[mirror] * (-1, 1, 1), p, atol=0.3, err_msg=name)
        else:
            assert abs(p[0]) < 0.3, name


def test_every_point_that_a_fap_moves_is_there_on_its_part(average_head: Head) -> None:
    template = load_template()
    on = {part: set(template.vertices_of(part).tolist()) for part in template.groups()}
    points = average_head.feature_points
    for fap in fap_table():
        for fp in fap.feature_points:
            if fp == "7.1":  # the head's turning point is no point of the surface
                continue
            assert fp in points.names, f"FAP {fap.number} {fap.name} needs {fp}"
            corners = points.corners[points.index(fp)].tolist()
            assert set(corners) <= on[NO_SKIN.get(fp, "skin")], fp


def test_a_head_has_all_84_points(average_head: Head) -> None:
    """On the surface, but for the centre of rotation inside and the top of the hair."""
    points, table = average_head.points, feature_point_table()
    skin = average_head.mesh.vertices[average_head.part_vertices("skin")]
    near = skin[np.abs(skin[:, 1] - points["7.1"][1]) < 5]

    assert set(points) == set(table)
    assert len(table) == 84
    assert set(table) - set(average_head.feature_points.names) == {"7.1", "11.5"}
    np.testing.assert_array_equal(points["7.1"], average_head.neck_pivot)
    assert near[:, 2].min() < points["7.1"][2] < near[:, 2].max()
    np.testing.assert_array_equal(points["11.5"], points["11.4"])


def test_ears_touch_the_face_between_their_tops_and_lobes(people: tuple[Head, ...]) -> None:
    for head in people:
        p = head.points
        for top, upper, lower, lobe in (
            ("10.1", "10.9", "10.7", "10.5"),
            ("10.2", "10.10", "10.8", "10.6"),
        ):
            assert p[top][1] > p[upper][1] > p[lower][1] > p[lobe][1] - 1, head.name
            assert min(p[upper][2], p[lower][2]) > p["10.3" if lower == "10.7" else "10.4"][2]


def test_points_are_inside_their_triangles() -> None:
    assert template_feature_points().barycentric.min() >= 0


def test_the_table_is_what_the_rules_give() -> None:
    """heads/data/feature_points.csv is not edited by hand."""
    text = files(facewright.heads).joinpath("data", "feature_points.csv").read_text("utf-8")
    rows = {r["id"]: r for r in csv.DictReader(text.splitlines())}
    placed = {fp: (p, part) for fp, p, part, _ in place(load_template())}
    at = at_template()

    assert set(rows) == set(placed) == set(at)
    for fp, (p, part) in placed.items():
        assert rows[fp]["part"] == part
        written = np.array([float(rows[fp][f"{a}_mm"]) for a in "xyz"])
        np.testing.assert_allclose(written, at[fp], atol=0.006, err_msg=fp)
        assert np.linalg.norm(at[fp] - p) < 1.0, fp  # drawn to the surface


#: (higher, lower), (farther to the left, farther to the right), (before, behind)
ABOVE = [
    ("4.3", "3.1"), ("3.1", "3.3"), ("3.3", "9.15"), ("9.15", "8.1"), ("8.1", "2.2"),
    ("8.1", "2.3"), ("2.3", "8.2"), ("8.2", "2.10"), ("2.10", "2.1"), ("11.1", "4.1"),
    ("11.4", "11.1"), ("3.13", "3.1"), ("3.3", "3.9"), ("10.1", "10.5"), ("9.3", "9.15"),
]  # fmt: skip
LEFT = [
    ("3.7", "3.11"), ("3.11", "3.8"), ("8.3", "8.4"), ("8.3", "2.4"), ("4.5", "4.3"),
    ("4.3", "4.1"), ("5.1", "8.3"), ("10.5", "5.1"), ("9.1", "9.2"), ("3.5", "3.6"),
    ("2.11", "2.12"), ("2.13", "2.11"), ("8.5", "8.6"), ("8.10", "8.9"), ("6.3", "6.4"),
]  # fmt: skip
BEFORE = [("9.3", "9.1"), ("9.3", "8.1"), ("8.1", "5.1"), ("5.1", "10.5"), ("11.1", "11.6")]


def test_points_are_where_their_names_say_on_everybody(people: tuple[Head, ...]) -> None:
    """The order of points on a face, as the standard's drawings show it."""
    for head in people:
        p = head.points
        for axis, pairs in ((1, ABOVE), (0, LEFT), (2, BEFORE)):
            for more, less in pairs:
                assert p[more][axis] > p[less][axis], f"{head.name}: {more} and {less}"
        assert p["2.2"][1] > p["2.3"][1] - 0.3, f"{head.name}: closed lips may overlap a little"


@pytest.mark.parametrize(("upper", "lower"), [("3.1", "3.3"), ("3.2", "3.4")])
def test_the_eyeball_shows_between_the_lids_and_hardly_beyond(
    people: tuple[Head, ...], upper: str, lower: str
) -> None:
    """Lid points sit at the lids' edges: the pupil lies between them."""
    pupil = "3.5" if upper == "3.1" else "3.6"
    for head in people:
        p = head.points
        assert p[lower][1] < p[pupil][1] < p[upper][1]
        assert abs(p[upper][0] - p[pupil][0]) < 5
