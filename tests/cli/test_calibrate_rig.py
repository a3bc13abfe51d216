"""`facewright calibrate rig`: formats, worlds, videos with troubles, and bad input.

Boards are drawn through known pinhole cameras; for videos, row by row at each row's own time.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from facewright.cli.main import app
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.formats.rig_files import read_any_rig
from facewright.core.formats.rig_json import read_rig, write_rig
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.film import FilmedTake

SIZE = 480, 360
K = np.array([[600.0, 0, 243.0], [0, 603.0, 177.0], [0, 0, 1]])
BOARD = parse_board("chessboard:9x6:25")
ZOOM = 3
RATE_HZ = 30.0
Floats = NDArray[np.float64]
PoseAt = Callable[[float], Rigid]


def facewright(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def one_line(result: Result) -> str:
    """The one line that says what was wrong with the input."""
    assert result.exit_code == 1, result.output
    lines = [line for line in result.stderr.splitlines() if " done in " not in line]
    assert len(lines) == 1, result.stderr
    return lines[0]


def read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


# Boards drawn ------------------------------------------------------------------------------------


def printed(per_mm: float = 3.0) -> tuple[NDArray[np.uint8], Floats]:
    """The sheet's picture, and its pixels from mm."""
    low, high = BOARD.sheet_box[:2], BOARD.sheet_box[2:]
    w, h = np.ceil((high - low) * per_mm).astype(int)
    y, x = np.mgrid[0:h, 0:w] + 0.5
    ink = BOARD.is_black(np.stack([x, y], axis=-1) / per_mm + low)
    to_sheet = np.array([[per_mm, 0, -low[0] * per_mm - 0.5], [0, per_mm, -low[1] * per_mm - 0.5],
                         [0, 0, 1]])  # fmt: skip
    return np.where(ink, 30, 160).astype(np.uint8), to_sheet


SHEET = printed()


def rows_shot(camera: Camera, pose: Rigid, first: int, last: int) -> NDArray[np.uint8]:
    """Some rows of a picture, several times oversampled: a pinhole's homography."""
    z = (ZOOM - 1) / 2
    zoom = np.array([[ZOOM, 0, z], [0, ZOOM, z - ZOOM * first], [0, 0, 1]])
    placed = (camera.camera_from_world @ pose).matrix
    H = zoom @ camera.matrix @ placed[:3][:, [0, 1, 3]] @ np.linalg.inv(SHEET[1])
    w, h = camera.image_size[0], last - first
    wide = cv2.warpPerspective(SHEET[0], H, (w * ZOOM, h * ZOOM), borderValue=90)
    return np.asarray(cv2.resize(wide, (w, h), interpolation=cv2.INTER_AREA), np.uint8)


def shot(
    camera: Camera, pose_at: PoseAt, time_s: float, readout_s: float = 0.0
) -> NDArray[np.uint8]:
    """A picture whose middle row is taken at a time, and the others before and after it."""
    h = camera.image_size[1]
    step = 15 if readout_s else h
    bands = []
    for first in range(0, h, step):
        share = (first + (step - 1) / 2) / (h - 1) - 0.5
        bands.append(rows_shot(camera, pose_at(time_s + readout_s * share), first, first + step))
    return np.concatenate(bands)


def camera_at(yaw_deg: float, pitch_deg: float = 0.0) -> Camera:
    """One that looks from 600 mm at the origin."""
    turn = Rotation.from_euler("YX", [yaw_deg, pitch_deg], degrees=True).as_matrix().T
    return Camera(SIZE, K, Rigid.from_rotation(turn, [0, 0, 600]))


def held(turn: Floats, place: Floats) -> Rigid:
    """The board turned (rad) about its middle, which lies off the origin (mm)."""
    R = Rotation.from_rotvec(turn).as_matrix()
    return Rigid.from_rotation(R, np.append(place, 0) - R @ BOARD.object_points().mean(axis=0))


def hand(t: float) -> Rigid:
    """How a lively hand holds a board."""
    k = np.arange(5)
    slow, quick = 1.3 + 0.37 * k, 4.1 + 0.93 * k
    swell = np.exp(-(((t - 0.7 - 0.5 * k) / 0.5) ** 2))
    way = 0.6 * np.sin(slow * t + k) + (0.2 + 0.5 * swell) * np.sin(quick * t + 2 * k)
    return held(0.4 * way[:3], np.array([25.0, 20.0]) * way[3:])


POSES = [
    held(np.array(turn), np.array(place))
    for turn, place in (
        ((0.0, 0.0, 0.0), (0.0, 0.0)), ((0.5, 0.1, 0.1), (-30, 20)), ((-0.5, 0.0, -0.2), (30, -20)),
        ((0.1, 0.5, 0.1), (-20, -30)), ((0.0, -0.5, 0.3), (20, 30)), ((0.4, 0.4, -0.1), (0, 25)),
    )
]  # fmt: skip
TRUTH = Rig({"a": camera_at(-20), "b": camera_at(20)})


