from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.formats.rig_json import read_rig
from facewright.core.rigid import Rigid
from facewright.core.video import read_frames
from facewright.datasets_synthetic.board_pictures import BoardPictures
from facewright.datasets_synthetic.boards import (
    IDEAL_LOOK,
    BoardLook,
    BoardShots,
    board_truth,
    board_views,
    make_board_shots,
    shoot_board,
)

SIZE = (800, 600)
SLIGHTLY_BLURRED = BoardLook(0.0, 0.8, IDEAL_LOOK.sensor, False)


def ideal(
    spec: str, n_views: int = 6, *, poor: bool = False, bow_mm: tuple[float, float] = (0.0, 0.0)
) -> BoardShots:
    return make_board_shots(
        parse_board(spec),
        5,
        n_views=n_views,
        poor=poor,
        image_size=SIZE,
        bow_mm=bow_mm,
        look=SLIGHTLY_BLURRED,
    )


def found_corners(picture: NDArray[np.uint8], like: NDArray[np.float64]) -> NDArray[np.float64]:
    """A 9x6 chessboard's corners by OpenCV, in the order of those that are like them."""
    is_found, corners = cv2.findChessboardCorners(picture, (9, 6))
    assert is_found
    spacing = np.linalg.norm(np.diff(corners.reshape(6, 9, 2), axis=1), axis=-1).min()
    window = max(2, int(spacing / 3))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    refined = cv2.cornerSubPix(picture, corners, (window, window), (-1, -1), stop).reshape(-1, 2)
    is_turned = np.linalg.norm(refined[0] - like[0]) > np.linalg.norm(refined[-1] - like[0])
    return np.asarray(refined[::-1] if is_turned else refined, dtype=np.float64)


def rms(off: NDArray[np.float64]) -> float:
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


@pytest.mark.parametrize("bow_mm", [(0.0, 0.0), (1.5, -1.0)])
def test_opencv_finds_chessboard_corners_where_truth_has_them(bow_mm: tuple[float, float]) -> None:
    shots = ideal("chessboard:9x6:25", bow_mm=bow_mm)
    truth = board_truth(shots)["pixels"][0]

    off = [
        rms(found_corners(picture, true) - true)
        for picture, true in zip(board_views(shots, "cam0"), truth, strict=True)
    ]

    assert len(off) == 6
    assert max(off) < 0.05, np.round(off, 3)


def test_opencv_finds_charuco_corners_and_ids_where_truth_has_them() -> None:
    shots = ideal("charuco:8x5:35:26:DICT_5X5_100", n_views=4)
    truth = board_truth(shots)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    known = cv2.aruco.CharucoBoard((8, 5), 35.0, 26.0, dictionary)
    detector = cv2.aruco.CharucoDetector(known)

    for view, picture in enumerate(board_views(shots, "cam0")):
        corners, ids, _, _ = detector.detectBoard(picture)

        assert len(ids) > 20
        true = truth["pixels"][0, view, ids.ravel()]
        assert np.median(np.linalg.norm(corners.reshape(-1, 2) - true, axis=1)) < 0.05


@pytest.mark.parametrize("spec", ["circles:7x6:25", "circles:4x11:18:asymmetric"])
def test_dots_have_their_centroids_where_truth_has_them(spec: str) -> None:
    shots = ideal(spec, n_views=3)
    truth = board_truth(shots)
    board = shots.board

    for view, pose in enumerate(shots.world_from_board):
        sheet, white = BoardPictures(board, shots.rig["cam0"]).cover(pose)
        black = (sheet - white).astype(np.float64)
        y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
        count, labels = cv2.connectedComponents((black > 0).astype(np.uint8))
        assert count == 1 + len(truth["ids"])
        middles = truth["centroids"][0, view]
        places = labels[tuple(np.rint(middles).astype(int).T[::-1])]
        assert len(set(places)) == len(middles) and places.min() > 0
        for label, middle in zip(places, middles, strict=True):
            ink = np.where(labels == label, black, 0)
            at = np.array([(ink * x).sum(), (ink * y).sum()]) / ink.sum()
            assert np.abs(at - middle).max() < 0.005

    bias = np.linalg.norm(truth["centroids"] - truth["pixels"], axis=-1)
    assert 0.01 < bias.max() < 2, "a tilted dot's centroid is not its centre"


