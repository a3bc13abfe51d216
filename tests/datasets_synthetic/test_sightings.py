"""Dots without pictures."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.datasets_synthetic.sightings import (
    MarkerMotion,
    Trouble,
    _distance,
    marker_motion,
    sight_markers,
)
from facewright.datasets_synthetic.takes import Take, take_truth


@pytest.fixture(scope="module")
def motion(short_take: Take) -> MarkerMotion:
    return marker_motion(short_take)


def test_markers_are_where_the_takes_truth_has_them(short_take: Take, motion: MarkerMotion) -> None:
    truth = take_truth(short_take)
    np.testing.assert_allclose(motion.markers, truth.marker_positions, atol=1e-9)
    np.testing.assert_allclose(motion.head_quaternion, truth.head_quaternion, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(motion.normals, axis=2), 1)


def test_without_trouble_dots_are_exact_projections(short_take: Take, motion: MarkerMotion) -> None:
    quiet = Trouble(0.0, 0.0, 0.0, 0, 0.0, lights=False)

    found = sight_markers(short_take, motion, quiet, rng=np.random.default_rng(0))

    for frame in (0, len(motion.time_s) - 1):
        for c, name in enumerate(short_take.rig):
            who, xy = found.owners[frame][c], found.centres[frame][c]
            assert len(np.unique(who)) == len(who) > 10
            expected = short_take.rig[name].project(motion.markers[frame, who])
            np.testing.assert_allclose(xy, expected, atol=1e-9)
    assert (found.n_seen()[0] >= 2).mean() > 0.85


def test_troubles_have_the_strength_that_was_asked_for(
    short_take: Take, motion: MarkerMotion
) -> None:
    def seen(**changes: float) -> int:
        trouble = Trouble(**{"dropped": 0.0, "n_passes": 0, "lights": False, **changes})  # type: ignore[arg-type]
        found = sight_markers(short_take, motion, trouble, rng=np.random.default_rng(1))
        return sum(int((o >= 0).sum()) for frame in found.owners for o in frame)

    whole = seen()
    assert seen(dropped=0.2) == pytest.approx(0.8 * whole, rel=0.04)
    assert seen(lost=0.2) == pytest.approx(0.8 * whole, rel=0.06)
    lit = sight_markers(
        short_take, motion, Trouble(0.0, 0.0, 0.0, 0, 2.0, True), rng=np.random.default_rng(3)
    )
    strays = np.mean([(o < 0).sum() for frame in lit.owners for o in frame])
    assert 2.5 < strays < 4.5, "two on average, and two lights where they are in the picture"


def test_a_hand_hides_a_still_face_for_a_while(short_take: Take, motion: MarkerMotion) -> None:
    n = 150
    still = MarkerMotion(
        np.arange(n) / 60.0,
        *(
            np.repeat(getattr(motion, name)[:1], n, axis=0)
            for name in ("markers", "normals", "head_quaternion", "head_translation")
        ),
    )
    passing = Trouble(0.0, 0.0, 0.0, 1, 0.0, lights=False)

    found = sight_markers(short_take, still, passing, rng=np.random.default_rng(2)).n_seen()

    assert (found[0] == found[-1]).all()
    hidden = (found < found[0]).any(axis=1)
    first, last = np.flatnonzero(hidden)[[0, -1]]
    assert 10 < last - first < 90
    assert first >= 24, "it comes after 0.4 s"
    assert ((found == 0) & (found[0] >= 2)).any()


def test_distances_of_segments_are_those_of_dense_samples() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        points, eye, a, b = rng.normal(0, 50, (5, 3)), *rng.normal(0, 50, (3, 3))
        u = np.linspace(0, 1, 400)
        ray = points[:, None] + u[:, None] * (eye - points)[:, None]
        bar = a + u[:, None] * (b - a)
        dense = np.linalg.norm(ray[:, :, None] - bar[None, None], axis=3).min(axis=(1, 2))
        np.testing.assert_allclose(_distance(points, eye, a, b), dense, atol=0.4)