def shoot(folder: Path, truth: Rig = TRUTH) -> tuple[str | Path, ...]:
    """Pictures of every camera; the words that begin the command."""
    for name in truth:
        (folder / name).mkdir(parents=True)
        for i, pose in enumerate(POSES):
            picture = rows_shot(truth[name], pose, 0, SIZE[1])
            Image.fromarray(picture).save(folder / name / f"view{i}.png")
    return begin(folder, truth)


def begin(folder: Path, truth: Rig = TRUTH) -> tuple[str | Path, ...]:
    lenses = folder / "lenses.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in truth}))
    return ("calibrate", "rig", folder, "--lenses", lenses)


def film(
    folder: Path,
    *,
    seconds: float = 3.0,
    late_s: float = 0.0,
    lost: Collection[int] = (),
    is_told: bool = True,
    jitter: float = 0.0,
    readout_s: float = 0.0,
    flashes: Collection[float] = (),
) -> tuple[str | Path, ...]:
    """Videos of a waved board; camera b begins later, and loses frames."""
    rng = np.random.default_rng(11)
    for name, start_s in (("a", 0.0), ("b", late_s)):
        path, base = folder / f"{name}.mp4", Fraction(1, 90_000)
        with VideoWriter(path, SIZE, RATE_HZ, crf=8, time_base=base) as video:
            for k in range(round(seconds * RATE_HZ)):
                if name == "b" and k in lost:
                    continue
                stamp = (k + (jitter * rng.uniform(-1, 1) if k else 0)) / RATE_HZ
                t = stamp + start_s
                light = 1 + sum(0.4 * np.exp(-(t - f) / 0.03) for f in flashes if t >= f)
                picture = light * shot(TRUTH[name], hand, t, readout_s)
                picture = np.rint(picture + rng.normal(0, 1, picture.shape))
                grey = np.clip(picture, 0, 255).astype(np.uint8)
                video.write(np.repeat(grey[..., None], 3, axis=2), stamp if is_told else None)
    return begin(folder)


def farthest_mm(found: Rig, truth: Rig = TRUTH) -> float:
    """Largest distance of a camera's centre from its true place, in the first camera's frame."""
    first = found.names[0]

    def place(rig: Rig, name: str) -> Floats:
        return rig[first].camera_from_world.apply(rig[name].position)

    return max(float(np.linalg.norm(place(found, n) - place(truth, n))) for n in found)


# Formats and worlds ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["r.json", "opencv.yaml", "camchain.yaml", "model"])
def test_rig_is_written_in_the_format_its_name_asks_for(tmp_path: Path, name: str) -> None:
    words = shoot(tmp_path / "take")

    result = facewright(*words, "--out", tmp_path / name)

    assert result.exit_code == 0, result.output
    found = read_any_rig(tmp_path / name)
    assert found.names == ("a", "b")
    assert farthest_mm(found) < 0.5
    assert (tmp_path / "model" / "images.txt").is_file() == (name == "model")


def test_rig_that_a_format_cannot_hold_is_kept_and_that_is_said(tmp_path: Path) -> None:
    _, _, folder, _, lenses = shoot(tmp_path / "take")
    strong = np.array([0.0, 0, 0, 0, 1e-9])  # Kalibr has no third radial coefficient
    write_rig(
        Path(lenses),
        Rig({n: Camera(SIZE, K, Rigid.identity(), "opencv", strong) for n in TRUTH}),
    )
    out, kept = tmp_path / "camchain.yaml", tmp_path / "camchain.json"

    result = facewright("calibrate", "rig", folder, "--lenses", lenses, "--out", out)

    assert "radtan" in one_line(result)
    assert str(kept) in one_line(result)
    assert not out.exists()
    assert farthest_mm(read_rig(kept)) < 0.5


def test_head_is_where_the_cameras_look(tmp_path: Path) -> None:
    truth = Rig({"a": camera_at(-20), "b": camera_at(20), "c": camera_at(0, 15)})
    words = shoot(tmp_path / "take", truth)

    result = facewright(*words, "--world", "head", "--out", tmp_path / "r.json")

    assert result.exit_code == 0, result.output
    found = read_rig(tmp_path / "r.json")
    for name in truth:
        # all cameras look from 600 mm at the point that becomes the origin
        np.testing.assert_allclose(found[name].camera_from_world.apply([0.0, 0, 0]), [0, 0, 600],
                                   atol=0.5)  # fmt: skip
    down = np.mean([c.camera_from_world.rotation[1] for c in found.cameras.values()], axis=0)
    np.testing.assert_allclose(down / np.linalg.norm(down), [0, -1, 0], atol=1e-9)
    middle = np.mean([c.position for c in found.cameras.values()], axis=0)
    assert abs(middle[0]) < 1e-6
    assert middle[2] > 500


