"""Skin: its pigments, lips, pores, wrinkles and spots, as albedo, gloss and relief."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from .appearance_traits import LONG_CUTS, AppearanceTraits
from .brow_paint import brow_cover
from .hair_paint import beard_density, hair_density, scalp_cover, strands
from .skin_pigments import (
    BASE_DENSITY,
    CALM_HAEMOGLOBIN,
    HAEMOGLOBIN_DENSITY,
    MELANIN_DENSITY,
    SURFACE_LIGHT,
    SkinPigments,
    melanin_of_darkness,
)
from .spot_paint import spot_blood, spot_melanin
from .srgb import linear_from_srgb, srgb_from_linear
from .template import Template
from .texture_canvas import Canvas, make_canvas
from .texture_noise import blob, noise_at, smooth_step
from .wrinkle_paint import furrow_depth

Floats = NDArray[np.float32]

SKIN_PX = 2048
_FIELD_PX = 512  # of what is smooth
_WET = (104, 40, 39)  # sRGB, of the inside of the mouth
#: Random streams of the painters, so that one's draws do not change another's.
_SPOTS, _BLOOD_SPOTS, _FURROWS, _BROWS = range(4)
#: Names of the smooth fields, in their order.
_FIELDS = ("melanin", "blood", "wet", "dark", "hair", "beard", "rough", "pores", "lips")
_PORE_MM, _CREASE_MM, _WHISKER_MM = 0.08, 0.10, 0.07
_LONG_HAIR_MM, _SHORT_HAIR_MM = 0.35, 0.12
_LEVELS = 8192  # of linear light, in the table to sRGB


@dataclass(frozen=True, eq=False)
class SkinMaps:
    """Maps of the whole skin over its texture coordinates.

    Attributes
    ----------
    albedo : (H, W, 3) uint8, sRGB
    roughness : (H, W) uint8, 0 mirror to 255 matt
    normal : (H, W, 3) uint8, as of `Appearance`
    """

    albedo: NDArray[np.uint8]
    roughness: NDArray[np.uint8]
    normal: NDArray[np.uint8]


def paint_skin(template: Template, traits: AppearanceTraits, *, size: int = SKIN_PX) -> SkinMaps:
    """Albedo, gloss and relief of a person's skin, `size` texels a side."""
    canvas = make_canvas(template, size)
    field = _fields(template, traits, canvas)
    p, seed = canvas.places, traits.seed
    pores, fleck = noise_at(p, 0.85, seed + 1), noise_at(p, 2.1, seed + 2)
    melanin, blood, mole_mm = _fine_pigments(field, p, traits, pores, fleck)
    furrow_mm = furrow_depth(p, traits, _stream(traits, _FURROWS))
    beard, scalp, strand = _hairs(field, p, traits, fleck)
    brow = brow_cover(template, p, traits, _stream(traits, _BROWS))
    cover = np.maximum(beard, scalp)
    albedo = np.empty((len(p), 3), np.uint8)
    furrow_dark = 1.1 * furrow_mm  # light is caught in furrows that the mesh has not
    _in_halves(
        _fill_albedo, len(p), melanin, blood, field["wet"], field["dark"] + furrow_dark,
        cover, brow, 1 + 0.24 * strand, _linear(traits.hair), _linear(traits.brow), _linear(_WET),
        BASE_DENSITY, MELANIN_DENSITY, HAEMOGLOBIN_DENSITY, np.float32(SURFACE_LIGHT),
        _srgb_table(), albedo,
    )  # fmt: skip
    # hair scatters: rougher; pores and furrows break the highlight up
    long = traits.cut in LONG_CUTS
    scatter = 0.3 * np.maximum(beard, brow) + (0.08 if long else 0.3) * scalp
    rough = field["rough"] + 0.05 * pores + scatter + 0.25 * furrow_mm
    relief = field["pores"] * _PORE_MM * (0.35 * fleck - np.maximum(pores - 0.1, 0))
    relief += (_LONG_HAIR_MM if long else _SHORT_HAIR_MM) * scalp * strand
    relief += _WHISKER_MM * np.maximum(beard, brow) + mole_mm - furrow_mm
    relief += _lip_creases(field["lips"], p, seed)
    return SkinMaps(
        np.asarray(canvas.filled(albedo)),
        np.asarray(canvas.filled((np.clip(rough, 0.05, 1) * 255).astype(np.uint8))),
        _normals(canvas, relief.astype(np.float32, copy=False)),
    )


