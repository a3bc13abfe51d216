"""Where points of one picture are in another: pyramidal Lucas-Kanade, there and back.

Bouguet 2000, Pyramidal implementation of the affine Lucas Kanade feature tracker; Kalal,
Mikolajczyk & Matas 2010, Forward-backward error.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_WINDOW = 15  # px
_LEVELS = 1  # beyond the picture itself: rectified faces move little
_SKIN_PX, _ALIKE = 8.0, 2.0  # how far skin moves as one, px of the rectified face
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02)


@dataclass(frozen=True, eq=False)
class FoundPoints:
    """Points found again.

    Attributes
    ----------
    places : (n, 2) float64, px
        NaN where the point left the picture.
    there_and_back_px : (n,) float64
        How far from its start a point is once it was followed back; infinite where lost.
    unlike : (n,) float64, grey levels
        Mean difference of the two patches.
    """

    places: Floats
    there_and_back_px: Floats
    unlike: Floats


def follow_points(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    points: Floats,
    guess: Floats,
    *,
    levels: int = _LEVELS,
) -> FoundPoints:
    """Find points of one picture in another.

    Parameters
    ----------
    before, after : (h, w) uint8
    points : (n, 2) float64, px
        In `before`.
    guess : (n, 2) float64, px
        Where they may be in `after`: the search begins there.
    levels : int
        Of the pyramid beyond the picture itself: with each, points may be twice as far away.
    """
    start = points.astype(np.float32)[:, None]
    there, is_there, unlike = _flow(before, after, start, guess.astype(np.float32)[:, None], levels)
    back, is_back, _ = _flow(after, before, there, start, levels)
    is_lost = (is_there[:, 0] == 0) | (is_back[:, 0] == 0)
    apart = np.linalg.norm(back[:, 0] - start[:, 0], axis=1).astype(np.float64)
    apart[is_lost] = np.inf
    places = there[:, 0].astype(np.float64)
    places[is_lost] = np.nan
    # of a lost point OpenCV leaves the difference as it found it in memory
    return FoundPoints(places, apart, np.where(is_lost, np.inf, unlike[:, 0]))


def flow_sd(found: FoundPoints) -> Floats:
    """Standard deviation of each coordinate of a step, (n,), px; infinite where points were lost.

    Fitted to the errors on plain renders: it grows as the root of the distance between there and
    back, and with how unlike the patches are.
    """
    sd = np.maximum(1.7 * np.sqrt(found.there_and_back_px), 0.24 * (found.unlike - 1.5))
    return np.where(np.isnan(found.places[:, 0]), np.inf, np.maximum(sd, 0.05))


def skin_kernel(places: Floats, is_skin: NDArray[np.bool_]) -> Floats:
    """How much points of the skin have to say about each other's motion, (n, n).

    Parameters
    ----------
    places : (n, 2) float64, px of the rectified face
    is_skin : (n,)
        The others move by themselves: they have only themselves.
    """
    squares = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    K = np.exp(-squares / (2 * _SKIN_PX**2))
    K[~is_skin] = K[:, ~is_skin] = 0.0
    np.fill_diagonal(K, 1.0)
    return np.asarray(K)


def shared_motion(moves: Floats, sd: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Motion of points on skin, each with the help of its neighbours, and what is left of `sd`.

    Where skin has no texture flow says little; its neighbours know how it moves.

    Parameters
    ----------
    moves : (n, 2) float64, px
        NaN where not known.
    sd : (n,) float64, px
        Infinite there.
    K : (n, n) float64
        `skin_kernel`.
    """
    w = 1.0 / sd**2
    share = K * w
    total = np.maximum(share.sum(axis=1), 1e-12)
    mean = share @ np.nan_to_num(moves) / total[:, None]
    # overlapping windows err alike: as if half of the neighbours were counted
    variance = _ALIKE * (share * K).sum(axis=1) / total**2
    is_known = total > 1e-9
    left = np.where(is_known, np.minimum(np.sqrt(variance), sd), np.inf)
    return np.where(is_known[:, None], mean, np.nan), left


def _flow(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    points: NDArray[np.float32],
    guess: NDArray[np.float32],
    levels: int,
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    found, status, error = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        guess.copy(),  # it is written into
        winSize=(_WINDOW, _WINDOW),
        maxLevel=levels,
        criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found), np.asarray(status), np.asarray(error)