def half_plane_cover(off: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of a unit square on the inner side of a straight edge, `off` from its middle."""
    a, b = sorted(np.abs(normal))[::-1]
    if b < 1e-9:
        return np.asarray(np.clip(off / a + 0.5, 0, 1))

    def ramp(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.maximum(x, 0) ** 2)

    outer, inner = (a + b) / 2, (a - b) / 2
    total = ramp(off + outer) - ramp(off + inner) - ramp(off - inner) + ramp(off - outer)
    return np.asarray(total / (2 * a * b))


@pytest.mark.parametrize("angle_deg", [0.0, 7.0, 30.0, 45.0])
@pytest.mark.parametrize("side", [0, 1, 2, 3])
def test_edges_lie_where_they_should_to_a_hundredth_of_a_pixel(angle_deg: float, side: int) -> None:
    board = parse_board("chessboard:5x4:20")
    camera = Camera((320, 240), np.array([[500.0, 0, 160.3], [0, 500.0, 119.7], [0, 0, 1]]))
    a = np.deg2rad(angle_deg)
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    middle = board.object_points().mean(axis=0)
    pose = Rigid.from_rotation(R, np.array([0.137, -0.211, 500.0]) - R @ middle)  # 1 px a mm

    sheet, _ = BoardPictures(board, camera).cover(pose)

    x0, y0, x1, y1 = board.sheet_box
    corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])
    start, end = camera.project(pose.apply(corners))[[side, (side + 1) % 4]]
    along = (end - start) / np.linalg.norm(end - start)
    inwards = np.array([-along[1], along[0]])
    y, x = np.mgrid[0:240, 0:320]
    from_start = np.stack([x, y], axis=-1) - start
    off, place = from_start @ inwards, from_start @ along
    near = (np.abs(off) < 3) & (place > 5) & (place < np.linalg.norm(end - start) - 5)
    error = sheet[near] - half_plane_cover(off[near], inwards)
    assert near.sum() > 500
    assert np.abs(error).max() < 0.025, "of a single pixel"
    length = np.linalg.norm(end - start) - 10
    assert abs(error.sum() / length) < 0.003, "px by which the edge lies off"


def test_calibration_of_the_pictures_gives_the_camera_back() -> None:
    shots = ideal("chessboard:9x6:25", n_views=12)
    camera = shots.rig["cam0"]
    truth = board_truth(shots)["pixels"][0]
    seen = [
        found_corners(picture, true).astype(np.float32)
        for picture, true in zip(board_views(shots, "cam0"), truth, strict=True)
    ]
    flat = [shots.board.object_points().astype(np.float32)] * len(seen)

    error, K, k, _, _ = cv2.calibrateCamera(flat, seen, SIZE, None, None)

    assert error < 0.05
    assert np.allclose(K.diagonal(), camera.matrix.diagonal(), rtol=1e-3)
    assert np.abs(K - camera.matrix)[:2, 2].max() < 0.6
    x = np.linspace(0, SIZE[0] - 1, 20)
    found = Camera(SIZE, K, Rigid.identity(), "opencv", np.ravel(k)[:5])
    middle_row = np.stack([x, np.full(20, SIZE[1] / 2)], axis=1)
    assert np.abs(found.undistort(middle_row) - camera.undistort(middle_row)).max() < 1e-3


def test_wide_coverage_fills_the_picture_and_poor_does_not() -> None:
    wide = board_truth(ideal("chessboard:9x6:25", n_views=20))
    poor = board_truth(ideal("chessboard:9x6:25", n_views=20, poor=True))

    def cells_filled(truth: dict[str, NDArray[np.float64]]) -> int:
        cells = (truth["pixels"][0].reshape(-1, 2) / SIZE * 5).astype(int)
        return len(np.unique(cells, axis=0))

    def tilts_deg(truth: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        z = [Rigid(q, np.zeros(3)).rotation[2, 2] for q in truth["board_quaternion"]]
        return np.asarray(np.degrees(np.arccos(z)))

    assert wide["visible"].all() and poor["visible"].all()
    assert cells_filled(wide) == 25 and cells_filled(poor) <= 12
    assert tilts_deg(wide).max() > 30 and tilts_deg(wide).max() < 45.1
    assert tilts_deg(poor).max() < 2.1


@pytest.mark.parametrize("n_cameras", [2, 4, 8])
def test_neighbouring_cameras_of_a_rig_share_views(n_cameras: int) -> None:
    shots = make_board_shots(
        parse_board("chessboard:9x6:18"), 1, n_cameras=n_cameras, n_views=3 * n_cameras
    )
    whole = board_truth(shots)["visible"].all(axis=2)

    assert whole.shape == (n_cameras, 3 * n_cameras)
    shared = whole.astype(int) @ whole.T.astype(int)
    assert (np.diag(shared, 1) >= 3).all(), shared


def test_one_truth_serves_all_cameras() -> None:
    shots = make_board_shots(
        parse_board("chessboard:9x6:18"), 1, n_cameras=2, n_views=2, look=SLIGHTLY_BLURRED
    )
    truth = board_truth(shots)

    for number, name in enumerate(shots.rig):
        for view, picture in enumerate(board_views(shots, name)):
            true = truth["pixels"][number, view]
            assert rms(found_corners(picture, true) - true) < 0.08


def test_back_of_a_board_is_white_and_its_points_are_not_seen() -> None:
    shots = ideal("chessboard:9x6:25", n_views=1)
    turned = Rigid.from_rotation(np.diag([-1.0, 1.0, -1.0]), (100, -60, 600))
    behind = BoardShots(shots.board, shots.rig, (turned,), (0.0, 0.0), shots.look, 0)

    sheet, white = BoardPictures(shots.board, shots.rig["cam0"]).cover(turned)

    assert sheet.sum() > 1e4 and np.array_equal(sheet, white)
    assert not board_truth(behind)["visible"].any()


def test_shots_are_written_with_their_truth_and_the_same_each_time(tmp_path: Path) -> None:
    shots = make_board_shots(parse_board("chessboard:9x6:25"), 2, n_views=2, image_size=(320, 240))
    done: list[int] = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shoot_board(shots, tmp_path / name, on_picture=done.append)

    names = sorted(str(p.relative_to(tmp_path / "a")) for p in (tmp_path / "a").rglob("*"))
    assert names == [
        "board.toml", "cam0", "cam0/view_000.png", "cam0/view_001.png", "rig.json", "truth.npz",
    ]  # fmt: skip
    assert done == [1, 2, 1, 2]
    for name in names:
        if name != "cam0":
            assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    settings = tomllib.loads((tmp_path / "a" / "board.toml").read_text())
    assert parse_board(settings["board"]) == shots.board
    rig = read_rig(tmp_path / "a" / "rig.json")
    with np.load(tmp_path / "a" / "truth.npz") as truth:
        pose = Rigid(truth["board_quaternion"][1], truth["board_translation"][1])
        again = rig["cam0"].project(pose.apply(truth["points"]))
        assert np.abs(again - truth["pixels"][0, 1]).max() < 1e-9
    picture = cv2.imread(str(tmp_path / "a" / "cam0" / "view_001.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert np.array_equal(picture, list(board_views(shots, "cam0"))[1])


def test_video_shows_a_smooth_motion(tmp_path: Path) -> None:
    shots = make_board_shots(
        parse_board("chessboard:9x6:25"), 2, n_views=30, moving=True, image_size=(320, 240)
    )
    shoot_board(shots, tmp_path, video=True)

    frames = sum(1 for _ in read_frames(tmp_path / "cam0.mp4", gray=True))
    with np.load(tmp_path / "truth.npz") as truth:
        path = truth["pixels"][0, :, 0]
    assert frames == 30 == len(path)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    jerks = np.linalg.norm(np.diff(path, n=2, axis=0), axis=1)
    assert 0 < steps.max() < 60 and jerks.max() < 0.5 * steps.max()


def test_noise_light_and_background_make_a_shot_less_perfect() -> None:
    board = parse_board("chessboard:9x6:25")
    plain, real = (
        next(board_views(make_board_shots(board, 4, n_views=1, image_size=SIZE, look=look), "cam0"))
        for look in (IDEAL_LOOK, BoardLook())
    )

    assert len(np.unique(plain)) < 300 and plain.std() > 10
    corner = real[:40, :40].astype(float)
    assert corner.std() > 1 and plain[:40, :40].std() < 1
    truth = board_truth(make_board_shots(board, 4, n_views=1, image_size=SIZE))["pixels"][0, 0]
    assert rms(found_corners(real, truth) - truth) < 0.1


def test_shots_that_cannot_be_made_are_refused() -> None:
    board = parse_board("chessboard:9x6:25")
    with pytest.raises(InputError, match="1 to 8 cameras, got 9"):
        make_board_shots(board, 0, n_cameras=9)
    with pytest.raises(InputError, match="at least one view"):
        make_board_shots(board, 0, n_views=0)
    with pytest.raises(InputError, match="too large"):
        make_board_shots(parse_board("chessboard:9x6:250"), 0, n_cameras=4, n_views=4)
