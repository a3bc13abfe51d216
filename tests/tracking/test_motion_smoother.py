"""Smoothed curves against truth, dense least squares, and their own promises."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.tracking.motion_smoother import smooth_curves

Floats = NDArray[np.float64]
RATE_HZ = 60.0


def drifting(rng: np.random.Generator, n: int, k: int, drift: float) -> Floats:
    """Curves whose velocity is a random walk, exactly as the model has it; interval 1."""
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    L = np.linalg.cholesky(drift * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))
    state = np.zeros((2, k))
    found = np.empty((n, k))
    for i in range(n):
        found[i] = state[0]
        state = F @ state + L @ rng.normal(size=(2, k))
    return found


@pytest.mark.parametrize("drift", [0.001, 0.03])
def test_the_stated_error_and_noise_are_true(drift: float) -> None:
    rng = np.random.default_rng(4)
    truth = drifting(rng, 1500, 3, drift)
    sd = 0.7
    seen = truth + rng.normal(0, sd, size=truth.shape)
    t = np.arange(len(truth)) / RATE_HZ

    found = smooth_curves(t, seen, np.ones_like(seen))

    error = np.sqrt(((found.values - truth) ** 2).mean())
    assert error < 0.75 * sd
    assert np.sqrt(found.variances.mean()) == pytest.approx(error, rel=0.1)
    assert np.sqrt(found.noise) == pytest.approx(sd, rel=0.05)


def test_the_smoother_is_the_dense_gaussian_solution() -> None:
    """The same model as one big linear system, at the ratio that was chosen."""
    rng = np.random.default_rng(5)
    n = 60
    seen = drifting(rng, n, 1, 0.05) + rng.normal(size=(n, 1))
    t = np.arange(n) / RATE_HZ

    found = smooth_curves(t, seen, np.ones_like(seen))

    q = found.ratio
    a = np.arange(1, n + 1)[:, None]
    lo, hi = np.minimum(a, a.T), np.maximum(a, a.T)
    prior = q * (lo**2 * (3 * hi - lo) / 6)  # integrated random walk, Wahba 1978
    basis = np.concatenate([np.ones((n, 1)), a], axis=1)
    K = prior + 1e8 * basis @ basis.T
    expected = K @ np.linalg.solve(K + np.eye(n), seen - seen.mean()) + seen.mean()
    np.testing.assert_allclose(found.values, expected, atol=2e-3)


def test_exact_motion_is_left_as_it_is() -> None:
    t = np.arange(300) / RATE_HZ
    curve = np.stack([np.sin(3 * t), np.cos(7 * t)], axis=1)

    found = smooth_curves(t, curve, np.ones_like(curve))

    np.testing.assert_allclose(found.values, curve, atol=1e-9)


def test_what_is_jerkier_than_the_most_noise_is_motion() -> None:
    jerky = np.random.default_rng(0).normal(size=(200, 2))
    t = np.arange(200) / RATE_HZ

    free = smooth_curves(t, jerky, np.full_like(jerky, 1e-6))
    bound = smooth_curves(t, jerky, np.full_like(jerky, 1e-6), most_noise=1.0)

    assert np.abs(free.values).max() < 0.5 * np.abs(jerky).max()
    np.testing.assert_allclose(bound.values, jerky, atol=1e-3)


def test_gaps_are_passed_over_with_growing_doubt() -> None:
    rng = np.random.default_rng(6)
    truth = drifting(rng, 400, 2, 0.002)
    seen = truth + rng.normal(0, 0.5, size=truth.shape)
    seen[200:212] = np.nan
    seen[:3] = np.nan
    t = np.arange(400) / RATE_HZ

    found = smooth_curves(t, seen, np.ones_like(seen))

    assert np.isnan(found.values[:3]).all()
    assert not np.isnan(found.values[3:]).any()
    assert found.variances[205:207].mean() > 2 * found.variances[150:190].mean()
    assert np.abs(found.values - truth)[200:212].max() < 4 * np.sqrt(found.variances[200:212].max())


def test_a_few_samples_are_left_as_they_are() -> None:
    curve = np.random.default_rng(0).normal(size=(11, 2))

    found = smooth_curves(np.arange(11) / RATE_HZ, curve, np.ones_like(curve))

    np.testing.assert_array_equal(found.values, curve)
