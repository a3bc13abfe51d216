"""The camera against OpenCV's and against its own laws."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.rigid import Rigid

COEFFICIENTS = {
    0: [],
    5: [-0.12, 0.05, 0.001, -0.002, 0.01],
    8: [0.3, 0.1, 0.001, -0.0005, 0.02, 0.4, 0.12, 0.01],
    12: [0.3, 0.1, 0.001, -0.0005, 0.02, 0.4, 0.12, 0.01, 0.002, -0.001, 0.003, 0.001],
}
MODELS = [("opencv", k) for k in COEFFICIENTS.values()] + [
    ("none", []),
    ("tsai", [0.08]),
    ("tsai", [-0.05]),
]


def camera(model: str = "none", coefficients: list[float] | None = None) -> Camera:
    rotation, _ = cv2.Rodrigues(np.array([0.2, -0.5, 0.1]))
    return Camera(
        (1280, 720),
        np.array([[1400.0, 0, 650.3], [0, 1420.0, 355.7], [0, 0, 1]]),
        Rigid.from_rotation(rotation, (20.0, -35.0, 900.0)),
        model,
        np.array(coefficients or []),
    )


def points_in_view(n: int = 200) -> NDArray[np.float64]:
    """World points that the camera sees all over its picture."""
    rng = np.random.default_rng(3)
    seen = rng.uniform((-200, -110, 700), (200, 110, 1200), (n, 3))
    return camera().camera_from_world.inverse().apply(seen)


@pytest.mark.parametrize("count", COEFFICIENTS)
def test_project_equals_opencv(count: int) -> None:
    cam = camera("opencv", COEFFICIENTS[count])
    points = points_in_view()
    rvec, _ = cv2.Rodrigues(cam.camera_from_world.rotation)

    found = cam.project(points)

    expected, _ = cv2.projectPoints(
        points, rvec, cam.camera_from_world.translation, cam.matrix, cam.distortion
    )
    np.testing.assert_allclose(found, expected[:, 0], atol=1e-8)


@pytest.mark.parametrize("count", [5, 8, 12])
def test_undistort_equals_opencv(count: int) -> None:
    cam = camera("opencv", COEFFICIENTS[count])
    pixels = cam.project(points_in_view())

    found = cam.undistort(pixels)

    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
    expected = cv2.undistortPoints(pixels[:, None], cam.matrix, cam.distortion, criteria=criteria)
    np.testing.assert_allclose(found, expected[:, 0], atol=1e-9)


def test_centre_of_the_top_left_pixel_is_zero() -> None:
    """A blob drawn on pixel (0, 0) with OpenCV is found there: both count from pixel centres."""
    picture = np.zeros((5, 5), np.uint8)
    picture[0, 0] = 255
    moments = cv2.moments(picture)
    assert (moments["m10"], moments["m01"]) == (0, 0)
    cam = Camera((5, 5), np.array([[10.0, 0, 0], [0, 10.0, 0], [0, 0, 1]]))
    np.testing.assert_array_equal(cam.project((0, 0, 7)), (0, 0))


@pytest.mark.parametrize(("model", "coefficients"), MODELS)
def test_projecting_along_a_ray_gives_its_pixel_back(model: str, coefficients: list[float]) -> None:
    cam = camera(model, coefficients)
    pixels = np.stack(np.meshgrid(np.linspace(0, 1279, 13), np.linspace(0, 719, 7)), axis=-1)

    rays = cam.ray(pixels)

    assert rays.shape == (7, 13, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-14)
    for distance_mm in (1.0, 800.0):
        there = cam.project(cam.position + distance_mm * rays)
        np.testing.assert_allclose(there, pixels, atol=1e-8)


@pytest.mark.parametrize(("model", "coefficients"), MODELS)
def test_rays_of_projections_pass_through_the_points(model: str, coefficients: list[float]) -> None:
    cam = camera(model, coefficients)
    points = points_in_view()

    rays = cam.ray(cam.project(points))

    towards = points - cam.position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    np.testing.assert_allclose(rays, towards, atol=1e-11)


@pytest.mark.parametrize("kappa", [-0.2, -0.01, 0.0, 0.05, 0.6])
def test_tsai_distortion_solves_tsais_equation(kappa: float) -> None:
    """Tsai 1987, eq. 5: undistorted = distorted (1 + kappa r_distorted^2)."""
    cam = camera("tsai", [kappa])
    distorted = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 2))

    undistorted = distorted * (1 + kappa * (distorted**2).sum(axis=1, keepdims=True))

    np.testing.assert_allclose(cam.distort(undistorted), distorted, atol=1e-12)
    pixels = cam.pixel_from_normalised(distorted)
    np.testing.assert_allclose(cam.undistort(pixels), undistorted, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "k", "fold"),
    [
        # r (1 + k1 r^2) stops growing at r = 1/sqrt(-3 k1)
        ("opencv", [-0.5, 0, 0, 0, 0], 1 / np.sqrt(1.5)),
        # r_d (1 + kappa r_d^2) has its largest value, 2/3 of 1/sqrt(-3 kappa), there
        ("tsai", [-0.5], 2 / 3 / np.sqrt(1.5)),
    ],
)
def test_points_beyond_the_fold_are_not_seen(model: str, k: list[float], fold: float) -> None:
    cam = Camera((640, 480), np.diag([500.0, 500.0, 1.0]), Rigid.identity(), model, np.array(k))

    inside = cam.project((0.99 * fold, 0, 1))
    outside = cam.project([(1.01 * fold, 0, 1), (0, 5 * fold, 1)])

    assert np.isfinite(inside).all()
    assert np.isnan(outside).all()


def test_points_behind_the_camera_are_not_seen() -> None:
    cam = Camera((640, 480), np.diag([500.0, 500.0, 1.0]))
    assert np.isnan(cam.project([(0, 0, -1), (1, 2, 0)])).all()
    assert np.isnan(cam.project((np.nan, 0, 1))).all()


def test_points_outside_the_picture_are_returned() -> None:
    cam = Camera((640, 480), np.diag([500.0, 500.0, 1.0]))
    np.testing.assert_allclose(cam.project((-10, 10, 1)), (-5000, 5000))


def test_a_rigid_motion_of_world_and_camera_changes_nothing() -> None:
    cam = camera("opencv", COEFFICIENTS[5])
    new_from_old = Rigid(np.array([0.9, 0.1, -0.3, 0.2]), np.array([5.0, -80.0, 33.0]))
    moved = Camera(
        cam.image_size,
        cam.matrix,
        cam.camera_from_world @ new_from_old.inverse(),
        cam.distortion_model,
        cam.distortion,
    )
    points = points_in_view()

    found = moved.project(new_from_old.apply(points))

    np.testing.assert_allclose(found, cam.project(points), atol=1e-8)
    np.testing.assert_allclose(moved.position, new_from_old.apply(cam.position), atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_size": (0, 480)}, "image_size"),
        ({"matrix": np.eye(2)}, r"matrix must have shape \(3, 3\), got \(2, 2\)"),
        ({"matrix": np.diag([-1.0, 1, 1])}, "focal"),
        ({"matrix": np.diag([np.nan, 1, 1])}, "finite"),
        ({"matrix": np.diag([1.0, 1, 2])}, "matrix must be"),
        ({"distortion_model": "fisheye"}, "one of none, opencv, tsai, not fisheye"),
        ({"distortion_model": "opencv", "distortion": [0.1]}, "takes 0 or 5 or 8 or 12"),
        ({"distortion_model": "tsai", "distortion": [np.inf]}, "finite"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(changes: dict[str, object], message: str) -> None:
    good: dict[str, object] = {"image_size": (640, 480), "matrix": np.diag([500.0, 500.0, 1.0])}
    with pytest.raises(ValueError, match=message):
        Camera(**{**good, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["project", "undistort"])
def test_wrong_shapes_are_named(method: str) -> None:
    with pytest.raises(ValueError, match=r"must have shape \(\.\.\., [23]\), got \(4,\)"):
        getattr(camera(), method)(np.zeros(4))


def test_arrays_of_a_camera_are_copied_and_locked() -> None:
    matrix = np.diag([500.0, 500.0, 1.0])
    cam = Camera((640, 480), matrix)
    matrix[0, 0] = 1
    assert cam.matrix[0, 0] == 500
    with pytest.raises(ValueError, match="read-only"):
        cam.matrix[0, 0] = 1
