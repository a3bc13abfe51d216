"""Tsai's calibration: a camera from one picture of a few known points, and how sure it is."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from .agreement import agreeing_points
from .bundle import Bundle, BundleCamera, BundleData, covariance_of, solve_bundle
from .pose import checked_points, estimate_pose, is_collinear, pose_jacobian
from .projection import TSAI, camera_of, project_one, selection
from .tsai_start import is_coplanar, plane_frame, tsai_start

Floats = NDArray[np.float64]
#: What is estimated beside the pose, and how each moves the intrinsics.
_PARAMETERS = {
    "f": {"fx": 1.0, "fy": 1.0},
    "k1": {"k1": 1.0},
    "cx": {"cx": 1.0},
    "cy": {"cy": 1.0},
    "sx": {"fx": 1.0},
}
_POSE_NAMES = ("rx", "ry", "rz", "tx", "ty", "tz")
_UNITS = {"f": "px", "k1": "", "cx": "px", "cy": "px", "sx": "", "rx": "deg", "ry": "deg",
          "rz": "deg", "tx": "mm", "ty": "mm", "tz": "mm"}  # fmt: skip
_FRONTAL_DEG = 15.0
_WEAK_SHARE = 0.05
_TIED = 0.98
_NEAR_MM, _FAR_MM = 20.0, 50_000.0
_GROSS_SHARE = 0.01  # of the picture's diagonal
_MARKING_PX = 1.5  # residuals up to this may well be marking errors
_MIN_TOLD = 6  # fewer points fit any camera
_MIN_FLAT, _MIN_SOLID = 5, 7  # points that the closed form takes
_DRAWS, _AGREEING_SHARE = 300, 0.6


@dataclass(frozen=True)
class Parameter:
    """One estimated number.

    Attributes
    ----------
    name : str
        f, k1, cx, cy, sx; rx, ry, rz: angles about the fixed axes x, y, z in that order
        (R = Rz Ry Rx), camera from world; tx, ty, tz.
    value, sd : float
    unit : str
        px, mm, deg, or none.
    """

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True, eq=False)
class TsaiCalibration:
    """A camera found from points.

    Attributes
    ----------
    camera : Camera
        With its pose; distortion model ``"tsai"``.
    parameters : tuple of Parameter, length P
    covariance : (P, P) float64
        In the parameters' units.
    state_covariance : (P, P) float64
        The same before angles are made of rotations: intrinsics (fx for sx), then δrotation (rad,
        R = exp(δ) R_found) and translation. The joint test of a known truth uses it.
    residuals : (N, 2) float64, px
        Seen minus projected.
    is_used : (N,) bool
    sd_px : float
        Standard deviation of a coordinate.
    rms_px, rms_used_px : float
    mm_at_target : float
        What the camera's uncertainty amounts to at the points, across the line of sight: the root
        mean square standard deviation, mm.
    is_coplanar : bool
    warnings : tuple of str
    """

    camera: Camera
    parameters: tuple[Parameter, ...]
    covariance: Floats
    state_covariance: Floats
    residuals: Floats
    is_used: NDArray[np.bool_]
    sd_px: float
    rms_px: float
    rms_used_px: float
    mm_at_target: float
    is_coplanar: bool
    warnings: tuple[str, ...]

    @property
    def correlation(self) -> Floats:
        """(P, P) float64."""
        sd = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.covariance / np.outer(sd, sd))

    def __getitem__(self, name: str) -> Parameter:
        """A parameter by its name."""
        return next(p for p in self.parameters if p.name == name)


def tsai(
    points: ArrayLike,
    pixels: ArrayLike,
    image_size: tuple[int, int],
    *,
    camera: Camera | None = None,
    fixed: Collection[str] = ("sx",),
    sd_px: float | None = None,
) -> TsaiCalibration:
    """Calibrate a camera from one picture of known points.

    Radial alignment first, then least squares over all parameters at once, over the points that
    agree with one another.

    Parameters
    ----------
    points : (N, 3) float, mm, world frame
        Coplanar or not.
    pixels : (N, 2) float, px
    image_size : (width, height), px
    camera : Camera, optional
        Known intrinsics: then only the pose is estimated.
    fixed : names among f, k1, cx, cy, sx
        Not estimated: k1 and sx stay 0 and 1, the principal point in the middle of the picture.
    sd_px : float, optional
        Standard deviation of the marking, px; found from the residuals if not given.

    Raises
    ------
    InputError
        If there are too few points for what is asked, they lie on one line, or no camera sees
        them so.
    """
    if camera is not None:
        return _pose_alone(points, pixels, camera, sd_px)
    unknown = sorted(set(fixed) - set(_PARAMETERS))
    if unknown:
        raise ValueError(f"cannot fix {', '.join(unknown)}: there are {', '.join(_PARAMETERS)}")
    if "f" in fixed:
        raise ValueError("to fix f give a camera of known intrinsics")
    free = {name: moves for name, moves in _PARAMETERS.items() if name not in fixed}
    X, uv = checked_points(points, pixels, _MIN_FLAT)
    if is_collinear(X):
        raise InputError("the points lie on one line: no camera can be found from them")
    flat = is_coplanar(X)
    least = max(_MIN_FLAT if flat else _MIN_SOLID, (len(free) + 6 + 2) // 2)
    if len(X) < least:
        kind = "coplanar points" if flat else "points that are not in one plane"
        raise InputError(f"expected at least {least} {kind}, got {len(X)}")
    (f, R, t), good = _start(X, uv, image_size, flat)
    row = _start_row(f, _middle(image_size))
    fit, used = _agreeing_fit(X, uv, free, row, R, t, good, sd_px, least)
    return _calibration(X, uv, image_size, free, fit, used, sd_px, flat)


def _middle(image_size: tuple[int, int]) -> Floats:
    return np.array([(image_size[0] - 1) / 2, (image_size[1] - 1) / 2])


Start = tuple[float, Floats, Floats]


def _start(
    X: Floats, uv: Floats, image_size: tuple[int, int], flat: bool
) -> tuple[Start, NDArray[np.bool_]]:
    """Tsai's closed form, and the points that suit it.

    Of all points; or, where they do not suit any camera or suit it badly, of the few under which
    most of the others do (least median of squares).
    """
    centre = _middle(image_size)
    gross = _GROSS_SHARE * float(np.hypot(*image_size))
    everyone = np.ones(len(X), dtype=bool)
    try:
        start = tsai_start(X, uv, centre)
    except InputError as error:
        failed: InputError | None = error
    else:
        failed = None
        if float(np.median(_start_errors(X, uv, centre, start))) < gross:
            return start, everyone
    few = _MIN_FLAT + 1 if flat else _MIN_SOLID + 1
    best: tuple[float, Start] | None = None
    rng = np.random.default_rng(0)
    for _ in range(_DRAWS if len(X) > few + 1 else 0):
        rows = rng.choice(len(X), few, replace=False)
        if is_collinear(X[rows]) or is_coplanar(X[rows]) != flat:
            continue
        try:
            trial = tsai_start(X[rows], uv[rows], centre)
        except InputError:
            continue
        errors = np.sort(_start_errors(X, uv, centre, trial))
        score = float(errors[int(_AGREEING_SHARE * (len(X) - 1))])
        if best is None or score < best[0]:
            best = score, trial
    if best is not None and best[0] < gross:
        return best[1], _start_errors(X, uv, centre, best[1]) <= max(3 * best[0], 1.0)
    if failed is not None:
        raise InputError(_mirrored(X, uv, centre, gross) or str(failed)) from failed
    return start, everyone


def _start_errors(X: Floats, uv: Floats, centre: Floats, start: Start) -> Floats:
    """Distances of pixels, without distortion; infinite behind the camera."""
    f, R, t = start
    p = X @ R.T + t
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.linalg.norm(f * p[:, :2] / p[:, 2:] + centre - uv, axis=1)
    return np.where(p[:, 2] > 0, off, np.inf)


def _mirrored(X: Floats, uv: Floats, centre: Floats, limit_px: float) -> str | None:
    """Says so if the points fit with an axis negated."""
    for axis, name in enumerate("xyz"):
        if np.ptp(X[:, axis]) == 0:
            continue
        flipped = X * np.where(np.arange(3) == axis, -1.0, 1.0)
        try:
            start = tsai_start(flipped, uv, centre)
        except InputError:
            continue
        rms = float(np.sqrt((_start_errors(flipped, uv, centre, start) ** 2).mean()))
        if rms < limit_px:
            return (
                f"the points look mirrored: with {name} negated the residual falls to {rms:.2g} px"
            )
    return None


def _start_row(f: float, centre: Floats) -> Floats:
    row = np.zeros(16)
    row[:4] = f, f, centre[0], centre[1]
    return row


def _agreeing_fit(
    X: Floats, uv: Floats, free: dict[str, dict[str, float]], row: Floats, R: Floats, t: Floats,
    used: NDArray[np.bool_], sd_px: float | None, least: int,
) -> tuple[Bundle, NDArray[np.bool_]]:  # fmt: skip
    """Points are thrown out one by one, the worst first, and taken back if they fit after all."""
    middle = X.mean(axis=0)
    if used.sum() < least:
        used = np.ones(len(X), dtype=bool)
    fit = _fitted(X, uv, used, free, row, R, t + R @ middle)
    for _ in range(2 * len(X)):
        residuals, J = _judged(X - middle, uv, fit)
        now = agreeing_points(residuals, J, used, sd_px, least=least)
        if (now == used).all():
            break
        worse = used & ~now
        if worse.sum() > 1:  # one bad point may drag good ones along
            size = np.where(worse, (residuals**2).sum(axis=1), -1)
            now = used.copy()
            now[int(np.argmax(size))] = False
        used = now
        pose = fit.target_rotation[0], fit.target_translation[0]
        fit = _fitted(X, uv, used, free, fit.cameras[0].intrinsics, *pose)
    return fit, used


def _fitted(
    X: Floats, uv: Floats, used: NDArray[np.bool_], free: dict[str, dict[str, float]],
    row: Floats, R: Floats, t: Floats,
) -> Bundle:  # fmt: skip
    """Least squares of the used points; the pose is that of the points' middle.

    It turns about the points, not about a far-off origin.
    """
    _, matrix = selection(free)
    camera = BundleCamera(row, TSAI, matrix, np.eye(3), np.zeros(3), pose_is_free=False)
    zeros = np.zeros(int(used.sum()), dtype=np.int64)
    data = BundleData(zeros, zeros, X[used] - X.mean(axis=0), uv[used], np.ones(len(zeros)))
    return solve_bundle([camera], R[None], t[None], data)


def _judged(X: Floats, uv: Floats, fit: Bundle) -> tuple[Floats, Floats]:
    """Residuals (N, 2) of points and their derivatives (N, 2, P) by all parameters."""
    camera = fit.cameras[0]
    R, t = fit.target_rotation[0], fit.target_translation[0]
    k = camera.free.shape[1]
    residuals, J = np.full((len(X), 2), 1e6), np.zeros((len(X), 2, k + 6))
    at, J_row, J_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    for i, turned in enumerate(X @ R.T):
        if project_one(camera.intrinsics, camera.model, *(turned + t), at, J_row, J_point):
            residuals[i] = uv[i] - at
            J[i, :, :k] = J_row @ camera.free
            J[i, :, k : k + 3] = np.cross(turned, J_point)
            J[i, :, k + 3 :] = J_point
    return residuals, J


def _calibration(
    X: Floats, uv: Floats, image_size: tuple[int, int], free: dict[str, dict[str, float]],
    fit: Bundle, used: NDArray[np.bool_], sd_px: float | None, flat: bool,
) -> TsaiCalibration:  # fmt: skip
    middle = X.mean(axis=0)
    residuals, J = _judged(X - middle, uv, fit)
    A = J[used].reshape(-1, J.shape[2])
    freedom = len(A) - A.shape[1]
    squares = (residuals**2).sum(axis=1)
    if sd_px is None and freedom <= 0:
        raise InputError(
            f"{int(used.sum())} points fix {A.shape[1]} parameters but leave nothing to judge them "
            "by: give more points, the marking's standard deviation, or fix some parameters"
        )
    sd = sd_px if sd_px is not None else float(np.sqrt(squares[used].sum() / freedom))
    state = covariance_of(A.T @ A) * max(sd, 1e-12) ** 2
    R = fit.target_rotation[0]
    # from a turn about the points to one about the world's origin
    shift = np.eye(len(state))
    m = R @ middle
    k = len(free)
    # t = T - R m: dt = dT + m x delta
    shift[k + 3 :, k : k + 3] = [[0, -m[2], m[1]], [m[2], 0, -m[0]], [-m[1], m[0], 0]]
    state = shift @ state @ shift.T
    t = fit.target_translation[0] - R @ middle
    camera = camera_of(fit.cameras[0].intrinsics, TSAI, image_size, Rigid.from_rotation(R, t))
    parameters, covariance = _named(tuple(free), camera, state)
    mm = _mm_at(J, covariance_of(A.T @ A) * sd**2, camera, X)
    found = TsaiCalibration(
        camera, parameters, covariance, state, residuals, used, float(sd),
        float(np.sqrt(squares.mean())), float(np.sqrt(squares[used].mean())), mm, flat, (),
    )  # fmt: skip
    return replace(found, warnings=_warnings(found, X, uv, fit.converged))


def _named(
    names: tuple[str, ...], camera: Camera, state: Floats
) -> tuple[tuple[Parameter, ...], Floats]:
    """Parameters in words and their covariance: angles for rotations, a ratio for sx."""
    K, pose = camera.matrix, camera.camera_from_world
    R = pose.rotation

    def angles(delta: Floats) -> Floats:
        turned = Rotation.from_rotvec(delta).as_matrix() @ R
        return np.asarray(Rotation.from_matrix(turned).as_euler("xyz", degrees=True))

    values = {
        "f": K[1, 1],
        "k1": camera.distortion[0] if len(camera.distortion) else 0.0,
        "cx": K[0, 2],
        "cy": K[1, 2],
    }
    values["sx"] = K[0, 0] / K[1, 1]
    k = len(names)
    D = np.eye(k + 6)
    if "sx" in names:
        row = names.index("sx")
        D[row, row] = 1 / K[1, 1]
        if "f" in names:
            # fx moves with f and with sx: sx = fx / fy
            D[row, names.index("f")] = (1 - values["sx"]) / K[1, 1]
    h = 1e-6
    for i in range(3):
        step = np.eye(3)[i] * h
        D[k : k + 3, k + i] = (angles(step) - angles(-step)) / (2 * h)
    covariance = D @ state @ D.T
    sd = np.sqrt(np.maximum(np.diag(covariance), 0))
    numbers = [*(values[n] for n in names), *angles(np.zeros(3)), *pose.translation]
    found = tuple(
        Parameter(n, float(v), float(s), _UNITS[n])
        for n, v, s in zip((*names, *_POSE_NAMES), numbers, sd, strict=True)
    )
    return found, covariance


def _mm_at(J: Floats, covariance: Floats, camera: Camera, X: Floats) -> float:
    """Uncertainty of the points' pictures, in mm at their depth."""
    spread = np.einsum("nij,jk,nik->n", J, covariance, J) / 2
    depth = camera.camera_from_world.apply(X)[:, 2]
    return float(np.sqrt(np.mean(np.maximum(spread, 0) * (depth / camera.focal_px) ** 2)))


