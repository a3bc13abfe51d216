"""What the other markers say about one that is missing.

A gap of a marker is a stretch of frames with known samples on both sides. Two things fill it:

1. *Regression.* How far the marker leaves the straight line between the gap's ends is a linear
   function of how far the other markers leave theirs. The weights are learnt from stretches of the
   same length in which the marker was seen, by ridge regression in the face frame. Near markers
   may count more than far ones. The ridge makes it low rank in effect: directions in which the
   other markers hardly move get no weight.
2. *Kriging.* What regression leaves over is smooth in time, and it is known on both sides. Its
   variogram, measured on stretches that the regression did not learn from, gives the most likely
   course between the two sides (so the ends are tied, with the right slope), and its variance.

Matheron 1963, Principles of geostatistics (ordinary kriging); Hoerl & Kennard 1970 (ridge).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Floats = NDArray[np.float64]

#: Time scales of the residual's variogram, s; between a frame and longer than any gap.
_SCALES_S = (0.04, 0.08, 0.15, 0.3, 0.6, 1.2, 2.4, 5.0)
#: A marker this far away counts half as much (in variance) as one beside the gap's.
_NEAR_MM = 45.0
#: Noise, mm², that the ridge takes predictors to have; the best by cross-validation is used.
_RIDGES = (0.01, 0.03, 0.1, 0.3)
_FOLDS = 5
_POSITIONS = 8  # of a stretch that regression learns from
_MAX_STRETCHES = 300
_MIN_STRETCHES = 8
#: Largest share of a stretch's predictors that may be bridged rather than seen: none, unless too
#: few stretches are left to learn from.
_BRIDGED = (0.0, 0.2)
#: Frames beside the gap that kriging ties the curve to, counted from its ends.
_TIES = np.array([0, 1, 2, 4, 7, 11])
_LAGS = 14


@dataclass(frozen=True, eq=False)
class Run:
    """A stretch of time in which a face was seen, in the face frame.

    Attributes
    ----------
    time_s : (T,) float64, s
    bridged : (T, M, 3) float64, mm
        Without NaN but for markers never seen.
    known : (T, M) bool
        Where that was seen rather than bridged.
    """

    time_s: Floats
    bridged: Floats
    known: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class GapFit:
    """Positions in a gap, (L, 3) mm, face frame, and their covariances, (L, 3, 3) mm²."""

    positions: Floats
    covariances: Floats


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Training stretches: departures from straight lines, and where they come from.

    `x` is (n, P, D), `y` (n, P, 3), `fold` (n,), `places` (run, frame before the stretch) of each,
    `length` in frames. Residuals count where the predictors `needed` were seen too.
    """

    x: Floats
    y: Floats
    fold: NDArray[np.int64]
    places: list[tuple[int, int]]
    length: int
    needed: NDArray[np.int64]

    def blocks(self) -> list[tuple[int, int, int, int]]:
        """Frames (run, first, end) that each fold's stretches cover, with the fold."""
        found: list[tuple[int, int, int, int]] = []
        for (run, first), f in zip(self.places, self.fold.tolist(), strict=True):
            end = first + self.length + 2
            if found and found[-1][0] == run and found[-1][3] == f and first < found[-1][2]:
                found[-1] = (run, found[-1][1], end, f)
            else:
                found.append((run, first, end, f))
        return found


def fit_gap(
    runs: Sequence[Run],
    here: Run,
    marker: int,
    predictors: NDArray[np.int64],
    first: int,
    end: int,
    rest: Floats,
) -> GapFit | None:
    """Fill frames `first` to `end` (exclusive) of a marker; None if too little was seen to learn.

    Parameters
    ----------
    runs : sequence of Run
        To learn from.
    here : Run
        The one with the gap; the marker must be known just before and after it, the predictors
        there and within.
    marker : int
    predictors : (P,) int
        Other markers.
    first, end : int
    rest : (M, 3) float64, mm
        Usual places, for distances between markers.
    """
    apart = np.linalg.norm(rest[predictors] - rest[marker], axis=1)
    near = 1 / np.sqrt(1 + (apart / _NEAR_MM) ** 2)
    counts = np.repeat(near, 3)

    def inputs(run: Run) -> Floats:
        moved = run.bridged[:, predictors] - rest[predictors]
        return np.asarray(moved.reshape(len(moved), -1) * counts)

    features = [inputs(run) for run in runs]
    stretches = _learnt_from(runs, features, marker, predictors, end - first)
    if stretches is None:
        return None
    W, of_folds = _ridge(stretches)
    left_over = _Residuals(runs, features, marker, stretches, of_folds)
    coefficients = left_over.variogram()
    if coefficients is None:
        return None
    scale = left_over.tried(coefficients)
    x = inputs(here)
    ties = _tie_frames(here, marker, predictors, first, end)
    weights, variance = _krige(here.time_s, ties, np.arange(first, end), coefficients)
    known = here.bridged[ties, marker] - x[ties] @ W
    positions = x[first:end] @ W + weights.T @ known
    return GapFit(positions, variance[:, None, None] * scale)


