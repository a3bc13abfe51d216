from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.video import Frame
from facewright.core.video_writer import VideoWriter
from facewright.heads import face_network
from facewright.heads.face_finder import FaceFinder
from facewright.heads.face_landmarks import NAMED_LANDMARKS
from facewright.heads.face_network import face_networks_path
from facewright.heads.head import Head
from facewright.heads.render import HeadRenderer, portrait_camera
from facewright.tracking.face_following import track_landmarks
from facewright.tracking.face_sightings import sight_face
from facewright.tracking.landmark_regions import IS_QUICK
from facewright.tracking.landmark_tracks import LandmarkSource

Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]
RATE_HZ = 30.0


@pytest.fixture(scope="module")
def finder() -> FaceFinder:
    if face_networks_path() is None:
        pytest.skip(f"the face networks are not installed: {face_network.INSTALL_NETWORKS}")
    return FaceFinder()


@pytest.fixture(scope="module")
def portrait() -> Picture:
    data = pytest.importorskip("skimage.data", reason="scikit-image has the portrait")
    return np.array(data.astronaut())


def frames_of(pictures: Sequence[Picture], rate_hz: float = RATE_HZ) -> list[Frame]:
    return [Frame(i, i / rate_hz, picture) for i, picture in enumerate(pictures)]


def noisy(picture: Picture, rng: np.random.Generator, sd: float = 3.0) -> Picture:
    return np.clip(picture + rng.normal(scale=sd, size=picture.shape), 0, 255).astype(np.uint8)


def moved(picture: Picture, M: Floats) -> Picture:
    height, width = picture.shape[:2]
    border = cv2.BORDER_REPLICATE
    return np.asarray(cv2.warpAffine(picture, M, (width, height), flags=3, borderMode=border))


def jitter(points: Floats) -> float:
    return float(np.median(points.std(axis=0)))


def test_a_still_face_jitters_at_most_half_as_much_as_the_network(
    finder: FaceFinder, portrait: Picture
) -> None:
    rng = np.random.default_rng(3)
    frames = frames_of([noisy(portrait, rng) for _ in range(24)])

    tracks = track_landmarks(frames, finder=finder)

    alone = sight_face(iter(frames), finder).points_px
    assert jitter(tracks.points_px) < 0.5 * jitter(alone.astype(np.float64))


def test_a_moving_face_is_followed_without_lag(finder: FaceFinder, portrait: Picture) -> None:
    rng = np.random.default_rng(4)
    phase = 2 * np.pi * 2.5 * np.arange(24) / RATE_HZ  # nods of 2.5 Hz, 14 px
    ways = [np.array([[1.0, 0.0, 4 * np.sin(p)], [0.0, 1.0, 14 * np.sin(p)]]) for p in phase]
    frames = frames_of([noisy(moved(portrait, M), rng, 2.0) for M in ways])

    tracks = track_landmarks(frames, finder=finder)

    skin = tracks.points_px[:, ~IS_QUICK].mean(axis=1)
    way = np.array([M[:, 2] for M in ways])
    off = skin - skin.mean(axis=0) - (way - way.mean(axis=0))
    # one frame of lag would be off by 3.5 px at this speed
    assert np.sqrt((off[3:-3] ** 2).mean()) < 0.25
    assert (tracks.source == LandmarkSource.NETWORK).all()


