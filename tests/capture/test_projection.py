"""Projection against the Camera type, OpenCV, and its derivatives against finite differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.capture.projection import (
    INTRINSIC_NAMES,
    OPENCV,
    TSAI,
    camera_of,
    intrinsics_of,
    project_one,
    selection,
)
from facewright.core.camera import Camera
from facewright.core.rigid import Rigid

Floats = NDArray[np.float64]
K = np.array([[1210.0, 0, 633.0], [0, 1190.0, 371.0], [0, 0, 1]])
TWELVE = (-0.21, 0.08, 1e-3, -2e-3, 0.02, 0.05, -0.03, 0.01, 1e-3, -5e-4, 8e-4, 3e-4)
MODELS = {
    "none": ("none", ()),
    "opencv 5": ("opencv", TWELVE[:5]),
    "opencv 8": ("opencv", TWELVE[:8]),
    "opencv 12": ("opencv", TWELVE),
    "tsai barrel": ("tsai", (0.3,)),
    "tsai pincushion": ("tsai", (-0.2,)),
}


def camera(model: str) -> Camera:
    name, coefficients = MODELS[model]
    return Camera((1280, 720), K, Rigid.identity(), name, np.array(coefficients))


def points(count: int = 60) -> Floats:
    rng = np.random.default_rng(4)
    xy = rng.uniform(-0.5, 0.5, (count, 2))
    depth = rng.uniform(300, 900, count)
    return np.column_stack([xy * depth[:, None], depth])


def projected(row: Floats, model: int, point: Floats) -> tuple[Floats, Floats, Floats]:
    uv, by_row, by_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    assert project_one(row, model, *point, uv, by_row, by_point)
    return uv, by_row, by_point


@pytest.mark.parametrize("model", MODELS)
def test_pixels_are_those_of_the_camera(model: str) -> None:
    row, kind = intrinsics_of(camera(model))

    found = np.stack([projected(row, kind, p)[0] for p in points()])

    np.testing.assert_allclose(found, camera(model).project(points()), atol=1e-9)


@pytest.mark.parametrize("model", [m for m in MODELS if not m.startswith("tsai")])
def test_pixels_are_those_of_opencv(model: str) -> None:
    row, kind = intrinsics_of(camera(model))

    found = np.stack([projected(row, kind, p)[0] for p in points()])

    theirs, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, row[4:])
    np.testing.assert_allclose(found, theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_finite_differences(model: str) -> None:
    row, kind = intrinsics_of(camera(model))
    estimated = range(5) if kind == TSAI else range(16)
    for point in points(12):
        _, by_row, by_point = projected(row, kind, point)
        for i in estimated:
            h = 1e-6 * max(abs(row[i]), 1.0)
            step = np.eye(16)[i] * h
            slope = projected(row + step, kind, point)[0] - projected(row - step, kind, point)[0]
            np.testing.assert_allclose(
                by_row[:, i], slope / (2 * h), rtol=1e-6, atol=1e-6, err_msg=INTRINSIC_NAMES[i]
            )
        for i in range(3):
            h = 1e-4
            step = np.eye(3)[i] * h
            slope = projected(row, kind, point + step)[0] - projected(row, kind, point - step)[0]
            np.testing.assert_allclose(by_point[:, i], slope / (2 * h), rtol=1e-6, atol=1e-8)


def test_tsai_inverts_its_own_equation() -> None:
    row, kind = intrinsics_of(camera("tsai barrel"))
    for point in points(20):
        uv, *_ = projected(row, kind, point)
        d = (uv - row[2:4]) / row[:2]
        np.testing.assert_allclose(d * (1 + row[4] * d @ d), point[:2] / point[2], atol=1e-12)


@pytest.mark.parametrize(
    ("model", "point"),
    [
        ("none", (10.0, 10.0, 0.0)),
        ("none", (10.0, 10.0, -500.0)),
        ("none", (10.0, 10.0, np.nan)),
        ("tsai pincushion", (2000.0, 0.0, 1000.0)),  # beyond where κ folds back
    ],
)
def test_what_cannot_be_seen_is_refused(model: str, point: tuple[float, float, float]) -> None:
    row, kind = intrinsics_of(camera(model))

    seen = project_one(row, kind, *point, np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3)))

    assert not seen


@pytest.mark.parametrize("model", MODELS)
def test_a_row_gives_its_camera_back(model: str) -> None:
    row, kind = intrinsics_of(camera(model))

    back = camera_of(row, kind, (1280, 720), Rigid.identity())

    assert back.distortion_model == camera(model).distortion_model
    np.testing.assert_array_equal(back.distortion, camera(model).distortion)
    np.testing.assert_array_equal(back.matrix, K)


def test_tied_parameters_move_together() -> None:
    names, matrix = selection({"f": {"fx": 1.0, "fy": 1.0}, "k1": {"k1": 1.0}})

    assert names == ("f", "k1")
    np.testing.assert_array_equal(np.flatnonzero(matrix[:, 0]), [0, 1])
    np.testing.assert_array_equal(np.flatnonzero(matrix[:, 1]), [4])
    assert OPENCV != TSAI


def test_skew_is_refused() -> None:
    skewed = K.copy()
    skewed[0, 1] = 2.0
    with pytest.raises(ValueError, match="skew"):
        intrinsics_of(Camera((1280, 720), skewed))
