"""Gaps, filled, flagged, and how far off that may be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from facewright.core.trajectories import Source, Trajectories
from facewright.tracking.gaps import SeenFace, fill_gaps, learn_face

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
    for name in ("residual_px", "n_views"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    assert found.covariances is not None
    assert given.covariances is not None
    measured = given.is_measured
    np.testing.assert_array_equal(found.covariances[measured], given.covariances[measured])


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


def test_the_stated_error_of_a_cubic_is_what_it_is_off_by() -> None:
    """Over many gaps in a curve of even liveliness."""
    rng = np.random.default_rng(3)
    curve = 60 * gaussian_filter1d(rng.normal(size=(20000, 3)), 4.0, axis=0)
    gaps = [(first, first + 4) for first in range(100, 19900, 37)]

    found = fill_gaps(trajectories(curve, gaps))

    filled = found.is_filled[:, 0]
    assert filled.sum() == 4 * len(gaps)
    assert found.covariances is not None
    error = found.positions[filled, 0] - curve[filled]
    covariance = found.covariances[filled, 0]
    real = np.sqrt((error**2).sum(axis=1).mean())
    stated = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())
    assert stated == pytest.approx(real, rel=0.2)  # 60 trials a length: 9 % at one sigma
    assert (np.linalg.eigvalsh(covariance) >= -1e-12).all()


def test_too_little_seen_to_try_a_cubic_on_states_no_error() -> None:
    curve = np.random.default_rng(1).normal(size=(20, 3)).cumsum(axis=0)

    found = fill_gaps(trajectories(curve, [(9, 11)]))

    assert found.is_filled.sum() == 2
    assert found.covariances is not None
    assert np.isnan(found.covariances[9:11]).all()


# ------------------------------------------------------------------- reconstructed from others

N_MARKERS = 16


def moving_face(
    seconds: float, *, seed: int = 0, own_mm: float = 0.1, turn: bool = True
) -> Trajectories:
    """Markers with four common movements and a little of their own, on a moving head."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE_HZ)
    anatomy = np.random.default_rng(99)  # one face, however it moves
    rest = anatomy.normal(0, 40.0, size=(N_MARKERS, 3))
    ways = anatomy.normal(0, 2.0, size=(4, N_MARKERS, 3))
    ways[:, :5] *= 0.02  # some hardly move
    common = gaussian_filter1d(rng.normal(size=(n, 4)), 9.0, axis=0)
    common /= common.std(axis=0)
    own = gaussian_filter1d(rng.normal(size=(n, N_MARKERS, 3)), 12.0, axis=0)
    own *= own_mm / own.std()
    p = rest + np.tensordot(common, ways, 1) + own
    if turn:
        angles = gaussian_filter1d(rng.normal(size=(n, 3)), 30.0, axis=0)
        R = Rotation.from_rotvec(0.2 * angles / angles.std()).as_matrix()
        p = np.einsum("tij,tmj->tmi", R, p) + 20 * angles[:, None] / angles.std()
    names = tuple(f"m{i}" for i in range(N_MARKERS))
    return Trajectories(np.arange(n) / RATE_HZ, names, p)


def with_gaps(take: Trajectories, gaps: list[tuple[int, int, int]]) -> Trajectories:
    """Markers (third) unseen in half-open ranges of frames."""
    p = np.array(take.positions)
    for first, end, m in gaps:
        p[first:end, m] = np.nan
    return Trajectories(take.time_s, take.names, p)


def off_mm(found: Trajectories, take: Trajectories) -> float:
    """RMS distance of filled samples from the truth."""
    d = (found.positions - take.positions)[found.is_filled]
    return float(np.sqrt((d**2).sum(axis=1).mean()))


def test_a_marker_is_reconstructed_from_the_others() -> None:
    take = moving_face(20)
    gaps = [(200, 260, 7), (500, 590, 9), (800, 860, 12)]

    found = fill_gaps(with_gaps(take, gaps))

    flagged = np.zeros_like(found.is_filled)
    for first, end, m in gaps:
        assert (found.source[first:end, m] == Source.RECONSTRUCTED).all()
        flagged[first:end, m] = True
    np.testing.assert_array_equal(found.is_filled, flagged)
    moves = np.linalg.norm(take.positions[:, 9].std(axis=0))
    assert moves > 3.0
    assert off_mm(found, take) < 0.25  # what is its own: 0.17 mm RMS over three coordinates


def test_several_markers_missing_at_once_are_reconstructed_from_the_rest() -> None:
    take = moving_face(20)
    gaps = [(300, 360, m) for m in (6, 8, 10)] + [(330, 420, 12)]

    found = fill_gaps(with_gaps(take, gaps))

    assert not found.is_missing.any()
    assert off_mm(found, take) < 0.3


