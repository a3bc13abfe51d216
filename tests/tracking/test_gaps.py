"""Short gaps, filled and flagged."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.trajectories import Source, Trajectories
from facewright.tracking.gaps import fill_gaps

Floats = NDArray[np.float64]
RATE_HZ = 60.0


def trajectories(
    curve: Floats, gaps: list[tuple[int, int]], times: Floats | None = None
) -> Trajectories:
    """One marker on a (T, 3) curve, unseen in the half-open ranges of frames."""
    t = np.arange(len(curve)) / RATE_HZ if times is None else times
    p = np.array(curve)[:, None]
    for first, end in gaps:
        p[first:end] = np.nan
    covariances = np.tile(np.eye(3), (len(t), 1, 1, 1))
    covariances[np.isnan(p[:, :, 0])] = np.nan
    n_views = np.where(np.isnan(p[:, :, 0]), 0, 3).astype(np.int32)
    residual = np.where(np.isnan(p[:, :, 0]), np.nan, 0.1)
    return Trajectories(t, ("a",), p, covariances, residual_px=residual, n_views=n_views)


def test_a_straight_line_is_continued_exactly_at_uneven_times() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.01, 0.02, size=40))
    line = np.array([1.0, -2, 3]) + t[:, None] * np.array([40.0, -25, 10])

    found = fill_gaps(trajectories(line, [(10, 13), (20, 22)], t), max_gap_s=0.2)

    np.testing.assert_allclose(found.positions[:, 0], line, atol=1e-9)


def test_a_cubic_is_continued_as_a_spline_of_the_same_degree_should() -> None:
    """Exact but for the natural ends, whose pull fades to a quarter from knot to knot."""
    t = np.arange(60) / RATE_HZ
    cubic = np.stack([80 * t**3, -60 * t**3 + 50 * t**2, 30 * t - 90 * t**2], axis=1)

    found = fill_gaps(trajectories(cubic, [(30, 34)]), max_gap_s=0.2)

    assert np.abs(found.positions[:, 0] - cubic).max() < 1e-5


def test_a_swaying_marker_is_found_again_within_a_few_hundredths_of_a_millimetre() -> None:
    t = np.arange(120) / RATE_HZ
    sway = 5 * np.stack([np.sin(2 * np.pi * f * t + f) for f in (1.0, 2.0, 3.0)], axis=1)

    found = fill_gaps(trajectories(sway, [(40, 43), (60, 64), (90, 93)]), max_gap_s=0.2)

    error = np.abs(found.positions[:, 0] - sway)
    assert error.max() < 0.05
    straight = np.interp(t, np.delete(t, slice(60, 64)), np.delete(sway[:, 2], slice(60, 64)))
    assert np.abs(straight - sway[:, 2]).max() > 5 * error[:, 2].max()


def test_only_gaps_up_to_the_length_are_filled_and_flagged() -> None:
    curve = np.random.default_rng(1).normal(size=(60, 3)).cumsum(axis=0)
    given = trajectories(curve, [(10, 15), (30, 36)])  # 6 and 7 intervals long

    found = fill_gaps(given, max_gap_s=6 / RATE_HZ)

    assert np.flatnonzero(found.is_filled[:, 0]).tolist() == [10, 11, 12, 13, 14]
    assert np.flatnonzero(np.isnan(found.positions[:, 0, 0])).tolist() == [*range(30, 36)]


def test_the_ends_of_the_take_stay_open() -> None:
    curve = np.random.default_rng(1).normal(size=(30, 3)).cumsum(axis=0)

    found = fill_gaps(trajectories(curve, [(0, 2), (28, 30)]), max_gap_s=1.0)

    assert np.isnan(found.positions[[0, 1, 28, 29]]).all()
    assert not found.is_filled.any()


def test_what_was_measured_is_left_as_it_is() -> None:
    curve = np.random.default_rng(1).normal(size=(50, 3)).cumsum(axis=0)
    given = trajectories(curve, [(10, 13), (15, 18)])

    found = fill_gaps(given, max_gap_s=0.2)

    seen = ~np.isnan(given.positions)
    np.testing.assert_array_equal(found.positions[seen], given.positions[seen])
    for name in ("covariances", "residual_px", "n_views"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))


def test_flags_that_were_there_stay() -> None:
    given = trajectories(np.zeros((20, 3)), [])
    flags = np.ones((20, 1), np.uint8)
    flags[7] = Source.RECONSTRUCTED
    given = Trajectories(given.time_s, given.names, given.positions, source=flags)

    found = fill_gaps(given)

    assert np.flatnonzero(found.is_filled).tolist() == [7]


def test_one_gap_is_not_shaped_by_what_was_put_into_another() -> None:
    curve = np.random.default_rng(1).normal(size=(50, 3)).cumsum(axis=0)
    both = fill_gaps(trajectories(curve, [(20, 22), (24, 27)]), max_gap_s=0.2)

    mirrored = fill_gaps(trajectories(curve[::-1], [(23, 26), (28, 30)]), max_gap_s=0.2)

    np.testing.assert_allclose(both.positions, mirrored.positions[::-1], atol=1e-9)


@pytest.mark.parametrize("n_seen", [0, 1, 2])
def test_a_marker_hardly_ever_seen_is_no_trouble(n_seen: int) -> None:
    given = trajectories(np.ones((10, 3)), [(0, 3), (3 + n_seen, 10)])

    found = fill_gaps(given, max_gap_s=1.0)

    np.testing.assert_array_equal(found.positions, given.positions)
