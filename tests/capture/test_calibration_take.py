"""Views of a take: read, interpolated between frames, turned to agree. Truth: Camera.project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from facewright.capture.board_detection import Detection
from facewright.capture.board_turns import agree_on_turns, alternatives
from facewright.capture.board_video import (
    TimedDetections,
    motion_of,
    view_at,
    views_at_moments,
)
from facewright.capture.board_views import without_blur, without_repeats
from facewright.capture.calibration_take import (
    check_sizes,
    find_take,
    pictures_in,
    read_picture,
)
from facewright.capture.lens import BoardView
from facewright.capture.synchronise import ClockFit
from facewright.core.boards import Board, parse_board
from facewright.core.camera import Camera
from facewright.core.errors import FileFormatError, InputError
from facewright.core.rigid import Rigid

ALIKE = parse_board("chessboard:8x6:25")  # half a turn changes nothing
SQUARE = parse_board("circles:6x6:20")  # nor does a quarter
PLAIN = parse_board("chessboard:9x6:25")


def camera_at(yaw_deg: float, roll_deg: float = 0.0) -> Camera:
    """One that looks from 800 mm at the origin."""
    turn = Rotation.from_euler("YZ", [yaw_deg, roll_deg], degrees=True).as_matrix().T
    K = np.array([[1000.0, 0, 639.5], [0, 1000, 359.5], [0, 0, 1]])
    return Camera((1280, 720), K, Rigid.from_rotation(turn, [0, 0, 800]))


def board_poses(rng: np.random.Generator, board: Board, n: int) -> list[Rigid]:
    middle = board.object_points().mean(axis=0)
    poses = []
    for _ in range(n):
        R = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).as_matrix()
        poses.append(Rigid.from_rotation(R, rng.uniform(-60, 60, 3) - R @ middle))
    return poses


def view_of(board: Board, camera: Camera, pose: Rigid, name: str) -> BoardView:
    points = board.object_points()
    return BoardView(name, points, camera.project(pose.apply(points)))


# Turned boards ---------------------------------------------------------------------------------


@pytest.mark.parametrize("board", [ALIKE, SQUARE], ids=str)
def test_cameras_agree_how_a_board_was_held_whatever_each_took(board: Board) -> None:
    rng = np.random.default_rng(4)
    cameras = {"a": camera_at(-30), "b": camera_at(5, 180), "c": camera_at(35, -90)}
    poses = board_poses(rng, board, 8)
    truth = {
        n: [view_of(board, c, pose, f"v{i}") for i, pose in enumerate(poses)]
        for n, c in cameras.items()
    }
    n_ways = len(alternatives(truth["a"][0], board))
    given = {
        n: [alternatives(v, board)[rng.integers(n_ways)] for v in seen] for n, seen in truth.items()
    }

    agreed, n_turned = agree_on_turns(given, cameras, board)

    assert n_turned > 0
    for i in range(len(poses)):
        # the same point of the board in all: where the truth has one and the same point
        kinds = set()
        for n in cameras:
            apart = np.linalg.norm(agreed[n][i].pixels[0] - truth[n][i].pixels, axis=1)
            assert apart.min() < 1e-9
            kinds.add(int(apart.argmin()))
        assert len(kinds) == 1, f"view {i}"


def test_board_that_cannot_be_mistaken_is_left_alone() -> None:
    pose = board_poses(np.random.default_rng(0), PLAIN, 1)[0]
    views = {"a": [view_of(PLAIN, camera_at(0, 180), pose, "v")]}

    agreed, n_turned = agree_on_turns(views, {"a": camera_at(0)}, PLAIN)

    assert n_turned == 0
    assert agreed["a"][0] is views["a"][0]


# Moments between frames ------------------------------------------------------------------------


def moving(board: Board, rate_hz: float, n: int, start_s: float = 0.0) -> TimedDetections:
    """A board that glides before a camera; every third frame takes it turned."""
    camera = camera_at(0)
    pose = board_poses(np.random.default_rng(1), board, 1)[0]
    times = np.arange(n) / rate_hz
    found = []
    for i, t in enumerate(times):
        moved = Rigid.from_rotation(pose.rotation, pose.translation + (t + start_s) * GLIDE)
        ways = alternatives(view_of(board, camera, moved, f"frame {i}"), board)
        view = ways[-1 if i % 3 == 0 else 0]
        found.append(Detection(view.name, view, None, sharpness_px=0.7))
    return TimedDetections((1280, 720), times, tuple(found))


GLIDE = np.array([60.0, 20.0, 0.0])  # mm/s, parallel to the picture: straight and even in it


@pytest.mark.parametrize("board", [PLAIN, ALIKE], ids=str)
def test_view_between_frames_is_where_the_board_was(board: Board) -> None:
    found = moving(board, 30.0, 12)
    pose = board_poses(np.random.default_rng(1), board, 1)[0]
    moved = Rigid.from_rotation(pose.rotation, pose.translation + 0.18 * GLIDE)
    # each point glides at its own constant depth: the straight line is exact

    view = view_at(found, 0.18, board, "now")

    assert view is not None
    truth = min(
        alternatives(view_of(board, camera_at(0), moved, "now"), board),
        key=lambda v: float(np.abs(v.pixels - view.pixels).max()),
    )
    np.testing.assert_allclose(view.pixels, truth.pixels, atol=1e-9)


def test_clocks_bring_videos_to_the_same_moments() -> None:
    late_s = 0.0471
    found = {"a": moving(PLAIN, 30.0, 30), "b": moving(PLAIN, 50.0, 50, start_s=late_s)}
    clock = ClockFit(-late_s, 0.0, 1e-4, float("inf"), 1, 1, "flash")
    moments = [(f"frame {i}", float(t)) for i, t in enumerate(found["a"].time_s)]

    views = views_at_moments(found, {"b": clock}, moments, PLAIN, max_views=10)

    assert len(views["a"]) == len(views["b"]) == 10
    for a, b in zip(views["a"], views["b"], strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.pixels, b.pixels, atol=1e-9)


@pytest.mark.parametrize("board", [PLAIN, ALIKE, SQUARE], ids=str)
def test_two_cameras_tell_the_motion_of_a_board_by_a_rigid_map(board: Board) -> None:
    rng = np.random.default_rng(6)
    cameras = {"a": camera_at(-25), "b": camera_at(20, 180)}
    poses = board_poses(rng, board, 12)
    told = {}
    for name, camera in cameras.items():
        seen = []
        for i, pose in enumerate(poses):
            ways = alternatives(view_of(board, camera, pose, f"frame {i}"), board)
            seen.append(Detection(f"frame {i}", ways[rng.integers(len(ways))], None))
        found = TimedDetections((1280, 720), np.arange(12) / 30, tuple(seen))
        told[name] = motion_of(found, board, camera)[1]

    b_from_a = cameras["b"].camera_from_world @ cameras["a"].camera_from_world.inverse()
    np.testing.assert_allclose(told["b"], b_from_a.apply(told["a"]), atol=1e-4)


def test_no_view_where_a_frame_beside_the_moment_shows_none() -> None:
    found = moving(PLAIN, 30.0, 4)
    gone = Detection("frame 2", None, "no board")
    found = TimedDetections(
        found.image_size, found.time_s, (*found.detections[:2], gone, found.detections[3])
    )

    assert view_at(found, 1.5 / 30, PLAIN, "x") is None
    assert view_at(found, 1 / 30, PLAIN, "x") is not None
    assert view_at(found, 9.0, PLAIN, "x") is None


def test_blurred_and_repeated_views_go() -> None:
    pose, other = board_poses(np.random.default_rng(2), PLAIN, 2)
    views = [
        view_of(PLAIN, camera_at(0), p, n) for p, n in ((pose, "a"), (pose, "b"), (other, "c"))
    ]
    blurs = [0.7, 0.72, 3.0]
    seen = [Detection(v.name, v, None, b) for v, b in zip(views, blurs, strict=True)]

    kept, repeated = without_repeats(views)

    assert [v.name for v in kept] == ["a", "c"]
    assert [(r.name, "as in a" in r.reason) for r in repeated] == [("b", True)]
    assert [d.name for d in without_blur(seen)] == ["a", "b"]


# Files -----------------------------------------------------------------------------------------


def test_pictures_are_read_upright_as_grey_and_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    values = np.zeros((40, 60), np.uint8)
    values[:, :20] = 200
    turned = Image.fromarray(values).convert("RGB")
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned a quarter clockwise
    turned.save(tmp_path / "shot10.png", exif=exif)
    Image.fromarray(values.astype(np.uint16) * 256).save(tmp_path / "shot9.png")

    upright, deep = (read_picture(tmp_path / n) for n in ("shot10.png", "shot9.png"))

    assert [p.name for p in pictures_in(tmp_path)] == ["shot9.png", "shot10.png"]
    np.testing.assert_array_equal(upright, np.rot90(values, -1))
    np.testing.assert_array_equal(deep > 100, values > 100)


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n"])
def test_what_is_no_picture_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "shot.png"
    path.write_bytes(content)

    with pytest.raises(FileFormatError, match=r"shot\.png"):
        read_picture(path)


def test_cut_off_picture_is_refused(tmp_path: Path) -> None:
    whole = tmp_path / "whole.png"
    noise = np.random.default_rng(0).integers(0, 255, (64, 64), np.uint8)
    Image.fromarray(noise).save(whole)
    cut = tmp_path / "cut.png"
    cut.write_bytes(whole.read_bytes()[:2000])

    with pytest.raises(FileFormatError, match="whole picture"):
        read_picture(cut)


def test_the_odd_size_is_named() -> None:
    with pytest.raises(InputError, match=r"b\.png is 480x640"):
        check_sizes({"a.png": (640, 480), "b.png": (480, 640), "c.png": (640, 480)})


def test_take_without_two_cameras_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found none"):
        find_take(tmp_path)
    (tmp_path / "cam0").mkdir()
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "cam0" / "a.png")
    with pytest.raises(InputError, match="only cam0"):
        find_take(tmp_path)
    (tmp_path / "cam1.mp4").touch()
    with pytest.raises(InputError, match="one or the other"):
        find_take(tmp_path)
