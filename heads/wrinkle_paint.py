"""Lines that age draws on a face at rest: how deep furrows are where."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .appearance_traits import AppearanceTraits
from .texture_front import FrontSheet

Floats = NDArray[np.float32]
Points = NDArray[np.float64]

#: Ways of furrows on the left of the template, mm, seen from the front, with width (mm), depth
#: (mm, at an age of 1) and the age from which they begin to show.
_PAIRED: tuple[tuple[tuple[tuple[float, float], ...], float, float, float], ...] = (
    # from the wing of the nose past the mouth's corner
    (((17.5, -38), (22, -46), (28, -56), (32, -66), (33.5, -74)), 1.7, 0.50, 0.50),
    # below the mouth's corner
    (((28, -73), (30, -81), (30, -90), (28, -98)), 1.5, 0.32, 0.66),
    # crow's feet
    (((49, 2.5), (54, 5), (60, 9.5)), 0.9, 0.26, 0.54),
    (((49.5, -0.5), (55, 0), (62, 2)), 0.9, 0.30, 0.52),
    (((49, -3.5), (54, -6), (60, -10.5)), 0.9, 0.28, 0.54),
    (((47.5, -6.5), (52, -11), (56, -17)), 0.8, 0.22, 0.64),
    # under the eye
    (((17, -8), (23, -13.5), (31, -16.5), (40, -15)), 1.1, 0.24, 0.52),
    (((20, -12), (27, -18.5), (35, -21.5), (42, -20)), 1.3, 0.22, 0.66),
    # between the brows
    (((6.0, 11), (6.8, 18), (6.2, 26)), 1.1, 0.30, 0.58),
    # across the cheek
    (((42, -38), (46, -50), (47, -62)), 1.2, 0.16, 0.74),
    # above the lip
    (((4.5, -56), (4.2, -61)), 0.7, 0.12, 0.76),
    (((9.5, -57), (9.0, -62.5)), 0.7, 0.13, 0.76),
    (((14.5, -59), (13.6, -64)), 0.7, 0.13, 0.76),
)
_FOREHEAD_Y_MM = (33.0, 41.0, 49.5, 58.5)
_FOREHEAD_WIDTH_MM, _FOREHEAD_DEPTH_MM, _FOREHEAD_FROM = 1.4, 0.45, 0.55
_CHIN_Y_MM = -84.0
_STEPS = 40


def furrow_depth(places: Floats, traits: AppearanceTraits, rng: np.random.Generator) -> Floats:
    """Depth of the furrows at places (N, 3) mm on the template: (N,) mm, none on the young."""
    if traits.age <= 0.5:
        return np.zeros(len(places), np.float32)
    sheet = FrontSheet.blank()
    for points, width, depth, since in _PAIRED:
        for side in (-1, 1):
            amount = depth * _grown(traits.age, since) * rng.uniform(0.55, 1.15)
            shift = rng.normal(0, 0.5, 2)
            way = _smooth_way(np.array(points), rng) + shift
            sheet.line(way * (side, 1), width, amount * _swell(rng))
    for y in _FOREHEAD_Y_MM:
        amount = _FOREHEAD_DEPTH_MM * _grown(traits.age, _FOREHEAD_FROM) * rng.uniform(0.3, 1.15)
        _forehead_line(sheet, y + rng.normal(0, 1.2), amount, rng)
    chin = np.stack([np.linspace(-15, 15, _STEPS), np.full(_STEPS, _CHIN_Y_MM)], axis=1)
    chin[:, 1] -= 2.5 * (chin[:, 0] / 15) ** 2
    sheet.line(chin, 2.2, 0.22 * _grown(traits.age, 0.5) * _swell(rng))
    return sheet.laid_on(places)


def _grown(age: float, since: float) -> float:
    """0 before an age, 1 at the end."""
    return float(np.clip((age - since) / (1 - since), 0, 1) ** 0.8)


def _swell(rng: np.random.Generator) -> NDArray[np.float64]:
    """Amount along a line: it begins and ends in nothing, and is uneven between."""
    t = np.linspace(0, 1, _STEPS)
    uneven = np.interp(t, np.linspace(0, 1, 7), rng.uniform(0.65, 1.0, 7))
    return np.asarray(np.sin(np.pi * t**0.8) ** 0.7 * uneven)


def _smooth_way(knots: Points, rng: np.random.Generator) -> Points:
    t = np.linspace(0, 1, len(knots))
    s = np.linspace(0, 1, _STEPS)
    order = min(len(knots) - 1, 3)
    way = np.stack([np.polyval(np.polyfit(t, knots[:, k], order), s) for k in (0, 1)], axis=1)
    wobble = np.interp(s, np.linspace(0, 1, 6), rng.normal(0, 0.25, 6))
    return np.asarray(way + wobble[:, None])


def _forehead_line(sheet: FrontSheet, y: float, amount: float, rng: np.random.Generator) -> None:
    """A line across, high over the brows and low in the middle, in two or three pieces."""
    ends = np.array([-44.0, rng.uniform(-10, 10), 44.0]) + rng.normal(0, 4, 3)
    for start, stop in ((ends[0], ends[1] + 5), (ends[1] - 5, ends[2])):
        x = np.linspace(start, stop, _STEPS)
        bow = 2.2 * np.cos(np.abs(x) / 44 * np.pi - np.pi * 0.55)
        wobble = np.interp(x, np.linspace(start, stop, 8), rng.normal(0, 0.55, 8))
        way = np.stack([x, y + bow + wobble], axis=1)
        sheet.line(way, _FOREHEAD_WIDTH_MM, amount * _swell(rng))
