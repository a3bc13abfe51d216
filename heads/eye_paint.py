"""The eyeball seen along its axis: sclera, vessels, iris and pupil."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .appearance_traits import AppearanceTraits
from .srgb import linear_from_srgb, srgb_from_linear
from .texture_layout import EYE_FRONT_RAD, EYE_FRONT_SHARE
from .texture_noise import smooth_step

EYE_PX = 512

_IRIS_RAD, _PUPIL_SHARE = 0.395, 0.40


def paint_eye(traits: AppearanceTraits, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(EYE_PX, EYE_PX, 3) uint8, sRGB; both eyes share it."""
    n = EYE_PX
    y, x = (np.mgrid[0:n, 0:n] + 0.5) / n * 2 - 1
    r, angle = np.hypot(x, y) / 0.98, np.arctan2(y, x)
    theta = np.interp(r, (0, EYE_FRONT_SHARE, 1.0), (0, EYE_FRONT_RAD, np.pi))
    rho = theta / _IRIS_RAD  # 1 at the edge of the iris
    sclera = linear_from_srgb(np.array([220, 211, 203]))
    pink = linear_from_srgb(np.array([214, 172, 158]))
    light = sclera + smooth_step(1.6, 3.2, rho)[..., None] * 0.6 * (pink - sclera)
    veins = _drawn_veins(rng, n)
    light = light * np.exp(-veins[..., None] * np.array([0.05, 0.42, 0.36]))
    light = light * (1 - 0.22 * np.exp(-(((rho - 1.04) / 0.16) ** 2)))[..., None]
    iris = _iris_light(traits, rng, rho, angle, y)
    edge = smooth_step(1.06, 0.95, rho)[..., None]
    light = light + edge * (iris - light)
    pupil = smooth_step(_PUPIL_SHARE + 0.03, _PUPIL_SHARE - 0.03, rho)[..., None]
    light = light + pupil * (0.004 - light)
    return srgb_from_linear(light.astype(np.float32))


def _iris_light(
    traits: AppearanceTraits,
    rng: np.random.Generator,
    rho: NDArray[Any],
    angle: NDArray[Any],
    y: NDArray[Any],
) -> NDArray[Any]:
    base = linear_from_srgb(np.array(traits.iris))
    turns = (angle / (2 * np.pi)) % 1
    fibres = np.zeros_like(rho)
    for count, weight in ((60, 0.5), (110, 0.6), (190, 0.5)):
        ring = rng.normal(size=(4, count))
        column = (turns * count).astype(int) % count
        nearer = np.clip((rho * 4).astype(int), 0, 3)
        share = (turns * count) % 1
        share = share * share * (3 - 2 * share)
        fibres += weight * (
            ring[nearer, column] * (1 - share) + ring[nearer, (column + 1) % count] * share
        )
    light = base * (1.30 + 0.26 * fibres)[..., None]
    warm = linear_from_srgb(np.array([150, 98, 48])) * (0.5 + base.max())
    collar = np.exp(-(((rho - 0.52) / 0.12) ** 2))[..., None]
    light = light + 0.35 * collar * (warm - light)
    ring = 1 - 0.80 * smooth_step(0.72, 1.02, rho)
    # light gathers opposite to where it comes in
    lens = 1 + 0.55 * smooth_step(-0.15, 0.15, y) * smooth_step(0.3, 0.6, rho)
    shade = 1 - 0.35 * smooth_step(0.02, -0.14, y)  # the lid's shade
    return np.asarray(np.clip(light, 0.004, 1) * (ring * lens * shade)[..., None])


def _drawn_veins(rng: np.random.Generator, n: int) -> NDArray[Any]:
    """Faint vessels that run from the rim towards the iris."""
    picture = np.zeros((n, n), np.uint8)
    for _ in range(26):
        angle = rng.choice([0, np.pi]) + rng.normal(0, 0.45)
        radius = rng.uniform(0.40, 0.47)
        stop, wobble = rng.uniform(0.21, 0.33), rng.normal(0, 0.05, 40).cumsum()
        path = []
        for step, turn in zip(np.linspace(radius, stop, 40), wobble, strict=True):
            a = angle + 0.5 * turn
            path.append((n / 2 + n * step * np.cos(a), n / 2 + n * step * np.sin(a)))
        points = np.rint(np.array(path) * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [points], False, int(rng.integers(70, 190)), 1, cv2.LINE_AA, 4)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.9) / 255.0)
