"""One lens from views of a board: against OpenCV, Monte Carlo, and bad sets of views."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.lens import (
    LENS_MODELS,
    BoardView,
    LensCalibration,
    board_pose,
    calibrate_board,
    coverage,
    point_sd_mm,
)
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.board_poses import camera_poses

Floats = NDArray[np.float64]
SIZE = (1280, 960)
K = np.array([[1250.0, 0, 633.0], [0, 1246.0, 487.0], [0, 0, 1]])
LENS = Camera(SIZE, K, Rigid.identity(), "opencv", np.array([-0.22, 0.08, 6e-4, -4e-4, 0.0]))
BOARD = parse_board("chessboard:9x6:25")
CORNERS = BOARD.object_points()
SD = 0.15


def poses(n: int = 12, *, poor: bool = False) -> tuple[Rigid, ...]:
    return camera_poses(BOARD, LENS, n, np.random.default_rng(8), poor=poor)


def views_of(
    held: tuple[Rigid, ...], seed: int = 0, sd: float = SD, lens: Camera = LENS
) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    return [
        BoardView(f"view {i}", CORNERS, lens.project(p.apply(CORNERS)) + rng.normal(0, sd, (54, 2)))
        for i, p in enumerate(held)
    ]


def lens_error(found: LensCalibration) -> Floats:
    row = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], LENS.distortion])
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    true = dict(zip(names, row, strict=True))
    return np.array([true[p.name] - p.value for p in found.parameters])


@pytest.fixture(scope="module")
def repeated() -> list[LensCalibration]:
    held = poses()
    return [calibrate_board(views_of(held, seed), SIZE, model="opencv4") for seed in range(120)]


def test_without_noise_the_lens_is_exact() -> None:
    found = calibrate_board(views_of(poses(), sd=0.0), SIZE, model="opencv4")

    np.testing.assert_allclose(lens_error(found)[:4], 0, atol=1e-4)
    np.testing.assert_allclose(lens_error(found)[4:], 0, atol=1e-6)
    for pose, true in zip(found.board_poses, poses(), strict=True):
        np.testing.assert_allclose(pose.matrix, true.matrix, atol=1e-3)


@pytest.mark.parametrize(
    ("model", "flags"),
    [
        ("opencv4", cv2.CALIB_FIX_K3),
        ("opencv5", 0),
        ("radial1", cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST),
    ],
)
def test_the_lens_is_that_of_calibrate_camera(model: str, flags: int) -> None:
    views = views_of(poses())

    found = calibrate_board(views, SIZE, model=model)

    exactly = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-15)
    rms, theirs, k, *_ = cv2.calibrateCamera(
        [CORNERS.astype(np.float32)] * len(views),
        [v.pixels.astype(np.float32) for v in views],
        SIZE,
        np.zeros((3, 3)),
        np.zeros(5),
        flags=flags,
        criteria=exactly,
    )
    assert found.rms_px <= rms * (1 + 1e-5)
    if rms < 0.3:  # else the model is wrong and the minimum flat
        np.testing.assert_allclose(found.camera.matrix, theirs, atol=0.05)
        np.testing.assert_allclose(found.camera.distortion, np.ravel(k)[:5], atol=2e-3)


def test_the_stated_covariance_is_that_of_repetition(repeated: list[LensCalibration]) -> None:
    errors = np.array([lens_error(f) for f in repeated])
    stated = np.sqrt(np.mean([np.diag(f.covariance) for f in repeated], axis=0))

    np.testing.assert_allclose(errors.std(axis=0) / stated, 1, atol=4 / np.sqrt(2 * len(errors)))
    scale = np.outer(stated, stated)
    correlations = np.mean([f.covariance for f in repeated], axis=0) / scale
    np.testing.assert_allclose(np.cov(errors.T) / scale, correlations, atol=0.5)
    assert np.mean([f.sd_px for f in repeated]) == pytest.approx(SD, rel=0.01)


@pytest.mark.parametrize("gauge", ["rotation", "none"])
def test_stated_millimetres_are_those_of_repetition(
    repeated: list[LensCalibration], gauge: str
) -> None:
    x, y = np.meshgrid(np.linspace(40, 1240, 7), np.linspace(40, 920, 5))
    at, distance = np.stack([x, y], axis=-1), 750.0

    sds = [point_sd_mm(f, at, distance, gauge=gauge) for f in repeated]
    stated = np.sqrt(np.mean(np.square(sds), axis=0))

    places = [f.camera.undistort(at) for f in repeated]
    if gauge == "rotation":
        places = [turned_back(f.camera, xy) for f, xy in zip(repeated, places, strict=True)]
    off = (np.array(places) - LENS.undistort(at)) * distance
    seen = np.sqrt((off**2).mean(axis=(0, -1)))
    # each of 35 places has about 120 draws of two directions that go together
    np.testing.assert_allclose(seen / stated, 1, atol=0.3)
    assert np.sqrt((seen**2).mean() / (stated**2).mean()) == pytest.approx(1, abs=0.15)


def turned_back(camera: Camera, xy: Floats) -> Floats:
    """Ideal coordinates after the rotation that lays the camera's rays best over the true ones."""
    x, y = np.meshgrid(np.linspace(40, 1240, 16), np.linspace(30, 930, 12))
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    turn, _ = Rotation.align_vectors(LENS.ray(grid), camera.ray(grid))
    p = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1) @ turn.as_matrix().T
    return np.asarray(p[..., :2] / p[..., 2:])


