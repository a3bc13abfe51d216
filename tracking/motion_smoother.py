"""The most likely smooth course of noisy curves, and how sure it is.

Each curve is taken to move at a velocity that drifts at random (white acceleration), and to be
seen with white noise. How much drift and how much noise the curves themselves tell, by maximum
likelihood: exact curves are left as they are, noisy ones smoothed as far as they are slow. Gaps
are passed over. Kalman 1960; Rauch, Tung & Striebel 1965.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Drift over noise that is tried: variance of acceleration a Hz over that of the noise, in units
#: of the frame interval, so that rates do not matter; from hardly moving to nothing but moving.
_RATIOS = np.geomspace(1e-7, 1e5, 37)
_VAGUE = 1e8  # of the noise: what is known of place and speed at first
_MIN_SEEN = 12


@dataclass(frozen=True, eq=False)
class SmoothedCurves:
    """What `smooth_curves` found.

    Attributes
    ----------
    values : (T, K) float64
        NaN before the first and after the last known sample only.
    variances : (T, K) float64
        Of their errors from white noise.
    noise : float
        What the given variances had to be multiplied by.
    ratio : float
        Drift over noise; infinite where the curves are left as they are.
    """

    values: Floats
    variances: Floats
    noise: float
    ratio: float


def smooth_curves(
    time_s: Floats, values: Floats, variances: Floats, *, most_noise: float = np.inf
) -> SmoothedCurves:
    """Smooth curves that share one kind of motion.

    Parameters
    ----------
    time_s : (T,) float64, s
    values : (T, K) float64
        NaN in whole rows where unknown.
    variances : (T, K) float64
        Of the noise, above 0, up to a common factor.
    most_noise : float
        The factor is at most this: what is jerkier is motion.
    """
    seen = np.flatnonzero(~np.isnan(values).any(axis=1))
    if len(seen) < _MIN_SEEN:
        return SmoothedCurves(values.copy(), variances.copy(), 1.0, np.inf)
    rows = slice(int(seen[0]), int(seen[-1]) + 1)
    usual = float(np.mean(variances[seen]))
    r = np.where(np.isnan(values), np.nan, variances / usual)[rows]
    steps = np.diff(time_s[rows])
    interval = float(np.median(steps))
    dt = np.concatenate([[0.0], steps / interval])
    origin = values[seen].mean(axis=0)
    z = values[rows] - origin
    likelihood, noise = _likelihoods(dt, z, r, most_noise * usual)
    best = int(np.argmax(likelihood))
    if best == len(_RATIOS) - 1:  # all motion and no noise: nothing to smooth
        return SmoothedCurves(values.copy(), np.zeros_like(variances), 0.0, np.inf)
    course, spread = _smoothed(dt, z, r, float(_RATIOS[best]))
    out, variance = np.full_like(values, np.nan), np.full_like(values, np.nan)
    out[rows], variance[rows] = course + origin, spread * noise[best]
    return SmoothedCurves(out, variance, float(noise[best] / usual), float(_RATIOS[best]))


def _likelihoods(dt: Floats, z: Floats, r: Floats, most: float) -> tuple[Floats, Floats]:
    """Log-likelihood of each ratio with its best noise variance up to `most`, and that variance."""
    G, K = len(_RATIOS), z.shape[1]
    q = _RATIOS[:, None]
    x, v = np.zeros((G, K)), np.zeros((G, K))
    pxx, pxv, pvv = np.full((G, K), _VAGUE), np.zeros((G, K)), np.full((G, K), _VAGUE)
    squares, logs, count = np.zeros(G), np.zeros(G), 0
    for i, h in enumerate(dt):
        if h:
            x, (pxx, pxv, pvv) = x + h * v, _grown(pxx, pxv, pvv, q, h)
        if np.isnan(z[i, 0]):
            continue
        s = pxx + r[i]
        miss = z[i] - x
        if i > 2:  # the first samples only tell where it starts
            squares += (miss**2 / s).sum(axis=1)
            logs += np.log(s).sum(axis=1)
            count += K
        gain_x, gain_v = pxx / s, pxv / s
        x, v = x + gain_x * miss, v + gain_v * miss
        pxx, pxv, pvv = r[i] * gain_x, r[i] * gain_v, pvv - gain_v * pxv
    noise = np.clip(squares / count, 1e-30, max(most, 1e-30))
    return -0.5 * (count * np.log(noise) + logs + squares / noise), noise


def _grown(
    pxx: Floats, pxv: Floats, pvv: Floats, q: Floats | float, h: float
) -> tuple[Floats, Floats, Floats]:
    """Covariance a step later."""
    return (
        pxx + 2 * h * pxv + h * h * pvv + q * h**3 / 3,
        pxv + h * pvv + q * h**2 / 2,
        pvv + q * h,
    )


def _smoothed(dt: Floats, z: Floats, r: Floats, q: float) -> tuple[Floats, Floats]:
    """Forward filter, backward smoother: (T, K) values and variances, the latter per unit noise."""
    T, K = z.shape
    state, cov = np.zeros((T, 2, K)), np.zeros((T, 3, K))
    early, early_cov = np.zeros((T, 2, K)), np.zeros((T, 3, K))  # before each sample is seen
    x, v = np.zeros(K), np.zeros(K)
    p = (np.full(K, _VAGUE), np.zeros(K), np.full(K, _VAGUE))
    for i, h in enumerate(dt):
        if h:
            x, p = x + h * v, _grown(*p, q, h)
        early[i], early_cov[i] = (x, v), p
        if not np.isnan(z[i, 0]):
            s = p[0] + r[i]
            gain_x, gain_v = p[0] / s, p[1] / s
            miss = z[i] - x
            x, v = x + gain_x * miss, v + gain_v * miss
            p = (r[i] * gain_x, r[i] * gain_v, p[2] - gain_v * p[1])
        state[i], cov[i] = (x, v), p
    for i in range(T - 2, -1, -1):
        h = dt[i + 1]
        a, b, c = cov[i]
        A, B, C = early_cov[i + 1]
        det = A * C - B * B
        # gain = P Fᵀ (predicted P)⁻¹, with F = [[1, h], [0, 1]]
        m00, m01, m10, m11 = a + h * b, b, b + h * c, c
        g00, g01 = (m00 * C - m01 * B) / det, (m01 * A - m00 * B) / det
        g10, g11 = (m10 * C - m11 * B) / det, (m11 * A - m10 * B) / det
        dx, dv = state[i + 1] - early[i + 1]
        state[i] += (g00 * dx + g01 * dv, g10 * dx + g11 * dv)
        da, db, dc = cov[i + 1] - early_cov[i + 1]
        cov[i] += (
            g00 * g00 * da + 2 * g00 * g01 * db + g01 * g01 * dc,
            g00 * g10 * da + (g00 * g11 + g01 * g10) * db + g01 * g11 * dc,
            g10 * g10 * da + 2 * g10 * g11 * db + g11 * g11 * dc,
        )
    return state[:, 0], np.maximum(cov[:, 0], 0.0)