def _warnings(found: TsaiCalibration, X: Floats, uv: Floats, converged: bool) -> tuple[str, ...]:
    said = []
    if not converged:
        said.append("the least squares did not settle: the result is not to be trusted")
    said += _weaknesses(found)
    if found.is_coplanar:
        normal = found.camera.camera_from_world.rotation @ plane_frame(X)[0][2]
        tilt = float(np.rad2deg(np.arccos(min(1.0, abs(normal[2])))))
        if tilt < _FRONTAL_DEG:
            said.append(
                f"the target is nearly parallel to the picture ({tilt:.0f}° of tilt): focal length "
                "and distance can hardly be told apart; tilt it by 30° or more"
            )
    spare = 2 * int(found.is_used.sum()) - len(found.parameters)
    if spare < len(found.parameters):
        said.append(
            f"only {int(found.is_used.sum())} points for {len(found.parameters)} parameters: "
            "the stated uncertainty is itself uncertain"
        )
    return (*said, *_unlikely_depth(found, X), *_gross(found, X, uv))


def _unlikely_depth(found: TsaiCalibration, X: Floats) -> list[str]:
    depth = float(np.median(found.camera.camera_from_world.apply(X)[:, 2]))
    if _NEAR_MM < depth < _FAR_MM:
        return []
    return [f"the points would lie {depth:.3g} mm before the camera: are they in millimetres?"]


