"""Several cameras from shared views: exactness, Monte Carlo, gauges, and bad sets."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.lens import BoardView
from facewright.capture.rigs import RigCalibration, calibrate_rig
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.board_poses import rig_poses, sees

Floats = NDArray[np.float64]
SIZE = (1280, 960)
CORNERS = parse_board("chessboard:9x6:20").object_points()
SD = 0.15


def rig(n: int = 3) -> Rig:
    cameras = {}
    for i, yaw in enumerate(np.linspace(-0.4, 0.4, n)):
        K = np.array([[1300.0 + 20 * i, 0, 640.0], [0, 1300.0 + 20 * i, 470.0], [0, 0, 1]])
        R = Rotation.from_euler("yx", [-yaw, 0.1 * i]).as_matrix()
        pose = Rigid.from_rotation(R, (5.0 * i, -7.0, 900.0))
        cameras[f"cam{i}"] = Camera(SIZE, K, pose, "opencv", np.array([-0.2, 0.06, 0, 0, 0]))
    return Rig(cameras)


HELD = tuple(rig_poses(parse_board("chessboard:9x6:20"), rig(), 16, np.random.default_rng(4)))


def views_of(
    cameras: Rig, seed: int = 0, sd: float = SD, X: Floats = CORNERS
) -> dict[str, list[BoardView]]:
    rng = np.random.default_rng(seed)
    found: dict[str, list[BoardView]] = {name: [] for name in cameras}
    for i, pose in enumerate(HELD):
        for name, camera in cameras.cameras.items():
            seen = sees(camera, pose, X)
            uv = camera.project(pose.apply(X)) + rng.normal(0, sd, (len(X), 2))
            if seen.sum() >= 20:
                found[name].append(BoardView(f"view {i}", X[seen], uv[seen]))
    return found


def in_first(found: Rig) -> dict[str, Rigid]:
    """Camera from the first camera."""
    first = next(iter(found.cameras.values())).camera_from_world.inverse()
    return {n: c.camera_from_world @ first for n, c in found.cameras.items()}


def errors(found: RigCalibration, truth: Rig) -> dict[str, Floats]:
    """δrotation and centre, true less found, in the first camera's frame."""
    true, got = in_first(truth), in_first(found.rig)
    result = {}
    for name in got:
        turn = Rotation.from_matrix(true[name].rotation @ got[name].rotation.T).as_rotvec()
        centre = true[name].inverse().translation - got[name].inverse().translation
        result[name] = np.concatenate([turn, centre])
    return result


@pytest.mark.parametrize("refine", [{}, {"cam0": "opencv4", "cam2": "opencv4"}])
def test_without_noise_the_cameras_are_exact(refine: dict[str, str]) -> None:
    found = calibrate_rig(views_of(rig(), sd=0.0), rig().cameras, refine=refine)

    for name, error in errors(found, rig()).items():
        np.testing.assert_allclose(error[:3], 0, atol=1e-7, err_msg=name)
        np.testing.assert_allclose(error[3:], 0, atol=1e-3, err_msg=name)
    assert found.rms_px < 1e-5
    assert not found.warnings


def test_lenses_that_are_refined_are_found() -> None:
    off = {n: Camera(SIZE, c.matrix * np.array([[1.01, 1, 1.005], [1, 1.01, 1], [1, 1, 1]]))
           for n, c in rig().cameras.items()}  # fmt: skip

    found = calibrate_rig(views_of(rig()), off, refine=dict.fromkeys(rig().names, "opencv4"))

    for i, name in enumerate(rig()):
        got, sd = found.rig[name].matrix, found.intrinsics_sd[name]
        assert found.parameters[name][:4] == ("fx", "fy", "cx", "cy")
        assert abs(got[0, 0] - (1300 + 20 * i)) < 4 * sd[0]
        assert abs(got[0, 2] - 640) < 4 * sd[2]
        assert sd[0] < 3


def test_the_stated_covariance_is_that_of_repetition() -> None:
    n = 60
    found = [calibrate_rig(views_of(rig(), seed), rig().cameras) for seed in range(n)]
    for name in ("cam1", "cam2"):
        off = np.array([errors(f, rig())[name] for f in found])
        stated = np.sqrt(np.mean([np.diag(f.covariance[name]) for f in found], axis=0))
        np.testing.assert_allclose(off.std(axis=0) / stated, 1, atol=4 / np.sqrt(2 * n))
    assert np.mean([f.sd_px for f in found]) == pytest.approx(SD, rel=0.02)
    np.testing.assert_array_equal(found[0].covariance["cam0"], 0)


