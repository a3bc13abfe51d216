"""What a head looks like: textures, and the coordinates that lay them on its mesh.

Textures are painted in `skin_paint`, `hair_paint`, `brow_paint`, `eye_paint` and `detail_paint`.
Colours are functions of the place on the template at rest, so that they stick under every identity
and expression. Sizes there are millimetres on the template, colours sRGB 0 to 255 unless named
otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .appearance_traits import AppearanceTraits, Rgb
from .detail_paint import paint_details
from .eye_paint import paint_eye
from .skin_paint import SKIN_PX, paint_skin
from .template import Template
from .texture_layout import appearance_uv

_SMALLEST_PX = 256


@dataclass(frozen=True, eq=False)
class Appearance:
    """Textures of a head and the coordinates that lay them on.

    Attributes
    ----------
    skin : (H, W, 3) uint8, sRGB
        Albedo of the skin, with brows and hair, lips and the inside of the mouth.
    roughness : (H, W) uint8 or None
        Of the skin, 0 mirror to 255 matt, over the same coordinates.
    eye : (H, W, 3) uint8, sRGB, or None
        The eyeball seen along its axis: iris in the middle. Both eyes share it.
    details : (H, W, 4) uint8, sRGB and alpha, or None
        Teeth, tongue and lashes; only the lashes are not opaque.
    normal : (H, W, 3) uint8 or None
        Fine relief of the skin over the same coordinates: a map of unit normals in the frame of
        the tangents as glTF has it (red to the right in the picture, green up, blue out of the
        skin; 128 is 0).
    uv : (U, 2) float64 in [0, 1], or None
        Replaces the rows of the mesh's `uv`: origin at the bottom left, each row within the
        texture of the part that uses it. None: the mesh's own, with `skin` on all parts.
    """

    skin: NDArray[np.uint8]
    roughness: NDArray[np.uint8] | None = None
    eye: NDArray[np.uint8] | None = None
    details: NDArray[np.uint8] | None = None
    uv: NDArray[np.float64] | None = None
    normal: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "skin", readonly(self.skin, (None, None, 3), "skin", np.uint8))
        if self.roughness is not None:
            r = readonly(self.roughness, (None, None), "roughness", np.uint8)
            set_field(self, "roughness", r)
        if self.eye is not None:
            set_field(self, "eye", readonly(self.eye, (None, None, 3), "eye", np.uint8))
        if self.details is not None:
            d = readonly(self.details, (None, None, 4), "details", np.uint8)
            set_field(self, "details", d)
        if self.normal is not None:
            n = readonly(self.normal, (None, None, 3), "normal", np.uint8)
            set_field(self, "normal", n)
        if self.uv is not None:
            set_field(self, "uv", readonly(self.uv, (None, 2), "uv"))

    def texture_of(self, part: str) -> NDArray[np.uint8]:
        """The texture that a part of the mesh uses."""
        if part.startswith("eye_") and self.eye is not None:
            return self.eye
        if part in ("lashes", "teeth_upper", "teeth_lower", "tongue") and self.details is not None:
            return self.details
        return self.skin

    def mean_skin(self) -> Rgb:
        """Mean sRGB of the skin's texture, for what can show one colour only."""
        r, g, b = self.skin.reshape(-1, 3).mean(axis=0)
        return float(r), float(g), float(b)


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """A grey, RGB or RGBA picture as a PNG file."""
    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])


def jpeg_bytes(image: NDArray[np.uint8], *, quality: int = 88) -> bytes:
    """A grey or RGB picture as a JPEG file."""
    return _encoded(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encoded(kind: str, image: NDArray[np.uint8], options: list[int]) -> bytes:
    order = {3: [2, 1, 0], 4: [2, 1, 0, 3]}
    swapped = image if image.ndim == 2 else image[..., order[image.shape[2]]]
    done, data = cv2.imencode(kind, np.ascontiguousarray(swapped), options)
    assert done, "OpenCV encodes every uint8 picture"
    return bytes(data)


@lru_cache(maxsize=6)
def make_appearance(
    template: Template, traits: AppearanceTraits, *, size: int = SKIN_PX
) -> Appearance:
    """Paint a person's textures (the last few are kept).

    The same traits give the same bytes.

    Parameters
    ----------
    template : Template
    traits : AppearanceTraits
    size : int, px
        Of the skin's maps, at least 256. 2048 takes about a second; 1024 a third of it, and is
        enough for faces of up to 400 pixels.
    """
    if size < _SMALLEST_PX:
        raise ValueError(f"size must be at least {_SMALLEST_PX}, got {size}")
    rng = np.random.default_rng(traits.seed)
    skin = paint_skin(template, traits, size=size)
    return Appearance(
        skin=skin.albedo,
        roughness=skin.roughness,
        normal=skin.normal,
        eye=paint_eye(traits, rng),
        details=paint_details(traits, rng),
        uv=appearance_uv(template),
    )
