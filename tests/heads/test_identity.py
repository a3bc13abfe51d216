"""People: lips, eyes and measures of random adults."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.heads.catalogue import BUILT_IN, built_in_identity
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity, target_weights
from facewright.heads.raycast import RayScene


@pytest.mark.parametrize("who", range(10))
def test_lips_are_sealed_at_rest(people: tuple[Head, ...], who: int) -> None:
    """No ray from the front reaches into the mouth between the corners of the lips."""
    head = people[who]
    p = head.points
    scene = RayScene(head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]])
    x = np.linspace(p["8.4"][0] + 5, p["8.3"][0] - 5, 60)
    seam_y = (p["2.2"][1] + p["2.3"][1]) / 2
    y = seam_y + np.arange(-5, 5, 0.1)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    origins = np.concatenate([grid, np.full((*grid.shape[:2], 1), 300.0)], axis=-1).reshape(-1, 3)

    t, *_ = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(origins), 1)))

    z = (300.0 - t).reshape(grid.shape[:2])
    lips = np.median(z, axis=1)
    assert (lips - z.min(axis=1)).max() < 9.0  # the seam is a groove of some mm, not a slit


def test_the_seal_is_needed(people: tuple[Head, ...], average_head: Head) -> None:
    """The rays of the test above do find an open mouth."""
    opened = average_head.shaped({"jawOpen": 0.15})
    scene = RayScene(opened, average_head.mesh.triangles[average_head.mesh.groups["skin"]])
    y = average_head.points["2.3"][1] + np.arange(-6, 4, 0.1)
    origins = np.stack([np.zeros_like(y), y, np.full_like(y, 300.0)], axis=1)

    t, *_ = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(y), 1)))

    assert (300.0 - t).min() < np.median(300.0 - t) - 9.0


def test_eyes_are_spheres_inside_the_head_with_the_origin_between(
    people: tuple[Head, ...],
) -> None:
    for head in people:
        right, left = head.eyes["right"], head.eyes["left"]
        np.testing.assert_allclose(right.centre + left.centre, 0, atol=1e-9)
        assert 25 < left.centre[0] < 36
        skin = head.part_vertices("skin")
        for side, eye in head.eyes.items():
            p = head.mesh.vertices[head.part_vertices(f"eye_{side}")]
            distance = np.linalg.norm(p - eye.centre, axis=1)
            assert 11 < eye.radius < 19
            assert np.abs(np.median(distance) - eye.radius) < 1e-9
            assert np.ptp(distance) < 0.25 * eye.radius
            # skin before and behind it
            near = head.mesh.vertices[skin]
            column = near[np.linalg.norm(near[:, :2] - eye.centre[:2], axis=1) < 25]
            assert column[:, 2].max() > eye.centre[2] > column[:, 2].min()
            pupil = head.points["3.5" if side == "left" else "3.6"]
            gaze = (pupil - eye.centre) / np.linalg.norm(pupil - eye.centre)
            assert gaze[2] > 0.98  # looks ahead


def test_measures_of_thirty_adults_are_human(people: tuple[Head, ...]) -> None:
    """Ranges of adults' faces: palpebral fissure, pupils, nose, philtrum, mouth."""
    ranges = {"IRISD": (5, 14), "ES": (45, 75), "ENS": (35, 70), "MNS": (8, 28), "MW": (30, 65)}
    measured = {k: np.array([head.fapu.as_dict()[k] for head in people]) for k in ranges}

    for unit, (low, high) in ranges.items():
        assert low < measured[unit].min(), unit
        assert measured[unit].max() < high, unit
        assert np.std(measured[unit]) > 0.02 * np.mean(measured[unit]), f"{unit}: all alike"


def test_people_stay_within_reach_of_the_average(
    people: tuple[Head, ...], average_head: Head
) -> None:
    skin = average_head.part_vertices("skin")
    for head in people:
        d = np.linalg.norm(head.mesh.vertices - average_head.mesh.vertices, axis=1)[skin]
        assert np.isfinite(head.mesh.vertices).all()
        assert 1.0 < np.sqrt((d**2).mean()) < 25.0


def test_the_same_seed_makes_the_same_person() -> None:
    one, other, third = (random_identity(np.random.default_rng(s), "x") for s in (5, 5, 6))

    assert one == other
    assert one != third


def test_left_and_right_differ_a_little(people: tuple[Head, ...]) -> None:
    pairs = (("4.3", "4.4"), ("3.1", "3.2"), ("5.3", "5.4"), ("10.1", "10.2"))
    differences = [
        max(np.linalg.norm(h.points[a] * (-1, 1, 1) - h.points[b]) for a, b in pairs)
        for h in people
    ]

    assert 0.2 < np.median(differences) < 5.0


def test_phenotype_weights_are_shares() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        identity = random_identity(rng)
        weights = target_weights(identity)
        universal = [w for n, w in weights.items() if n.startswith("universal-")]
        ancestry = [
            w for n, w in weights.items() if n.split("-")[0] in ("african", "asian", "caucasian")
        ]
        assert sum(universal) == pytest.approx(1)
        assert sum(ancestry) == pytest.approx(1)
        assert min(weights.values()) >= 0


def test_ancestry_is_taken_in_proportion() -> None:
    one = target_weights(Identity("a", ancestry={"asian": 1, "african": 3}))
    other = target_weights(Identity("a", ancestry={"asian": 0.25, "african": 0.75}))

    assert one == pytest.approx(other)
    assert one["african-male-young"] == pytest.approx(0.75 * 0.5)


@pytest.mark.parametrize("ancestry", [{}, {"asian": 0.0}, {"asian": 2.0, "african": -1.0}])
def test_impossible_ancestries_are_refused(ancestry: dict[str, float]) -> None:
    with pytest.raises(InputError, match="someone odd: ancestry shares"):
        target_weights(Identity("someone odd", ancestry=ancestry))


def test_an_unknown_target_is_refused() -> None:
    with pytest.raises(InputError, match="identity x: unknown target nose-of-clay"):
        make_head(Identity("x", local={"nose-of-clay": 1.0}))


def test_an_unknown_ancestry_is_refused() -> None:
    with pytest.raises(InputError, match="unknown target martian"):
        make_head(Identity("x", ancestry={"martian": 1.0}))


def test_shapes_of_a_head_add_up(average_head: Head) -> None:
    both = average_head.shaped({"jawOpen": 0.4, "mouthSmileLeft": 0.7})
    jaw = average_head.shaped({"jawOpen": 0.4})
    smile = average_head.shaped({"mouthSmileLeft": 0.7})

    np.testing.assert_allclose(both, jaw + smile - average_head.mesh.vertices, atol=1e-9)
    with pytest.raises(InputError, match="head average has no shape wink"):
        average_head.shaped({"wink": 1.0})


def test_built_in_heads_have_names_and_an_unknown_one_is_told_them() -> None:
    identities = [built_in_identity(name) for name in BUILT_IN]

    assert [i.name for i in identities] == list(BUILT_IN)
    with pytest.raises(InputError, match="no built-in head bob; there are average, ruth"):
        built_in_identity("bob")
