"""Teeth, tongue and lashes: stripes of one small picture."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .appearance_traits import AppearanceTraits
from .srgb import linear_from_srgb, srgb_from_linear
from .texture_noise import smooth_step

DETAILS_PX = 512

#: Widths of the teeth from the middle outwards, mm (means of adults).
_TEETH_MM = {
    "upper": (8.5, 6.6, 7.6, 7.0, 6.8, 10.0, 9.5, 8.5),
    "lower": (5.4, 5.9, 6.9, 7.0, 7.1, 11.0, 10.5, 10.0),
}


def paint_details(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(DETAILS_PX, DETAILS_PX, 4) uint8, sRGB and alpha: upper teeth, lower, tongue, lashes."""
    n = DETAILS_PX
    light = np.zeros((n, n, 4), np.float32)
    light[..., 3] = 1
    light[: n // 4, :, :3] = _teeth_light(rng, "upper")
    light[n // 4 : n // 2, :, :3] = _teeth_light(rng, "lower")[::-1]
    tongue = linear_from_srgb(np.array([168, 88, 86])).astype(np.float32)
    bumps = cv2.GaussianBlur(rng.normal(size=(n // 4, n)).astype(np.float32), (0, 0), 1.5)
    far = np.linspace(1.0, 0.25, n // 4, dtype=np.float32)[:, None]  # into the throat
    light[n // 2 : 3 * n // 4, :, :3] = tongue * ((1 + 0.2 * bumps) * far)[..., None]
    light[3 * n // 4 :, :, :3] = linear_from_srgb(np.array(traits.brow)) * 0.45
    light[3 * n // 4 :, :, 3] = _lash_alpha(rng, n // 4, n)
    found = np.empty((n, n, 4), np.uint8)
    found[..., :3] = srgb_from_linear(light[..., :3])
    found[..., 3] = np.rint(light[..., 3] * 255)
    return found


def _teeth_light(rng: np.random.Generator, row: str) -> NDArray[Any]:
    """A row of teeth seen from outside; gums at the top."""
    height, width = DETAILS_PX // 4, DETAILS_PX
    widths = np.array(_TEETH_MM[row])
    edges = np.concatenate([[0], np.cumsum(widths)])
    edges = edges / edges[-1]
    x = np.abs((np.arange(width) + 0.5) / width * 2 - 1.0)
    tooth = np.clip(np.searchsorted(edges, x) - 1, 0, len(widths) - 1)
    within = (x - edges[tooth]) / (edges[tooth + 1] - edges[tooth])  # 0..1 across a tooth
    from_edge = np.minimum(within, 1 - within) * widths[tooth]  # mm
    t = np.linspace(0, 1, height)[:, None]
    enamel = linear_from_srgb(np.array([226, 214, 192]))
    neck = linear_from_srgb(np.array([206, 182, 142]))
    tone = rng.normal(1, 0.02, size=(2, len(widths)))[np.arange(width) * 2 // width, tooth]
    light = enamel + smooth_step(0.55, 0.12, t)[..., None] * 0.55 * (neck - enamel)
    light = np.broadcast_to(light, (height, width, 3)) * tone[None, :, None]
    gap = np.exp(-((from_edge / 0.32) ** 2))
    light = light * (1 - 0.62 * gap)[None, :, None]
    scallop = 0.16 + 0.10 * (np.abs(2 * within - 1) ** 2)
    gum = smooth_step(0.03, -0.03, t - scallop[None])[..., None]
    return np.asarray(light + gum * (linear_from_srgb(np.array([176, 98, 94])) - light))


def _lash_alpha(rng: np.random.Generator, height: int, width: int) -> NDArray[Any]:
    """Hairs from the root (bottom) to the tip (top)."""
    picture = np.zeros((height, width), np.uint8)
    for _ in range(130):
        root = rng.uniform(0, width)
        lean = (root / width - 0.35) * 60 + rng.normal(0, 10)
        length = rng.uniform(0.55, 1.0) * height
        line = np.array([[root, height + 2], [root + lean, height - length]])
        points = np.rint(line * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [points], False, 255, 3, cv2.LINE_AA, 4)
    fade = np.linspace(0.25, 1.0, height)[:, None]
    inner = np.interp(np.arange(width), (0, 0.25 * width), (0.25, 1.0))
    return np.asarray(picture / 255.0 * fade * inner * 0.95)
