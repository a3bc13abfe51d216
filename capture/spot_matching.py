"""Unlabelled spots of a rig's cameras, matched although a camera may have been moved.

Spots are matched by a callable (`tracking.matching.match_views` behind it): capture knows no
tracking. If few of a camera's spots fit, the others are matched without it, and the camera is
placed anew where its pictures of their points are: all of those lie beside their expected places by
about the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .pose import pose_bundle
from .rays import Pose, nearest_points

Floats = NDArray[np.float64]
#: (rig, centres (N_c, 2) px and deviations (N_c,) px of each camera's spots, tolerance px) to
#: (K, C): each point's spot in each camera, -1 where it has none.
MatchSpots = Callable[[Rig, Sequence[Floats], Sequence[Floats], float], NDArray[np.int64]]
#: If that share of every camera's spots is matched, and that share of those by three cameras or
#: more, no camera is in doubt.
_ENOUGH, _ENOUGH_FIRM = 0.85, 0.3
#: Below these, rig and pictures do not belong together. Two cameras' spots are matched by chance.
_TOO_FEW, _TOO_FEW_FIRM = 0.4, 0.15
#: A rig is mended if so much more of the spots is matched then.
_BETTER = 1.05
_MOST_MOVED = 2
_TRIAL_FRAMES = 12
_REACH_PX = 120.0  # a knocked camera's picture is searched so far
_CELL_PX, _PAIR_PX, _CLOSE_PX = 4.0, 10.0, 3.0
_LEAST_PAIRS = 12


@dataclass(frozen=True, eq=False)
class SpotFrame:
    """The bright spots of one moment.

    Attributes
    ----------
    name : str
    centres : C arrays (N_c, 2) float64, px
        In the order of the rig's cameras.
    sd_px : C arrays (N_c,) float64
        Standard deviation of each coordinate.
    """

    name: str
    centres: tuple[Floats, ...]
    sd_px: tuple[Floats, ...]


@dataclass(frozen=True, eq=False)
class MatchedSpots:
    """Points of all frames.

    Attributes
    ----------
    rig : Rig
        As they were matched with: cameras that had been moved are placed anew.
    frame : (P,) int64
    rows : (P, C) int64
        Each point's spot in each camera, -1 where it has none.
    share : (C,) float64
        Of each camera's spots, how many belong to a point.
    placed_anew : tuple of str
    """

    rig: Rig
    frame: NDArray[np.int64]
    rows: NDArray[np.int64]
    share: Floats
    placed_anew: tuple[str, ...]

    @property
    def firm(self) -> Floats:
        """(C,) of each camera's matched spots, how many belong to a point of three or more."""
        counts = (self.rows >= 0).sum(axis=0)
        return np.asarray(self._firm_rows.sum(axis=0) / np.maximum(counts, 1))

    @property
    def _firm_rows(self) -> NDArray[np.bool_]:
        seen = self.rows >= 0
        return np.asarray(seen & (seen.sum(axis=1) >= min(3, len(self.rig)))[:, None])

    @property
    def score(self) -> int:
        """How many spots are matched beyond chance."""
        return int(self._firm_rows.sum())


def match_spots(
    rig: Rig, frames: Sequence[SpotFrame], match: MatchSpots, *, tolerance_px: float = 1.5
) -> MatchedSpots:
    """Match the spots of all frames, with a rig of which some cameras may have been moved.

    Raises
    ------
    InputError
        If fewer than 40 % of some camera's spots can be matched even so, or hardly any by three
        cameras (of three or more).
    """
    found = _matched(rig, frames, match, tolerance_px, ())
    sure = found.share.min() >= _ENOUGH and found.firm.min() >= _ENOUGH_FIRM
    if len(rig) > 2 and not sure:
        trial = [frames[i] for i in _evenly(len(frames), _TRIAL_FRAMES)]
        mended = _mended(rig, trial, match, tolerance_px)
        if mended is not None:
            again = _matched(mended[0], frames, match, tolerance_px, mended[1])
            if again.score > _BETTER * found.score:
                found = again
    if not _belong_together(found):
        meet = found.share * found.firm
        told = ", ".join(f"{n} {100 * s:.0f} %" for n, s in zip(rig, meet, strict=True))
        raise InputError(
            f"too few of the cameras' spots meet in space ({told}): is the camera rig of this "
            "take, is each video named after its camera, were several cameras moved?"
        )
    return found


def _belong_together(found: MatchedSpots) -> bool:
    """Whether more is matched, in every camera, than chance would match."""
    return bool(found.share.min() >= _TOO_FEW and found.firm.min() >= _TOO_FEW_FIRM)


def _evenly(n: int, most: int) -> list[int]:
    return sorted({int(i) for i in np.linspace(0, n - 1, min(n, most)).round()})


def _matched(
    rig: Rig,
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    tolerance_px: float,
    placed_anew: tuple[str, ...],
) -> MatchedSpots:
    rows = [match(rig, f.centres, f.sd_px, tolerance_px) for f in frames]
    counts = np.array([[len(c) for c in f.centres] for f in frames]).sum(axis=0)
    joined = np.concatenate([r.reshape(-1, len(rig)) for r in rows])
    of_frame = np.repeat(np.arange(len(frames)), [len(r) for r in rows])
    used = (joined >= 0).sum(axis=0)
    if not counts.all():
        blind = [n for n, k in zip(rig, counts, strict=True) if not k]
        raise InputError(f"{', '.join(blind)}: no bright spots in any of the frames")
    return MatchedSpots(rig, of_frame, joined, used / counts, placed_anew)


