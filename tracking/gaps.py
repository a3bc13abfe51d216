"""Short gaps in trajectories, filled and flagged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from ..core.trajectories import Source, Trajectories

DEFAULT_MAX_GAP_S = 0.1  # speech turns round in less than twice that
_SUPPORT = 8  # samples on each side that shape the curve


def fill_gaps(trajectories: Trajectories, *, max_gap_s: float = DEFAULT_MAX_GAP_S) -> Trajectories:
    """Fill gaps up to a length by cubic splines through the neighbours; flag what was filled.

    Gaps at the ends of the take and longer ones stay NaN: nothing is extrapolated.

    Parameters
    ----------
    trajectories : Trajectories
    max_gap_s : float
        Longest gap, from the last sample before to the first after it.
    """
    t = trajectories.time_s
    positions = np.array(trajectories.positions)
    source = np.array(trajectories.source)
    for m in range(len(trajectories.names)):
        known = np.flatnonzero(~np.isnan(positions[:, m, 0]))
        original = positions[:, m].copy()
        for left, right in pairwise(known):
            if right == left + 1 or t[right] - t[left] > max_gap_s + 1e-9:
                continue
            at = np.searchsorted(known, left)
            near = known[max(0, at - _SUPPORT + 1) : at + _SUPPORT + 1]
            spline = CubicSpline(t[near], original[near], bc_type="natural")
            inside = np.arange(left + 1, right)
            positions[inside, m] = spline(t[inside])
            source[inside, m] = Source.INTERPOLATED
    return Trajectories(
        t,
        trajectories.names,
        positions,
        trajectories.covariances,
        source,
        trajectories.residual_px,
        trajectories.n_views,
    )
