"""Low-pass filters for curves: without lag for takes, with little for streams.

What a filter costs and gains can be asked for before it is used: its lag, s, and its noise gain,
the share of a white noise's standard deviation that is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import butter, sosfiltfilt, sosfreqz

_ORDER = 2
_PAD = 6  # samples a section is padded by at each end, and the shortest run that is filtered


@dataclass(frozen=True)
class FilterFigures:
    """What a filter does.

    Attributes
    ----------
    lag_s : float
        By how much slow motion is late.
    noise_gain : float
        Standard deviation of white noise behind the filter over that before it.
    """

    lag_s: float
    noise_gain: float


def zero_phase(
    values: ArrayLike, rate_hz: float, cutoff_hz: float, *, order: int = _ORDER
) -> NDArray[np.float64]:
    """Low-pass without lag: a Butterworth filter run forwards and backwards.

    The gain at frequency f is 1 / (1 + (tan(π f/fs) / tan(π fc/fs))^(2 order)), one half at the
    cut-off. Runs between NaN are filtered by themselves; runs too short to pad stay as they are.

    Parameters
    ----------
    values : (T, ...) float
        NaN where unknown; NaN stays.
    rate_hz, cutoff_hz : float
        The cut-off must lie below half the rate.
    order : int
        Of the filter in one direction.

    Returns
    -------
    (T, ...) float64

    Raises
    ------
    ValueError
        If the cut-off is not between 0 and half the rate.
    """
    sos = _butterworth(rate_hz, cutoff_hz, order)
    v = np.array(values, dtype=np.float64)
    flat = v.reshape(len(v), -1)
    pad = _PAD * len(sos)
    known = ~np.isnan(flat)
    for rows in np.unique(known, axis=1).T:
        columns = np.flatnonzero((known == rows[:, None]).all(axis=0))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            if end - first > pad:
                piece = flat[first:end][:, columns]
                flat[first:end, columns] = sosfiltfilt(sos, piece, axis=0, padlen=pad)
    return flat.reshape(v.shape)


def zero_phase_figures(rate_hz: float, cutoff_hz: float, *, order: int = _ORDER) -> FilterFigures:
    """Of `zero_phase`, away from the ends: no lag, and the noise that is left.

    Examples
    --------
    >>> figures = zero_phase_figures(60.0, 8.0)
    >>> figures.lag_s, round(figures.noise_gain, 2)
    (0.0, 0.47)
    """
    sos = _butterworth(rate_hz, cutoff_hz, order)
    _, response = sosfreqz(sos, worN=4096)
    return FilterFigures(0.0, float(np.sqrt(np.mean(np.abs(response) ** 4))))


def _butterworth(rate_hz: float, cutoff_hz: float, order: int) -> NDArray[np.float64]:
    if not 0 < cutoff_hz < rate_hz / 2:
        raise ValueError(
            f"the cut-off must lie between 0 and half the rate of {rate_hz:g} Hz, got "
            f"{cutoff_hz:g} Hz"
        )
    return np.asarray(butter(order, cutoff_hz, fs=rate_hz, output="sos"))


class OneEuroFilter:
    """A low-pass for streams whose cut-off rises with speed: still when still, quick when quick.

    Call it with each sample in turn; it keeps the last one. A NaN leaves the state alone and gives
    NaN.

    Parameters
    ----------
    min_cutoff_hz : float
        Cut-off of what stands still: lower means calmer.
    beta : float
        Hertz of cut-off for each unit of the values a second: higher means less lag in motion.
    speed_cutoff_hz : float
        Of the speed's own low-pass.

    References
    ----------
    Casiez, Roussel & Vogel 2012, 1€ filter, CHI.
    """

    def __init__(
        self, *, min_cutoff_hz: float = 1.0, beta: float = 0.02, speed_cutoff_hz: float = 1.0
    ) -> None:
        if not (min_cutoff_hz > 0 and speed_cutoff_hz > 0 and beta >= 0):
            raise ValueError("cut-offs must be above 0 Hz and beta 0 or more")
        self.min_cutoff_hz = min_cutoff_hz
        self.beta = beta
        self.speed_cutoff_hz = speed_cutoff_hz
        self._time_s: float | None = None
        self._raw: NDArray[np.float64] = np.zeros(0)
        self._value: NDArray[np.float64] = np.zeros(0)
        self._speed: NDArray[np.float64] = np.zeros(0)

    def __call__(self, time_s: float, value: ArrayLike) -> NDArray[np.float64]:
        """The filtered value of any shape, always the same; times must increase.

        A point's coordinates, the last axis, share one speed and so one cut-off.
        """
        v = np.asarray(value, dtype=np.float64)
        if np.isnan(v).any():
            return np.full(v.shape, np.nan)
        if self._time_s is None:
            self._time_s, self._raw, self._value = time_s, v.copy(), v
            self._speed = np.zeros_like(v)
            return v.copy()
        step = time_s - self._time_s
        if not step > 0:
            raise ValueError(f"times must increase: {time_s:g} s after {self._time_s:g} s")
        raw_speed = (v - self._raw) / step
        self._speed = self._speed + _alpha(self.speed_cutoff_hz, step) * (raw_speed - self._speed)
        fast = np.abs(self._speed)
        if v.ndim:
            fast = np.linalg.norm(self._speed, axis=-1, keepdims=True)
        share = _alpha(self.min_cutoff_hz + self.beta * fast, step)
        self._value = self._value + share * (v - self._value)
        self._time_s, self._raw = time_s, v.copy()
        return self._value.copy()

    def figures(self, rate_hz: float, speed: float = 0.0) -> FilterFigures:
        """Lag and noise gain in steady motion at a speed, values a second.

        At one cut-off the filter is exponential smoothing with share α: it is late by
        1 / (2 π cut-off), and leaves √(α / (2 − α)) of white noise.
        """
        cutoff = self.min_cutoff_hz + self.beta * abs(speed)
        alpha = float(_alpha(cutoff, 1 / rate_hz))
        return FilterFigures(1 / (2 * np.pi * cutoff), float(np.sqrt(alpha / (2 - alpha))))


def _alpha(cutoff_hz: ArrayLike, step_s: float) -> NDArray[np.float64]:
    """Share of the new sample in exponential smoothing, eq. 5 and 6."""
    rate = 2 * np.pi * np.asarray(cutoff_hz, dtype=np.float64) * step_s
    return np.asarray(rate / (1 + rate))