def test_reconstructed_gaps_meet_the_samples_on_both_sides() -> None:
    take = moving_face(20, own_mm=0.4)

    found = fill_gaps(with_gaps(take, [(300, 400, 8)]))

    off = np.linalg.norm(found.positions[:, 8] - take.positions[:, 8], axis=1)
    assert off[300:400].max() > 0.2
    assert off[[300, 399]].max() < 0.01  # no step
    assert off[[301, 398]].max() < 0.02  # and no corner


def test_the_stated_error_of_reconstructions_is_true() -> None:
    take = moving_face(90, own_mm=0.4)
    rng = np.random.default_rng(8)
    gaps = [
        (first, first + int(rng.integers(20, 90)), int(rng.integers(5, N_MARKERS)))
        for first in range(60, 5280, 170)
    ]

    found = fill_gaps(with_gaps(take, gaps))

    assert found.covariances is not None
    filled = found.is_filled
    error = (found.positions - take.positions)[filled]
    covariance = found.covariances[filled]
    stated = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())
    assert stated == pytest.approx(np.sqrt((error**2).sum(axis=1).mean()), rel=0.2)
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), atol=1e-12)
    # at the ends the marker was just seen: the error grows inwards
    sd = np.sqrt(np.trace(found.covariances[gaps[0][0] : gaps[0][1], gaps[0][2]], axis1=1, axis2=2))
    assert sd[0] < 0.3 * sd[len(sd) // 2]
    assert sd[-1] < 0.3 * sd[len(sd) // 2]


def test_fillings_move_with_the_world() -> None:
    take = with_gaps(moving_face(10), [(200, 260, 7)])
    R = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    p = take.positions @ R.T + (100.0, -50, 700)

    here = fill_gaps(take)
    there = fill_gaps(Trajectories(take.time_s, take.names, p))

    # not exactly: the usual place of a marker is a median along each axis
    np.testing.assert_allclose(there.positions, here.positions @ R.T + (100.0, -50, 700), atol=2e-3)
    assert here.covariances is not None
    assert there.covariances is not None
    np.testing.assert_allclose(
        there.covariances[200:260, 7], R @ here.covariances[200:260, 7] @ R.T, atol=1e-3
    )


def test_a_short_chunk_fills_its_gap_from_what_was_seen_before() -> None:
    before, chunk = moving_face(30, seed=1), moving_face(3, seed=2)
    broken = with_gaps(chunk, [(50, 130, 9)])

    alone = fill_gaps(broken)
    seen = learn_face(before)
    informed = fill_gaps(broken, seen=seen)

    assert not informed.is_missing.any()
    assert off_mm(informed, chunk) < 0.3
    assert alone.is_missing.any() or off_mm(alone, chunk) > 1.5 * off_mm(informed, chunk)


def test_what_is_kept_of_a_face_is_bounded() -> None:
    seen: SeenFace | None = None
    for seed in range(4):
        seen = learn_face(moving_face(5, seed=seed), seen, keep_s=12.0)

    assert seen is not None
    assert 11.0 < seen.seconds <= 12.0
    # the latest are kept whole: 5, 5, and 2 s of the one before
    assert [round(float(run.time_s[-1] - run.time_s[0])) for run in seen.runs] == [2, 5, 5]


def test_filled_samples_are_not_learnt_from() -> None:
    take = fill_gaps(with_gaps(moving_face(10), [(200, 260, 7)]))

    seen = learn_face(take)

    assert seen is not None
    known = np.concatenate([run.known for run in seen.runs])
    np.testing.assert_array_equal(known, take.is_measured)


def test_other_markers_than_those_seen_before_are_a_wrong_call() -> None:
    seen = learn_face(moving_face(5))
    other = moving_face(5).select(tuple(f"m{i}" for i in range(8)))

    with pytest.raises(ValueError, match="same names"):
        fill_gaps(with_gaps(other, [(100, 150, 3)]), seen=seen)
    with pytest.raises(ValueError, match="same names"):
        learn_face(other, seen)


def test_gaps_longer_than_asked_and_at_the_ends_stay_open() -> None:
    take = moving_face(10)
    gaps = [(0, 30, 6), (570, 600, 6), (200, 290, 7), (200, 250, 8)]

    found = fill_gaps(with_gaps(take, gaps), max_gap_s=1.0)

    assert np.isnan(found.positions[:30, 6]).all()
    assert np.isnan(found.positions[570:, 6]).all()
    assert np.isnan(found.positions[200:290, 7]).all()
    assert not np.isnan(found.positions[200:250, 8]).any()


def test_a_gap_of_all_markers_cannot_be_reconstructed() -> None:
    take = moving_face(10)

    found = fill_gaps(with_gaps(take, [(200, 260, m) for m in range(N_MARKERS)]))

    assert np.isnan(found.positions[200:260]).all()
