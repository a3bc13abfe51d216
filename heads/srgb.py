"""sRGB, in which pictures are stored, and linear light, in which they are mixed (IEC 61966-2-1)."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray


def linear_from_srgb(colour: NDArray[Any]) -> NDArray[Any]:
    """Linear light 0 to 1 of sRGB 0 to 255."""
    c = np.asarray(colour, dtype=np.float32) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(light: NDArray[np.float32], *, n_levels: int = 4096) -> NDArray[np.uint8]:
    """sRGB 0 to 255 of linear light; below 0 is black, above 1 white.

    Parameters
    ----------
    light : (...) float32
    n_levels : int
        Of light told apart, evenly from 0 to 1.

    Returns
    -------
    (...) uint8
    """
    top = n_levels - 1
    nearest = np.clip(light * top + 0.5, 0, top).astype(np.int32)
    return np.asarray(_srgb_levels(n_levels)[nearest])


@cache
def _srgb_levels(n_levels: int) -> NDArray[np.uint8]:
    """sRGB of `n_levels` of linear light from 0 to 1."""
    grid = np.arange(n_levels) / (n_levels - 1)
    c = np.where(grid <= 0.0031308, grid * 12.92, 1.055 * grid ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(c * 255), dtype=np.uint8)
