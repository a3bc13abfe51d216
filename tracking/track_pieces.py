"""Tracks cut where they jump, and joined again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NOBODY = -1
#: A step is a jump if it exceeds the neighbouring steps so many times, and this besides.
_JUMP_MM, _JUMP_FACTOR = 3.0, 2.5


def cut_at_jumps(x: Floats) -> tuple[Floats, Ints]:
    """Tracks cut where they jump as no skin does: (T, K', 3) pieces, and of which track each is.

    A step stands out if it is far longer than the steps before and after it; all steps are taken
    against the median of all tracks at that time, which is the head's.
    """
    T, K = x.shape[:2]
    head = np.zeros((T, 3))
    if T > 1:
        steps = np.diff(x, axis=0)
        with_any = ~np.isnan(steps[..., 0]).all(axis=1)
        head[1:][with_any] = np.nanmedian(steps[with_any], axis=1)
    still = x - np.cumsum(head, axis=0)[:, None]
    parts: list[tuple[int, Ints]] = []
    for k in range(K):
        frames = np.flatnonzero(~np.isnan(x[:, k, 0]))
        parts += [(k, part) for part in np.split(frames, _jumps(still[frames, k], frames))]
    pieces = np.full((T, len(parts), 3), np.nan)
    for i, (k, frames) in enumerate(parts):
        pieces[frames, i] = x[frames, k]
    return pieces, np.array([k for k, _ in parts], dtype=np.int64)


def _jumps(p: Floats, frames: Ints) -> Ints:
    """Indices of samples that begin anew."""
    if len(p) < 3:
        return np.zeros(0, dtype=np.int64)
    step = np.linalg.norm(np.diff(p, axis=0), axis=1)
    pace = np.pad(step / np.diff(frames), 1)
    usual = np.maximum(pace[:-2], pace[2:])
    is_jump = step > (_JUMP_MM + _JUMP_FACTOR * usual) * np.diff(frames)
    return np.flatnonzero(is_jump) + 1


def labels_of_pieces(pieces: Floats, first: Ints, of_track: Ints, start: int) -> Ints:
    """Labels of tracks as those of their pieces nearest to a frame."""
    seen = ~np.isnan(pieces[..., 0])
    away = np.where(seen, np.abs(np.arange(len(seen)) - start)[:, None], len(seen)).min(axis=0)
    found = np.full(len(of_track), NOBODY, dtype=np.int64)
    for k in np.flatnonzero(first >= 0):
        own = np.flatnonzero(of_track == k)
        found[own[away[own].argmin()]] = first[k]
    return found


def joined_pieces(label: Ints, of_track: Ints, n_tracks: int) -> Ints:
    """(T, K) labels of tracks from those of their pieces."""
    found = np.full((len(label), n_tracks), NOBODY, dtype=np.int64)
    t, i = np.nonzero(label >= 0)
    found[t, of_track[i]] = label[t, i]
    return found
