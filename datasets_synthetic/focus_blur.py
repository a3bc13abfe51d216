"""Focus blur of a rendered layer by the depth of its pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from .image_motion import in_threads
from .optics import Optics

Floats = NDArray[np.float32]

_FOCUS_SIGMAS_PX = (0.7, 1.4, 2.8, 5.6, 11.0)


def blur_by_depth(
    light: Floats, cover: Floats, depth_mm: Floats, optics: Optics, focal_px: float
) -> tuple[Floats, Floats]:
    """Focus blur of a layer whose pixels lie at known depths.

    The disc of confusion is taken as a Gaussian of the same variance (a sixteenth of the
    diameter's square along each axis), interpolated between a few blurred copies.

    Parameters
    ----------
    light : (h, w, 3) float32, premultiplied; cover : (h, w) float32
    depth_mm : (h, w) float32
        NaN where nothing is.
    optics : Optics
    focal_px : float
    """
    known = np.isfinite(depth_mm)
    if optics.pupil_mm == 0 or not known.any():
        return light, cover
    near, far = float(depth_mm[known].min()), float(depth_mm[known].max())
    scale = focal_px * optics.pupil_mm / 4
    most = scale * max(abs(1 / d - 1 / optics.focus_mm) for d in (near, far))
    levels = [0.0, *(s for s in _FOCUS_SIGMAS_PX if s / 2 < most)]
    if len(levels) == 1:
        return light, cover
    depth = np.where(known, depth_mm, np.float32((near + far) / 2))
    depth = cv2.blur(depth, (5, 5))
    layer = np.concatenate([light, cover[..., None]], axis=2)
    stack = [layer]
    for high in levels[1:]:
        stack.append(cv2.GaussianBlur(layer, (0, 0), high, borderType=cv2.BORDER_REPLICATE))
    found = np.empty_like(layer)
    sigmas = np.array(levels, np.float32)
    in_threads(
        _focus,
        (np.stack(stack), sigmas, depth, np.float32(scale), np.float32(optics.focus_mm), found),
        len(layer),
    )
    return np.ascontiguousarray(found[..., :3]), np.ascontiguousarray(found[..., 3])


@njit(cache=True, nogil=True)
def _focus(stack, sigmas, depth, scale, focus, out, first, last):  # type: ignore[no-untyped-def]
    """Mix blurred copies so that variances agree."""
    top = len(sigmas) - 1
    for y in range(first, last):
        for x in range(depth.shape[1]):
            sigma = scale * abs(1 / depth[y, x] - 1 / focus)
            k = 0
            while k < top - 1 and sigmas[k + 1] < sigma:
                k += 1
            low, high = sigmas[k] * sigmas[k], sigmas[k + 1] * sigmas[k + 1]
            share = min(max((sigma * sigma - low) / (high - low), np.float32(0)), np.float32(1))
            for c in range(4):
                a, b = stack[k, y, x, c], stack[k + 1, y, x, c]
                out[y, x, c] = a + share * (b - a)
