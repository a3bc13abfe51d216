"""A filmed take: its files, and their truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from facewright.core.audio import read_audio
from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.mesh import vertex_normals
from facewright.core.video import probe_video, read_frames
from facewright.datasets_synthetic.film import WORK_FOLDER, FilmedTake, film_take
from facewright.datasets_synthetic.film_views import open_views
from facewright.datasets_synthetic.take_settings import (
    TakeSettings,
    read_take_settings,
    settings_for,
    settings_with,
)
from facewright.datasets_synthetic.takes import Take, make_take, take_truth


def test_all_files_are_there_and_say_what_they_should(
    short_take: Take, filmed_take: FilmedTake
) -> None:
    assert [p.name for p in filmed_take.videos] == [f"cam{i}.mp4" for i in range(4)]
    for path in filmed_take.videos:
        info = probe_video(path)
        assert (info.width, info.height) == (1280, 720)
        assert info.rate_hz == pytest.approx(60)
        assert info.n_frames == len(short_take.time_s)
        # a key frame in half a second; below 2 Mbit/s over 2 s and longer
        assert 8 * path.stat().st_size / info.duration_s < 5e6
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
    assert filmed_take.marker_set is not None
    assert short_take.marker_set is not None
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

    assert short_take.marker_set is not None
    assert saved["marker_names"].tolist() == list(short_take.marker_set.labels)
    np.testing.assert_array_equal(saved["time_s"], np.arange(T) / 60)
    np.testing.assert_array_equal(saved["marker_positions"], truth.marker_positions)
    np.testing.assert_array_equal(saved["faps"], truth.faps)
    np.testing.assert_array_equal(saved["head_quaternion"], truth.head_quaternion)
    np.testing.assert_array_equal(saved["landmarks"][:, 0], next(iter(truth.landmarks.values())))
    assert saved["faps"].shape == (T, 68)
    assert saved["marker_pixels"].shape == (T, 4, M, 2)
    assert saved["marker_visible"].shape == (T, 4, M)
    assert saved["camera_names"].tolist() == list(short_take.rig)
    for c, name in enumerate(short_take.rig):
        np.testing.assert_allclose(
            saved["marker_pixels"][:, c],
            short_take.rig[name].project(truth.marker_positions),
            atol=1e-6,
        )
        np.testing.assert_array_equal(saved[f"frame_{name}"], np.arange(T))
    order = ("IRISD", "ES", "ENS", "MNS", "MW")
    np.testing.assert_array_equal(saved["fapu"], [short_take.head.fapu.as_dict()[k] for k in order])
    assert not any(a.dtype == object for a in saved.values())


def test_frames_are_the_renderers_but_for_coding(short_take: Take, filmed_take: FilmedTake) -> None:
    views = open_views(short_take)
    for c, path in enumerate(filmed_take.videos[:2]):
        rendered = views.film(
            path.stem, 20 / 60, np.random.default_rng([short_take.seed, 7, c, 20])
        )
        frames = read_frames(path, gray=True)
        decoded = next(f.image for f in frames if f.index == 20)
        frames.close()
        image = rendered.image.astype(np.float64)
        limited = 16 + image * 219 / 255  # luma of limited range, as coded
        dots = image > 150
        assert np.abs(decoded - limited)[dots].mean() < 6
        assert np.corrcoef(decoded.ravel(), limited.ravel())[0, 1] > 0.99


class _Stop(Exception):
    pass


def _read_all(folder: Path) -> dict[str, bytes]:
    return {
        p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".npz", ".toml", ".json")
    }


@pytest.fixture
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("facewright.datasets_synthetic.film.PIECE_S", 0.25)


@pytest.mark.usefixtures("short_pieces")
def test_an_interrupted_take_goes_on_to_the_same_end(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        4,
        seconds=1.0,
        rate_hz=12.0,
        **{"cameras.count": 2, "cameras.image_size": (320, 192), "clocks.dropped": 0.2},
    )
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    whole.mkdir()
    broken.mkdir()
    film_take(take, whole)

    def stop(frame: int) -> None:
        if frame == 7:
            raise _Stop

    with pytest.raises(_Stop):
        film_take(take, broken, on_frame=stop)
    assert [p.name for p in broken.iterdir()] == [WORK_FOLDER]  # nothing half-written in sight
    told: list[int] = []
    left: list[int] = []
    film_take(take, broken, on_frame=told.append, on_resume=left.append)

    assert left == [2]
    assert told == list(range(12))
    assert _read_all(broken) == _read_all(whole)
    for name in ("cam0.mp4", "cam1.mp4"):
        pair = [list(read_frames(d / name, gray=True)) for d in (whole, broken)]
        assert [f.time_s for f in pair[0]] == [f.time_s for f in pair[1]]
        for a, b in zip(*pair, strict=True):
            np.testing.assert_array_equal(a.image, b.image)
    assert WORK_FOLDER not in [p.name for p in broken.iterdir()]


def test_pieces_of_another_take_are_not_used(
    make_plain_take: Callable[..., Take], tmp_path: Path, short_pieces: None
) -> None:
    small = {"cameras.count": 1, "cameras.image_size": (160, 120)}
    first = make_plain_take(1, seconds=0.5, rate_hz=12.0, **small)
    other = make_plain_take(2, seconds=0.5, rate_hz=12.0, **small)

    def stop(frame: int) -> None:
        if frame == 4:
            raise _Stop

    with pytest.raises(_Stop):
        film_take(first, tmp_path, on_frame=stop)
    left: list[int] = []
    film_take(other, tmp_path, on_resume=left.append)

    assert left == []
    assert read_take_settings(tmp_path / "take.toml")[1] == 2


@pytest.mark.usefixtures("short_pieces")
def test_dropped_frames_late_clocks_and_stamps_are_in_the_truth(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        5,
        seconds=1.0,
        rate_hz=30.0,
        **{
            "cameras.count": 2,
            "cameras.image_size": (320, 192),
            "clocks.dropped": 0.2,
            "clocks.max_offset_s": 0.1,
            "clocks.max_drift_ppm": 100.0,
            "clocks.jitter_frames": 0.3,
        },
    )

    filmed = film_take(take, tmp_path)

    with np.load(filmed.truth) as z:
        for c, path in enumerate(filmed.videos):
            name = path.stem
            frames = list(read_frames(path, gray=True))
            stamps = z[f"frame_stamp_s_{name}"]
            assert len(frames) == len(stamps) == len(z[f"frame_{name}"]) < 30
            np.testing.assert_allclose([f.time_s for f in frames], stamps, atol=2e-5)
            world = z["clock_offset_s"][c] + (1 + z["clock_drift"][c]) * stamps
            np.testing.assert_allclose(z[f"frame_world_s_{name}"], world, atol=1e-12)
            # where the markers are in the pictures is where they are when the picture is taken
            for row, beat in enumerate(z[f"frame_{name}"][:5]):
                pose = take.pose(float(world[row]))
                assert take.markers is not None
                normals = vertex_normals(pose.world_vertices, take.head.mesh.triangles)
                centres, _ = take.markers.places(pose.world_vertices, normals)
                expected = take.rig[name].project(centres)
                np.testing.assert_allclose(z["marker_pixels"][beat, c], expected, atol=1e-6)
            lost = np.setdiff1d(np.arange(30), z[f"frame_{name}"])
            assert np.isnan(z["marker_pixels"][lost, c]).all()


def test_lossless_video_holds_the_rendered_pixels(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        6,
        seconds=0.5,
        rate_hz=10.0,
        **{"cameras.count": 1, "cameras.image_size": (320, 192), "video.codec": "lossless"},
    )

    filmed = film_take(take, tmp_path)

    views = open_views(take)
    for frame in read_frames(filmed.videos[0], gray=True):
        rng = np.random.default_rng([6, 7, 0, frame.index])
        expected = views.film("cam0", frame.index / 10, rng).image
        np.testing.assert_array_equal(frame.image, expected)


def test_a_knocked_camera_sees_everything_from_elsewhere(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        7,
        seconds=0.5,
        rate_hz=20.0,
        **{"cameras.count": 2, "cameras.image_size": (320, 192), "events.knocked": True},
    )
    assert take.knock is not None

    filmed = film_take(take, tmp_path)

    with np.load(filmed.truth) as z:
        assert z["knocked_camera"].tolist() == [take.knock.camera]
        c = z["camera_names"].tolist().index(take.knock.camera)
        pixels, positions = z["marker_pixels"], z["marker_positions"]
        after = z["time_s"] >= z["knock_s"][0]
        assert 0 < after.sum() < len(after)
        still = take.rig[take.knock.camera].project(positions)
        moved = take.knock.after.project(positions)
        np.testing.assert_allclose(pixels[~after, c], still[~after], atol=1e-6)
        np.testing.assert_allclose(pixels[after, c], moved[after], atol=1e-6)
        np.testing.assert_allclose(
            pixels[:, 1 - c], take.rig[take.rig.names[1 - c]].project(positions), atol=1e-6
        )
    # the rig file still says what it said
    said = read_rig(filmed.rig)[take.knock.camera]
    np.testing.assert_allclose(said.position, take.rig[take.knock.camera].position, atol=1e-9)


def test_a_wand_keeps_its_length(tmp_path: Path) -> None:
    small = {"seconds": 0.5, "cameras.rate_hz": 20.0, "cameras.image_size": (640, 360)}
    take = make_take(8, settings_with(settings_for("wand"), small))

    filmed = film_take(take, tmp_path)

    with np.load(filmed.truth) as z:
        balls = z["marker_positions"]
        np.testing.assert_allclose(np.linalg.norm(balls[:, 2] - balls[:, 0], axis=1), 120.0)
        np.testing.assert_allclose(np.linalg.norm(balls[:, 1] - balls[:, 0], axis=1), 45.0)
        assert np.ptp(balls[:, 0], axis=0).max() > 5
        for c, name in enumerate(take.rig):
            np.testing.assert_allclose(
                z["marker_pixels"][:, c], take.rig[name].project(balls), atol=1e-6
            )
            frame = next(read_frames(tmp_path / f"{name}.mp4", gray=True)).image
            for place, seen in zip(
                z["marker_pixels"][0, c], z["marker_visible"][0, c], strict=True
            ):
                if seen > 0.99:
                    column, row = np.rint(place).astype(int)
                    assert frame[row, column] > 180
    assert filmed.marker_set is None


def test_a_voice_and_claps_are_heard_by_every_camera(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        9,
        seconds=1.5,
        rate_hz=8.0,
        **{
            "cameras.count": 2,
            "cameras.image_size": (160, 120),
            "performance.voice": True,
            "performance.style": "speech",
            "events.claps": 1,
        },
    )

    filmed = film_take(take, tmp_path)

    assert filmed.sound is not None
    studio = read_audio(filmed.sound)
    assert studio.duration_s == pytest.approx(1.5)
    with np.load(filmed.truth) as z:
        for c, path in enumerate(filmed.videos):
            heard = read_audio(path)
            start = z["clap_s"][0] + z["sound_delay_s"][c]
            onset = np.flatnonzero(np.abs(heard.samples) > 0.15)[0] / heard.rate_hz
            assert onset == pytest.approx(start, abs=0.025)  # AAC smears its start
    assert np.abs(studio.samples[int(0.5 * studio.rate_hz) :]).max() > 0.05


def test_a_plain_take_shows_a_face_where_truth_says(tmp_path: Path) -> None:
    asked = {
        "seconds": 0.5,
        "cameras.rate_hz": 6.0,
        "cameras.image_size": (480, 270),
        "actor.head": "ruth",
        "scene.light": "studio",
        "video.rotation_deg": 90,
        "events.flash": True,
    }
    take = make_take(10, settings_with(settings_for("plain"), asked))

    filmed = film_take(take, tmp_path)

    frames = list(read_frames(filmed.videos[0]))
    assert frames[0].image.shape == (270, 480, 3)  # turned upright as players do
    with np.load(filmed.truth) as z:
        names = z["feature_point_names"].tolist()
        nose = z["feature_point_pixels"][0, 0, names.index("9.3")]
        column, row = np.rint(nose).astype(int)
        skin = frames[0].image[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3)
        red, green, blue = skin.mean(axis=0)
        assert red > green > blue  # skin
        assert z["feature_point_visible"][0, 0, names.index("9.3")] == 1
        assert z["flash_s"].shape == (1,)
    assert read_take_settings(filmed.settings) == (take.settings, 10)


def test_all_vertices_are_there_if_asked_for(
    make_plain_take: Callable[..., Take], tmp_path: Path
) -> None:
    take = make_plain_take(
        11, seconds=0.5, rate_hz=6.0, **{"cameras.count": 1, "cameras.image_size": (160, 120)}
    )

    filmed = film_take(take, tmp_path, keep_vertices=True)

    with np.load(filmed.truth) as z:
        found = z["vertices"]
        points = take.head.feature_points.at(found.astype(np.float64))
        np.testing.assert_allclose(points, z["feature_points"], atol=1e-4)


def test_settings_that_ask_for_nothing_special_are_the_demos() -> None:
    assert settings_for("markers") == TakeSettings()
