"""Boards found in synthetic pictures, whose truth is exact, and in real ones."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.capture.board_detection import Detection, detect_board, flip_view
from facewright.capture.chessboard_detection import grown
from facewright.capture.grid_order import look_alikes, put_in_order
from facewright.capture.lens import calibrate_board
from facewright.capture.rigs import calibrate_rig
from facewright.core.boards import Board, parse_board
from facewright.datasets_synthetic.boards import (
    BoardLook,
    board_truth,
    board_views,
    make_board_shots,
)
from facewright.datasets_synthetic.optics import Sensor

REAL = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "real" / "chessboards"
CHESS = parse_board("chessboard:9x6:25")
CHARUCO = parse_board("charuco:8x6:30:22:DICT_5X5_100")
PLAIN = BoardLook(has_background=False)
Image = NDArray[np.uint8]
Floats = NDArray[np.float64]


@lru_cache(maxsize=16)
def shots(
    text: str, n_views: int = 4, seed: int = 1, look: BoardLook = PLAIN
) -> tuple[list[Image], Floats, Floats]:
    """Pictures, true pixels (V, N, 2), and true centroids of dots (V, N, 2) or nothing."""
    made = make_board_shots(parse_board(text), seed, n_views=n_views, look=look)
    truth = board_truth(made)
    centroids = truth["centroids"][0] if "centroids" in truth else np.zeros((0, 0, 2))
    return list(board_views(made, "cam0")), truth["pixels"][0], centroids


def errors(found: Detection, board: Board, truth: Floats) -> Floats:
    """Seen less true, (n, 2); of boards that look alike when turned the turn that fits."""
    assert found.view is not None, found.reason
    points = board.object_points()
    i = np.abs(points[None] - found.view.points[:, None]).max(axis=2).argmin(axis=1)
    turned = [found.view.pixels - truth[np.argsort(order)][i] for order in look_alikes(board)]
    return min(turned, key=lambda e: float((e**2).sum()))


def rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize(
    "text",
    ["chessboard:9x6:25", "chessboard:8x6:25", "chessboard:7x7:25", "chessboard:8x8:20",
     "charuco:8x5:30:22:DICT_5X5_100", "charuco:9x6:25:18:DICT_4X4_50:legacy",
     "circles:9x7:15", "circles:4x11:15:asymmetric"],
)  # fmt: skip
def test_points_lie_where_they_are(text: str) -> None:
    board = parse_board(text)
    images, truth, _ = shots(text)

    found = [detect_board(image, board, name=f"{i}") for i, image in enumerate(images)]

    off = [errors(d, board, t) for d, t in zip(found, truth, strict=True) if d.view is not None]
    assert len(off) >= (len(images) if board.kind != "circles" else 3), [d.reason for d in found]
    # over 32 pictures of each board: 0.0037 to 0.0047 px for corners, 0.0065 to 0.008 for dots
    assert rms(np.concatenate(off)) < (0.007 if board.kind != "circles" else 0.015)


@pytest.mark.parametrize(
    ("look", "allowed_px"),
    [
        (PLAIN, 0.008),
        (replace(PLAIN, blur_px=1.5), 0.010),
        (replace(PLAIN, sensor=Sensor(full_well_e=1500.0, read_noise_e=20.0)), 0.016),
        (replace(PLAIN, sensor=Sensor(1.0, 9000.0, 10.0, 2.2)), 0.010),
    ],
    ids=["plain", "blurred", "noisy", "gamma"],
)  # fmt: skip
def test_corners_beat_opencv_and_know_their_own_error(look: BoardLook, allowed_px: float) -> None:
    images, truth, _ = shots("chessboard:9x6:25", 5, 2, look)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    ours, theirs, stated = [], [], []

    for image, true in zip(images, truth, strict=True):
        found = detect_board(image, CHESS)
        ours.append(errors(found, CHESS, true))
        stated.append(found.sd_px)
        size = int(0.3 * found.step_px)
        start = np.rint(true).astype(np.float32)
        theirs.append(cv2.cornerSubPix(image, start, (size, size), (-1, -1), stop) - true)

    error = rms(np.concatenate(ours))
    assert error < allowed_px
    assert error < 0.5 * rms(np.concatenate(theirs))
    # a gamma curve fits the model less well: what is left over is not all noise
    assert 0.6 < error / rms(np.array(stated)) < 1.6


def test_the_perspective_of_dots_is_undone() -> None:
    board = parse_board("circles:9x7:15")
    images, truth, centroids = shots("circles:9x7:15", 6)
    off, bias = [], []

    for image, true, centroid in zip(images, truth, centroids, strict=True):
        found = detect_board(image, board)
        if found.view is not None:
            off.append(errors(found, board, true))
            bias.append(centroid - true)

    assert len(off) >= 4
    assert rms(np.concatenate(bias)) > 0.03
    assert rms(np.concatenate(off)) < 0.3 * rms(np.concatenate(bias))


def test_the_unlike_halves_of_a_board_are_told_apart() -> None:
    """9x6 corners: 10x7 squares, of which the first is black and the last of its row white."""
    images, truth, _ = shots("chessboard:9x6:25")

    for image, true in zip(images, truth, strict=True):
        upright = detect_board(image, CHESS)
        turned = detect_board(np.ascontiguousarray(image[::-1, ::-1]), CHESS)
        assert upright.view is not None and turned.view is not None
        h, w = image.shape
        assert np.abs(upright.view.pixels - true).max() < 0.1
        assert np.abs((w - 1, h - 1) - turned.view.pixels - true).max() < 0.1


def test_the_other_way_round_is_the_same_picture() -> None:
    board = parse_board("chessboard:8x6:25")
    view = detect_board(shots("chessboard:8x6:25")[0][0], board).view
    assert view is not None

    flipped = flip_view(view, board)

    assert (flipped.pixels == view.pixels[::-1]).all()
    assert (flipped.points == view.points).all()
    twice = flip_view(flipped, board)
    assert (twice.pixels == view.pixels).all()
    with pytest.raises(ValueError, match="does not look the same"):
        flip_view(view, CHESS)


@pytest.mark.parametrize(
    ("text", "count"),
    [("chessboard:9x6:1", 1), ("chessboard:8x6:1", 2), ("chessboard:7x7:1", 2),
     ("chessboard:8x8:1", 4), ("circles:7x6:1", 2), ("circles:7x7:1", 4),
     ("circles:4x11:1:asymmetric", 1), ("circles:4x10:1:asymmetric", 2),
     ("charuco:7x7:3:2:DICT_5X5_100", 1)],
)  # fmt: skip
def test_how_many_ways_a_board_looks_the_same(text: str, count: int) -> None:
    board = parse_board(text)
    ways = look_alikes(board)

    assert len(ways) == count
    points = board.object_points()[:, :2]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    for order in ways:  # a turn keeps all distances, and what is printed
        assert np.allclose(
            np.linalg.norm(points[order] - middle, axis=1), np.linalg.norm(points - middle, axis=1)
        )
        if board.kind == "chessboard":
            a, b = points[order[0]], points[order[1]]
            x = (b - a) / (points[1] - points[0])[0]
            R = np.array([[x[0], -x[1]], [x[1], x[0]]])
            places = np.random.default_rng(3).uniform(-0.9, board.rows - 0.1, (200, 2))
            assert (
                board.is_black(places) == board.is_black((places - middle) @ R.T + middle)
            ).all()


def test_orders_are_put_right_and_mirrors_recognised() -> None:
    _, truth, _ = shots("chessboard:9x6:25")
    points, true = CHESS.object_points()[:, :2], truth[1]
    grid = true.reshape(6, 9, 2)

    for wrong in (grid[::-1], grid[:, ::-1], np.random.default_rng(1).permutation(true)):
        found, changed = put_in_order(points, wrong.reshape(-1, 2), 25.0)
        assert found is not None and changed
        assert any((found[o] == true).all() for o in (np.arange(54), np.arange(54)[::-1]))
    bad = true.copy()
    bad[20] += 40
    assert put_in_order(points, bad, 25.0) == (None, True)


# --- what is wrong with a picture ---------------------------------------------------------------


def reason_of(image: Image, board: Board) -> str:
    found = detect_board(image, board)
    assert found.view is None
    assert found.reason is not None
    return found.reason


@pytest.mark.parametrize("size", ["8x6", "9x5", "7x4"])
def test_a_board_with_more_corners_than_asked_for_is_counted(size: str) -> None:
    image = shots("chessboard:9x6:25")[0][0]

    reason = reason_of(image, parse_board(f"chessboard:{size}:25"))

    assert reason.startswith("wrong size: the picture shows 9x6 inner corners")


def test_a_part_of_the_corners_of_a_board_is_no_board() -> None:
    """Every corner of a slanted grid, two columns of the board apart, is right by itself."""
    image, truth = shots("chessboard:9x6:25")[0][0], shots("chessboard:9x6:25")[1][0]
    board_grid = truth.reshape(6, 9, 2)
    row, column = np.mgrid[0:3, 0:4]
    slanted = board_grid[3 - column + row, 2 * column]  # (0, 1) and (2, -1) squares on

    assert grown(image, board_grid[1:4, 2:6], most_lines=9).shape == (6, 9, 2)  # type: ignore[union-attr]
    assert grown(image, board_grid).shape == (6, 9, 2)  # type: ignore[union-attr]
    assert grown(image, slanted) is None
    assert grown(image, board_grid[:, ::3]) is None


@pytest.mark.parametrize("name", ["left01", "left05", "left14", "right04"])
@pytest.mark.parametrize("size", ["5x4", "4x3", "8x5"])
def test_real_boards_with_more_corners_than_asked_for_are_counted(name: str, size: str) -> None:
    if not REAL.is_dir():
        pytest.skip("real chessboard pictures are not there (../shared/data/real/chessboards)")
    image = cv2.imread(str(REAL / f"{name}.jpg"), cv2.IMREAD_GRAYSCALE)

    reason = reason_of(np.asarray(image, np.uint8), parse_board(f"chessboard:{size}:25"))

    assert reason == f"wrong size: the picture shows 9x6 inner corners, not {size}"


@pytest.mark.parametrize(
    ("shown", "asked", "told"),
    [
        ("circles:9x7:15", "circles:8x7:15", "shows 9x7 dots, not 8x7"),
        ("circles:9x7:15", "circles:5x4:15", "shows 9x7 dots, not 5x4"),
        ("circles:9x7:15", "circles:4x9:15:asymmetric", "shows 9x7 dots, not 4x9:asymmetric"),
        ("circles:4x11:15:asymmetric", "circles:4x9:15:asymmetric", "shows 4x11 dots, not 4x9"),
        ("circles:4x11:15:asymmetric", "circles:3x5:15:asymmetric", "shows 4x11 dots, not 3x5"),
        ("circles:4x11:15:asymmetric", "circles:4x5:15", "shows 4x11:asymmetric dots, not 4x5"),
        ("circles:9x7:15", "circles:10x7:15", "shows 9x7 dots, not 10x7"),
        (str(CHARUCO), "charuco:8x5:30:22:DICT_5X5_100", "6 rows or more of 8 squares, not 8x5"),
        (str(CHARUCO), "charuco:8x4:30:22:DICT_5X5_100", "8 columns and 6 rows or more"),
        (str(CHARUCO), "charuco:5x4:30:22:DICT_5X5_100", "8 columns and 6 rows or more"),
        ("charuco:9x6:30:22:DICT_5X5_100", "charuco:9x4:30:22:DICT_5X5_100", "9 columns and 6"),
    ],
)
def test_dots_and_squares_beyond_the_asked_board_are_counted(
    shown: str, asked: str, told: str
) -> None:
    image = shots(shown)[0][0]

    assert told in reason_of(image, parse_board(asked))


def test_a_charuco_board_that_ends_early_is_used_and_told() -> None:
    images, truth, _ = shots(str(CHARUCO))
    taller = replace(CHARUCO, rows=8)
    room = [i for i, t in enumerate(truth) if t[:, 1].max() + 2.5 * 60 < images[i].shape[0]]
    found = detect_board(images[room[0]], taller)

    assert found.view is not None
    assert any("is it a board of 8x6?" in note for note in found.details)
    assert not any("is it" in note for note in detect_board(images[room[0]], CHARUCO).details)


def test_squares_counted_instead_of_corners_are_told() -> None:
    reason = reason_of(shots("chessboard:9x6:25")[0][0], parse_board("chessboard:10x7:25"))

    assert "9x6 inner corners (10x7 squares)" in reason


def test_a_board_that_leaves_the_picture_is_cut_off() -> None:
    images, truth, _ = shots("chessboard:9x6:25")
    image, grid = images[0], truth[0].reshape(6, 9, 2)
    right = int((grid[:, -2, 0].max() + grid[:, -1, 0].min()) / 2)

    reason = reason_of(np.ascontiguousarray(image[:, :right]), CHESS)

    assert reason.startswith("cut off")
    assert "right" in reason


def test_a_covered_corner_is_left_out_and_a_covered_row_refused() -> None:
    images, truth, _ = shots("chessboard:9x6:25")
    image, true = images[0].copy(), truth[0]
    size = 9
    x, y = np.rint(true[22]).astype(int)
    image[y - size : y + size, x - size : x + size] = 90
    hand = images[0].copy()
    cv2.polylines(hand, [np.rint(true[45:]).astype(np.int32)], False, 90, 40)

    found = detect_board(image, CHESS)

    assert found.view is not None
    assert len(found.view.points) == 53, found.details
    assert "1 of 54 corners left out" in " ".join(found.details)
    assert not (found.view.points == CHESS.object_points()[22]).all(axis=1).any()
    assert np.abs(found.view.pixels - np.delete(true, 22, axis=0)).max() < 0.1
    assert "can be seen" in reason_of(hand, CHESS) or "clear" in reason_of(hand, CHESS)


def test_blur_is_measured_and_too_much_refused() -> None:
    image = shots("chessboard:9x6:25")[0][0]
    sharp = detect_board(image, CHESS)
    blurred = cv2.GaussianBlur(image, (0, 0), 2.0)
    wiped = cv2.GaussianBlur(image, (0, 0), 0.3 * sharp.step_px)
    along = cv2.blur(image, (9, 1))

    found = detect_board(np.asarray(blurred, np.uint8), CHESS)

    # the lens's 0.6 px and the pixel's own width, 1/sqrt(12)
    assert sharp.sharpness_px == pytest.approx(np.sqrt(0.6**2 + 1 / 12), abs=0.06)
    assert found.sharpness_px == pytest.approx(np.sqrt(2.0**2 + sharp.sharpness_px**2), rel=0.05)
    moved = detect_board(np.asarray(along, np.uint8), CHESS)
    assert moved.sharpness_px > 2.0
    assert detect_board(np.asarray(wiped, np.uint8), CHESS).view is None


def test_a_far_board_is_too_small() -> None:
    image = shots("chessboard:9x6:25")[0][0]
    step = detect_board(image, CHESS).step_px
    factor = 4.5 / step
    far = np.full((300, 400), 128, np.uint8)
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    far[50 : 50 + small.shape[0], 60 : 60 + small.shape[1]] = small

    found = detect_board(far, CHESS)

    assert found.view is None
    assert found.reason is not None
    assert found.reason.startswith(("too small", "no board", "blurred", "only"))


@pytest.mark.parametrize("text", ["chessboard:9x6:25", "circles:9x7:15"])
def test_a_negative_is_used_and_told(text: str) -> None:
    board, image = parse_board(text), shots(text)[0][0]
    positive, negative = detect_board(image, board), detect_board(255 - image, board)

    assert positive.view is not None and negative.view is not None
    if text.startswith("circles"):
        assert any("inverted" in note for note in negative.details)
    assert len(negative.view.points) == len(positive.view.points)
    either = [
        negative.view.pixels - positive.view.pixels[o] for o in (slice(None), slice(None, None, -1))
    ]
    assert min(float(np.abs(e).max()) for e in either) < 0.02


def test_the_other_charuco_pattern_is_told() -> None:
    image = shots(str(CHARUCO))[0][0]
    old = shots(str(replace(CHARUCO, legacy=True)))[0][0]

    assert detect_board(image, CHARUCO).view is not None
    assert "without :legacy" in reason_of(image, replace(CHARUCO, legacy=True))
    assert "with :legacy" in reason_of(old, CHARUCO)


def test_charuco_failures_are_told_apart() -> None:
    image = shots(str(CHARUCO))[0][0]

    assert reason_of(np.asarray(255 - image, np.uint8), CHARUCO).startswith("inverted contrast")
    other = replace(CHARUCO, dictionary="DICT_6X6_250")
    assert reason_of(image, other).startswith("wrong dictionary: 24 markers of DICT_5X5")
    wide = reason_of(image, replace(CHARUCO, columns=10, rows=5))
    assert "8 columns and 6 rows" in wide
    tight = detect_board(image, replace(CHARUCO, marker_mm=24.5))
    assert any("markers look 2" in note and "not 24.5" in note for note in tight.details)


def test_half_a_charuco_board_is_enough() -> None:
    images, truth, _ = shots(str(CHARUCO))
    image = images[0].copy()
    middle = int(truth[0][:, 0].mean())
    image[:, middle:] = 100

    found = detect_board(image, CHARUCO)

    assert found.view is not None
    assert 6 <= len(found.view.points) < 30
    assert np.abs(errors(found, CHARUCO, truth[0])).max() < 0.1


@pytest.mark.parametrize("text", ["chessboard:9x6:25", "circles:9x7:15", str(CHARUCO)])
def test_pictures_without_a_board_say_so(text: str) -> None:
    board = parse_board(text)
    noise = np.random.default_rng(5).integers(0, 255, (240, 320)).astype(np.uint8)

    assert reason_of(np.zeros((240, 320), np.uint8), board).startswith("no board: the picture is")
    assert detect_board(noise, board).view is None
    assert "too small" in reason_of(np.zeros((20, 20), np.uint8), board)
    wrong: list[Any] = [np.zeros((9, 9, 4), np.uint8), np.zeros((9, 9)), np.zeros((0, 9), np.uint8)]
    for image in wrong:
        with pytest.raises(ValueError, match="image must"):
            detect_board(image, board)


def test_colour_is_no_hindrance() -> None:
    image = shots("chessboard:9x6:25")[0][0]
    gray, rgb = detect_board(image, CHESS), detect_board(np.stack([image] * 3, axis=-1), CHESS)

    assert gray.view is not None and rgb.view is not None
    assert np.abs(gray.view.pixels - rgb.view.pixels).max() < 0.01


# --- real pictures --------------------------------------------------------------------------------


def test_the_classic_pictures_reach_what_is_there_to_be_had() -> None:
    if not REAL.is_dir():
        pytest.skip("real chessboard pictures are not there (../shared/data/real/chessboards)")
    views, lenses = {}, {}
    for side in ("left", "right"):
        found = []
        for path in sorted(REAL.glob(f"{side}*.jpg")):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert image is not None
            found.append(detect_board(np.asarray(image, np.uint8), CHESS, name=path.stem[-2:]))
        assert [d.reason for d in found] == [None] * 13
        views[side] = [d.view for d in found if d.view is not None]
        assert all(len(v.points) == 54 for v in views[side])
        lenses[side] = calibrate_board(views[side], (640, 480), model="opencv5")
        assert not lenses[side].views_rejected

    rig = calibrate_rig(
        views, {s: c.camera for s, c in lenses.items()}, refine=dict.fromkeys(views, "opencv5")
    )

    assert lenses["left"].rms_px <= 0.180
    assert lenses["right"].rms_px <= 0.185
    assert rig.rms_px <= 0.198
    baseline = np.linalg.norm(rig.rig["left"].position - rig.rig["right"].position)
    assert baseline == pytest.approx(83.2, abs=0.3)
    assert lenses["left"]["fx"].value == pytest.approx(533.1, abs=1.5)


def test_the_classic_pictures_are_counted() -> None:
    if not REAL.is_dir():
        pytest.skip("real chessboard pictures are not there (../shared/data/real/chessboards)")
    for path in sorted(REAL.glob("*1.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert "shows 9x6" in reason_of(
            np.asarray(image, np.uint8), parse_board("chessboard:8x6:25")
        )
