from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.tracking.snakes import (
    SnakeSettings,
    edge_potential,
    lip_potential,
    relax_snake,
    snake_energy,
    stiffness_matrix,
)

Floats = NDArray[np.float64]


def circle(n: int, radius: float, centre: tuple[float, float]) -> Floats:
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + centre


def ellipse_distance(c: Floats, centre: tuple[float, float], axes: tuple[float, float]) -> Floats:
    """About how far points are from an ellipse, px."""
    x, y = ((c - centre) / axes).T
    r = np.hypot(x, y)
    return np.asarray(np.abs(r - 1) * np.hypot(x * axes[0], y * axes[1]) / r)


def lips(size: int = 160) -> NDArray[np.uint8]:
    """A redder ellipse of the same brightness on skin."""
    y, x = np.mgrid[:size, :size].astype(float)
    inside = np.clip(20 * (1 - np.hypot((x - 80) / 45, (y - 80) / 22)), 0, 1)[..., None]
    skin, red = np.array([170.0, 130.0, 110.0]), np.array([185.0, 122.5, 110.0])
    shadow = np.where(x < 80, 1.0, 0.7)[..., None]
    return np.asarray(shadow * (skin + inside * (red - skin)), dtype=np.uint8)


@pytest.mark.parametrize("is_closed", [True, False])
def test_stiffness_is_the_second_derivative_of_the_energy(is_closed: bool) -> None:
    rng = np.random.default_rng(1)
    settings = SnakeSettings(stiffness=0.7, tension=0.35)
    flat = np.zeros((40, 40), np.float32)
    c, d = rng.normal(size=(9, 2)), rng.normal(size=(9, 2))

    def energy(t: float) -> float:
        return snake_energy(c + t * d, flat, is_closed=is_closed, settings=settings)

    slope = (energy(1e-4) - energy(-1e-4)) / 2e-4
    A = stiffness_matrix(9, is_closed=is_closed, settings=settings)
    assert slope == pytest.approx(float(np.sum(d * (A @ c))), rel=1e-6)
    # the tutorial's sum, term by term
    ahead = np.roll(c, -1, axis=0)
    stretch, bend = ahead - c, ahead + np.roll(c, 1, axis=0) - 2 * c
    if not is_closed:
        stretch, bend = stretch[:-1], bend[1:-1]
    whole = 0.7 * (0.35 * (stretch**2).sum() + 0.65 * (bend**2).sum())
    assert energy(0.0) == pytest.approx(whole)


def test_a_snake_without_a_picture_shrinks_to_its_centre_as_the_closed_form_says() -> None:
    settings = SnakeSettings(stiffness=0.4, tension=1.0, friction=2.0, n_steps=7, most_px=100.0)
    n, radius = 16, 10.0

    c = relax_snake(
        circle(n, radius, (50, 50)),
        np.zeros((100, 100), np.float32),
        is_closed=True,
        settings=settings,
    )

    # a circle is an eigenvector of the second difference
    value = 2 * 0.4 * (2 - 2 * np.cos(2 * np.pi / n))
    left = radius * (2.0 / (2.0 + value)) ** 7
    np.testing.assert_allclose(c, circle(n, left, (50, 50)), atol=1e-9)


def test_a_snake_finds_lips_of_the_skins_brightness_across_a_shadow() -> None:
    start = circle(24, 1.0, (0, 0)) * (41, 18) + (82, 81)
    settings = SnakeSettings(stiffness=0.02, n_steps=500)
    potential = lip_potential(lips(), blur_px=2.0)

    c = relax_snake(start, potential, is_closed=True, settings=settings, rest=start)

    before = ellipse_distance(start, (80, 80), (45, 22)).mean()
    after = ellipse_distance(c, (80, 80), (45, 22)).mean()
    assert before > 2.5
    assert after < 0.4 * before  # 3.2 px before; rigidity keeps corners from being filled
    energies = [
        snake_energy(x, potential, is_closed=True, settings=settings, rest=start)
        for x in (start, c)
    ]
    assert energies[1] < energies[0]


def test_an_open_snake_settles_on_an_edge() -> None:
    picture = np.zeros((80, 80), np.uint8)
    picture[40:] = 200
    start = np.column_stack([np.linspace(10, 70, 9), np.full(9, 37.0)])

    settings = SnakeSettings(n_steps=300)
    potential = edge_potential(picture, blur_px=2.0)
    c = relax_snake(start, potential, is_closed=False, settings=settings)

    # free ends lie where one row is missing to bend against: they lag
    np.testing.assert_allclose(c[1:-1, 1], 39.5, atol=0.25)
    np.testing.assert_allclose(c[[0, -1], 1], 39.5, atol=1.0)


def test_no_point_goes_farther_than_allowed() -> None:
    start = circle(12, 20.0, (50, 50))
    settings = SnakeSettings(stiffness=5.0, tension=1.0, n_steps=200, most_px=3.0)

    c = relax_snake(start, np.zeros((99, 99), np.float32), is_closed=True, settings=settings)

    assert np.linalg.norm(c - start, axis=1).max() <= 3.0 + 1e-9


def test_wrong_calls_are_told() -> None:
    flat = np.zeros((9, 9), np.float32)
    with pytest.raises(ValueError, match="contour must have shape"):
        relax_snake(np.zeros((4, 2)), flat, is_closed=True)
    with pytest.raises(ValueError, match="tension must lie between 0 and 1"):
        SnakeSettings(tension=1.5)
