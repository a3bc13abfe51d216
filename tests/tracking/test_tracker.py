"""Following markers, against points whose motion is known exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.rig import Rig
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.rigs import face_rig
from facewright.tracking.tracker import (
    MAX_COAST,
    MIN_TRACK_FRAMES,
    FrameDots,
    TrackerSettings,
    centres_of_spheres,
    follow_markers,
)

Floats = NDArray[np.float64]
NOISE_PX, SD_PX = 0.03, 0.1  # what a dot's place is off by, and what it is told to be
Change = Callable[[int, int, Floats, Floats, NDArray[np.int64]], tuple[Floats, Floats]]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return face_rig(np.random.default_rng(1))


def moving_points(rng: np.random.Generator, n_frames: int, n: int) -> Floats:
    """(T, N, 3) mm: points of half an ellipsoid at least 12 mm apart, swaying at 60 frames/s."""
    rest: list[Floats] = []
    while len(rest) < n:
        d = rng.normal(size=3) * (1, 1, 1)
        d[2] = abs(d[2])
        p = d / np.linalg.norm(d) * (65, 95, 75)
        if all(np.linalg.norm(p - q) > 12 for q in rest):
            rest.append(p)
    t = np.arange(n_frames)[:, None, None] / 60
    frequency = rng.uniform(0.5, 2.0, size=(1, n, 3))
    phase = rng.uniform(0, 6, size=(1, n, 3))
    own = 1.5 * np.sin(2 * np.pi * frequency * t + phase)
    together = 12 * np.sin(2 * np.pi * np.array([0.7, 0.4, 0.5]) * t)
    return np.asarray(np.array(rest)[None] + own + together)


def dots_of(
    rig: Rig,
    truth: Floats,
    rng: np.random.Generator,
    *,
    hidden: NDArray[np.bool_] | None = None,
    change: Change | None = None,
) -> list[FrameDots]:
    """What the cameras see of points (T, N, 3); `hidden` is (T, N, C)."""
    frames = []
    for t, points in enumerate(truth):
        centres, sds = [], []
        for c, camera in enumerate(rig.cameras.values()):
            own = np.arange(len(points))
            if hidden is not None:
                own = own[~hidden[t, :, c]]
            pixels = camera.project(points[own]) + rng.normal(0, NOISE_PX, size=(len(own), 2))
            sd = np.full(len(own), SD_PX)
            if change is not None:
                pixels, sd = change(t, c, pixels, sd, own)
            order = rng.permutation(len(pixels))
            centres.append(pixels[order])
            sds.append(sd[order])
        frames.append(FrameDots(t / 60, tuple(centres), tuple(sds)))
    return frames


def owners(found: Trajectories, truth: Floats) -> NDArray[np.int64]:
    """(T, M) index of the true point within 1 mm of each track; −1 unseen, −2 no such point."""
    d = np.linalg.norm(found.positions[:, :, None] - truth[:, None], axis=3)
    unseen = np.isnan(found.positions[..., 0])
    d = np.where(np.isnan(d), np.inf, d)
    return np.where(unseen, -1, np.where(d.min(axis=2) < 1.0, d.argmin(axis=2), -2))


def assert_one_whole_track_each(found: Trajectories, truth: Floats) -> None:
    own = owners(found, truth)
    assert (own == own[0]).all()
    assert sorted(own[0].tolist()) == list(range(truth.shape[1]))


def test_every_point_is_one_track_from_end_to_end(rig: Rig) -> None:
    rng = np.random.default_rng(0)
    truth = moving_points(rng, 90, 20)

    followed = follow_markers(rig, dots_of(rig, truth, rng))

    found = followed.trajectories
    assert_one_whole_track_each(found, truth)
    np.testing.assert_allclose(followed.share_used, 1.0)
    own = owners(found, truth)[0]
    rms = np.sqrt(((found.positions - truth[:, own]) ** 2).sum(axis=2).mean())
    assert rms < 0.03
    assert (np.asarray(found.n_views) == 4).all()
    np.testing.assert_allclose(found.time_s, np.arange(90) / 60)


def test_covariances_are_honest_whatever_the_dots_standard_deviations_claim(rig: Rig) -> None:
    """The squared error over the covariance has three degrees of freedom.

    A little less: what residuals cannot show is stated too, and does not happen here.
    """
    rng = np.random.default_rng(0)
    truth = moving_points(rng, 90, 20)

    found = follow_markers(rig, dots_of(rig, truth, rng)).trajectories

    error = found.positions - truth[:, owners(found, truth)[0]]
    assert found.covariances is not None
    squared = np.einsum("tma,tmab,tmb->tm", error, np.linalg.inv(found.covariances), error)
    assert 2.3 < squared.mean() < 3.1
    assert 0.93 < (squared < 7.815).mean() < 0.985  # χ² of three degrees of freedom at 95 %


def test_markers_that_cross_in_one_view_keep_their_names(rig: Rig) -> None:
    """Two points pass each other on one ray of the first camera, where their dots merge."""
    rng = np.random.default_rng(4)
    n_frames = 50
    camera = next(iter(rig.cameras.values()))
    across = camera.camera_from_world.rotation[0]
    ray = np.array([0.0, 0, 40]) - camera.position
    ray /= np.linalg.norm(ray)
    path = np.linspace(-8, 8, n_frames)[:, None] * across
    truth = np.stack([np.array([0.0, 0, 40]) + path, np.array([0.0, 0, 40]) - 18 * ray - path], 1)

    def merge(
        t: int, c: int, pixels: Floats, sd: Floats, own: NDArray[np.int64]
    ) -> tuple[Floats, Floats]:
        if c == 0 and np.linalg.norm(pixels[0] - pixels[1]) < 8:
            return pixels.mean(axis=0, keepdims=True), np.array([1.5])
        return pixels, sd

    frames = dots_of(rig, truth, rng, change=merge)
    assert min(len(f.centres[0]) for f in frames) == 1

    found = follow_markers(rig, frames).trajectories

    assert_one_whole_track_each(found, truth)


def test_a_head_that_turns_away_fast_is_followed(rig: Rig) -> None:
    """At its fastest, points move four gates a frame: past where others were."""
    rng = np.random.default_rng(9)
    truth = moving_points(rng, 40, 20)
    s = np.clip((np.arange(40) - 5) / 24, 0, 1)
    shift = 220 * s**3 * (10 + s * (6 * s - 15)) - 100
    truth = truth + shift[:, None, None] * np.array([1.0, 0, 0])
    frames = dots_of(rig, truth, rng)
    camera = next(iter(rig.cameras.values()))
    step = np.linalg.norm(np.diff(camera.project(truth), axis=0), axis=2)
    assert step.max() > 4 * TrackerSettings().gate_px

    found = follow_markers(rig, frames).trajectories

    assert_one_whole_track_each(found, truth)


@pytest.mark.parametrize("gap", [1, 3])
def test_a_short_occlusion_is_coasted(rig: Rig, gap: int) -> None:
    rng = np.random.default_rng(1)
    truth = moving_points(rng, 60, 12)
    hidden = np.zeros((60, 12, 4), bool)
    hidden[30 : 30 + gap, 5] = True

    found = follow_markers(rig, dots_of(rig, truth, rng, hidden=hidden)).trajectories

    own = owners(found, truth)
    assert len(found.names) == 12
    track = int(np.flatnonzero(own[0] == 5)[0])
    expected = np.full(60, 5)
    expected[30 : 30 + gap] = -1
    assert own[:, track].tolist() == expected.tolist()
    assert np.asarray(found.n_views)[30 : 30 + gap, track].tolist() == [0] * gap
    assert found.covariances is not None
    assert np.isnan(found.covariances[30 : 30 + gap, track]).all()


def test_a_long_occlusion_ends_the_track_and_begins_a_new_one(rig: Rig) -> None:
    rng = np.random.default_rng(1)
    truth = moving_points(rng, 60, 12)
    hidden = np.zeros((60, 12, 4), bool)
    hidden[20 : 20 + MAX_COAST + 5, 5] = True

    found = follow_markers(rig, dots_of(rig, truth, rng, hidden=hidden)).trajectories

    own = owners(found, truth)
    assert len(found.names) == 13
    tracks = [int(m) for m in range(13) if (own[:, m] == 5).any()]
    assert len(tracks) == 2
    assert set(np.unique(own[:, tracks])) == {-1, 5}
    assert (own[:20, tracks[0]] == 5).all()
    assert (own[20 + MAX_COAST + 5 :, tracks[1]] == 5).all()


def test_a_marker_seen_by_two_cameras_only_is_followed(rig: Rig) -> None:
    rng = np.random.default_rng(2)
    truth = moving_points(rng, 60, 12)
    hidden = np.zeros((60, 12, 4), bool)
    hidden[20:45, 3, 2:] = True

    found = follow_markers(rig, dots_of(rig, truth, rng, hidden=hidden)).trajectories

    assert_one_whole_track_each(found, truth)
    track = int(np.flatnonzero(owners(found, truth)[0] == 3)[0])
    assert set(np.asarray(found.n_views)[20:45, track].tolist()) == {2}


def test_half_hidden_dots_make_no_ghost_tracks(rig: Rig) -> None:
    rng = np.random.default_rng(3)
    truth = moving_points(rng, 60, 15)

    def half_hidden(
        t: int, c: int, pixels: Floats, sd: Floats, own: NDArray[np.int64]
    ) -> tuple[Floats, Floats]:
        if 15 <= t < 40 and c in (0, 3):
            bad = (own % 3) == (0 if c == 0 else 1)
            pixels = pixels + bad[:, None] * np.array([1.6, 0.7])
            sd = np.where(bad, 0.4, sd)
        return pixels, sd

    found = follow_markers(rig, dots_of(rig, truth, rng, change=half_hidden)).trajectories

    assert_one_whole_track_each(found, truth)
    error = np.linalg.norm(found.positions - truth[:, owners(found, truth)[0]], axis=2)
    assert error.max() < 0.25  # 1.6 px are 0.6 mm at this distance


def test_specks_that_come_and_go_are_no_tracks(rig: Rig) -> None:
    rng = np.random.default_rng(5)
    truth = moving_points(rng, 60, 15)

    def specks(
        t: int, c: int, pixels: Floats, sd: Floats, own: NDArray[np.int64]
    ) -> tuple[Floats, Floats]:
        more = rng.uniform((300, 100), (1000, 620), size=(2, 2))
        return np.concatenate([pixels, more]), np.append(sd, [SD_PX] * 2)

    found = follow_markers(rig, dots_of(rig, truth, rng, change=specks)).trajectories

    own = owners(found, truth)
    real = [m for m in range(len(found.names)) if (own[:, m] >= 0).mean() > 0.9]
    assert sorted(int(own[0, m]) for m in real) == list(range(15))
    assert (own[:, real] == own[0, real]).all()
    assert len(found.names) - len(real) <= 1


def test_a_marker_seen_for_a_moment_only_is_no_track(rig: Rig) -> None:
    rng = np.random.default_rng(6)
    truth = moving_points(rng, 40, 6)
    hidden = np.zeros((40, 6, 4), bool)
    hidden[:, 2] = True
    hidden[20 : 20 + MIN_TRACK_FRAMES - 1, 2] = False

    found = follow_markers(rig, dots_of(rig, truth, rng, hidden=hidden)).trajectories

    assert 2 not in owners(found, truth)
    assert len(found.names) == 5


def test_dots_of_another_rig_are_not_used(rig: Rig) -> None:
    rng = np.random.default_rng(7)
    truth = moving_points(rng, 30, 15)
    frames = dots_of(rig, truth, rng)
    names = list(rig)
    swapped = Rig(dict(zip(names, [rig[n] for n in (*names[1:], names[0])], strict=True)))

    share = follow_markers(swapped, frames).share_used

    assert share.max() < 0.6


def test_the_tolerance_can_be_set(rig: Rig) -> None:
    rng = np.random.default_rng(8)
    truth = moving_points(rng, 20, 8)
    frames = dots_of(rig, truth, rng)

    nothing = follow_markers(rig, frames, TrackerSettings(tolerance_px=1e-6))
    something = follow_markers(rig, frames, TrackerSettings(tolerance_px=0.5))

    assert len(nothing.trajectories.names) == 0
    assert len(something.trajectories.names) == 8


def middle_of_sphere(centre: Floats, radius: float) -> Floats:
    """Of the ellipse through the rays that touch a sphere, in front of an ideal camera."""
    distance = float(np.linalg.norm(centre))
    d = centre / distance
    u = np.cross(d, (0.0, 1.0, 0.0))
    u /= np.linalg.norm(u)
    v = np.cross(d, u)
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)[:, None]
    angle = np.arcsin(radius / distance)
    rays = np.cos(angle) * d + np.sin(angle) * (np.cos(turn) * u + np.sin(turn) * v)
    xy = rays[:, :2] / rays[:, 2:]
    # least squares for the conic A x² + B xy + C y² + D x + E y = 1
    x, y = (xy - xy.mean(axis=0)).T * 100
    rows = np.stack([x * x, x * y, y * y, x, y], axis=1)
    A, B, C, D, E = np.linalg.lstsq(rows, np.ones(len(x)), rcond=None)[0]
    middle = np.linalg.solve(np.array([[2 * A, B], [B, 2 * C]]), np.array([-D, -E]))
    return np.asarray(middle / 100 + xy.mean(axis=0))


@pytest.mark.parametrize("radius", [1.5, 10.0, 60.0])
def test_the_middle_of_a_spheres_picture_is_put_right(radius: float) -> None:
    for centre in np.array([[0.0, 0, 500], [150, -90, 500], [-300, 200, 700]]):
        seen = middle_of_sphere(centre, radius)

        found = centres_of_spheres(seen, np.array(centre[2]), radius)

        np.testing.assert_allclose(found, centre[:2] / centre[2], rtol=0, atol=1e-9)
        if radius > 5 and centre[0]:
            assert np.linalg.norm(seen - centre[:2] / centre[2]) > 1e-5


def test_spheres_are_where_their_centres_are(rig: Rig) -> None:
    """Balls of 12 mm (a glove's, say): the pictures' middles are tenths of a pixel off."""
    rng = np.random.default_rng(12)
    radius, truth = 12.0, moving_points(rng, 30, 10) + (60.0, 30, 0)
    frames = []
    for t, points in enumerate(truth):
        centres = []
        for camera in rig.cameras.values():
            local = camera.camera_from_world.apply(points)
            middles = np.stack([middle_of_sphere(p, radius) for p in local])
            centres.append(camera.pixel_from_normalised(camera.distort(middles)))
        frames.append(FrameDots(t / 60, tuple(centres), (np.full(10, SD_PX),) * len(rig)))

    plain = follow_markers(rig, frames).trajectories
    right = follow_markers(rig, frames, TrackerSettings(sphere_radius_mm=radius)).trajectories

    def rms(found: Trajectories) -> float:
        d = np.linalg.norm(found.positions[1:, :, None] - truth[1:, None], axis=3)
        return float(np.sqrt((d.min(axis=2) ** 2).mean()))

    assert rms(right) < 1e-4
    assert rms(plain) > 0.02


def test_no_frames_and_empty_frames_give_no_tracks(rig: Rig) -> None:
    empty = FrameDots(0.0, (np.zeros((0, 2)),) * 4, (np.zeros(0),) * 4)

    none = follow_markers(rig, [])
    blank = follow_markers(rig, [empty])

    assert none.trajectories.positions.shape == (0, 0, 3)
    assert blank.trajectories.positions.shape == (1, 0, 3)
    assert np.isnan(blank.share_used).all()
