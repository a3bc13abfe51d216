"""Skin: pigment, blood, lips, pores, freckles and moles, and how rough it is."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .appearance_traits import AppearanceTraits
from .brow_paint import brow_cover
from .hair_paint import beard_density, hair_density, scalp_cover
from .srgb import linear_from_srgb, srgb_from_linear
from .template import Template
from .texture_canvas import Canvas, make_canvas, sample_bilinear
from .texture_noise import blob, noise_at, smooth_step

Floats = NDArray[np.float32]

SKIN_PX, ROUGHNESS_PX = 2048, 1024
_FIELD_PX = 512  # of what is smooth
#: Skin from the least to the most melanin.
_SKIN = np.array(
    [
        (241, 208, 189),
        (231, 188, 162),
        (212, 161, 129),
        (178, 124, 92),
        (132, 88, 64),
        (86, 57, 45),
    ]
)
#: What a unit of blood takes from red, green, blue (log reflectance); less seen through melanin.
_BLOOD = np.array([0.06, 0.62, 0.52])
#: What a unit of mottling by melanin takes.
_MELANIN = np.array([0.7, 1.0, 1.15])
_SPOT_PX_PER_MM = 8


def paint_skin(
    template: Template, traits: AppearanceTraits, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Albedo (H, W, 3) uint8, sRGB, and roughness (h, w) uint8, of the whole skin."""
    coarse = make_canvas(template, _FIELD_PX, with_masks=True)
    fine = make_canvas(template, SKIN_PX)
    field = coarse.filled(_smooth_fields(coarse, traits))
    field = cv2.resize(field, (SKIN_PX, SKIN_PX), interpolation=cv2.INTER_LINEAR)
    field = field.reshape(-1, field.shape[2])[fine.texels]
    p, seed = fine.places, traits.seed
    pores = noise_at(p, 0.85, seed + 1)
    fleck = noise_at(p, 2.1, seed + 2)
    log_albedo = field[:, :3]
    strength = (0.030 * pores + 0.028 * fleck) * (1 - field[:, 3])
    log_albedo -= strength[:, None] * np.array([0.6, 1.0, 1.0], np.float32)
    _add_spots(log_albedo, p, traits, rng)
    albedo = np.exp(log_albedo, out=log_albedo)
    whiskers = noise_at(p, (0.75, 1.3, 0.75), seed + 3)
    beard = np.clip(field[:, 5] * (0.75 + 0.85 * whiskers), 0, 0.9)
    scalp = scalp_cover(field[:, 4], noise_at(p, (0.8, 1.0, 1.3), seed + 4), fleck)
    hair = linear_from_srgb(np.array(traits.hair)).astype(np.float32)
    sheen = 1 + 0.22 * noise_at(p, (1.0, 2.2, 2.6), seed + 5)
    cover = np.maximum(beard, scalp)[:, None]
    albedo += cover * (hair * sheen[:, None] - albedo)
    brow = brow_cover(template, p, traits, rng)[:, None]
    albedo += brow * (linear_from_srgb(np.array(traits.brow)).astype(np.float32) - albedo)
    # hair scatters: rougher; pores break the highlight up
    rough = field[:, 6] + 0.07 * pores + 0.3 * np.maximum(cover, brow)[:, 0]
    small = cv2.resize(
        fine.filled((np.clip(rough, 0.05, 1) * 255).astype(np.uint8)),
        (ROUGHNESS_PX, ROUGHNESS_PX),
        interpolation=cv2.INTER_AREA,
    )
    return fine.filled(srgb_from_linear(albedo)), np.asarray(small, dtype=np.uint8)


