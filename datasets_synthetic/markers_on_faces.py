"""What is glued on a face, or shines beside it, and what else stands in the room."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.mesh import SurfacePoints
from .optics import Flash

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

STICKER_MM = 0.2  # thickness of a dot: its face lies this far above the skin
SPHERE_BASE_MM = 0.5  # between the skin and a sphere
#: Linear light at gain 1: grey levels 7, 46, 205 of 255.
BACKGROUND_LIGHT, SKIN_LIGHT, DOT_LIGHT = 7 / 255, 46 / 255, 205 / 255
SPHERE_LIGHT = 0.9
OCCLUDER_LIGHT = 38 / 255
_KINDS = ("dots", "spheres")


@dataclass(frozen=True, eq=False)
class GluedMarkers:
    """What is glued on a face.

    Attributes
    ----------
    glue : SurfacePoints
        Names and places on the head's mesh.
    kind : str
        ``"dots"``, flat discs; or ``"spheres"``, retro-reflective balls.
    radius_mm : (M,) float64
    light : (M,) float64
        Linear light of each marker's picture, of saturation at gain 1; of dots, seen from straight
        ahead.
    """

    glue: SurfacePoints
    kind: str
    radius_mm: Floats
    light: Floats

    def __post_init__(self) -> None:
        n = len(self.glue)
        if self.kind not in _KINDS:
            raise ValueError(f"kind must be one of {', '.join(_KINDS)}, got {self.kind}")
        for name in ("radius_mm", "light"):
            value = np.broadcast_to(np.asarray(getattr(self, name), dtype=np.float64), (n,))
            object.__setattr__(self, name, readonly(value, (n,), name))
        if not (self.radius_mm > 0).all():
            raise ValueError("radius_mm must lie above 0")

    def __len__(self) -> int:
        return len(self.glue)

    @property
    def stand_off_mm(self) -> Floats:
        """(M,) how far the centres lie above the skin."""
        if self.kind == "dots":
            return np.full(len(self), STICKER_MM)
        return self.radius_mm + SPHERE_BASE_MM

    def places(self, vertices: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """Centres and unit normals of the markers, both (M, 3), in the vertices' frame.

        Parameters
        ----------
        vertices : (V, 3) float, mm
        normals : (V, 3) float
            `vertex_normals` of them.
        """
        n = self.glue.at(normals)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        return self.glue.at(vertices) + self.stand_off_mm[:, None] * n, n


@dataclass(frozen=True, eq=False)
class Lights:
    """Bright spheres that belong to nobody: a wand's, or what else shines.

    Attributes
    ----------
    centres : (K, 3) float64, mm, world
    radius_mm : (K,) float64
    light : (K,) float64
        Linear, of saturation at gain 1.
    """

    centres: Floats
    radius_mm: Floats
    light: Floats

    def __post_init__(self) -> None:
        centres = readonly(self.centres, (None, 3), "centres")
        object.__setattr__(self, "centres", centres)
        for name in ("radius_mm", "light"):
            value = np.broadcast_to(np.asarray(getattr(self, name)), (len(centres),))
            object.__setattr__(self, name, readonly(value, (len(centres),), name))


@dataclass(frozen=True, eq=False)
class Room:
    """What is around the actor.

    Attributes
    ----------
    background, skin : float
        Linear light of the dark room, and of skin that faces the lamp.
    backdrops : mapping from camera name to (h, w) float32
        Linear light behind everything, in place of `background`.
    occluder : callable or None
        From a time, s, to the vertices (V, 3), mm, world, and triangles (F, 3) of what stands
        around (a hand, hair), or None for nothing. Always the same number of vertices.
    occluder_light : float
        Linear light of it, where it faces the lamp.
    lights : callable or None
        From a time, s, to `Lights`; always the same number.
    flash : Flash or None
    """

    background: float = BACKGROUND_LIGHT
    skin: float = SKIN_LIGHT
    backdrops: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    occluder: Callable[[float], tuple[Floats, Triangles] | None] | None = None
    occluder_light: float = OCCLUDER_LIGHT
    lights: Callable[[float], Lights] | None = None
    flash: Flash | None = None

    def __post_init__(self) -> None:
        backdrops = {
            name: readonly(picture, (None, None), f"backdrop of {name}", np.float32)
            for name, picture in self.backdrops.items()
        }
        object.__setattr__(self, "backdrops", MappingProxyType(backdrops))