def test_a_shift_of_the_centre_is_harmless_to_whoever_finds_the_pose(
    repeated: list[LensCalibration],
) -> None:
    at = np.array([[400.0, 300.0], [640.0, 480.0]])

    turned, fixed = (point_sd_mm(repeated[0], at, 750.0, gauge=g) for g in ("rotation", "none"))

    centre_mm = 750 * repeated[0]["cx"].sd / repeated[0]["fx"].value
    assert (fixed > 0.5 * centre_mm).all()
    assert (turned < 0.5 * fixed).all()
    with pytest.raises(ValueError, match="gauge must be rotation or none"):
        point_sd_mm(repeated[0], at, 750.0, gauge="pose")


def test_millimetres_grow_with_distance_and_with_noise() -> None:
    found = calibrate_board(views_of(poses()), SIZE, model="opencv4")
    told = calibrate_board(views_of(poses()), SIZE, model="opencv4", sd_px=2 * found.sd_px)
    at = np.array([[100.0, 100.0], [640.0, 480.0]])

    near, far = (point_sd_mm(found, at, d) for d in (500.0, 1500.0))

    assert near.shape == (2,)
    np.testing.assert_allclose(far, 3 * near)
    np.testing.assert_allclose(point_sd_mm(told, at, 500.0), 2 * near, rtol=1e-6)


@pytest.mark.parametrize("true", ["none", "radial1", "opencv4"])
def test_a_model_as_plain_as_the_lens_is_chosen(true: str) -> None:
    k = np.zeros(5)
    k[: len(LENS_MODELS[true])] = LENS.distortion[: len(LENS_MODELS[true])]
    lens = Camera(SIZE, K, Rigid.identity(), "opencv", k)
    held = camera_poses(BOARD, lens, 14, np.random.default_rng(8))

    found = calibrate_board(views_of(held, lens=lens), SIZE)

    order = list(LENS_MODELS)
    assert set(found.held_out_px) == set(order)
    assert found.held_out_px[found.model] <= 1.011 * min(found.held_out_px.values())
    enough = "radial2" if true == "opencv4" else true
    assert order.index(enough) <= order.index(found.model) <= order.index("opencv4")
    wrong = [m for m in order if order.index(m) < order.index(enough)]
    assert all(found.held_out_px[m] > 1.01 * found.held_out_px[found.model] for m in wrong)


def test_a_term_that_hides_in_the_residuals_but_bends_the_rest_is_estimated() -> None:
    # tangential distortion passes for a shift of the centre: a hundredth of the residual is left
    lens = Camera(SIZE, K, Rigid.identity(), "opencv", np.array([-0.22, 0.08, 2e-4, 2e-4, 0]))
    held = camera_poses(BOARD, lens, 40, np.random.default_rng(5))

    found = calibrate_board(views_of(held, sd=0.1, lens=lens), SIZE)

    plain = found.held_out_px["radial2"] / min(found.held_out_px.values())
    assert plain < 1.01, "too easy: the residuals tell"
    assert found.model == "opencv4"
    shift = np.abs([K[0, 2] - found["cx"].value, K[1, 2] - found["cy"].value])
    assert (shift < 4 * np.array([found["cx"].sd, found["cy"].sd])).all()


def test_a_model_that_cannot_predict_a_view_is_not_chosen() -> None:
    # five views in the middle, one far out: fitted to the five, the richest model folds before it
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (5, 3))).as_matrix()
    held = [Rigid.from_rotation(R, (*rng.uniform(-120, -80, 2), 900.0)) for R in turns]
    held.insert(2, Rigid.from_rotation(np.eye(3), (200.0, 150.0, 800.0)))

    found = calibrate_board(views_of(tuple(held), sd=0.3, lens=Camera(SIZE, K)), SIZE)

    assert found.held_out_px["opencv8"] == np.inf
    assert found.model in ("none", "radial1")


def test_a_lens_that_does_not_reach_a_view_is_told() -> None:
    folding = Camera(SIZE, K, Rigid.identity(), "opencv", np.array([-2.0, 0, 0, 0, 0]))
    far_out = BoardView("corner", CORNERS, np.full((54, 2), 1200.0) + CORNERS[:, :2] / 10)
    with pytest.raises(InputError, match="view corner: the lens's distortion folds"):
        board_pose(far_out, folding)


