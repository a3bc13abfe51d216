"""Which points agree with a fit, and which are wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Noise alone throws a good point out in one of so many calibrations.
FALSE_ALARM = 1e-3
_MIN_VARIANCE = 1e-18  # px²: data without noise


def agreeing_points(
    residuals: Floats,
    jacobian: Floats,
    used: NDArray[np.bool_],
    sd_px: float | None,
    *,
    least: int,
) -> NDArray[np.bool_]:
    """Points whose residual is no larger than noise and the fit's own uncertainty allow.

    Parameters
    ----------
    residuals : (N, 2) float64, px
        Seen minus projected, under a least squares fit of the `used` points.
    jacobian : (N, 2, P) float64
        Derivatives of the projections by the fit's parameters.
    used : (N,) bool
    sd_px : float or None
        Standard deviation of a coordinate; None takes it from the used points' residuals.
    least : int
        That many, the best, are kept in any case.

    Returns
    -------
    (N,) bool

    References
    ----------
    Baarda 1968 (data snooping): a residual's own variance is the noise's less what the fit took
    of it, or, for a point that was left out, plus what the fit is unsure of.
    """
    from scipy.stats import chi2, f

    n, n_used = len(residuals), int(used.sum())
    J = jacobian[used].reshape(2 * n_used, -1)
    covariance = np.linalg.pinv(J.T @ J, hermitian=True)
    spread = np.einsum("nij,jk,nlk->nil", jacobian, covariance, jacobian)
    freedom = 2 * n_used - J.shape[1]
    if sd_px is not None:
        variance = sd_px**2
    else:
        variance = float((residuals[used] ** 2).sum()) / max(freedom, 1)
        variance *= _trimmed_factor(n_used / n)
    C = np.eye(2) + np.where(used, -1.0, 1.0)[:, None, None] * spread
    # a point that alone holds a parameter cannot be judged
    C = np.where((np.linalg.det(C) > 1e-6)[:, None, None], C, np.eye(2))
    z = np.einsum("ni,nij,nj->n", residuals, np.linalg.inv(C), residuals)
    z /= max(variance, _MIN_VARIANCE)
    level = 1 - FALSE_ALARM / n
    limit = chi2.ppf(level, 2) if sd_px is not None else 2 * f.ppf(level, 2, max(freedom, 1))
    now = z <= limit
    if now.sum() < least:
        now = z <= np.sort(z)[min(least, n) - 1]
    return np.asarray(now)


def _trimmed_factor(share: float) -> float:
    """Variance of a Gaussian in the plane over that of its inner `share`."""
    if share >= 1 - 1e-9:
        return 1.0
    half = -np.log(1 - share)  # r²/2 at the rim
    return float(1 / max(1 - half * (1 - share) / share, 0.05))
