"""The compiled inversion of lens distortion, against `Camera`."""

from __future__ import annotations

import time

import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.tracking.lenses import undistort

K = np.array([[1900.0, 0.7, 633.0], [0, 1910.0, 352.0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("none", []),
        ("opencv", []),
        ("opencv", [-0.2, 0.08, 7e-4, -9e-4, 0.03]),
        ("opencv", [0.4, -0.3, 1e-3, 2e-3, 0.1, 0.5, -0.2, 0.05]),
        ("opencv", [-0.2, 0.08, 7e-4, -9e-4, 0.0, 0.01, 0.0, 0.0, 2e-3, -1e-3, -3e-3, 2e-3]),
        ("tsai", [0.15]),
    ],
)
def test_points_are_what_camera_makes_of_them(model: str, coefficients: list[float]) -> None:
    camera = Camera((1280, 720), K, distortion_model=model, distortion=np.array(coefficients))
    pixels = np.random.default_rng(0).uniform((-20, -20), (1300, 740), size=(500, 2))

    found = undistort(camera, pixels)

    np.testing.assert_allclose(found, camera.undistort(pixels), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        camera.pixel_from_normalised(camera.distort(found)), pixels, rtol=0, atol=1e-8
    )


def test_what_no_ray_reaches_is_nan() -> None:
    """Strong barrel distortion folds: far pixels are nobody's picture."""
    camera = Camera(
        (1280, 720), K, distortion_model="opencv", distortion=np.array([-2.5, 0, 0, 0, 0])
    )
    pixels = np.array([[633.0, 352.0], [700.0, 380.0], [1900.0, 352.0]])

    found = undistort(camera, pixels)

    assert np.isnan(found[2]).all() and np.isnan(camera.undistort(pixels)[2]).all()
    np.testing.assert_allclose(found[:2], camera.undistort(pixels[:2]), atol=1e-11)


def test_no_points_are_no_points() -> None:
    camera = Camera((1280, 720), K, distortion_model="opencv", distortion=np.full(5, 0.01))

    assert undistort(camera, np.zeros((0, 2))).shape == (0, 2)


def test_it_is_fast() -> None:
    camera = Camera(
        (1280, 720), K, distortion_model="opencv", distortion=np.array([-0.2, 0.08, 0, 0, 0])
    )
    pixels = np.random.default_rng(0).uniform((0, 0), (1280, 720), size=(30, 2))
    undistort(camera, pixels)

    def seconds(work: object) -> float:
        assert callable(work)
        times = []
        for _ in range(20):
            start = time.perf_counter()
            work(pixels)
            times.append(time.perf_counter() - start)
        return min(times)

    assert seconds(lambda p: undistort(camera, p)) < 0.3 * seconds(camera.undistort)
