from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from facewright.heads import bounded_paths
from facewright.heads.bounded_paths import second_differences, solve_paths

Floats = NDArray[np.float64]


def problem(seed: int, n_frames: int, n: int = 5) -> tuple[Floats, Floats, Floats]:
    """A, targets d (T, rows), upper bounds: correlated columns, solutions that meet bounds."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(8, n)) + rng.normal(size=(8, 1))
    x = np.cumsum(rng.normal(0, 0.3, size=(n_frames, n)), axis=0) + 0.4
    upper = np.where(rng.random((n_frames, n)) < 0.1, 0.0, rng.uniform(0.5, 1.5, (n_frames, n)))
    return A, x @ A.T + rng.normal(0, 0.3, (n_frames, 8)), upper


def dense_minimum(A: Floats, d: Floats, upper: Floats, D: Floats, smooth: float) -> Floats:
    """The same by SciPy, over all frames at once."""
    T, n = len(d), A.shape[1]
    rows = np.zeros((len(D), T))
    for i, row in enumerate(D):
        rows[i, i : i + 3] = row
    whole = np.vstack([np.kron(np.eye(T), A), np.sqrt(smooth) * np.kron(rows, np.eye(n))])
    right = np.concatenate([d.ravel(), np.zeros(len(D) * n)])
    found = lsq_linear(
        whole, right, (0, np.maximum(upper.ravel(), 1e-14)), method="bvls", tol=1e-14
    )
    return np.asarray(found.x.reshape(T, n))


@pytest.mark.parametrize("smooth", [0.0, 0.5, 30.0])
@pytest.mark.parametrize("n_frames", [1, 2, 3, 12])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_minimum_is_scipys(seed: int, n_frames: int, smooth: float) -> None:
    A, d, upper = problem(seed, n_frames)
    time_s = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.04, n_frames))
    D = second_differences(time_s)

    found = solve_paths(A.T @ A, d @ A, upper, D, smooth)

    assert found.converged
    np.testing.assert_allclose(found.values, dense_minimum(A, d, upper, D, smooth), atol=1e-7)


def test_windows_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    A, d, upper = problem(4, 150)
    D = second_differences(np.arange(150) / 60)
    whole = solve_paths(A.T @ A, d @ A, upper, D, 1.0)
    monkeypatch.setattr(bounded_paths, "WINDOW", 50)

    found = solve_paths(A.T @ A, d @ A, upper, D, 1.0)

    np.testing.assert_allclose(found.values, whole.values, atol=1e-6)


def test_second_differences_are_exact_for_parabolas() -> None:
    t = np.array([0.0, 0.1, 0.15, 0.3, 0.35, 0.5])
    D = second_differences(t)
    windows = np.lib.stride_tricks.sliding_window_view
    line, parabola = 3 - 2 * t, t**2

    np.testing.assert_allclose((D * windows(line, 3)).sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose((D * windows(parabola, 3)).sum(axis=1), 2 * 0.1**2, rtol=1e-9)
    np.testing.assert_allclose(second_differences(np.arange(5) / 60), [[1, -2, 1]] * 3)


def test_smoothness_has_no_lag() -> None:
    t = np.arange(61) / 60
    pulse = np.exp(-(((t - 0.5) / 0.05) ** 2))[:, None]
    found = solve_paths(np.eye(1), pulse, np.ones_like(pulse), second_differences(t), 5.0).values

    np.testing.assert_allclose(found, found[::-1], atol=1e-12)
    assert found.argmax() == 30
    assert 0.5 < found.max() < 0.99


def test_bounds_hold_exactly() -> None:
    A, d, upper = problem(7, 40)
    found = solve_paths(A.T @ A, d @ A, upper, second_differences(np.arange(40) / 60), 0.3).values

    assert (found >= 0).all() and (found <= upper).all()
    assert (found[upper == 0] == 0).all()
    assert (found == 0).sum() > (upper == 0).sum()
    assert ((found == upper) & (upper > 0)).any()


def test_wrong_calls_are_refused() -> None:
    eye, flat = np.eye(2), np.zeros((4, 2))
    D = second_differences(np.arange(4.0))
    with pytest.raises(ValueError, match="upper must have shape"):
        solve_paths(eye, flat, np.ones((3, 2)), D, 1.0)
    with pytest.raises(ValueError, match="finite"):
        solve_paths(eye, flat * np.nan, flat, D, 1.0)
    with pytest.raises(ValueError, match="negative"):
        solve_paths(eye, flat, flat - 1, D, 1.0)