def _smooth_fields(canvas: Canvas, traits: AppearanceTraits) -> Floats:
    """(N, 7): log albedo ×3, wetness, hair, beard, roughness."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    lips = smooth_step(0.22, 0.8, m["lips"])
    inside = smooth_step(0.25, 0.75, m["inside-mouth"])
    melanin, blood = _pigment(canvas, traits)
    grid = np.linspace(0, 1, len(_SKIN))
    tone = np.log(linear_from_srgb(_SKIN))
    log_albedo = np.stack([np.interp(melanin, grid, tone[:, c]) for c in range(3)], axis=1)
    veil = 1 - 0.55 * np.clip(melanin, 0, 1)
    log_albedo -= (blood * veil)[:, None] * _BLOOD
    # lips: thin skin over blood, as dark as the person's melanin lets them be
    redder = (0.45 + 1.0 * traits.lip_redness) * np.array([0.22, 0.62, 0.45])
    lip_log = log_albedo - redder * veil[:, None]
    lip_log -= 0.16 * smooth_step(0.45, 0.9, np.full(1, traits.melanin)) * _MELANIN
    crease = noise_at(p, (0.9, 3.0, 3.0), seed + 8)
    lip_log -= (0.05 * crease)[:, None]
    log_albedo += (0.88 * lips)[:, None] * (lip_log - log_albedo)
    wet = np.log(linear_from_srgb(np.array([104, 40, 39])))
    log_albedo += inside[:, None] * (wet - log_albedo)
    nostril = blob(p, (7.5, -43.5, 27.0), (4.0, 3.6, 6.0))
    log_albedo -= nostril[:, None] * np.array([1.3, 2.0, 2.0])
    hair, beard = hair_density(canvas, traits), beard_density(canvas, traits)
    bare = (1 - lips) * (1 - inside)
    rough = _roughness(p, lips, inside)
    columns = [lips + inside, hair * bare, beard * bare, rough]
    return np.concatenate([log_albedo, np.stack(columns, axis=1)], axis=1).astype(np.float32)


def _pigment(canvas: Canvas, traits: AppearanceTraits) -> tuple[NDArray[Any], NDArray[Any]]:
    """Melanin, 0 to 1 of `_SKIN`, and blood above the mean, at every texel."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    broad, middle = noise_at(p, 22.0, seed + 6), noise_at(p, 7.0, seed + 7)
    fine = noise_at(p, 3.2, seed + 9)
    blotch = 0.45 + traits.weathering
    lids = smooth_step(0.3, 0.9, m["eyelids"])
    under_eye = blob(p, (30, -12.5, 13), (13, 4.5, 9))
    beard_zone = blob(p, (26, -82, 12), (30, 26, 30))
    melanin = traits.melanin + blotch * (0.015 * broad + 0.012 * middle + 0.008 * fine)
    melanin += 0.02 * smooth_step(40, 75, p[:, 1]) - 0.02 * beard_zone
    melanin += (0.03 + 0.04 * traits.weathering) * under_eye + 0.03 * lids
    melanin -= 0.035 * blob(p, (0, -10, 30), (9, 26, 18), mirrored=False)  # bridge of the nose
    flush = (
        0.55 * blob(p, (41, -30, 8), (17, 15, 24))
        + 0.50 * blob(p, (0, -37, 42), (11, 9, 12), mirrored=False)
        + 0.45 * blob(p, (15, -40, 28), (7, 8, 9))
        + 0.20 * blob(p, (0, -93, 25), (14, 10, 14), mirrored=False)
        + 0.50 * smooth_step(0.3, 0.9, m["ears"]) * smooth_step(60, 84, np.abs(p[:, 0]))
        + 0.14 * m["ears"]
    )
    blood = (0.35 + 1.3 * traits.ruddiness) * flush
    blood += 0.22 * lids + 0.16 * under_eye + 0.10 * blob(p, (0, -52, 28), (16, 8, 14))
    blood += 0.75 * blob(p, (17.5, -1.8, 13), (3.0, 2.2, 6.0))  # caruncle
    blood += 0.35 * blob(p, (31, -4.6, 15.0), (13.0, 1.3, 3.0))  # rim of the lower lid
    blood += blotch * (0.07 * broad + 0.07 * middle + 0.055 * fine)
    blood -= 0.10 * blob(p, (0, 48, 15), (40, 25, 40), mirrored=False)
    blood += 0.35 * smooth_step(-100, -140, p[:, 1]) * 0.3
    return np.clip(melanin, 0, 1), blood


def _roughness(p: Floats, lips: NDArray[Any], inside: NDArray[Any]) -> NDArray[Any]:
    oily = (
        0.09 * blob(p, (0, 45, 15), (30, 24, 30), mirrored=False)
        + 0.15 * blob(p, (0, -28, 38), (12, 18, 16), mirrored=False)
        + 0.05 * blob(p, (0, -93, 25), (12, 10, 14), mirrored=False)
        + 0.04 * blob(p, (40, -22, 10), (16, 12, 20))
    )
    rough = 0.56 - oily
    rough += lips * (0.36 - rough)
    return np.asarray(rough + inside * (0.42 - rough))


def _add_spots(
    log_albedo: Floats, p: Floats, traits: AppearanceTraits, rng: np.random.Generator
) -> None:
    """Freckles over nose and cheeks, moles anywhere on the face; in place."""
    rows = np.flatnonzero((p[:, 2] > -50) & (np.abs(p[:, 0]) < 70) & (p[:, 1] < 75))
    q = p[rows]
    picture = _drawn_spots(traits, rng)
    at = (q[:, 0] + 70) * _SPOT_PX_PER_MM, (75 - q[:, 1]) * _SPOT_PX_PER_MM
    amount = sample_bilinear(picture, *at) / 255.0
    log_albedo[rows] -= (0.9 * amount[:, None] * _MELANIN).astype(np.float32)


def _drawn_spots(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Freckles and moles from the front: 70 mm to the right, 75 up, 120 down; 255 is darkest."""
    scale = _SPOT_PX_PER_MM
    picture = np.zeros((195 * scale, 140 * scale), np.float32)

    def spot(x: float, y: float, radius: float, dark: float) -> None:
        centre = round((x + 70) * scale * 16), round((75 - y) * scale * 16)
        one = np.zeros((8 * scale, 8 * scale), np.uint8)
        corner = centre[0] // 16 - 4 * scale, centre[1] // 16 - 4 * scale
        local = centre[0] - corner[0] * 16, centre[1] - corner[1] * 16
        cv2.circle(one, local, round(radius * scale * 16), 255, -1, cv2.LINE_AA, 4)
        soft = cv2.GaussianBlur(one, (0, 0), 0.3 * radius * scale).astype(np.float32)
        if corner[0] >= 0 and corner[1] >= 0:
            part = picture[corner[1] : corner[1] + 8 * scale, corner[0] : corner[0] + 8 * scale]
            np.maximum(part, dark * soft[: part.shape[0], : part.shape[1]], out=part)

    for _ in range(round(420 * traits.freckles)):
        x, y = rng.normal(0, 26), rng.normal(-20, 17)
        spot(x, y, float(rng.uniform(0.3, 0.75)), float(rng.uniform(0.12, 0.38)))
    for _ in range(traits.n_moles):
        x, y = rng.uniform(-60, 60), rng.uniform(-100, 50)
        if abs(x) > 16 or not -90 < y < -25:  # not on nose and lips
            spot(x, y, float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.45, 0.95)))
    return np.rint(np.clip(picture, 0, 255)).astype(np.uint8)
