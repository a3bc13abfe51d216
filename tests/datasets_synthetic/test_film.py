"""A filmed take: its files, and their truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.video import probe_video, read_frames
from facewright.datasets_synthetic.film import FilmedTake, film_take
from facewright.datasets_synthetic.takes import Take, take_truth
from facewright.datasets_synthetic.views import TakeRenderer


def test_all_files_are_there_and_say_what_they_should(
    short_take: Take, filmed_take: FilmedTake
) -> None:
    assert [p.name for p in filmed_take.videos] == [f"cam{i}.mp4" for i in range(4)]
    for path in filmed_take.videos:
        info = probe_video(path)
        assert (info.width, info.height) == (1280, 720)
        assert info.rate_hz == pytest.approx(60)
        assert info.n_frames == len(short_take.time_s)
        assert 8 * path.stat().st_size / info.duration_s < 2.6e6  # less over 2 s and longer
    rig = read_rig(filmed_take.rig)
    point = np.array([10.0, -20, 40])
    for name in rig:
        np.testing.assert_allclose(
            rig[name].project(point), short_take.rig[name].project(point), atol=1e-6
        )
    assert not [p.name for p in filmed_take.folder.iterdir() if "part" in p.name]


def test_the_actors_units_are_measured_to_a_tenth_of_a_millimetre(
    short_take: Take, filmed_take: FilmedTake
) -> None:
    marker_set = read_marker_set(filmed_take.marker_set)

    assert marker_set.labels == short_take.marker_set.labels
    assert marker_set.fapu is not None
    for name, value in marker_set.fapu.as_dict().items():
        true = short_take.head.fapu.as_dict()[name]
        assert abs(value - true) <= 0.05 + 1e-9
        assert round(10 * value) == pytest.approx(10 * value)


def test_the_truth_is_the_takes(short_take: Take, filmed_take: FilmedTake) -> None:
    truth = take_truth(short_take)
    T, M = len(short_take.time_s), 30

    with np.load(filmed_take.truth, allow_pickle=False) as z:
        saved = {name: z[name] for name in z.files}

    assert saved["marker_names"].tolist() == list(short_take.marker_set.labels)
    np.testing.assert_array_equal(saved["time_s"], np.arange(T) / 60)
    np.testing.assert_array_equal(saved["marker_positions"], truth.marker_positions)
    np.testing.assert_array_equal(saved["faps"], truth.faps)
    np.testing.assert_array_equal(saved["head_quaternion"], short_take.head_motion.quaternion)
    np.testing.assert_array_equal(saved["head_translation"], short_take.head_motion.translation)
    assert saved["faps"].shape == (T, 68)
    assert saved["marker_pixels"].shape == (T, 4, M, 2)
    assert saved["marker_visible"].shape == (T, 4, M)
    assert saved["camera_names"].tolist() == list(short_take.rig)
    for c, name in enumerate(short_take.rig):
        np.testing.assert_allclose(
            saved["marker_pixels"][:, c], short_take.rig[name].project(truth.marker_positions)
        )
    order = ("IRISD", "ES", "ENS", "MNS", "MW")
    np.testing.assert_array_equal(saved["fapu"], [short_take.head.fapu.as_dict()[k] for k in order])
    assert not any(a.dtype == object for a in saved.values())


def test_frames_are_the_renderers_but_for_coding(short_take: Take, filmed_take: FilmedTake) -> None:
    rendered = TakeRenderer(short_take).frame(20, np.random.default_rng(0), noise=False)
    for path in filmed_take.videos[:2]:
        frames = read_frames(path, gray=True)
        decoded = next(f.image for f in frames if f.index == 20)
        frames.close()
        image = rendered[path.stem].image.astype(np.float64)
        limited = 16 + image * 219 / 255  # luma of limited range, as coded
        dots = image > 150
        assert np.abs(decoded - limited)[dots].mean() < 6
        assert np.corrcoef(decoded.ravel(), limited.ravel())[0, 1] > 0.995


class _Stop(Exception):
    pass


def test_an_interruption_leaves_nothing_behind(short_take: Take, tmp_path: Path) -> None:
    def stop(frame: int) -> None:
        if frame == 1:
            raise _Stop

    with pytest.raises(_Stop):
        film_take(short_take, tmp_path, on_frame=stop)

    assert list(tmp_path.iterdir()) == []


def test_the_same_seed_is_filmed_to_the_same_bytes(short_take: Take, tmp_path: Path) -> None:
    from dataclasses import replace

    from facewright.core.clip import Clip
    from facewright.core.head_motion import HeadMotion
    from facewright.datasets_synthetic.performances import Performance

    weights, motion = short_take.performance.weights, short_take.head_motion
    n = 3
    brief = replace(
        short_take,
        performance=Performance(
            Clip(weights.time_s[:n], weights.channels, weights.values[-n:]),
            HeadMotion(motion.time_s[:n], motion.quaternion[-n:], motion.translation[-n:]),
        ),
    )
    told: list[int] = []
    files = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        film_take(brief, folder, on_frame=told.append)
        with np.load(folder / "truth.npz") as z:
            truth = {k: z[k] for k in z.files}
        frames = [f.image.copy() for f in read_frames(folder / "cam2.mp4", gray=True)]
        files.append((truth, frames, (folder / "rig.json").read_bytes()))
        shutil.rmtree(folder)

    assert told == [0, 1, 2, 0, 1, 2]
    for key, value in files[0][0].items():
        np.testing.assert_array_equal(value, files[1][0][key])
    for one, other in zip(files[0][1], files[1][1], strict=True):
        np.testing.assert_array_equal(one, other)
    assert files[0][2] == files[1][2]
