from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.heads.appearance import make_appearance
from facewright.heads.appearance_traits import AppearanceTraits
from facewright.heads.skin_paint import paint_pigments
from facewright.heads.skin_pigments import (
    BASE_DENSITY,
    HAEMOGLOBIN_DENSITY,
    MELANIN_DENSITY,
    SURFACE_LIGHT,
    SkinPigments,
    melanin_of_darkness,
    skin_albedo,
    skin_pigments,
)
from facewright.heads.srgb import linear_from_srgb, srgb_from_linear
from facewright.heads.template import load_template
from facewright.heads.texture_canvas import make_canvas

SIZE = 512


@cache
def pigments(**traits: object) -> SkinPigments:
    person = AppearanceTraits(**traits)  # type: ignore[arg-type]
    return paint_pigments(load_template(), person, size=SIZE)


def near(place_mm: tuple[float, float], radius_mm: float = 3.0) -> NDArray[np.int64]:
    """Flat indices of the texels about a place on the template, seen from the front."""
    canvas = make_canvas(load_template(), SIZE)
    off = canvas.places[:, :2] - np.array(place_mm, np.float32)
    inside = np.linalg.norm(off, axis=1) < radius_mm
    front = canvas.places[inside, 2].max()  # not the cavity behind
    close = inside & (canvas.places[:, 2] > front - 3)
    assert close.sum() > 10
    return np.asarray(canvas.texels[close])


def test_density_is_the_base_plus_each_pigment_times_its_amount() -> None:
    m, h = np.array([0.0, 0.3, 2.0]), np.array([0.0, 1.2, 0.4])

    inner = (skin_albedo(m, h).astype(np.float64) - SURFACE_LIGHT) / (1 - SURFACE_LIGHT)

    # Bando 2003, eq. 2.6, on densities
    wanted = BASE_DENSITY + np.outer(m, MELANIN_DENSITY) + np.outer(h, HAEMOGLOBIN_DENSITY)
    np.testing.assert_allclose(-np.log(inner), wanted, atol=2e-5)


def test_amounts_come_back_from_the_albedo() -> None:
    rng = np.random.default_rng(1)
    m, h = rng.uniform(0, 2.5, (40, 30)), rng.uniform(0, 2.0, (40, 30))

    found_m, found_h = skin_pigments(skin_albedo(m, h))

    assert np.abs(found_m - m).max() < 2e-3
    assert np.abs(found_h - h).max() < 5e-3


def test_amounts_of_a_picture_of_eight_bits_are_close() -> None:
    rng = np.random.default_rng(2)
    m, h = rng.uniform(0.05, 1.2, 500), rng.uniform(0.1, 1.2, 500)

    picture = srgb_from_linear(skin_albedo(m, h))
    found_m, found_h = skin_pigments(linear_from_srgb(picture))

    # half a level of 100 is 1.1 % of light: 0.011 of density, over a_m and a_h of about 1 and 0.5
    assert np.sqrt(np.mean((found_m - m) ** 2)) < 0.02
    assert np.sqrt(np.mean((found_h - h) ** 2)) < 0.04


def test_melanin_darkens_all_colours_and_blood_leaves_red() -> None:
    amounts = np.linspace(0, 3, 50)
    assert (np.diff(skin_albedo(amounts, 0.35), axis=0) < 0).all()
    pale, flushed = skin_albedo(0.2, 0.2), skin_albedo(0.2, 1.2)
    lost = 1 - flushed / pale
    assert lost[0] < 0.12 and lost[1] > 0.4 and lost[2] > 0.3


def test_published_skin_tones_lie_near_the_surface_of_possible_colours() -> None:
    # tones 5 to 8 of the Monk Skin Tone Scale (2022), sRGB; its ends are paper white and black
    tones = np.array([(215, 189, 150), (160, 126, 86), (130, 92, 67), (96, 65, 52)])
    m, h = np.meshgrid(np.linspace(0, 3, 200), np.linspace(0, 1.5, 100))
    possible = srgb_from_linear(skin_albedo(m, h)).reshape(-1, 3).astype(float)

    apart = [np.abs(possible - tone).max(axis=1).min() for tone in tones]

    assert max(apart) < 13, f"levels of 255 apart: {apart}"


def test_darkness_runs_in_even_steps_to_the_eye() -> None:
    light = srgb_from_linear(skin_albedo(melanin_of_darkness(np.linspace(0, 1, 11)), 0.35))
    steps = -np.diff(light.astype(float).mean(axis=1))
    assert steps.min() > 5 and steps.max() < 27


def test_maps_hold_what_was_asked_for() -> None:
    plain = pigments(seed=3, melanin=0.3)
    cheek, forehead, lip = near((38, -30)), near((0, 45)), near((0, -74))

    def of(p: SkinPigments, rows: NDArray[np.int64]) -> tuple[float, float]:
        return float(p.melanin.ravel()[rows].mean()), float(p.haemoglobin.ravel()[rows].mean())

    assert of(plain, lip)[1] > of(plain, cheek)[1] + 0.2
    assert of(plain, cheek)[1] > of(plain, forehead)[1] + 0.2
    assert of(pigments(seed=3, melanin=0.6), forehead)[0] > of(plain, forehead)[0] + 0.4
    assert of(pigments(seed=3, melanin=0.3, tan=1.0), forehead)[0] > of(plain, forehead)[0] + 0.05
    flushed = pigments(seed=3, melanin=0.3, ruddiness=1.0)
    assert of(flushed, cheek)[1] > of(plain, cheek)[1] + 0.2
    assert of(flushed, forehead)[1] == pytest.approx(of(plain, forehead)[1], abs=0.1)


def test_freckles_and_age_spots_are_melanin_and_blemishes_are_blood() -> None:
    plain = pigments(seed=3)
    for change in ({"freckles": 1.0}, {"age": 1.0}):
        other = pigments(seed=3, **change)
        assert (other.melanin - plain.melanin).max() > 0.08
    spotted = pigments(seed=3, blemishes=1.0)
    assert (spotted.haemoglobin - plain.haemoglobin).max() > 0.2
    np.testing.assert_array_equal(spotted.melanin, plain.melanin)


def test_the_equation_gives_the_painted_albedo_where_nothing_hides_the_skin() -> None:
    traits = AppearanceTraits(seed=8, melanin=0.4, n_moles=6, freckles=0.6, cut="bald")
    painted = make_appearance(load_template(), traits, size=SIZE).skin.reshape(-1, 3)
    wanted = srgb_from_linear(paint_pigments(load_template(), traits, size=SIZE).albedo()).reshape(
        -1, 3
    )

    for place in ((38, -30), (-38, -30), (0, 40), (0, -74), (0, -20)):
        rows = near(place)
        assert np.abs(painted[rows].astype(int) - wanted[rows]).max() <= 1


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"albedo must have shape \(\.\.\., 3\)"):
        skin_pigments(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="haemoglobin must have shape"):
        SkinPigments(np.zeros((4, 4), np.float32), np.zeros((4, 5), np.float32))
