"""How much of the stage's light reaches a place: soft shadows and hollows, by rays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .raycast import RayScene
from .stage_lights import StageLights

Floats = NDArray[np.float32]

#: Numbers of rays to the key and rim light, over the sky (of the whole sphere) and for the eyes.
_FINE, _QUICK = (10, 4, 40, 14), (6, 2, 22, 8)
_SKY_REACH_MM, _EYE_REACH_MM = 70.0, 14.0
_EYE_SPREAD_RAD, _EYE_RAISE = 0.76, 0.64  # the eyes' rays: how wide, how far above the key light
_SHARP_RAD, _SHARP_RAYS = 0.08, 3  # narrower key lights cast shadows sharper than vertices lie
_GRAZING = 0.11  # cosine to a sharp light below which shadows fade
_OFFSET_MM = 0.25  # rays for shadows start this far off the surface
_THIN_MM = 3.0  # skin this thin lets 1/e of the red light through


class LightRays:
    """The stage's lights in the world, and rays towards them.

    Parameters
    ----------
    lights : StageLights
    world_from_stage : (3, 3) float64
        Rotation.
    quick : bool
        Fewer rays.

    Attributes
    ----------
    directions : (4, 3) float32, world axes
        Unit vectors towards the key, the fill and the rim light, and up.
    colours : (5, 3) float32, linear RGB
        Of the key, fill and rim light, of the sky and the ground.
    spreads : (3,) float32, rad
        Half angles of the key, fill and rim light.
    is_sharp : bool
        Whether shadows of the key light are to be traced for every sample, not every vertex.
    """

    def __init__(
        self, lights: StageLights, world_from_stage: NDArray[np.float64], *, quick: bool
    ) -> None:
        lamps = (lights.key, lights.fill, lights.rim)
        towards = [*(lamp.towards for lamp in lamps), np.eye(3)[1]]
        self.directions = np.stack([world_from_stage @ v for v in towards]).astype(np.float32)
        colours = [*(lamp.colour for lamp in lamps), lights.sky, lights.ground]
        self.colours = np.stack(colours).astype(np.float32)
        self.spreads = np.array([lamp.spread_rad for lamp in lamps], dtype=np.float32)
        self.is_sharp = lights.key.spread_rad < _SHARP_RAD
        n_key, n_rim, n_sky, n_eye = _QUICK if quick else _FINE
        count = _SHARP_RAYS if self.is_sharp else n_key
        self._key_rays = _cone(self.directions[0], lights.key.spread_rad, count)
        self._rim_rays = _cone(self.directions[2], lights.rim.spread_rad, n_rim)
        self._sky_rays = _sphere(n_sky)
        raised = self.directions[0] + _EYE_RAISE * self.directions[3]
        self._eye_rays = _cone(raised, _EYE_SPREAD_RAD, n_eye)

    def reaching(self, scene: RayScene, places: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """Shares of key and rim light (N, 2) and of sky (N,) that reach places on a surface.

        All of a sharp key light: its shadows are those of `reaching_sharply`.
        """
        lamps = np.ones((len(places), 2), np.float32)
        start = places + _OFFSET_MM * normals
        for lamp, rays in enumerate((self._key_rays, self._rim_rays)):
            if lamp == 0 and self.is_sharp:
                continue
            facing = normals @ rays.T > -0.25
            blocked = _blocked(scene, start, rays, facing, np.inf)
            lamps[:, lamp] = 1 - blocked.sum(axis=1) / np.maximum(facing.sum(axis=1), 1)
        cosine = np.clip(normals @ self._sky_rays.T, 0, None)
        blocked = _blocked(scene, start, self._sky_rays, cosine > 0.05, _SKY_REACH_MM)
        sky = 1 - (blocked * cosine).sum(axis=1) / np.maximum(cosine.sum(axis=1), 1e-6)
        return lamps, sky.astype(np.float32)

    def reaching_sharply(self, scene: RayScene, places: Floats, normals: Floats) -> Floats:
        """Share of the key light (N,) that reaches places on a surface."""
        cosine = normals @ self.directions[0]
        # where light only grazes, facets would shade each other: the cosine darkens there
        certain = np.clip(cosine / _GRAZING, 0, 1)
        wanted = np.repeat(certain[:, None] > 0, len(self._key_rays), axis=1)
        start = places + _OFFSET_MM * normals
        blocked = _blocked(scene, start, self._key_rays, wanted, np.inf)
        return np.asarray(1 - certain * blocked.mean(axis=1), dtype=np.float32)

    def reaching_eyes(self, scene: RayScene, places: Floats, normals: Floats) -> Floats:
        """Openness (N,) of places on the eyeballs to the light, dimmed near the lids."""
        start = (places + 0.1 * normals).astype(np.float32)
        facing = np.ones((len(start), len(self._eye_rays)), bool)
        blocked = _blocked(scene, start, self._eye_rays, facing, _EYE_REACH_MM)
        return np.asarray(1 - blocked.mean(axis=1), dtype=np.float32)

    def through(
        self, scene: RayScene, places: Floats, normals: Floats, thickness_mm: Floats
    ) -> Floats:
        """Light (N, 3) that comes through thin skin, ears and nostrils, from its far side."""
        found = np.zeros((len(places), 3), np.float32)
        start = places - (thickness_mm + 2 * _OFFSET_MM)[:, None] * normals
        share = np.exp(-thickness_mm / _THIN_MM)
        for lamp in (0, 2):
            towards = self.directions[lamp]
            cosine = np.clip(-(normals @ towards), 0, None)
            blocked = _blocked(scene, start, towards[None], cosine[:, None] > 0.05, np.inf)[:, 0]
            found += (share * cosine * (1 - blocked))[:, None] * self.colours[lamp]
        return found


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
