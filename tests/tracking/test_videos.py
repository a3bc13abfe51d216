"""From video files to unlabelled trajectories: small videos of dots whose places are known."""

from __future__ import annotations

import random
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.rig_json import read_rig
from facewright.core.rig import Rig
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.film import FilmedTake
from facewright.datasets_synthetic.rigs import face_rig
from facewright.datasets_synthetic.takes import Take, take_truth
from facewright.tracking import dot_streams
from facewright.tracking.blobs import find_blobs
from facewright.tracking.tracker import TrackerSettings
from facewright.tracking.videos import match_videos_to_rig, track_videos

Floats = NDArray[np.float64]
SIZE = (480, 270)
N_FRAMES = 16


@pytest.fixture(scope="module")
def rig() -> Rig:
    return face_rig(np.random.default_rng(2), n_cameras=3, image_size=SIZE)


@pytest.fixture(scope="module")
def truth() -> Floats:
    """(T, 6, 3) mm: six dots that drift."""
    rng = np.random.default_rng(3)
    rest = np.array(
        [[-50.0, 40, 10], [50, 55, 12], [5, -8, 55], [-40, -45, 20], [38, -42, 22], [2, -85, 20]]
    )
    speed = rng.normal(0, 25.0, size=(6, 3))
    return np.asarray(rest + np.arange(N_FRAMES)[:, None, None] / 60 * speed)


def film(
    path: Path,
    rig: Rig,
    truth: Floats,
    *,
    camera: str | None = None,
    rate_hz: float = 60.0,
    size: tuple[int, int] = SIZE,
    brightness: float = 180.0,
    radius_px: float = 3.0,
    lost: Sequence[int] = (),
) -> Path:
    """Film dots, as smooth discs, with the camera that the file is named after."""
    y, x = np.mgrid[: size[1], : size[0]]
    noise = np.random.default_rng(1).normal(30, 1.0, size=(size[1], size[0]))
    with VideoWriter(path, size, rate_hz, crf=8) as writer:
        for frame, points in enumerate(truth):
            if frame in lost:
                continue
            level = np.array(noise)
            for cx, cy in rig[camera or path.stem].project(points):
                distance = np.hypot(x - cx, y - cy)
                level += brightness * np.clip(radius_px + 0.5 - distance, 0, 1)
            image = np.clip(np.rint(level), 0, 255).astype(np.uint8)
            writer.write(image, frame / rate_hz if len(lost) else None)
    return path


