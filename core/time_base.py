"""Checks and rates of time stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import readonly

_UNIFORM = 1e-3  # of one interval; container time stamps are rounded to 1/90000 s or 1 ms


def checked_times(time_s: ArrayLike) -> NDArray[np.float64]:
    """A read-only (T,) float64 copy, s; ValueError unless finite and strictly increasing."""
    t = readonly(time_s, (None,), "time_s")
    if not np.isfinite(t).all() or (len(t) > 1 and not (np.diff(t) > 0).all()):
        raise ValueError("time_s must be finite and strictly increasing")
    return t


def uniform_rate_hz(time_s: NDArray[np.float64]) -> float | None:
    """The rate of uniformly spaced times; None for fewer than two or uneven ones."""
    if len(time_s) < 2:
        return None
    mean_step = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    even = time_s[0] + mean_step * np.arange(len(time_s))
    if np.abs(time_s - even).max() > max(_UNIFORM * mean_step, 1.1e-3 if mean_step > 8e-3 else 0):
        return None
    rate = 1.0 / mean_step
    nearest = round(rate)
    return float(nearest) if abs(rate - nearest) < 1e-3 * rate / 10 else float(rate)
