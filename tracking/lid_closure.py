"""Blinks close eyes: how far a person's lids are followed, told by the clip itself.

Landmarks follow lids by less than they move, by another share for each person. A blink is known to
end with the lids together, so its height tells the share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from ..core.clip import Clip

Floats = NDArray[np.float64]

#: FAPs of an eye that add up to its opening, which is their unit, in its 1024ths.
_LIDS = {
    "left": ("close_t_l_eyelid", "close_b_l_eyelid"),
    "right": ("close_t_r_eyelid", "close_b_r_eyelid"),
}
_FULL = 1024.0
#: A closing that reaches this share of the opening and has half its height for no longer is a
#: blink; a longer one may be a squint or a look down.
_LEAST_SHARE, _LONGEST_S = 0.5, 0.4
_GAINS = (0.85, 1.6)
_WEIGHT_GAINS = (1.0, 2.2)


@dataclass(frozen=True, eq=False)
class Blinks:
    """Blinks of a clip: frames (n,) of greatest closing of both eyes together, and its median
    height, (2,) left and right, over the opening."""

    frames: NDArray[np.int64]
    heights: Floats


def find_blinks(faps: Clip) -> Blinks:
    """Blinks of both eyes.

    Parameters
    ----------
    faps : Clip
        With the four FAPs of the lids.
    """
    closed = np.stack([faps[a] + faps[b] for a, b in _LIDS.values()]) / _FULL
    both = np.nan_to_num(closed.min(axis=0))
    step = float(np.median(np.diff(faps.time_s))) if len(faps.time_s) > 1 else 1.0
    longest = max(1.0, _LONGEST_S / step)
    padded = np.pad(both, 1)  # a clip may begin or end in a blink
    peaks, _ = find_peaks(
        padded, height=_LEAST_SHARE, prominence=_LEAST_SHARE / 2, width=(0, longest)
    )
    frames = peaks - 1
    heights = np.median(closed[:, frames], axis=1) if len(frames) else np.full(2, np.nan)
    return Blinks(frames, heights)


def with_whole_blinks(faps: Clip, weights: Clip) -> tuple[Clip, Clip]:
    """FAPs and ARKit weights whose blinks close the eyes; as they were if there is none.

    Closing is scaled by one factor for each eye in the whole clip, opening is left as it is.

    Parameters
    ----------
    faps : Clip
        With the four FAPs of the lids.
    weights : Clip
        With ``eyeBlinkLeft`` and ``eyeBlinkRight``.
    """
    blinks = find_blinks(faps)
    if not len(blinks.frames):
        return faps, weights
    values, w = np.array(faps.values), np.array(weights.values)
    for (side, names), height in zip(_LIDS.items(), blinks.heights, strict=True):
        gain = np.clip(1 / height, *_GAINS)
        for name in names:
            column = values[:, faps.channels.index(name)]
            column[column > 0] *= gain
        column = w[:, weights.channels.index(f"eyeBlink{side.capitalize()}")]
        usual = float(np.median(column[blinks.frames]))
        column *= np.clip(1 / max(usual, 1e-3), *_WEIGHT_GAINS)
        np.minimum(column, 1.0, out=column)
    return replace(faps, values=values), replace(weights, values=w)
