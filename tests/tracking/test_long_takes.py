"""Takes worked in chunks, against the same take worked whole, and against the truth."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import FileFormatError, InputError
from facewright.core.files import alone_in
from facewright.core.formats.c3d import read_c3d
from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.markers import MarkerSet
from facewright.core.rig import Rig
from facewright.core.trajectories import Trajectories
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.film import FilmedTake
from facewright.datasets_synthetic.rigs import face_rig
from facewright.datasets_synthetic.takes import Take, take_truth
from facewright.tracking.chunk_files import ChunkFiles, part_folder
from facewright.tracking.long_takes import LongSettings, track_long

Floats = NDArray[np.float64]
#: Half a second in chunks of 12 frames that overlap by 4.
SHORT_CHUNKS = LongSettings(chunk_s=0.2, overlap_s=4 / 60)


@pytest.fixture
def videos(filmed_take: FilmedTake, tmp_path: Path) -> list[Path]:
    """The take's videos where a test may leave things beside them."""
    return [Path(shutil.copy2(path, tmp_path)) for path in filmed_take.videos]


@pytest.fixture(scope="module")
def rig(filmed_take: FilmedTake) -> Rig:
    return read_rig(filmed_take.rig)


@pytest.fixture(scope="module")
def marker_set(filmed_take: FilmedTake) -> MarkerSet:
    assert filmed_take.marker_set is not None
    return read_marker_set(filmed_take.marker_set)


def test_a_take_in_chunks_is_what_it_is_whole(
    videos: list[Path], rig: Rig, marker_set: MarkerSet, short_take: Take, tmp_path: Path
) -> None:
    out = tmp_path / "m.c3d"
    pieces: list[Trajectories] = []
    told: list[int] = []

    found = track_long(
        videos, rig, out, marker_set=marker_set, settings=SHORT_CHUNKS,
        on_frame=told.append, on_chunk=pieces.append,
    )  # fmt: skip

    truth = take_truth(short_take)
    assert short_take.markers is not None
    rows = [short_take.markers.glue.names.index(n) for n in found.names]
    tracks = read_c3d(out)
    assert found.n_frames == 30 and told == list(range(30))
    assert [len(p.time_s) for p in pieces] == [10, 12, 8]
    np.testing.assert_allclose(np.concatenate([p.time_s for p in pieces]), np.arange(30) / 60)
    joined = np.concatenate([p.positions for p in pieces])
    np.testing.assert_allclose(tracks.positions, joined, rtol=2.0**-24)
    error = np.linalg.norm(tracks.positions - truth.marker_positions[:, rows], axis=2)
    assert np.isnan(error).mean() < 0.03
    assert np.nanmax(error) < 1.0  # a wrong name would be centimetres off
    whole = track_long(videos, rig, tmp_path / "w.c3d", marker_set=marker_set)
    gap = np.linalg.norm(read_c3d(whole.path).positions - tracks.positions, axis=2)
    assert np.nanmedian(gap) < 2e-3  # weights are learnt from fewer dots; errors are 0.01 mm
    assert found.n_measured.sum() == tracks.is_measured.sum()
    assert found.n_missing.sum() == tracks.is_missing.sum()
    assert found.reprojection_rms_px == pytest.approx(whole.reprojection_rms_px, rel=0.02)
    assert found.notes == () and found.labelling is not None and found.person is not None
    assert sorted(p.name for p in tmp_path.iterdir() if p.suffix not in (".mp4", ".mkv")) == [
        "m.c3d", "w.c3d",
    ]  # fmt: skip


def test_a_run_that_is_stopped_goes_on_to_the_same_end(
    videos: list[Path], rig: Rig, marker_set: MarkerSet, tmp_path: Path
) -> None:
    straight = tmp_path / "straight.c3d"
    track_long(videos, rig, straight, marker_set=marker_set, settings=SHORT_CHUNKS)
    out = tmp_path / "m.c3d"

    def stop(frame: int) -> None:
        if frame == 27:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_long(videos, rig, out, marker_set=marker_set, settings=SHORT_CHUNKS, on_frame=stop)
    assert not out.exists()
    resumed: list[float] = []
    track_long(
        videos, rig, out, marker_set=marker_set, settings=SHORT_CHUNKS, on_resume=resumed.append
    )

    assert resumed == [pytest.approx(0.4)]
    assert out.read_bytes() == straight.read_bytes()
    assert not part_folder(out).exists()


