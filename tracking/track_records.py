"""What a tracker finds, kept frame by frame and put together at the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.trajectories import Trajectories
from .dot_weights import learn_weights
from .triangulation import Points, Views, joined_points, triangulate

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dots:
    """What samples were made of: (N, C, 2) normalised places, (N, C) stated deviations, px."""

    xy: Floats
    sd_px: Floats

    def select(self, rows: NDArray[np.int64]) -> Dots:
        """Some of them."""
        return Dots(self.xy[rows], self.sd_px[rows])


_MIN_SCALE = 1e-4  # of the dots' variances; noise-free footage leaves no residuals
_WINDOW_S = 0.5  # on both sides: how long a marker's errors are alike
_PRIOR_FREEDOM = 30.0  # what the take's mean counts against a marker's own residuals
#: What displaces a dot alike in all pictures (shading, the skin around it) shows in no residual;
#: measured on synthetic takes, and the same lossless and through H.264.
_SHARED_PX = 0.0095


@dataclass(frozen=True, eq=False)
class Followed:
    """What the tracker found.

    Attributes
    ----------
    trajectories : Trajectories
        Unlabelled.
    n_dots : (T, C) int64
        Dots that each camera saw.
    n_used : (T, C) int64
        How many of them belong to a marker that another camera sees too.
    """

    trajectories: Trajectories
    n_dots: NDArray[np.int64]
    n_used: NDArray[np.int64]

    @property
    def share_used(self) -> Floats:
        """(C,) of each camera's dots; NaN for a camera without dots."""
        dots, used = self.n_dots.sum(axis=0), self.n_used.sum(axis=0)
        share = np.full(self.n_dots.shape[1], np.nan)
        return np.asarray(np.divide(used, dots, out=share, where=dots > 0))


class TrackRecords:
    """Samples as they come in; a frame may be added to several times."""

    def __init__(self, n_cameras: int) -> None:
        self._times: list[float] = []
        self._ids: list[NDArray[np.int64]] = []
        self._frames: list[NDArray[np.int64]] = []
        self._points: list[Points] = []
        self._dots: list[Dots] = []
        self._rigs: list[NDArray[np.int64]] = []
        self._views: list[Views] = []
        self._n_dots: list[NDArray[np.int64]] = []
        self._n_used: list[NDArray[np.int64]] = []
        self._n_cameras = n_cameras

    def begin_frame(self, time_s: float, views: Views) -> None:
        """What is added from now on belongs to this time, and was seen by these cameras."""
        self._times.append(time_s)
        if not self._views or self._views[-1] is not views:
            self._views.append(views)

    def add(self, ids: NDArray[np.int64], points: Points, dots: Dots) -> None:
        """Samples of tracks, each track once a frame, and what they were made of."""
        self._ids.append(ids)
        self._dots.append(dots)
        self._rigs.append(np.full(len(ids), len(self._views) - 1))
        self._frames.append(np.full(len(ids), len(self._times) - 1))
        self._points.append(points)

    def end_frame(self, n_dots: NDArray[np.int64], n_used: NDArray[np.int64]) -> None:
        """How many dots each camera saw, and how many of them are markers'."""
        self._n_dots.append(n_dots)
        self._n_used.append(n_used)

    def followed(self, min_frames: int) -> Followed:
        """All tracks that were seen in so many frames, in the order in which they began."""
        shape = (-1, self._n_cameras)
        n_dots = np.array(self._n_dots, dtype=np.int64).reshape(shape)
        n_used = np.array(self._n_used, dtype=np.int64).reshape(shape)
        return Followed(self._assemble(min_frames), n_dots, n_used)

    def _assemble(self, min_frames: int) -> Trajectories:
        time_s, T = np.array(self._times), len(self._times)
        if not self._ids:
            return no_tracks(time_s)
        ids, frames = np.concatenate(self._ids), np.concatenate(self._frames)
        kept = np.flatnonzero(np.bincount(ids) >= min_frames)
        if not len(kept):
            return no_tracks(time_s)
        column = np.full(ids.max() + 1, -1)
        column[kept] = np.arange(len(kept))  # numbers were given in order of beginning
        rows = np.flatnonzero(column[ids] >= 0)
        at, M = (frames[rows], column[ids[rows]]), len(kept)
        points, mm_per_px = self._solved_again(rows)

        def spread(values: Floats) -> Floats:
            whole = np.full((T, M, *values.shape[1:]), np.nan)
            whole[at] = values
            return whole

        n_views = np.zeros((T, M), np.int32)
        n_views[at] = points.used.sum(axis=1)
        return Trajectories(
            time_s,
            tuple(f"m{m:03d}" for m in range(M)),
            spread(points.positions),
            covariances=_covariances(
                time_s,
                spread(points.information),
                spread(points.misfit),
                n_views,
                spread(mm_per_px),
            ),
            residual_px=spread(points.residual_px),
            n_views=n_views,
        )

    def _solved_again(self, rows: NDArray[np.int64]) -> tuple[Points, Floats]:
        """Samples, with the weights that the residuals of all of them tell; and their scale.

        That is (N,) mm/px: what a pixel of the pictures used is there.
        """
        points = joined_points(self._points).select(rows)
        xy = np.concatenate([d.xy for d in self._dots])[rows]
        sd = np.concatenate([d.sd_px for d in self._dots])[rows]
        rigs = np.concatenate(self._rigs)[rows]
        mm_per_px = np.full(len(rows), np.nan)
        for k, views in enumerate(self._views):
            of_rig = np.flatnonzero(rigs == k)
            if not len(of_rig):
                continue
            before = points.select(of_rig)
            weights = learn_weights(views, xy[of_rig], sd[of_rig], before)
            used = np.where(before.used[..., None], xy[of_rig], np.nan)
            again = triangulate(views, used, weights.of(sd[of_rig]), tolerance_px=np.inf)
            points = points.replace(of_rig, again)
            scales = np.where(again.used, views.depths(again.positions) / views.focal_px, 0)
            mm_per_px[of_rig] = scales.sum(axis=1) / again.used.sum(axis=1)
        return points, mm_per_px


