"""Where cameras roughly stand, from a wand that several of them saw: essential matrices, chained.

Every shared moment gives a pair of cameras as many corresponding points as the wand has balls; the
essential matrix of those (five points, robust) gives their relative pose up to scale, and the
wand's length the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from .rays import Pose, nearest_points, normalised_from_world

Floats = NDArray[np.float64]
#: Moments that a pair of cameras must share.
MIN_SHARED = 8
_EPIPOLAR_PX = 2.0
_MOST_POINTS = 1500  # that a pair's essential matrix is found from
_CONFIDENCE = 0.9999
_WIDE_RAD = 0.15  # between two cameras' rays: wider makes depth no surer
#: Turned round, a symmetrical wand must fit so many times worse, or the moment is not used.
_CLEARER = 2.0
_LEAST_AGREEING = 0.5  # of a pair's points


@dataclass(frozen=True, eq=False)
class WandStart:
    """Where cameras and wand roughly are.

    Attributes
    ----------
    poses : mapping from camera (its row) to Pose
        From the first connected camera's frame, mm; the first one's is the identity.
    xy : (C, T, B, 2) float64
        As given, but balls of symmetrical wands in one order for all cameras.
    """

    poses: dict[int, Pose]
    xy: Floats


def start_from_wand(
    xy: Floats, focal_px: Sequence[float], balls: Floats, *, symmetric: bool
) -> WandStart:
    """Place cameras along the pairs that are surest of each other.

    Parameters
    ----------
    xy : (C, T, B, 2) float64
        Ideal normalised coordinates; NaN where unseen.
    focal_px : C floats
    balls : (B,) float64, mm
    symmetric : bool
        The order of the balls is not known.
    """
    edges = _edges(xy, focal_px, balls, symmetric)
    poses = _tree(_largest_part(edges, len(xy)), edges)
    if symmetric and poses:
        xy = _in_one_order(xy, focal_px, balls, poses)
    return WandStart(poses, xy)


@dataclass(frozen=True, eq=False)
class _Edge:
    pose: Pose  # second camera from first, mm
    weight: float


def _edges(
    xy: Floats, focal_px: Sequence[float], balls: Floats, symmetric: bool
) -> dict[tuple[int, int], _Edge]:
    found = {}
    for a, b in combinations(range(len(xy)), 2):
        edge = _pair(xy[a], xy[b], float(np.sqrt(focal_px[a] * focal_px[b])), balls, symmetric)
        if edge is not None:
            found[a, b] = edge
    return found


def _pair(
    xy_a: Floats, xy_b: Floats, focal_px: float, balls: Floats, symmetric: bool
) -> _Edge | None:
    """The second camera from the first, from the moments in which both see the wand."""
    import cv2

    both = np.isfinite(xy_a[..., 0]) & np.isfinite(xy_b[..., 0])  # (T, B)
    if both.any(axis=1).sum() < MIN_SHARED or both.sum() < 2 * MIN_SHARED:
        return None
    a, b = xy_a[both], xy_b[both]
    if symmetric:  # of the two ways round, one is an outlier
        turned = np.isfinite(xy_a[..., 0]) & np.isfinite(xy_b[:, ::-1, 0])
        a, b = np.concatenate([a, xy_a[turned]]), np.concatenate([b, xy_b[:, ::-1][turned]])
    rows = np.linspace(0, len(a) - 1, min(len(a), _MOST_POINTS)).round().astype(int)
    pa, pb = np.ascontiguousarray(a[rows]), np.ascontiguousarray(b[rows])
    E, mask = cv2.findEssentialMat(
        pa, pb, np.eye(3), method=cv2.USAC_MAGSAC, prob=_CONFIDENCE,
        threshold=_EPIPOLAR_PX / focal_px,
    )  # fmt: skip
    if E is None or E.shape != (3, 3):
        return None
    n, R, t, _ = cv2.recoverPose(E, pa, pb, np.eye(3), mask=mask.copy())
    least = _LEAST_AGREEING * len(rows) * (0.5 if symmetric else 1.0)
    if n < max(least, 5):
        return None
    return _scaled(xy_a, xy_b, (R, t.ravel()), focal_px, balls, symmetric, float(n))


def _scaled(
    xy_a: Floats,
    xy_b: Floats,
    unit: Pose,
    focal_px: float,
    balls: Floats,
    symmetric: bool,
    n_points: float,
) -> _Edge | None:
    """The pose in mm, by the lengths of the wand as the pair sees it."""
    at_origin = (np.eye(3), np.zeros(3))
    views = np.stack([xy_a, xy_b], axis=-2)  # (T, B, 2, 2)
    X = nearest_points([at_origin, unit], views)
    if symmetric:
        turned = np.stack([xy_a, xy_b[:, ::-1]], axis=-2)
        Y = nearest_points([at_origin, unit], turned)
        better = _misfit_px([at_origin, unit], Y, turned, focal_px) < _misfit_px(
            [at_origin, unit], X, views, focal_px
        )
        X = np.where(better[:, None, None], Y, X)
    lengths, true = [], []
    for i, j in combinations(range(len(balls)), 2):
        length = np.linalg.norm(X[:, j] - X[:, i], axis=1)
        keep = np.isfinite(length) & (length > 0)
        lengths.append(length[keep])
        true.append(np.full(int(keep.sum()), balls[j] - balls[i]))
    ratio = np.concatenate(true) / np.concatenate(lengths)
    if not len(ratio):
        return None
    scale = float(np.median(ratio))
    R, t = unit
    middle = X[np.isfinite(X).all(axis=2)]
    rays_a, rays_b = _unit(middle), _unit(middle + R.T @ t)
    angle = float(np.median(np.arccos(np.clip((rays_a * rays_b).sum(axis=1), -1, 1))))
    return _Edge((R, scale * t), n_points * min(angle / _WIDE_RAD, 1.0))


def _unit(p: Floats) -> Floats:
    return np.asarray(p / np.linalg.norm(p, axis=-1, keepdims=True))


def _misfit_px(poses: Sequence[Pose], X: Floats, xy: Floats, focal_px: float) -> Floats:
    """(T,) RMS over what is seen of the wand; infinite where its place is not known."""
    squares, count = np.zeros(X.shape[:-1]), np.zeros(X.shape[:-1])
    for c, pose in enumerate(poses):
        off2 = ((normalised_from_world(pose, X) - xy[..., c, :]) ** 2).sum(axis=-1)
        seen = np.isfinite(xy[..., c, 0]) & np.isfinite(X[..., 0])
        squares += np.where(seen, np.nan_to_num(off2, nan=np.inf), 0.0)
        count += seen
    n = count.sum(axis=-1)
    total = squares.sum(axis=-1)
    return np.where(n > 0, np.sqrt(total / np.maximum(n, 1)) * focal_px, np.inf)


def _largest_part(edges: dict[tuple[int, int], _Edge], n: int) -> set[int]:
    """The largest set of cameras that are connected; of equally large ones the first."""
    parts = [{c} for c in range(n)]
    for a, b in edges:
        of_a = next(p for p in parts if a in p)
        of_b = next(p for p in parts if b in p)
        if of_a is not of_b:
            parts.remove(of_b)
            of_a |= of_b
    return max(parts, key=lambda p: (len(p), -min(p)))


def _tree(part: set[int], edges: dict[tuple[int, int], _Edge]) -> dict[int, Pose]:
    """Poses from the first camera of a part, along the heaviest edges; empty for one camera."""
    if len(part) < 2:
        return {}
    found: dict[int, Pose] = {min(part): (np.eye(3), np.zeros(3))}
    while len(found) < len(part):
        near = {pair: e for pair, e in edges.items() if (pair[0] in found) != (pair[1] in found)}
        a, b = max((pair for pair in near if set(pair) <= part), key=lambda pair: near[pair].weight)
        R, t = near[a, b].pose
        if b in found:  # turn it round
            a, b, R, t = b, a, R.T, -R.T @ t
        Ra, ta = found[a]
        found[b] = R @ Ra, R @ ta + t
    return dict(sorted(found.items()))


def _in_one_order(
    xy: Floats, focal_px: Sequence[float], balls: Floats, poses: dict[int, Pose]
) -> Floats:
    """The balls of each moment so ordered that all cameras agree; NaN where that is not clear."""
    rows = list(poses)
    placed = [poses[c] for c in rows]
    seen = np.moveaxis(xy[rows], 0, 2)  # (T, B, C, 2)
    focal = float(np.median([focal_px[c] for c in rows]))
    ways = list(product((False, True), repeat=len(rows)))
    misfit = np.stack([_way_misfit(seen, way, placed, focal, balls) for way in ways])
    is_seen = np.isfinite(seen[..., 0]).any(axis=1)  # (T, C)
    first = is_seen.argmax(axis=1)
    for w, way in enumerate(ways):
        # the first camera that sees it tells the order; who does not see it is left as is
        idle = (np.array(way)[None] & ~is_seen).any(axis=1) | np.array(way)[first]
        misfit[w][idle] = np.inf
    order = np.sort(misfit, axis=0)
    best = misfit.argmin(axis=0)
    clear = np.isfinite(order[0]) & (order[1] > _CLEARER * np.maximum(order[0], 0.5))
    found = np.array(xy)
    for w, way in enumerate(ways):
        for c, is_turned in zip(rows, way, strict=True):
            if is_turned:
                moments = best == w
                found[c, moments] = xy[c][moments][:, ::-1]
    found[:, ~clear] = np.nan
    return found


def _way_misfit(
    seen: Floats, way: Sequence[bool], poses: Sequence[Pose], focal_px: float, balls: Floats
) -> Floats:
    """(T,) px: how badly rays meet, and how wrong the wand's length comes out."""
    ordered = np.array(seen)
    for c, is_turned in enumerate(way):
        if is_turned:
            ordered[:, :, c] = seen[:, ::-1, c]
    X = nearest_points(poses, ordered)
    rays = _misfit_px(poses, X, ordered, focal_px)
    length = np.linalg.norm(X[:, -1] - X[:, 0], axis=1)
    middle = X.mean(axis=1)
    depth = np.median([np.linalg.norm(middle @ R.T + t, axis=1) for R, t in poses], axis=0)
    wrong = np.abs(length - balls[-1]) * focal_px / depth
    return np.asarray(np.hypot(rays, np.nan_to_num(wrong, nan=0.0)))
