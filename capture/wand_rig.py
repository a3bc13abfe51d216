"""A camera rig from a wand of known length, waved through the space that the cameras see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .bundle import Bundle, BundleCamera, BundleData, solve_bundle
from .lens import LENS_MODELS, RejectedView
from .projection import camera_of, intrinsics_of, selection
from .rays import Pose, nearest_points
from .rigs import RigCalibration, joint_covariance
from .wand_detection import checked_balls, is_symmetric
from .wand_start import MIN_SHARED, start_from_wand
from .wand_warnings import wand_warnings

Floats = NDArray[np.float64]
_PINHOLE = ("fx", "fy", "cx", "cy")
#: Noise alone throws a good ball out in one of so many calibrations.
_FALSE_ALARM = 1e-3
_FLOOR_PX = 1e-6  # pictures without noise
_ROUNDS = 4
#: Holds the wand's spin about itself, which nobody sees; a millionth of what its tilt is known to.
_SPIN_INFORMATION = 1e-3
#: A wand has five parameters that can be seen.
_WAND_PARAMETERS = 5


def calibrate_wand(
    sightings: Mapping[str, ArrayLike],
    lenses: Mapping[str, Camera],
    balls_mm: Sequence[float],
    *,
    refine: Mapping[str, str] | None = None,
    spot_sd: Mapping[str, ArrayLike] | None = None,
    names: Sequence[str] | None = None,
    sd_px: float | None = None,
) -> RigCalibration:
    """Poses of cameras from a wand that several of them saw at the same moments.

    Essential matrices of pairs of cameras, chained along the surest, start a least squares over all
    poses of cameras and wand (and lenses, if asked): first under Huber's loss, then, without the
    balls that do not fit, under squares. The wand's length gives the scale.

    Parameters
    ----------
    sightings : mapping from camera to (T, B, 2) float, px
        Centres of the balls' pictures in the order of `balls_mm`; NaN where unseen. Row t is the
        same moment for all cameras. If the wand looks the same turned round (two balls; equal
        distances), the order in each picture may be either.
    lenses : mapping from camera to Camera
        Their intrinsics; poses are ignored.
    balls_mm : B floats
        Places of the balls along the wand; two or more.
    refine : mapping from camera to lens model, optional
        Cameras whose intrinsics are estimated anew, with a model of `lens.LENS_MODELS`.
    spot_sd : mapping from camera to (T, B) float, optional
        How unsure centres are relative to each other (`Blobs.sd_px`); all alike if not given.
        Only ratios matter.
    names : T texts, optional
        What moments are called; ``"moment 0"`` and so on by default.
    sd_px : float, optional
        Standard deviation of a centre's coordinate (of middling `spot_sd`); found from the
        residuals if not given.

    Returns
    -------
    RigCalibration
        In the frame of the first connected camera. Its views are the moments, its target's x axis
        lies along the wand, from the first ball.

    Raises
    ------
    InputError
        If no two cameras share moments from which their pose can be found, or a wand, lens or
        model does not make sense.
    ValueError
        If arrays have wrong shapes.
    """
    balls = checked_balls(balls_mm)
    refine = dict(refine or {})
    seen = _Seen.of(sightings, lenses, balls, spot_sd, names)
    _check_models(seen, refine)
    xy = np.stack([lenses[n].undistort(p) for n, p in zip(seen.cameras, seen.pixels, strict=True)])
    focal_px = [lenses[n].focal_px for n in seen.cameras]
    symmetric = is_symmetric(balls_mm)
    start = start_from_wand(xy, focal_px, balls, symmetric=symmetric)
    if len(start.poses) < 2:
        raise InputError(_nobody(seen))
    if symmetric:
        seen = seen.ordered_as(xy, start.xy)
    unconnected = tuple(n for c, n in enumerate(seen.cameras) if c not in start.poses)
    seen, xy = seen.of_cameras(list(start.poses)), start.xy[list(start.poses)]
    problem = _Problem.of(seen, xy, list(start.poses.values()), balls, lenses, refine)
    fit, used = _robust_fit(problem)
    return _calibration(seen, problem, fit, used, lenses, refine, unconnected, sd_px)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Sightings as arrays: pixels (C, T, B, 2), NaN where unseen, and sd (C, T, B)."""

    cameras: tuple[str, ...]
    names: tuple[str, ...]
    pixels: Floats
    sd: Floats

    @classmethod
    def of(
        cls,
        sightings: Mapping[str, ArrayLike],
        lenses: Mapping[str, Camera],
        balls: Floats,
        spot_sd: Mapping[str, ArrayLike] | None,
        names: Sequence[str] | None,
    ) -> _Seen:
        if len(sightings) < 2:
            raise InputError("a rig needs at least two cameras")
        lacking = [n for n in sightings if n not in lenses]
        if lacking:
            raise InputError(
                f"no lens for {', '.join(lacking)}: calibrate each camera's lens first"
            )
        T = len(np.asarray(next(iter(sightings.values()))))
        shape = (T, len(balls), 2)
        pixels = np.stack([readonly(p, shape, f"sightings of {n}") for n, p in sightings.items()])
        sd = np.ones(pixels.shape[:3])
        if spot_sd is not None:
            given = [readonly(spot_sd[n], shape[:2], f"spot_sd of {n}") for n in sightings]
            sd = np.stack(given)
            if not (sd[np.isfinite(sd)] > 0).all():
                raise ValueError("spot_sd must be positive")
        unseen = ~(np.isfinite(pixels).all(axis=-1) & np.isfinite(sd))
        pixels[unseen] = np.nan
        sd = np.where(unseen, 1.0, sd / (np.median(sd[~unseen]) if not unseen.all() else 1.0))
        told = tuple(names) if names is not None else tuple(f"moment {t}" for t in range(T))
        if len(set(told)) != T:
            raise ValueError(f"names must be {T} different texts")
        return cls(tuple(sightings), told, pixels, sd)

    def of_cameras(self, rows: Sequence[int]) -> _Seen:
        """Some of the cameras."""
        kept = tuple(self.cameras[c] for c in rows)
        return replace(self, cameras=kept, pixels=self.pixels[rows], sd=self.sd[rows])

    def ordered_as(self, given: Floats, wanted: Floats) -> _Seen:
        """Balls turned round, or dropped, as `wanted` (C, T, B, 2) has it against `given`."""
        dropped = np.isnan(wanted).all(axis=(-1, -2))
        same = np.isclose(given, wanted, rtol=0, atol=0, equal_nan=True).all(axis=(-1, -2))
        turned = ~same & ~dropped
        pixels, sd = np.array(self.pixels), np.array(self.sd)
        pixels[turned], sd[turned] = self.pixels[turned][:, ::-1], self.sd[turned][:, ::-1]
        pixels[dropped] = np.nan
        return replace(self, pixels=pixels, sd=sd)


