"""Low-pass filters against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.tracking.filters import OneEuroFilter, zero_phase, zero_phase_figures

RATE_HZ, CUTOFF_HZ = 120.0, 8.0


@pytest.mark.parametrize("frequency_hz", [0.5, 4.0, 8.0, 20.0])
def test_the_gain_is_that_of_a_butterworth_filter_twice_and_nothing_is_late(
    frequency_hz: float,
) -> None:
    t = np.arange(1200) / RATE_HZ
    wave = np.sin(2 * np.pi * frequency_hz * t)

    found = zero_phase(wave, RATE_HZ, CUTOFF_HZ)

    warped = np.tan(np.pi * frequency_hz / RATE_HZ) / np.tan(np.pi * CUTOFF_HZ / RATE_HZ)
    middle = slice(300, -300)  # the ends feel the end
    np.testing.assert_allclose(found[middle], wave[middle] / (1 + warped**4), atol=1e-4)


def test_the_stated_noise_is_what_is_left_of_noise() -> None:
    noise = np.random.default_rng(0).normal(size=200_000)

    found = zero_phase(noise, 60.0, 8.0)

    figures = zero_phase_figures(60.0, 8.0)
    assert figures.lag_s == 0
    assert found.std() == pytest.approx(figures.noise_gain, rel=0.01)


def test_runs_between_unknown_values_are_filtered_by_themselves() -> None:
    v = np.random.default_rng(1).normal(size=(100, 2))
    v[40:43, 0] = np.nan
    v[95:97, 0] = np.nan

    found = zero_phase(v, RATE_HZ, CUTOFF_HZ)

    np.testing.assert_array_equal(np.isnan(found), np.isnan(v))
    np.testing.assert_allclose(found[:40, 0], zero_phase(v[:40, 0], RATE_HZ, CUTOFF_HZ))
    np.testing.assert_allclose(found[:, 1], zero_phase(v[:, 1], RATE_HZ, CUTOFF_HZ))
    np.testing.assert_array_equal(found[97:, 0], v[97:, 0])  # too short to filter


def test_time_turned_round_turns_the_result_round() -> None:
    v = np.random.default_rng(1).normal(size=300)

    forwards, backwards = (zero_phase(w, RATE_HZ, CUTOFF_HZ) for w in (v, v[::-1]))

    np.testing.assert_allclose(forwards[60:-60], backwards[::-1][60:-60], atol=1e-6)


@pytest.mark.parametrize("cutoff_hz", [0.0, 60.0, 80.0])
def test_a_cut_off_beyond_half_the_rate_is_a_wrong_call(cutoff_hz: float) -> None:
    with pytest.raises(ValueError, match="half the rate"):
        zero_phase(np.zeros(50), RATE_HZ, cutoff_hz)


def run(one_euro: OneEuroFilter, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([one_euro(float(now), v) for now, v in zip(t, values, strict=True)])


@pytest.mark.parametrize("speed", [0.0, 50.0, 400.0])
def test_one_euro_is_as_late_as_it_says_in_steady_motion(speed: float) -> None:
    t = np.arange(3000) / RATE_HZ
    one_euro = OneEuroFilter()

    found = run(one_euro, t, speed * t)

    late = one_euro.figures(RATE_HZ, speed).lag_s
    assert speed * t[-1] - found[-1] == pytest.approx(speed * late, abs=1e-6)
    assert late == pytest.approx(1 / (2 * np.pi * (1.0 + 0.02 * speed)))


def test_one_euro_leaves_as_much_noise_as_it_says_of_what_stands_still() -> None:
    noise = np.random.default_rng(2).normal(size=100_000) * 1e-3  # so little that speed stays low
    t = np.arange(len(noise)) / RATE_HZ
    one_euro = OneEuroFilter(beta=0.0)

    found = run(one_euro, t, noise)

    stated = one_euro.figures(RATE_HZ).noise_gain
    assert found[1000:].std() / noise.std() == pytest.approx(stated, rel=0.03)


def test_one_euro_turns_with_the_axes() -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(3)
    p = rng.normal(size=(200, 4, 3)).cumsum(axis=0)
    R = Rotation.random(rng=rng).as_matrix()
    t = np.arange(200) / RATE_HZ

    here, there = run(OneEuroFilter(), t, p), run(OneEuroFilter(), t, p @ R.T)

    np.testing.assert_allclose(there, here @ R.T, atol=1e-9)


def test_one_euro_passes_over_what_is_unknown() -> None:
    one_euro = OneEuroFilter()
    one_euro(0.0, 1.0)

    assert np.isnan(one_euro(0.1, np.nan))

    other = OneEuroFilter()
    other(0.0, 1.0)
    assert one_euro(0.2, 2.0) == other(0.2, 2.0)


def test_one_euro_demands_increasing_times_and_sane_settings() -> None:
    one_euro = OneEuroFilter()
    one_euro(1.0, 0.0)

    with pytest.raises(ValueError, match="times must increase"):
        one_euro(1.0, 0.0)
    with pytest.raises(ValueError, match="above 0 Hz"):
        OneEuroFilter(min_cutoff_hz=0.0)
