"""Shells of a head are told apart by names, size and place."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.heads.head import Head
from facewright.heads.own_shells import (
    Landmarks,
    fitted_eye,
    meaning_of,
    sort_shells,
)


@pytest.mark.parametrize(
    ("label", "meaning"),
    [
        ("M_EyeLashes", "lashes"),
        ("Eyebrow_L", "other"),
        ("eye_L", "eye"),
        ("IrisLeft", "eye"),
        ("eyelid_upper", ""),
        ("GumsTongue", "tongue"),
        ("Zähne_oben", "teeth"),
        ("mesh.003", ""),
        ("舌", "tongue"),
    ],
)
def test_names_of_rigs_are_understood(label: str, meaning: str) -> None:
    assert meaning_of(label) == meaning


def expected_of(head: Head) -> Landmarks:
    p = head.points
    names = ("9.3", "5.1", "5.2", "4.3", "4.4", "8.1", "2.10", "5.3", "5.4")
    return Landmarks(
        {side: eye.centre for side, eye in head.eyes.items()},
        (p["2.2"] + p["2.3"]) / 2,
        np.stack([p["8.4"], p["8.3"]]),
        np.array([p[n] for n in names]),
    )


def test_shells_without_names_are_told_apart_on_thirty_people(people: tuple[Head, ...]) -> None:
    """Where each is expected a few millimetres beside its place, as the template's are."""
    rng = np.random.default_rng(3)
    for head in people:
        mesh, exact = head.mesh, expected_of(head)
        shift = rng.normal(0, 2.0, 3)
        expected = Landmarks(
            {side: centre + shift for side, centre in exact.eyes.items()},
            exact.mouth + shift,
            exact.corners + shift,
            exact.face + shift,
        )
        none = np.zeros(len(mesh.triangles), np.int32)

        found = sort_shells(mesh.vertices, mesh.triangles, ("",), none, expected)

        for part in ("skin", "eye_right", "eye_left", "teeth_upper", "teeth_lower", "tongue"):
            assert set(found[part].tolist()) == set(mesh.groups[part].tolist()), (head.name, part)


def test_a_high_tongue_is_no_lining_of_the_mouth(people: tuple[Head, ...]) -> None:
    """Where the mouth is expected in the middle of the tongue's height."""
    for head in people:
        exact = expected_of(head)
        tongue = head.mesh.vertices[head.part_vertices("tongue"), 1]
        mouth = exact.mouth.copy()
        mouth[1] = (tongue.min() + tongue.max()) / 2
        expected = Landmarks(exact.eyes, mouth, exact.corners, exact.face)
        none = np.zeros(len(head.mesh.triangles), np.int32)

        found = sort_shells(head.mesh.vertices, head.mesh.triangles, ("",), none, expected)

        wanted = head.mesh.groups["tongue"].tolist()
        assert set(found["tongue"].tolist()) == set(wanted), head.name


def test_the_ball_of_an_eye_is_found_though_the_cornea_bulges(average_head: Head) -> None:
    mesh = average_head.mesh

    found = fitted_eye(mesh.vertices, mesh.triangles, mesh.groups["eye_left"])

    truth = average_head.eyes["left"]
    assert found is not None
    assert abs(found.radius - truth.radius) < 0.5
    assert np.linalg.norm(found.centre - truth.centre) < 1.0
