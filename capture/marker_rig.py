"""An existing camera rig against the performer's own markers: did a camera move, and where to.

Markers are points of unknown place, so that they tell everything of the cameras' poses but the
world's place, turn and size: those are kept from the rig as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .bundle import Bundle, BundleCamera, BundleData, solve_bundle
from .camera_shifts import CameraShift, PoseSd, judged_shifts
from .pose import pose_jacobian
from .projection import N_INTRINSICS, intrinsics_of
from .rays import Pose, nearest_points
from .rig_gauge import change_from_step, covariance_in_gauge
from .rigs import RigCalibration
from .spot_matching import MatchedSpots, MatchSpots, SpotFrame, match_spots

Floats = NDArray[np.float64]
_FALSE_ALARM = 1e-3
_FLOOR_PX = 1e-6
_ROUNDS = 3
_LEAST_POINTS = 30
#: Points that three cameras see are enough if each camera has so many; then those of two, which
#: chance may have matched, are left out.
_ENOUGH_POINTS = 100
_POINT_FREE = (False, False, False, True, True, True)
_LARGE_PX = 0.75
_CELL_MM = 20.0  # about the distance of neighbouring markers


@dataclass(frozen=True, eq=False)
class RigRefinement:
    """A rig refined from markers, and what became of its cameras.

    Attributes
    ----------
    calibration : RigCalibration
        In the old rig's world, whose steady cameras stay where they were as well as they can, their
        centres as far apart, on average, as before: the scale. Its views are the frames; it has no
        `view_poses`, since points have no poses.
    shifts : tuple of CameraShift
        One a camera.
    matched : MatchedSpots
    points : (P, 3) float64, mm
        Markers of all frames, in the world of `calibration`.
    """

    calibration: RigCalibration
    shifts: tuple[CameraShift, ...]
    matched: MatchedSpots
    points: Floats

    def mended(self, rig: Rig) -> Rig:
        """The old rig as it was, but for the cameras that moved: those where they stand now."""
        now = {s.camera: s.camera_from_world for s in self.shifts if s.is_moved}
        return Rig({
            name: replace(camera, camera_from_world=now.get(name, camera.camera_from_world))
            for name, camera in rig.cameras.items()
        })  # fmt: skip


def refine_rig(
    rig: Rig,
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    *,
    pose_sd: PoseSd | None = None,
    tolerance_px: float = 1.5,
) -> RigRefinement:
    """Refine the poses of a rig's cameras from unlabelled markers.

    Spots are matched with the rig as it is; a camera whose spots do not fit is placed anew by the
    points that the others see (`match_spots`). Then all poses and points are refined together,
    under Huber's loss first, and each camera is judged: was it moved?

    Parameters
    ----------
    rig : Rig
    frames : sequence of SpotFrame
        Some moments; 50, spread over what is to be judged, are plenty. A camera that moves in
        between fits nowhere.
    match : callable
        As `spot_matching.MatchSpots` says.
    pose_sd : PoseSd, optional
        How well the old poses were known.
    tolerance_px : float
        How far the pictures of a point may lie from where the rig puts them.

    Raises
    ------
    InputError
        If spots do not match, or too few points are seen by two cameras.
    """
    if len(rig) < 2:
        raise InputError("markers refine a rig of two cameras or more")
    matched = match_spots(rig, frames, match, tolerance_px=tolerance_px)
    problem = _Problem.of(matched, frames)
    fit, used = _robust_fit(problem)
    again = _matched_again(matched, fit, frames, match, tolerance_px)
    if again is not None:
        matched = again
        problem = _Problem.of(matched, frames)
        fit, used = _robust_fit(problem)
    return _refinement(rig, problem, fit, used, matched, frames, pose_sd or PoseSd())


def camera_shifts(
    rig: Rig,
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    *,
    pose_sd: PoseSd | None = None,
    tolerance_px: float = 1.5,
) -> tuple[CameraShift, ...]:
    """Which cameras of a rig were moved since it was calibrated, from some frames of markers.

    As `refine_rig`, of which it is the verdict: some tenths of a second for 50 frames.
    """
    found = refine_rig(rig, frames, match, pose_sd=pose_sd, tolerance_px=tolerance_px)
    return found.shifts


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points of unknown place: camera, point (N,), pixels (N, 2), sd (N,), start (P, 3)."""

    rig: Rig
    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    frame: NDArray[np.int64]
    pixels: Floats
    sd: Floats
    start: Floats

    @classmethod
    def of(cls, matched: MatchedSpots, frames: Sequence[SpotFrame]) -> _Problem:
        rig, C = matched.rig, len(matched.rig)
        uv = np.full((len(matched.rows), C, 2), np.nan)
        sd = np.full((len(matched.rows), C), np.nan)
        for p, (f, row) in enumerate(zip(matched.frame, matched.rows, strict=True)):
            for c in np.flatnonzero(row >= 0):
                uv[p, c], sd[p, c] = frames[f].centres[c][row[c]], frames[f].sd_px[c][row[c]]
        keep = _kept(matched.rows)
        uv, sd, frame = uv[keep], sd[keep], matched.frame[keep]
        xy = np.stack([rig[n].undistort(uv[:, c]) for c, n in enumerate(rig)], axis=1)
        X = nearest_points([pose_of(rig[n]) for n in rig], xy)
        good = np.isfinite(X).all(axis=1)
        uv, sd, frame, X = uv[good], sd[good], frame[good], X[good]
        if len(X) < _LEAST_POINTS:
            raise InputError(
                f"only {len(X)} points are seen by two cameras or more: "
                f"{_LEAST_POINTS} are the least; give more frames"
            )
        point, camera = np.nonzero(np.isfinite(uv[..., 0]) & np.isfinite(sd))
        values = sd[point, camera]
        return cls(
            rig, camera, point, frame[point], uv[point, camera], values / np.median(values), X
        )

    def solved(self, fit: Bundle | None, used: NDArray[np.bool_], *, robust: bool) -> Bundle:
        """A solution, from where another ended."""
        cameras = fit.cameras if fit is not None else [_bundle_camera(c) for c in self._cameras]
        X = self.start if fit is None else fit.target_translation
        turns = np.tile(np.eye(3), (len(X), 1, 1))
        data = BundleData(
            self.camera[used], self.point[used], np.zeros((int(used.sum()), 3)),
            self.pixels[used], self.sd[used],
        )  # fmt: skip
        return solve_bundle(
            cameras, turns, X, data, target_free=_POINT_FREE, robust=robust, max_steps=60
        )

    @property
    def _cameras(self) -> list[Camera]:
        return list(self.rig.cameras.values())


