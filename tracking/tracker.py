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
    last: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def predict(self) -> NDArray[np.float64]:
        return self.last + self.velocity

    def see(self, points: Points, row: int) -> None:
        p = points.positions[row]
        if self.positions:
            step = (p - self.last) / (self.unseen + 1)
            self.velocity = step if len(self.positions) == 1 else 0.3 * self.velocity + 0.7 * step
        self.last, self.unseen = p, 0
        self.positions.append(p)
        self.information.append(points.information[row])
        self.misfit.append(float(points.misfit[row]))
        self.residual.append(float(points.residual_px[row]))
        self.n_views.append(int(points.used[row].sum()))

    def miss(self) -> None:
        self.unseen += 1
        self.last = self.last + self.velocity
        self.velocity = 0.7 * self.velocity
        self.positions.append(np.full(3, np.nan))
        self.information.append(np.full((3, 3), np.nan))
        self.misfit.append(np.nan)
        self.residual.append(np.nan)
        self.n_views.append(0)


def follow_markers(
    rig: Rig, frames: Iterable[FrameDots], settings: TrackerSettings | None = None
) -> Trajectories:
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
    Trajectories
        Names ``m000``, ``m001``, …; covariances scaled by the residuals found.
    """
    settings = settings or TrackerSettings()
    cameras = [rig[name] for name in rig]
    views = Views.of(cameras)
    tolerance = _Tolerance(settings.tolerance_px)
    live: list[_Track] = []
    done: list[_Track] = []
    times: list[float] = []
    for index, frame in enumerate(frames):
        times.append(frame.time_s)
        free = _continue_tracks(views, live, frame, settings.gate_px, tolerance)
        _begin_tracks(views, live, free, index, tolerance)
        ended = [t for t in live if t.unseen > MAX_COAST]
        done += ended
        live = [t for t in live if t.unseen <= MAX_COAST]
    tracks = [t for t in done + live if np.count_nonzero(t.n_views) >= MIN_TRACK_FRAMES]
    tracks.sort(key=lambda t: t.start)
    return _assemble(tracks, np.array(times))


def _continue_tracks(
    views: Views,
    live: list[_Track],
    frame: FrameDots,
    gate_px: float,
    tolerance: _Tolerance,
) -> FrameDots:
    """Extend or miss every live track; return the dots that none took."""
    dots = frame.centres
    C = len(dots)
    if not live:
        return frame
    predicted = np.stack([t.predict() for t in live])
    xy = np.full((len(live), C, 2), np.nan)
    sd = np.full((len(live), C), np.nan)
    chosen = np.full((len(live), C), -1)
    for c in range(C):
        if not len(dots[c]):
            continue
        pixel = views.cameras[c].project(predicted)
        d = np.linalg.norm(pixel[:, None] - dots[c][None], axis=2)
        d = np.where(np.isfinite(d), np.minimum(d, gate_px), gate_px)
        rows, columns = linear_sum_assignment(d)
        near = d[rows, columns] < gate_px
        chosen[rows[near], c] = columns[near]
        xy[rows[near], c] = views.cameras[c].undistort(dots[c][columns[near]])
        sd[rows[near], c] = frame.sd_px[c][columns[near]]
    points = triangulate(views, xy, sd, tolerance_px=tolerance.px)
    tolerance.learn(points)
    used = [np.zeros(len(d), bool) for d in dots]
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
        tuple(d[~u] for d, u in zip(dots, used, strict=True)),
        tuple(d[~u] for d, u in zip(frame.sd_px, used, strict=True)),
    )


def _begin_tracks(
    views: Views,
    live: list[_Track],
    dots: FrameDots,
    frame: int,
    tolerance: _Tolerance,
) -> None:
    if sum(len(d) > 0 for d in dots.centres) < 2:
        return
    normalised = [views.cameras[c].undistort(d) for c, d in enumerate(dots.centres)]
    _, points = match_views(views, normalised, dots.sd_px, tolerance_px=tolerance.px)
    for row in range(len(points.positions)):
        track = _Track(frame)
        track.see(points, row)
        live.append(track)


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
