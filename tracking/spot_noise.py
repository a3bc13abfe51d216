"""How sure a fitted centre is: from what the fits leave over in the picture itself.

A centre moves with that part of the noise which is odd about it; so only the odd part of the
residuals counts, and a shape that the model does not have (which is even) does not. The noise of
one spot's few pixels is not well known: it is drawn towards the picture's median. What one spot
has in excess of that comes from something that hides a part of it, and moves its centre by a share
of its radius.

What compression does to a place is another matter: it leaves the spot's shape intact and moves it
whole, which no single picture shows. `place_noise` finds that from how the centres jitter in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError
from .spot_fit import AMP, WXX, WXY, WYY
from .spot_windows import BESIDE, COUNT, ODD, U_XX, U_XY, U_YY

_OWN_WEIGHT = 60.0  # pixels of a spot that weigh as much as the picture's median
_ODD_FREEDOM = 8.0  # centre and slopes, in the odd half of the pixels
_MANY = 5  # spots whose median tells the noise
_ROUNDING = 1 / 12  # variance of grey levels' rounding
_CODED_SHARE = 0.012  # of a lone spot's amplitude: what codecs leave around its edge
_SIGNIFICANT = 5.0  # sd of the noise's estimate
# What hides a part of a disc of radius R px leaves an odd residual of the share o of its amplitude,
# and moves the centre by about 0.07 (o / 0.01 R)^2.5 radii in each coordinate. Fitted on discs of
# 2.5 and 4 px, blurred by 0.45 px, seen at 0 and 60°, hidden by 5 to 35 % behind straight edges
# that are darker or brighter than the skin; true within a factor of about two.
_HIDDEN, _HIDDEN_ODD, _HIDDEN_POWER = 0.07, 0.01, 2.5
_MOST_HIDDEN = 0.6  # radii: beyond, little would be left to see


@njit(cache=True, nogil=True, error_model="numpy")
def spot_covariances(found):  # type: ignore[no-untyped-def]
    """(n, 4): variances xx, xy, yy of centres, px², and noise (grey levels, sd) of each spot."""
    n = len(found)
    own = np.empty(n)
    for i in range(n):
        spare = max(found[i, COUNT] - _ODD_FREEDOM, 1.0)
        own[i] = max(found[i, ODD] / spare, _ROUNDING)
    usual = np.median(own) if n else 0.0
    result = np.empty((n, 4))
    for i in range(n):
        f = found[i]
        reference = usual
        if n < _MANY:
            reference = min(own[i], max(f[BESIDE], _ROUNDING) + (_CODED_SHARE * f[AMP]) ** 2)
        count = f[COUNT]
        excess = own[i] - reference * (1 + _SIGNIFICANT * np.sqrt(4 / count))
        noise2 = (_OWN_WEIGHT * reference + count * own[i]) / (_OWN_WEIGHT + count)
        off2 = 0.0
        if excess > 0:
            radius = np.sqrt(2 * (f[WXX] + f[WYY]) / (f[WXX] * f[WYY] - f[WXY] ** 2))
            odd = np.sqrt(excess / 2) / f[AMP] / radius / _HIDDEN_ODD
            off2 = (radius * min(_HIDDEN * odd**_HIDDEN_POWER, _MOST_HIDDEN)) ** 2
        result[i, 0] = noise2 * f[U_XX] + off2
        result[i, 1] = noise2 * f[U_XY]
        result[i, 2] = noise2 * f[U_YY] + off2
        result[i, 3] = np.sqrt(noise2)
    return result


@dataclass(frozen=True)
class PlaceNoise:
    """How centres jitter in time, against what single pictures say of them.

    Attributes
    ----------
    scale : float
        Factor on standard deviations: about 1 for lossless video, several for compressed.
    correlation : float
        Of the errors of successive frames. Compression predicts frames from earlier ones, and
        errors with them; means over n frames are less sure than 1/√n.
    n_windows : int
        Stretches of `WINDOW` frames it rests on.
    """

    scale: float
    correlation: float
    n_windows: int


WINDOW = 15  # frames; within them, motion is a polynomial
_DEGREE, _STEP = 4, 7
_MIN_WINDOWS = 20
# Errors that last longer than a window pass for motion: 9 % of the standard deviation with x264 at
# crf 12 to 23 (benchmarks/codec_centres.py), none without compression, where the scale is 1.
_SLOW = 0.09
_STRAY = 4.0  # times the median jitter: motion that no polynomial follows
# beyond 0.6, errors are told from motion no more; x264 at crf 23 has 0.4 to 0.55
_CORRELATIONS = np.linspace(0.0, 0.6, 121)


def place_noise(centres: ArrayLike, sd_px: ArrayLike) -> PlaceNoise:
    """How large the errors of centres are, from how they jitter about smooth motion.

    The errors are taken for a first-order autoregression. Two measures of jitter, third
    differences and what a polynomial of degree 4 leaves of 15 frames, feel its correlation
    differently, and so tell its size and its correlation.

    Parameters
    ----------
    centres : (T, N, 2) float, px
        Dots followed through successive frames of one camera; NaN where unseen. Filmed fast enough
        that motion is smooth over 15 frames for most of the dots most of the time.
    sd_px : (T, N) float, px
        Their standard deviations, from `Blobs`.

    Raises
    ------
    InputError
        If fewer than 20 stretches of 15 frames are seen whole.
    """
    paths = np.asarray(centres, dtype=np.float64)
    sd = np.asarray(sd_px, dtype=np.float64)
    if paths.ndim != 3 or paths.shape[2] != 2 or sd.shape != paths.shape[:2]:
        raise ValueError(
            f"centres must be (T, N, 2) and sd_px (T, N), got {paths.shape} and {sd.shape}"
        )
    windows = _windows(paths, sd)
    if len(windows) < _MIN_WINDOWS:
        raise InputError(
            f"the noise of places needs {_MIN_WINDOWS} stretches of {WINDOW} frames in which a dot "
            f"is followed, found {len(windows)}: give more frames"
        )
    power = np.vander(np.arange(WINDOW) - (WINDOW - 1) / 2, _DEGREE + 1)
    keep_rest = np.eye(WINDOW) - power @ np.linalg.pinv(power)
    smooth = (np.einsum("ab,nbi->nai", keep_rest, windows) ** 2).sum(axis=1).mean(axis=1)
    rough = (np.diff(windows, n=3, axis=1) ** 2).mean(axis=(1, 2))
    kept = (smooth <= _STRAY * np.median(smooth)) & (rough <= _STRAY * np.median(rough))
    smooth_mean, rough_mean = float(smooth[kept].mean()), float(rough[kept].mean())
    expected_smooth, expected_rough = _expected(keep_rest)
    # both measures grow with the variance; their ratio with the correlation alone
    ratio = smooth_mean / max(rough_mean, 1e-300)
    best = int(np.abs(np.log(expected_smooth / expected_rough / ratio)).argmin())
    scale = float(np.sqrt(smooth_mean / expected_smooth[best]))
    scale *= 1 + _SLOW * max(0.0, 1 - 1 / max(scale, 1e-9) ** 2)
    return PlaceNoise(scale, float(_CORRELATIONS[best]), int(kept.sum()))


def _windows(paths: NDArray[np.float64], sd: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, WINDOW, 2): stretches seen whole, over the median standard deviation of each."""
    found = []
    for first in range(0, len(paths) - WINDOW + 1, _STEP):
        part, part_sd = paths[first : first + WINDOW], sd[first : first + WINDOW]
        whole = np.isfinite(part).all(axis=(0, 2)) & np.isfinite(part_sd).all(axis=0)
        scaled = part[:, whole] / np.median(part_sd[:, whole], axis=0)[:, None]
        found.append(scaled.transpose(1, 0, 2))
    return np.concatenate(found) if found else np.empty((0, WINDOW, 2))


def _expected(
    keep_rest: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both measures for errors of variance 1, for each of `_CORRELATIONS`."""
    lag = np.abs(np.subtract.outer(np.arange(WINDOW), np.arange(WINDOW)))
    third = np.diff(np.eye(WINDOW), n=3, axis=0)
    smooth, rough = [], []
    for rho in _CORRELATIONS:
        covariance = rho**lag
        smooth.append(np.trace(keep_rest @ covariance @ keep_rest))
        rough.append(np.trace(third @ covariance @ third.T) / len(third))
    return np.array(smooth), np.array(rough)