def paint_pigments(
    template: Template, traits: AppearanceTraits, *, size: int = SKIN_PX
) -> SkinPigments:
    """The pigments below a person's albedo: without hair, brows and the inside of the mouth.

    Where those do not hide the skin, `SkinPigments.albedo` is what `paint_skin` paints, except
    in furrows and nostrils, which are darker for the light that they catch.
    """
    canvas = make_canvas(template, size)
    field = _fields(template, traits, canvas)
    p, seed = canvas.places, traits.seed
    pores, fleck = noise_at(p, 0.85, seed + 1), noise_at(p, 2.1, seed + 2)
    melanin, blood, _ = _fine_pigments(field, p, traits, pores, fleck)
    return SkinPigments(canvas.filled(melanin), canvas.filled(blood))


def _stream(traits: AppearanceTraits, painter: int) -> np.random.Generator:
    return np.random.default_rng((traits.seed, painter))


def _linear(colour: tuple[float, float, float]) -> Floats:
    return np.asarray(linear_from_srgb(np.array(colour)), dtype=np.float32)


def _srgb_table() -> NDArray[np.uint8]:
    return srgb_from_linear(np.linspace(0, 1, _LEVELS, dtype=np.float32), n_levels=_LEVELS)


def _fields(template: Template, traits: AppearanceTraits, canvas: Canvas) -> dict[str, Floats]:
    """Smooth fields (N,) at the canvas's texels, painted small."""
    coarse = make_canvas(template, min(_FIELD_PX, canvas.size), with_masks=True)
    small = coarse.filled(_smooth_fields(coarse, traits))
    found = {}
    for name, plane in zip(_FIELDS, np.moveaxis(small, -1, 0), strict=True):
        large = cv2.resize(
            np.ascontiguousarray(plane), (canvas.size, canvas.size), interpolation=cv2.INTER_LINEAR
        )
        found[name] = np.asarray(large, dtype=np.float32).ravel()[canvas.texels]
    return found


def _fine_pigments(
    field: dict[str, Floats], p: Floats, traits: AppearanceTraits, pores: Floats, fleck: Floats
) -> tuple[Floats, Floats, Floats]:
    """Melanin and haemoglobin (N,) with their finest grain, and height of moles (N,) mm."""
    spots, mole_mm = spot_melanin(p, traits, _stream(traits, _SPOTS))
    bare = 1 - field["lips"]
    grain = 0.016 * pores + 0.014 * fleck
    melanin = field["melanin"] * (1 + 0.9 * grain * bare) + spots * bare
    blood = field["blood"] + (0.9 * grain) * bare
    blood += spot_blood(p, traits, _stream(traits, _BLOOD_SPOTS)) * bare
    return (
        np.asarray(np.maximum(melanin, 0), dtype=np.float32),
        np.asarray(np.maximum(blood, 0), dtype=np.float32),
        mole_mm,
    )


