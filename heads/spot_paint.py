"""Freckles, moles, age spots and blemishes: single spots of pigment on the face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .appearance_traits import AppearanceTraits
from .texture_front import FrontSheet

Floats = NDArray[np.float32]

_FRECKLE_MELANIN = (0.08, 0.36)  # from the faintest to the strongest
_MOLE_MELANIN = (0.5, 1.2)
_AGE_SPOT_MELANIN = (0.08, 0.24)
_BLEMISH_BLOOD = (0.25, 0.8)
_MOST_FRECKLES, _MOST_BLEMISHES = 520, 16


def spot_melanin(
    places: Floats, traits: AppearanceTraits, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Melanin of spots above the skin's, (N,), and height of moles, (N,) mm."""
    flat, raised = FrontSheet.blank(), FrontSheet.blank()
    for _ in range(round(_MOST_FRECKLES * traits.freckles)):
        x, y = rng.normal(0, 27), rng.normal(-17, 20)
        dark = rng.uniform(*_FRECKLE_MELANIN) * np.exp(-((x / 70) ** 2))
        flat.spot(x, y, float(rng.uniform(0.25, 0.8)), dark, float(rng.uniform(0.5, 1.0)))
    for _ in range(round(26 * max(traits.age - 0.68, 0.0) / 0.32)):
        x, y = rng.uniform(-52, 52), rng.uniform(-45, 66)
        if abs(x) > 18 or y > 20:
            dark = rng.uniform(*_AGE_SPOT_MELANIN)
            flat.spot(x, y, float(rng.uniform(0.8, 2.4)), dark, float(rng.uniform(0.5, 0.9)))
    for _ in range(traits.n_moles):
        x, y = rng.uniform(-48, 48), rng.uniform(-100, 50)
        if abs(x) > 16 or not -90 < y < 12:  # not on nose and lips
            radius, dark = float(rng.uniform(0.4, 0.95)), float(rng.uniform(*_MOLE_MELANIN))
            flat.spot(x, y, radius, dark)
            raised.spot(x, y, radius, float(rng.uniform(0.0, 0.25)) * radius, 0.6)
    return flat.laid_on(places), raised.laid_on(places)


def spot_blood(places: Floats, traits: AppearanceTraits, rng: np.random.Generator) -> Floats:
    """Haemoglobin of blemishes above the skin's, (N,)."""
    if traits.blemishes == 0:
        return np.zeros(len(places), np.float32)
    sheet = FrontSheet.blank()
    centres = np.array([(0.0, 45.0), (36.0, -40.0), (-36.0, -40.0), (0.0, -92.0)])
    spread = np.array([(24.0, 12.0), (12.0, 16.0), (12.0, 16.0), (16.0, 8.0)])
    for _ in range(round(_MOST_BLEMISHES * traits.blemishes)):
        zone = int(rng.integers(len(centres)))
        x, y = rng.normal(centres[zone], spread[zone])
        radius = float(rng.uniform(0.7, 1.9))
        sheet.spot(x, y, radius, float(rng.uniform(*_BLEMISH_BLOOD)), 0.9)
    return sheet.laid_on(places)