def _check_models(seen: _Seen, refine: Mapping[str, str]) -> None:
    for name, model in refine.items():
        if name not in seen.cameras:
            raise InputError(f"no camera {name} to refine; there are {', '.join(seen.cameras)}")
        if model not in LENS_MODELS:
            raise InputError(f"no lens model {model}; there are {', '.join(LENS_MODELS)}")


def _nobody(seen: _Seen) -> str:
    whole = np.isfinite(seen.pixels[..., 0]).all(axis=2).sum(axis=1)
    counts = ", ".join(f"{n} in {k}" for n, k in zip(seen.cameras, whole, strict=True))
    return (
        f"no two cameras can be placed from the wand (seen whole by {counts} of "
        f"{len(seen.names)} moments): two cameras must see it together at {MIN_SHARED} moments or "
        "more, in different places; are the balls' places on the wand right, the videos in step, "
        "and the lenses theirs?"
    )


@dataclass(frozen=True, eq=False)
class _Problem:
    """The least squares to solve.

    Attributes
    ----------
    cameras : tuple of BundleCamera
    moments : (L,) int64
        Which moments are targets.
    rotation, translation : (L, 3, 3), (L, 3) float64
        First camera from wand at the start.
    camera, target, ball : (N,) int64
    pixels : (N, 2); sd : (N,) float64
    balls : (B,) float64, mm
    """

    cameras: tuple[BundleCamera, ...]
    moments: NDArray[np.int64]
    rotation: Floats
    translation: Floats
    camera: NDArray[np.int64]
    target: NDArray[np.int64]
    ball: NDArray[np.int64]
    pixels: Floats
    sd: Floats
    balls: Floats

    @classmethod
    def of(
        cls,
        seen: _Seen,
        xy: Floats,
        poses: Sequence[Pose],
        balls: Floats,
        lenses: Mapping[str, Camera],
        refine: Mapping[str, str],
    ) -> _Problem:
        X = nearest_points(poses, np.moveaxis(xy, 0, 2))  # (T, B, 3)
        R, t, is_placed = _wand_poses(X, balls)
        moments = np.flatnonzero(is_placed)
        target_of = np.full(len(X), -1)
        target_of[moments] = np.arange(len(moments))
        camera, moment, ball = np.nonzero(np.isfinite(xy[..., 0]))
        keep = target_of[moment] >= 0
        camera, moment, ball = camera[keep], moment[keep], ball[keep]
        order = np.argsort(target_of[moment], kind="stable")
        camera, moment, ball = camera[order], moment[order], ball[order]
        cameras = []
        for c, name in enumerate(seen.cameras):
            row, model = intrinsics_of(lenses[name])
            free = [*_PINHOLE, *LENS_MODELS[refine[name]]] if name in refine else []
            _, matrix = selection({n: {n: 1.0} for n in free})
            cameras.append(BundleCamera(row, model, matrix, *poses[c], pose_is_free=c > 0))
        return cls(
            tuple(cameras), moments, R[moments], t[moments], camera, target_of[moment], ball,
            seen.pixels[camera, moment, ball], seen.sd[camera, moment, ball], balls,
        )  # fmt: skip

    def data(self, used: NDArray[np.bool_]) -> BundleData:
        """What the solver is given of the used observations."""
        points = np.zeros((int(used.sum()), 3))
        points[:, 0] = self.balls[self.ball[used]]
        return BundleData(
            self.camera[used], self.target[used], points, self.pixels[used], self.sd[used]
        )

    def solved(self, fit: Bundle, used: NDArray[np.bool_], *, robust: bool) -> Bundle:
        """A solution from where another ended."""
        prior = (_SPIN_INFORMATION,) * 3 + (0.0,) * 3
        return solve_bundle(
            fit.cameras, fit.target_rotation, fit.target_translation, self.data(used),
            target_prior=prior, robust=robust,
        )  # fmt: skip

    def first_solved(self) -> Bundle:
        """The robust solution from the start, with everything."""
        prior = (_SPIN_INFORMATION,) * 3 + (0.0,) * 3
        everything = self.data(np.ones(len(self.camera), bool))
        return solve_bundle(
            self.cameras, self.rotation, self.translation, everything,
            target_prior=prior, robust=True,
        )  # fmt: skip