@pytest.fixture(scope="module")
def takes(rig: Rig, truth: Floats, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("dots")
    return [film(folder / f"{name}.mp4", rig, truth) for name in rig]


@pytest.fixture
def copies(takes: list[Path], tmp_path: Path) -> list[Path]:
    """The videos where a test may spoil them."""
    return [Path(shutil.copy(path, tmp_path)) for path in takes]


def test_dots_in_videos_become_their_places_in_space(
    rig: Rig, truth: Floats, takes: list[Path]
) -> None:
    told: list[int] = []

    found = track_videos(takes, rig, on_frame=told.append)

    assert told == list(range(N_FRAMES))
    assert found.n_dots.tolist() == [[6, 6, 6]] * N_FRAMES
    assert set(found.levels) == set(rig)
    tracks = found.trajectories
    np.testing.assert_allclose(tracks.time_s, np.arange(N_FRAMES) / 60, atol=1e-4)
    assert len(tracks.names) == 6
    d = np.linalg.norm(tracks.positions[:, :, None] - truth[:, None], axis=3)
    nearest = d[0].argmin(axis=1)
    assert sorted(nearest) == list(range(6))
    assert np.sqrt((d[:, np.arange(6), nearest] ** 2).mean()) < 0.2  # mm; a pixel is 1 mm here


def test_the_order_of_the_files_does_not_matter(rig: Rig, takes: list[Path]) -> None:
    here, there = track_videos(takes, rig), track_videos(takes[::-1], rig)

    np.testing.assert_array_equal(here.trajectories.positions, there.trajectories.positions)


def test_two_of_three_cameras_suffice(rig: Rig, truth: Floats, takes: list[Path]) -> None:
    found = track_videos(takes[::2], rig).trajectories

    d = np.linalg.norm(found.positions[0][:, None] - truth[0], axis=2)
    assert sorted(d.argmin(axis=1)) == list(range(6))
    assert set(np.asarray(found.n_views).ravel().tolist()) == {2}


def test_the_timing_of_the_threads_changes_nothing(
    rig: Rig, takes: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = track_videos(takes, rig).trajectories

    def dawdle(*args: Any) -> Any:
        time.sleep(random.random() * 0.02)
        return find_blobs(*args)

    monkeypatch.setattr(dot_streams, "find_blobs", dawdle)
    monkeypatch.setattr(dot_streams, "_QUEUE", 2)
    for _ in range(2):
        found = track_videos(takes, rig).trajectories
        for name in ("time_s", "positions", "covariances", "residual_px", "n_views"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_take_is_tracked_whole(short_take: Take, filmed_take: FilmedTake) -> None:
    """All thirty markers of a performance, from compressed video, in the right places."""
    found = track_videos(filmed_take.videos, read_rig(filmed_take.rig)).trajectories

    true = take_truth(short_take).marker_positions
    d = np.linalg.norm(found.positions[:, :, None] - true[:, None], axis=3)
    seen = ~np.isnan(found.positions[..., 0])
    nearest = np.where(np.isnan(d), np.inf, d).argmin(axis=2)
    for m in range(len(found.names)):
        assert len(set(nearest[seen[:, m], m].tolist())) == 1, "one track, one marker"
    assert set(nearest[seen].tolist()) == set(range(30))
    error = d.min(axis=2)[seen]
    assert np.sqrt((error**2).mean()) < 0.1
    assert seen.sum() > 0.97 * true.shape[0] * 30


# --------------------------------------------------------------------------------- bad input


def test_a_video_named_after_no_camera_is_refused(rig: Rig, copies: list[Path]) -> None:
    other = copies[1].rename(copies[1].with_name("left.mp4"))

    with pytest.raises(InputError, match=r"left\.mp4: .* no camera named left .*cam0, cam1, cam2"):
        track_videos([copies[0], other], rig)


def test_two_videos_of_one_camera_are_refused(
    rig: Rig, takes: list[Path], copies: list[Path]
) -> None:
    with pytest.raises(InputError, match=r"cam0\.mp4 and .*cam0\.mp4 are both of camera cam0"):
        match_videos_to_rig([takes[0], copies[0], takes[1]], rig)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_videos_are_refused(rig: Rig, takes: list[Path], count: int) -> None:
    with pytest.raises(InputError, match=f"at least 2 videos, got {count}"):
        track_videos(takes[:count], rig)


def test_a_picture_size_that_is_not_the_cameras_is_refused(
    rig: Rig, truth: Floats, copies: list[Path]
) -> None:
    copies[1].unlink()
    film(copies[1], rig, truth, size=(320, 180))

    with pytest.raises(
        FileFormatError, match=r"cam1\.mp4, picture size: expected 480x270 .*, found 320x180"
    ):
        track_videos(copies, rig)


def test_different_rates_are_refused(rig: Rig, truth: Floats, copies: list[Path]) -> None:
    film(copies[2], rig, truth, rate_hz=50)

    told = r"cam2 says 50 frames/s, cam0 60, but both have about 16 frames: .* wrong"
    with pytest.raises(InputError, match=told):
        track_videos(copies, rig)


def test_a_rate_that_a_file_says_wrong_can_be_put_right(
    rig: Rig, truth: Floats, copies: list[Path]
) -> None:
    film(copies[2], rig, truth, rate_hz=50)

    found = track_videos(copies, rig, rate_hz=120).trajectories

    d = np.linalg.norm(found.positions[:, :, None] - truth[:, None], axis=3).min(axis=2)
    assert d.shape == (N_FRAMES, 6)
    assert np.sqrt((d**2).mean()) < 0.2
    assert found.rate_hz == 120


def test_rates_that_differ_are_refused(rig: Rig, truth: Floats, copies: list[Path]) -> None:
    film(copies[2], rig, truth[:12], rate_hz=50)

    told = r"different rates: cam2 says 50 frames/s, cam0 60: convert"
    with pytest.raises(InputError, match=told):
        track_videos(copies, rig)


def test_a_camera_that_ends_early_is_missed_and_said(
    rig: Rig, truth: Floats, copies: list[Path]
) -> None:
    film(copies[1], rig, truth[:-5])

    found = track_videos(copies, rig)

    assert len(found.trajectories.time_s) == N_FRAMES
    views = np.asarray(found.trajectories.n_views)
    assert (views[:-5] == 3).all() and (views[-5:] == 2).all()
    assert found.notes == ("cam1 ends 5 frames before the others",)


def test_when_one_camera_is_left_the_take_ends(rig: Rig, truth: Floats, copies: list[Path]) -> None:
    for path in copies[:2]:
        film(path, rig, truth[:-4])

    found = track_videos(copies, rig).trajectories

    assert len(found.time_s) == N_FRAMES - 4


def test_lost_frames_are_missing_views_of_their_own_instants(
    rig: Rig, truth: Floats, copies: list[Path]
) -> None:
    lost = [3, 7, 8]
    film(copies[1], rig, truth, lost=lost)

    found = track_videos(copies, rig)

    views = np.asarray(found.trajectories.n_views)
    expected = np.where(np.isin(np.arange(N_FRAMES), lost), 2, 3)
    np.testing.assert_array_equal(views, np.repeat(expected[:, None], 6, axis=1))
    d = np.linalg.norm(found.trajectories.positions[:, :, None] - truth[:, None], axis=3)
    assert np.sqrt((d.min(axis=2) ** 2).mean()) < 0.2  # mm; as without losses
    assert (d.argmin(axis=2) == d[0].argmin(axis=1)).all()
    np.testing.assert_allclose(found.trajectories.time_s, np.arange(N_FRAMES) / 60)
    assert found.notes == (f"cam1 lost 3 of {N_FRAMES} frames: they are missing views",)


def test_a_video_cut_off_in_the_middle_is_refused(rig: Rig, copies: list[Path]) -> None:
    whole = copies[2].read_bytes()
    copies[2].write_bytes(whole[: int(0.7 * len(whole))])

    with pytest.raises(FileFormatError, match=rf"cam2\.mp4, frame \d+: expected {N_FRAMES} frames"):
        track_videos(copies, rig)


def test_what_is_no_video_is_refused(rig: Rig, copies: list[Path]) -> None:
    copies[0].write_bytes(b"these are not the frames you are looking for\n" * 100)

    with pytest.raises(FileFormatError, match=r"cam0\.mp4, file: expected a video"):
        track_videos(copies, rig)


def test_a_video_that_is_not_there_is_refused(rig: Rig, copies: list[Path]) -> None:
    copies[0].unlink()

    with pytest.raises(FileNotFoundError):
        track_videos(copies, rig)


def test_a_video_without_dots_is_named(rig: Rig, truth: Floats, copies: list[Path]) -> None:
    film(copies[1], rig, truth, brightness=0)

    with pytest.raises(InputError, match=r"cam1\.mp4: no markers found: in most of"):
        track_videos(copies, rig)


def test_a_level_below_the_noise_names_the_video_and_the_frame(
    rig: Rig, takes: list[Path], tmp_path: Path
) -> None:
    image = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    image[::4, ::4] = 255
    path = tmp_path / "cam1.mp4"
    with VideoWriter(path, SIZE, 60, crf=1) as writer:
        for _ in range(N_FRAMES):
            writer.write(image)

    with pytest.raises(InputError, match=r"cam1\.mp4, frame 0: more than 4096 bright spots"):
        track_videos([takes[0], path], rig, level=40.0)


def test_the_rig_of_another_take_is_refused(truth: Floats, takes: list[Path]) -> None:
    """Same names, same picture size, other places."""
    other = face_rig(np.random.default_rng(77), n_cameras=3, image_size=SIZE)

    with pytest.raises(InputError, match=r"meet those of other cameras|no marker was seen by two"):
        track_videos(takes, other)


def test_two_cameras_exchanged_are_named(rig: Rig, truth: Floats, tmp_path: Path) -> None:
    """Each filmed by the other, of three or of more cameras."""
    other = {"cam0": "cam2", "cam2": "cam0"}
    videos = [
        film(tmp_path / f"{name}.mp4", rig, truth, camera=other.get(name, name)) for name in rig
    ]

    with pytest.raises(InputError, match=r"videos of cam0 and cam2 are exchanged"):
        track_videos(videos, rig)


def test_an_error_in_one_video_leaves_no_thread_behind(rig: Rig, copies: list[Path]) -> None:
    import threading

    before = threading.active_count()
    whole = copies[1].read_bytes()
    copies[1].write_bytes(whole[: len(whole) // 2])

    with pytest.raises(FileFormatError):
        track_videos(copies, rig, settings=TrackerSettings())

    assert threading.active_count() == before


def test_an_interruption_in_the_midst_leaves_no_thread_behind(
    rig: Rig, takes: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    monkeypatch.setattr(dot_streams, "_QUEUE", 2)  # the searches wait for room
    before = threading.active_count()

    def stop(frame: int) -> None:
        if frame == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_videos(takes, rig, on_frame=stop)

    assert threading.active_count() == before
