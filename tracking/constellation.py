"""Names for the points of one instant, from nothing but where they lie.

A search over poses, then a fit of the face's Gaussian, then a decision between assignments:

1. From rotations spread over all of SO(3), the mean face is laid over the points by soft
   assignment whose reach shrinks (expectation maximisation with a uniform share of strays, as in
   Myronenko & Song 2010, many starts at a time).
2. The most likely poses are fitted with the face's modes, softly and then by the Hungarian method,
   each marker against where the others say it is.
3. What has the highest probability of all wins: density of the whole face, a price for every
   marker that is missing and every point that is nobody's. It is held against its neighbours
   (swaps, moves to strays and to missing markers, the best assignment without each pair in turn)
   and against other poses. A name whose best alternative is not clearly worse is refused.

Mirror images are excluded throughout.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from ..core.errors import InputError
from ..core.person import Person
from .face_gaussian import FaceGaussian, gaussian_cost
from .rigid_fit import fit_similarity

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MIN_LABELLED = 6
#: A name is refused unless its best alternative is this much less likely (natural logarithm).
MARGIN = 4.0
_N_STARTS = 360  # rotations; the farthest turn from the nearest is then about 20°
_REACH_MM = (32.0, 26.0, 21.0, 17.0, 14.0)  # of soft assignment, step by step
_SHARP_MM = (12.0, 10.0, 8.0)
_CLOSING_MM = (12.0, 9.0, 7.0, 5.5, 4.5)  # the same while the face is fitted with its modes
_STRAY = 0.1  # share of a point that belongs to nobody, against a marker right at it
_N_KEPT, _N_POSES = 40, 6  # poses sharpened, and fitted with modes
_SAME_POSE_RAD, _SAME_PLACE_MM = 0.35, 80.0
_APART_MM = 75.0  # clouds of points this far apart may be of different faces
_SCALES = (0.6, 1.6)  # of a face against the average one
_SEEN = 0.95  # of markers, roughly, are seen
_STRAY_MM = 200.0  # one stray point in a cube of this side
_SEEN_COST = -float(np.log(_SEEN)) - 3 * float(np.log(_STRAY_MM))  # against being a stray
_MISSING_COST = -float(np.log(1 - _SEEN))
_MAX_STEPS = 30
#: A face is there if half of what could be named is named for certain: the search over poses finds
#: up to a third in clouds of as many points within a face's box.
_MIN_SHARE = 0.5
_RIVAL_SHARE = 0.5  # of a rival's points are also the winner's


@dataclass(frozen=True, eq=False)
class Constellation:
    """Which point is which marker.

    Attributes
    ----------
    point_of_label : (M,) int64
        −1 where a marker is missing or its name refused.
    margin : (M,) float64
        How much less likely (natural logarithm) the best alternative of each name is; of a marker
        that is missing, NaN.
    refused : (M,) int64
        The point that a refused name would have had, else −1.
    evidence : float
        Natural logarithm of how much likelier this face is than stray points.
    scale : float
    rotation : (3, 3); translation : (3,)
        ``x = scale · rotation · p_head + translation`` of the person's neutral face.
    """

    point_of_label: Ints
    margin: Floats
    refused: Ints
    evidence: float
    scale: float
    rotation: Floats
    translation: Floats


@dataclass(frozen=True, eq=False)
class _Pose:
    s: float
    R: Floats
    t: Floats
    match: Ints
    cost: float = np.inf

    def to_head(self, x: Floats) -> Floats:
        return np.asarray((x - self.t) @ self.R / self.s)


def find_constellation(points: Floats, person: Person, *, margin: float = MARGIN) -> Constellation:
    """Name points by where they lie, whatever the head's place and turn.

    Parameters
    ----------
    points : (N, 3) float64, mm
        Without NaN; may hold strays.
    person : Person
        Whose face it is, or `face_variation.anyone`.
    margin : float
        Names whose best alternative is not less likely by this much are refused.

    Raises
    ------
    InputError
        If fewer than 6 points are given, or they do not look like this face.
    """
    if len(points) < MIN_LABELLED:
        raise InputError(
            f"{len(points)} markers are visible in the neutral frame: at least {MIN_LABELLED} are "
            f"needed to tell which is which of {len(person.labels)}"
        )
    gaussian = FaceGaussian(person)
    poses = [_settled(gaussian, points, pose) for pose in _search_poses(points, person)]
    poses = sorted((p for p in poses if (p.match >= 0).any()), key=lambda p: p.cost)
    if not poses:
        raise _no_face(person, 0)
    best, margins = _decided(gaussian, points, poses[0])
    for other in poses[1:]:
        shared = np.isin(other.match[other.match >= 0], best.match).mean()
        if shared < _RIVAL_SHARE:  # it is another face
            continue
        differs = other.match != best.match
        margins[differs] = np.minimum(margins[differs], max(other.cost - best.cost, 0.0))
    found = best.match >= 0
    sure = found & (margins >= margin)
    least = max(MIN_LABELLED, _MIN_SHARE * min(len(points), len(person.labels)))
    if sure.sum() < least:
        raise _no_face(person, int(sure.sum()))
    s, R, t = fit_similarity(person.neutral[sure], points[best.match[sure]])
    if not _SCALES[0] <= s <= _SCALES[1]:
        raise _no_face(person, int(sure.sum()), f", {s:.2f} times as large as the average face")
    return Constellation(
        np.where(sure, best.match, -1),
        np.where(found, margins, np.nan),
        np.where(found & ~sure, best.match, -1),
        _MISSING_COST * len(person.labels) - best.cost,
        s,
        R,
        t,
    )


def _no_face(person: Person, n_sure: int, more: str = "") -> InputError:
    return InputError(
        f"the markers of the neutral frame do not look like marker set {person.marker_set}: "
        f"{n_sure} of {len(person.labels)} can be told for certain{more}; choose a frame that "
        "shows the face at rest, and check the marker set and the camera rig's unit"
    )


# ------------------------------------------------------------------------------ search of poses


@cache
def _spread_rotations(n: int) -> Floats:
    """Super-Fibonacci spirals (Alexa 2022): n rotations evenly over SO(3)."""
    s = np.arange(n) + 0.5
    r, q = np.sqrt(s / n), np.sqrt(1 - s / n)
    a, b = 2 * np.pi * s / np.sqrt(2.0), 2 * np.pi * s / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), q * np.sin(b), q * np.cos(b)], axis=1)
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _search_poses(points: Floats, person: Person) -> list[_Pose]:
    """The most likely poses of the mean face, best first."""
    face = person.neutral
    turns, centres = _spread_rotations(_N_STARTS), _centres(points)
    R = np.tile(turns, (len(centres), 1, 1))
    t = np.repeat(centres, len(turns), axis=0) - R @ face.mean(axis=0)
    s = np.ones(len(R))
    limits = (1.0, 1.0) if person.log_scale_sd == 0 else _SCALES
    for reach in _REACH_MM:
        s, R, t, score = _soft_step(face, points, s, R, t, reach, limits)
    kept = np.argsort(score)[:_N_KEPT]
    s, R, t = s[kept], R[kept], t[kept]
    for reach in _SHARP_MM:
        s, R, t, score = _soft_step(face, points, s, R, t, reach, limits)
    chosen: list[int] = []
    for i in np.argsort(score):
        traces = np.array([np.trace(R[i].T @ R[j]) for j in chosen])
        apart = np.arccos(np.clip((traces - 1) / 2, -1, 1)) > _SAME_POSE_RAD
        apart |= np.linalg.norm(t[i] - t[chosen], axis=1) > _SAME_PLACE_MM
        if apart.all():
            chosen.append(int(i))
        if len(chosen) == _N_POSES:
            break
    none = np.full(len(face), -1, dtype=np.int64)
    return [_Pose(float(s[i]), R[i], t[i], none) for i in chosen]


def _centres(points: Floats) -> Floats:
    """(C, 3) where a face may be: amid all points, and amid each cloud that stands apart."""
    cloud = fcluster(linkage(points, "single"), _APART_MM, criterion="distance")
    clouds = [points[cloud == c] for c in np.unique(cloud)]
    large = [c.mean(axis=0) for c in clouds if len(c) >= MIN_LABELLED]
    return np.array([points.mean(axis=0), *(large if len(clouds) > 1 else [])])


def _soft_step(
    face: Floats,
    points: Floats,
    s: Floats,
    R: Floats,
    t: Floats,
    reach_mm: float,
    limits: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """One step of expectation maximisation from S poses at a time; scores of where it started."""
    S, M, N = len(R), len(face), len(points)
    placed = s[:, None, None] * (face @ np.swapaxes(R, 1, 2)) + t[:, None]
    d2 = (placed**2).sum(axis=2)[:, :, None] + (points**2).sum(axis=1)
    d2 = d2 - 2 * (placed.reshape(-1, 3) @ points.T).reshape(S, M, N)
    closeness = np.exp(np.maximum(d2 / (-2 * reach_mm**2), -80.0), dtype=np.float32)
    of_point = closeness.sum(axis=1) + np.float32(_STRAY)
    # a marker is one point: what several points ask of it is shared
    of_face = np.maximum(closeness.sum(axis=2), 1.0)
    score = -np.log(of_point).sum(axis=1) - np.log(closeness.sum(axis=2) + _STRAY).sum(axis=1)
    share = (closeness / of_point[:, None, :] / of_face[:, :, None]).astype(np.float64)
    total = np.maximum(share.sum(axis=(1, 2)), 1e-9)
    by_marker, by_point = share.sum(axis=2), share.sum(axis=1)
    fc = (by_marker @ face) / total[:, None]
    pc = (by_point @ points) / total[:, None]
    centred = face - fc[:, None]
    H = np.einsum("sni,smn,smj->sij", points - pc[:, None], share, centred, optimize=True)
    U, D, Vt = np.linalg.svd(H)
    sign = np.sign(np.linalg.det(U @ Vt))
    U[..., 2] *= sign[:, None]
    R = U @ Vt
    D[:, 2] *= sign
    spread = np.einsum("sm,smx->s", by_marker, centred**2)
    s = np.clip(D.sum(axis=1) / np.maximum(spread, 1e-9), *limits)
    return s, R, pc - s[:, None] * np.einsum("sij,sj->si", R, fc), score.astype(np.float64)


# ------------------------------------------------------------------------- assignment at a pose


def _settled(gaussian: FaceGaussian, points: Floats, pose: _Pose) -> _Pose:
    """Fit the modes softly, then assign."""
    shape: Floats = gaussian.person.neutral
    for reach in _CLOSING_MM:
        q = pose.to_head(points)
        d2 = ((shape[:, None] - q[None]) ** 2).sum(axis=2)
        closeness = np.exp(d2 / (-2 * reach**2))
        share = closeness / (closeness.sum(axis=0) + _STRAY)
        of_marker = share.sum(axis=1)
        drawn = (share @ q) / np.maximum(of_marker, 1e-9)[:, None]
        fit, shape = gaussian.soft_fit(drawn, np.minimum(of_marker, 1.0) / reach**2)
        pose = _reposed(gaussian, pose, shape, fit)
    return _assigned(gaussian, points, pose, shape)


def _reposed(gaussian: FaceGaussian, pose: _Pose, shape: Floats, fit: Floats) -> _Pose:
    """Move the pose so that a face of this shape lies where the fit has it."""
    s, R, t = fit_similarity(shape, fit)
    if gaussian.person.log_scale_sd == 0:
        s, t = 1.0, fit.mean(axis=0) - R @ shape.mean(axis=0)
    s = float(np.clip(pose.s * s, *_SCALES)) / pose.s
    moved = pose.s * pose.R @ t + pose.t
    return replace(pose, s=pose.s * s, R=pose.R @ R, t=moved)


def _assigned(
    gaussian: FaceGaussian, points: Floats, pose: _Pose, shape: Floats | None = None
) -> _Pose:
    """The best assignment near a pose, and its cost; the pose follows."""
    if shape is not None:
        q = pose.to_head(points)
        near = np.broadcast_to(25.0 * np.eye(3), (len(shape), len(q), 3, 3))
        pose = replace(pose, match=_hungarian(gaussian_cost(q[None] - shape[:, None], near)))
    seen_before: set[bytes] = set()
    for _ in range(_MAX_STEPS):
        pose = _refitted(gaussian, points, pose)
        seen_before.add(pose.match.tobytes())
        match = _hungarian(_costs(gaussian, points, pose))
        if match.tobytes() in seen_before:
            break
        pose = replace(pose, match=match)
    return replace(pose, cost=_joint_costs(gaussian, points, pose, pose.match[None])[0])


def _refitted(gaussian: FaceGaussian, points: Floats, pose: _Pose) -> _Pose:
    """The pose of an assignment; as it was if that has fewer than four points."""
    found = pose.match >= 0
    if found.sum() < 4:
        return pose
    q = _in_labels(pose.to_head(points), pose.match)
    fit, shape = gaussian.soft_fit(q, np.where(found, 1e3, 0.0))
    return _reposed(gaussian, pose, shape, fit)


def _in_labels(q: Floats, match: Ints) -> Floats:
    """Points (N, 3) in the order of labels; NaN where one is missing. `match` is (..., M)."""
    return np.where((match >= 0)[..., None], q[match], np.nan)


def _costs(gaussian: FaceGaussian, points: Floats, pose: _Pose) -> Floats:
    """(M, N): negative log density of each point as each marker, given where the others are."""
    q = pose.to_head(points)
    expected = gaussian.predict(_in_labels(q, pose.match)[None])
    off = q[None] - expected.mean[0][:, None]
    covariance = np.broadcast_to(expected.covariance[0][:, None], (*off.shape, 3))
    return gaussian_cost(off, covariance)


def _hungarian(costs: Floats) -> Ints:
    """Points of labels, (M,), −1 for none, of the least total cost."""
    M, N = costs.shape
    padded = np.full((M, N + M), _MISSING_COST)
    padded[:, :N] = costs + _SEEN_COST
    rows, columns = linear_sum_assignment(padded)
    match = np.full(M, -1, dtype=np.int64)
    match[rows] = np.where(columns < N, columns, -1)
    return match


def _joint_costs(gaussian: FaceGaussian, points: Floats, pose: _Pose, matches: Ints) -> Floats:
    """Cost of each of (A, M) assignments at one pose, against all points being strays."""
    q = _in_labels(pose.to_head(points), matches)
    n_found = (matches >= 0).sum(axis=1)
    joint = gaussian.predict(q).cost
    return np.asarray(joint + _SEEN_COST * n_found + _MISSING_COST * (matches.shape[1] - n_found))


# ------------------------------------------------------------------------------------- decision


def _decided(gaussian: FaceGaussian, points: Floats, pose: _Pose) -> tuple[_Pose, Floats]:
    """Go down to the best assignment around; how much worse each name's best alternative is."""
    margins = np.zeros(len(pose.match))
    for _ in range(_MAX_STEPS):
        others = _alternatives(gaussian, points, pose)
        if not len(others):
            return pose, np.where(pose.match >= 0, np.inf, 0.0)
        worse = _joint_costs(gaussian, points, pose, others) - pose.cost
        differs = others != pose.match
        margins = np.where(differs, worse[:, None], np.inf).min(axis=0)
        if worse.min() >= -1e-6:
            break
        pose = _refitted(gaussian, points, replace(pose, match=others[worse.argmin()]))
        cost = _joint_costs(gaussian, points, pose, pose.match[None])[0]
        pose = replace(pose, cost=cost)
    return pose, margins


