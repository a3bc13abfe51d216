"""Where markers will be: the motion that all share, and each one's own.

On a face most of what a marker does is the head's doing. So a rigid motion is fitted to all markers
from frame to frame (robustly, since the face is not rigid), and goes on for the next; what is left
of each marker's step is its own, and goes on too. A marker that is hidden is carried along by those
that are seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

_MIN_COMMON = 6  # markers that tell a common motion
_ROUNDS = 2
_LEAST_SPREAD_MM = 0.05
_COLLINEAR = 1e-4  # ratio of singular values: the turn about a line cannot be seen
_TURN = 0.5  # of the last change of a step goes on; 0 would be constant velocity
_COAST_DAMPING = 0.7  # of its own step, a frame, while a marker is not seen
_PER_TRACK = ("ids", "last", "seen_at", "unseen", "_own", "_turn", "_is_fresh")


class Prediction:
    """The live tracks' places and velocities, arrays over tracks.

    Attributes
    ----------
    ids : (N,) int64
    last : (N, 3) float64, mm
        Where each is now: seen, or carried along.
    seen_at : (N, 3) float64, mm
        Where it was seen last.
    unseen : (N,) int64
        For how many frames it was not.
    """

    def __init__(self) -> None:
        self.ids = np.zeros(0, np.int64)
        self.last, self.seen_at = np.zeros((0, 3)), np.zeros((0, 3))
        self.unseen = np.zeros(0, np.int64)
        self._own, self._turn = np.zeros((0, 3)), np.zeros((0, 3))
        self._is_fresh = np.zeros(0, bool)  # no step from one frame to the next is known
        self._common = _Common()
        self._next_id = 0

    def __len__(self) -> int:
        return len(self.ids)

    def predict(self) -> Floats:
        """(N, 3) mm: places in the frame that comes, by all that is known of it."""
        return self._common.carry(self.last) + self._own + self._turn

    def learn_common_motion(self, found: Floats) -> None:
        """Fit the common motion to what was found in the frame that comes; NaN: not found."""
        known = ~np.isnan(found[:, 0]) & (self.unseen == 0)
        self._common.fit(self.last[known], found[known])

    def update(self, found: Floats) -> None:
        """Take over the frame that came: (N, 3) mm, NaN where not found."""
        carried, expected = self._common.carry(self.last), self.predict()
        seen = ~np.isnan(found[:, 0])[:, None]
        follows = seen & (self.unseen == 0)[:, None]
        own = found - carried
        # after a gap the step is over several frames, and from where nobody saw it
        own = np.where(follows, own, own / (self.unseen + 1)[:, None])
        changed = follows & ~self._is_fresh[:, None]
        self._turn = np.where(changed, _TURN * (own - self._own), 0.0)
        self._is_fresh = ~follows[:, 0]
        self._own = np.where(seen, own, _COAST_DAMPING * self._own)
        self.last = np.where(seen, found, expected)
        self.seen_at = np.where(seen, found, self.seen_at)
        self.unseen = np.where(seen[:, 0], 0, self.unseen + 1)
        self._common.go_on()

    def revive(self, row: int, place: Floats) -> None:
        """See after all what was missed in the frame that came."""
        self._own[row] += (place - self.last[row]) / self.unseen[row]
        self._turn[row], self._is_fresh[row] = 0.0, True
        self.last[row] = self.seen_at[row] = place
        self.unseen[row] = 0

    def begin(self, places: Floats) -> NDArray[np.int64]:
        """New tracks at (K, 3) mm, which have the common motion; their numbers."""
        K = len(places)
        ids = np.arange(self._next_id, self._next_id + K)
        self._next_id += K
        nothing = np.zeros((K, 3))
        new = (ids, places, places, np.zeros(K, np.int64), nothing, nothing, np.ones(K, bool))
        for name, values in zip(_PER_TRACK, new, strict=True):
            setattr(self, name, np.concatenate([getattr(self, name), values]))
        return ids

    def drop(self, ended: NDArray[np.bool_]) -> None:
        """Forget tracks."""
        if ended.any():
            for name in _PER_TRACK:
                setattr(self, name, getattr(self, name)[~ended])


class _Common:
    """The rigid motion of all markers from the last frame to the one that comes.

    Kept as a turn about the markers' middle and that middle's step, which both go on smoothly.
    """

    def __init__(self) -> None:
        self._pivot = np.zeros(3)
        self._now = np.zeros(6)  # rotation vector, rad, and step, mm
        self._before = np.zeros(6)
        self._fitted = False

    def carry(self, points: Floats) -> Floats:
        R = Rotation.from_rotvec(self._now[:3]).as_matrix()
        return np.asarray((points - self._pivot) @ R.T + self._pivot + self._now[3:])

    def fit(self, source: Floats, target: Floats) -> None:
        """Least squares under weights that fall with what a marker does by itself."""
        self._fitted = len(source) >= _MIN_COMMON
        if not self._fitted:
            self._now = np.zeros(6)
            return
        weights = np.ones(len(source))
        for _ in range(_ROUNDS):
            R, pivot, step = _rigid_motion(source, target, weights)
            off2 = (((source - pivot) @ R.T + pivot + step - target) ** 2).sum(axis=1)
            weights = 1 / (1 + off2 / max(float(np.median(off2)), _LEAST_SPREAD_MM**2))
        self._pivot = pivot
        self._now = np.concatenate([Rotation.from_matrix(R).as_rotvec(), step])

    def go_on(self) -> None:
        """The frame came: expect the next step to be like this one, and its change to go on."""
        now = self._now if self._fitted else np.zeros(6)
        self._pivot = self._pivot + now[3:]
        self._now = now + _TURN * (now - self._before) if self._fitted else now
        self._before = now
        self._fitted = False


def _rigid_motion(source: Floats, target: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Rotation, the middle that it is about, and that middle's step.

    As `rigid_fit.fit_rigid`, for one small set without gaps, and with an answer for points on a
    line: between two frames they are taken not to turn.
    """
    w = weights / weights.sum()
    p0, g0 = w @ source, w @ target
    U, S, Vt = np.linalg.svd((w[:, None] * (target - g0)).T @ (source - p0))
    if S[1] <= _COLLINEAR * S[0]:
        return np.eye(3), p0, g0 - p0
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        U[:, 2] = -U[:, 2]
    return U @ Vt, p0, g0 - p0
