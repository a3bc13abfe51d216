"""Tracks cut where they jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.tracking.track_pieces import (
    NOBODY,
    cut_at_jumps,
    joined_pieces,
    labels_of_pieces,
)

Floats = NDArray[np.float64]
T = 60


def tracks() -> Floats:
    """Three tracks: on a head that shakes, one of them a lip in fast speech; (T, 3, 3) mm."""
    t = np.arange(T) / 60.0
    head = np.stack([60 * np.sin(9 * t), 20 * np.cos(5 * t), 0 * t], axis=1)
    places = np.array([[0.0, 0, 0], [30.0, 0, 0], [0.0, 40, 0]])
    p = head[:, None] + places
    p[:, 2, 1] += 6 * np.sin(2 * np.pi * 5 * t)  # 190 mm/s
    return np.asarray(p)


def test_fast_skin_on_a_fast_head_is_not_cut() -> None:
    pieces, of_track = cut_at_jumps(tracks())

    np.testing.assert_array_equal(of_track, [0, 1, 2])
    np.testing.assert_array_equal(pieces, tracks())


def test_a_jump_cuts_also_across_a_gap() -> None:
    p = tracks()
    p[20:, 1] += (0, 9, 0)
    p[40:44, 0] = np.nan
    p[44:, 0] += (0, 0, 25)

    pieces, of_track = cut_at_jumps(p)

    np.testing.assert_array_equal(of_track, [0, 0, 1, 1, 2])
    spans = [np.flatnonzero(~np.isnan(pieces[:, i, 0]))[[0, -1]].tolist() for i in range(5)]
    assert spans == [[0, 39], [44, 59], [0, 19], [20, 59], [0, 59]]


def test_pieces_give_the_tracks_back() -> None:
    p = tracks()
    p[20:, 1] += (0, 9, 0)
    pieces, of_track = cut_at_jumps(p)
    label = np.where(np.isnan(pieces[..., 0]), NOBODY, np.arange(len(of_track)) + 10)

    joined = joined_pieces(label, of_track, 3)

    np.testing.assert_array_equal(joined[19], [10, 11, 13])
    np.testing.assert_array_equal(joined[20], [10, 12, 13])


def test_names_go_to_the_piece_that_was_there() -> None:
    p = tracks()
    p[20:, 1] += (0, 9, 0)
    pieces, of_track = cut_at_jumps(p)
    first = np.array([4, 7, NOBODY])

    early = labels_of_pieces(pieces, first, of_track, 5)
    late = labels_of_pieces(pieces, first, of_track, 30)

    np.testing.assert_array_equal(early, [4, 7, NOBODY, NOBODY])
    np.testing.assert_array_equal(late, [4, NOBODY, 7, NOBODY])


def test_no_frames_and_single_samples_are_left_as_they_are() -> None:
    empty = np.zeros((0, 2, 3))
    single = np.full((1, 2, 3), 5.0)
    for p in (empty, single):
        pieces, of_track = cut_at_jumps(p)
        np.testing.assert_array_equal(pieces, p)
        np.testing.assert_array_equal(of_track, [0, 1])
