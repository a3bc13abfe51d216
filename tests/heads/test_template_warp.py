"""Laying the template onto another head: similarity in closed form, people by known points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.core.errors import InputError
from facewright.heads.face_model import face_model
from facewright.heads.head import Head
from facewright.heads.similarity import Similarity
from facewright.heads.skin_surface import Surface
from facewright.heads.template import load_template, template_feature_points
from facewright.heads.template_warp import (
    LaidTemplate,
    known_points,
    lay_template,
)

CLICKS = ("3.7", "3.8", "9.3", "8.3", "8.4", "2.1")


def test_a_similarity_is_found_from_three_points_and_undone() -> None:
    rng = np.random.default_rng(2)
    truth = Similarity(0.013, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    points = rng.normal(size=(3, 3))

    found = Similarity.between(points, truth.apply(points))

    others = rng.normal(size=(20, 3))
    np.testing.assert_allclose(found.apply(others), truth.apply(others), atol=1e-12)
    np.testing.assert_allclose(found.inverse().apply(found.apply(others)), others, atol=1e-11)
    twice = truth.after(truth)
    np.testing.assert_allclose(twice.apply(others), truth.apply(truth.apply(others)), atol=1e-12)


def test_points_on_a_line_lay_nothing_straight() -> None:
    line = np.outer(np.arange(5.0), (1.0, 2.0, 3.0))

    with pytest.raises(InputError, match="lie on one line"):
        Similarity.between(line, line)
    with pytest.raises(InputError, match="at least 3"):
        Similarity.between(line[:2], line[:2])


@pytest.fixture(scope="module")
def laid(people: tuple[Head, ...]) -> LaidTemplate:
    """The template on the first of the people, begun by six exact points."""
    head = people[0]
    clicks = known_points({n: head.points[n] for n in CLICKS}, template_feature_points())
    surface = Surface(head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]])
    return lay_template(surface, anchors=clicks)


def test_feature_points_of_a_person_are_found_from_six_points(
    laid: LaidTemplate, people: tuple[Head, ...]
) -> None:
    head, found = people[0], laid.at(template_feature_points())
    skin = set(np.unique(head.mesh.triangles[head.mesh.groups["skin"]]).tolist())
    of_skin = [
        name
        for name, corners in zip(
            head.feature_points.names, head.feature_points.corners, strict=True
        )
        if int(corners[0]) in skin
    ]

    off = np.array([np.linalg.norm(found[n] - head.points[n]) for n in of_skin])

    assert off.mean() < 1.2, f"mean {off.mean():.2f} mm"  # 0.5 to 0.7 over ten people
    assert off.max() < 5.0
    assert laid.rms_mm < 0.5
    assert laid.covered > 0.9


def test_a_turned_person_is_seen_to_be_turned(laid: LaidTemplate, people: tuple[Head, ...]) -> None:
    head, turn = people[0], Rotation.from_euler("xyz", (6, -5, 4), degrees=True).as_matrix()
    clicks = {n: turn @ head.points[n] for n in CLICKS}
    surface = Surface(head.mesh.vertices @ turn.T, head.mesh.triangles[head.mesh.groups["skin"]])

    turned = lay_template(surface, anchors=known_points(clicks, template_feature_points()))

    between = turned.placed.rotation @ laid.placed.rotation.T @ turn.T
    assert np.degrees(np.arccos(min(1.0, (np.trace(between) - 1) / 2))) < 1.0


def test_the_model_spans_the_template_itself() -> None:
    model, template = face_model(), load_template()
    # all targets at zero is a point of the model's space
    zero = np.asarray(np.linalg.lstsq(model.targets.T, -model.mean_targets, rcond=None)[0], float)

    off = model.whole(zero)[model.rows] - template.vertices[model.rows]

    assert np.linalg.norm(off, axis=1).max() < 1.0
