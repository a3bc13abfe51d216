"""Feature points, normals and spheres, on faces that move by a model of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.markers import MarkerSet
from facewright.core.mesh import vertex_normals
from facewright.core.mpeg4 import fap_by_name, fap_table
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from facewright.heads.head import Head
from facewright.heads.marker_sets import glue_markers, ready_marker_set
from facewright.tracking.performance import analyse
from facewright.tracking.skin_points import (
    LIP_APPROXIMATIONS,
    normal_rules,
    point_rules,
    skin_displacements,
)

Floats = NDArray[np.float64]
RATE_HZ = 60.0


@pytest.fixture(scope="module")
def marker_set() -> MarkerSet:
    return ready_marker_set()


@pytest.fixture(scope="module")
def faces(people: tuple[Head, ...]) -> list[tuple[Head, Floats]]:
    """Three people at rest and in every expression and viseme: vertices (P, V, 3)."""
    found = []
    for head in people[:3]:
        motion = FaceMotion(head)
        poses = [expression_weights(name) for name in EXPRESSIONS]
        poses += [viseme_weights(name) for name in VISEMES[1:]]
        rows = [np.zeros(len(head.shape_names))]
        rows += [np.array([pose.get(n, 0.0) for n in head.shape_names]) for pose in poses]
        found.append((head, np.stack([motion.vertices(w) for w in rows])))
    return found


def marker_moves(head: Head, vertices: Floats, marker_set: MarkerSet) -> Floats:
    p = glue_markers(head, marker_set).at(vertices)
    return np.asarray(p - p[0])


def point_moves(head: Head, vertices: Floats, point: str) -> Floats:
    p = head.feature_points.at(vertices)[:, head.feature_points.index(point)]
    return np.asarray(p - p[0])


def rms(values: Floats) -> float:
    return float(np.sqrt((values**2).sum(axis=-1).mean()))


def test_inner_lips_are_nearer_than_the_outer_ones_are(
    faces: list[tuple[Head, Floats]], marker_set: MarkerSet
) -> None:
    rules = point_rules(marker_set)
    off: dict[str, list[list[float]]] = {fp: [] for fp in LIP_APPROXIMATIONS}
    for head, vertices in faces:
        moved = marker_moves(head, vertices, marker_set)
        by_label = {label: moved[:, m] for m, label in enumerate(marker_set.labels)}
        for fp, rule in ((fp, rules[fp]) for fp in LIP_APPROXIMATIONS):
            true = point_moves(head, vertices, fp)
            off[fp].append([rms(rule.apply(by_label) - true), rms(by_label[rule.stand_in] - true)])

    for fp, pairs in off.items():
        ours, outer = np.mean(pairs, axis=0)
        assert ours < 0.6 * outer, f"{fp}: {ours:.2f} mm, outer lip {outer:.2f} mm"


def test_corners_are_nearer_than_markers_beside_them(
    faces: list[tuple[Head, Floats]], marker_set: MarkerSet
) -> None:
    rules = point_rules(marker_set)
    ours, alone = [], []
    for head, vertices in faces:
        moved = marker_moves(head, vertices, marker_set)
        by_label = {label: moved[:, m] for m, label in enumerate(marker_set.labels)}
        for fp in ("8.3", "8.4"):
            true = point_moves(head, vertices, fp)
            ours.append(rms(rules[fp].apply(by_label) - true))
            alone.append(rms(by_label[rules[fp].stand_in] - true))

    assert np.mean(ours) < 0.6 * np.mean(alone)


def test_lids_take_their_markers_as_they_are(marker_set: MarkerSet) -> None:
    for fp in ("3.1", "3.2", "3.3", "3.4"):
        assert point_rules(marker_set)[fp].labels == ()


def test_a_marker_that_is_missing_does_not_unset_its_neighbours(marker_set: MarkerSet) -> None:
    rule = point_rules(marker_set)["8.3"]
    moved = {label: np.ones((4, 3)) for label in rule.labels}
    other = next(label for label in rule.labels if label != rule.stand_in)
    moved[other] = np.full((4, 3), np.nan)

    assert not np.isnan(rule.apply(moved)).any()

    moved[rule.stand_in] = np.full((4, 3), np.nan)
    assert np.isnan(rule.apply(moved)).all()


def takes_of_jaw(marker_set: MarkerSet, head: Head, *, lips_part: bool) -> Trajectories:
    """The jaw drops by 12 mm; the lower lip's markers follow or are held."""
    rest = glue_markers(head, marker_set).at(head.mesh.vertices)
    p = np.tile(rest, (60, 1, 1))
    drop = 12.0 * np.clip((np.arange(60) - 20) / 30, 0, 1)
    for m, marker in enumerate(marker_set.markers):
        follows = marker.feature_point in ("2.1", "2.10")
        if lips_part:
            follows |= marker.feature_point in ("8.2", "8.7", "8.8")
        if follows:
            p[:, m, 1] -= drop
    return Trajectories(np.arange(60) / RATE_HZ, marker_set.labels, p)