def _smooth_fields(canvas: Canvas, traits: AppearanceTraits) -> Floats:
    """(N, 9): `_FIELDS`."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    lips = smooth_step(0.22, 0.8, m["lips"])
    inside = smooth_step(0.25, 0.75, m["inside-mouth"])
    darkness, blood = _pigment(canvas, traits)
    melanin = melanin_of_darkness(darkness)
    # lips: thin skin over blood, as dark as the person's melanin lets them be
    uneven = 0.05 * noise_at(p, (0.9, 3.0, 3.0), seed + 8)
    lip_blood = blood + 0.25 + 0.95 * traits.lip_redness + uneven
    lip_melanin = 0.95 * melanin + 0.12 + 0.16 * traits.lip_redness
    melanin = melanin + 0.9 * lips * (lip_melanin - melanin)
    blood = blood + 0.9 * lips * (lip_blood - blood)
    nostril = blob(p, (7.5, -43.5, 27.0), (4.0, 3.6, 6.0))
    hair, beard = hair_density(canvas, traits), beard_density(canvas, traits)
    bare = (1 - lips) * (1 - inside)
    columns = [
        melanin,
        blood,
        inside,
        1.6 * nostril,
        hair * bare,
        beard * bare,
        _roughness(p, lips, inside, traits),
        _pore_strength(canvas, traits) * bare,
        lips * (1 - inside),
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def _pigment(canvas: Canvas, traits: AppearanceTraits) -> tuple[NDArray[Any], NDArray[Any]]:
    """Darkness by melanin, 0 to 1, and haemoglobin, at every texel."""
    p, m, seed = canvas.places, canvas.masks, traits.seed
    broad, middle = noise_at(p, 22.0, seed + 6), noise_at(p, 7.0, seed + 7)
    fine = noise_at(p, 3.2, seed + 9)
    blotch = 0.40 + traits.weathering
    lids = smooth_step(0.3, 0.9, m["eyelids"])
    under_eye = blob(p, (30, -12.5, 13), (13, 4.5, 9))
    beard_zone = blob(p, (26, -82, 12), (30, 26, 30))
    darkness = traits.melanin + blotch * (0.015 * broad + 0.012 * middle + 0.008 * fine)
    darkness += 0.02 * smooth_step(40, 75, p[:, 1]) - 0.02 * beard_zone
    darkness += (0.02 + 0.05 * traits.weathering) * under_eye + 0.03 * lids
    darkness -= 0.03 * blob(p, (0, -10, 30), (9, 26, 18), mirrored=False)  # bridge of the nose
    darkness += 0.10 * traits.tan * _sunlit(p)
    flush = (
        0.55 * blob(p, (41, -30, 8), (17, 15, 24))
        + 0.50 * blob(p, (0, -37, 42), (11, 9, 12), mirrored=False)
        + 0.45 * blob(p, (15, -40, 28), (7, 8, 9))
        + 0.20 * blob(p, (0, -93, 25), (14, 10, 14), mirrored=False)
        + 0.50 * smooth_step(0.3, 0.9, m["ears"]) * smooth_step(60, 84, np.abs(p[:, 0]))
        + 0.14 * m["ears"]
    )
    blood = (0.35 + 1.2 * traits.ruddiness) * flush
    blood += 0.22 * lids + 0.16 * under_eye + 0.10 * blob(p, (0, -52, 28), (16, 8, 14))
    blood += 0.75 * blob(p, (17.5, -1.8, 13), (3.0, 2.2, 6.0))  # caruncle
    blood += 0.45 * blob(p, (31, -4.6, 15.0), (13.0, 1.3, 3.0))  # rim of the lower lid
    blood += blotch * (0.07 * broad + 0.07 * middle + 0.055 * fine)
    blood -= 0.10 * blob(p, (0, 48, 15), (40, 25, 40), mirrored=False)
    blood += 0.10 * smooth_step(-100, -140, p[:, 1])
    veil = 1 - 0.45 * traits.melanin  # less of it is seen through much melanin
    return np.clip(darkness, 0, 1), CALM_HAEMOGLOBIN + veil * blood


def _sunlit(p: Floats) -> NDArray[Any]:
    """Where the sun tans most: what faces up and forward."""
    return np.asarray(
        0.9 * blob(p, (0, 45, 15), (45, 26, 40), mirrored=False)
        + 0.8 * blob(p, (0, -22, 35), (12, 24, 20), mirrored=False)
        + 0.7 * blob(p, (40, -25, 10), (20, 14, 25))
    )


def _roughness(
    p: Floats, lips: NDArray[Any], inside: NDArray[Any], traits: AppearanceTraits
) -> NDArray[Any]:
    oily = (
        0.08 * blob(p, (0, 45, 15), (30, 24, 30), mirrored=False)
        + 0.13 * blob(p, (0, -28, 38), (12, 18, 16), mirrored=False)
        + 0.05 * blob(p, (0, -93, 25), (12, 10, 14), mirrored=False)
        + 0.04 * blob(p, (40, -22, 10), (16, 12, 20))
    )
    # children have little oil, old skin is dry
    rough = 0.56 + 0.10 * max(traits.age - 0.5, 0.0) - oily * min(0.4 + 1.4 * traits.age, 1.0)
    rough += lips * (0.40 - rough)
    rough -= 0.22 * blob(p, (31, -4.9, 15.0), (13.0, 0.9, 3.0))  # tears wet the lower lid's rim
    return np.asarray(rough + inside * (0.34 - rough))


def _pore_strength(canvas: Canvas, traits: AppearanceTraits) -> NDArray[Any]:
    """How deep pores are, 1 on an adult's cheeks."""
    p = canvas.places
    nose = blob(p, (0, -32, 38), (15, 16, 18), mirrored=False)
    cheek = blob(p, (33, -32, 15), (18, 20, 24))
    lids = smooth_step(0.2, 0.8, canvas.masks["eyelids"])
    strength = 0.45 + 0.55 * cheek + 0.55 * nose
    grown = np.interp(traits.age, (0.0, 0.25, 0.45, 1.0), (0.15, 0.3, 0.85, 1.15))
    return np.asarray(grown * strength * (1 - 0.7 * lids))


