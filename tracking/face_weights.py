"""ARKit weights of a face's expressions: bounded, smooth without lag, zero at rest.

The expression c of each frame and the network's own scores are two measurements of the weights w,

    c = A w + e₁,   scores − scores at rest = G w + e₂,

whose maps and covariances were learnt on renders (`landmark_noise`). Minimised over all frames at
once with 0 ≤ w ≤ 1 by `heads.bounded_paths`, with a small price on every weight, so that few are
used, and on second differences; lids pay none of the latter, so that a blink keeps its height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..heads.bounded_paths import second_differences, solve_paths
from .landmark_noise import LandmarkModel

Floats = NDArray[np.float64]
#: Spread that weights have around 0, and the price of each, in the measurements' units.
_WEIGHT_SD, _PRICE = 0.5, 0.5
#: Of scores: they are no measurement of their own, but another look at the same landmarks.
_SCORE_SHARE = 0.25
_SMOOTH_S = 0.02
_LIDS = ("eyeBlink", "eyeWide", "eyeSquint", "eyeLook")


def expression_weights(
    model: LandmarkModel, time_s: Floats, c: Floats, cov: Floats, scores: Floats | None
) -> Clip:
    """Weights of the expressions of a clip.

    Parameters
    ----------
    model : LandmarkModel
    time_s : (T,) float64, s
    c : (T, K) float64
        NaN in frames without a face: they are bridged, and not set in the result.
    cov : (K, K) float64
        Of the errors of c, of a usual frame.
    scores : (T, 52) float64 or None
        Changes of the scores from the neutral face.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(c).all(axis=1))
    gram, pull = _normal(model, np.where(known[:, None], c, 0.0), cov, scores)
    pull[~known] = np.nan
    for column in pull.T:
        column[~known] = np.interp(time_s[~known], time_s[known], column[known])
    lids = np.array([n.startswith(_LIDS) for n in model.weight_names])
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    smooth = float(np.median(np.diag(gram)[~lids])) * (_SMOOTH_S / step_s) ** 4
    rows = second_differences(time_s)
    found = solve_paths(gram, pull - _PRICE, np.ones_like(pull), rows, smooth).values
    quick = solve_paths(gram, pull - _PRICE, np.ones_like(pull), rows, 0.0).values
    values = np.where(lids, quick, found)
    values = np.where(known[:, None], values, np.nan)
    return Clip(time_s, model.weight_names, values)


def _normal(
    model: LandmarkModel, c: Floats, cov: Floats, scores: Floats | None
) -> tuple[Floats, Floats]:
    """Hessian (52, 52) and pull (T, 52)."""
    A, G = model.weights_to_c, model.score_gain
    P = np.linalg.inv(cov + model.c_of_weights_cov)
    gram = A @ P @ A.T + np.eye(len(A)) / _WEIGHT_SD**2
    pull = c @ P @ A.T
    if scores is not None:
        S = _SCORE_SHARE * np.linalg.inv(model.score_cov)
        seen = np.where(np.isfinite(scores), scores, 0.0)
        gram = gram + G @ S @ G.T
        pull = pull + seen @ S @ G.T
    return gram, pull
