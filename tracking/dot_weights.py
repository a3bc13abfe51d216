"""How sure dots are, as their residuals tell, against what their pictures said.

A picture knows its sensor's noise and suspects what is hidden; it does not know what compression
did to a dot, nor how often its suspicions are true. The residuals of points that three or more
cameras see do. So the variance of a dot is found anew as a growing function of the stated one, and
points are solved once more with it: the weights are then those of the least variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from .triangulation import Points, Views, triangulate

Floats = NDArray[np.float64]

_BINS, _LEAST_IN_BIN = 16, 60
_ROUNDS = 4
_LEAST_KEPT = 0.02  # of a dot's variance; residuals that hold less say nothing of it
_CUT = 12.0  # squared residuals count up to so many times their bin's median
_LEAST_PX = 1e-6
#: A median of squares of two coordinates is this share of their mean.
_MEDIAN_SHARE = float(np.log(2.0))


@dataclass(frozen=True, eq=False)
class DotWeights:
    """Standard deviations as a function of the stated ones.

    Attributes
    ----------
    stated_px, true_px : (B,) float64, growing
        Between them on a double logarithmic scale; beyond the ends by the ends' factor.
    """

    stated_px: Floats
    true_px: Floats

    def of(self, stated_px: Floats) -> Floats:
        """What dots of stated standard deviations really have; NaN stays."""
        if not len(self.stated_px):
            return stated_px
        x, y = np.log(self.stated_px), np.log(self.true_px)
        log_sd = np.log(np.maximum(stated_px, _LEAST_PX))
        inside = np.interp(log_sd, x, y)
        below, above = np.minimum(log_sd - x[0], 0), np.maximum(log_sd - x[-1], 0)
        return np.asarray(np.exp(inside + below + above))


def learn_weights(views: Views, xy: Floats, sd_px: Floats, points: Points) -> DotWeights:
    """From the residuals of what a take's points were made of.

    Parameters
    ----------
    views : Views
    xy : (N, C, 2) float64, normalised
        Dots, NaN where there are none.
    sd_px : (N, C) float64
        Stated.
    points : Points
        Made of them; `used` says which.

    Returns
    -------
    DotWeights
        The stated ones, if too few points have three views.
    """
    found = DotWeights(np.zeros(0), np.zeros(0))
    rows = np.flatnonzero(points.used.sum(axis=1) >= 3)
    used = points.used[rows]
    if used.sum() < 2 * _LEAST_IN_BIN:
        return found
    xy, stated = np.where(used[..., None], xy[rows], np.nan), sd_px[rows]
    bins = _bins(stated[used])
    n_bins = int(bins.max()) + 1
    middles = np.array([np.median(stated[used][bins == b]) for b in range(n_bins)])
    counts = np.bincount(bins).astype(np.float64)
    for _ in range(_ROUNDS):
        sd = found.of(stated)
        solved = triangulate(views, xy, sd, tolerance_px=np.inf)
        squares, kept = (v[used] for v in _residuals(views, xy, sd, solved))
        variance = [_variance(squares[bins == b], kept[bins == b]) for b in range(n_bins)]
        logs = np.log(np.maximum(variance, _LEAST_PX**2))
        fitted = isotonic_regression(logs, weights=counts).x
        found = DotWeights(middles, np.exp(0.5 * fitted))
    return found


def _bins(stated: Floats) -> NDArray[np.int64]:
    """(n,) of alike deviations, each with so many dots that their residuals tell theirs."""
    log_sd = np.log(np.maximum(stated, _LEAST_PX))
    edges = np.linspace(log_sd.min(), log_sd.max() + 1e-9, _BINS + 1)
    fine = np.clip(np.searchsorted(edges, log_sd, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(fine, minlength=_BINS)
    group, held, of_fine = 0, 0, np.zeros(_BINS, np.int64)
    for b in range(_BINS):
        of_fine[b] = group
        held += int(counts[b])
        if held >= _LEAST_IN_BIN and counts[b + 1 :].sum() >= _LEAST_IN_BIN:
            group, held = group + 1, 0
    return np.asarray(of_fine[fine])


def _residuals(views: Views, xy: Floats, sd: Floats, points: Points) -> tuple[Floats, Floats]:
    """(N, C): squared residuals of one coordinate, px², and what share of variances is in them.

    That is 1 − h, with h the dot's leverage: how much of it the solution follows.
    """
    off = (views.normalised(points.positions) - xy) * views.focal_px[:, None]
    inverse = np.linalg.inv(points.information)
    q = np.einsum("cij,nj->nci", views.matrices[:, :, :3], points.positions)
    q = q + views.matrices[:, :, 3]
    place = q[..., :2] / q[..., 2:]
    P = views.matrices[:, :, :3]
    J = P[None, :, :2] - place[..., None] * P[None, :, 2:3]
    J = J * (views.focal_px[None, :] / q[..., 2])[..., None, None]
    leverage = np.einsum("ncia,nab,ncib->nc", J, inverse, J) / sd**2 / 2
    return np.asarray((off**2).sum(axis=-1) / 2), np.maximum(1 - leverage, 0.0)


def _variance(squares: Floats, kept: Floats) -> float:
    """Of dots whose residuals hold these shares of it; strays have no say."""
    told = kept > _LEAST_KEPT
    if not told.any():
        return float(squares.mean())
    ratio = squares[told] / kept[told]
    near = ratio <= _CUT * np.median(ratio) / _MEDIAN_SHARE
    return float(squares[told][near].sum() / kept[told][near].sum())