def no_tracks(time_s: Floats) -> Trajectories:
    """Trajectories without any."""
    T = len(time_s)
    return Trajectories(
        time_s,
        (),
        np.zeros((T, 0, 3)),
        covariances=np.zeros((T, 0, 3, 3)),
        residual_px=np.zeros((T, 0)),
        n_views=np.zeros((T, 0), np.int32),
    )


def _covariances(
    time_s: Floats,
    information: Floats,
    misfit: Floats,
    n_views: NDArray[np.int32],
    mm_per_px: Floats,
) -> Floats:
    """Inverse information, scaled so that the dots' standard deviations explain the residuals.

    A point of n views leaves 2 n − 3 degrees of freedom. Each marker's residuals of the half
    second around count together with the mean of all: a dot that is small, dim or seen at a slant
    is less sure than its neighbours for as long as it is. What no residual shows is added.
    """
    seen = n_views > 0
    freedom = np.where(seen, 2.0 * n_views - 3, 0.0)
    squares = np.where(seen, misfit, 0.0)
    mean = squares.sum() / freedom.sum() if freedom.any() else 1.0
    near = [_window_sum(time_s, values) for values in (squares, freedom)]
    scale = (near[0] + _PRIOR_FREEDOM * mean) / (near[1] + _PRIOR_FREEDOM)
    found = np.full_like(information, np.nan)
    factor = np.maximum(scale[seen], _MIN_SCALE)
    shared = (_SHARED_PX * mm_per_px[seen]) ** 2
    own = np.linalg.inv(information[seen]) * factor[:, None, None]
    found[seen] = own + shared[:, None, None] * np.eye(3)
    return found


def _window_sum(time_s: Floats, values: Floats) -> Floats:
    """Sums of (T, M) values over the times within the window around each."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    first = np.searchsorted(time_s, time_s - _WINDOW_S - 1e-9)
    behind = np.searchsorted(time_s, time_s + _WINDOW_S + 1e-9, side="right")
    return np.asarray(total[behind] - total[first])