def _weaknesses(found: TsaiCalibration) -> list[str]:
    """Parameters that the points do not determine, and pairs that trade against each other."""
    said = []
    for p in found.parameters:
        if p.name in ("f", "tz") and p.sd > _WEAK_SHARE * abs(p.value):
            said.append(f"{p.name} is known to {100 * p.sd / abs(p.value):.0f} % only")
        if p.name in ("cx", "cy") and p.sd > _WEAK_SHARE * found.camera.image_size[0]:
            said.append(
                f"{p.name} is known to {p.sd:.0f} px only: fix cx and cy, or take points that are "
                "not in one plane"
            )
    names = [p.name for p in found.parameters]
    C = found.correlation
    if "f" in names and abs(C[names.index("f"), names.index("tz")]) > _TIED:
        said.append(
            f"f and tz move together (correlation {C[names.index('f'), names.index('tz')]:.4f}): "
            "their ratio is known far better than either"
        )
    return said


def _gross(found: TsaiCalibration, X: Floats, uv: Floats) -> list[str]:
    """What a bad fit may come from: mirrored axes, or many wrong points."""
    diagonal = float(np.hypot(*found.camera.image_size))
    if found.rms_used_px < _GROSS_SHARE * diagonal and found.is_used.mean() > 0.6:
        return []
    said = _mirrored(X, uv, _middle(found.camera.image_size), 0.2 * found.rms_px)
    return (
        [said]
        if said
        else [
            f"{found.rms_px:.3g} px of residual is far more than marking errors: "
            "points are paired wrongly, or many are wrong"
        ]
    )


