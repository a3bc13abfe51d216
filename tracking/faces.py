"""Several faces before the cameras: whose markers are whose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ..core.trajectories import Trajectories

#: Markers of a face have a neighbour within this; other people's markers are farther.
_NEIGHBOUR_MM = 80.0
MIN_FACE = 6
_FRAMES = 60
_FAR_MM = 1e4


def split_faces(tracks: Trajectories) -> tuple[NDArray[np.int64], ...]:
    """Tracks, unlabelled, by the face that they are on.

    Neighbours are on one face; groups of fewer than six tracks go to the nearest face.

    Parameters
    ----------
    tracks : Trajectories

    Returns
    -------
    tuple of (n,) int64
        Indices of each face's tracks, the face that was seen most first; empty without one.
    """
    p, M = tracks.positions, len(tracks.names)
    n_seen = (~np.isnan(p[..., 0])).sum(axis=0)
    if M == 0:
        return ()
    d = _distances(p)
    _, group = connected_components(d < _NEIGHBOUR_MM, directed=False)
    groups = [np.flatnonzero(group == g) for g in np.unique(group)]
    faces = [g for g in groups if _at_once(p, g) >= MIN_FACE]
    if not faces:
        return (np.arange(M),)
    for small in (g for g in groups if _at_once(p, g) < MIN_FACE):
        nearest = int(np.argmin([d[np.ix_(small, face)].min() for face in faces]))
        faces[nearest] = np.sort(np.concatenate([faces[nearest], small]))
    return tuple(sorted(faces, key=lambda face: -int(n_seen[face].sum())))


def _at_once(p: NDArray[np.float64], rows: NDArray[np.int64]) -> int:
    return int((~np.isnan(p[:, rows, 0])).sum(axis=1).max(initial=0))


def _distances(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M, M) mm: the least of tracks that were seen together at some of the frames looked at."""
    T, M = p.shape[:2]
    found = np.full((M, M), _FAR_MM)
    seen = ~np.isnan(p[..., 0])
    n_seen = seen.sum(axis=1)
    stretches = np.array_split(np.arange(T), min(_FRAMES, T))
    fullest = {int(stretch[np.argmax(n_seen[stretch])]) for stretch in stretches}
    for m in np.flatnonzero(~seen[sorted(fullest)].any(axis=0)):  # short tracks in between
        own = np.flatnonzero(seen[:, m])
        fullest.add(int(own[len(own) // 2]))
    for frame in sorted(fullest):
        here = np.flatnonzero(~np.isnan(p[frame, :, 0]))
        x = p[frame, here]
        d = np.linalg.norm(x[:, None] - x[None], axis=2)
        found[np.ix_(here, here)] = np.minimum(found[np.ix_(here, here)], d)
    return found
