"""`facewright calibrate`: real recordings, boards drawn through a known camera, and bad input."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from facewright.cli.drawing import Drawing, stacked
from facewright.cli.main import app
from facewright.core.audio import Audio
from facewright.core.boards import Board, parse_board
from facewright.core.camera import Camera
from facewright.core.formats.points_csv import read_points
from facewright.core.formats.rig_json import read_rig, write_rig
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.core.video_writer import VideoWriter

ALIKE = "chessboard:8x6:25"
SIZE = 640, 480
K = np.array([[800.0, 0, 325.0], [0, 805.0, 236.0], [0, 0, 1]])


def facewright(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def one_line(result: Result) -> str:
    """The one line that says what was wrong with the input."""
    assert result.exit_code == 1, result.output
    lines = [line for line in result.stderr.splitlines() if " done in " not in line]
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("facewright: ")
    return lines[0]


def read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


# Boards drawn ------------------------------------------------------------------------------------


def printed(board: Board, per_mm: float) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The sheet's picture, and its pixels from mm."""
    low, high = board.sheet_box[:2], board.sheet_box[2:]
    w, h = np.ceil((high - low) * per_mm).astype(int)
    y, x = np.mgrid[0:h, 0:w] + 0.5
    ink = board.is_black(np.stack([x, y], axis=-1) / per_mm + low)
    to_sheet = np.array([[per_mm, 0, -low[0] * per_mm - 0.5], [0, per_mm, -low[1] * per_mm - 0.5],
                         [0, 0, 1]])  # fmt: skip
    return np.where(ink, 40, 215).astype(np.uint8), to_sheet


def shot(
    sheet: tuple[NDArray[np.uint8], NDArray[np.float64]], camera: Camera, pose: Rigid
) -> NDArray[np.uint8]:
    """A board as a pinhole camera sees it: a homography, four times oversampled."""
    zoom = np.array([[4.0, 0, 1.5], [0, 4, 1.5], [0, 0, 1]])
    placed = (camera.camera_from_world @ pose).matrix
    H = zoom @ camera.matrix @ placed[:3][:, [0, 1, 3]] @ np.linalg.inv(sheet[1])
    large = (camera.image_size[0] * 4, camera.image_size[1] * 4)
    wide = cv2.warpPerspective(sheet[0], H, large, flags=cv2.INTER_LINEAR, borderValue=120)
    return np.asarray(cv2.resize(wide, camera.image_size, interpolation=cv2.INTER_AREA), np.uint8)


def camera_at(yaw_deg: float, roll_deg: float = 0.0) -> Camera:
    """One that looks from 600 mm at the origin."""
    turn = Rotation.from_euler("YZ", [yaw_deg, roll_deg], degrees=True).as_matrix().T
    return Camera(SIZE, K, Rigid.from_rotation(turn, [0, 0, 600]))


def held(board: Board, turn: tuple[float, float, float], place: tuple[float, float]) -> Rigid:
    """A board turned (rad) about its middle, which lies off the origin (mm)."""
    R = Rotation.from_rotvec(turn).as_matrix()
    return Rigid.from_rotation(R, (*place, 0) - R @ board.object_points().mean(axis=0))


POSES = (
    ((0.0, 0.0, 0.0), (0.0, 0.0)), ((0.5, 0.1, 0.1), (-30, 20)), ((-0.5, 0.0, -0.2), (30, -20)),
    ((0.1, 0.5, 0.1), (-20, -30)), ((0.0, -0.5, 0.3), (20, 30)), ((0.4, 0.4, -0.1), (0, 25)),
)  # fmt: skip


def shoot(folder: Path, board_text: str, cameras: dict[str, Camera], n: int = len(POSES)) -> Rig:
    """Pictures of every camera in a folder of its own."""
    board = parse_board(board_text)
    sheet = printed(board, 4.0)
    for name, camera in cameras.items():
        (folder / name).mkdir(parents=True)
        for i, (turn, place) in enumerate(POSES[:n]):
            picture = shot(sheet, camera, held(board, turn, place))
            Image.fromarray(picture).save(folder / name / f"view{i}.png")
    return Rig(cameras)


