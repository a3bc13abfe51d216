"""Following markers from frame to frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..core.rig import Rig
from .lenses import undistort
from .matching import match_views
from .prediction import Prediction
from .track_records import Dots, Followed, TrackRecords
from .triangulation import Points, Views, triangulate

__all__ = [
    "MAX_COAST", "MIN_TRACK_FRAMES", "Followed", "FrameDots", "Tracker", "TrackerSettings",
    "centres_of_spheres", "follow_markers",
]  # fmt: skip

Floats = NDArray[np.float64]

#: A track not seen for this many frames ends; a marker that comes back begins a new one.
MAX_COAST = 6
MIN_TRACK_FRAMES = 4  # shorter ones are ghosts
_CLOSE_GATE_PX = 3.0  # around the projection of a point already found
_SAME_MM = 1.5  # no two dots are this close
_REVIVE_MM = 4.0  # a marker found anew this near to a missed track is that track's


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
    sphere_radius_mm : float
        Of markers that are spheres: their pictures' middles lie farther out than their centres.
        0 for flat dots.
    """

    gate_px: float = 9.0
    tolerance_px: float | None = None
    sphere_radius_mm: float = 0.0


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
    """The dots of one instant, by all cameras.

    Attributes
    ----------
    time_s : float
    centres : C arrays (N_c, 2) float64, px
        None of a camera that lost the frame.
    sd_px : C arrays (N_c,) float64
        Standard deviation of each coordinate.
    stamps_s : tuple of C floats
        What the cameras' files say of when that was; NaN for a camera that lost the frame. Empty
        where there are no files.
    """

    time_s: float
    centres: tuple[Floats, ...]
    sd_px: tuple[Floats, ...]
    stamps_s: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class _Sighted:
    """The dots of one instant without lens distortion, and which of them are still free."""

    centres: tuple[Floats, ...]
    sd_px: tuple[Floats, ...]

    def only(self, free: list[NDArray[np.bool_]]) -> _Sighted:
        return _Sighted(
            tuple(d[f] for d, f in zip(self.centres, free, strict=True)),
            tuple(d[f] for d, f in zip(self.sd_px, free, strict=True)),
        )


