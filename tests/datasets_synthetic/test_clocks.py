"""Cameras' clocks and the frames that reach their files."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.datasets_synthetic.clocks import CameraClock, frame_times


def test_a_clock_tells_the_same_moment_both_ways() -> None:
    clock = CameraClock(offset_s=0.2, drift=-4e-5)
    t = np.linspace(0, 3600, 7)

    np.testing.assert_allclose(clock.world_s(np.asarray(clock.clock_s(t))), t, atol=1e-9)
    assert clock.world_s(0.0) == 0.2


def test_a_slow_clock_falls_behind_by_its_drift() -> None:
    """At 100 ppm, an hour on the camera's clock takes the world 0.36 s longer."""
    assert CameraClock(drift=1e-4).world_s(3600.0) == pytest.approx(3600.36)


def test_regular_frames_are_on_the_beat() -> None:
    times = frame_times(np.random.default_rng(0), CameraClock(), seconds=2.0, rate_hz=30.0)

    np.testing.assert_allclose(times.world_s, np.arange(60) / 30)
    np.testing.assert_array_equal(times.world_s, times.stamp_s)


@pytest.mark.parametrize("tell", [True, False])
def test_dropped_frames_leave_gaps_in_time_but_not_always_in_the_stamps(tell: bool) -> None:
    times = frame_times(
        np.random.default_rng(1),
        CameraClock(),
        seconds=20.0,
        rate_hz=50.0,
        dropped=0.1,
        stamps_tell=tell,
    )

    assert 850 < len(times) < 950  # 1000 less a tenth, 5 standard deviations either way
    assert times.frame[0] == 0
    np.testing.assert_allclose(times.world_s, times.frame / 50)
    expected = times.frame if tell else np.arange(len(times))
    np.testing.assert_allclose(times.stamp_s, expected / 50)


def test_an_irregular_beat_never_runs_backwards() -> None:
    times = frame_times(
        np.random.default_rng(2), CameraClock(0.1, 5e-5), seconds=10.0, rate_hz=60.0, jitter=0.45
    )

    assert np.diff(times.world_s).min() > 0
    assert np.abs(times.clock_s * 60 - times.frame).max() <= 0.45
    assert np.abs(times.clock_s * 60 - times.frame).max() > 0.4