def farthest_mm(found: Rig, truth: Rig) -> float:
    """Largest distance of a camera's centre from its true place, in the first camera's frame."""
    first = found.names[0]

    def place(rig: Rig, name: str) -> NDArray[np.float64]:
        return rig[first].camera_from_world.apply(rig[name].position)

    return max(float(np.linalg.norm(place(found, n) - place(truth, n))) for n in found)


# tsai --------------------------------------------------------------------------------------------


def test_willsons_points_give_his_residual_and_say_what_is_weak(
    real_data: Path, tmp_path: Path
) -> None:
    points, out, told = real_data / "tsai" / "cc_cd.txt", tmp_path / "c.json", tmp_path / "t.json"

    result = facewright(
        "calibrate", "tsai", points, "--image-size", "512x480", "--out", out, "--json", told,
        "--report", tmp_path / "page.html",
    )  # fmt: skip

    assert result.exit_code == 0, result.output
    found = read_json(told)
    assert found["rms_px"] <= 0.1102 + 5e-5  # Willson's own optimum, to the digits he gives
    assert {p["name"] for p in found["parameters"]} >= {"f", "k1", "cx", "cy", "tz"}
    assert all(p["sd"] > 0 for p in found["parameters"])
    assert ["f", "tz"] in [pair["names"] for pair in found["correlated"]]
    assert "f and tz move together" in result.stderr
    given = read_points(points)
    assert given.pixels[:, 0].max() > 512  # that picture was wider
    assert "outside a picture of 512x480" in result.stderr
    camera = read_rig(out)["cc_cd"]
    off = camera.project(given.points) - given.pixels
    assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(found["rms_px"], rel=1e-6)


@pytest.fixture
def points_file(tmp_path: Path) -> tuple[Path, Camera]:
    """20 points around the origin as a known camera sees them; one of them is wrong."""
    rng = np.random.default_rng(8)
    camera = camera_at(25.0)
    points = rng.uniform(-100, 100, (20, 3))
    pixels = camera.project(points) + rng.normal(scale=0.2, size=(20, 2))
    pixels[6] += 40
    path = tmp_path / "face.csv"
    rows = [",".join(f"{v:.4f}" for v in (*u, *x)) for x, u in zip(points, pixels, strict=True)]
    path.write_text("u,v,X,Y,Z\n" + "\n".join(rows) + "\n")
    return path, camera


def test_wrong_point_is_named_by_its_line(points_file: tuple[Path, Camera], tmp_path: Path) -> None:
    path, _ = points_file
    told = tmp_path / "t.json"

    result = facewright("calibrate", "tsai", path, "--image-size", "640x480", "--json", told)

    assert result.exit_code == 0, result.output
    assert "line 8" in result.stdout
    found = read_json(told)
    assert [p["line"] for p in found["points_rejected"]] == [8]
    assert found["rms_used_px"] < 0.5 < found["rms_px"]
    f = next(p for p in found["parameters"] if p["name"] == "f")
    assert abs(f["value"] - 800) < 4 * f["sd"]
    assert (tmp_path / "face.camera.json").is_file()


