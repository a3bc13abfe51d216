"""Which of the bright spots of a picture are the balls of a calibration wand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.camera import Camera
from ..core.errors import InputError

Floats = NDArray[np.float64]
MIN_BALLS = 2
#: More spots than this are no picture of a wand: the largest are looked at.
_MOST_SPOTS = 24
#: How unlike the distances of a wand's two ends may be: farther / nearer.
_DEPTH_RATIO = 1.5
#: How unlike the areas of equal balls may be beyond what their distances explain.
_AREA_RATIO = 1.8
#: A wand is taken if it is so many times better than any other triple of spots.
_BETTER = 3.0
_FLOOR_PX = 0.15  # spots lie off a line by so much without meaning anything
_EQUAL = 1e-6


@dataclass(frozen=True, eq=False)
class _Candidate:
    rows: tuple[int, ...]
    misfit: float


def checked_balls(balls_mm: Sequence[float]) -> Floats:
    """Places of a wand's balls along it, from the first, (B,) mm.

    Raises
    ------
    InputError
        If there are fewer than two, or they do not stand one behind the other.
    """
    balls = np.asarray(balls_mm, dtype=np.float64)
    if balls.ndim != 1 or len(balls) < MIN_BALLS:
        raise InputError("a wand has at least two balls: give their places along it, like 0,45,120")
    if not np.isfinite(balls).all() or not (np.diff(balls) > 0).all():
        text = ",".join(f"{b:g}" for b in balls)
        raise InputError(f"wand {text}: expected places that grow from ball to ball, in mm")
    return np.asarray(balls - balls[0])


def is_symmetric(balls_mm: Sequence[float]) -> bool:
    """Whether a wand looks the same when turned round, so that its ends cannot be told apart."""
    balls = checked_balls(balls_mm)
    return bool(np.abs(balls + balls[::-1] - balls[-1]).max() <= _EQUAL * balls[-1])


def find_wand(
    centres: ArrayLike,
    lens: Camera,
    balls_mm: Sequence[float],
    *,
    areas_px: ArrayLike | None = None,
    tolerance_px: float = 1.5,
) -> NDArray[np.int64] | None:
    """Find a wand among the spots of one picture.

    Its balls lie on a line, in the ratios of the wand seen in perspective: the ratio of the
    distances of its ends, which an inner ball tells, lies between 2/3 and 3/2. Equal balls have
    areas in accordance with their distances, so that ghosts and other lights drop out. Between two
    sets of spots that fit about as well nothing is guessed.

    Parameters
    ----------
    centres : (N, 2) float, px
    lens : Camera
        Its pose does not matter.
    balls_mm : B floats
        Places of the balls along the wand. Of two balls, or of balls that stand symmetrically, the
        order cannot be known.
    areas_px : (N,) float, optional
    tolerance_px : float
        How far balls may lie off their line.

    Returns
    -------
    (B,) int64 or None
        Rows of the spots in the order of the balls; None if the wand is not there, not whole, or
        not the only thing that looks like it.
    """
    balls = checked_balls(balls_mm)
    pixels = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
    areas = np.ones(len(pixels)) if areas_px is None else np.asarray(areas_px, dtype=np.float64)
    xy = lens.undistort(pixels)
    rows = np.flatnonzero(np.isfinite(xy[:, 0]))
    rows = rows[np.argsort(-areas[rows], kind="stable")[:_MOST_SPOTS]]
    if len(rows) < len(balls):
        return None
    if len(balls) == 2:
        return _two_balls(rows, areas, is_known=areas_px is not None)
    found = _candidates(xy[rows] * lens.focal_px, areas[rows], balls, tolerance_px)
    if not found:
        return None
    best, *others = sorted(found, key=lambda c: c.misfit)
    rivals = [c for c in others if set(c.rows) != set(best.rows)]
    if rivals and rivals[0].misfit < _BETTER * best.misfit:
        return None
    return rows[list(best.rows)].astype(np.int64)


def _two_balls(
    rows: NDArray[np.intp], areas: Floats, *, is_known: bool
) -> NDArray[np.int64] | None:
    """The two largest spots, if they are alike and nothing else is nearly as large."""
    if areas[rows[0]] > _AREA_RATIO**2 * areas[rows[1]]:
        return None
    if len(rows) > 2 and (not is_known or areas[rows[2]] * _AREA_RATIO > areas[rows[1]]):
        return None
    return np.sort(rows[:2]).astype(np.int64)


def _candidates(p: Floats, areas: Floats, balls: Floats, tolerance_px: float) -> list[_Candidate]:
    """Sets of spots that the wand may be, p (N, 2) px without the lens."""
    found = []
    share = balls / balls[-1]
    for first, last in permutations(range(len(p)), 2):
        along = p[last] - p[first]
        length = float(np.linalg.norm(along))
        if length < 2 * tolerance_px:
            continue
        way = along / length
        s = (p - p[first]) @ way / length  # 0 at the first ball, 1 at the last
        off = (p - p[first]) @ np.array([-way[1], way[0]])
        inner = np.flatnonzero((np.abs(off) <= tolerance_px) & (s > 0) & (s < 1))
        for middle in inner:
            # s = t k / (1 - t + t k), where k is last depth / first depth
            k = float(s[middle] * (1 - share[1]) / (share[1] * (1 - s[middle])))
            if not 1 / _DEPTH_RATIO <= k <= _DEPTH_RATIO:
                continue
            expected = share * k / (1 - share + share * k)
            rows = _rows_at(expected, s, off, length, (first, int(middle), last), tolerance_px)
            if rows is None:
                continue
            misfit = _misfit(rows, expected, s, off, areas, share, k, length)
            if misfit is not None:
                found.append(_Candidate(rows, misfit))
    return found


def _rows_at(
    expected: Floats,
    s: Floats,
    off: Floats,
    length: float,
    known: tuple[int, int, int],
    tolerance_px: float,
) -> tuple[int, ...] | None:
    """The spots nearest to where all balls must be, or None if one is not there."""
    first, second, last = known
    rows = [first, second]
    for at in expected[2:-1]:
        gap = np.hypot((s - at) * length, off)
        row = int(np.argmin(gap))
        if gap[row] > tolerance_px or row in rows or row == last:
            return None
        rows.append(row)
    return (*rows, last)


def _misfit(
    rows: tuple[int, ...],
    expected: Floats,
    s: Floats,
    off: Floats,
    areas: Floats,
    share: Floats,
    k: float,
    length: float,
) -> float | None:
    """How badly spots fit, in units of what means nothing; None if their areas forbid it."""
    picked = list(rows)
    px = np.hypot((s[picked] - expected) * length, off[picked])
    depth = 1 - share + share * k
    sizes = np.log(areas[picked] * depth**2)
    unlike = np.abs(sizes - np.median(sizes))
    if unlike.max() > np.log(_AREA_RATIO):
        return None
    return float(np.hypot(px.max() / _FLOOR_PX, unlike.max() / np.log(1.1))) + 1.0
