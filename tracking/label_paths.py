"""Labels along each track: evidence summed over time, and one track a label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .face_view import FaceView, costs_as_labels
from .track_pieces import NOBODY

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STRAY_COST = 3 * float(np.log(100.0))  # of a sample that is nobody's: one in a cube of 100 mm
CORRELATED = 4.0  # frames; neighbours in time err alike, so evidence counts less
_SWITCH_COST, _SWITCH_IN_GAP_COST = 12.0, 6.0
_SWITCH_REACH_MM = 8.0  # changes of identity happen where two markers are this close
_MAX_FAR_COST = 20.0
_RIVALS_WINDOW = 15  # frames to each side in which two tracks of one name are compared
_PER_SAMPLE = 0.1  # what a sample more counts there


def along_tracks(label: Ints, view: FaceView) -> Ints:
    """(T, K) labels of each track over its time, by Viterbi's algorithm over its evidence."""
    found = np.full_like(label, NOBODY)
    for k in range(label.shape[1]):
        frames = np.flatnonzero(~np.isnan(view.tracks[:, k, 0]))
        if not len(frames):
            continue
        costs = costs_as_labels(view, frames, view.tracks[frames, k])
        # far tails are not what they seem: the face is not quite Gaussian
        costs = np.minimum(costs, 3 * STRAY_COST)
        costs = np.pad(costs, ((0, 0), (0, 1)), constant_values=STRAY_COST)
        found[frames, k] = _viterbi(costs, frames, view.prediction.mean[frames])
    return found


def _viterbi(costs: Floats, frames: Ints, places: Floats) -> Ints:
    """The cheapest labels (n,) of a track, −1 for nobody's.

    Parameters
    ----------
    costs : (n, M + 1) float64
        Of each sample as each label, and as nobody's.
    frames : (n,) int64
    places : (n, M, 3) float64, mm, head frame
        Where labels are expected.
    """
    n, L = costs.shape
    costs = costs / CORRELATED
    best = costs.argmin(axis=1)
    if (best == best[0]).all():
        return np.where(best == L - 1, NOBODY, best)
    gaps = np.diff(frames, prepend=frames[0] - 1) > 1
    total = costs[0].copy()
    back = np.zeros((n, L), dtype=np.int64)
    stay = np.arange(L)
    for i in range(1, n):
        price = _SWITCH_IN_GAP_COST if gaps[i] else _SWITCH_COST
        switch = np.full((L, L), price)
        apart = np.linalg.norm(places[i][:, None] - places[i][None], axis=2)
        far = np.minimum(0.5 * (apart / _SWITCH_REACH_MM) ** 2, _MAX_FAR_COST)
        switch[:-1, :-1] += far
        switch[stay, stay] = 0.0
        reached = total[:, None] + switch
        back[i] = reached.argmin(axis=0)
        total = reached[back[i], stay] + costs[i]
    path = np.empty(n, dtype=np.int64)
    path[-1] = total.argmin()
    for i in range(n - 1, 0, -1):
        path[i - 1] = back[i, path[i]]
    return np.where(path == L - 1, NOBODY, path)


def without_conflicts(label: Ints, view: FaceView) -> Ints:
    """Where two tracks have one name at one time, it is that one's which fits better."""
    found = label.copy()
    cost = np.full(label.shape, np.inf)
    t, k = np.nonzero(label >= 0)
    cost[t, k] = view.own_costs(t, k, label[t, k])
    for m in range(view.labelled.shape[1]):
        of_label = label == m
        for frame in np.flatnonzero(of_label.sum(axis=1) > 1):
            rivals = np.flatnonzero(of_label[frame])
            near = slice(max(0, frame - _RIVALS_WINDOW), frame + _RIVALS_WINDOW + 1)
            fit = [
                cost[near, r][of_label[near, r]].mean() - _PER_SAMPLE * of_label[near, r].sum()
                for r in rivals
            ]
            found[frame, np.delete(rivals, int(np.argmin(fit)))] = NOBODY
    return found