def test_known_lens_leaves_the_pose(points_file: tuple[Path, Camera], tmp_path: Path) -> None:
    path, camera = points_file
    known, out, told = tmp_path / "lens.json", tmp_path / "placed.json", tmp_path / "t.json"
    write_rig(known, Rig({"lens": Camera(SIZE, K)}))

    result = facewright(
        "calibrate", "tsai", path, "--camera", known, "--out", out, "--json", told
    )  # fmt: skip

    assert result.exit_code == 0, result.output
    assert [p["name"] for p in read_json(told)["parameters"]] == [
        "rx",
        "ry",
        "rz",
        "tx",
        "ty",
        "tz",
    ]
    # 19 points of 0.2 px at 600 mm, f 800: about 0.15 px / sqrt(19) aside, far less sure in depth
    assert np.linalg.norm(read_rig(out)["face"].position - camera.position) < 2.0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "--image-size"),
        (("--image-size", "640x480", "--fix", "f"), "--fix"),
        (("--image-size", "640x480", "--sd", "0"), "--sd"),
    ],
)
def test_wrong_usage_of_tsai_exits_with_2(
    points_file: tuple[Path, Camera], words: tuple[str, ...], told: str
) -> None:
    result = facewright("calibrate", "tsai", points_file[0], *words)

    assert result.exit_code == 2
    assert told in result.stderr


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("X,Y,Z,u,v\n1,2,3,4,5\n1,2,nose,4,5\n", "line 3"),
        ("1 2 3 4 nan\n", "line 1"),
        ("1 2 3 4 5\n2 2 3 4 5\n3 2 3 4 5\n", "expected at least"),
        ("\n".join(f"{i} 0 0 {10 * i} 5" for i in range(12)), "one line"),
    ],
)
def test_bad_points_are_one_line_and_leave_no_file(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)

    result = facewright("calibrate", "tsai", path, "--image-size", "640x480")

    assert told in one_line(result)
    assert [p.name for p in tmp_path.iterdir()] == ["points.csv"]


# board -------------------------------------------------------------------------------------------


def test_left_chessboards_are_all_used_and_the_report_is_whole(
    real_data: Path, tmp_path: Path
) -> None:
    pictures = sorted((real_data / "chessboards").glob("left*.jpg"))
    told, page = tmp_path / "t.json", tmp_path / "page.html"

    result = facewright(
        "calibrate", "board", *pictures, "--model", "opencv5", "--out", tmp_path / "c.json",
        "--json", told, "--report", page,
    )  # fmt: skip

    assert result.exit_code == 0, result.output
    found = read_json(told)
    assert len(found["views_used"]) == 13
    assert found["views_rejected"] == []
    assert found["rms_px"] <= 0.180
    fx = next(p for p in found["parameters"] if p["name"] == "fx")
    # OpenCV's solver on OpenCV's own corners: 533.1 ± 0.5
    assert abs(fx["value"] - 533.1) < 4 * np.hypot(0.5, fx["sd"])
    assert found["uncertainty_mm"]["worst"] > found["uncertainty_mm"]["median"] > 0
    text = page.read_text(encoding="utf-8")
    drawings = [f"<svg{part.split('</svg>')[0]}</svg>" for part in text.split("<svg")[1:]]
    assert len(drawings) == 3
    assert sum(len(ET.fromstring(d).findall(".//{*}circle")) for d in drawings[:1]) == 13 * 54
    with Image.open(page.with_suffix(".png")) as picture:
        assert picture.size[0] == 620


def test_lens_model_is_chosen_and_the_choice_is_shown(tmp_path: Path) -> None:
    shoot(tmp_path, "chessboard:9x6:25", {"cam": camera_at(0.0)})
    told = tmp_path / "t.json"

    result = facewright("calibrate", "board", tmp_path / "cam", "--json", told)

    assert result.exit_code == 0, result.output
    assert "px on unseen views" in result.stdout
    found = read_json(told)
    assert found["model"] == min(found["held_out_px"], key=lambda m: found["held_out_px"][m]) or (
        found["held_out_px"][found["model"]] <= 1.01 * min(found["held_out_px"].values())
    )
    values = {p["name"]: (p["value"], p["sd"]) for p in found["parameters"]}
    for name, true in (("fx", 800.0), ("fy", 805.0), ("cx", 325.0), ("cy", 236.0)):
        assert abs(values[name][0] - true) < 2.0, name
    camera = read_rig(tmp_path / "cam" / "camera.json")["camera"]
    assert camera.matrix[0, 0] == values["fx"][0]