def _wand_poses(X: Floats, balls: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """World from wand (T, 3, 3), (T, 3) of triangulated balls (T, B, 3), and where it is known."""
    known = np.isfinite(X[..., 0])
    is_placed = known.sum(axis=1) >= 2
    R, t = np.tile(np.eye(3), (len(X), 1, 1)), np.zeros((len(X), 3))
    for i in np.flatnonzero(is_placed):
        b, p = balls[known[i]], X[i][known[i]]
        way = (b - b.mean()) @ (p - p.mean(axis=0))
        length = float(np.linalg.norm(way))
        if not length > 0:
            is_placed[i] = False
            continue
        x = way / length
        y = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
        y /= np.linalg.norm(y)
        R[i] = np.column_stack([x, y, np.cross(x, y)])
        t[i] = p.mean(axis=0) - b.mean() * x
    return R, t, is_placed


def _robust_fit(problem: _Problem) -> tuple[Bundle, NDArray[np.bool_]]:
    """Huber's loss finds which balls do not fit; squares over the others."""
    n = len(problem.camera)
    used = np.ones(n, bool)
    fit = problem.first_solved()
    for _ in range(_ROUNDS):
        now = _agreeing(_residuals_of_all(problem, fit), problem)
        if (now == used).all():
            break
        used = now
        fit = problem.solved(fit, used, robust=True)
    return problem.solved(fit, used, robust=False), used


def _agreeing(residuals: Floats, problem: _Problem) -> NDArray[np.bool_]:
    """Observations that noise explains, of wands that two cameras and two balls still hold."""
    z2 = (residuals**2).sum(axis=1) / problem.sd**2
    variance = float(np.median(z2)) / (2 * np.log(2))  # of a Gaussian in the plane
    limit = max(variance * chi2.ppf(1 - _FALSE_ALARM / len(z2), 2), _FLOOR_PX**2)
    used = z2 <= limit
    n_targets = len(problem.moments)
    by_camera = np.zeros((n_targets, len(problem.cameras)), bool)
    by_ball = np.zeros((n_targets, len(problem.balls)), np.int64)
    by_camera[problem.target[used], problem.camera[used]] = True
    np.add.at(by_ball, (problem.target[used], problem.ball[used]), 1)
    held = (by_camera.sum(axis=1) >= 2) & ((by_ball >= 2).sum(axis=1) >= 2)
    return np.asarray(used & held[problem.target])


def _residuals_of_all(problem: _Problem, fit: Bundle) -> Floats:
    """(N, 2) px, used or not; far where a ball comes to lie behind a camera."""
    found = np.full((len(problem.camera), 2), 1e6)
    X = fit.target_rotation[problem.target, :, 0] * problem.balls[problem.ball][:, None]
    X = X + fit.target_translation[problem.target]
    for c, solved in enumerate(fit.cameras):
        rows = np.flatnonzero(problem.camera == c)
        pose = Rigid.from_rotation(solved.rotation, solved.translation)
        camera = camera_of(solved.intrinsics, solved.model, (1, 1), pose)
        off = problem.pixels[rows] - camera.project(X[rows])
        found[rows] = np.where(np.isfinite(off), off, 1e6)
    return found


def _calibration(
    seen: _Seen,
    problem: _Problem,
    fit: Bundle,
    used: NDArray[np.bool_],
    lenses: Mapping[str, Camera],
    refine: Mapping[str, str],
    unconnected: tuple[str, ...],
    sd_px: float | None,
) -> RigCalibration:
    rig = Rig({
        name: camera_of(
            c.intrinsics, c.model, lenses[name].image_size,
            Rigid.from_rotation(c.rotation, c.translation),
        )
        for name, c in zip(seen.cameras, fit.cameras, strict=True)
    })  # fmt: skip
    moments = np.unique(problem.target[used])
    n_parameters = len(fit.information) + _WAND_PARAMETERS * len(moments)
    sd = sd_px if sd_px is not None else _sd_px(fit, n_parameters)
    off = _residuals_of_all(problem, fit)
    residuals: dict[tuple[str, str], Floats] = {}
    poses = {}
    for k in moments:
        name = seen.names[problem.moments[k]]
        poses[name] = Rigid.from_rotation(fit.target_rotation[k], fit.target_translation[k])
    ends = np.flatnonzero(np.diff(problem.target[used] * len(rig) + problem.camera[used])) + 1
    for rows in np.split(np.flatnonzero(used), ends):
        first = rows[0]
        moment = seen.names[problem.moments[problem.target[first]]]
        residuals[seen.cameras[problem.camera[first]], moment] = off[rows]
    squares = (off**2).sum(axis=1)
    found = RigCalibration(
        rig=rig,
        parameters={
            n: (*_PINHOLE, *LENS_MODELS[refine[n]]) if n in refine else () for n in seen.cameras
        },
        joint_covariance=joint_covariance(fit, sd, Rigid.identity()),
        view_poses=poses,
        residuals=residuals,
        views_rejected=_rejected(seen, problem, used, np.sqrt(squares)),
        unconnected=unconnected,
        sd_px=sd,
        rms_px=float(np.sqrt(squares.mean())),
        rms_used_px=float(np.sqrt(squares[used].mean())),
        warnings=(),
    )
    counts = np.bincount(problem.ball, minlength=len(problem.balls))
    kept = np.bincount(problem.ball[used], minlength=len(problem.balls))
    said = wand_warnings(found, problem.balls, seen.pixels, 1 - kept / np.maximum(counts, 1))
    if not fit.converged:
        said = ("the least squares did not settle: the result is not to be trusted", *said)
    return replace(found, warnings=said)


def _sd_px(fit: Bundle, n_parameters: int) -> float:
    return float(np.sqrt(fit.cost / max(2 * len(fit.residuals) - n_parameters, 1)))


def _rejected(
    seen: _Seen, problem: _Problem, used: NDArray[np.bool_], size_px: Floats
) -> tuple[RejectedView, ...]:
    found = []
    for n in np.flatnonzero(~used):
        name = f"{seen.cameras[problem.camera[n]]}/{seen.names[problem.moments[problem.target[n]]]}"
        reason = f"ball {problem.ball[n]} lies {size_px[n]:.2g} px from where the others put it"
        found.append(RejectedView(name, reason))
    return tuple(found)
