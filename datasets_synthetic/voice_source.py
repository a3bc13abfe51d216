"""The glottis: pulses of air after Liljencrants and Fant, breath between them.

References
----------
Fant, Liljencrants & Lin, A four-parameter model of glottal flow, STL-QPSR 4/1985.
Fant, The LF-model revisited: transformations and frequency domain analysis, STL-QPSR 2-3/1995:
one parameter Rd from pressed (0.3) to breathy (2.7).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..core.arrays import readonly

#: Tracks that drive the synthesisers have one value a millisecond.
FRAME_RATE_HZ = 1000
#: Sound is made at this rate, then brought to the one that is asked for.
SOURCE_RATE_HZ = 24_000

RD_RANGE = (0.4, 2.6)
_PHASES = 2048
_BREATH_WHEN_SHUT = 0.35  # of the noise that an open glottis makes


@dataclass(frozen=True)
class VoiceQuality:
    """How a talker's glottis works.

    Attributes
    ----------
    rd : float
        Shape of the pulses, in `RD_RANGE`: low is pressed, high is breathy.
    jitter, shimmer : float
        Standard deviation of a period, and of a pulse's strength, relative to their means.
    breath : float
        Noise in voiced sound relative to the pulses' strongest slope.
    """

    rd: float = 1.0
    jitter: float = 0.006
    shimmer: float = 0.03
    breath: float = 0.01

    def __post_init__(self) -> None:
        if not RD_RANGE[0] <= self.rd <= RD_RANGE[1]:
            raise ValueError(f"rd must lie in {RD_RANGE}, got {self.rd}")
        if not 0 <= self.jitter <= 0.1 or not 0 <= self.shimmer <= 0.5 or not 0 <= self.breath <= 1:
            raise ValueError("jitter must lie in 0..0.1, shimmer in 0..0.5, breath in 0..1")


@dataclass(frozen=True, eq=False)
class GlottalSource:
    """What the glottis puts into the tract, at `SOURCE_RATE_HZ`.

    Attributes
    ----------
    pulses : (n,) float64
        Derivative of the glottal flow; the strongest slope of an unmodified pulse is -1.
    breath : (n,) float64
        Noise of the air that flows through it, stronger while it is open.
    closures_s : (K,) float64, s
        When the glottis shuts: the instants of the strongest slope, of all pulses that sound.
    """

    pulses: NDArray[np.float64]
    breath: NDArray[np.float64]
    closures_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("pulses", "breath", "closures_s"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None,), name))


def glottal_source(
    f0_hz: NDArray[np.float64],
    voicing: NDArray[np.float64],
    aspiration: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    quality: VoiceQuality,
) -> GlottalSource:
    """Pulses and breath for tracks of one value a millisecond.

    Parameters
    ----------
    f0_hz : (T,) float, Hz
        Defined throughout, also where nothing is voiced.
    voicing, aspiration : (T,) float
        Amplitudes of pulses and of breath.
    """
    if not (np.isfinite(f0_hz).all() and (f0_hz > 20).all() and (f0_hz < 2000).all()):
        raise ValueError("f0_hz must be finite and lie in 20..2000 throughout")
    n_periods = int(np.ceil(len(f0_hz) / FRAME_RATE_HZ * f0_hz.max() * 1.5)) + 8
    wobble = rng.standard_normal((n_periods, 2)).clip(-2.5, 2.5)
    per_frame = SOURCE_RATE_HZ // FRAME_RATE_HZ
    n = len(f0_hz) * per_frame
    shape = lf_flow(quality.rd)
    strength = quality.shimmer * wobble[:, 1]
    pulses, openness, closures = _pulse_train(
        f0_hz, quality.jitter * wobble[:, 0], strength, shape, lf_closure(quality.rd), n, per_frame
    )
    frames = np.arange(n) / per_frame
    at = np.arange(len(f0_hz))
    loud = np.interp(frames, at, voicing)
    breath = np.interp(frames, at, aspiration) + quality.breath * loud
    is_open = _BREATH_WHEN_SHUT + (1 - _BREATH_WHEN_SHUT) * openness
    is_voiced = np.interp(frames, at, (voicing > 0).astype(float))
    noise = rng.standard_normal(n) * breath * (is_open * is_voiced + 1 - is_voiced)
    sounding = np.interp(closures * FRAME_RATE_HZ, at, voicing) > 0
    return GlottalSource(pulses * loud, noise, closures[sounding])


@cache
def lf_flow(rd: float) -> NDArray[np.float64]:
    """Glottal flow over one period of length 1, (2049,) float64, whose steepest fall is 1.

    Fant's 1995 rules give the LF parameters from Rd; α follows from the flow's return to zero.
    """
    ra, _, rg, te = _lf_times(rd)
    omega = np.pi * 2 * rg  # eq. 1: ωg = π / tp with tp = 1 / 2 rg
    eps = brentq(lambda e: e * ra - 1 + np.exp(-e * (1 - te)), 1 / ra * 1e-3, 2 / ra)
    returned = ((1 - np.exp(-eps * (1 - te))) / eps - (1 - te) * np.exp(-eps * (1 - te))) / (
        eps * ra
    )

    def opened(alpha: float, t: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
        """Integral of exp(αt) sin(ωt) from 0 to t."""
        grown = np.exp(alpha * np.asarray(t))
        wave = alpha * np.sin(omega * np.asarray(t)) - omega * np.cos(omega * np.asarray(t))
        return (grown * wave + omega) / (alpha**2 + omega**2)

    def area(alpha: float) -> float:
        gain = -1 / (np.exp(alpha * te) * np.sin(omega * te))  # the slope at te is -1
        return float(gain * opened(alpha, te) - returned)

    alpha = brentq(area, -60.0, 60.0)
    gain = -1 / (np.exp(alpha * te) * np.sin(omega * te))
    phase = np.linspace(0, 1, _PHASES + 1)
    rising = gain * np.asarray(opened(alpha, np.minimum(phase, te)))
    late = np.maximum(phase - te, 0)
    fallen = ((1 - np.exp(-eps * late)) / eps - late * np.exp(-eps * (1 - te))) / (eps * ra)
    flow = rising - fallen
    flow[-1] = 0.0
    flow.flags.writeable = False
    return np.asarray(flow, dtype=np.float64)


def lf_closure(rd: float) -> float:
    """When in a period (0 to 1) the flow falls steepest."""
    return _lf_times(rd)[3]


def _lf_times(rd: float) -> tuple[float, float, float, float]:
    """Ra, Rk, Rg and te of a period of length 1 (Fant 1995, eqs. 2 to 4)."""
    ra = (-1 + 4.8 * rd) / 100
    rk = (22.4 + 11.8 * rd) / 100
    rg = rk / 4 * (0.5 + 1.2 * rk) / (0.11 * rd - ra * (0.5 + 1.2 * rk))
    return ra, rk, rg, (1 + rk) / (2 * rg)


@njit(cache=True, nogil=True)
def _pulse_train(f0, jitter, shimmer, shape, te, n, per_frame):  # type: ignore[no-untyped-def]
    """Flow difference per sample: the integral over each sample, so that pulses do not alias."""
    rate = per_frame * 1000.0
    derivative = np.zeros(n)
    openness = np.zeros(n)
    closures = np.empty(len(jitter))
    start, period_n, before = 0.0, 0, 0.0
    last_phase = len(shape) - 1
    highest = shape.max()
    period = (1 + jitter[0]) / f0[0]
    loud = 1 + shimmer[0]
    for i in range(n):
        t = i / rate
        while t - start >= period:
            closures[period_n] = start + te * period
            start += period
            period_n = min(period_n + 1, len(jitter) - 1)
            frame = min(int(start * 1000), len(f0) - 1)
            period = (1 + jitter[period_n]) / f0[frame]
            loud = 1 + shimmer[period_n]
        x = (t - start) / period * last_phase
        k = min(int(x), last_phase - 1)
        u = shape[k] + (x - k) * (shape[k + 1] - shape[k])
        flow = loud * period * u
        derivative[i] = (flow - before) * rate
        openness[i] = u / highest
        before = flow
    return derivative, openness, closures[:period_n]