def follow_markers(
    rig: Rig, frames: Iterable[FrameDots], settings: TrackerSettings | None = None
) -> Followed:
    """Track all markers, unlabelled: one name each for as long as it is followed.

    `Tracker` says how.

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
    tracker = Tracker(rig, settings)
    for frame in frames:
        tracker.step(frame)
    return tracker.followed()


def centres_of_spheres(middles: Floats, depths_mm: Floats, radius_mm: float) -> Floats:
    """Where centres of spheres are projected, from the middles of the spheres' pictures.

    A sphere of radius r, whose centre has the depth z and is seen at x (normalised), is pictured
    as an ellipse with its middle at x z² / (z² − r²): the outline is the cone that touches it.

    Parameters
    ----------
    middles : (..., 2) float64, normalised
    depths_mm : (...) float64, mm
        Of the centres, along the optical axis.
    radius_mm : float
    """
    return np.asarray(middles * (1 - (radius_mm / depths_mm) ** 2)[..., None])


class Tracker:
    """Follows all markers of a take, a frame at a time.

    Each frame: predict every track by the motion that all markers share and its own, assign dots
    to predictions camera by camera (Hungarian method within a gate), triangulate robustly. What
    was found tells the motion that is shared in this very frame; tracks not found are then looked
    for where it carries them. Dots that no track took are matched over all views and begin new
    tracks.
    """

    def __init__(self, rig: Rig, settings: TrackerSettings | None = None) -> None:
        self._settings = settings or TrackerSettings()
        self._views = Views.of([rig[name] for name in rig])
        self._tolerance = _Tolerance(self._settings.tolerance_px)
        self._live = Prediction()
        self._records = TrackRecords(len(rig))

    def step(self, frame: FrameDots) -> None:
        """Go on to the next frame."""
        cameras = self._views.cameras
        dots = _Sighted(
            tuple(undistort(c, d) for c, d in zip(cameras, frame.centres, strict=True)),
            frame.sd_px,
        )
        self._records.begin_frame(frame.time_s, self._views)
        free = self._continue_tracks(dots)
        n_begun = self._begin_tracks(free)
        n_dots = np.array([len(d) for d in dots.centres])
        n_free = np.array([len(d) for d in free.centres])
        self._records.end_frame(n_dots, n_dots - n_free + n_begun)
        self._live.drop(self._live.unseen > MAX_COAST)

    def change_rig(self, rig: Rig) -> None:
        """Go on with cameras that stand elsewhere."""
        self._views = Views.of([rig[name] for name in rig])

    def followed(self) -> Followed:
        """What was found so far."""
        return self._records.followed(MIN_TRACK_FRAMES)

    def _continue_tracks(self, dots: _Sighted) -> _Sighted:
        """Extend or miss every live track; return the dots that none took.

        Dots are assigned twice: to predictions, and then, much closer, to where the points found
        by that project; a camera whose dot lay outside the first gate is won back.
        """
        live = self._live
        if not len(live):
            return dots
        predicted, gate_px = live.predict(), self._settings.gate_px
        before = self._assign(predicted, dots, np.full(len(live), gate_px))
        points = self._triangulate(self._gathered(dots, before, predicted))
        live.learn_common_motion(points.positions)
        lost = np.isnan(points.positions[:, 0])
        expected = np.where(lost[:, None], live.predict(), points.positions)
        chosen = self._assign(expected, dots, np.where(lost, gate_px, _CLOSE_GATE_PX))
        changed = np.flatnonzero((chosen != before).any(axis=1))
        own = self._gathered(dots, chosen, expected)
        points = points.replace(changed, self._triangulate(own.select(changed)))
        self._tolerance.learn(points)
        seen = np.flatnonzero(points.used.any(axis=1))
        free = [np.ones(len(d), bool) for d in dots.centres]
        for c in range(len(free)):
            # a dot that was left out (half hidden, say) is still this marker's: it must not
            # begin a ghost
            mine = chosen[seen, c]
            free[c][mine[mine >= 0]] = False
        live.update(points.positions)
        self._records.add(live.ids[seen], points.select(seen), own.select(seen))
        return dots.only(free)

    def _assign(self, expected: Floats, dots: _Sighted, gate_px: Floats) -> NDArray[np.int64]:
        """Nearest dots of expected places, one to one in each camera.

        Returns (N, C) indices of the dots, −1 where none lies within the gate.
        """
        views = self._views
        chosen = np.full((len(expected), len(dots.centres)), -1, dtype=np.int64)
        places = views.normalised(expected)
        for c, centres in enumerate(dots.centres):
            if not len(centres):
                continue
            gap = (places[:, None, c] - centres[None]) * views.focal_px[c]
            d = np.sqrt(gap[..., 0] ** 2 + gap[..., 1] ** 2)
            d = np.where(d < gate_px[:, None], d, gate_px[:, None])  # also where NaN
            rows, columns = linear_sum_assignment(d)
            near = d[rows, columns] < gate_px[rows]
            chosen[rows[near], c] = columns[near]
        return chosen

    def _gathered(self, dots: _Sighted, chosen: NDArray[np.int64], expected: Floats) -> Dots:
        """The dots of (N, C) groups, which are about at (N, 3) mm."""
        xy, sd = np.full((*chosen.shape, 2), np.nan), np.full(chosen.shape, np.nan)
        for c, (centres, sd_px) in enumerate(zip(dots.centres, dots.sd_px, strict=True)):
            rows = np.flatnonzero(chosen[:, c] >= 0)
            xy[rows, c] = centres[chosen[rows, c]]
            sd[rows, c] = sd_px[chosen[rows, c]]
        if self._settings.sphere_radius_mm:
            depths = self._views.depths(expected)
            xy = centres_of_spheres(xy, depths, self._settings.sphere_radius_mm)
        return Dots(xy, sd)

    def _triangulate(self, dots: Dots) -> Points:
        return triangulate(self._views, dots.xy, dots.sd_px, tolerance_px=self._tolerance.px)

    def _begin_tracks(self, dots: _Sighted) -> NDArray[np.int64]:
        """Markers among the dots that no track took: missed tracks go on there, others begin.

        Returns how many dots of each camera they use.
        """
        if sum(len(d) > 0 for d in dots.centres) < 2:
            return np.zeros(len(dots.centres), np.int64)
        live = self._live
        rows, points = match_views(
            self._views, dots.centres, dots.sd_px, tolerance_px=self._tolerance.px
        )
        followed = live.last[live.unseen == 0]
        gap = np.linalg.norm(points.positions[:, None] - followed, axis=2)
        twice = (gap < _SAME_MM).any(axis=1)
        kept = np.flatnonzero(~twice)
        # in the order of the dots: that of residuals would hang on their last digits
        kept = kept[np.lexsort(np.where(rows[kept] < 0, np.inf, rows[kept]).T[::-1])]
        rows, points = rows[kept], points.select(kept)
        missed = np.flatnonzero(live.unseen > 0)
        # from where it should be, or from where it was last seen: lips turn round in a frame
        d = np.minimum(
            np.linalg.norm(points.positions[:, None] - live.last[missed], axis=2),
            np.linalg.norm(points.positions[:, None] - live.seen_at[missed], axis=2),
        )
        d = np.minimum(d, _REVIVE_MM)
        ids = np.full(len(rows), -1, dtype=np.int64)
        for row, m in zip(*linear_sum_assignment(d), strict=True):
            if d[row, m] < _REVIVE_MM:
                ids[row] = live.ids[missed[m]]
                live.revive(int(missed[m]), points.positions[row])
        new = np.flatnonzero(ids < 0)
        ids[new] = live.begin(points.positions[new])
        self._records.add(ids, points, self._gathered(dots, rows, points.positions))
        return np.asarray((rows >= 0).sum(axis=0))
