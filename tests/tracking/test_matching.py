"""Which dots of different cameras are one marker."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.datasets_synthetic.rigs import face_rig
from facewright.tracking.matching import match_views
from facewright.tracking.triangulation import Points, Views

Floats = NDArray[np.float64]
N_POINTS = 30
NOISE_PX = 0.05


def scene(seed: int) -> tuple[list[Camera], Floats, np.random.Generator]:
    rng = np.random.default_rng(seed)
    cameras = list(face_rig(rng).cameras.values())
    # half a sphere of points, as the markers of a face are
    d = rng.normal(size=(N_POINTS, 3))
    d[:, 2] = np.abs(d[:, 2])
    points = d / np.linalg.norm(d, axis=1, keepdims=True) * (65, 95, 75)
    return cameras, points, rng


def seen_by(
    cameras: list[Camera],
    points: Floats,
    rng: np.random.Generator,
    *,
    hidden: NDArray[np.bool_] | None = None,
    n_ghosts: int = 0,
) -> tuple[list[Floats], list[NDArray[np.int64]]]:
    """Normalised dots of each camera in random order, and whose they are (−1: a ghost's)."""
    dots, owners = [], []
    for c, camera in enumerate(cameras):
        own = np.arange(len(points))
        if hidden is not None:
            own = own[~hidden[:, c]]
        pixels = camera.project(points[own]) + rng.normal(0, NOISE_PX, size=(len(own), 2))
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        pixels = np.concatenate([pixels, rng.uniform(low, high, size=(n_ghosts, 2))])
        own = np.concatenate([own, np.full(n_ghosts, -1)])
        order = rng.permutation(len(own))
        dots.append(camera.undistort(pixels[order]))
        owners.append(own[order])
    return dots, owners


def match(cameras: list[Camera], dots: list[Floats]) -> tuple[NDArray[np.int64], Points]:
    return match_views(Views.of(cameras), dots, tolerance_px=0.5)


def owners_of(rows: NDArray[np.int64], owners: list[NDArray[np.int64]]) -> list[set[int]]:
    """Whose dots each group holds."""
    return [{int(owners[c][row[c]]) for c in np.flatnonzero(row >= 0)} for row in rows]


@pytest.mark.parametrize("seed", range(5))
def test_all_points_seen_by_all_cameras_are_grouped_right(seed: int) -> None:
    cameras, points, rng = scene(seed)
    dots, owners = seen_by(cameras, points, rng)

    rows, found = match(cameras, dots)

    groups = owners_of(rows, owners)
    assert sorted(map(tuple, groups)) == [(i,) for i in range(N_POINTS)]
    own = [group.pop() for group in groups]
    assert (rows >= 0).all()
    rms = np.sqrt(((found.positions - points[own]) ** 2).sum(axis=1).mean())
    assert rms < 0.05  # mm; 0.05 px at 750 mm are 0.02 mm across


@pytest.mark.parametrize("seed", range(5))
def test_ghosts_in_every_view_join_no_marker(seed: int) -> None:
    cameras, points, rng = scene(seed)
    dots, owners = seen_by(cameras, points, rng, n_ghosts=6)

    rows, _ = match(cameras, dots)

    groups = owners_of(rows, owners)
    markers = [g for g, row in zip(groups, rows, strict=True) if (row >= 0).sum() >= 3]
    assert sorted(map(tuple, markers)) == [(i,) for i in range(N_POINTS)]
    # two ghosts whose rays happen to meet look like a marker that two cameras see
    assert len(groups) - len(markers) <= 2


@pytest.mark.parametrize("seed", range(5))
def test_markers_hidden_from_some_cameras_are_not_mixed_up(seed: int) -> None:
    cameras, points, rng = scene(seed)
    hidden = np.zeros((N_POINTS, 4), bool)
    for i in range(N_POINTS):
        hidden[i, rng.choice(4, size=i % 3, replace=False)] = True
    dots, owners = seen_by(cameras, points, rng, hidden=hidden)

    rows, _ = match(cameras, dots)

    groups = owners_of(rows, owners)
    n_views = {own: int((~hidden[own]).sum()) for own in range(N_POINTS)}
    found = {next(iter(g)) for g in groups if len(g) == 1}
    assert {own for own, n in n_views.items() if n >= 3} <= found
    wrong = [g for g in groups if len(g) > 1]
    assert len(wrong) <= 1
    pairs = [own for own, n in n_views.items() if n == 2]
    assert len(found & set(pairs)) >= 0.6 * len(pairs)  # a rival makes a pair be left alone


def test_a_dot_serves_once() -> None:
    cameras, points, rng = scene(3)
    dots, _ = seen_by(cameras, points, rng, n_ghosts=10)

    rows, found = match(cameras, dots)

    for c in range(4):
        used = rows[rows[:, c] >= 0, c]
        assert len(set(used.tolist())) == len(used)
    assert (found.used == (rows >= 0)).all()


def test_a_pair_with_a_rival_is_left_alone() -> None:
    """Two points in one epipolar plane of the only two cameras: four ways to pair, none sure."""
    cameras = scene(0)[0][:2]
    a, b = (c.position for c in cameras)
    middle = np.array([0.0, 0, 20])
    other = middle + 0.05 * (a - middle) + 0.05 * (b - middle) + (a - b) * 0.02
    points = np.stack([middle, other])  # both in the plane of the two centres and `middle`
    dots = [c.undistort(c.project(points)) for c in cameras]

    rows, _ = match(cameras, dots)

    assert len(rows) == 0


def test_no_dots_or_dots_of_one_camera_are_no_markers() -> None:
    cameras, points, rng = scene(0)
    dots, _ = seen_by(cameras, points, rng)
    empty = np.zeros((0, 2))

    for given in ([empty] * 4, [dots[0], empty, empty, empty]):
        rows, found = match(cameras, given)
        assert rows.shape == (0, 4)
        assert found.positions.shape == (0, 3)
    rows, _ = match(cameras, [dots[0], empty, dots[2], dots[3]])
    assert (rows[:, 1] == -1).all()
    assert len(rows) >= 25