def _lip_creases(lips: Floats, p: Floats, seed: int) -> Floats:
    """Fine upright furrows of the lips, (N,) mm above the skin."""
    found = np.zeros(len(p), np.float32)
    rows = np.flatnonzero(lips > 0.02)
    creases = noise_at(p[rows], (1.1, 7.0, 7.0), seed + 13)
    found[rows] = -_CREASE_MM * lips[rows] * np.maximum(creases, 0)
    return found


def _hairs(
    field: dict[str, Floats], p: Floats, traits: AppearanceTraits, fleck: Floats
) -> tuple[Floats, Floats, Floats]:
    """How much whiskers and the hair of the head hide, and the hair's strands in about ±1."""
    beard, scalp = np.zeros(len(p), np.float32), np.zeros(len(p), np.float32)
    strand = np.zeros(len(p), np.float32)
    rows = np.flatnonzero(field["beard"] > 0.002)
    whiskers = noise_at(p[rows], (0.75, 1.3, 0.75), traits.seed + 3)
    beard[rows] = np.clip(field["beard"][rows] * (0.75 + 0.85 * whiskers), 0, 0.9)
    rows = np.flatnonzero(field["hair"] > 0.002)
    single, strand[rows] = strands(p[rows], traits)
    scalp[rows] = scalp_cover(field["hair"][rows], single, fleck[rows])
    return beard, scalp, strand


def _normals(canvas: Canvas, relief_mm: Floats) -> NDArray[np.uint8]:
    """Normals (H, W, 3) uint8 of heights (N,) mm above the skin."""
    height = canvas.filled(relief_mm)
    found = np.empty((canvas.size, canvas.size, 3), np.uint8)
    _in_halves(_fill_normals, canvas.size, height, canvas.texel_mm, found)
    return found


def _in_halves(function: Any, count: int, *arguments: Any) -> None:
    """Call a compiled loop over rows, which lets go of the interpreter, in two threads."""
    with ThreadPoolExecutor(2) as pool:
        jobs = [
            pool.submit(function, *(*arguments, first, last))
            for first, last in ((0, count // 2), (count // 2, count))
        ]
    for job in jobs:
        job.result()  # raises what went wrong in it


@njit(cache=True, nogil=True)
def _fill_albedo(  # type: ignore[no-untyped-def]
    melanin, blood, wet, dark, cover, brow, sheen, hair, brow_hair, inside, base, of_melanin,
    of_blood, surface, table, found, first, last,
):  # fmt: skip
    """sRGB of texels: pigments, then what is wet, caught in hollows or hidden by hair."""
    top = len(table) - 1
    for i in range(first, last):
        for k in range(3):
            density = base[k] + melanin[i] * of_melanin[k] + blood[i] * of_blood[k]
            c = surface + (1 - surface) * np.exp(-density)
            c += wet[i] * (inside[k] - c)
            c *= np.exp(-dark[i] * (0.7 if k == 0 else 1.0))
            c += cover[i] * (hair[k] * sheen[i] - c)
            c += brow[i] * (brow_hair[k] - c)
            found[i, k] = table[int(min(max(c, 0.0), 1.0) * top + 0.5)]


@njit(cache=True, nogil=True)
def _fill_normals(height, texel_mm, found, first, last):  # type: ignore[no-untyped-def]
    """Unit normals of a height field, as bytes; rows grow downwards, green points up."""
    rows, columns = height.shape
    for y in range(first, last):
        for x in range(columns):
            right, left = height[y, min(x + 1, columns - 1)], height[y, max(x - 1, 0)]
            below, above = height[min(y + 1, rows - 1), x], height[max(y - 1, 0), x]
            nx = (left - right) / (2 * texel_mm[y, x, 0])
            ny = (below - above) / (2 * texel_mm[y, x, 1])
            length = np.sqrt(nx * nx + ny * ny + 1)
            found[y, x, 0] = int(nx / length * 127.5 + 128)
            found[y, x, 1] = int(ny / length * 127.5 + 128)
            found[y, x, 2] = int(1 / length * 127.5 + 127.5)
