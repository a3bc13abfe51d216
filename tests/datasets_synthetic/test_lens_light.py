"""What a lens does to light: corners, reflections, blur."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from facewright.core.camera import Camera
from facewright.datasets_synthetic.lens_light import apply_lens_light, kept_light, kept_light_slope
from facewright.datasets_synthetic.optics import Optics

CAMERA = Camera((320, 200), np.array([[400.0, 0, 171.5], [0, 400, 92.25], [0, 0, 1]]))


def spot(x: int, y: int) -> np.ndarray:
    light = np.zeros((200, 320), np.float32)
    light[y, x] = 1
    return light


def centre_of(light: np.ndarray) -> tuple[float, float]:
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    total = light.sum(dtype=np.float64)
    return float((light * x).sum() / total), float((light * y).sum() / total)


def test_an_ideal_lens_changes_nothing() -> None:
    light = np.random.default_rng(0).uniform(size=(200, 320)).astype(np.float32)

    np.testing.assert_array_equal(apply_lens_light(light, Optics(), CAMERA), light)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_vignetting_takes_its_share_from_the_farthest_corner(channels: tuple[int, ...]) -> None:
    light = np.ones((200, 320, *channels), np.float32)

    got = apply_lens_light(light, Optics(vignetting=0.4), CAMERA)

    assert got.shape == light.shape
    assert got[199, 0].max() == pytest.approx(0.6, abs=1e-6)  # farthest from (171.5, 92.25)
    assert got[92, 171].min() == pytest.approx(1.0, abs=1e-4)
    place = np.array([[30.0, 150.0]])
    assert got[150, 30].max() == pytest.approx(kept_light(Optics(vignetting=0.4), CAMERA, place)[0])
    h = 1e-3
    slope = kept_light_slope(Optics(vignetting=0.4), CAMERA, place)[0]
    for axis in (0, 1):
        step = h * np.eye(2)[axis]
        sides = [kept_light(Optics(vignetting=0.4), CAMERA, place + s) for s in (step, -step)]
        assert slope[axis] == pytest.approx(float(sides[0][0] - sides[1][0]) / (2 * h))


def test_a_ghost_lies_mirrored_through_the_principal_point() -> None:
    got = apply_lens_light(spot(100, 60), Optics(ghost=0.1), CAMERA) - spot(100, 60)

    assert got.sum() == pytest.approx(0.1, rel=1e-3)
    np.testing.assert_allclose(centre_of(got), (2 * 171.5 - 100, 2 * 92.25 - 60), atol=1e-3)


def test_blur_is_a_normal_distribution() -> None:
    light = np.random.default_rng(0).uniform(size=(200, 320)).astype(np.float32)

    got = apply_lens_light(light, Optics(psf_px=1.3), CAMERA)

    inner = np.s_[10:-10, 10:-10]
    expected = ndimage.gaussian_filter(light.astype(float), 1.3)
    np.testing.assert_allclose(got[inner], expected[inner], atol=2e-3)
    np.testing.assert_array_equal(apply_lens_light(light, Optics(psf_px=1.3), CAMERA, psf=False),
                                  light)  # fmt: skip


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"light must be \(200, 320"):
        apply_lens_light(np.zeros((320, 200), np.float32), Optics(), CAMERA)
