from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.tracking.covered_faces import covered_points, long_covered

T, SIDE = 10, 12
PLACES: NDArray[np.float64] = 17.0 * np.array([[x, y] for y in range(SIDE) for x in range(SIDE)])
UNIT = np.ones(T)


def found_except(below: float) -> NDArray[np.float64]:
    """Patches are found 1 px off, but from frame 5 on those with y above `below` are not."""
    apart = np.full((T, len(PLACES)), 1.0)
    apart[5:, PLACES[:, 1] > below] = np.nan
    return apart


def test_points_are_hidden_where_the_network_doubts_and_their_patches_are_gone() -> None:
    presence = np.array([18.0] * 5 + [6.0] * 5)

    covered, _ = covered_points(presence, found_except(100.0), PLACES, UNIT)

    assert not covered[:5].any()
    assert covered[5:, PLACES[:, 1] > 130].all()
    assert not covered[5:, PLACES[:, 1] < 70].any()


def test_a_sure_network_is_believed_although_patches_have_changed() -> None:
    hidden, uncertain = covered_points(np.full(T, 18.0), found_except(100.0), PLACES, UNIT)

    assert not hidden.any() and not uncertain.any()


def test_a_network_less_sure_than_before_makes_points_without_patches_uncertain() -> None:
    presence = np.array([20.0] * 5 + [16.0] * 5)

    hidden, uncertain = covered_points(presence, found_except(100.0), PLACES, UNIT)

    assert not hidden.any() and not uncertain[:5].any()
    assert uncertain[5:, PLACES[:, 1] > 150].all()
    assert not uncertain[5:, PLACES[:, 1] < 90].any()


def test_a_hand_that_is_taken_for_the_face_is_not_it() -> None:
    presence = np.array([18.0] * 5 + [12.0] * 5)

    covered, _ = covered_points(presence, found_except(10.0), PLACES, UNIT)

    assert not covered[:5].any()
    assert covered[5:, PLACES[:, 1] > 40].all()


def test_a_patch_found_far_away_is_not_found() -> None:
    presence = np.array([18.0] * 5 + [6.0] * 5)
    apart = found_except(100.0)

    far, _ = covered_points(presence, np.nan_to_num(apart, nan=20.0), PLACES, UNIT)

    np.testing.assert_array_equal(far, covered_points(presence, apart, PLACES, UNIT)[0])
    # twenty pixels of a face four times as large are as near as five of this one
    near, _ = covered_points(presence, np.nan_to_num(apart, nan=20.0), PLACES, 4 * UNIT)
    assert not near.any()


def test_only_short_covers_between_seen_frames_are_bridged() -> None:
    covered = np.zeros((T, 3), bool)
    covered[4:6, 0] = True  # from 0.3 s to 0.6 s
    covered[2:8, 1] = True
    covered[8:, 2] = True  # nothing comes after it

    left = long_covered(covered, np.arange(T) / 10, 0.35)

    np.testing.assert_array_equal(left[:, 0], False)
    np.testing.assert_array_equal(left[:, 1], covered[:, 1])
    np.testing.assert_array_equal(left[:, 2], covered[:, 2])
