"""Irises found in drawn eyes, and gazes from irises that a camera projected."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.tracking.face_fit import FittedFace
from facewright.tracking.face_gaze import GAIN, measure_gaze
from facewright.tracking.face_pose import FaceState, View
from facewright.tracking.iris_fit import fit_irises, usual_radius
from facewright.tracking.landmark_noise import landmark_model
from facewright.tracking.landmark_regions import CONTOURS

Floats = NDArray[np.float64]
WIDTH_PX = 60.0  # between an eye's corners
RADIUS = 0.23


def drawn_eyes(
    iris_at: Floats, *, opening: float = 0.4, light: float = 1.0
) -> tuple[NDArray[np.uint8], Floats]:
    """A picture of two eyes and its 478 landmarks; irises (2, 2) from the middles, px."""
    large, skin = 4, 120.0  # drawn larger, then shrunk
    picture = np.full((120 * large, 240 * large), skin)
    points = np.zeros((478, 2))
    for eye, (side, first, sign) in enumerate((("right", 60.0, 1), ("left", 180.0, -1))):
        middle = np.array([first, 60.0])
        along = np.linspace(-1, 1, 9)
        height = opening * WIDTH_PX / 2 * (1 - along**2)
        upper = np.column_stack([along * WIDTH_PX / 2 * sign, -height]) + middle
        lower = np.column_stack([along * WIDTH_PX / 2 * sign, height])[::-1] + middle
        outline = np.concatenate([upper, lower[1:-1]])
        points[list(CONTOURS[f"lids_{side}"])] = outline
        centre = middle + iris_at[eye]
        rows = (468, 469, 470, 471, 472) if eye == 0 else (473, 474, 475, 476, 477)
        rim = RADIUS * WIDTH_PX * np.array([(0, 0), (1, 0), (0, -1), (-1, 0), (0, 1)])
        points[list(rows)] = middle + 0.4 * iris_at[eye] + rim  # the network leans to the middle
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in picture.shape[::-1])), -1)
        at = (grid + 0.5) / large - 0.5
        inside = np.zeros(picture.shape, np.uint8)
        cv2.fillPoly(inside, [np.round((outline + 0.5) * large - 0.5).astype(np.int32)], 1)
        apart = np.linalg.norm(at - centre, axis=2) / WIDTH_PX
        eye_colours = np.where(apart < 0.1, 20.0, np.where(apart < RADIUS, 70.0, 200.0))
        picture[inside > 0] = eye_colours[inside > 0]
    small = cv2.resize(light * picture, (240, 120), interpolation=cv2.INTER_AREA)
    return np.round(small).astype(np.uint8), points


@pytest.mark.parametrize("light", [1.0, 0.5])
@pytest.mark.parametrize("aside", [(0.0, 0.0), (6.0, 0.0), (-8.0, 1.0), (4.0, -1.5)])
def test_irises_are_found_where_they_were_drawn(aside: tuple[float, float], light: float) -> None:
    iris_at = np.tile(aside, (2, 1))
    picture, points = drawn_eyes(iris_at, light=light)

    found = fit_irises(picture, points, usual_radius(points[None]))

    middles = np.array([[60.0, 60.0], [180.0, 60.0]])
    off = found.centre_px - middles - iris_at
    assert np.abs(off[:, 0]).max() < 0.5
    assert np.abs(off[:, 1]).max() < 1.5  # lids hide above and below


def test_a_shut_eye_has_no_iris() -> None:
    picture, points = drawn_eyes(np.zeros((2, 2)), opening=0.1)

    assert np.isnan(fit_irises(picture, points, np.full(2, RADIUS)).centre_px).all()


def test_an_eye_without_contrast_has_no_iris() -> None:
    _, points = drawn_eyes(np.zeros((2, 2)))
    noise = np.random.default_rng(0).normal(120, 5, (120, 240))

    found = fit_irises(np.round(noise).astype(np.uint8), points, np.full(2, RADIUS))

    assert np.isnan(found.centre_px).all()


def looked(
    face: FittedFace, gaze: Floats, turn: Floats
) -> tuple[list[list[View]], list[FaceState]]:
    """Views and states of a head that turns (T, 3) rad while its eyes look (T, 2) rad."""
    K, n = landmark_model().n_components, len(landmark_model().numbers)
    frames, states = [], []
    for (yaw, pitch), w in zip(gaze, turn, strict=True):
        R = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(w).as_matrix()
        t = np.array([10.0, 5.0, 700.0])
        irises = []
        for eye in face.eyes:
            reach = 0.9 * eye.radius
            at = eye.centre + (reach * np.sin(yaw), -reach * np.sin(pitch), reach)
            P = R @ at + t
            irises.append(P[:2] / P[2])
        nothing = np.full((n, 2), np.nan)
        view = View(nothing, np.zeros(n), np.eye(3), np.zeros(3), np.array(irises))
        frames.append([view])
        states.append(FaceState(R, t, np.zeros(K), np.eye(6 + K), 1.0, np.zeros((n, 2))))
    return frames, states


@pytest.fixture(scope="module")
def face() -> FittedFace:
    n = len(landmark_model().numbers)
    return FittedFace(np.zeros(5), 1.0, np.zeros((n, 3)), 1500.0, 0.0, 1)


def test_gaze_is_that_of_the_eyes_not_of_the_head(face: FittedFace) -> None:
    T = 60
    slow = np.sin(np.linspace(0, 3, T))[:, None]
    gaze, turn = slow * (0.3, 0.15), np.linspace(0, 1, T)[:, None] * (0.1, -0.3, 0.1)
    frames, states = looked(face, gaze, turn)

    found = measure_gaze(np.arange(T) / 30, frames, states, face, np.arange(1))

    assert found is not None
    for axis in range(2):
        expected = np.arcsin(GAIN[axis] * np.sin(gaze[:, axis]))
        assert np.abs(found[1:-1, :, axis] - expected[1:-1, None]).max() < 1e-2


def test_a_blink_is_bridged_and_one_eye_serves_for_both(face: FittedFace) -> None:
    T = 30
    gaze = np.tile((0.2, 0.0), (T, 1))
    gaze[0] = 0
    frames, states = looked(face, gaze, np.zeros((T, 3)))
    for t in range(10, 16):
        frames[t][0].irises[:] = np.nan  # type: ignore[index]
    for t in range(20, T):
        frames[t][0].irises[0] = np.nan  # type: ignore[index]

    found = measure_gaze(np.arange(T) / 30, frames, states, face, np.arange(1))

    assert found is not None
    assert np.abs(found[3:, :, 0] - np.arcsin(GAIN[0] * np.sin(0.2))).max() < 1e-6


def test_without_measured_irises_there_is_no_gaze(face: FittedFace) -> None:
    frames, states = looked(face, np.zeros((3, 2)), np.zeros((3, 3)))
    for views in frames:
        views[0].irises[:] = np.nan  # type: ignore[index]

    assert measure_gaze(np.arange(3) / 30, frames, states, face, np.arange(1)) is None
