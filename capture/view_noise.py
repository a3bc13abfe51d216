"""How sure a solution is when the errors of one view go together.

Neighbouring corners of a picture share what displaced them: light that falls off across the board,
blur, the codec's blocks. Their errors are then no independent draws, a view is worth fewer points
than it has, and the inverse of the information promises too much. What a view's errors together
pull at the parameters (its score) is known after the fit; from view to view scores are
independent, so their spread is the truth that the information only supposes.

With H the information and s_k the score of view k, the covariance is H⁻¹ (Σ s_k s_kᵀ) H⁻¹ (White
1980; Liang & Zeger 1986). Each fit takes part of its own errors away: scores are enlarged for it
so that independent errors give σ² H⁻¹ again, exactly in the mean (Bell & McCaffrey 2002). Few
views tell a large matrix badly: the result is drawn towards a multiple of H⁻¹ as far as its own
scatter asks; and where scores are no larger than independent errors may well make them, errors are
taken as independent.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .bundle import Bundle, covariance_of, root_of, target_parts

Floats = NDArray[np.float64]
#: Below so many degrees of freedom views do not tell how their errors go together.
LEAST_FREEDOM = 20.0
#: Independent errors are taken to go together in this share of calibrations.
FALSE_ALARM = 0.05
#: What a fit takes of a view's errors is made good up to this share.
_MOST_TAKEN = 0.95
#: Found with simulated rigs of four, 24 and 60 views, whose errors shift, shear or bend each view.
_DRAWN = 0.5


def covariance_by_view(fit: Bundle) -> Floats:
    """Covariance of a solution's global parameters, where only views are independent.

    Parameters
    ----------
    fit : Bundle
        Its targets are the views: what all cameras saw of a target at one moment.

    Returns
    -------
    (G, G) float64
        For a variance factor of 1, as `bundle.covariance_of` gives it for independent errors; the
        same as that where errors may well be independent, or there are too few views to tell.
    """
    from scipy.stats import chi2

    covariance = covariance_of(fit.information)
    variance = fit.variance_factor
    if not len(covariance) or not (np.isfinite(variance) and variance > 0):
        return covariance
    root = root_of(covariance)
    scores, freedom, trace = _scores(fit, root)
    scores = scores / np.sqrt(variance)
    if not (trace > 0 and freedom >= LEAST_FREEDOM):
        return covariance
    larger = float((scores**2).sum()) / trace
    if larger * freedom <= chi2.ppf(1 - FALSE_ALARM, freedom):
        return covariance
    spread = _drawn_to_unit(scores, larger, root)
    return np.asarray(root @ spread @ root.T)


def _scores(fit: Bundle, root: Floats) -> tuple[Floats, float, float]:
    """Scores in the coordinates in which the information is the unit matrix, (L, G).

    Also the degrees of freedom of the sum of their squares, and its mean for independent errors.
    """
    scores, means, variances = [], 0.0, 0.0
    for score, information in _of_views(fit):
        involved = np.flatnonzero(np.diag(information) > 0)
        U = root[involved].T @ root_of(information[np.ix_(involved, involved)])
        directions, sizes, _ = np.linalg.svd(U, full_matrices=False)
        taken = sizes**2  # the share of each direction's information that is this view's
        left = 1 - np.minimum(taken, _MOST_TAKEN)
        s = root.T @ score
        along = directions.T @ s
        scores.append(s + directions @ (along * (1 / np.sqrt(left) - 1)))
        means += float((taken * (1 - taken) / left).sum())
        variances += float(((taken * (1 - taken) / left) ** 2).sum())
    return np.array(scores), means**2 / max(variances, 1e-300), means


def _of_views(fit: Bundle) -> Iterator[tuple[Floats, Floats]]:
    """Each view's score and information of the global parameters, its pose eliminated."""
    for k, part in enumerate(target_parts(fit)):
        to_pose = fit.mixed_information[k] @ np.linalg.pinv(
            fit.target_information[k], hermitian=True
        )
        yield part.g - to_pose @ part.g_target, part.H - to_pose @ fit.mixed_information[k].T


def _drawn_to_unit(scores: Floats, larger: float, root: Floats) -> Floats:
    """The sum of outer products, (G, G), less its scatter.

    The unit matrix times `larger` would enlarge all variances alike; the sum itself tells which
    are enlarged how much, but each from few views. For single parameters so much of the first is
    best as their enlargements differ by scatter alone (empirical Bayes). What many parameters
    make together, such as the bend of space at a face, averages scatter out and is best without.
    `_DRAWN` of it leaves single parameters true, a face's millimetres some 5 to 10 % too unsure,
    and no direction without variance.
    """
    length = np.linalg.norm(root, axis=1)
    ways = root[length > 0] / length[length > 0, None]
    parts = (scores @ ways.T) ** 2  # (L, P): of each parameter's enlargement
    enlarged = parts.sum(axis=0)
    scatter = float((parts**2).sum(axis=0).mean()) * 2 / 3  # Gaussian: the variance of a square
    differ = float(((enlarged - larger) ** 2).mean())
    share = _DRAWN * (min(scatter / differ, 1.0) if differ > 0 else 1.0)
    return np.asarray(share * larger * np.eye(len(root)) + (1 - share) * scores.T @ scores)
