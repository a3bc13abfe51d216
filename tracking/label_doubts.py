"""What is not delivered: samples that fit nowhere, or could be another marker's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from .constellation import MARGIN
from .face_view import FaceView, costs_as_labels
from .label_paths import CORRELATED

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_DELIVERED2 = 36.0  # squared Mahalanobis distance beyond which a sample fits nowhere
_SPIKE_MM, _SPIKE_FACTOR, _SPIKE_REACH = 2.0, 12.0, 6  # frames
_ALONE, _ALONE_GAP = 4, 1  # so few samples between gaps of as many frames are looked at
_AGAINST = 2.5  # a sample that by itself speaks so much for another name is refused
_MOST = 30.0  # what one sample can say for or against a name
_WINDOW = 15  # frames over which doubts are summed, to each side
_BLOCK = 256  # frames at a time: every marker is held against every other


def doubtful(label: Ints, view: FaceView) -> Bools:
    """(T, K): samples that do not fit in, or that could be another marker's."""
    T = len(label)
    is_doubtful = spikes(view)
    for start in range(0, T, _BLOCK):
        wide = slice(max(0, start - _WINDOW), min(T, start + _BLOCK + _WINDOW))
        block = slice(start, min(T, start + _BLOCK))
        inner = slice(block.start - wide.start, block.stop - wide.start)
        is_doubtful[block] |= _vague(view, wide)[inner]
    found = np.zeros(label.shape, bool)
    t, k = np.nonzero(label >= 0)
    found[t, k] = is_doubtful[t, label[t, k]]
    return found | _near_cuts(label, view)


def _vague(view: FaceView, frames: slice) -> Bools:
    """(n, M): markers whose sample, or time around it, another name explains about as well."""
    M = view.labelled.shape[1]
    all_labels = np.arange(M)
    # [t, a, b]: of label a's sample as label b
    cost = np.stack(
        [costs_as_labels(view, frames, view.labelled[frames, m]) for m in all_labels], axis=1
    )
    own = cost[:, all_labels, all_labels]
    there = ~np.isnan(own)
    own = np.where(there, own, 0.0)
    # exchanged with its rival where that is seen, or taking the rival's place where it is not
    mine = cost - own[:, :, None]
    theirs = np.where(there[:, None, :], np.swapaxes(cost, 1, 2) - own[:, None, :], 0.0)
    margin = np.where(there[:, :, None], mine + theirs, 0.0)
    margin[:, all_labels, all_labels] = np.inf
    width = 2 * _WINDOW + 1
    mean = uniform_filter1d(np.clip(margin, -_MOST, _MOST), width, axis=0, mode="constant")
    around = mean.min(axis=2) * (width / CORRELATED)
    far2 = 2 * own - view.log_det[frames]
    vague = (margin.min(axis=2) < -_AGAINST) | (around < MARGIN) | (far2 > _DELIVERED2)
    return np.asarray(there & vague)


def _near_cuts(label: Ints, view: FaceView) -> Bools:
    """(T, K): samples beside a change of identity that could as well lie on its other side."""
    found = np.zeros(label.shape, bool)
    for k in range(label.shape[1]):
        frames = np.flatnonzero(label[:, k] >= 0)
        own = label[frames, k]
        for cut in np.flatnonzero(np.diff(own)):
            before, after = frames[: cut + 1][::-1], frames[cut + 1 :]
            for side, mine, other in (
                (before, own[cut], own[cut + 1]),
                (after, own[cut + 1], own[cut]),
            ):
                side = side[: 2 * _WINDOW]
                costs = [view.own_costs(side, k, m) for m in (mine, other)]
                is_plain = costs[1] - costs[0] > MARGIN
                n_vague = int(is_plain.argmax()) if is_plain.any() else len(side)
                found[side[:n_vague], k] = True
    return found


def spikes(view: FaceView) -> Bools:
    """(T, M): samples that leave their marker's way for an instant, as strays do.

    What the others do not explain of a marker is held against its neighbours in time; how much of
    that is usual, each marker tells by itself.
    """
    off = view.labelled - view.prediction.mean
    found = np.zeros(off.shape[:2], bool)
    for m in range(off.shape[1]):
        frames = np.flatnonzero(~np.isnan(off[:, m, 0]))
        e = off[frames, m]
        found[_strays_alone(frames, e), m] = True
        if len(frames) < 3:
            continue
        share = ((frames[1:-1] - frames[:-2]) / (frames[2:] - frames[:-2]))[:, None]
        jump = np.linalg.norm(e[1:-1] - (1 - share) * e[:-2] - share * e[2:], axis=1)
        near = frames[2:] - frames[:-2] <= _SPIKE_REACH
        usual = np.median(jump)
        is_spike = near & (jump > max(_SPIKE_MM, _SPIKE_FACTOR * usual))
        # the neighbours of a spike are not spikes
        higher = np.pad(jump, 1)
        is_spike &= (jump >= 0.75 * higher[:-2]) & (jump >= 0.75 * higher[2:])
        found[frames[1:-1][is_spike], m] = True
    return found


def _strays_alone(frames: Ints, e: Floats) -> Ints:
    """Of a marker's frames, those few between gaps that agree with neither side's samples.

    A stray dot meets another's ray now and then, near where a hidden marker is.
    """
    ends = np.flatnonzero(np.diff(frames) > _ALONE_GAP) + 1
    found = [frames[:0]]
    for run in np.split(np.arange(len(frames)), ends):
        sides = [i for i in (run[0] - 1, run[-1] + 1) if 0 <= i < len(frames)] if len(run) else []
        if 0 < len(run) <= _ALONE:
            off = np.linalg.norm(e[run][:, None] - e[sides][None], axis=2)
            found.append(frames[run[off.min(axis=1, initial=np.inf) > _SPIKE_MM]])
    return np.concatenate(found)
