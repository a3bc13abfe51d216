"""A wand in one video: its balls in every frame, and at moments between frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
_SAME_TIME_FRAMES = 0.02
_GAP_FRAMES = 1.5


@dataclass(frozen=True, eq=False)
class WandTrack:
    """A wand in one video.

    Attributes
    ----------
    time_s : (F,) float64, s
        Of the frames, from the first.
    pixels : (F, B, 2) float64, px
        Centres of the balls in order; NaN where the wand was not found.
    sd : (F, B) float64, px
        What to expect of the centres' errors, relative to each other.
    """

    time_s: Floats
    pixels: Floats
    sd: Floats

    @property
    def is_seen(self) -> NDArray[np.bool_]:
        """(F,) frames in which the whole wand was found."""
        return np.asarray(np.isfinite(self.pixels[..., 0]).all(axis=1))


def at_times(track: WandTrack, times_s: ArrayLike) -> tuple[Floats, Floats]:
    """The wand as a video would have shown it at moments between its frames.

    Where a frame was taken at a moment it is taken as it is; otherwise a cubic through the two
    frames before and the two after.

    Returns
    -------
    pixels : (T, B, 2) float64, px
    sd : (T, B) float64, px
        NaN where the frames around a moment are missing, or one does not show the wand.
    """
    t, at = track.time_s, np.asarray(times_s, dtype=np.float64)
    pixels = np.full((len(at), *track.pixels.shape[1:]), np.nan)
    sd = np.full(pixels.shape[:2], np.nan)
    if len(t) < 4:
        return pixels, sd
    usual = float(np.median(np.diff(t)))
    first = np.clip(np.searchsorted(t, at) - 2, 0, len(t) - 4)
    four = first[:, None] + np.arange(4)
    inside = (at > t[four[:, 1]]) & (at < t[four[:, 2]])
    inside &= np.diff(t[four], axis=1).max(axis=1) <= _GAP_FRAMES * usual
    weights = _lagrange(t[four], at)
    pixels[inside] = np.einsum("tk,tkbi->tbi", weights[inside], track.pixels[four[inside]])
    spread = np.einsum("tk,tkb->tb", weights[inside] ** 2, track.sd[four[inside]] ** 2)
    sd[inside] = np.sqrt(spread)
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    nearest = np.where(at - t[after - 1] < t[after] - at, after - 1, after)
    exact = np.abs(t[nearest] - at) <= _SAME_TIME_FRAMES * usual
    pixels[exact], sd[exact] = track.pixels[nearest[exact]], track.sd[nearest[exact]]
    return pixels, sd


def _lagrange(t: Floats, at: Floats) -> Floats:
    """Weights (T, 4) of the values at t (T, 4) whose cubic is asked for at (T,)."""
    same = np.eye(t.shape[1], dtype=bool)
    gaps = np.where(same, 1.0, t[:, :, None] - t[:, None])
    ways = np.where(same, 1.0, (at[:, None] - t)[:, None])
    return np.asarray((ways / gaps).prod(axis=2))
