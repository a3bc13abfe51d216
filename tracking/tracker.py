"""Following markers from frame to frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..core.rig import Rig
from ..core.trajectories import Trajectories
from .matching import match_views
from .triangulation import Points, Views, triangulate

#: A track not seen for this many frames ends; a marker that comes back begins a new one.
MAX_COAST = 6
MIN_TRACK_FRAMES = 4  # shorter ones are ghosts
_CLOSE_GATE_PX = 3.0  # around the projection of a point already found
_SAME_MM = 1.5  # no two dots are this close
_REVIVE_MM = 8.0  # a marker found anew this near to a missed track is that track's
_MIN_SCALE = 1e-4  # of the dots' variances; noise-free footage leaves no residuals


@dataclass(frozen=True)
class TrackerSettings:
    """How far predictions may be off.

    Attributes
    ----------
    gate_px : float
        Farthest a dot may lie from its predicted place.
    tolerance_px : float or None
        Largest reprojection error of a view that is used. None finds it from the footage: six
        times the median error so far, from 0.25 px (a perfect rig) to 1.2 px.
    """

    gate_px: float = 9.0
    tolerance_px: float | None = None


_TOLERANCE_RANGE_PX = (0.25, 1.2)
_TOLERANCE_FACTOR = 6.0
_RECENT = 600  # residuals that tell the tolerance


class _Tolerance:
    """The tolerance as it is learnt from residuals of points that three or more cameras see."""

    def __init__(self, fixed: float | None) -> None:
        self._fixed = fixed
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self.px = fixed if fixed is not None else _TOLERANCE_RANGE_PX[1]

    def learn(self, points: Points) -> None:
        if self._fixed is not None:
            return
        self._recent.extend(points.residual_px[points.used.sum(axis=1) >= 3])
        if len(self._recent) >= 20:
            low, high = _TOLERANCE_RANGE_PX
            self.px = float(np.clip(_TOLERANCE_FACTOR * np.median(self._recent), low, high))


@dataclass(frozen=True, eq=False)
class FrameDots:
    """The dots of one instant: per camera (N_c, 2) centres and (N_c,) standard deviations, px."""

    time_s: float
    centres: tuple[NDArray[np.float64], ...]
    sd_px: tuple[NDArray[np.float64], ...]


@dataclass(eq=False)
class _Track:
    start: int
    positions: list[NDArray[np.float64]] = field(default_factory=list)
    information: list[NDArray[np.float64]] = field(default_factory=list)
    misfit: list[float] = field(default_factory=list)
    residual: list[float] = field(default_factory=list)
    n_views: list[int] = field(default_factory=list)
    unseen: int = 0
    seen_at: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    last: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def predict(self) -> NDArray[np.float64]:
        return self.last + self.velocity

    def see(self, points: Points, row: int) -> None:
        p = points.positions[row]
        if self.positions:
            step = (p - self.seen_at) / (self.unseen + 1)
            self.velocity = step if len(self.positions) == 1 else 0.3 * self.velocity + 0.7 * step
        self.last, self.seen_at, self.unseen = p, p, 0
        self.positions.append(p)
        self.information.append(points.information[row])
        self.misfit.append(float(points.misfit[row]))
        self.residual.append(float(points.residual_px[row]))
        self.n_views.append(int(points.used[row].sum()))

    def revive(self, points: Points, row: int) -> None:
        """See after all what was missed in this frame."""
        for record in (
            self.positions, self.information, self.misfit, self.residual, self.n_views,
        ):  # fmt: skip
            record.pop()
        self.unseen -= 1
        self.see(points, row)

    def distance_mm(self, p: NDArray[np.float64]) -> float:
        """From where it should be, or from where it was last seen: lips turn round in a frame."""
        return float(min(np.linalg.norm(p - self.last), np.linalg.norm(p - self.seen_at)))

    def miss(self) -> None:
        self.unseen += 1
        self.last = self.last + self.velocity
        self.velocity = 0.7 * self.velocity
        self.positions.append(np.full(3, np.nan))
        self.information.append(np.full((3, 3), np.nan))
        self.misfit.append(np.nan)
        self.residual.append(np.nan)
        self.n_views.append(0)


@dataclass(frozen=True, eq=False)
class Followed:
    """What the tracker found.

    Attributes
    ----------
    trajectories : Trajectories
        Unlabelled.
    share_used : (C,) float64
        Of each camera's dots, how many belong to a marker that another camera sees too; NaN for a
        camera without dots.
    """

    trajectories: Trajectories
    share_used: NDArray[np.float64]


def follow_markers(
    rig: Rig, frames: Iterable[FrameDots], settings: TrackerSettings | None = None
) -> Followed:
    """Track all markers, unlabelled: one name each for as long as it is followed.

    Each frame: predict every track by constant velocity, assign dots to predictions camera by
    camera (Hungarian method within a gate), triangulate robustly; dots that no track took are
    matched over all views and begin new tracks.

    Parameters
    ----------
    rig : Rig
    frames : iterable of FrameDots
        One entry of `centres` for each camera of the rig, in order; taken one at a time.
    settings : TrackerSettings, optional

    Returns
    -------
    Followed
        Names ``m000``, ``m001``, …; covariances scaled by the residuals found.
    """
    settings = settings or TrackerSettings()
    cameras = [rig[name] for name in rig]
    views = Views.of(cameras)
    tolerance = _Tolerance(settings.tolerance_px)
    live: list[_Track] = []
    done: list[_Track] = []
    times: list[float] = []
    n_dots, n_free = (np.zeros(len(cameras), dtype=np.int64) for _ in range(2))
    for index, frame in enumerate(frames):
        times.append(frame.time_s)
        free = _continue_tracks(views, live, frame, settings.gate_px, tolerance)
        begun = _begin_tracks(views, live, free, index, tolerance)
        n_dots += [len(d) for d in frame.centres]
        n_free += [len(d) for d in free.centres]
        n_free -= begun
        ended = [t for t in live if t.unseen > MAX_COAST]
        done += ended
        live = [t for t in live if t.unseen <= MAX_COAST]
    tracks = [t for t in done + live if np.count_nonzero(t.n_views) >= MIN_TRACK_FRAMES]
    tracks.sort(key=lambda t: t.start)
    share = np.divide(n_dots - n_free, n_dots, out=np.full(len(cameras), np.nan), where=n_dots > 0)
    return Followed(_assemble(tracks, np.array(times)), share)


def _continue_tracks(
    views: Views,
    live: list[_Track],
    frame: FrameDots,
    gate_px: float,
    tolerance: _Tolerance,
) -> FrameDots:
    """Extend or miss every live track; return the dots that none took.

    Dots are assigned twice: to predictions, and then, much closer, to where the points found by
    that project; a camera whose dot lay outside the first gate is won back.
    """
    if not live:
        return frame
    predicted = np.stack([t.predict() for t in live])
    points, _ = _assign(views, predicted, frame, gate_px, tolerance)
    found = np.where(np.isnan(points.positions), predicted, points.positions)
    gate = np.where(np.isnan(points.positions[:, 0]), gate_px, _CLOSE_GATE_PX)
    points, chosen = _assign(views, found, frame, gate, tolerance)
    tolerance.learn(points)
    used = [np.zeros(len(d), bool) for d in frame.centres]
    for row, track in enumerate(live):
        if points.used[row].any():
            track.see(points, row)
            for view in np.flatnonzero(chosen[row] >= 0):
                # a dot that was left out (half hidden, say) is still this marker's: it must not
                # begin a ghost
                used[view][chosen[row, view]] = True
        else:
            track.miss()
    return FrameDots(
        frame.time_s,
        tuple(d[~u] for d, u in zip(frame.centres, used, strict=True)),
        tuple(d[~u] for d, u in zip(frame.sd_px, used, strict=True)),
    )


def _assign(
    views: Views,
    expected: NDArray[np.float64],
    frame: FrameDots,
    gate_px: float | NDArray[np.float64],
    tolerance: _Tolerance,
) -> tuple[Points, NDArray[np.int64]]:
    """Nearest dots of expected places, one to one in each camera, and the points they make.

    Returns the points and (N, C) indices of the dots, −1 where none lies within the gate.
    """
    N, C = len(expected), len(frame.centres)
    gate = np.broadcast_to(np.asarray(gate_px, dtype=np.float64), N)
    xy, sd = np.full((N, C, 2), np.nan), np.full((N, C), np.nan)
    chosen = np.full((N, C), -1, dtype=np.int64)
    for c, dots in enumerate(frame.centres):
        if not len(dots):
            continue
        pixel = views.cameras[c].project(expected)
        d = np.linalg.norm(pixel[:, None] - dots[None], axis=2)
        d = np.where(d < gate[:, None], d, gate[:, None])  # also where NaN
        rows, columns = linear_sum_assignment(d)
        near = d[rows, columns] < gate[rows]
        rows, columns = rows[near], columns[near]
        chosen[rows, c] = columns
        xy[rows, c] = views.cameras[c].undistort(dots[columns])
        sd[rows, c] = frame.sd_px[c][columns]
    return triangulate(views, xy, sd, tolerance_px=tolerance.px), chosen


def _begin_tracks(
    views: Views,
    live: list[_Track],
    dots: FrameDots,
    frame: int,
    tolerance: _Tolerance,
) -> NDArray[np.int64]:
    """Markers among the dots that no track took: missed tracks go on there, others begin.

    Returns how many dots of each camera they use.
    """
    if sum(len(d) > 0 for d in dots.centres) < 2:
        return np.zeros(len(dots.centres), np.int64)
    normalised = [views.cameras[c].undistort(d) for c, d in enumerate(dots.centres)]
    rows, points = match_views(views, normalised, dots.sd_px, tolerance_px=tolerance.px)
    followed = np.array([t.last for t in live if not t.unseen]).reshape(-1, 3)
    twice = np.array(
        [(np.linalg.norm(followed - p, axis=1) < _SAME_MM).any() for p in points.positions], bool
    )
    rows, points = rows[~twice], points.select(~twice)
    missed = [t for t in live if t.unseen]
    d = np.array([[t.distance_mm(p) for t in missed] for p in points.positions])
    d = np.minimum(d.reshape(len(points.positions), len(missed)), _REVIVE_MM)
    revived = set()
    for row, m in zip(*linear_sum_assignment(d), strict=True):
        if d[row, m] < _REVIVE_MM:
            missed[m].revive(points, row)
            revived.add(row)
    for row in range(len(points.positions)):
        if row in revived:
            continue
        track = _Track(frame)
        track.see(points, row)
        live.append(track)
    return np.asarray((rows >= 0).sum(axis=0))


def _assemble(tracks: Sequence[_Track], time_s: NDArray[np.float64]) -> Trajectories:
    T, M = len(time_s), len(tracks)
    positions = np.full((T, M, 3), np.nan)
    information = np.full((T, M, 3, 3), np.nan)
    misfit, residual = np.full((T, M), np.nan), np.full((T, M), np.nan)
    n_views = np.zeros((T, M), np.int32)
    for m, track in enumerate(tracks):
        span = slice(track.start, track.start + len(track.positions))
        positions[span, m] = track.positions
        information[span, m] = track.information
        misfit[span, m] = track.misfit
        residual[span, m] = track.residual
        n_views[span, m] = track.n_views
    return Trajectories(
        time_s,
        tuple(f"m{m:03d}" for m in range(M)),
        positions,
        covariances=_covariances(information, misfit, n_views),
        residual_px=residual,
        n_views=n_views,
    )


def _covariances(
    information: NDArray[np.float64], misfit: NDArray[np.float64], n_views: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Inverse information, scaled so that the dots' standard deviations explain the residuals.

    A point of n views leaves 2 n − 3 degrees of freedom.
    """
    seen = n_views > 0
    freedom = float((2 * n_views[seen] - 3).sum())
    scale = float(misfit[seen].sum()) / freedom if freedom > 0 else 1.0
    found = np.full_like(information, np.nan)
    found[seen] = np.linalg.inv(information[seen]) * max(scale, _MIN_SCALE)
    return found