def test_a_view_whose_corners_are_in_a_wrong_order_is_thrown_out() -> None:
    views = views_of(poses())
    views[4] = BoardView("shifted by a row", CORNERS, np.roll(views[4].pixels, 9, axis=0))

    found = calibrate_board(views, SIZE, model="opencv4")

    assert [v.name for v in found.views_rejected] == ["shifted by a row"]
    assert "residual of" in found.views_rejected[0].reason
    assert len(found.views) == 11
    assert found.rms_used_px < 0.25 < found.rms_px


def test_a_bowed_board_is_found() -> None:
    middle, reach2 = CORNERS.mean(axis=0), (np.ptp(CORNERS, axis=0)[:2] ** 2).sum() / 4
    r2 = ((CORNERS - middle)[:, :2] ** 2).sum(axis=1) / reach2
    bowed = CORNERS + np.column_stack([0 * r2, 0 * r2, 0.8 * (1 - r2)])
    rng = np.random.default_rng(2)
    views = [
        BoardView(f"{i}", CORNERS, LENS.project(p.apply(bowed)) + rng.normal(0, SD, (54, 2)))
        for i, p in enumerate(poses())
    ]

    flat, found = (
        calibrate_board(views, SIZE, model="opencv4", estimate_bow=bow) for bow in (False, True)
    )

    assert found.bow_mm == pytest.approx(0.8, abs=0.1)
    assert found.rms_px < flat.rms_px
    assert np.abs(lens_error(found)[:2]).max() < np.abs(lens_error(flat)[:2]).max()


def test_a_view_with_few_corners_is_named() -> None:
    views = views_of(poses())
    views[0] = BoardView("cut off", CORNERS[:5], views[0].pixels[:5])

    found = calibrate_board(views, SIZE, model="opencv4")

    assert [(v.name, v.reason) for v in found.views_rejected] == [("cut off", "only 5 corners")]


def test_one_view_gives_one_focal_length_and_says_so() -> None:
    found = calibrate_board(views_of(poses())[:1], SIZE)

    assert any("one view only" in w for w in found.warnings)
    assert found.parameters[0].name == "f"
    assert found.camera.matrix[0, 0] == found.camera.matrix[1, 1]
    assert np.isfinite([(p.value, p.sd) for p in found.parameters]).all()


def test_views_that_are_all_alike_are_told() -> None:
    found = calibrate_board(views_of(poses(poor=True)), SIZE, model="opencv4")

    assert any("nearly the same slant" in w or "never tilted" in w for w in found.warnings)
    assert any("cover" in w for w in found.warnings)
    assert np.isfinite([(p.value, p.sd) for p in found.parameters]).all()


def test_the_same_view_again_and_again_is_told() -> None:
    held = (poses()[1],) * 8

    found = calibrate_board(views_of(held), SIZE, model="opencv4")

    assert any("nearly the same slant" in w for w in found.warnings)
    assert np.isfinite([(p.value, p.sd) for p in found.parameters]).all()


def test_a_good_set_is_praised_by_silence() -> None:
    assert calibrate_board(views_of(poses(20)), SIZE, model="opencv4").warnings == ()


@pytest.mark.parametrize(
    ("views", "told"),
    [
        ([], "no view shows 6 corners"),
        ([BoardView("a", CORNERS[:3], np.zeros((3, 2)))], "no view shows 6 corners"),
        ([BoardView("a", CORNERS[:9], np.ones((9, 2)))] * 3, "one line"),
        ([BoardView("a", CORNERS, np.full((54, 2), np.nan))] * 3, "finite"),
        ([BoardView("a", CORNERS, np.zeros((54, 2)))] * 3, "a: its corners lie on one line"),
    ],
)
def test_views_that_cannot_do_are_told(views: list[BoardView], told: str) -> None:
    with pytest.raises(InputError, match=told):
        calibrate_board(views, SIZE, model="opencv4")


def test_an_unknown_model_is_told() -> None:
    with pytest.raises(InputError, match="no lens model fisheye"):
        calibrate_board(views_of(poses()), SIZE, model="fisheye")


def test_coverage_counts_cells() -> None:
    pixels = np.array([[0.0, 0.0], [1279.0, 959.0], [10.0, 10.0]])

    assert coverage([BoardView("a", np.zeros((3, 3)), pixels)], SIZE) == pytest.approx(2 / 64)


def test_a_turned_board_frame_leaves_the_lens_alone() -> None:
    turn = Rotation.from_rotvec([0, 0, 0.7]).as_matrix()
    moved = [
        BoardView(v.name, v.points @ turn.T + (40, -9, 0), v.pixels) for v in views_of(poses())
    ]

    one, two = (calibrate_board(v, SIZE, model="opencv4") for v in (views_of(poses()), moved))

    np.testing.assert_allclose(two.camera.matrix, one.camera.matrix, atol=1e-3)
    np.testing.assert_allclose(two.covariance, one.covariance, rtol=1e-3, atol=1e-12)
    assert Rotation.from_matrix(LENS.camera_from_world.rotation).magnitude() == 0