def test_other_settings_or_videos_begin_anew(
    videos: list[Path], rig: Rig, marker_set: MarkerSet, tmp_path: Path
) -> None:
    out = tmp_path / "m.c3d"

    def stopped(frame: int) -> None:
        if frame == 20:
            raise KeyboardInterrupt

    def leave_something() -> None:
        with pytest.raises(KeyboardInterrupt):
            track_long(videos, rig, out, settings=SHORT_CHUNKS, on_frame=stopped)
        assert list(part_folder(out).glob("tracked_*.npz"))

    def resumes(settings: LongSettings) -> bool:
        told: list[float] = []
        track_long(videos, rig, out, settings=settings, on_resume=told.append)
        return bool(told)

    leave_something()
    assert resumes(SHORT_CHUNKS)
    leave_something()
    assert not resumes(LongSettings(chunk_s=0.25, overlap_s=0.1))
    leave_something()
    os.utime(videos[0], (1, 1))
    assert not resumes(SHORT_CHUNKS)


def test_without_a_marker_set_tracks_are_joined_over_chunks(
    videos: list[Path], rig: Rig, short_take: Take, tmp_path: Path
) -> None:
    found = track_long(videos, rig, tmp_path / "m.c3d", settings=SHORT_CHUNKS)

    truth = take_truth(short_take).marker_positions
    tracks = read_c3d(found.path)
    d = np.linalg.norm(tracks.positions[:, :, None] - truth[:, None], axis=3)
    seen = ~np.isnan(tracks.positions[..., 0])
    own = np.where(np.isnan(d), np.inf, d).argmin(axis=2)
    for m in range(len(found.names)):
        assert len(set(own[seen[:, m], m].tolist())) == 1
    whole = sum(bool(seen[:, m].sum() >= 28) for m in range(len(found.names)))
    assert whole >= 27
    assert found.labelling is None and found.person is None


def test_a_neutral_frame_in_a_later_chunk_names_the_earlier_ones(
    videos: list[Path], rig: Rig, marker_set: MarkerSet, short_take: Take, tmp_path: Path
) -> None:
    settings = LongSettings(chunk_s=0.2, overlap_s=4 / 60, neutral_frame=14)

    found = track_long(videos, rig, tmp_path / "m.c3d", marker_set=marker_set, settings=settings)

    truth = take_truth(short_take).marker_positions
    assert short_take.markers is not None
    rows = [short_take.markers.glue.names.index(n) for n in found.names]
    error = np.linalg.norm(read_c3d(found.path).positions - truth[:, rows], axis=2)
    assert np.isnan(error).mean() < 0.03
    assert np.nanmax(error) < 1.0
    beyond = LongSettings(chunk_s=0.2, overlap_s=4 / 60, neutral_s=5.0)
    with pytest.raises(InputError, match="neutral frame is behind the end of the take"):
        track_long(videos, rig, tmp_path / "n.c3d", marker_set=marker_set, settings=beyond)


def test_a_second_run_on_the_same_take_is_refused(
    videos: list[Path], rig: Rig, tmp_path: Path
) -> None:
    out = tmp_path / "m.c3d"
    with alone_in(part_folder(out)):
        code = (
            "import sys; from pathlib import Path;"
            "from facewright.core.files import alone_in\n"
            "with alone_in(Path(sys.argv[1])): pass"
        )
        command = [sys.executable, "-c", code, str(part_folder(out))]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "another run is working in this folder" in done.stderr


