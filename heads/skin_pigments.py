"""The colour of skin from two pigments: melanin above, haemoglobin below.

Bando (2003, eq. 2.6) writes the colour as ``c = b − m a_m − h a_h``: a base, less an amount of
each pigment times what a unit of it absorbs. We use the equation for optical densities (minus the
logarithm of what comes back), in which pigments add and no amount makes light negative, and let a
little light come back from the surface itself, unfiltered: so very dark skin is brown, not orange.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly

Floats = NDArray[np.float32]

#: b: density of bloodless skin without melanin in linear red, green and blue.
BASE_DENSITY = np.array([0.091, 0.240, 0.520], dtype=np.float32)
#: a_m: density of a unit of melanin. Falls with the wavelength as eumelanin's does; fitted with
#: `BASE_DENSITY` and `SURFACE_LIGHT` to photographed skin from very light to very dark.
MELANIN_DENSITY = np.array([0.90, 1.39, 1.87], dtype=np.float32)
#: a_h: density of a unit of haemoglobin: green and blue light, hardly red.
HAEMOGLOBIN_DENSITY = np.array([0.10, 0.62, 0.43], dtype=np.float32)
#: Share of the light that the surface sends back diffusely before any pigment.
SURFACE_LIGHT = 0.020
#: Mean amount of haemoglobin of a calm face.
CALM_HAEMOGLOBIN = 0.35
#: Amount of melanin by darkness from 0, very light skin, to 1, very dark skin, in even steps.
_MELANIN_BY_DARKNESS = (0.0, 0.15, 0.39, 0.80, 1.60, 2.90)


@dataclass(frozen=True, eq=False)
class SkinPigments:
    """Amounts of pigment over the skin's texture coordinates.

    Attributes
    ----------
    melanin, haemoglobin : (H, W) float32
        In units of `MELANIN_DENSITY` and `HAEMOGLOBIN_DENSITY`.
    """

    melanin: Floats
    haemoglobin: Floats

    def __post_init__(self) -> None:
        melanin = readonly(self.melanin, (None, None), "melanin", np.float32)
        wanted = melanin.shape
        haemoglobin = readonly(self.haemoglobin, wanted, "haemoglobin", np.float32)
        object.__setattr__(self, "melanin", melanin)
        object.__setattr__(self, "haemoglobin", haemoglobin)

    def albedo(self) -> Floats:
        """(H, W, 3) float32, linear RGB."""
        return skin_albedo(self.melanin, self.haemoglobin)


def skin_albedo(melanin: ArrayLike, haemoglobin: ArrayLike) -> Floats:
    """Albedo of skin.

    Parameters
    ----------
    melanin, haemoglobin : (...) float
        Amounts, as of `SkinPigments`.

    Returns
    -------
    (..., 3) float32, linear RGB, 0 to 1

    References
    ----------
    Bando 2003, eq. 2.6, on densities: see the module.

    Examples
    --------
    More melanin darkens all colours, more blood leaves red nearly alone:

    >>> light, dark = skin_albedo([0.2, 1.5], 0.35)
    >>> bool((dark < light).all())
    True
    >>> pale, flushed = skin_albedo(0.2, [0.2, 0.9])
    >>> [round(float(f / p), 2) for f, p in zip(flushed, pale)]
    [0.93, 0.66, 0.75]
    """
    m = np.asarray(melanin, dtype=np.float32)[..., None]
    h = np.asarray(haemoglobin, dtype=np.float32)[..., None]
    density = BASE_DENSITY + m * MELANIN_DENSITY + h * HAEMOGLOBIN_DENSITY
    surface = np.float32(SURFACE_LIGHT)
    return np.asarray(surface + (1 - surface) * np.exp(-density), dtype=np.float32)


def skin_pigments(albedo: ArrayLike) -> tuple[Floats, Floats]:
    """Amounts of pigment that come nearest to an albedo: the inverse of `skin_albedo`.

    Nearest in density, by least squares over red, green and blue. What is no skin (a blue shirt)
    gives amounts that no skin has, also below 0.

    Parameters
    ----------
    albedo : (..., 3) float, linear RGB
        At or below `SURFACE_LIGHT` it is taken as just above.

    Returns
    -------
    (...) float32
        Melanin.
    (...) float32
        Haemoglobin.
    """
    c = np.asarray(albedo, dtype=np.float64)
    if c.shape[-1:] != (3,):
        raise ValueError(f"albedo must have shape (..., 3), got {c.shape}")
    inner = np.clip((c - SURFACE_LIGHT) / (1 - SURFACE_LIGHT), 1e-4, None)
    over = -np.log(inner) - BASE_DENSITY
    columns = np.stack([MELANIN_DENSITY, HAEMOGLOBIN_DENSITY], axis=1).astype(np.float64)
    found = over @ np.linalg.pinv(columns).T
    return found[..., 0].astype(np.float32), found[..., 1].astype(np.float32)


def melanin_of_darkness(darkness: ArrayLike) -> NDArray[np.float64]:
    """Amount of melanin of skin from 0, very light, to 1, very dark (even steps to the eye)."""
    steps = np.linspace(0, 1, len(_MELANIN_BY_DARKNESS))
    return np.asarray(
        np.interp(np.asarray(darkness), steps, _MELANIN_BY_DARKNESS), dtype=np.float64
    )