def _mended(
    rig: Rig, frames: Sequence[SpotFrame], match: MatchSpots, tolerance_px: float
) -> tuple[Rig, tuple[str, ...]] | None:
    """The rig with as few cameras placed anew as it takes, so that most spots are matched."""
    names = rig.names
    for n_moved in range(1, min(_MOST_MOVED, len(names) - 2) + 1):
        best, best_score = None, 0
        for moved in combinations(range(len(names)), n_moved):
            trial = _placed_anew(rig, moved, frames, match, tolerance_px)
            if trial is None:
                continue
            found = _matched(trial, frames, match, tolerance_px, ())
            if found.score > best_score and _belong_together(found):
                best, best_score = (trial, tuple(names[c] for c in moved)), found.score
                if found.share.min() >= _ENOUGH and found.firm.min() >= _ENOUGH_FIRM:
                    return best
        if best is not None:
            return best
    return None


def _placed_anew(
    rig: Rig,
    moved: tuple[int, ...],
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    tolerance_px: float,
) -> Rig | None:
    """The rig with these cameras placed by the points that the others see; None if it fails."""
    core = [c for c in range(len(rig)) if c not in moved]
    names = rig.names
    core_rig = Rig({names[c]: rig[names[c]] for c in core})
    poses = [_pose(rig[names[c]]) for c in core]
    others = [
        SpotFrame(f.name, tuple(f.centres[c] for c in core), tuple(f.sd_px[c] for c in core))
        for f in frames
    ]
    matched = _matched(core_rig, others, match, tolerance_px, ())
    if not _belong_together(matched):
        return None
    points = []
    for i, frame in enumerate(others):
        rows = matched.rows[matched.frame == i]
        xy = np.full((*rows.shape, 2), np.nan)
        for k, name in enumerate(core_rig):
            seen = rows[:, k] >= 0
            xy[seen, k] = rig[name].undistort(frame.centres[k][rows[seen, k]])
        points.append(nearest_points(poses, xy))
    cameras = dict(rig.cameras)
    for c in moved:
        camera = _resected(rig[names[c]], points, [f.centres[c] for f in frames])
        if camera is None:
            return None
        cameras[names[c]] = camera
    return Rig(cameras)


def _pose(camera: Camera) -> Pose:
    return camera.camera_from_world.rotation, camera.camera_from_world.translation


def _resected(camera: Camera, points: Sequence[Floats], spots: Sequence[Floats]) -> Camera | None:
    """A camera where its pictures of known points are; frames of (P, 3) mm and (N, 2) px."""
    shift = _common_shift([camera.project(X) for X in points], spots)
    if shift is None:
        return None
    found = camera
    for reach in (_PAIR_PX, _CLOSE_PX, _CLOSE_PX):
        offset = shift if found is camera else np.zeros(2)
        X, uv = _paired(found, points, spots, offset, reach)
        if len(X) < _LEAST_PAIRS:
            return None
        fit = pose_bundle(X, uv, found, *_pose(found), robust=True)
        pose = Rigid.from_rotation(fit.target_rotation[0], fit.target_translation[0])
        found = replace(found, camera_from_world=pose)
    return found


def _common_shift(expected: Sequence[Floats], spots: Sequence[Floats]) -> Floats | None:
    """The way (2,) px by which most spots lie beside their expected places."""
    ways = []
    for q, p in zip(expected, spots, strict=True):
        q = q[np.isfinite(q).all(axis=1)]
        way = (p[None] - q[:, None]).reshape(-1, 2)
        ways.append(way[np.linalg.norm(way, axis=1) < _REACH_PX])
    joined = np.concatenate(ways) if ways else np.zeros((0, 2))
    if len(joined) < _LEAST_PAIRS:
        return None
    tree = cKDTree(joined)
    cells = np.unique(np.round(joined / _CELL_PX), axis=0) * _CELL_PX
    counts = np.array([len(near) for near in tree.query_ball_point(cells, 2 * _CELL_PX)])
    near = tree.query_ball_point(cells[int(np.argmax(counts))], 2 * _CELL_PX)
    return np.asarray(np.median(joined[near], axis=0))


def _paired(
    camera: Camera,
    points: Sequence[Floats],
    spots: Sequence[Floats],
    offset: Floats,
    reach_px: float,
) -> tuple[Floats, Floats]:
    """Points (N, 3) and spots (N, 2) that are each other's nearest, of all frames."""
    X, uv = [], []
    for known, seen in zip(points, spots, strict=True):
        q = camera.project(known) + offset
        rows = np.flatnonzero(np.isfinite(q).all(axis=1))
        if not len(rows) or not len(seen):
            continue
        d, nearest = cKDTree(seen).query(q[rows], distance_upper_bound=reach_px)
        _, back = cKDTree(q[rows]).query(seen)
        for i in np.flatnonzero(np.isfinite(d)):
            if back[nearest[i]] == i:
                X.append(known[rows[i]])
                uv.append(seen[nearest[i]])
    return np.array(X).reshape(-1, 3), np.array(uv).reshape(-1, 2)