# Videos ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_frames_that_are_missing_do_not_part_what_belongs_together(
    tmp_path: Path, jitter: float
) -> None:
    words = film(tmp_path, lost=(8, 20, 21, 50), jitter=jitter)
    told = tmp_path / "t.json"

    result = facewright(*words, "--no-shutter", "--json", told)

    assert result.exit_code == 0, result.output
    assert ("uneven times" if jitter else "b 4 of 90") in result.stderr
    assert "warning" not in result.stderr
    assert farthest_mm(read_rig(tmp_path / "rig.json")) < 1.0
    found = read_json(told)
    assert len(found["notes"]) == 1
    assert found["rms_px"] < 0.2


@pytest.mark.slow
def test_frames_that_are_missing_without_a_trace_are_warned_about(tmp_path: Path) -> None:
    words = film(tmp_path, lost=(8, 20, 21, 50), is_told=False)

    result = facewright(*words, "--no-shutter")

    assert result.exit_code == 0, result.output
    assert "warning: the videos have different numbers of frames (a 90, b 86)" in result.stderr
    assert "do not fit together" in result.stderr


@pytest.mark.slow
def test_rolling_shutter_is_told_in_words_and_mm(tmp_path: Path) -> None:
    words = film(tmp_path, readout_s=0.015)
    told, page = tmp_path / "t.json", tmp_path / "page.html"

    result = facewright(*words, "--json", told, "--report", page)

    assert result.exit_code == 0, result.output
    for name in "ab":
        found = read_json(told)["rolling_shutter"][name]
        # bands of 15 rows are exposed at once: a twelfth of a ms of jags
        assert abs(found["readout_s"] - 0.015) < 2e-4
        assert found["matters"]
        assert found["bend_mm"] > 0.1
        assert f"warning: {name}: a rolling shutter: 15." in result.stderr.replace("14.9", "15.")
    assert "rolling shutter" in page.read_text(encoding="utf-8")
    assert page.with_suffix(".png").is_file()


@pytest.mark.slow
def test_global_shutter_is_not_warned_about(tmp_path: Path) -> None:
    words = film(tmp_path, seconds=2.0)
    told = tmp_path / "t.json"

    result = facewright(*words, "--json", told)

    assert result.exit_code == 0, result.output
    found = read_json(told)
    assert found["warnings"] == []
    for name in "ab":
        assert abs(found["rolling_shutter"][name]["readout_s"]) < 1e-4
    assert 20 < found["board_speed_mm_s"]["a"] < 200


@pytest.mark.slow
@pytest.mark.parametrize("are_lenses_known", [True, False])
def test_motion_of_the_board_brings_videos_into_step(
    tmp_path: Path, are_lenses_known: bool
) -> None:
    late_s = 0.163
    words = film(tmp_path, late_s=late_s, lost=(30, 31, 60))
    told = tmp_path / "t.json"
    words = words if are_lenses_known else words[:3]

    result = facewright(
        *words, "--sync", "motion", "--max-offset", "1", "--no-shutter", "--json", told
    )

    assert result.exit_code == 0, result.output
    found = read_json(told)
    # the goal is a twentieth of a frame, 1.7 ms
    assert abs(found["clocks"]["b"]["offset_s"] + late_s) < 2e-4
    assert found["rms_px"] < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("sync", "limit_s"), [("flash", 0.034), ("flash-light", 0.002)])
def test_flash_brings_videos_into_step(tmp_path: Path, sync: str, limit_s: float) -> None:
    late_s = 0.163
    words = film(tmp_path, late_s=late_s, flashes=(1.013,))
    told = tmp_path / "t.json"

    result = facewright(*words, "--sync", sync, "--max-offset", "1", "--no-shutter", "--json", told)

    assert result.exit_code == 0, result.output
    found = read_json(told)
    clock = found["clocks"]["b"]
    assert abs(clock["offset_s"] + late_s) < limit_s
    assert abs(clock["offset_s"] + late_s) < 3 * clock["offset_sd_s"]
    # 14 ms of doubt let the board go far: said; one of a few tenths of a ms does not
    assert ("its clock is sure to" in result.stderr) == (sync == "flash")


