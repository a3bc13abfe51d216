"""Sub-pixel centres of dots, and how sure they are.

A dot is a connected component above a level half-way between skin and dot. Its centre is that of a
slanted, blurred disc (from Gaussian to sharp) on sloping skin, fitted to its pixels by least
squares (`spot_fit`): it is not biased by the pixel grid, the skin's shading or clipping, and as
precise as the noise allows. Dots that touch are parted. How sure a centre is follows from what the
fits leave over (`spot_noise`); a dot that something hides in part is known to be unsure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.errors import InputError
from .spot_components import fit_components
from .spot_fit import AMP, BACK, SHARP, WXX, WXY, WYY
from .spot_noise import spot_covariances
from .spot_profiles import profile_table
from .spot_scan import scan
from .spot_windows import CLIPPED, S_AREA

MAX_BLOBS = 4096  # in one picture; more is not a marker take
#: `BlobSettings.weights` and `.offset` of luma for markers brighter, and darker, than the skin.
BRIGHT: tuple[tuple[float, ...], float] = ((1.0,), 0.0)
DARK: tuple[tuple[float, ...], float] = ((-1.0,), 255.0)
_SURROUNDINGS, _EVERY = 0.97, 16  # quantile of every so many pixels each way
_LEVEL_SHARE = 0.38  # below one half: dots seen at a slant cover their pixels only in part


@dataclass(frozen=True)
class BlobSettings:
    """What counts as a dot.

    Attributes
    ----------
    level : float
        Grey level (luma) above which a pixel belongs to a dot.
    min_area_px, max_area_px : int
        Pixels above the level.
    clip : float
        A pixel at or above this level is overexposed: it says only that there is at least as much.
    weights, offset : floats
        What makes the markers shine: ``grey = offset + weights · channels``. One weight for luma,
        `BRIGHT` (1) or `DARK` (-1 and 255); three for RGB.
    background : float
        How bright the surroundings were (`background_level`) where the level was found. The level
        then follows that of each frame in proportion: light that flickers. NaN: it stays.
    """

    level: float
    min_area_px: int = 4
    max_area_px: int = 2500
    clip: float = 250.0
    weights: tuple[float, ...] = (1.0,)
    offset: float = 0.0
    background: float = float("nan")

    def __post_init__(self) -> None:
        if len(self.weights) not in (1, 3):
            raise ValueError(f"weights must be one (luma) or three (RGB), got {len(self.weights)}")

    @property
    def needs_colour(self) -> bool:
        """Whether pictures must be RGB."""
        return len(self.weights) == 3


@dataclass(frozen=True, eq=False)
class Blobs:
    """Dots in one picture.

    Attributes
    ----------
    centres : (N, 2) float64, px
    covariances : (N, 2, 2) float64, px²
        Of the centres, as far as one picture tells: sensor noise, coding's noise around the dot,
        and what hides a part of it.
    areas_px : (N,) float64
        Pixels above the level; of dots that touch, each an equal share.
    contrast : (N,) float64
        Grey levels of the dot's light above its background.
    background : (N,) float64
        Grey level of what is around it.
    shapes : (N, 2, 2) float64, px²
        Variance of the light about the centre: a disc's is a quarter of its squared half axes,
        blur added.
    sharpness : (N,) float64
        From 0, a Gaussian, to 1, a disc with a hard edge.
    noise : (N,) float64
        Standard deviation of a pixel in and around the dot, grey levels.
    is_clipped : (N,) bool
        Whether a part is overexposed.
    """

    centres: NDArray[np.float64]
    covariances: NDArray[np.float64]
    areas_px: NDArray[np.float64]
    contrast: NDArray[np.float64]
    background: NDArray[np.float64]
    shapes: NDArray[np.float64]
    sharpness: NDArray[np.float64]
    noise: NDArray[np.float64]
    is_clipped: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def sd_px(self) -> NDArray[np.float64]:
        """(N,) standard deviation to expect of each coordinate of a centre, px."""
        return np.asarray(np.sqrt((self.covariances[:, 0, 0] + self.covariances[:, 1, 1]) / 2))

    @property
    def half_axes_px(self) -> NDArray[np.float64]:
        """(N, 2) half axes, shorter first, of the ellipse that is blurred to the dot, px."""
        share = 1 - (1 - self.sharpness) ** 2
        return np.asarray(2 * np.sqrt(share[:, None] * np.linalg.eigvalsh(self.shapes)))


def find_level(image: NDArray[np.uint8]) -> float:
    """A level that parts bright dots from everything else.

    Dots cover little of the picture, so the skin is taken as its 99th percentile (the dark room
    does not count) and the dots as the mean of the brightest 200 pixels; the level lies a little
    below half-way.

    Parameters
    ----------
    image : (h, w) uint8

    Raises
    ------
    InputError
        If nothing stands out: the two are less than 40 levels apart.
    """
    counts = np.bincount(image.ravel(), minlength=256)
    levels = np.arange(256)
    above = np.cumsum(counts[::-1])[::-1]
    skin = float(levels[above >= 0.01 * image.size].max())
    n_brightest = min(200, image.size)
    # of the level that reaches past them only a part counts: saturated dots share the top level
    brightest = np.clip(n_brightest - (above - counts), 0, counts)
    dots = float((brightest * levels).sum() / n_brightest)
    if dots - skin < 40:
        raise InputError(
            f"no bright dots: the brightest pixels (level {dots:.0f}) hardly exceed the rest "
            f"(level {skin:.0f})"
        )
    return skin + _LEVEL_SHARE * (dots - skin)


def shining(image: NDArray[np.uint8], settings: BlobSettings) -> NDArray[np.uint8]:
    """The grey picture in which the markers shine.

    Parameters
    ----------
    image : (h, w) uint8 luma, or (h, w, 3) uint8 RGB as the settings' weights are one or three
    settings : BlobSettings

    Returns
    -------
    (h, w) uint8
        The picture itself where it shines already.

    Raises
    ------
    ValueError
        If the picture has not as many channels as there are weights.
    """
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels != len(settings.weights):
        raise ValueError(
            f"settings have {len(settings.weights)} weights, the picture {channels} channels"
        )
    if image.ndim == 2 and (settings.weights, settings.offset) == BRIGHT:
        return image
    if image.ndim == 2 and (settings.weights, settings.offset) == DARK:
        return np.invert(image)
    weights = np.array(settings.weights, dtype=np.float32)
    planes = image.reshape(*image.shape[:2], channels)
    return np.asarray(_projected(planes, weights, settings.offset), dtype=np.uint8)


@njit(cache=True, nogil=True, error_model="numpy")
def _projected(image, weights, offset):  # type: ignore[no-untyped-def]
    h, w, channels = image.shape
    out = np.empty((h, w), np.uint8)
    base = np.float32(offset + 0.5)
    for y in range(h):
        for x in range(w):
            grey = base
            for c in range(channels):
                grey += weights[c] * np.float32(image[y, x, c])
            out[y, x] = np.uint8(min(max(grey, np.float32(0)), np.float32(255)))
    return out


def background_level(image: NDArray[np.uint8]) -> float:
    """How bright what surrounds the markers is: the 97th percentile of a coarse sample.

    Markers cover less of a picture, and the skin more.

    Parameters
    ----------
    image : (h, w) uint8 luma, or (h, w, 3) uint8 RGB, of which green is looked at
    """
    sample = image[::_EVERY, ::_EVERY] if image.ndim == 2 else image[::_EVERY, ::_EVERY, 1]
    counts = np.bincount(sample.ravel(), minlength=256)
    above = np.cumsum(counts[::-1])[::-1]
    return float(np.flatnonzero(above >= (1 - _SURROUNDINGS) * counts.sum())[-1])


def level_of(image: NDArray[np.uint8], settings: BlobSettings) -> float:
    """The level for one picture, as filmed: that of the settings, or what follows the light."""
    if np.isnan(settings.background):
        return settings.level
    here = background_level(image)
    brighter = here / max(settings.background, 1.0)
    level = settings.offset + (settings.level - settings.offset) * brighter
    if settings.offset == 0:  # bright markers: overexposed, they have nowhere to go
        level = min(level, here + _LEVEL_SHARE * (255 - here))
    return float(np.clip(level, 1, 254))


def find_blobs(image: NDArray[np.uint8], settings: BlobSettings) -> Blobs:
    """All dots of a picture.

    Parameters
    ----------
    image : (h, w) uint8 luma, or (h, w, 3) uint8 RGB as the settings' weights are one or three
    settings : BlobSettings

    Raises
    ------
    InputError
        If there are more than 4096 components: the level is below the noise or the skin.
    """
    grey = shining(image, settings)
    level = level_of(image, settings)
    components, n = scan(grey, level, MAX_BLOBS)
    if n > MAX_BLOBS:
        raise InputError(
            f"more than {MAX_BLOBS} bright spots above level {level:.0f}: "
            "are these bright markers on a darker face?"
        )
    found = fit_components(
        grey, components, level, settings.min_area_px, settings.max_area_px,
        settings.clip, profile_table(),
    )  # fmt: skip
    variance = spot_covariances(found)
    det = found[:, WXX] * found[:, WYY] - found[:, WXY] ** 2
    return Blobs(
        centres=found[:, :2],
        covariances=_symmetric(variance[:, 0], variance[:, 1], variance[:, 2]),
        areas_px=found[:, S_AREA],
        contrast=found[:, AMP],
        background=found[:, BACK],
        shapes=_symmetric(found[:, WYY] / det, -found[:, WXY] / det, found[:, WXX] / det),
        sharpness=found[:, SHARP],
        noise=variance[:, 3],
        is_clipped=found[:, CLIPPED] > 0,
    )


def _symmetric(
    xx: NDArray[np.float64], xy: NDArray[np.float64], yy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 2, 2) of three (N,)."""
    matrices = np.empty((len(xx), 2, 2))
    matrices[:, 0, 0], matrices[:, 1, 1] = xx, yy
    matrices[:, 0, 1] = matrices[:, 1, 0] = xy
    return matrices