def _pose_alone(
    points: ArrayLike, pixels: ArrayLike, camera: Camera, sd_px: float | None
) -> TsaiCalibration:
    X, uv = checked_points(points, pixels, 4)
    pose = estimate_pose(X, uv, camera, sd_px=sd_px)
    placed = Camera(
        camera.image_size, camera.matrix, pose.camera_from_world, camera.distortion_model,
        camera.distortion,
    )  # fmt: skip
    J = pose_jacobian(
        X, camera, pose.camera_from_world.rotation, pose.camera_from_world.translation
    )
    parameters, covariance = _named((), placed, pose.covariance)
    found = TsaiCalibration(
        placed, parameters, covariance, pose.covariance, pose.residuals, pose.is_used, pose.sd_px,
        pose.rms_px, pose.rms_used_px, _mm_at(J, pose.covariance, placed, X), is_coplanar(X), (),
    )  # fmt: skip
    said = []
    if len(X) < 12:
        gain = np.sqrt(12 / len(X))
        said.append(
            f"{len(X)} points: about {100 * (gain - 1):.0f} % less sure than 12, "
            f"and at most {max(0, (len(X) - 4) // 2)} wrong ones can be told"
        )
    said += _unlikely_depth(found, X)
    mirrored = _mirrored_pose(found, X, uv)
    return replace(found, warnings=(*said, *([mirrored] if mirrored else _gross(found, X, uv))))


def _mirrored_pose(found: TsaiCalibration, X: Floats, uv: Floats) -> str | None:
    """Says so if a pose fits far better with an axis negated."""
    if found.is_coplanar or len(X) < _MIN_TOLD or found.rms_px < _MARKING_PX:
        return None
    rms = {
        name: estimate_pose(X * np.where(np.arange(3) == axis, -1.0, 1.0), uv, found.camera).rms_px
        for axis, name in enumerate("xyz")
    }
    name = min(rms, key=lambda n: rms[n])
    if rms[name] > 0.2 * found.rms_px:
        return None
    return f"the points look mirrored: with {name} negated the residual falls to {rms[name]:.2g} px"
