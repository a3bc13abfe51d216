"""What makes the markers shine in this footage: polarity, colour, level; found from the footage.

A level is right if many spots like markers stand out at it: of a few levels and ways to make a
grey picture (as it is, inverted, the colour of the markers against that of the skin), the one is
taken at which most spots are found that a marker's profile fits, alike in size and light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from .blobs import (
    BRIGHT,
    DARK,
    MAX_BLOBS,
    Blobs,
    BlobSettings,
    background_level,
    find_blobs,
    shining,
)
from .spot_scan import AREA, scan

#: What marker colours are called, as RGB.
COLOURS: dict[str, tuple[float, float, float]] = {
    "white": (255, 255, 255),
    "black": (0, 0, 0),
    "red": (230, 30, 30),
    "green": (30, 200, 60),
    "blue": (30, 60, 220),
    "yellow": (240, 220, 30),
    "cyan": (30, 210, 220),
    "magenta": (220, 40, 200),
    "orange": (240, 130, 20),
}
_TRIED = ("white", "black", "blue", "green", "red", "yellow", "cyan", "magenta")
_LOOKED_AT = 7  # frames, spread over those given
_LEVELS = np.arange(24, 244, 12)
_MIN_SPOTS, _MANY, _ENOUGH = 3, 400, 0.9
_LEVEL_SHARE = 0.38  # of the levels that will do: low, for dots seen at a slant
_MIN_CONTRAST, _MIN_SNR = 14.0, 7.0
_ALIKE = 3.5  # factor within which areas and contrasts lie about their medians
_STEADY = 0.06  # light that varies less needs no following
_SKIN, _PURE = 40.0, 200.0  # grey levels that a colour projection gives to skin and to the colour
_SKIN_SHARE = 0.25  # of the picture's brightest pixels, whose median is taken for skin


def find_settings(
    images: Sequence[NDArray[np.uint8]], *, colour: str | None = None
) -> BlobSettings:
    """Settings for footage of which some frames are given.

    Parameters
    ----------
    images : sequence of (h, w) or (h, w, 3) uint8
        Frames spread over the take, luma or RGB; some may be too bright or too dark, or without
        markers. Up to 7 are looked at. Of luma only bright and dark markers can be found.
    colour : str, optional
        One of `COLOURS`, where the marker set says so; by default the colour is found too, and
        grey pictures are preferred: they decode faster.

    Raises
    ------
    InputError
        If nothing like markers is found in half of the frames, or the colour is not known.
    """
    if not len(images):
        raise InputError("no frames to find the markers' settings from")
    if colour is not None and colour not in COLOURS:
        raise InputError(f"marker colour {colour}: expected one of {', '.join(COLOURS)}")
    every = np.linspace(0, len(images) - 1, min(_LOOKED_AT, len(images))).round().astype(int)
    frames = [images[i] for i in sorted(set(every.tolist()))]
    best: tuple[float, BlobSettings] | None = None
    for name in (colour,) if colour is not None else _TRIED:
        if frames[0].ndim == 2 and name not in ("white", "black"):
            if colour is not None:
                raise InputError(f"{name} markers cannot be told in grey pictures: decode colour")
            continue
        found = _settings_for(frames, name)
        # a further colour must be clearly better: grey is faster, and sharper in 4:2:0 video
        if found is not None and (best is None or found[0] > 1.3 * best[0]):
            best = found
    if best is None:
        said = f"{colour} markers" if colour else "markers"
        raise InputError(
            f"no {said} found: in most of the {len(frames)} frames looked at, nothing like "
            f"{_MIN_SPOTS} spots of one kind stands out of its surroundings (give the level by "
            "hand if they are there)"
        )
    return best[1]


def projection(
    image: NDArray[np.uint8], colour: tuple[float, float, float]
) -> tuple[tuple[float, ...], float]:
    """Weights of R, G and B, and an offset, that make a colour shine against skin.

    The weights point from the skin's colour to the marker's, brightness left out where the two
    differ in hue: shading then hardly shows. Skin is taken for the median of the brightest quarter
    of the picture. It comes to 40, and the markers' colour, if pure, to 200.

    Parameters
    ----------
    image : (h, w, 3) uint8, RGB
    colour : (r, g, b), 0 to 255
    """
    pixels = image[::4, ::4].reshape(-1, 3).astype(np.float64)
    bright = pixels.sum(axis=1)
    skin = np.median(pixels[bright >= np.quantile(bright, 1 - _SKIN_SHARE)], axis=0)
    along = skin / max(np.linalg.norm(skin), 1e-9)  # shading scales the skin's colour
    direction = np.asarray(colour) - skin
    chroma = direction - (direction @ along) * along
    if np.linalg.norm(chroma) < 40:
        raise InputError("the markers' colour is too near to the skin's to tell them apart")
    weights = (_PURE - _SKIN) * chroma / float(chroma @ chroma)
    return tuple(float(w) for w in weights), float(_SKIN - weights @ skin)


def _settings_for(
    frames: Sequence[NDArray[np.uint8]], name: str
) -> tuple[float, BlobSettings] | None:
    """Median number of markers over the frames and the settings that find them."""
    try:
        ways = [_way(image, name) for image in frames]
    except InputError:
        return None
    weights = tuple(np.median([w for w, _ in ways], axis=0).tolist())
    offset = float(np.median([o for _, o in ways]))
    base = BlobSettings(0.0, weights=weights, offset=offset)
    counts, levels, lights = [], [], []
    for image in frames:
        n, level = _best_level(shining(image, base))
        counts.append(n)
        if n >= _MIN_SPOTS:
            levels.append(level)
            lights.append(background_level(image))
    usual = float(np.median(counts))
    if usual < _MIN_SPOTS:
        return None
    light = float(np.median(lights))
    if np.ptp(lights) <= _STEADY * light:
        return usual, replace(base, level=float(np.median(levels)))
    brighter = np.maximum(lights, 1.0) / max(light, 1.0)
    level = offset + float(np.median((np.array(levels) - offset) / brighter))
    return usual, replace(base, level=level, background=light)


def _way(image: NDArray[np.uint8], name: str) -> tuple[tuple[float, ...], float]:
    if name in ("white", "black"):
        weights, offset = BRIGHT if name == "white" else DARK
        if image.ndim == 3:  # BT.709 luma of full range
            weights = tuple(weights[0] * w for w in (0.2126, 0.7152, 0.0722))
        return weights, offset
    return projection(image, COLOURS[name])


def _best_level(grey: NDArray[np.uint8]) -> tuple[int, float]:
    """Most spots like markers at any level, and a middle level of those that show most of them."""
    counts = np.zeros(len(_LEVELS))
    for i, level in enumerate(_LEVELS):
        settings = BlobSettings(float(level))
        components, n = scan(grey, settings.level, MAX_BLOBS)
        n_large = int((components[:, AREA] >= settings.min_area_px).sum())
        if n <= MAX_BLOBS and n_large <= _MANY:  # else the level is in the noise
            counts[i] = _like_markers(find_blobs(grey, settings))
    best = int(counts.argmax())
    nearly = counts >= _ENOUGH * counts[best]
    low, high = best, best
    while low > 0 and nearly[low - 1]:
        low -= 1
    while high + 1 < len(nearly) and nearly[high + 1]:
        high += 1
    level = _LEVELS[low] + _LEVEL_SHARE * (_LEVELS[high] - _LEVELS[low])
    return int(counts[best]), float(level)


def _like_markers(blobs: Blobs) -> int:
    """How many spots stand out of the noise, fit the profile, and are alike."""
    clear = (blobs.contrast > _MIN_CONTRAST) & (blobs.contrast > _MIN_SNR * blobs.noise)
    if clear.sum() < _MIN_SPOTS:
        return 0
    alike = np.ones(int(clear.sum()), bool)
    for values in (blobs.areas_px[clear], blobs.contrast[clear]):
        ratio = values / np.median(values)
        alike &= (ratio < _ALIKE) & (ratio > 1 / _ALIKE)
    # what is not like a marker counts against the level: hair, teeth, highlights
    return max(int(alike.sum()) - (len(blobs) - int(alike.sum())), 0)