def test_repeated_pictures_and_pictures_without_a_board_are_told(tmp_path: Path) -> None:
    shoot(tmp_path, "chessboard:9x6:25", {"cam": camera_at(0.0)}, n=5)
    again = tmp_path / "cam" / "view9.png"
    again.write_bytes((tmp_path / "cam" / "view0.png").read_bytes())
    Image.fromarray(np.full(SIZE[::-1], 120, np.uint8)).save(tmp_path / "cam" / "wall.png")
    told = tmp_path / "t.json"

    result = facewright("calibrate", "board", tmp_path / "cam", "--json", told)

    assert result.exit_code == 0, result.output
    rejected = {r["name"]: r["reason"] for r in read_json(told)["views_rejected"]}
    assert set(rejected) == {"view9.png", "wall.png"}
    assert "view0.png" in rejected["view9.png"]
    assert "view9.png" in result.stdout


def test_one_view_is_warned_about(tmp_path: Path) -> None:
    shoot(tmp_path, "chessboard:9x6:25", {"cam": camera_at(0.0)}, n=2)

    result = facewright("calibrate", "board", tmp_path / "cam" / "view1.png")

    assert result.exit_code == 0, result.output
    assert "warning: one view only" in result.stderr


def test_one_frontal_view_is_refused_rather_than_believed(tmp_path: Path) -> None:
    shoot(tmp_path, "chessboard:9x6:25", {"cam": camera_at(0.0)}, n=1)

    result = facewright("calibrate", "board", tmp_path / "cam" / "view0.png")

    assert "tell focal length from distance" in one_line(result)
    assert not (tmp_path / "cam" / "camera.json").exists()


def test_bad_pictures_are_one_line(tmp_path: Path) -> None:
    shoot(tmp_path, "chessboard:9x6:25", {"cam": camera_at(0.0)}, n=3)
    cam = tmp_path / "cam"
    text = tmp_path / "notes.png"
    text.write_text("no picture")
    with Image.open(cam / "view0.png") as picture:
        picture.rotate(90, expand=True).save(tmp_path / "upright.png")
    (tmp_path / "empty").mkdir()
    good = cam / "view1.png"

    def said(*words: str | Path) -> str:
        return one_line(facewright("calibrate", "board", *words))

    assert "notes.png" in said(good, text)
    assert "upright.png is 480x640" in said(good, cam / "view2.png", tmp_path / "upright.png")
    assert "9x6 inner corners" in said(good, "--board", "chessboard:7x6:25")
    assert "expected pictures" in said(tmp_path / "empty")
    assert "chessboard:9x6:25" in said(good, "--board", "chess")
    assert "no such file" in said(tmp_path / "gone.png").lower()


def test_unknown_lens_model_is_wrong_usage(tmp_path: Path) -> None:
    result = facewright("calibrate", "board", tmp_path / "a.png", "--model", "fisheye")

    assert result.exit_code == 2
    assert "opencv5" in result.stderr


# rig ---------------------------------------------------------------------------------------------


