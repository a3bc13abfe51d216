"""What a lens does to the light of a picture: blur, darker corners, reflections within."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from .optics import Optics

#: Ghosts are out of focus.
GHOST_BLUR_PX = 2.5
_LEAST_PSF_PX = 0.02


def apply_lens_light(
    light: NDArray[np.float32], optics: Optics, camera: Camera, *, psf: bool = True
) -> NDArray[np.float32]:
    """A picture as the lens makes it: Gaussian blur, ghosts, vignetting, in this order.

    Parameters
    ----------
    light : (h, w) or (h, w, 3) float32, linear
        Not changed.
    optics : Optics
    camera : Camera
        Whose picture it is.
    psf : bool
        False where `light` is blurred already.

    Returns
    -------
    float32, shaped as `light`
        May be `light` itself where the lens is ideal.
    """
    import cv2

    width, height = camera.image_size
    if light.shape[:2] != (height, width):
        raise ValueError(f"light must be ({height}, {width}[, 3]), got {light.shape}")
    found = light
    if psf and optics.psf_px > _LEAST_PSF_PX:
        found = np.asarray(cv2.GaussianBlur(found, (0, 0), optics.psf_px))
    if optics.ghost > 0:
        found = found + _ghost(found, optics.ghost, camera)
    if optics.vignetting > 0:
        cx, cy = (float(c) for c in camera.matrix[:2, 2])
        kept = _vignetting(width, height, cx, cy, optics.vignetting)
        found = found * (kept if light.ndim == 2 else kept[..., None])
    return np.asarray(found, dtype=np.float32)


def kept_light(optics: Optics, camera: Camera, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the light that vignetting leaves at pixels (..., 2): (...)."""
    centre = camera.matrix[:2, 2]
    farthest2 = _farthest2(*camera.image_size, float(centre[0]), float(centre[1]))
    return np.asarray(1 - optics.vignetting * ((pixels - centre) ** 2).sum(axis=-1) / farthest2)


def kept_light_slope(
    optics: Optics, camera: Camera, pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Its gradient, (..., 2) per px."""
    centre = camera.matrix[:2, 2]
    farthest2 = _farthest2(*camera.image_size, float(centre[0]), float(centre[1]))
    return np.asarray(-2 * optics.vignetting * (pixels - centre) / farthest2)


def _farthest2(width: int, height: int, cx: float, cy: float) -> float:
    """Square of the distance from the principal point to the farthest corner."""
    return float(max(cx, width - 1 - cx) ** 2 + max(cy, height - 1 - cy) ** 2)


@lru_cache(maxsize=16)
def _vignetting(width: int, height: int, cx: float, cy: float, lost: float) -> NDArray[np.float32]:
    x2 = (np.arange(width) - cx) ** 2
    y2 = (np.arange(height) - cy) ** 2
    kept = 1 - lost / _farthest2(width, height, cx, cy) * (y2[:, None] + x2)
    found = kept.astype(np.float32)
    found.flags.writeable = False
    return found


def _ghost(light: NDArray[np.float32], share: float, camera: Camera) -> NDArray[np.float32]:
    """The picture mirrored through the principal point, dim and out of focus."""
    import cv2

    cx, cy = camera.matrix[:2, 2]
    mirror = np.array([[-1.0, 0, 2 * cx], [0, -1.0, 2 * cy]])
    turned = cv2.warpAffine(
        light, mirror, camera.image_size, flags=cv2.INTER_LINEAR, borderValue=0.0
    )
    return np.asarray(cv2.GaussianBlur(turned, (0, 0), GHOST_BLUR_PX) * np.float32(share))
