"""The noise of places from their jitter, against noise that was put in."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.tracking.spot_noise import place_noise

Floats = NDArray[np.float64]


def noisy_paths(scale: float, correlation: float, seed: int) -> tuple[Floats, Floats]:
    """240 frames of 30 dots that move by some pixels at up to 2 Hz (60 frames/s), and their sd."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(240)[:, None, None] / 60
    phase, rate_hz = rng.uniform(0, 2 * np.pi, (1, 30, 2)), rng.uniform(0.2, 2, (1, 30, 2))
    true = 200 + rng.uniform(2, 8, (1, 30, 2)) * np.sin(2 * np.pi * rate_hz * time_s + phase)
    sd = rng.uniform(0.01, 0.03, 30) * np.ones((240, 30))
    error = rng.normal(size=true.shape)
    for t in range(1, len(error)):  # an autoregression of variance 1
        error[t] = correlation * error[t - 1] + np.sqrt(1 - correlation**2) * error[t]
    return true + scale * sd[..., None] * error, sd


@pytest.mark.parametrize("scale", [1.0, 4.0])
@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.55])
def test_size_and_correlation_are_those_put_in(scale: float, correlation: float) -> None:
    paths, sd = noisy_paths(scale, correlation, 5)

    found = place_noise(paths, sd)

    # up to 9 % are added for errors that last longer than windows, which these have not
    assert 0.95 * scale < found.scale < 1.16 * scale
    assert found.correlation == pytest.approx(correlation, abs=0.08)


def test_gaps_and_jerks_do_not_spoil_it() -> None:
    rng = np.random.default_rng(1)
    paths, sd = noisy_paths(2.0, 0.0, 6)
    paths[rng.random(paths.shape[:2]) < 0.01] = np.nan
    for dot in range(0, 30, 6):
        paths[100:, dot] += 5.0  # jumps: another marker took its place

    found = place_noise(paths, sd)

    assert 1.9 < found.scale < 2.3


def test_too_little_to_tell_is_refused() -> None:
    paths, sd = noisy_paths(1.0, 0.0, 7)

    with pytest.raises(InputError, match="20 stretches of 15 frames"):
        place_noise(paths[:14], sd[:14])
    with pytest.raises(ValueError, match=r"\(T, N, 2\)"):
        place_noise(paths[..., 0], sd)
