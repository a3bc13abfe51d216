"""Offset and drift from one motion that two cameras saw; or that they cannot be told from it.

Two smooth motions that have nothing to do with each other can be laid over each other quite well,
somewhere: the fewer bends they have, the better. So an offset is given only if every other one is
much less likely, where what is left over is counted as it comes: in few independent pieces if it
is smooth, as lack of fit is, in many if it is noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize
from scipy.interpolate import BSpline, make_smoothing_spline

from ..core.errors import InputError
from .clock_fit import ClockFit

Floats = NDArray[np.float64]
_MIN_FRAMES = 8
_LEAST_OVERLAP = 0.25  # of the other's frames
#: Twice the logarithm of how much likelier the best offset must be than any other. Unrelated
#: motions reached 10 in 170 draws; boards swung for 8 s before two cameras had 13 and more.
_LEAST_LIKELIER = 16.0
#: What the next best leaves, over what the best leaves: noise alone makes 1.2 among 1,000 offsets.
_LEAST_WORSE = 1.5
_MOST_RIVALS = 8  # that are looked at closely
#: Bends that both motions must have beyond what the linear map between them can take up.
_LEAST_SPARE = 2.0
_LAGS = 2.0  # of the motions' memory: residuals are not followed farther


@dataclass(frozen=True, eq=False)
class _Pair:
    """What is compared: a curve through the reference, and the other's frames.

    Attributes
    ----------
    curve : BSpline to (K,)
    first_s, last_s : float, s
        Of the reference.
    time_s : (U,) float64, s
    seen : (U, L) float64
    memory : float, frames
        For so many frames both motions go on alike: 1 for noise.
    """

    curve: BSpline
    first_s: float
    last_s: float
    time_s: Floats
    seen: Floats
    memory: float

    def rest(self, offset: float, drift: float = 0.0) -> tuple[Floats, Floats, Floats] | None:
        """What the reference leaves unexplained, and how the explained part changes.

        Returns
        -------
        residual : (N, L) float64
        slope : (N, L) float64
            Of the explained part by the offset, 1/s.
        basis : (N, K + 1) float64
            The reference at the same moments, and 1.
            None instead of all three where they do not overlap.
        """
        at = (self.time_s - offset) / (1 + drift)
        inside = (at >= self.first_s) & (at <= self.last_s)
        if inside.sum() < max(_MIN_FRAMES, _LEAST_OVERLAP * len(self.time_s)):
            return None
        basis = np.column_stack([self.curve(at[inside]), np.ones(int(inside.sum()))])
        gains = np.linalg.lstsq(basis, self.seen[inside], rcond=None)[0]
        residual = self.seen[inside] - basis @ gains
        return residual, -self.curve(at[inside], 1) @ gains[:-1], basis

    def spare(self, n: int) -> float:
        """Independent pieces among n frames beyond those that the linear map takes up."""
        return float(n / self.memory - self.curve.c.shape[-1] - 1)

    def share(self, offset: float, drift: float = 0.0) -> tuple[float, float]:
        """The share of the other's variance that is unexplained, and the allowance for chance.

        Where the overlap is short, less is left by chance: the allowance is Akaike's (final
        prediction error), with independent pieces for samples. Infinite without overlap.
        """
        found = self.rest(offset, drift)
        if found is None:
            return float("inf"), 1.0
        p, pieces = self.curve.c.shape[-1] + 1, len(found[0]) / self.memory
        unexplained = float((found[0] ** 2).mean() / self.seen.var(axis=0).mean())
        return unexplained, (pieces + p) / max(pieces - p, 0.5)

    def left(self, offset: float, drift: float = 0.0) -> float:
        """The unexplained share with its allowance: what the best offset has least of."""
        unexplained, allowance = self.share(offset, drift)
        return unexplained * allowance


def synchronise_motion(
    reference_time_s: ArrayLike,
    reference: ArrayLike,
    other_time_s: ArrayLike,
    other: ArrayLike,
    *,
    max_offset_s: float = 5.0,
    estimate_drift: bool = False,
) -> ClockFit:
    """From the same motion seen by two cameras, as signals whose shape both share.

    Parameters
    ----------
    reference_time_s, other_time_s : (T,), (U,) float, s
    reference, other : (T, K), (U, L) float
        Any measures of the motion, such as the coordinates of a board's corner in each picture.
        Each of the other's is explained as a linear combination of the reference's (and 1) at
        the offset that leaves least (canonical correlation): cameras need not be calibrated.
    max_offset_s : float
    estimate_drift : bool

    Raises
    ------
    InputError
        If nothing moves, if the two do not overlap, if the motion is too short or too smooth to
        tell one offset from another, or if it repeats itself.

    References
    ----------
    Bartlett 1946, on the theoretical specification of the sampling properties of autocorrelated
    time series: how many independent samples a smooth series is worth.
    """
    pair = _pair(reference_time_s, reference, other_time_s, other)
    step = float(np.median(np.diff(pair.time_s)))
    offsets = np.arange(-max_offset_s, max_offset_s + step / 2, step / 2)
    shares, allowances = np.array([pair.share(o) for o in offsets]).T
    scores = shares * allowances
    if not np.isfinite(scores).any():
        raise InputError("the recordings do not overlap within the largest offset")
    i = int(np.argmin(scores))
    offset = _lowest(pair, offsets, scores, i)
    drift = 0.0
    if estimate_drift:
        offset, drift = _with_drift(pair, offset, step)
    _refuse_chance(pair, offset, drift)
    apart = np.where(_beyond_the_rise(scores, i), shares, np.inf)
    _refuse_rivals(pair, offset, drift, offsets, apart)
    return ClockFit(
        offset, drift, _sd(pair, offset, drift),
        float("nan") if estimate_drift else float("inf"),
        len(pair.time_s), len(pair.time_s), "motion",
    )  # fmt: skip


def _pair(
    reference_time_s: ArrayLike, reference: ArrayLike, other_time_s: ArrayLike, other: ArrayLike
) -> _Pair:
    ta, tb = (np.asarray(x, dtype=float) for x in (reference_time_s, other_time_s))
    a = np.asarray(reference, dtype=float).reshape(len(ta), -1)
    b = np.asarray(other, dtype=float).reshape(len(tb), -1)
    known_a, known_b = np.isfinite(a).all(axis=1), np.isfinite(b).all(axis=1)
    ta, a, tb, b = ta[known_a], a[known_a], tb[known_b], b[known_b]
    if min(len(ta), len(tb)) < _MIN_FRAMES:
        raise InputError("too few frames show the motion in both recordings")
    if not ((np.diff(ta) > 0).all() and (np.diff(tb) > 0).all()):
        raise InputError("the frames' times must grow from each to the next")
    if not (np.ptp(a, axis=0).max() > 0 and np.ptp(b, axis=0).max() > 0):
        raise InputError("nothing moves: the recordings cannot be brought into step")
    curve = _smooth_curve(ta, a)
    step = float(np.median(np.diff(tb)))
    as_often = curve(np.arange(ta[0], ta[-1], step))
    return _Pair(curve, float(ta[0]), float(ta[-1]), tb, b, _memory(as_often, b))


def _smooth_curve(time_s: Floats, values: Floats) -> BSpline:
    """Through values (T, K), as smooth as generalised cross-validation finds them.

    A curve through every value is less noisy between frames than at them: the fit would lean
    towards offsets of half a frame.
    """
    # the search for the smoothness is made for steps of about 1
    step = float(np.median(np.diff(time_s)))
    columns = [make_smoothing_spline(time_s / step, column) for column in values.T]
    knots, degree = columns[0].t * step, columns[0].k
    return BSpline(knots, np.stack([c.c for c in columns], axis=1), degree)


def _memory(x: Floats, y: Floats) -> float:
    """Frames of x (N, K) and y (M, L) that count as one, where they are set against each other.

    Bartlett: n samples of two unrelated series tell of their correlation what n over this
    would if each were independent.
    """
    n = min(len(x), len(y)) // 2
    product = _autocorrelation(x)[:n] * _autocorrelation(y)[:n]
    taper = 1 - np.arange(1, n) / min(len(x), len(y))
    return float(max(1 + 2 * (product[1:] * taper).sum(), 1.0))


def _autocorrelation(x: Floats) -> Floats:
    """Of all columns together, (N,); 1 at lag 0."""
    y = x - x.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(y, 2 * len(y), axis=0)) ** 2
    found = np.fft.irfft(spectrum.sum(axis=1), 2 * len(y))[: len(y)]
    return np.asarray(found / max(float(found[0]), 1e-300))


def _lowest(pair: _Pair, offsets: Floats, scores: Floats, i: int) -> float:
    """The offset that leaves least near one of a grid."""
    near = [k for k in (i - 1, i, i + 1) if 0 <= k < len(offsets) and np.isfinite(scores[k])]
    if len(near) < 3:
        raise InputError(
            f"the motions fit best at the largest overlap or offset that is tried "
            f"({offsets[i]:.2f} s): longer recordings, or a larger offset, are needed"
        )
    fine = optimize.minimize_scalar(
        pair.left, bounds=(offsets[i - 1], offsets[i + 1]), method="bounded",
        options={"xatol": 1e-6},
    )  # fmt: skip
    return float(fine.x)


def _with_drift(pair: _Pair, offset: float, step: float) -> tuple[float, float]:
    """Offset and drift that leave least."""
    middle = float(pair.time_s.mean())

    def cost(p: Floats) -> float:
        return pair.left(offset + p[0] * step - p[1] * 1e-5 * middle, p[1] * 1e-5)

    found = optimize.minimize(
        cost, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-12}
    )
    drift = float(found.x[1]) * 1e-5
    return offset + float(found.x[0]) * step - drift * middle, drift


def _refuse_chance(pair: _Pair, offset: float, drift: float) -> None:
    """So smooth a motion, or so short an overlap, that almost any two could be laid together."""
    found = pair.rest(offset, drift)
    assert found is not None
    residual = found[0]
    if pair.spare(len(residual)) * pair.seen.shape[1] >= _LEAST_SPARE:
        return
    raise InputError(
        f"the motion is too short or too smooth to bring the recordings into step: "
        f"{len(residual)} frames in common hold {len(residual) / pair.memory:.0f} independent "
        "pieces of it; move longer and more unevenly"
    )


def _refuse_rivals(
    pair: _Pair, offset: float, drift: float, offsets: Floats, apart: Floats
) -> None:
    """Another offset, apart from the best by a rise between them, is nearly as likely.

    Parameters
    ----------
    offsets, apart : (N,) float64
        What is left unexplained there, without allowance: what is repeated is repeated as well
        where fewer frames overlap. Infinite for offsets that are not apart.
    """
    if not np.isfinite(apart).any():
        raise InputError(
            "the motion fits at many offsets alike: it is too slow to bring the recordings into "
            "step; move faster and more unevenly"
        )
    rival, unexplained = _best_rival(pair, drift, offsets, apart)
    found = pair.rest(offset, drift)
    assert found is not None
    pieces = len(found[0]) / _memory(found[0], found[0])
    worse = unexplained / max(pair.share(offset, drift)[0], 1e-300)
    if worse < _LEAST_WORSE or pieces * np.log(worse) < _LEAST_LIKELIER:
        raise InputError(
            f"the motions fit about as well at {rival:.2f} s as at {offset:.2f} s: one "
            "does not show the other, or it repeats itself; move longer and more unevenly"
        )


def _best_rival(pair: _Pair, drift: float, offsets: Floats, apart: Floats) -> tuple[float, float]:
    """The rival offset that leaves least, between those tried, and what it leaves."""
    padded = np.concatenate([[np.inf], apart, [np.inf]])
    is_low = np.isfinite(apart) & (apart <= padded[:-2]) & (apart <= padded[2:])
    lows = np.flatnonzero(is_low)
    found = []
    for i in lows[np.argsort(apart[lows])][:_MOST_RIVALS]:
        found.append((float(apart[i]), float(offsets[i])))
        if np.isfinite(padded[[i, i + 2]]).all():
            fine = optimize.minimize_scalar(
                lambda o: pair.share(o, drift)[0], bounds=(offsets[i - 1], offsets[i + 1]),
                method="bounded", options={"xatol": 1e-5},
            )  # fmt: skip
            found.append((float(fine.fun), float(fine.x)))
    unexplained, rival = min(found)
    return rival, unexplained


def _beyond_the_rise(scores: Floats, i: int) -> NDArray[np.bool_]:
    """Which of a grid's scores lie beyond the first that is not above its inner neighbour."""
    low, high = i, i
    while low > 0 and scores[low - 1] > scores[low]:
        low -= 1
    while high < len(scores) - 1 and scores[high + 1] > scores[high]:
        high += 1
    apart = np.isfinite(scores)
    apart[low : high + 1] = False
    return apart


def _sd(pair: _Pair, offset: float, drift: float) -> float:
    """Standard deviation of the offset, s, whatever the residuals' memory and likeness.

    The estimate moves by sum(slope . residual) / sum(slope^2), slopes without what the gains can
    take up; the variance of that sum follows from the covariances of both at all lags.
    """
    found = pair.rest(offset, drift)
    assert found is not None
    residual, slope, basis = found
    slope = slope - basis @ np.linalg.lstsq(basis, slope, rcond=None)[0]
    n, size = len(residual), float((slope**2).sum())
    if not size > 0:
        return float("nan")
    white = float((residual.T @ residual * (slope.T @ slope)).sum())
    whole = white
    for lag in range(1, min(n // 2, round(_LAGS * pair.memory))):
        R, G = residual[:-lag].T @ residual[lag:], slope[:-lag].T @ slope[lag:]
        whole += 2 * (1 - lag / n) * float((R * G).sum())
    freedom = max(n - basis.shape[1], 1)
    return float(np.sqrt(max(whole, white) / freedom) / size)
