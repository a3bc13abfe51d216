"""What the renderer is given besides a head, and what it returns: linear light, to be exposed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .raycast import NO_HIT

Floats = NDArray[np.float32]

_SHOULDER = 0.5  # of white: light above is compressed


@dataclass(frozen=True, eq=False)
class ExtraMesh:
    """Something drawn beside the head, in the same light: shoulders, a hand, strands of hair.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        In the frame that `frame` names.
    triangles : (F, 3) int32
        Both sides are drawn.
    colour : (V, 3) float32, linear RGB, 0 to 1
        Albedo.
    frame : "world" or "head"
    roughness : float
        0 mirror to 1 matt.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    colour: NDArray[np.float32]
    frame: Literal["world", "head"] = "world"
    roughness: float = 0.85

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        v = readonly(self.vertices, (None, 3), "vertices")
        if not np.isfinite(v).all():
            raise ValueError("vertices of an extra mesh must be finite")
        triangles = readonly(self.triangles, (None, 3), "triangles", np.int32)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(v):
            raise ValueError(f"triangles of an extra mesh must index its {len(v)} vertices")
        colour = readonly(self.colour, (len(v), 3), "colour", np.float32)
        if not ((colour >= 0) & (colour <= 1)).all():
            raise ValueError("colour of an extra mesh must lie in 0..1")
        if self.frame not in ("world", "head"):
            raise ValueError(f'frame must be "world" or "head", not {self.frame!r}')
        if not 0 < self.roughness <= 1:
            raise ValueError(f"roughness must lie in 0..1 and be above 0, got {self.roughness}")
        set_field(self, "vertices", v)
        set_field(self, "triangles", triangles)
        set_field(self, "colour", colour)


@dataclass(frozen=True, eq=False)
class Layers:
    """A head's picture in linear light over the box of pixels that it may touch.

    Attributes
    ----------
    light : (h, w, 3) float32, linear RGB
        Premultiplied by `cover`; 1 is white, glints pass it.
    cover : (h, w) float32, 0 to 1
    triangle : (h, w) uint32
        At the first sample of each pixel (its centre if there is one sample), or `NO_HIT`. From
        the head's number of triangles on, they count through the extra meshes in their order.
        What lies behind the lashes is seen through them.
    weights : (h, w, 2) float32
        Barycentric weights of the triangle's second and third corner there.
    box : (x0, y0, x1, y1) int, px
        Columns x0 to x1 and rows y0 to y1 of the picture, ends excluded; all 0 where nothing is
        in view.
    """

    light: Floats
    cover: Floats
    triangle: NDArray[np.uint32]
    weights: Floats
    box: tuple[int, int, int, int]

    @classmethod
    def empty(cls) -> Layers:
        """Of a picture in which nothing is seen."""
        return cls(
            np.zeros((0, 0, 3), np.float32),
            np.zeros((0, 0), np.float32),
            np.full((0, 0), NO_HIT, np.uint32),
            np.zeros((0, 0, 2), np.float32),
            (0, 0, 0, 0),
        )

    def over(self, behind: Floats) -> Floats:
        """These layers before a background.

        Parameters
        ----------
        behind : (H, W, 3) float32, linear RGB
            Of the whole picture.

        Returns
        -------
        (H, W, 3) float32, linear RGB
        """
        found = np.array(behind, dtype=np.float32)
        x0, y0, x1, y1 = self.box
        found[y0:y1, x0:x1] *= (1 - self.cover)[..., None]
        found[y0:y1, x0:x1] += self.light
        return found


def film_curve(light: Floats) -> Floats:
    """Light as a picture shows it: as it is up to the half of white, then ever less, below white.

    Parameters
    ----------
    light : (...) float32, linear
        Not premultiplied.
    """
    over = np.maximum(light - np.float32(_SHOULDER), 0)
    room = np.float32(1 - _SHOULDER)
    return np.asarray(light - over + room * -np.expm1(-over / room), dtype=np.float32)