def _learnt_from(
    runs: Sequence[Run],
    features: Sequence[Floats],
    marker: int,
    predictors: NDArray[np.int64],
    length: int,
) -> _Stretches | None:
    """Stretches as long as the gap, or, where there are too few of them, half, a quarter …

    Rather a quarter with all predictors seen than as long with some bridged: straight lines
    where faces move spoil what is learnt of the errors.
    """
    lengths = [length >> halved for halved in range(length.bit_length())]
    for bridged in _BRIDGED:
        for shorter in lengths[:3] if bridged == 0 else lengths:
            found = _stretches(runs, features, marker, predictors, shorter, bridged)
            if found is not None:
                return found
    return None


def _stretches(
    runs: Sequence[Run],
    features: Sequence[Floats],
    marker: int,
    predictors: NDArray[np.int64],
    length: int,
    bridged: float,
) -> _Stretches | None:
    at = np.unique(np.linspace(0, length - 1, _POSITIONS).round().astype(np.int64))
    total = sum(len(run.time_s) for run in runs)
    step = max(length // 6, total // _MAX_STRETCHES, 1)
    xs, ys, places = [], [], []
    for r, (run, x) in enumerate(zip(runs, features, strict=True)):
        starts = np.arange(1, len(run.time_s) - length, step)
        if not len(starts):
            continue
        rows = np.column_stack([starts - 1, starts[:, None] + at, starts + length])
        seen = run.known[rows, marker].all(axis=1)
        if len(predictors):
            seen &= run.known[rows][..., predictors].mean(axis=(1, 2)) >= 1 - bridged
        rows = rows[seen]
        xs.append(_departures(x[rows], at, length))
        ys.append(_departures(run.bridged[rows, marker], at, length))
        places += [(r, int(row[0])) for row in rows]
    if len(places) < _MIN_STRETCHES:
        return None
    fold = np.arange(len(places)) * _FOLDS // len(places)
    needed = predictors if bridged == 0 else predictors[:0]
    return _Stretches(np.concatenate(xs), np.concatenate(ys), fold, places, length, needed)


def _departures(values: Floats, at: NDArray[np.int64], length: int) -> Floats:
    """From the straight line between first and last of (n, 1 + P + 1, D): (n, P, D)."""
    share = ((at + 1) / (length + 1))[:, None]
    return np.asarray(values[:, 1:-1] - values[:, :1] * (1 - share) - values[:, -1:] * share)


def _ridge(stretches: _Stretches) -> tuple[Floats, list[Floats]]:
    """Weights (D, 3) learnt from all stretches, and from all but each fold, at the best ridge."""
    D = stretches.x.shape[2]
    folds = range(_FOLDS)
    rows = [stretches.fold == f for f in folds]
    x = [stretches.x[r].reshape(-1, D) for r in rows]
    y = [stretches.y[r].reshape(-1, 3) for r in rows]
    gram, moment = [a.T @ a for a in x], [a.T @ b for a, b in zip(x, y, strict=True)]
    all_gram, all_moment, n = sum(gram, np.zeros((D, D))), sum(moment), sum(len(a) for a in x)
    best: tuple[float, float, list[Floats]] | None = None
    for ridge in _RIDGES:
        of_folds, error = [], 0.0
        for f in folds:
            damped = all_gram - gram[f] + ridge * (n - len(x[f])) * np.eye(D)
            of_folds.append(np.linalg.solve(damped, all_moment - moment[f]))
            error += float(((y[f] - x[f] @ of_folds[-1]) ** 2).sum())
        if best is None or error < best[0]:
            best = error, ridge, of_folds
    assert best is not None
    W = np.linalg.solve(all_gram + best[1] * n * np.eye(D), all_moment)
    return np.asarray(W), best[2]


@dataclass(frozen=True, eq=False)
class _Residuals:
    """What regression leaves over, in frames that the weights used did not learn from."""

    runs: Sequence[Run]
    features: Sequence[Floats]
    marker: int
    stretches: _Stretches
    of_folds: Sequence[Floats]

    def at(self, run: int, rows: NDArray[np.int64], fold: int) -> Floats:
        """(..., 3) mm at frames of a run; NaN where not all was seen."""
        left = self.runs[run].bridged[rows, self.marker]
        left = left - self.features[run][rows] @ self.of_folds[fold]
        asked = [self.marker, *self.stretches.needed]
        known = np.asarray(self.runs[run].known[rows][..., asked].all(axis=-1))
        return np.asarray(np.where(known[..., None], left, np.nan))

    def variogram(self) -> Floats | None:
        """Weights (K,), mm², of the unit variograms whose sum fits best."""
        pieces = [
            (self.at(run, np.arange(first, end), fold), self.runs[run].time_s[first:end])
            for run, first, end, fold in self.stretches.blocks()
        ]
        longest = max(len(left) for left, _ in pieces)
        lags = np.unique(np.geomspace(1, max(longest // 2, 2), _LAGS).round().astype(np.int64))
        apart_s, gamma = [], []
        for lag in lags:
            steps = [left[lag:] - left[:-lag] for left, _ in pieces if len(left) > lag]
            if not steps:
                continue
            d = np.concatenate(steps)
            h = np.concatenate([t[lag:] - t[:-lag] for _, t in pieces if len(t) > lag])
            ok = ~np.isnan(d[:, 0])
            if ok.sum() >= _MIN_STRETCHES:
                apart_s.append(float(np.median(h[ok])))
                gamma.append(max(float((d[ok] ** 2).sum() / ok.sum() / 2), 1e-12))
        if not gamma:
            return None
        relative = _variogram(np.array(apart_s)).T / np.array(gamma)[:, None]
        found, _ = nnls(relative, np.ones(len(gamma)))
        return np.asarray(found)

    def tried(self, coefficients: Floats) -> Floats:
        """Kriging tried on the stretches: errors' second moment over the variance promised, (3, 3).

        A variogram tells little of how smooth curves are between frames, on which the variance
        hangs. Where no stretch has room for the ties, promises are taken as they are.
        """
        length = self.stretches.length
        ties = np.concatenate([-1 - _TIES[::-1], length + _TIES])
        inside = np.unique(np.linspace(0, length - 1, _POSITIONS).round().astype(np.int64))
        moment, promised = np.zeros((3, 3)), 0.0
        for (run, before), fold in zip(
            self.stretches.places, self.stretches.fold.tolist(), strict=True
        ):
            rows = before + 1 + ties
            if rows[0] < 0 or rows[-1] >= len(self.runs[run].time_s):
                continue
            time_s = self.runs[run].time_s
            weights, variance = _krige(time_s, rows, before + 1 + inside, coefficients)
            error = self.at(run, before + 1 + inside, fold) - weights.T @ self.at(run, rows, fold)
            if not np.isnan(error).any():
                moment += error.T @ error
                promised += float(variance.sum())
        if promised <= 0:
            return np.eye(3) / 3
        return np.asarray(moment / promised)


def _variogram(apart_s: Floats) -> Floats:
    """Unit variograms at time differences, (K, ...): Matérn 3/2 and Gaussian kernels."""
    h = np.abs(apart_s)[None]
    scale = np.reshape(_SCALES_S, (-1, *(1,) * np.ndim(apart_s)))
    a = np.sqrt(3) * h / scale
    return np.concatenate([1 - (1 + a) * np.exp(-a), 1 - np.exp(-0.5 * (h / scale) ** 2)])


def _tie_frames(
    here: Run, marker: int, predictors: NDArray[np.int64], first: int, end: int
) -> NDArray[np.int64]:
    """Known frames beside the gap; the two nearest always."""
    wanted = np.concatenate([first - 1 - _TIES, end + _TIES])
    wanted = wanted[(wanted >= 0) & (wanted < len(here.time_s))]
    usable = here.known[wanted, marker] & here.known[wanted][:, predictors].all(axis=1)
    usable |= (wanted == first - 1) | (wanted == end)
    return np.sort(wanted[usable])


def _krige(
    time_s: Floats, ties: NDArray[np.int64], inside: NDArray[np.int64], coefficients: Floats
) -> tuple[Floats, Floats]:
    """Ordinary kriging weights (ties, inside) and variances (inside,), mm² in all."""
    n = len(ties)
    at, to = time_s[ties], time_s[inside]
    A = np.ones((n + 1, n + 1))
    A[:n, :n] = np.tensordot(coefficients, _variogram(at[:, None] - at[None]), 1)
    A[n, n] = 0.0
    A[np.arange(n), np.arange(n)] -= 1e-7 * coefficients.sum() + 1e-12  # smooth kernels: stiff
    b = np.ones((n + 1, len(inside)))
    b[:n] = np.tensordot(coefficients, _variogram(at[:, None] - to[None]), 1)
    solution = np.linalg.solve(A, b)
    return np.asarray(solution[:n]), np.maximum((solution * b).sum(axis=0), 0.0)