def _kept(rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Points that three cameras see, if they suffice for every camera; else all."""
    wide = (rows >= 0).sum(axis=1) >= 3
    if len(rows) and ((rows[wide] >= 0).sum(axis=0) >= _ENOUGH_POINTS).all():
        return np.asarray(wide)
    return np.ones(len(rows), bool)


def pose_of(camera: Camera) -> Pose:
    """A camera's rotation and translation."""
    return camera.camera_from_world.rotation, camera.camera_from_world.translation


def _bundle_camera(camera: Camera) -> BundleCamera:
    row, model = intrinsics_of(camera)
    fixed = np.zeros((N_INTRINSICS, 0))
    return BundleCamera(row, model, fixed, *pose_of(camera), pose_is_free=True)


def _robust_fit(problem: _Problem) -> tuple[Bundle, NDArray[np.bool_]]:
    """Huber's loss finds which spots do not fit; squares over the others."""
    used = np.ones(len(problem.camera), bool)
    fit = problem.solved(None, used, robust=True)
    for _ in range(_ROUNDS):
        now = _agreeing(_residuals_of_all(problem, fit), problem)
        if (now == used).all():
            break
        used = now
        fit = problem.solved(fit, used, robust=True)
    return problem.solved(fit, used, robust=False), used


def _agreeing(residuals: Floats, problem: _Problem) -> NDArray[np.bool_]:
    z2 = (residuals**2).sum(axis=1) / problem.sd**2
    variance = float(np.median(z2)) / (2 * np.log(2))  # of a Gaussian in the plane
    used = z2 <= max(variance * chi2.ppf(1 - _FALSE_ALARM / len(z2), 2), _FLOOR_PX**2)
    views = np.bincount(problem.point[used], minlength=len(problem.start))
    return np.asarray(used & (views[problem.point] >= 2))


def _residuals_of_all(problem: _Problem, fit: Bundle) -> Floats:
    found = np.empty((len(problem.camera), 2))
    for c, camera in enumerate(_placed(problem.rig, [_of(b) for b in fit.cameras])):
        rows = problem.camera == c
        off = problem.pixels[rows] - camera.project(fit.target_translation[problem.point[rows]])
        found[rows] = np.where(np.isfinite(off), off, 1e6)
    return found


def _of(camera: BundleCamera) -> Pose:
    return camera.rotation, camera.translation


def _placed(rig: Rig, poses: Sequence[Pose]) -> list[Camera]:
    return [
        replace(camera, camera_from_world=Rigid.from_rotation(*pose))
        for camera, pose in zip(rig.cameras.values(), poses, strict=True)
    ]


def _matched_again(
    matched: MatchedSpots,
    fit: Bundle,
    frames: Sequence[SpotFrame],
    match: MatchSpots,
    tolerance_px: float,
) -> MatchedSpots | None:
    """The spots matched with the refined rig, if more of them are then; None if not."""
    cameras = _placed(matched.rig, [_of(c) for c in fit.cameras])
    better = Rig(dict(zip(matched.rig, cameras, strict=True)))
    try:
        again = match_spots(better, frames, match, tolerance_px=tolerance_px)
    except InputError:  # a poor first solution: the first matching stands
        return None
    if (again.rows >= 0).sum() <= (matched.rows >= 0).sum():
        return None
    names = tuple(dict.fromkeys((*matched.placed_anew, *again.placed_anew)))
    return replace(again, placed_anew=names)


def _refinement(
    rig: Rig,
    problem: _Problem,
    fit: Bundle,
    used: NDArray[np.bool_],
    matched: MatchedSpots,
    frames: Sequence[SpotFrame],
    pose_sd: PoseSd,
) -> RigRefinement:
    n_points = len(np.unique(problem.point[used]))
    freedom = 2 * int(used.sum()) - 3 * n_points - (6 * len(rig) - 7)
    sd = float(np.sqrt(fit.cost / max(freedom, 1)))
    free = [_of(c) for c in fit.cameras]
    steps = np.linalg.inv(change_from_step(free))
    information = steps.T @ fit.information @ steps / max(sd, 1e-12) ** 2
    information /= _times_told(problem, fit, used, max(sd, 1e-12))
    judged = judged_shifts(rig, free, information, fit.target_translation, pose_sd)
    cameras = _placed(rig, judged.poses)
    off = _residuals_of_all(problem, fit)
    squares = (off**2).sum(axis=1)
    found = RigCalibration(
        rig=Rig(dict(zip(rig, cameras, strict=True))),
        parameters=dict.fromkeys(rig, ()),
        joint_covariance=covariance_in_gauge(information, judged.poses, judged.steady),
        view_poses={},
        residuals=_by_view(problem, off, used, frames),
        views_rejected=(),
        unconnected=(),
        sd_px=sd,
        rms_px=float(np.sqrt(squares.mean())),
        rms_used_px=float(np.sqrt(squares[used].mean())),
        warnings=_warnings(matched, fit, judged.warnings, float(np.sqrt(squares[used].mean()))),
    )
    return RigRefinement(found, judged.shifts, matched, _points(problem, used, cameras))


def _points(problem: _Problem, used: NDArray[np.bool_], cameras: Sequence[Camera]) -> Floats:
    """(P, 3) where rays of placed cameras come nearest to each other."""
    xy = np.full((len(problem.start), len(cameras), 2), np.nan)
    for c, camera in enumerate(cameras):
        rows = used & (problem.camera == c)
        xy[problem.point[rows], c] = camera.undistort(problem.pixels[rows])
    X = nearest_points([pose_of(c) for c in cameras], xy)
    return np.asarray(X[np.isfinite(X).all(axis=1)])


def _times_told(problem: _Problem, fit: Bundle, used: NDArray[np.bool_], sd: float) -> float:
    """How often the same error is told, on average: 1 or more.

    A dot seen at a slant has the same error in all frames, so that a thousand frames are no surer
    than a few. Errors of points of one place (a cell of the world: faces do not travel far) are
    taken as one cluster; the covariance of the estimate is then the sandwich S⁻¹ (Σ g gᵀ) S⁻¹ of
    the clusters' gradients g (Liang & Zeger 1986), of which the mean ratio to S⁻¹ is taken.
    """
    point, camera = problem.point[used], problem.camera[used]
    residuals = _residuals_of_all(problem, fit)[used] / (sd * problem.sd[used, None])
    gradients = np.zeros((len(problem.start), 6 * len(fit.cameras)))
    cameras = _placed(problem.rig, [_of(c) for c in fit.cameras])
    for c, solved in enumerate(fit.cameras):
        rows = camera == c
        X = fit.target_translation[point[rows]]
        J = pose_jacobian(X, cameras[c], solved.rotation, solved.translation)
        J = J / (sd * problem.sd[used][rows, None, None])
        columns = slice(6 * c, 6 * c + 6)
        np.add.at(gradients[:, columns], point[rows], np.einsum("nai,na->ni", J, residuals[rows]))
    seen = np.unique(point)
    cells = np.floor(fit.target_translation[seen] / _CELL_MM)
    _, cluster = np.unique(cells, axis=0, return_inverse=True)
    n = int(cluster.max()) + 1
    sums = np.zeros((n, gradients.shape[1]))
    np.add.at(sums, cluster.ravel(), gradients[seen])
    if n < 2:
        return 1.0
    meat = sums.T @ sums * (n / (n - 1))
    information, scaled = _unit_diagonal(fit.information / sd**2, meat)
    values, vectors = np.linalg.eigh(information)
    held = np.argsort(values)[7:]  # without the gauge
    ratio = np.einsum("ik,ij,jk->k", vectors[:, held], scaled, vectors[:, held]) / values[held]
    return max(float(ratio.mean()), 1.0)


def _unit_diagonal(information: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Both in units in which the information has a diagonal of 1: rad and mm differ by orders."""
    scale = 1 / np.sqrt(np.diag(information))
    both = np.outer(scale, scale)
    return information * both, other * both


def _by_view(
    problem: _Problem, off: Floats, used: NDArray[np.bool_], frames: Sequence[SpotFrame]
) -> dict[tuple[str, str], Floats]:
    found = {}
    for c, name in enumerate(problem.rig):
        for f in np.unique(problem.frame):
            rows = used & (problem.camera == c) & (problem.frame == f)
            if rows.any():
                found[name, frames[f].name] = off[rows]
    return found


def _warnings(
    matched: MatchedSpots, fit: Bundle, judged: Sequence[str], rms_px: float
) -> tuple[str, ...]:
    said = list(judged)
    if not fit.converged:
        said.append("the least squares did not settle: the result is not to be trusted")
    low = [(n, s) for n, s in zip(matched.rig, matched.share, strict=True) if s < 0.6]
    if low:
        told = ", ".join(f"{n} {100 * s:.0f} %" for n, s in low)
        said.append(f"few of the spots could be matched ({told})")
    if rms_px > _LARGE_PX:
        said.append(
            f"residuals of {rms_px:.2g} px are large: a camera that moved in mid-take, lenses of "
            "other cameras, or videos out of step"
        )
    return tuple(said)