def test_bad_input_leaves_nothing_behind(videos: list[Path], rig: Rig, tmp_path: Path) -> None:
    whole = videos[1].read_bytes()
    videos[1].write_bytes(whole[: len(whole) // 2])
    before = sorted(tmp_path.iterdir())

    with pytest.raises(FileFormatError, match=videos[1].name):
        track_long(videos, rig, tmp_path / "m.c3d")

    assert sorted(tmp_path.iterdir()) == before


def film_dots(path: Path, rig: Rig, truth: Floats) -> Path:
    size = rig[path.stem].image_size
    y, x = np.mgrid[: size[1], : size[0]]
    with VideoWriter(path, size, 60, crf=8) as writer:
        for points in truth:
            level = np.full(size[::-1], 30.0)
            for cx, cy in rig[path.stem].project(points):
                if np.isfinite(cx):
                    level += 180 * np.clip(3.5 - np.hypot(x - cx, y - cy), 0, 1)
            writer.write(np.clip(np.rint(level), 0, 255).astype(np.uint8))
    return path


def test_a_face_that_is_away_for_a_while_is_missing_then(tmp_path: Path) -> None:
    rig = face_rig(np.random.default_rng(2), n_cameras=3, image_size=(320, 180))
    rest = np.array(
        [[-50.0, 40, 10], [50, 55, 12], [5, -8, 55], [-40, -45, 20], [38, -42, 22], [2, -85, 20]]
    )
    truth = np.tile(rest, (40, 1, 1)) + np.arange(40)[:, None, None] * 0.1
    truth[12:26] = np.nan
    videos = [film_dots(tmp_path / f"{name}.mp4", rig, truth) for name in rig]

    settings = LongSettings(chunk_s=10 / 60, overlap_s=2 / 60)
    found = track_long(videos, rig, tmp_path / "m.c3d", settings=settings)

    tracks = read_c3d(found.path)
    seen = ~np.isnan(tracks.positions[..., 0])
    assert found.n_frames == 40
    assert not seen[12:26].any()
    assert (seen[:12].sum(axis=1) == 6).all() and (seen[27:].sum(axis=1) == 6).all()


def test_chunks_are_read_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(20, 3, 3))
    positions[4, 1] = np.nan
    root = rng.normal(size=(20, 3, 3, 3))
    covariances = root @ np.swapaxes(root, -1, -2)
    residual, n_views = rng.random((20, 3)), rng.integers(2, 5, (20, 3)).astype(np.int32)
    tracks = Trajectories(
        np.arange(20) / 60, ("a", "b", "c"), positions, covariances,
        residual_px=residual, n_views=n_views,
    )  # fmt: skip
    files = ChunkFiles(tmp_path)

    files.write("tracked", 3, tracks, more=np.arange(5))
    found, more = files.read("tracked", 3)

    assert files.has("tracked", 3) and not files.has("labelled", 3)
    assert found.names == tracks.names
    np.testing.assert_array_equal(found.positions, positions)
    np.testing.assert_array_equal(found.source, tracks.source)
    np.testing.assert_array_equal(found.n_views, n_views)
    np.testing.assert_allclose(found.covariances, covariances, rtol=1e-6, atol=1e-9)  # type: ignore
    np.testing.assert_allclose(found.residual_px, residual, rtol=1e-6)  # type: ignore
    assert list(more) == ["more"]


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on(
    videos: list[Path], rig: Rig, filmed_take: FilmedTake, tmp_path: Path, repository: Path
) -> None:
    """As the machine does it: no exception, no clean-up."""
    out = tmp_path / "m.c3d"
    code = (
        "import sys, time; from pathlib import Path\n"
        "from facewright.core.formats.rig_json import read_rig\n"
        "from facewright.tracking.long_takes import LongSettings, track_long\n"
        "def wait(frame):\n"
        "    if frame == 20:\n"
        "        time.sleep(400)\n"
        "track_long([Path(p) for p in sys.argv[3:]], read_rig(Path(sys.argv[1])),\n"
        "           Path(sys.argv[2]), on_frame=wait,\n"
        "           settings=LongSettings(chunk_s=0.2, overlap_s=4 / 60))\n"
    )
    command = [sys.executable, "-c", code, str(filmed_take.rig), str(out), *map(str, videos)]
    process = subprocess.Popen(command, cwd=repository)
    end = time.monotonic() + 400
    while not (part_folder(out) / "tracked_00000.npz").exists():
        assert time.monotonic() < end and process.poll() is None
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    told: list[float] = []

    track_long(videos, rig, out, settings=SHORT_CHUNKS, on_resume=told.append)

    assert told == [pytest.approx(0.2)]
    straight = track_long(videos, rig, tmp_path / "s.c3d", settings=SHORT_CHUNKS)
    found, expected = read_c3d(out), read_c3d(straight.path)
    assert found.names == expected.names
    # other processes, other memory: sums may differ in their last digits
    np.testing.assert_allclose(found.positions, expected.positions, rtol=0, atol=1e-3)
