"""Pose from a few points: against OpenCV, its own stated uncertainty, and wrong points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

from facewright.capture.pose import estimate_pose
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rigid import Rigid

Floats = NDArray[np.float64]
K = np.array([[1500.0, 0, 640.0], [0, 1495.0, 480.0], [0, 0, 1]])
R = Rotation.from_euler("xyz", [170, 20, -15], degrees=True).as_matrix()
POSE = Rigid.from_rotation(R, (20.0, -15.0, 800.0))
MODELS = {"none": (), "opencv": (-0.2, 0.05, 1e-3, -1e-3, 0.0), "tsai": (0.25,)}
SD = 0.5


def camera(model: str = "opencv") -> Camera:
    return Camera((1280, 960), K, POSE, model, np.array(MODELS[model]))


def head(n: int = 14) -> Floats:
    return np.random.default_rng(5).uniform((-75, -110, 0), (75, 110, 95), (n, 3))


def state_error(found: Rigid) -> Floats:
    turn = Rotation.from_matrix(POSE.rotation @ found.rotation.T).as_rotvec()
    return np.concatenate([turn, POSE.translation - found.translation])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("n", [4, 6, 14])
def test_without_noise_the_pose_is_exact(model: str, n: int) -> None:
    X = head(n)

    found = estimate_pose(X, camera(model).project(X), camera(model))

    np.testing.assert_allclose(state_error(found.camera_from_world), 0, atol=1e-6)
    assert found.is_used.all()
    assert found.rms_px < 1e-6


def test_the_pose_is_that_of_solve_pnp() -> None:
    X = head()
    for seed in range(20):
        uv = camera().project(X) + np.random.default_rng(seed).normal(0, SD, (14, 2))

        found = estimate_pose(X, uv, camera())

        k = camera().distortion
        _, turn, shift = cv2.solvePnP(X, uv, K, k, flags=cv2.SOLVEPNP_SQPNP)
        turn, shift = cv2.solvePnPRefineLM(
            X, uv, K, k, turn, shift, criteria=(cv2.TERM_CRITERIA_COUNT, 200, 0.0)
        )
        if found.is_used.all():
            np.testing.assert_allclose(
                found.camera_from_world.translation, shift.ravel(), atol=2e-3
            )
            np.testing.assert_allclose(
                found.camera_from_world.rotation, cv2.Rodrigues(turn)[0], atol=5e-6
            )


def test_the_stated_covariance_is_that_of_repetition() -> None:
    X, n = head(), 150
    found = [
        estimate_pose(
            X, camera().project(X) + np.random.default_rng(seed).normal(0, SD, (14, 2)), camera()
        )
        for seed in range(n)
    ]

    errors = np.array([state_error(f.camera_from_world) for f in found])
    z2 = [e @ np.linalg.solve(f.covariance, e) for e, f in zip(errors, found, strict=True)]

    covered = np.mean(np.array(z2) <= 6 * stats.f.ppf(0.95, 6, 22))
    assert abs(covered - 0.95) < 3.3 * np.sqrt(0.95 * 0.05 / n), f"{100 * covered:.1f} % covered"
    stated = np.sqrt(np.mean([np.diag(f.covariance) for f in found], axis=0))
    np.testing.assert_allclose(errors.std(axis=0) / stated, 1, atol=4 / np.sqrt(2 * n))
    assert np.mean([f.sd_px for f in found]) == pytest.approx(SD, rel=0.06)


def test_a_moved_world_moves_the_pose() -> None:
    X = head()
    uv = camera().project(X) + np.random.default_rng(1).normal(0, SD, (14, 2))
    new_from_old = Rigid.from_rotation(
        Rotation.from_rotvec([0.5, -1.0, 0.2]).as_matrix(), (300.0, -2000.0, 40.0)
    )

    still = estimate_pose(X, uv, camera()).camera_from_world
    moved = estimate_pose(new_from_old.apply(X), uv, camera()).camera_from_world

    back = moved @ new_from_old
    np.testing.assert_allclose(back.rotation, still.rotation, atol=1e-7)
    np.testing.assert_allclose(back.translation, still.translation, atol=1e-3)


def test_scaling_the_world_scales_the_distance() -> None:
    X = head()
    uv = camera().project(X) + np.random.default_rng(1).normal(0, SD, (14, 2))

    one, ten = estimate_pose(X, uv, camera()), estimate_pose(10 * X, uv, camera())

    np.testing.assert_allclose(
        ten.camera_from_world.translation, 10 * one.camera_from_world.translation, rtol=1e-6
    )
    np.testing.assert_allclose(ten.covariance[3:, 3:], 100 * one.covariance[3:, 3:], rtol=1e-4)


def test_known_noise_is_taken_as_told() -> None:
    X = head()
    uv = camera().project(X) + np.random.default_rng(1).normal(0, SD, (14, 2))

    told, found = estimate_pose(X, uv, camera(), sd_px=2.0), estimate_pose(X, uv, camera())

    assert told.sd_px == 2.0
    np.testing.assert_allclose(told.covariance / 4, found.covariance / found.sd_px**2, rtol=1e-6)


@pytest.mark.parametrize("n_wrong", [1, 2, 4])
def test_wrong_points_are_named(n_wrong: int) -> None:
    X, named, errors = head(), 0, []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        uv = camera().project(X) + rng.normal(0, SD, (14, 2))
        wrong = rng.choice(14, n_wrong, replace=False)
        turn = rng.uniform(0, 2 * np.pi, n_wrong)
        uv[wrong] += np.column_stack([np.cos(turn), np.sin(turn)]) * rng.uniform(
            25, 400, (n_wrong, 1)
        )

        found = estimate_pose(X, uv, camera(), rng=rng)

        named += not found.is_used[wrong].any()
        errors.append(np.linalg.norm(state_error(found.camera_from_world)[3:]))
        assert found.rms_used_px < found.rms_px
    assert named >= 39, f"all {n_wrong} named in {named} of 40 draws"
    assert np.median(errors) < 6.0, f"{np.median(errors):.2f} mm"


def test_good_points_are_seldom_thrown_out() -> None:
    X = head()
    lost = sum(
        not estimate_pose(
            X, camera().project(X) + np.random.default_rng(seed).normal(0, SD, (14, 2)), camera()
        ).is_used.all()
        for seed in range(100)
    )

    assert lost <= 2, f"{lost} of 100 clean sets lost a point"


@pytest.mark.parametrize(
    ("X", "uv", "told"),
    [
        (head(3), np.zeros((3, 2)), "at least 4 points, got 3"),
        (np.outer(np.arange(8.0), (10, 5, 2)), np.zeros((8, 2)), "on one line"),
        (np.ones((8, 3)), np.zeros((8, 2)), "on one line"),
        (np.full((8, 3), np.nan), np.zeros((8, 2)), "finite"),
        (head(8), np.full((8, 2), np.inf), "finite"),
    ],
)
def test_bad_points_are_told(X: Floats, uv: Floats, told: str) -> None:
    with pytest.raises(InputError, match=told):
        estimate_pose(X, uv, camera())


def test_pixels_beyond_the_lens_are_told() -> None:
    folding = Camera((1280, 960), K, POSE, "opencv", np.array([-2.0, 0, 0, 0, 0]))
    uv = camera("none").project(head())
    uv[0] = 1e5, 1e5
    with pytest.raises(InputError, match="cannot be inverted"):
        estimate_pose(head(), uv, folding)


def test_wrong_shapes_are_a_wrong_call() -> None:
    with pytest.raises(ValueError, match=r"points \(N, 3\)"):
        estimate_pose(head()[:, :2], np.zeros((14, 2)), camera())