# Markers -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_camera_that_was_moved_is_found_by_the_performers_markers(
    filmed_take: FilmedTake, tmp_path: Path
) -> None:
    truth = read_rig(filmed_take.rig)
    turn = Rotation.from_rotvec([0.0, np.deg2rad(0.4), 0.0]).as_matrix()
    knock = Rigid.from_rotation(turn, [2.0, 0.0, 0.0])
    cam2 = replace(truth["cam2"], camera_from_world=knock @ truth["cam2"].camera_from_world)
    stale, told = tmp_path / "stale.json", tmp_path / "t.json"
    write_rig(stale, Rig({**truth.cameras, "cam2": cam2}))
    out = tmp_path / "now.json"

    result = facewright(
        "calibrate", "rig", filmed_take.folder, "--markers", "--rig", stale, "--out", out,
        "--json", told,
    )  # fmt: skip

    assert result.exit_code == 0, result.output
    shifts = {s["camera"]: s for s in read_json(told)["camera_shifts"]}
    assert [n for n, s in shifts.items() if s["moved"]] == ["cam2"]
    assert abs(shifts["cam2"]["degrees"] - 0.4) < 0.05
    found = read_rig(out)
    for name in truth:
        assert np.linalg.norm(found[name].position - truth[name].position) < 1.0, name


# Bad input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--sync", "light"), "flash-light"),
        (("--exposure", "5"), "--sync flash"),
        (("--model", "fisheye"), "opencv5"),
        (("--model", "opencv5", "--lenses", "x.json"), "--model"),
        (("--max-views", "1"), "--max-views"),
        (("--max-offset", "-3"), "--max-offset"),
        (("--distance", "0"), "--distance"),
        (("--rig", "r.json"), "--markers alone"),
        (("--markers", "--wand", "0,45,120"), "--wand"),
        (("--markers", "--sync", "motion"), "--sync"),
        (("--markers", "--lenses", "r.json"), "--lenses"),
        (("--markers", "--world", "view3"), "--world"),
    ],
)
def test_wrong_usage_exits_with_2(tmp_path: Path, words: tuple[str, ...], told: str) -> None:
    result = facewright("calibrate", "rig", tmp_path, *words)

    assert result.exit_code == 2, result.output
    assert told in result.stderr


def test_wrong_arguments_are_one_line_before_the_work(tmp_path: Path) -> None:
    words = shoot(tmp_path / "take")
    (tmp_path / "file").write_text("x")
    (tmp_path / "bad.json").write_text("{")
    before = sorted(tmp_path.rglob("*"))

    def said(*more: str | Path) -> str:
        return one_line(facewright(*words, *more))

    assert ".json (ours)" in said("--out", tmp_path / "rig.txt")
    assert "is a file" in said("--out", tmp_path / "file")
    assert "ends in .html" in said("--report", tmp_path / "page.pdf")
    assert "is a folder" in said("--json", tmp_path)
    assert "bad.json" in said("--lenses", tmp_path / "bad.json")
    assert "no-lens.json" in said("--lenses", tmp_path / "no-lens.json")
    assert "chessboard:9x6:25" in said("--board", "chess")
    assert "expected camera, head or a view: view0" in said("--world", "here")
    assert "needs videos" in said("--sync", "flash")
    assert "0,45,120" in said("--wand", "long")
    assert "folders of pictures" in said("--wand", "0,45,120")
    without = one_line(facewright(*words[:3], "--wand", "0,45,120"))
    assert "--lenses" in without
    markers = one_line(facewright(*words[:3], "--markers", "--rig", words[4]))
    assert "folders of pictures" in markers
    assert sorted(tmp_path.rglob("*")) == before


def test_cameras_that_look_the_same_way_have_no_head(tmp_path: Path) -> None:
    side = Camera(SIZE, K, Rigid.from_rotation(np.eye(3), [60, 0, 600]))
    truth = Rig({"a": camera_at(0), "b": side})
    words = shoot(tmp_path / "take", truth)

    assert "--world camera" in one_line(facewright(*words, "--world", "head"))


def test_broken_videos_are_one_line(tmp_path: Path) -> None:
    words = film(tmp_path, seconds=0.5)
    whole = (tmp_path / "b.mp4").read_bytes()

    def said(content: bytes, *more: str) -> str:
        (tmp_path / "b.mp4").write_bytes(content)
        return one_line(facewright(*words, *more))

    for sync in ("none", "sound", "flash", "motion"):
        assert "b.mp4, file: expected a video, found an empty file" in said(b"", "--sync", sync)
    assert "b.mp4" in said(whole[: len(whole) // 2])
    assert "sound track" in said(whole, "--sync", "sound")
    assert "no flash" in said(whole, "--sync", "flash")
    assert not (tmp_path / "rig.json").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent")
def test_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    words = film(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    run = "from facewright.cli.main import app; app()"
    asked = [str(w) for w in (*words, "--report", tmp_path / "p.html")]
    with subprocess.Popen([sys.executable, "-c", run, *asked], stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert b"searching a" in process.stderr.readline()
        time.sleep(0.3)  # in the midst of the second video
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()

    assert process.returncode == 130, rest
    assert rest.strip().endswith(b"interrupted; nothing half-written")
    assert b"Traceback" not in rest
    assert sorted(tmp_path.rglob("*")) == before
