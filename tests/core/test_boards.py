from __future__ import annotations

import cv2
import numpy as np
import pytest

from facewright.core.boards import Board, parse_board
from facewright.core.errors import InputError

SPECS = [
    "chessboard:9x6:25",
    "circles:7x6:20.5",
    "circles:4x11:20:asymmetric",
    "charuco:8x5:32:24:DICT_6X6_250",
    "charuco:7x6:32:24:DICT_6X6_250",
    "charuco:7x6:32:24:DICT_6X6_250:legacy",
    "charuco:5x7:30:21:DICT_5X5_100:legacy",
]
CHARUCO = [spec for spec in SPECS if spec.startswith("charuco")]


def opencv_charuco(board: Board) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(board.dictionary)))
    assert board.marker_mm is not None
    size = board.columns, board.rows
    known = cv2.aruco.CharucoBoard(size, board.square_mm, board.marker_mm, dictionary)
    known.setLegacyPattern(board.legacy)
    return known


@pytest.mark.parametrize("spec", SPECS)
def test_board_reads_back_as_it_was_written(spec: str) -> None:
    assert str(parse_board(spec)) == spec
    assert parse_board(str(parse_board(spec))) == parse_board(spec)


@pytest.mark.parametrize("spec", CHARUCO)
def test_charuco_is_the_board_that_opencv_draws(spec: str) -> None:
    board = parse_board(spec)
    known = opencv_charuco(board)
    px = {24.0: 2, 21.0: 2}[float(board.marker_mm or 0)]  # per mm: whole pixels for every bit
    side = round(board.square_mm * px)
    drawn = known.generateImage((board.columns * side, board.rows * side), marginSize=0)

    y, x = np.mgrid[0 : drawn.shape[0], 0 : drawn.shape[1]]
    ours = board.is_black((np.stack([x, y], axis=-1) + 0.5) / px)

    assert np.array_equal(ours, drawn < 128)
    assert np.allclose(board.object_points(), known.getChessboardCorners(), atol=1e-6)


def test_chessboard_points_are_where_four_squares_meet() -> None:
    board = parse_board("chessboard:9x6:25")
    points = board.object_points()

    assert points.shape == (54, 3) and not points[:, 2].any()
    assert points[0].tolist() == [0, 0, 0] and points[10].tolist() == [25, 25, 0]
    around = [board.is_black(points[:, :2] + d) for d in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    assert (around[0] == around[2]).all() and (around[1] == around[3]).all()
    assert (around[0] != around[1]).all()
    assert board.is_black(np.array([-1.0, -1.0])), "the upper left square is black"
    assert not board.is_black(np.array([-26.0, -1.0])) and board.is_black(np.array([-24.0, -1.0]))


def test_asymmetric_circles_are_counted_as_opencv_does() -> None:
    points = parse_board("circles:4x11:20:asymmetric").object_points()

    assert points.shape == (44, 3)
    expected = [[(2 * j + i % 2) * 20, i * 20, 0] for i in range(11) for j in range(4)]
    assert points.tolist() == expected


def test_dots_are_round_and_apart() -> None:
    board = parse_board("circles:7x6:20")
    angle = np.linspace(0, 2 * np.pi, 50)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = board.object_points()[:, None, :2] + board.dot_radius_mm * ring

    middle = board.object_points()[:, None, :2]
    assert board.is_black(middle + 0.999 * (places - middle)).all()
    assert not board.is_black(middle + 1.001 * (places - middle)).any()


def test_share_of_ink_is_that_of_the_cells() -> None:
    board = parse_board("chessboard:5x4:10")
    x_edges, y_edges, black = board.cells

    area = np.outer(np.diff(y_edges), np.diff(x_edges))

    assert np.isclose(area[black].sum(), 15 * 100), "half of 6x5 squares"
    sheet = board.sheet_box
    assert np.isclose(area.sum(), (sheet[2] - sheet[0]) * (sheet[3] - sheet[1]))


@pytest.mark.parametrize(
    "text",
    [
        "", "chessboard", "chessboard:9x6", "chessboard:9:25", "chessboard:9x6:25:asymmetric",
        "chessboard:9x6:abc", "chessboard:9x6:nan", "chessboard:9x6:-25", "chessboard:9x6:0",
        "chessboard:1x6:25", "chessboard:99999x6:25", "chessboard:9x6:25:", "checkerboard:9x6:25",
        "circles:7x6:20:legacy", "charuco:8x5:30:22", "charuco:8x5:30:30:DICT_5X5_100",
        "charuco:8x5:30:22:DICT_9X9", "charuco:8x5:30:22:Dictionary",
        "charuco:30x30:30:22:DICT_4X4_50", "charuco:8x5:30:22:DICT_5X5_100:old",
    ],
)  # fmt: skip
def test_what_is_no_board_is_named(text: str) -> None:
    with pytest.raises(InputError, match=r"^board "):
        parse_board(text)
