"""Which parts of a face are hidden by a hand, a cup, a microphone.

The landmark network draws a whole face whatever it sees of it; its doubt shows in its presence
only. Then the patches of the reference frame tell which parts are still there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Presence below which a part of the face may be hidden: of faces seen well it is 13 to 23, of
#: ones half behind a hand 2 to 8; a face that is never seen better is held against itself.
_DOUBTFUL_PRESENCE, _DOUBTFUL_SHARE = 8.5, 0.6
_NEAR_PX = 16.0  # of the rectified face: patches that speak for a point
_FEWEST_FOUND = 0.4  # share of those patches that must be there
_LESS_SURE_SHARE, _NONE_FOUND = 0.85, 0.05
#: Hands have been taken for faces with a presence of 13, and less than this share of the patches.
_SURE_PRESENCE, _FEWEST_ANYWHERE = 15.0, 0.2
_OFF_PX = 8.0  # a patch found this far from where the network sees its point is something else


def covered_points(
    presence: Floats, apart_px: Floats, places: Floats, unit_px: Floats
) -> tuple[Flags, Flags]:
    """Landmarks that are hidden, and others that may be.

    Parameters
    ----------
    presence : (T,) float64
        The network's logit; NaN where it saw no face.
    apart_px : (T, n) float64, px
        From each point to where its patch of the reference frame was found; NaN where it was not.
    places : (n, 2) float64, px of the rectified face
    unit_px : (T,) float64
        Pixels of the picture in one of the rectified face.

    Returns
    -------
    hidden, uncertain : (T, n) bool
        The first are not seen. The second may be: no patch around them is found and the network
        is less sure than it was; or a mouth is open as never before.
    """
    best = float(np.nanquantile(presence, 0.9))
    is_doubtful = presence < min(_DOUBTFUL_PRESENCE, _DOUBTFUL_SHARE * best)
    squares = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    K = np.exp(-squares / (2 * _NEAR_PX**2))
    K /= K.sum(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        is_found = apart_px < _OFF_PX * unit_px[:, None]
    is_strange = is_found.mean(axis=1) < _FEWEST_ANYWHERE
    is_doubtful |= is_strange & (presence < _SURE_PRESENCE)
    found_often = np.maximum(is_found.mean(axis=0), 0.2)  # smooth skin is seldom found at all
    share = (is_found / found_often) @ K.T
    hidden = is_doubtful[:, None] & (share < _FEWEST_FOUND)
    is_less_sure = presence < _LESS_SURE_SHARE * best
    return hidden, is_less_sure[:, None] & (share < _NONE_FOUND) & ~hidden


def long_covered(is_covered: Flags, time_s: Floats, longest_bridge_s: float) -> Flags:
    """Those of the hidden samples (T, n) that are too far from seen ones to be bridged."""
    found = np.zeros_like(is_covered)
    for column in np.flatnonzero(is_covered.any(axis=0)):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_covered[:, column], [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            at_edge = first == 0 or end == len(time_s)
            if at_edge or time_s[end] - time_s[first - 1] > longest_bridge_s:
                found[first:end, column] = True
    return found
