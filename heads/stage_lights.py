"""Where the lights of the stage stand, and how much of them reaches a place: soft shadows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .raycast import RayScene

Floats = NDArray[np.float32]

#: Towards the lights: x left of the subject, y up, z out of the face.
_KEY_TO = np.array([-0.52, 0.55, 0.80])
_KEY_SPREAD, _KEY_RAYS = 0.30, 10
_RIM_SPREAD, _RIM_RAYS = 0.25, 4
_FILL_TO = np.array([0.85, 0.10, 0.75])
_RIM_TO = np.array([0.80, 0.45, -0.75])
_SKY_RAYS, _SKY_REACH_MM = 20, 70.0
_EYE_RAYS, _EYE_REACH_MM = 14, 14.0
_OFFSET_MM = 0.25  # rays for shadows start this far off the surface


class StageLights:
    """Key, fill and rim light and the sky about a head, turned as the stage is.

    Parameters
    ----------
    world_from_stage : (3, 3) float64
        Rotation; the key light comes from the subject's right, above, when the face looks along
        the stage's z axis.

    Attributes
    ----------
    directions : (4, 3) float32, world axes
        Unit vectors towards the key, the fill and the rim light, and up.
    """

    def __init__(self, world_from_stage: NDArray[np.float64]) -> None:
        towards = (_KEY_TO, _FILL_TO, _RIM_TO, np.eye(3)[1])
        self.directions = np.stack(
            [world_from_stage @ (v / np.linalg.norm(v)) for v in towards]
        ).astype(np.float32)
        self._key_rays = _cone(self.directions[0], _KEY_SPREAD, _KEY_RAYS)
        self._rim_rays = _cone(self.directions[2], _RIM_SPREAD, _RIM_RAYS)
        self._sky_rays = _sphere(_SKY_RAYS * 2)
        self._eye_rays = _cone(self.directions[0] + 0.64 * self.directions[3], 0.95, _EYE_RAYS)

    def reaching(self, scene: RayScene, places: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """Shares of key and rim light (N, 2) and of sky (N,) that reach places on a surface."""
        lamps = np.ones((len(places), 2), np.float32)
        start = places + _OFFSET_MM * normals
        for lamp, rays in enumerate((self._key_rays, self._rim_rays)):
            facing = normals @ rays.T > -0.25
            blocked = _blocked(scene, start, rays, facing, np.inf)
            lamps[:, lamp] = 1 - blocked.sum(axis=1) / np.maximum(facing.sum(axis=1), 1)
        cosine = np.clip(normals @ self._sky_rays.T, 0, None)
        blocked = _blocked(scene, start, self._sky_rays, cosine > 0.05, _SKY_REACH_MM)
        sky = 1 - (blocked * cosine).sum(axis=1) / np.maximum(cosine.sum(axis=1), 1e-6)
        return lamps, sky.astype(np.float32)

    def reaching_eyes(self, scene: RayScene, places: Floats, normals: Floats) -> Floats:
        """Openness (N,) of places on the eyeballs to the light, dimmed near the lids."""
        start = (places + 0.1 * normals).astype(np.float32)
        facing = np.ones((len(start), len(self._eye_rays)), bool)
        blocked = _blocked(scene, start, self._eye_rays, facing, _EYE_REACH_MM)
        return np.asarray(1 - blocked.mean(axis=1), dtype=np.float32)


def _cone(axis: NDArray[Any], spread: float, count: int) -> Floats:
    """Directions about an axis within `spread` rad, evenly (sunflower), (count, 3)."""
    w = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    u = np.cross(w, np.eye(3)[np.argmin(np.abs(w))])
    u /= np.linalg.norm(u)
    i = np.arange(count)
    radius = np.tan(spread) * np.sqrt((i + 0.5) / count)
    turn = i * np.pi * (3 - np.sqrt(5))
    d = w + radius[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(w, u))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True), dtype=np.float32)


def _sphere(count: int) -> Floats:
    """Evenly spread directions (Fibonacci), (count, 3)."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    turn = i * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1).astype(np.float32)


def _blocked(
    scene: RayScene, start: Floats, rays: Floats, wanted: NDArray[np.bool_], reach_mm: float
) -> Floats:
    """How much each ray (N, M) is blocked: 1 near, falling to 0 at the reach."""
    found = np.zeros(wanted.shape, np.float32)
    row, ray = np.nonzero(wanted)
    if not len(row):
        return found
    t, *_ = scene.cast(start[row], rays[ray])
    if np.isinf(reach_mm):
        found[row, ray] = np.isfinite(t)
    else:
        found[row, ray] = np.clip(1 - np.minimum(t, reach_mm) / reach_mm, 0, 1) ** 0.8
    return found
