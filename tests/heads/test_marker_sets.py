"""Where markers are glued."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.core.markers import HEAD, Marker
from facewright.datasets_synthetic.take_settings import MarkerSettings
from facewright.datasets_synthetic.takes import LID_RADIUS_SHARE
from facewright.heads.head import Head
from facewright.heads.marker_sets import (
    CORNER_OFFSET_MM,
    LID_OFFSET_MM,
    glue_markers,
    ready_marker_set,
)
from facewright.heads.raycast import RayScene

CORNERS = {"8.3": 1, "8.4": -1}
LIDS = {"3.1": 1, "3.2": 1, "3.3": -1, "3.4": -1}


def test_the_ready_set_has_27_markers_of_the_face_and_3_of_the_skull() -> None:
    markers = ready_marker_set().markers

    assert sum(m.feature_point == HEAD for m in markers) == 3
    assert sum(m.feature_point != HEAD for m in markers) == 27
    with pytest.raises(InputError, match="no ready marker set vicon; there are kshirsagar"):
        ready_marker_set("vicon")


def test_markers_are_on_the_skin_at_their_feature_points(people: tuple[Head, ...]) -> None:
    marker_set = ready_marker_set()
    for head in people[:10]:
        glue = glue_markers(head, marker_set)
        at = glue.at(head.mesh.vertices)
        assert glue.names == marker_set.labels
        assert np.isin(glue.corners, head.part_vertices("skin")).all()
        assert glue.barycentric.min() > -1e-6
        for marker, p in zip(marker_set.markers, at, strict=True):
            if marker.is_rigid:
                continue
            d = p - head.points[marker.feature_point]
            if marker.feature_point in LIDS:
                # the skin nearest to a spot above the lid's edge may lie lower on some faces
                assert 0.1 < d[1] * LIDS[marker.feature_point] < 2 * LID_OFFSET_MM
            elif marker.feature_point in CORNERS:
                assert 1.0 < d[0] * CORNERS[marker.feature_point] < 1.2 * CORNER_OFFSET_MM
                assert np.linalg.norm(d) < 1.5 * CORNER_OFFSET_MM
            else:
                assert np.linalg.norm(d) < 1e-3


@pytest.mark.parametrize(("name", "n"), [("kshirsagar", 30), ("full53", 53), ("few16", 16)])
def test_no_two_dots_touch(people: tuple[Head, ...], name: str, n: int) -> None:
    marker_set = ready_marker_set(name)
    assert len(marker_set.markers) == n
    for head in people:
        p = glue_markers(head, marker_set).at(head.mesh.vertices)
        d = np.linalg.norm(p[:, None] - p, axis=2) + 1e3 * np.eye(len(p))
        assert d.min() > 5.0


def test_the_dots_of_the_lids_do_not_touch_in_a_blink(people: tuple[Head, ...]) -> None:
    marker_set = ready_marker_set()
    label = marker_set.label_by_feature_point
    for head in people:
        assert head.shapes is not None
        glue = glue_markers(head, marker_set)
        for upper, lower, shape in (("3.1", "3.3", "Left"), ("3.2", "3.4", "Right")):
            blink = head.shapes[head.shape_names.index(f"eyeBlink{shape}")].astype(np.float64)
            edges = head.feature_points.select((upper, lower))
            gap = head.points[upper][1] - head.points[lower][1]
            travel = edges.at(blink)[1, 1] - edges.at(blink)[0, 1]
            closed = head.mesh.vertices + min(gap / travel, 1.0) * blink
            dots = glue.select((label[upper], label[lower])).at(closed)
            assert (
                np.linalg.norm(dots[0] - dots[1])
                > 2 * LID_RADIUS_SHARE * MarkerSettings().radius_mm
            )


def test_expressions_hardly_move_the_markers_of_the_skull(people: tuple[Head, ...]) -> None:
    """They are glued to skin, and a frown reaches the temples; 0.3 mm are 0.13° of the head."""
    marker_set = ready_marker_set()
    rigid = [i for i, m in enumerate(marker_set.markers) if m.is_rigid]
    for head in people[:10]:
        assert head.shapes is not None
        glue = glue_markers(head, marker_set)
        moved = np.einsum(
            "nc,sncx->snx", glue.barycentric[rigid], head.shapes[:, glue.corners[rigid]]
        )
        assert np.linalg.norm(moved, axis=2).max() < 0.3


def test_markers_of_the_skull_are_well_spread(people: tuple[Head, ...]) -> None:
    marker_set = ready_marker_set()
    rigid = [i for i, m in enumerate(marker_set.markers) if m.is_rigid]
    for head in people:
        a, b, c = glue_markers(head, marker_set).at(head.mesh.vertices)[rigid]
        assert np.linalg.norm(np.cross(b - a, c - a)) / 2 > 2000  # mm² of the triangle


def test_a_head_without_a_feature_point_of_the_set_is_refused(average_head: Head) -> None:
    names = tuple(n for n in average_head.feature_points.names if n != "9.3")
    lacking = replace(average_head, feature_points=average_head.feature_points.select(names))

    with pytest.raises(InputError, match=r"head average has no feature point 9\.3"):
        glue_markers(lacking, ready_marker_set())


def test_a_head_marker_goes_to_the_skin_near_its_rough_place(average_head: Head) -> None:
    skin = average_head.mesh.triangles[average_head.mesh.groups["skin"]]
    scene = RayScene(average_head.mesh.vertices, skin)
    base = ready_marker_set()
    spots = {"left": (60.0, 40.0, -30.0), "right": (-60.0, 40.0, -30.0), "front": (5.0, 60.0, 20.0)}
    more = tuple(Marker(name, HEAD, spot) for name, spot in spots.items())
    marker_set = replace(base, markers=(*base.markers, *more))

    at = glue_markers(average_head, marker_set).at(average_head.mesh.vertices)[-3:]

    on_skin, *_ = scene.closest(at)
    np.testing.assert_allclose(at, on_skin, atol=1e-3)
    nearest, *_ = scene.closest(np.array(list(spots.values())))
    assert np.linalg.norm(at - nearest, axis=1).max() < 8.0  # a rough place, on a head of any size