def _alternatives(gaussian: FaceGaussian, points: Floats, pose: _Pose) -> Ints:
    """(A, M) assignments that differ in little: the most likely of every kind."""
    costs = _costs(gaussian, points, pose)
    found = np.flatnonzero(pose.match >= 0)
    others = [_swaps(costs, pose.match, found)]
    for label in found:
        without = costs.copy()
        without[label, pose.match[label]] = np.inf
        without = np.where(np.isfinite(without), without, 1e9)
        others.append(_hungarian(without)[None])
        dropped = pose.match.copy()
        dropped[label] = -1
        others.append(dropped[None])
    return np.unique(np.concatenate(others), axis=0)


def _swaps(costs: Floats, match: Ints, found: Ints) -> Ints:
    """For each label, exchanges with the two that mind it least."""
    own = costs[found, match[found]]
    crossed = costs[np.ix_(found, match[found])]
    total = crossed + crossed.T - own[:, None] - own[None]
    np.fill_diagonal(total, np.inf)
    chosen = []
    for i, row in enumerate(total):
        for j in np.argsort(row)[:2]:
            if i != j:
                swapped = match.copy()
                swapped[found[i]], swapped[found[j]] = match[found[j]], match[found[i]]
                chosen.append(swapped)
    return np.array(chosen, dtype=np.int64).reshape(-1, len(match))
