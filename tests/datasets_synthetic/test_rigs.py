"""Camera rigs around a face."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.datasets_synthetic.rigs import face_rig
from facewright.heads.head import Head


@pytest.mark.parametrize("n_cameras", [2, 4, 6])
def test_all_cameras_see_the_whole_face_from_the_front(average_head: Head, n_cameras: int) -> None:
    face = np.stack([average_head.points[n] for n in ("11.1", "2.1", "5.1", "5.2", "9.3")])
    for seed in range(5):
        rig = face_rig(np.random.default_rng(seed), n_cameras=n_cameras)
        assert rig.names == tuple(f"cam{i}" for i in range(n_cameras))
        for camera in rig.cameras.values():
            pixels = camera.project(face)
            width, height = camera.image_size
            assert (pixels > 30).all()
            assert (pixels < (width - 30, height - 30)).all()
            assert camera.position[2] > 300
            assert 600 < np.linalg.norm(camera.position) < 900
            up = camera.project([[0, 50.0, 0], [0, -50.0, 0]])
            assert up[0, 1] < up[1, 1]


def test_lenses_can_be_inverted_over_the_whole_picture() -> None:
    for seed in range(5):
        for camera in face_rig(np.random.default_rng(seed)).cameras.values():
            width, height = camera.image_size
            x, y = np.meshgrid(np.linspace(-1, width, 20), np.linspace(-1, height, 20))
            pixels = np.stack([x, y], axis=-1)
            back = camera.project(camera.position + 700 * camera.ray(pixels))
            np.testing.assert_allclose(back, pixels, atol=1e-6)


def test_no_two_cameras_stand_together() -> None:
    for seed in range(5):
        p = np.stack([c.position for c in face_rig(np.random.default_rng(seed)).cameras.values()])
        d = np.linalg.norm(p[:, None] - p, axis=2) + 1e4 * np.eye(len(p))
        assert d.min() > 150


def test_the_picture_size_scales_the_focal_length() -> None:
    large = face_rig(np.random.default_rng(1), image_size=(1280, 720))
    small = face_rig(np.random.default_rng(1), image_size=(640, 360))

    for name in large:
        np.testing.assert_allclose(
            large[name].matrix[:2, :2], 2 * small[name].matrix[:2, :2], rtol=1e-12
        )
        np.testing.assert_array_equal(large[name].position, small[name].position)
