"""Shares of pixels: exact areas, and blur that moves no light."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from facewright.datasets_synthetic.coverage import paint_polygons, polygon_moments

Floats = NDArray[np.float64]


def painted(
    *polygons: Floats, weights: Floats | None = None, psf_px: float = 0.0, defocus_px: float = 0.0
) -> NDArray[np.float32]:
    level = np.zeros((40, 50), np.float32)
    shares = np.ones(len(polygons)) if weights is None else weights
    paint_polygons(
        level, np.zeros_like(level), np.ones_like(level), np.stack(polygons), shares, 1.0,
        psf_px=psf_px, defocus_px=defocus_px,
    )  # fmt: skip
    return level


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Floats:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def circle(x: float, y: float, r: float, n: int = 400) -> Floats:
    a = 2 * np.pi * np.arange(n) / n
    return np.stack([x + r * np.cos(a), y + r * np.sin(a)], axis=1)


def test_a_rectangle_covers_each_pixel_by_the_product_of_its_sides() -> None:
    level = painted(rectangle(10.2, 7.9, 15.6, 12.25))

    edge = np.arange(-0.5, 50)
    x = np.diff(np.clip(edge, 10.2, 15.6))
    y = np.diff(np.clip(edge[:41], 7.9, 12.25))
    np.testing.assert_allclose(level, np.outer(y, x), atol=1e-7)


def test_the_sense_of_rotation_does_not_matter() -> None:
    shape = circle(20.3, 17.1, 4.4)

    np.testing.assert_allclose(painted(shape), painted(shape[::-1].copy()), atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_slanted_triangles_agree_with_counted_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform((5, 5), (45, 35), size=(3, 2))
    n = 32
    y, x = np.mgrid[: 40 * n, : 50 * n]
    px, py = (x + 0.5) / n - 0.5, (y + 0.5) / n - 0.5
    sides = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        sides.append((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0]))
    inside = np.all(np.array(sides) > 0, axis=0) | np.all(np.array(sides) < 0, axis=0)
    counted = inside.reshape(40, n, 50, n).mean(axis=(1, 3))

    np.testing.assert_allclose(painted(corners), counted, atol=2.5 / n)
    d = corners - corners[0]
    area = abs(d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]) / 2
    assert painted(corners).sum() == pytest.approx(area, rel=1e-5)


def test_pieces_side_by_side_are_the_whole() -> None:
    a, b = rectangle(5.3, 6.2, 11.7, 20.4), rectangle(11.7, 6.2, 19.1, 20.4)

    np.testing.assert_allclose(painted(a, b), painted(rectangle(5.3, 6.2, 19.1, 20.4)), atol=1e-6)


def test_weights_are_shares_of_the_light() -> None:
    shape = circle(20, 20, 5)

    both = painted(shape, shape + (3.0, 0), weights=np.array([0.25, 0.75]))

    expected = 0.25 * painted(shape) + 0.75 * painted(shape + (3.0, 0))
    np.testing.assert_allclose(both, expected, atol=1e-6)


def test_shapes_replace_what_is_under_them() -> None:
    under = np.full((40, 50), 0.2, np.float32)
    level = under.copy()

    free = np.ones_like(level)
    area = paint_polygons(level, under, free, circle(20, 20, 5)[None], np.ones(1), 0.9)

    assert level[20, 20] == pytest.approx(0.9)
    assert level[0, 0] == pytest.approx(0.2)
    assert area == pytest.approx(np.pi * 25, rel=1e-3)
    assert (level - under).sum() == pytest.approx(0.7 * area, rel=1e-4)
    np.testing.assert_allclose(1 - free, (level - under) / 0.7, atol=1e-6)
    # what comes later gets what is left
    paint_polygons(level, under, free, rectangle(18, 10, 30, 30)[None], np.ones(1), 0.5)
    assert level[20, 20] == pytest.approx(0.9)
    assert level[12, 28] == pytest.approx(0.5)
    assert level.max() <= 0.9 + 1e-6


def test_gaussian_blur_of_a_square_is_a_product_of_normal_integrals() -> None:
    """Closed form: the square's blurred profile, integrated over each pixel."""
    sd, x0, x1 = 0.8, 14.3, 20.9
    level = painted(rectangle(x0, 9.7, x1, 16.2), psf_px=sd)

    def integral(edge: Floats, at: float) -> Floats:
        z = (edge - at) / sd  # the antiderivative of the normal distribution function
        return np.asarray(sd * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)))

    def profile(low: float, high: float, count: int) -> Floats:
        edge = np.arange(count + 1, dtype=np.float64) - 0.5
        return np.diff(np.asarray(integral(edge, low) - integral(edge, high)))

    expected = np.outer(profile(9.7, 16.2, 40), profile(x0, x1, 50))
    np.testing.assert_allclose(level, expected, atol=6e-3)  # a fine pixel counts as its middle
    assert level.sum() == pytest.approx(6.6 * 6.5, rel=1e-5)


def test_a_point_out_of_focus_is_a_disc() -> None:
    level = painted(circle(20.2, 18.4, 0.05, 32), defocus_px=9.0)

    disc = painted(circle(20.2, 18.4, 4.5)) / (np.pi * 4.5**2)
    np.testing.assert_allclose(level / level.sum(), disc, atol=0.12 * disc.max())
    assert level.sum() == pytest.approx(np.pi * 0.05**2, rel=0.01)


@pytest.mark.parametrize(("psf_px", "defocus_px"), [(0.0, 0.0), (0.7, 0.0), (0.5, 6.0)])
def test_light_that_falls_outside_is_lost_and_nothing_breaks(
    psf_px: float, defocus_px: float
) -> None:
    def shown(shape: Floats) -> NDArray[np.float32]:
        return painted(shape, psf_px=psf_px, defocus_px=defocus_px)

    whole = shown(circle(25, 20, 6))

    for x, y in ((-0.5, 20), (49.5, 20), (25, -0.5), (25, 39.5)):
        half = shown(circle(x, y, 6))
        assert half.sum() == pytest.approx(whole.sum() / 2, rel=1e-3)
    assert shown(circle(-40, -40, 6)).sum() == 0
    assert shown(np.full((4, 2), np.nan)).sum() == 0


def test_moments_of_an_ellipse() -> None:
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    shape = circle(0, 0, 1, 2000) * (5.0, 2.0) @ turn.T + (300.5, 200.25)

    area, x, y, xx, xy, yy = polygon_moments(shape[None])

    assert area == pytest.approx(np.pi * 10, rel=1e-5)
    np.testing.assert_allclose((x, y), (300.5, 200.25), atol=1e-9)
    spread = turn @ np.diag([25 / 4, 4 / 4]) @ turn.T  # of a uniform ellipse: a²/4
    np.testing.assert_allclose([[xx, xy], [xy, yy]], spread, rtol=1e-5)
    two = polygon_moments(np.stack([shape, shape + (6.0, 0)]))
    np.testing.assert_allclose(two[:3], (area, x + 3, y), atol=1e-9)
    assert two[3] == pytest.approx(xx + 9)
