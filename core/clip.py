"""Animation curves: named channels over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import readonly
from .time_base import checked_times, uniform_rate_hz

#: Channels of the high-level FAPs 1 and 2 are held from key to key, never interpolated.
HELD_PREFIXES = ("viseme.", "expression.")


@dataclass(frozen=True, eq=False)
class Clip:
    """Named channels over time: FAPs, ARKit weights, muscle contractions.

    FAP channels bear the names of the MPEG-4 table (``open_jaw``) and its units (FAPU/1024, or
    1e-5 rad); the fields of FAPs 1 and 2 are ``viseme.select1`` and so on.

    Attributes
    ----------
    time_s : (T,) float64, s
        Strictly increasing.
    channels : tuple of str, length C
    values : (T, C) float64
        NaN exactly where `is_set` is False.
    is_set : (T, C) bool
        False where a channel has no value at that time (not "zero": not given).
    """

    time_s: NDArray[np.float64]
    channels: tuple[str, ...]
    values: NDArray[np.float64]
    is_set: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        channels = tuple(self.channels)
        if len(set(channels)) != len(channels):
            twice = sorted({c for c in channels if channels.count(c) > 1})
            raise ValueError(f"channels must differ; twice: {', '.join(twice)}")
        times = checked_times(self.time_s)
        shape = (len(times), len(channels))
        v = np.array(readonly(self.values, shape, "values"))
        if np.isinf(v).any():
            raise ValueError("values must be finite, or NaN where not set")
        given = ~np.isnan(v)
        if self.is_set is not None:
            given &= readonly(self.is_set, shape, "is_set", np.bool_)
        v[~given] = np.nan
        object.__setattr__(self, "channels", channels)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "values", readonly(v, shape, "values"))
        object.__setattr__(self, "is_set", readonly(given, shape, "is_set", np.bool_))

    @property
    def rate_hz(self) -> float | None:
        """Frames per second where the times are uniform, else None."""
        return uniform_rate_hz(self.time_s)

    def __getitem__(self, channel: str) -> NDArray[np.float64]:
        """One channel, (T,) float64; NaN where not set."""
        return self.values[:, self.channels.index(channel)]

    def resample(self, time_s: ArrayLike) -> Clip:
        """The clip at other times.

        Linear between the keys that are set; held for the fields of FAPs 1 and 2; not set outside
        the keys' range (0.5 ms of rounding apart).
        """
        t = np.asarray(time_s, dtype=np.float64)
        found = np.full((len(t), len(self.channels)), np.nan)
        for c, name in enumerate(self.channels):
            rows = np.flatnonzero(~np.isnan(self.values[:, c]))
            if not len(rows):
                continue
            keys, v = self.time_s[rows], self.values[rows, c]
            inside = (t >= keys[0] - 5e-4) & (t <= keys[-1] + 5e-4)
            if name.startswith(HELD_PREFIXES):
                before = np.clip(np.searchsorted(keys, t + 5e-4, side="right") - 1, 0, None)
                found[:, c] = np.where(inside, v[before], np.nan)
            else:
                found[:, c] = np.where(inside, np.interp(t, keys, v), np.nan)
        return Clip(t, self.channels, found)
