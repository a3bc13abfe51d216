"""Whose tracks are whose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.core.trajectories import Trajectories
from facewright.tracking.faces import split_faces

Floats = NDArray[np.float64]


def face(rng: np.random.Generator, n: int, x_mm: float) -> Floats:
    """(50, n, 3) mm: points within a face's reach of each other, in motion."""
    points = rng.uniform((-60, -90, 0), (60, 90, 60), size=(n, 3)) + (x_mm, 0, 0)
    return np.asarray(points + 10 * np.sin(np.arange(50) / 9)[:, None, None])


def tracks(positions: Floats) -> Trajectories:
    names = tuple(f"m{m}" for m in range(positions.shape[1]))
    return Trajectories(np.arange(len(positions)) / 60, names, positions)


def test_one_face_is_one() -> None:
    found = split_faces(tracks(face(np.random.default_rng(0), 30, 0.0)))

    assert [f.tolist() for f in found] == [list(range(30))]


def test_two_people_side_by_side_are_two_the_one_seen_most_first() -> None:
    rng = np.random.default_rng(1)
    left, right = face(rng, 20, -250.0), face(rng, 28, 250.0)

    found = split_faces(tracks(np.concatenate([left, right], axis=1)))

    assert [f.tolist() for f in found] == [list(range(20, 48)), list(range(20))]


def test_pieces_of_a_track_go_to_their_own_face() -> None:
    rng = np.random.default_rng(2)
    positions = np.concatenate([face(rng, 20, -250.0), face(rng, 28, 250.0)], axis=1)
    late = positions.copy()
    positions[23:] = np.where(np.arange(48)[:, None] == 3, np.nan, positions[23:])
    late[:23, 3] = np.nan
    late[26:, 3] = np.nan
    joined = np.concatenate([positions, late[:, 3:4]], axis=1)

    small, large = sorted(split_faces(tracks(joined)), key=len)

    assert small.tolist() == [*range(20), 48]
    assert large.tolist() == list(range(20, 48))


def test_a_few_stray_tracks_are_no_face() -> None:
    rng = np.random.default_rng(3)
    strays = face(rng, 3, 600.0)

    found = split_faces(tracks(np.concatenate([face(rng, 25, 0.0), strays], axis=1)))

    assert len(found) == 1
    assert len(found[0]) == 28


def test_no_tracks_are_no_face() -> None:
    assert split_faces(tracks(np.zeros((5, 0, 3)))) == ()
