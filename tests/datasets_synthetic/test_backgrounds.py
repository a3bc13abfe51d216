"""Rooms: the same for all cameras, closed, and out of focus."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.datasets_synthetic.backgrounds import Room
from facewright.datasets_synthetic.optics import Optics
from facewright.datasets_synthetic.rigs import look_at

SHARP = Optics()


def camera_at(position: tuple[float, float, float], *, distorted: bool = False) -> Camera:
    K = np.array([[420.0, 0, 240], [0, 420.0, 135], [0, 0, 1]])
    pose = look_at(position, (0, -30, 0))
    if not distorted:
        return Camera((480, 270), K, pose)
    return Camera((480, 270), K, pose, "opencv", np.array([-0.15, 0.05, 1e-3, -1e-3, 0.0]))


@pytest.fixture(scope="module")
def room() -> Room:
    return Room("clutter", 4)


@pytest.mark.parametrize("distorted", [False, True])
def test_two_cameras_see_one_room(room: Room, distorted: bool) -> None:
    """A place on the back wall has one colour, wherever it is seen from."""
    cameras = [
        camera_at((-120, 30, 700), distorted=distorted),
        camera_at((260, -60, 650), distorted=distorted),
    ]
    pictures = [room.seen_by(c, SHARP) for c in cameras]
    back = max(room.walls, key=lambda w: -w.corner[2] - abs(w.right[2]) * 1e6)
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0.1, 0.9, (2, 4000)) * np.array(back.size_mm)[:, None]
    points = back.corner + u[:, None] * back.right + v[:, None] * back.down

    seen, colours = np.ones(len(points), bool), []
    for camera, picture in zip(cameras, pictures, strict=True):
        at = camera.project(points)
        seen &= (at > 2).all(axis=1) & (at < (477, 267)).all(axis=1)
        x, y = np.nan_to_num(at, nan=-9).astype(np.float32).T
        colours.append(cv2.remap(picture, x, y, cv2.INTER_LINEAR).reshape(-1, 3))

    assert seen.sum() > 300
    off = np.abs(colours[0] - colours[1])[seen].mean(axis=1)
    contrast = colours[0][seen].mean(axis=1).std()
    assert np.median(off) < 0.05 * contrast
    other = np.abs(colours[0][seen] - np.roll(colours[1][seen], 7, axis=0)).mean(axis=1)
    assert np.median(other) > 10 * np.median(off)  # it is not that all the wall is alike


@pytest.mark.parametrize("kind", ["clutter", "studio"])
def test_a_room_is_closed(kind: Literal["clutter", "studio"]) -> None:
    room = Room(kind, 2)
    for yaw in np.linspace(0, 2 * np.pi, 9)[:-1]:
        for height in (-300.0, 400.0):
            eye = (700 * np.sin(yaw), height, 700 * np.cos(yaw))
            picture = room.seen_by(camera_at(eye), SHARP)
            assert np.isfinite(picture).all()
            assert picture.min() > 0


def test_walls_face_the_person(room: Room) -> None:
    for wall in room.walls:
        np.testing.assert_allclose([wall.right @ wall.right, wall.right @ wall.down], [1, 0])
        assert np.cross(wall.right, wall.down) @ wall.corner > 0


def test_focus_blurs_by_the_pupil(room: Room) -> None:
    camera = camera_at((0, 0, 700))

    def detail(optics: Optics) -> float:
        grey = room.seen_by(camera, optics).mean(axis=2)
        return float(np.abs(cv2.Laplacian(grey, cv2.CV_32F)).mean())

    details = [detail(Optics(pupil_mm=p, focus_mm=700)) for p in (0.0, 6.0, 20.0)]
    assert details[0] > 1.1 * details[1]
    assert details[1] > 1.5 * details[2]


def test_blur_keeps_the_light(room: Room) -> None:
    camera = camera_at((0, 0, 700))

    sharp = room.seen_by(camera, SHARP)
    soft = room.seen_by(camera, Optics(pupil_mm=12, focus_mm=700))

    np.testing.assert_allclose(soft.mean(axis=(0, 1)), sharp.mean(axis=(0, 1)), rtol=0.02)


def test_seeds_make_different_rooms_and_the_same_again(room: Room) -> None:
    camera = camera_at((0, 0, 700))

    def picture(seed: int) -> NDArray[np.float32]:
        return Room("clutter", seed).seen_by(camera, SHARP)

    np.testing.assert_array_equal(picture(4), room.seen_by(camera, SHARP))
    assert np.abs(picture(5) - picture(4)).mean() > 0.02


def test_rooms_are_neither_dark_nor_blinding() -> None:
    camera = camera_at((0, 0, 700))
    means = [float(Room("clutter", seed).seen_by(camera, SHARP).mean()) for seed in range(8)]

    assert min(means) > 0.05
    assert max(means) < 0.9


def test_an_unknown_room_is_refused() -> None:
    with pytest.raises(ValueError, match="clutter"):
        Room("garden", 1)  # type: ignore[arg-type]