@pytest.mark.slow  # renders four faces
def test_most_of_a_fast_blink_is_left(finder: FaceFinder, average_head: Head) -> None:
    rng = np.random.default_rng(5)
    camera, renderer = portrait_camera(average_head, (480, 540)), HeadRenderer(average_head)
    shut = [0.0, 0.25, 0.75, 1.0]  # 5 Hz at 30 frames/s: six frames
    looks = [
        renderer.render(average_head.shaped({"eyeBlinkLeft": w, "eyeBlinkRight": w}), camera)
        for w in shut
    ]
    order = [0] * 6 + [0, 1, 2, 3, 2, 1] * 3 + [0] * 6
    frames = frames_of([noisy(looks[k], rng, 2.0) for k in order])

    tracks = track_landmarks(frames, finder=finder)

    alone = sight_face(iter(frames), finder).points_px.astype(np.float64)
    opened, closed = np.array(order) == 0, np.array(order) == 3
    for side in ("right", "left"):
        upper, lower = (NAMED_LANDMARKS[f"lid_{side}_{edge}"] for edge in ("upper", "lower"))
        ours, network = (p[:, lower, 1] - p[:, upper, 1] for p in (tracks.points_px, alone))
        swing = np.median(network[opened]) - np.median(network[closed])
        assert swing > 3.0, "the network must see the blink for the test to say anything"
        assert np.median(ours[opened]) - ours[closed].max() >= 0.9 * swing


def in_place(portrait: Picture) -> Picture:
    """Another shot, the face at the same place."""
    other = portrait[:, ::-1, ::-1] // 2 + 100
    other[30:220, 150:310] = portrait[30:220, 150:310]
    return np.ascontiguousarray(other)


def jumped(portrait: Picture) -> Picture:
    """The same background, the face elsewhere."""
    return np.roll(portrait, (40, 110), axis=(0, 1))


@pytest.mark.parametrize("other", [in_place, jumped])
def test_a_cut_begins_a_new_shot(
    finder: FaceFinder, portrait: Picture, other: Callable[[Picture], Picture]
) -> None:
    frames = frames_of([portrait] * 6 + [other(portrait)] * 6)

    tracks = track_landmarks(frames, finder=finder)

    assert tracks.cuts == (6,)
    assert any("cut" in note for note in tracks.notes)
    # nothing is carried over: each shot's landmarks stand still
    for shot in tracks.shots:
        assert jitter(tracks.points_px[shot]) < 0.1


@pytest.mark.parametrize(
    ("n_without", "source"), [(3, LandmarkSource.BRIDGED), (15, LandmarkSource.MISSING)]
)
def test_frames_without_a_face_are_marked(
    finder: FaceFinder, portrait: Picture, n_without: int, source: LandmarkSource
) -> None:
    covered = portrait.copy()
    covered[0:300, 120:360] = covered[300, 120:360].mean(axis=0).astype(np.uint8)
    frames = frames_of([portrait] * 6 + [covered] * n_without + [portrait] * 6)

    tracks = track_landmarks(frames, finder=finder)

    gap = slice(6, 6 + n_without)
    assert (tracks.source[gap] == source).all()
    assert np.isnan(tracks.presence[gap]).all()
    is_known = np.isfinite(tracks.points_px[gap]).all(axis=(1, 2))
    assert (is_known == (source != LandmarkSource.MISSING)).all()
    if source == LandmarkSource.BRIDGED:
        middle = np.median(tracks.sd_px[gap], axis=1)[1]
        assert middle > 2 * np.median(tracks.sd_px[:5])
    assert any(f"{n_without} of" in note for note in tracks.notes)


def test_of_two_faces_the_asked_one_is_followed_and_that_is_said(
    finder: FaceFinder, portrait: Picture
) -> None:
    small = cv2.resize(portrait, (384, 384), interpolation=cv2.INTER_AREA)
    both = np.hstack([portrait, np.pad(small, ((0, 128), (0, 0), (0, 0)))])
    frames = frames_of([both] * 3)

    first = track_landmarks(frames, finder=finder)
    second = track_landmarks(frames, finder=finder, face=1)

    assert np.nanmean(first.points_px[..., 0]) < 512 < np.nanmean(second.points_px[..., 0])
    assert any("2 faces" in note for note in first.notes)
    with pytest.raises(InputError, match="face 2 was asked for, but at most 2"):
        track_landmarks(frames, finder=finder, face=2)


