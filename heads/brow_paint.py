"""Brows: single hairs along a curve."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from .appearance_traits import AppearanceTraits
from .template import Template, template_feature_points
from .texture_canvas import sample_bilinear

Floats = NDArray[np.float32]

_BROW_PX_PER_MM = 16
_BROW_BOX = (0.0, 66.0, 2.0, 40.0)  # x0, x1, y0, y1


def brow_cover(
    template: Template, p: Floats, traits: AppearanceTraits, rng: np.random.Generator
) -> Floats:
    """How much brow hairs hide, (N,): single strokes along a curve, each side drawn anew."""
    found = np.zeros(len(p), dtype=np.float32)
    x0, x1, y0, y1 = _BROW_BOX
    inside = (np.abs(p[:, 0]) < x1) & (p[:, 1] > y0) & (p[:, 1] < y1) & (p[:, 2] > -25)
    middle = template_feature_points().select(("4.1", "4.3", "4.5")).at(template.vertices)
    for sign in (-1, 1):
        picture = _drawn_brow(middle, traits, rng)
        rows = np.flatnonzero(inside & (sign * p[:, 0] > x0))
        q = p[rows]
        at_x = (sign * q[:, 0] - x0) * _BROW_PX_PER_MM
        at_y = (y1 - q[:, 1]) * _BROW_PX_PER_MM
        values = sample_bilinear(picture, at_x, at_y)
        found[rows] = values / 255.0
    return found


def _drawn_brow(
    points: NDArray[np.float64], traits: AppearanceTraits, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The left brow from the front, `_BROW_PX_PER_MM`, 255 where hidden."""
    x0, x1, y0, y1 = _BROW_BOX
    size = (round((y1 - y0) * _BROW_PX_PER_MM), round((x1 - x0) * _BROW_PX_PER_MM))
    curve, half_height = _brow_curve(points, traits)
    hairs = np.zeros(size, np.float32)
    for _ in range(round(350 * traits.brow_density)):
        s = rng.beta(1.15, 1.25)
        across = np.clip(rng.normal(0, 0.5), -1, 1)
        x, y = curve(s)
        slope = np.diff(curve(np.array([s - 0.02, min(s + 0.02, 1.0)])), axis=1).ravel()
        direction = np.arctan2(slope[1], slope[0])
        # hairs rise at the inner end, lie along the arch, and close in from above and below
        lean = np.interp(s, (0, 0.12, 0.35, 1), (0.95, 0.62, 0.34, 0.04)) - 0.30 * across
        angle = direction + lean + rng.normal(0, 0.10)
        length = np.interp(s, (0, 0.2, 0.7, 1), (4.2, 6.0, 6.0, 4.0)) * rng.uniform(0.75, 1.15)
        y += across * half_height(s) - 0.35 * length * np.sin(lean) * 0.5
        t = np.linspace(0, 1, 6)[:, None]
        bend = angle - 0.45 * t * np.sign(lean)
        step = np.concatenate([np.cos(bend), np.sin(bend)], axis=1) * length / 6
        line = np.array([x, y]) + np.cumsum(step, axis=0)
        pixels = np.stack([line[:, 0] - x0, y1 - line[:, 1]], axis=1) * _BROW_PX_PER_MM * 16
        stroke = np.zeros(size, np.uint8)
        low, high = pixels.min(axis=0) / 16 - 8, pixels.max(axis=0) / 16 + 8
        box = (
            slice(max(0, int(low[1])), max(0, int(high[1]))),
            slice(max(0, int(low[0])), max(0, int(high[0]))),
        )
        part = np.rint(pixels).astype(np.int32).reshape(-1, 1, 2)
        thick = 4 if rng.random() < 0.4 else 3
        cv2.polylines(stroke, [part], False, 255, thick, cv2.LINE_AA, shift=4)
        strength = rng.uniform(0.4, 0.75) * np.interp(s, (0, 0.18, 1), (0.55, 1.0, 0.9))
        hairs[box] += (1 - hairs[box]) * strength * (stroke[box] / 255.0)
    soft = cv2.GaussianBlur(hairs, (0, 0), 0.7 * _BROW_PX_PER_MM)
    total = 0.74 * cv2.GaussianBlur(hairs, (0, 0), 1.0) + 0.34 * soft
    return np.asarray(np.rint(np.clip(total, 0, 0.93) * 255), dtype=np.uint8)


def _brow_curve(points: NDArray[np.float64], traits: AppearanceTraits) -> tuple[Any, Any]:
    """Middle line, s in [0, 1] → (2, ...) mm, and half height of the left brow."""
    inner, arch, outer = points
    knots = np.array(
        [
            (inner[0] - 3.5, inner[1] + 1.5),
            (inner[0] + 6.0, inner[1] + 2.4),
            (arch[0] - 1.0, arch[1] - 3.2 + traits.brow_arch_mm),
            (outer[0] - 4.0, outer[1] + 1.2 + 0.6 * traits.brow_arch_mm),
            (outer[0] + 4.5, outer[1] - 3.0),
        ]
    )
    line = PchipInterpolator((0, 0.25, 0.6, 0.82, 1.0), knots.T, axis=1)
    thick = traits.brow_thickness

    def half_height(s: Any) -> Any:
        return thick * np.interp(s, (0, 0.15, 0.45, 0.75, 1), (2.1, 2.9, 2.9, 2.1, 0.5))

    return line, half_height