def test_the_world_may_be_a_board() -> None:
    plain = calibrate_rig(views_of(rig()), rig().cameras)
    placed = calibrate_rig(views_of(rig()), rig().cameras, world="view 3")

    np.testing.assert_allclose(placed.view_poses["view 3"].matrix, np.eye(4), atol=1e-9)
    np.testing.assert_array_equal(plain.rig["cam0"].camera_from_world.matrix, np.eye(4))
    for name, pose in in_first(plain.rig).items():
        np.testing.assert_allclose(in_first(placed.rig)[name].matrix, pose.matrix, atol=1e-6)
    X = np.array([[10.0, 20.0, 0.0]])
    for name in rig():
        np.testing.assert_allclose(
            placed.rig[name].project(placed.view_poses["view 5"].apply(X)),
            plain.rig[name].project(plain.view_poses["view 5"].apply(X)),
            atol=1e-6,
        )
    moved = placed.view_poses["view 3"].rotation @ plain.view_poses["view 3"].rotation.T
    np.testing.assert_allclose(
        placed.covariance["cam2"][3:, 3:],
        moved @ plain.covariance["cam2"][3:, 3:] @ moved.T,
        rtol=1e-6,
        atol=1e-12,
    )


def test_targets_need_not_be_flat() -> None:
    solid = CORNERS + np.random.default_rng(0).uniform(-40, 40, CORNERS.shape) * (0, 0, 1)

    found = calibrate_rig(views_of(rig(), X=solid), rig().cameras)

    assert max(np.abs(e[3:]).max() for e in errors(found, rig()).values()) < 2.0


def test_a_picture_that_does_not_fit_is_named() -> None:
    views = views_of(rig())
    views["cam1"][2] = BoardView(
        views["cam1"][2].name, views["cam1"][2].points, views["cam1"][2].pixels + (30.0, -12.0)
    )

    found = calibrate_rig(views, rig().cameras)

    assert [v.name for v in found.views_rejected] == [f"cam1/{views['cam1'][2].name}"]
    assert found.rms_used_px < 0.3 < found.rms_px
    clean = calibrate_rig(views_of(rig()), rig().cameras)
    for name, error in errors(found, rig()).items():
        assert np.abs(error[3:] - errors(clean, rig())[name][3:]).max() < 0.5


def test_cameras_that_share_nothing_are_named() -> None:
    views = views_of(rig(4))
    views["cam3"] = [BoardView(f"alone {v.name}", v.points, v.pixels) for v in views["cam3"]]

    found = calibrate_rig(views, rig(4).cameras)

    assert found.unconnected == ("cam3",)
    assert "cam3" not in found.rig.cameras
    assert any("cam3: shares no view" in w for w in found.warnings)


def test_few_shared_views_are_told() -> None:
    views = {name: seen[:2] for name, seen in views_of(rig(2)).items()}

    found = calibrate_rig(views, rig(2).cameras)

    assert any("shares only 2 views" in w for w in found.warnings)


@pytest.mark.parametrize(
    ("views", "options", "told"),
    [
        ({"cam0": views_of(rig())["cam0"]}, {}, "fewer than two cameras"),
        ({"cam0": [], "cam1": []}, {}, "fewer than two cameras"),
        (views_of(rig()), {"world": "view 99"}, "no view view 99"),
        (views_of(rig()), {"refine": {"cam1": "fisheye"}}, "no lens model fisheye"),
        (views_of(rig()), {"refine": {"cam9": "opencv4"}}, "no camera cam9"),
    ],
)
def test_bad_sets_are_told(
    views: dict[str, list[BoardView]], options: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        calibrate_rig(views, rig().cameras, **options)  # type: ignore[arg-type]


def test_a_camera_without_a_lens_is_told() -> None:
    lenses = {n: c for n, c in rig().cameras.items() if n != "cam1"}
    with pytest.raises(InputError, match="no lens for cam1"):
        calibrate_rig(views_of(rig()), lenses)