@pytest.mark.parametrize("turn", [1, 2])  # quarter turns: on its side, upside down
def test_a_turned_picture_gives_turned_landmarks(
    finder: FaceFinder, portrait: Picture, turn: int
) -> None:
    upright = track_landmarks(frames_of([portrait] * 3), finder=finder).points_px[1]
    turned = np.ascontiguousarray(np.rot90(portrait, turn))

    found = track_landmarks(frames_of([turned] * 3), finder=finder).points_px[1]

    # what lies at a landmark's place in one picture lies there in the other
    index = np.arange(512 * 512).reshape(512, 512)
    y, x = np.divmod(np.rot90(index, turn), 512)
    col, row = np.rint(found).astype(int).T
    back = np.column_stack([x[row, col], y[row, col]])
    assert np.median(np.linalg.norm(back - upright, axis=1)) < 2.5


def test_a_video_without_a_face_is_one_clear_error(finder: FaceFinder) -> None:
    blank = np.full((120, 160, 3), 90, np.uint8)

    with pytest.raises(InputError, match="no face was found in 4 frames"):
        track_landmarks(frames_of([blank] * 4), finder=finder)


def test_uneven_times_are_kept(finder: FaceFinder, portrait: Picture) -> None:
    times = [0.0, 0.033, 0.1, 0.115, 0.2]
    frames = [Frame(i, t, portrait) for i, t in enumerate(times)]

    tracks = track_landmarks(frames, finder=finder)

    np.testing.assert_array_equal(tracks.time_s, times)
    assert tracks.scores is not None and np.isfinite(tracks.scores).all()


def test_a_large_picture_gives_the_same_landmarks(finder: FaceFinder, portrait: Picture) -> None:
    large = np.asarray(cv2.resize(portrait, (2048, 2048), interpolation=cv2.INTER_CUBIC))

    small = track_landmarks(frames_of([portrait] * 3), finder=finder).points_px[1]
    found = track_landmarks(frames_of([large] * 3), finder=finder).points_px[1]

    off = (found + 0.5) / 4 - 0.5 - small  # pixels' centres are whole numbers
    assert np.abs(off.mean(axis=0)).max() < 0.25
    assert np.median(np.linalg.norm(off, axis=1)) < 0.6


def test_a_video_file_is_read_with_its_own_times(
    finder: FaceFinder, portrait: Picture, tmp_path: Path
) -> None:
    path = tmp_path / "clip.mp4"
    with VideoWriter(path, (512, 512), 15.0) as writer:
        for _ in range(6):
            writer.write(portrait)

    tracks = track_landmarks(path, finder=finder)

    np.testing.assert_allclose(tracks.time_s, np.arange(6) / 15, atol=1e-3)
    assert tracks.image_size == (512, 512)
    alone = track_landmarks(frames_of([portrait] * 3), finder=finder)
    off = np.linalg.norm(tracks.points_px[3] - alone.points_px[1], axis=1)
    assert np.median(off) < 0.5


def test_what_a_hand_may_hide_is_marked(finder: FaceFinder, portrait: Picture) -> None:
    rng = np.random.default_rng(8)
    hidden = portrait.copy()
    skin = rng.normal((205, 150, 125), 6, (110, 130, 3))
    hidden[128:238, 160:290] = cv2.GaussianBlur(skin, (0, 0), 2.0).astype(np.uint8)
    frames = frames_of([portrait] * 12 + [hidden] * 12 + [portrait] * 6)

    sd = track_landmarks(frames, finder=finder).sd_px

    mouth = [NAMED_LANDMARKS[n] for n in ("mouth_left", "mouth_right", "lip_lower_outer")]
    eyes = [NAMED_LANDMARKS[n] for n in ("eye_left_outer", "eye_right_outer")]
    usual = np.median(sd[:11])
    assert (np.isnan(sd[14:22, mouth]) | (sd[14:22, mouth] > 3 * usual)).all()
    assert (sd[14:22, eyes] < 3 * usual).all()
    assert (sd[26:, mouth] < 3 * usual).all()
