"""Rolling shutters of moving boards. Truth: exact projections, row by row, at each row's time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.capture.board_detection import Detection
from facewright.capture.board_turns import alternatives
from facewright.capture.board_video import TimedDetections
from facewright.capture.lens import BoardView
from facewright.capture.shutter_check import (
    MATTERS_PX,
    busiest_stretches,
    check_shutter,
    usual_speed,
)
from facewright.core.boards import Board, parse_board
from facewright.core.camera import Camera
from facewright.core.rigid import Rigid

SIZE = 1280, 720
CAMERA = Camera(SIZE, np.array([[1000.0, 0, 639.5], [0, 1000, 359.5], [0, 0, 1]]))
BOARD = parse_board("chessboard:9x6:25")
ALIKE = parse_board("chessboard:8x6:25")
FRAME_S = 1 / 30
PoseAt = Callable[[float], Rigid]


def glide(t: float) -> Rigid:
    """60 mm/s across, parallel to the picture, 800 mm away."""
    return Rigid.from_rotation(np.eye(3), [60 * t - 150, -60, 800])


def wave(t: float) -> Rigid:
    """A hand's motion: places and turns that swing."""
    turn = 0.3 * np.sin(np.array([5.1, 6.3, 4.2]) * t + [0, 1, 2])
    place = [60 * np.sin(5.7 * t) - 100, 50 * np.sin(7.1 * t + 1) - 60, 800 + 40 * np.sin(4 * t)]
    return Rigid.from_rotation(Rotation.from_rotvec(turn).as_matrix(), place)


def seen(
    pose_at: PoseAt, times: np.ndarray, readout_s: float = 0.0, board: Board = BOARD
) -> TimedDetections:
    """The board at some frames, each row at its own time; every third frame takes it turned."""
    rng = np.random.default_rng(5)
    points = board.object_points()
    found = []
    for i, t in enumerate(times):
        pixels = CAMERA.project(pose_at(t).apply(points))
        for _ in range(8 if readout_s else 0):
            rows = t + readout_s * (pixels[:, 1] / (SIZE[1] - 1) - 0.5)
            pixels = np.stack(
                [CAMERA.project(pose_at(s).apply(p)) for s, p in zip(rows, points, strict=True)]
            )
        noisy = pixels + rng.normal(scale=0.05, size=pixels.shape)
        ways = alternatives(BoardView(f"frame {i}", points, noisy), board)
        found.append(Detection(f"frame {i}", ways[-1 if i % 3 == 0 else 0], None))
    return TimedDetections(SIZE, times, tuple(found), FRAME_S)


@pytest.mark.parametrize("board", [BOARD, ALIKE], ids=str)
@pytest.mark.parametrize("readout_s", [0.0, 0.012])
def test_shutter_is_measured_and_told_in_mm(board: Board, readout_s: float) -> None:
    dense = seen(wave, np.arange(40) * FRAME_S, readout_s, board)
    speed = usual_speed(dense, board, CAMERA)

    check = check_shutter(dense, speed, board, CAMERA)

    assert check.readout is not None
    assert abs(check.readout.readout_s - readout_s) < max(4 * check.readout.sd_s, 1e-9)
    assert check.matters == bool(check.warning) == (readout_s > 0)
    assert check.bend_mm == pytest.approx(
        abs(check.readout.readout_s) * speed.rows_share * speed.mm_s
    )
    # 800 mm away a pixel is 0.8 mm
    assert check.bend_mm == pytest.approx(0.8 * check.bend_px, rel=0.1)
    if readout_s:
        assert f"{check.bend_mm:.2f} mm" in check.warning


def test_slight_bend_does_not_matter() -> None:
    dense = seen(wave, np.arange(40) * FRAME_S, 0.012)
    fast = usual_speed(dense, BOARD, CAMERA)
    slow = type(fast)(0.005 * fast.px_s, 0.005 * fast.mm_s, fast.rows_share)

    check = check_shutter(dense, slow, BOARD, CAMERA)

    assert check.readout is not None
    assert check.readout.warnings  # it rolls
    assert check.bend_px < MATTERS_PX
    assert not check.matters
    assert not check.warning


def test_board_that_is_held_still_tells_no_shutter() -> None:
    dense = seen(lambda _: glide(1.0), np.arange(20) * FRAME_S)

    check = check_shutter(dense, usual_speed(dense, BOARD, CAMERA), BOARD, CAMERA)

    assert check.readout is None
    assert "hardly moves" in check.reason
    assert not check.matters


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("board", [BOARD, ALIKE], ids=str)
def test_speed_is_that_of_the_board(every: int, board: Board) -> None:
    looks = seen(glide, np.arange(0, 90, every) * FRAME_S, board=board)

    speed = usual_speed(looks, board, CAMERA)

    # 0.05 px of noise between neighbouring frames adds some 0.1 px to 2.5 px in quadrature
    assert speed.mm_s == pytest.approx(60, rel=0.01)
    assert speed.px_s == pytest.approx(75, rel=0.01)
    assert speed.rows_share == pytest.approx(5 * 25 / 0.8 / (SIZE[1] - 1), rel=0.01)


def test_liveliest_stretches_are_taken_and_none_with_a_break() -> None:
    def restless(t: float) -> Rigid:  # still for 2 s, fast for 1 s, slow for 1 s
        x = 200 * np.clip(t - 2, 0, 1) + 40 * np.clip(t - 3, 0, 1) - 200
        return Rigid.from_rotation(np.eye(3), [x, -60, 800])

    times = np.arange(0, 120, 4) * FRAME_S
    looks = seen(restless, times)
    lost = np.abs(times - 2.53).argmin()
    gone = tuple(
        Detection(d.name, None, "no board") if i == lost else d
        for i, d in enumerate(looks.detections)
    )
    broken = TimedDetections(SIZE, looks.time_s, gone, FRAME_S)

    one = busiest_stretches(looks, BOARD, length_s=0.9, most=1)
    two = busiest_stretches(looks, BOARD, length_s=0.9, most=2)
    other = busiest_stretches(broken, BOARD, length_s=0.9, most=1)

    assert len(one) == 1
    assert abs(one[0][0] - 2.0) < 0.15
    assert len(two) == 2
    assert two[0][1] <= two[1][0]
    assert other
    assert not other[0][0] <= 2.53 < other[0][1]
    assert busiest_stretches(looks, BOARD, length_s=9.0, most=1) == []