def test_a_jaw_lowered_behind_held_lips_moves_fap_3_alone(
    marker_set: MarkerSet, people: tuple[Head, ...]
) -> None:
    head = people[0]
    with_units = replace(marker_set, fapu=head.fapu)

    held = analyse(takes_of_jaw(marker_set, head, lips_part=False), with_units).faps
    parted = analyse(takes_of_jaw(marker_set, head, lips_part=True), with_units).faps

    open_jaw = fap_by_name()["open_jaw"]
    full = 12.0 / head.fapu.unit(open_jaw)
    assert held["open_jaw"][-1] == pytest.approx(full, rel=1e-3)
    assert parted["open_jaw"][-1] == pytest.approx(full, rel=1e-3)
    for fap in fap_table()[3:13]:  # 4 to 13
        used = 3.0 / head.fapu.unit(fap)  # no FAP's used range counts as less than 3 mm
        assert np.abs(held[fap.name]).max() <= 0.01 * used, fap.name
    for number in (5, 10, 11):  # the lower lip, inner
        fap = fap_table()[number - 1]
        assert parted[fap.name][-1] == pytest.approx(-12.0 / head.fapu.unit(fap), rel=0.15)
    for number in (52, 57, 58):  # and outer, which markers show
        fap = fap_table()[number - 1]
        assert parted[fap.name][-1] == pytest.approx(-12.0 / head.fapu.unit(fap), rel=1e-3)


def test_the_normals_are_the_skins(faces: list[tuple[Head, Floats]], marker_set: MarkerSet) -> None:
    """Angles from the mesh's own normals, turned as much as the rules say."""
    rules = normal_rules(marker_set)
    off, still = [], []
    for head, vertices in faces:
        glue = glue_markers(head, marker_set)
        skin = head.mesh.triangles[head.mesh.groups["skin"]]
        true = np.stack([glue.at(vertex_normals(v, skin)) for v in vertices])
        true /= np.linalg.norm(true, axis=2, keepdims=True)
        found = rules.at(marker_moves(head, vertices, marker_set))
        # how normals turn, not where a person's skin looks at rest
        off.append(rms((found - found[0]) - (true - true[0])))
        still.append(rms(true - true[0]))

    assert np.mean(off) < 0.55 * np.mean(still)


def test_spheres_move_as_the_skin_under_them(
    faces: list[tuple[Head, Floats]], marker_set: MarkerSet
) -> None:
    standoff = 3.0
    ours, centres = [], []
    for head, vertices in faces:
        glue = glue_markers(head, marker_set)
        skin = head.mesh.triangles[head.mesh.groups["skin"]]
        n = np.stack([glue.at(vertex_normals(v, skin)) for v in vertices])
        n /= np.linalg.norm(n, axis=2, keepdims=True)
        on_skin = marker_moves(head, vertices, marker_set)
        moved = on_skin + standoff * (n - n[0])

        found = skin_displacements(moved, replace(marker_set, standoff_mm=standoff))

        ours.append(rms(found - on_skin))
        centres.append(rms(moved - on_skin))

    assert np.mean(centres) > 0.2  # mm: it matters
    assert np.mean(ours) < 0.55 * np.mean(centres)


def test_dots_are_left_as_they_are(marker_set: MarkerSet) -> None:
    moved = np.random.default_rng(0).normal(size=(5, len(marker_set.labels), 3))

    np.testing.assert_array_equal(skin_displacements(moved, marker_set), moved)
