"""Hair of the head by its cut, and stubble: how dense they grow where."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from .appearance_traits import LONG_CUTS, AppearanceTraits
from .texture_canvas import Canvas
from .texture_noise import blob, noise_at, smooth_step

Floats = NDArray[np.float32]

#: Hairline: azimuth from the front and elevation, degrees, seen from `_SKULL_CENTRE`.
_SKULL_CENTRE = np.array([0.0, 20.0, -70.0], dtype=np.float32)
_HAIRLINE_AZIMUTH = (0.0, 20.0, 33.0, 47.0, 60.0, 70.0, 79.0, 90.0, 112.0, 140.0, 180.0)
_HAIRLINE_ELEVATION = (34.0, 34.0, 30.5, 24.0, 8.0, -9.0, -25.0, -26.0, -29.0, -40.0, -45.0)
#: By cut: middle of the fade (mm above the hairline), its half width, and the share taken from
#: the sides, at azimuths 20, 55, 90 and 180 degrees.
_HAIR_FADE: dict[str, tuple[tuple[float, ...], ...]] = {
    "bald": ((6, 8, 8, 12), (7, 9, 10, 14), (0.0, 0.0, 0.0, 0.0)),
    "shaved": ((4, 6, 7, 12), (6, 8, 9, 14), (0.0, 0.1, 0.15, 0.2)),
    "fade": ((4, 7, 14, 22), (5, 8, 16, 24), (0.0, 0.55, 0.75, 0.75)),
    "buzz": ((4, 5, 7, 12), (5, 6, 9, 14), (0.0, 0.15, 0.25, 0.25)),
    "slick": ((4, 4, 4, 6), (5, 5, 6, 9), (0.0, 0.0, 0.05, 0.05)),
    "rows": ((3, 3, 4, 6), (4, 4, 5, 8), (0.0, 0.0, 0.05, 0.05)),
}
_HAIR_DENSITY = {
    "bald": 0.10, "shaved": 0.50, "fade": 1.02, "buzz": 1.05, "slick": 1.2, "rows": 1.1,
}  # fmt: skip
_EARS_MM = np.array([0.0, -22.0, -80.0], dtype=np.float32)  # hair combed back goes round them
_ROW_MM, _BRAID_MM = 13.0, 5.0  # from braid to braid, from twist to twist


def hair_density(canvas: Canvas, traits: AppearanceTraits) -> NDArray[Any]:
    """Hair within the hairline, by the cut, 0 to 1, at every texel."""
    p = canvas.places
    q = p - _SKULL_CENTRE
    distance = np.linalg.norm(q, axis=1)
    azimuth = np.degrees(np.arctan2(np.abs(q[:, 0]), q[:, 2]))
    elevation = np.degrees(np.arcsin(q[:, 1] / distance))
    line = PchipInterpolator(_HAIRLINE_AZIMUTH, _HAIRLINE_ELEVATION)(azimuth)
    temple = np.exp(-(((azimuth - 36) / 15) ** 2))
    line = line + traits.recession_mm * (0.55 + 0.75 * temple) * smooth_step(75, 50, azimuth)
    inside_mm = np.radians(elevation - line) * distance
    ragged = 2.2 * noise_at(p, 5.0, traits.seed + 10) + 1.6 * noise_at(p, 1.8, traits.seed + 11)
    inside_mm = inside_mm + ragged
    front, side, nape = (np.interp(azimuth, (20, 55, 90, 180), w) for w in _HAIR_FADE[traits.cut])
    fade = smooth_step(-1.0, 1.0, (inside_mm - front) / np.maximum(side, 1.0))
    most = _HAIR_DENSITY[traits.cut]
    sides = 1 - nape * smooth_step(62.0, -5.0, p[:, 1]) * smooth_step(35, 75, azimuth)
    off_ears = 1 - smooth_step(0.15, 0.6, canvas.masks["ears"])
    lower = smooth_step(-75, -50, p[:, 1])
    return np.asarray(most * fade * sides * off_ears * lower)


def scalp_cover(density: Floats, hairs: Floats, clumps: Floats) -> Floats:
    """How much of the skin hair hides: single hairs where it is thin, all where it is dense."""
    # where partings are, `hairs` falls far below −1
    parted = np.clip(3.0 + hairs, 0, 1)
    return np.asarray(
        parted
        * np.clip(
            density * (1.0 + (0.42 * hairs + 0.2 * clumps) * (1.05 - 0.75 * density)), 0, 0.96
        ),
        dtype=np.float32,
    )


def strands(p: Floats, traits: AppearanceTraits) -> tuple[Floats, Floats]:
    """Single hairs and the sheen of strands, both (N,) in about ±1, at places with hair.

    Short hair stands in tufts; hair combed back or braided runs from the brow over the crown.
    """
    seed = traits.seed
    if traits.cut not in LONG_CUTS:
        single = noise_at(p, (0.8, 1.0, 1.3), seed + 4)
        return single, noise_at(p, (1.0, 2.2, 2.6), seed + 5)
    q = p - _EARS_MM
    radius = np.linalg.norm(q, axis=1)
    across = np.arcsin(np.clip(q[:, 0] / radius, -1, 1)) * 85.0  # mm, from the middle
    along = np.arctan2(q[:, 1], q[:, 2]) * np.hypot(q[:, 1], q[:, 2])
    flow = np.stack([across + 1.5 * np.sin(along / 23.0), along, np.zeros_like(across)], axis=1)
    flow = flow.astype(np.float32)
    single = noise_at(flow, (0.7, 16.0, 1.0), seed + 4)
    locks = noise_at(flow, (3.6, 40.0, 1.0), seed + 5)
    if traits.cut == "slick":
        return single, np.asarray(0.3 * single + 0.55 * locks, dtype=np.float32)
    # braids: round between partings, in twists that lean to either side in turn
    phase = across / _ROW_MM
    off = phase - np.rint(phase)
    twist = np.sin(2 * np.pi * (along / _BRAID_MM + np.abs(off) * 1.6))
    round_ = np.cos(np.pi * np.clip(np.abs(off) * 2.0, 0, 1))
    parting = np.exp(-(((np.abs(off) - 0.5) / 0.05) ** 2))
    braid = 0.9 * round_ + 0.45 * twist * (1 - parting) + 0.25 * single
    return (
        np.asarray(single - 6.0 * parting, dtype=np.float32),
        np.asarray(braid, dtype=np.float32),
    )


def beard_density(canvas: Canvas, traits: AppearanceTraits) -> NDArray[Any]:
    """Stubble on jaw, chin, upper lip and under the jaw."""
    p = canvas.places
    if traits.stubble == 0:
        return np.zeros(len(p))
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    upper = np.interp(x, (0, 12, 22, 32, 45, 58, 70), (-48, -49, -55, -62, -60, -48, -22))
    area = smooth_step(8, -11, y - upper) * smooth_step(-132, -112, y) * smooth_step(-78, -55, z)
    area = area * (1 - 0.85 * blob(p, (14, -82, 25), (5, 6, 12)))  # bare beside the lower lip
    area = area * (1 - 0.5 * blob(p, (0, -55, 32), (2.5, 5, 8), mirrored=False))
    off_ears = 1 - smooth_step(0.05, 0.4, canvas.masks["ears"])
    patch = 1 + 0.25 * noise_at(p, 6.0, traits.seed + 12)
    return np.asarray(0.55 * traits.stubble * area * off_ears * patch)