def test_real_stereo_pair_has_its_baseline(real_data: Path, tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for picture in (real_data / "chessboards").glob(f"{side}*.jpg"):
            (tmp_path / side / picture.name.removeprefix(side)).symlink_to(picture.resolve())
    told = tmp_path / "t.json"

    result = facewright("calibrate", "rig", tmp_path, "--model", "opencv5", "--json", told)

    assert result.exit_code == 0, result.output
    found = read_json(told)
    assert len(found["views_used"]) == 13
    assert found["rms_px"] <= 0.198
    assert abs(found["distances_mm"][0]["value"] - 83.2) <= 0.3  # OpenCV's stereoCalibrate
    assert read_rig(tmp_path / "rig.json").names == ("left", "right")


def test_rig_is_found_though_cameras_took_an_ambiguous_board_differently(tmp_path: Path) -> None:
    cameras = {"a": camera_at(-20), "b": camera_at(10, 170), "c": camera_at(25, 80)}
    truth = shoot(tmp_path, ALIKE, cameras)
    lenses, told = tmp_path / "lenses.json", tmp_path / "t.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in cameras}))
    out, page = tmp_path / "found.json", tmp_path / "page.html"

    result = facewright(
        "calibrate", "rig", tmp_path, "--board", ALIKE, "--lenses", lenses, "--out", out,
        "--json", told, "--report", page,
    )  # fmt: skip

    assert result.exit_code == 0, result.output
    assert "were turned to agree" in result.stderr
    assert farthest_mm(read_rig(out), truth) < 0.3
    found = read_json(told)
    assert found["rms_px"] < 0.1
    assert found["board_points_mm"]["points"] == 6 * 48
    assert found["board_points_mm"]["rms"] < 0.1
    names = {p["name"] for p in found["parameters"]}
    assert {"b.x", "b.y", "b.z"} <= names
    assert "from above" in page.read_text(encoding="utf-8")


def test_world_may_be_the_board_of_a_view(tmp_path: Path) -> None:
    truth = shoot(tmp_path, "chessboard:9x6:25", {"a": camera_at(-20), "b": camera_at(20)})
    lenses, out = tmp_path / "lenses.json", tmp_path / "found.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in truth}))
    words = ("calibrate", "rig", tmp_path, "--lenses", lenses, "--out", out)

    placed = facewright(*words, "--world", "view1")
    unknown = facewright(*words, "--world", "view77")

    assert placed.exit_code == 0, placed.output
    board_from_world = held(parse_board("chessboard:9x6:25"), *POSES[1]).inverse()
    for name in truth:
        wanted = board_from_world.apply(truth[name].position)
        assert np.linalg.norm(read_rig(out)[name].position - wanted) < 0.5
    assert "view77" in one_line(unknown)


def test_camera_that_shares_nothing_is_named(tmp_path: Path) -> None:
    truth = shoot(tmp_path, "chessboard:9x6:25", {"a": camera_at(-20), "b": camera_at(20)})
    (tmp_path / "blind").mkdir()
    Image.fromarray(np.full(SIZE[::-1], 90, np.uint8)).save(tmp_path / "blind" / "view0.png")
    lenses, told = tmp_path / "lenses.json", tmp_path / "t.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in (*truth, "blind")}))

    result = facewright("calibrate", "rig", tmp_path, "--lenses", lenses, "--json", told)

    assert result.exit_code == 0, result.output
    assert "warning: blind: never saw the board" in result.stderr
    assert read_json(told)["unconnected"] == ["blind"]
    assert read_rig(tmp_path / "rig.json").names == ("a", "b")


def test_rig_that_is_there_is_kept(tmp_path: Path) -> None:
    truth = shoot(tmp_path, "chessboard:9x6:25", {"a": camera_at(-20), "b": camera_at(20)}, n=4)
    lenses = tmp_path / "rig.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in truth}))
    before = lenses.read_bytes()

    result = facewright("calibrate", "rig", tmp_path, "--lenses", lenses)

    assert result.exit_code == 0, result.output
    assert lenses.read_bytes() == before
    assert (tmp_path / "calibrated_rig.json").is_file()


def test_takes_that_are_none_are_one_line(tmp_path: Path) -> None:
    def said(*words: str | Path) -> str:
        return one_line(facewright("calibrate", "rig", *words))

    assert "two cameras or more" in said(tmp_path)
    assert "expected a folder" in said(tmp_path / "nowhere")
    shoot(tmp_path, "chessboard:9x6:25", {"a": camera_at(0), "b": camera_at(20)}, n=1)
    assert "needs videos" in said(tmp_path, "--sync", "sound")
    assert "give --lenses" in said(tmp_path)
    assert "no picture shows" in said(tmp_path, "--board", "chessboard:7x6:25")


def hand(t: float) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """How a lively hand holds a board: slow and quick motions that do not repeat."""

    def wander(k: int) -> float:
        slow, quick = 1.3 + 0.37 * k, 4.1 + 0.93 * k
        swell = np.exp(-(((t - 0.7 - 0.5 * k) / 0.5) ** 2))
        return float(0.6 * np.sin(slow * t + k) + (0.2 + 0.5 * swell) * np.sin(quick * t + 2 * k))

    turn = 0.4 * wander(0), 0.4 * wander(1), 0.3 * wander(2)
    return turn, (25 * wander(3), 20 * wander(4))


@pytest.mark.slow
@pytest.mark.parametrize("sync", ["sound", "motion"])
def test_videos_that_began_apart_are_brought_into_step(tmp_path: Path, sync: str) -> None:
    rate, late_s, seconds = 30.0, 0.150 + 0.4 / 30, 4.0
    board = parse_board("chessboard:9x6:25")
    sheet = printed(board, 4.0)
    truth = Rig({"a": camera_at(-20), "b": camera_at(20)})
    noise = np.random.default_rng(3).normal(scale=0.2, size=48_000 * 6).astype(np.float32)
    for name, start_s in (("a", 0.0), ("b", late_s)):
        first = round(start_s * 48_000)
        heard = Audio(noise[first : first + round(48_000 * seconds)], 48_000)
        with VideoWriter(tmp_path / f"{name}.mp4", SIZE, rate, crf=8, audio=heard) as video:
            for i in range(round(seconds * rate)):
                t = i / rate + start_s
                turn, place = hand(t)
                pose = held(board, turn, place)
                picture = shot(sheet, truth[name], pose)
                video.write(np.repeat(picture[..., None], 3, axis=2))
    lenses, told = tmp_path / "lenses.json", tmp_path / "t.json"
    write_rig(lenses, Rig({n: Camera(SIZE, K) for n in truth}))
    words = ("calibrate", "rig", tmp_path, "--lenses", lenses, "--out", tmp_path / "found.json")
    step = ("--sync", sync, "--max-offset", "1")

    stepped = facewright(*words, *step, "--json", told)
    apart = facewright(*words, "--out", tmp_path / "apart.json", "--json", tmp_path / "u.json")

    assert stepped.exit_code == 0, stepped.output
    found = read_json(told)
    # b's clock shows less, for it began later
    assert abs(found["clocks"]["b"]["offset_s"] + late_s) < 0.002
    assert farthest_mm(read_rig(tmp_path / "found.json"), truth) < 1.0
    assert apart.exit_code == 0, apart.output
    assert read_json(tmp_path / "u.json")["rms_px"] > 5 * found["rms_px"]


# Drawings ----------------------------------------------------------------------------------------


def test_drawing_is_the_same_as_page_and_as_pixels() -> None:
    drawing = Drawing(100, 60)
    drawing.box(10, 10, 30, 20, fill="#ff0000")
    drawing.dot(70, 20, 8, fill="#00ff00")
    drawing.line((0, 50), (100, 50), colour="#0000ff", width=4)
    drawing.words(5, 45, "a < b & c")

    root = ET.fromstring(stacked([drawing, drawing]).svg())
    image = stacked([drawing, drawing]).image()

    assert [t.text for t in root.findall("{*}text")] == ["a < b & c"] * 2
    assert image.shape == (120, 100, 3)
    for top in (0, 60):
        assert image[top + 20, 20].tolist() == [255, 0, 0]
        assert image[top + 20, 70].tolist() == [0, 255, 0]
        assert image[top + 50, 50].tolist() == [0, 0, 255]
        assert image[top + 5, 50].tolist() == [255, 255, 255]
