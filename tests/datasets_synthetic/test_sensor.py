"""A sensor's numbers: the curve, and noise of the right size that nothing ties together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from facewright.datasets_synthetic.optics import NOISELESS, Sensor
from facewright.datasets_synthetic.sensor import develop

SHAPE = (400, 500)


def flat(light: float) -> np.ndarray:
    return np.full(SHAPE, light, np.float32)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize(("gain", "black"), [(1.0, 0.0), (2.0, 16.0)])
def test_without_noise_numbers_follow_the_curve(gamma: float, gain: float, black: float) -> None:
    light = np.linspace(0, 1, 200_000, dtype=np.float32).reshape(SHAPE)
    sensor = Sensor(gain=gain, gamma=gamma, black_level=black, full_well_e=np.inf, read_noise_e=0.0)

    level = develop(light, sensor, np.random.default_rng(0))

    exact = black + (255 - black) * np.minimum(gain * light.astype(float), 1) ** (1 / gamma)
    steep = light > 1e-4  # nearer to black a table's step is more than a level
    assert np.abs(level - exact)[steep].max() < (0.501 if gamma == 1 else 0.6)
    assert level.dtype == np.uint8
    assert level[0, 0] == black


@pytest.mark.parametrize("level", [7, 46, 128, 205])
def test_the_variance_is_that_of_shot_and_read_noise(level: int) -> None:
    """In grey levels: 0.6² of read and 0.15² · level of shot noise, and 1/12 of rounding."""
    sensor = Sensor(full_well_e=11333.0, read_noise_e=26.7)

    got = develop(flat(level / 255), sensor, np.random.default_rng(level)).astype(float)

    expected = 0.6**2 + 0.15**2 * level + 1 / 12
    assert got.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / got.size) + 0.01)
    assert got.mean() == pytest.approx(level, abs=5 * np.sqrt(expected / got.size) + 0.01)


def test_noise_comes_before_the_power() -> None:
    """The slope of the curve scales it: 255/γ · s^(1/γ - 1) levels per unit of light."""
    sensor = Sensor(full_well_e=20000.0, read_noise_e=10.0, gamma=2.2)

    for s in (0.1, 0.4, 0.8):
        got = develop(flat(s), sensor, np.random.default_rng(1)).astype(float)
        slope = 255 / 2.2 * s ** (1 / 2.2 - 1)
        expected = slope**2 * (s / 20000 + (10 / 20000) ** 2) + 1 / 12
        assert got.var() == pytest.approx(expected, rel=0.04)


def test_noise_is_normal() -> None:
    sensor = Sensor(full_well_e=300.0, read_noise_e=0.0)

    got = develop(flat(0.5), sensor, np.random.default_rng(3)).astype(float)

    sd = np.sqrt((255**2) * 0.5 / 300)
    z = (got - 127.5) / np.sqrt(sd**2 + 1 / 12)
    assert abs(stats.skew(z.ravel())) < 0.03
    assert abs(stats.kurtosis(z.ravel())) < 0.06
    for bound in (1.0, 2.0, 3.0):
        step = np.floor(127.5 + bound * sd) + 0.5  # numbers above this are above it unrounded
        expected = stats.norm.sf((step - 127.5) / sd)
        assert (got > step).mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / got.size))


@pytest.mark.parametrize("lag", [(0, 1), (0, 2), (0, 3), (0, 4), (1, 0), (1, 1), (2, 0)])
def test_pixels_do_not_know_of_each_other(lag: tuple[int, int]) -> None:
    sensor = Sensor(full_well_e=2000.0, read_noise_e=30.0)
    found = []
    for seed in range(5):
        got = develop(flat(0.4), sensor, np.random.default_rng(seed)).astype(float)
        a = got[lag[0] :, lag[1] :]
        b = got[: SHAPE[0] - lag[0], : SHAPE[1] - lag[1]]
        found.append(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    assert abs(np.mean(found)) < 4 / np.sqrt(5 * 200_000)


def test_frames_do_not_know_of_each_other_and_seeds_repeat_them() -> None:
    sensor = Sensor(full_well_e=2000.0, read_noise_e=30.0)
    rng = np.random.default_rng(5)
    a, b = (develop(flat(0.4), sensor, rng) for _ in range(2))

    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)
    again = develop(flat(0.4), sensor, np.random.default_rng(5))
    np.testing.assert_array_equal(a, again)


def test_colours_have_noise_of_their_own() -> None:
    light = np.full((200, 300, 3), 0.5, np.float32)

    got = develop(light, Sensor(full_well_e=500.0), np.random.default_rng(2)).astype(float)

    assert got.shape == (200, 300, 3)
    correlation = np.corrcoef(got.reshape(-1, 3).T)
    assert np.abs(correlation - np.eye(3)).max() < 0.02


def test_what_saturates_stays_saturated() -> None:
    sensor = Sensor(full_well_e=2000.0, read_noise_e=10.0)

    assert (develop(flat(1.6), sensor, np.random.default_rng(0)) == 255).all()
    assert develop(flat(0.0), sensor, np.random.default_rng(0)).max() <= 8
    assert (develop(flat(3.0), NOISELESS, np.random.default_rng(0)) == 255).all()
