"""Dots' true deviations from residuals, against the noise that was put in."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.datasets_synthetic.rigs import face_rig
from facewright.tracking.dot_weights import learn_weights
from facewright.tracking.triangulation import Points, Views, triangulate

Floats = NDArray[np.float64]


def seen(stated: Floats, true: Floats, seed: int = 0) -> tuple[Views, Floats, Floats, Points]:
    """Points seen by four cameras, (N, 4) deviations stated and true."""
    rng = np.random.default_rng(seed)
    cameras = list(face_rig(rng, distortion=False).cameras.values())
    views = Views.of(cameras)
    X = rng.uniform((-60, -80, -40), (60, 80, 40), size=(len(stated), 3))
    noise = rng.normal(size=(*stated.shape, 2)) * (true / views.focal_px)[..., None]
    xy = views.normalised(X) + noise
    return views, xy, X, triangulate(views, xy, stated, tolerance_px=np.inf)


@pytest.mark.parametrize(
    "true_of",
    [lambda s: s, lambda s: 3 * s, lambda s: np.hypot(s, 0.03), lambda s: np.minimum(s, 0.04)],
    ids=["as stated", "three times", "a floor", "overstated"],
)
def test_the_true_deviations_are_found(true_of: object) -> None:
    assert callable(true_of)
    rng = np.random.default_rng(1)
    stated = np.exp(rng.uniform(np.log(0.005), np.log(0.2), size=(6000, 4)))
    true = np.asarray(true_of(stated))
    views, xy, _, points = seen(stated, true)

    found = learn_weights(views, xy, stated, points).of(stated)

    ratio = found / true
    assert np.abs(np.log(np.quantile(ratio, (0.05, 0.5, 0.95)))).max() < 0.2


def test_points_come_nearer_and_their_covariances_true() -> None:
    """Stated: half of the dots doubtful. True: they are as good as the others."""
    rng = np.random.default_rng(2)
    stated = np.where(rng.random((4000, 4)) < 0.5, 0.02, 0.2)
    true = np.full(stated.shape, 0.05)
    views, xy, X, before = seen(stated, true)

    sd = learn_weights(views, xy, stated, before).of(stated)
    after = triangulate(views, xy, sd, tolerance_px=np.inf)

    def rms(points: Points) -> float:
        return float(np.sqrt(((points.positions - X) ** 2).sum(axis=1).mean()))

    best = triangulate(views, xy, true, tolerance_px=np.inf)
    assert rms(before) > 1.15 * rms(best)
    assert rms(after) < 1.02 * rms(best)
    error = after.positions - X
    squared = np.einsum("ni,nij,nj->n", error, after.information, error)
    assert squared.mean() == pytest.approx(3, rel=0.1)


def test_a_few_strays_do_not_spoil_it() -> None:
    rng = np.random.default_rng(3)
    stated = np.full((3000, 4), 0.03)
    true = np.where(rng.random(stated.shape) < 0.01, 1.0, 0.03)
    views, xy, _, points = seen(stated, true)

    found = learn_weights(views, xy, stated, points).of(np.array([0.03]))

    assert found[0] == pytest.approx(0.03, rel=0.25)


def test_with_few_points_or_two_views_what_is_stated_stays() -> None:
    stated = np.full((5, 4), 0.02)
    views, xy, _, points = seen(stated, stated)
    np.testing.assert_array_equal(learn_weights(views, xy, stated, points).of(stated), stated)

    two = np.full((500, 4), 0.02)
    two[:, 2:] = np.nan
    views, xy, _, points = seen(two, np.nan_to_num(two, nan=0.02))
    np.testing.assert_array_equal(learn_weights(views, xy, two, points).of(two), two)


def test_dots_without_noise_do_not_break_it() -> None:
    stated = np.full((500, 4), 0.02)
    views, xy, _, points = seen(stated, np.zeros(stated.shape))

    found = learn_weights(views, xy, stated, points).of(stated)

    assert (found > 0).all() and np.isfinite(found).all()
