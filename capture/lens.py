"""One camera's lens from many views of a flat board, and which lens model the views support."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from .bundle import Bundle, BundleCamera, BundleData, root_of, solve_bundle
from .pose import is_collinear
from .projection import OPENCV, camera_of, intrinsics_of, project_one, selection
from .tsai import Parameter
from .view_noise import covariance_by_view

Floats = NDArray[np.float64]
MIN_CORNERS = 6
_PINHOLE = ("fx", "fy", "cx", "cy")
#: Lens models from plain to rich: the distortion coefficients that each estimates.
LENS_MODELS: dict[str, tuple[str, ...]] = {
    "none": (),
    "radial1": ("k1",),
    "radial2": ("k1", "k2"),
    "opencv4": ("k1", "k2", "p1", "p2"),
    "opencv5": ("k1", "k2", "p1", "p2", "k3"),
    "opencv8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_FOLDS = 5
#: A richer model is taken if it predicts left-out views better by this share, or by this many
#: standard errors of what it gains from view to view: a term that is missing, however small its
#: part of the residuals, may bias the rest by far more than their stated deviations.
_BETTER, _BETTER_SE = 0.01, 2.0
#: A view is thrown out if its residual is this many times the others' and above this, px.
_WORSE_TIMES, _WORSE_PX = 4.0, 1.0
_ALIKE_DEG = 4.0
_WEAK_SHARE, _USELESS_SHARE = 0.02, 0.25
#: Of the picture's longer side: no lens sees less than about 1°, nor a fisheye fits below.
_FOCAL_RANGE = (0.1, 50.0)


@dataclass(frozen=True, eq=False)
class BoardView:
    """What one picture shows of a board.

    Attributes
    ----------
    name : str
    points : (N, 3) float64, mm, board frame
    pixels : (N, 2) float64, px
    """

    name: str
    points: Floats
    pixels: Floats

    def __post_init__(self) -> None:
        n = len(np.asarray(self.points))
        object.__setattr__(self, "points", readonly(self.points, (n, 3), "points"))
        object.__setattr__(self, "pixels", readonly(self.pixels, (n, 2), "pixels"))


@dataclass(frozen=True)
class RejectedView:
    """A view that was not used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class LensCalibration:
    """A lens and how sure it is.

    Attributes
    ----------
    camera : Camera
        Its pose is the identity.
    model : str
        One of `LENS_MODELS`.
    parameters : tuple of Parameter, length P
    covariance : (P, P) float64
    views : tuple of BoardView
        Those used.
    board_poses : tuple of Rigid
        Camera from board, of the views used.
    residuals : tuple of (N, 2) float64, px
        Seen minus projected, of the views used.
    views_rejected : tuple of RejectedView
    sd_px : float
        Standard deviation of a corner's coordinate.
    rms_px, rms_used_px : float
        Over all points given, and over those used.
    held_out_px : mapping from model to float
        RMS of views that were left out, predicted from the others: infinite where the model folds
        back before a view. Empty if the model was given.
    bow_mm : float
        How far the board's middle stands out from its rim; 0 if it was taken as flat.
    warnings : tuple of str
    """

    camera: Camera
    model: str
    parameters: tuple[Parameter, ...]
    covariance: Floats
    views: tuple[BoardView, ...]
    board_poses: tuple[Rigid, ...]
    residuals: tuple[Floats, ...]
    views_rejected: tuple[RejectedView, ...]
    sd_px: float
    rms_px: float
    rms_used_px: float
    held_out_px: dict[str, float]
    bow_mm: float
    warnings: tuple[str, ...]

    def __getitem__(self, name: str) -> Parameter:
        """A parameter by its name."""
        return next(p for p in self.parameters if p.name == name)


def calibrate_board(
    views: Sequence[BoardView],
    image_size: tuple[int, int],
    *,
    model: str | None = None,
    estimate_bow: bool = False,
    sd_px: float | None = None,
) -> LensCalibration:
    """Calibrate a lens from views of a flat board.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : (width, height), px
    model : str, optional
        One of `LENS_MODELS`; by default the plainest that predicts views it has not seen about
        as well as any (cross-validation over views).
    estimate_bow : bool
        Let the board be bowed: z = bow (1 − (r / r_max)²).
    sd_px : float, optional
        Standard deviation of a corner's coordinate; found from the residuals if not given.

    Raises
    ------
    InputError
        If no view has 6 corners, or the views do not determine the lens.
    """
    given = tuple(views)
    if model is not None and model not in LENS_MODELS:
        raise InputError(f"no lens model {model}; there are {', '.join(LENS_MODELS)}")
    reasons = [unusable(v) for v in given]
    rejected = [RejectedView(v.name, r) for v, r in zip(given, reasons, strict=True) if r]
    usable = [v for v, r in zip(given, reasons, strict=True) if not r]
    if not usable:
        told = "; ".join(f"{v.name}: {v.reason}" for v in rejected[:5])
        raise InputError(
            f"no view shows {MIN_CORNERS} corners or more of the board"
            + (f" ({told})" * bool(told))
        )
    start = _start(usable, image_size)
    first = _fit(usable, image_size, "opencv4" if len(usable) > 2 else "none", start)
    _check_focal(first, image_size)
    usable, bad = _without_bad_views(usable, image_size, first, start)
    rejected += bad
    scores: dict[str, float] = {}
    if model is None:
        squares = _held_out(usable, image_size, start)
        model = _choice(squares) if squares else _few_views_model(len(usable))
        n_points = sum(len(v.points) for v in usable)
        scores = {m: float(np.sqrt(s.sum() / n_points)) for m, s in squares.items()}
    bow = _bow(usable, image_size, model, start) if estimate_bow else 0.0
    fit = _fit(_bowed(usable, bow), image_size, model, start)
    _check_focal(fit, image_size)
    return _calibration(
        given, tuple(usable), image_size, model, fit, tuple(rejected), scores, bow, sd_px
    )


def _check_focal(fit: Bundle, image_size: tuple[int, int]) -> None:
    """Refuse a focal length that ran away: nothing in the views holds it."""
    found = fit.cameras[0].intrinsics[:2]
    low, high = (share * max(image_size) for share in _FOCAL_RANGE)
    if not ((found > low) & (found < high)).all():
        raise _no_focal("it runs away")


def _no_focal(why: str) -> InputError:
    return InputError(
        f"the views do not tell focal length from distance ({why}): a board flat before the "
        "camera looks the same from near and from far; tilt it by 30° and more, in several "
        "directions"
    )


def unusable(view: BoardView) -> str | None:
    """Why nothing can be made of a view; None if something can."""
    if len(view.points) < MIN_CORNERS:
        return f"only {len(view.points)} corners"
    if not (np.isfinite(view.points).all() and np.isfinite(view.pixels).all()):
        return "its corners are not finite numbers"
    if is_collinear(view.points) or is_collinear(view.pixels):
        return "its corners lie on one line"
    return None


def _few_views_model(n_views: int) -> str:
    return "radial1" if n_views > 1 else "none"


def _start(views: Sequence[BoardView], image_size: tuple[int, int]) -> Camera:
    """Focal length from the views' homographies (Zhang 2000), centre in the middle."""
    width, height = image_size
    points = [v.points.astype(np.float32) * (1, 1, 0) for v in views]
    pixels = [v.pixels.astype(np.float32) for v in views]
    K = cv2.initCameraMatrix2D(
        [p.astype(np.float32) for p in points], pixels, image_size, aspectRatio=1.0
    )
    f = float(K[0, 0])
    if not (np.isfinite(f) and 0.2 * width < f < 50 * width):
        f = 1.2 * width
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    return Camera(image_size, K)


def board_pose(view: BoardView, camera: Camera) -> tuple[Floats, Floats]:
    """Camera from board, (3, 3) and (3,) mm, for a known lens.

    Raises
    ------
    InputError
        If the lens reaches fewer than 4 of the view's corners: its distortion folds before them.
    """
    ideal = camera.undistort(view.pixels)
    known = np.isfinite(ideal).all(axis=1)
    if known.sum() < 4:
        raise InputError(
            f"view {view.name}: the lens's distortion folds back before it reaches the corners"
        )
    flat = view.points[known] * (1, 1, 0)
    _, turn, shift = cv2.solvePnP(flat, ideal[known], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    return cv2.Rodrigues(turn)[0], shift.ravel()


def _data(views: Sequence[BoardView]) -> BundleData:
    sizes = [len(v.points) for v in views]
    target = np.repeat(np.arange(len(views)), sizes)
    return BundleData(
        np.zeros(len(target), dtype=np.int64),
        target,
        np.concatenate([v.points for v in views]),
        np.concatenate([v.pixels for v in views]),
        np.ones(len(target)),
    )


def _fit(
    views: Sequence[BoardView],
    image_size: tuple[int, int],
    model: str,
    start: Camera,
    *,
    robust: bool = False,
) -> Bundle:
    free = [*_PINHOLE, *LENS_MODELS[model]] if len(views) > 1 else ["fx", "fy"]
    moves = {n: {n: 1.0} for n in free}
    if len(views) == 1:  # one view: one focal length, centre in the middle
        moves = {"f": {"fx": 1.0, "fy": 1.0}, **{n: {n: 1.0} for n in LENS_MODELS[model][:1]}}
    _, matrix = selection(moves)
    row = np.zeros(16)
    row[:4] = start.matrix[0, 0], start.matrix[1, 1], start.matrix[0, 2], start.matrix[1, 2]
    row[4 : 4 + len(start.distortion)] = start.distortion
    poses = [board_pose(v, start) for v in views]
    camera = BundleCamera(row, OPENCV, matrix, np.eye(3), np.zeros(3), pose_is_free=False)
    R, t = np.stack([p[0] for p in poses]), np.stack([p[1] for p in poses])
    return solve_bundle([camera], R, t, _data(views), robust=robust)


def _camera(fit: Bundle, image_size: tuple[int, int]) -> Camera:
    return camera_of(fit.cameras[0].intrinsics, OPENCV, image_size, Rigid.identity())


def _per_view(fit: Bundle) -> list[Floats]:
    n = len(fit.target_rotation)
    cuts = np.searchsorted(fit.data.target, np.arange(1, n))
    return np.split(fit.residuals, cuts)


def _rms(residuals: Floats) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def _without_bad_views(
    views: list[BoardView], image_size: tuple[int, int], fit: Bundle, start: Camera
) -> tuple[list[BoardView], list[RejectedView]]:
    """Views that do not fit the others (corners in a wrong order, a board that bent) go."""
    rejected = []
    while len(views) > 3:
        sizes = np.array([_rms(r) for r in _per_view(fit)])
        worst = int(np.argmax(sizes))
        others = float(np.median(np.delete(sizes, worst)))
        if sizes[worst] < max(_WORSE_TIMES * others, _WORSE_PX):
            break
        reason = f"residual of {sizes[worst]:.2g} px against {others:.2g} px in the other views"
        rejected.append(RejectedView(views[worst].name, reason))
        views = [v for i, v in enumerate(views) if i != worst]
        fit = _fit(views, image_size, "opencv4" if len(views) > 2 else "none", start)
    return views, rejected


def _held_out(
    views: Sequence[BoardView], image_size: tuple[int, int], start: Camera
) -> dict[str, Floats]:
    """Squares of residuals of each view (V,), left out of the fit but for its pose, by model."""
    if len(views) < 4:
        return {}
    folds = min(_FOLDS, len(views))
    found = {}
    for model in LENS_MODELS:
        squares = np.zeros(len(views))
        for fold in range(folds):
            kept = [v for i, v in enumerate(views) if i % folds != fold]
            left = [v for i, v in enumerate(views) if i % folds == fold]
            squares[fold::folds] = _predicted(left, _fit(kept, image_size, model, start))
        found[model] = squares
    return found


def _predicted(left: Sequence[BoardView], fit: Bundle) -> list[float]:
    """Squares of the residuals of views that a fit has not seen, but for their poses."""
    row = fit.cameras[0].intrinsics
    fixed = BundleCamera(row, OPENCV, np.zeros((16, 0)), np.eye(3), np.zeros(3), False)
    try:
        poses = [board_pose(v, _camera(fit, (1, 1))) for v in left]
    except InputError:  # the model bends where it has not seen points: no prediction at all
        return [np.inf] * len(left)
    R, t = np.stack([p[0] for p in poses]), np.stack([p[1] for p in poses])
    residuals = _per_view(solve_bundle([fixed], R, t, _data(left)))
    return [float((r**2).sum()) for r in residuals]


def _choice(squares: dict[str, Floats]) -> str:
    """The plainest model that predicts as well as the best, as far as can be told."""
    best = min(squares.values(), key=lambda s: float(s.sum()))
    for model, s in squares.items():
        if not np.isfinite(s).all():
            continue
        worse = s - best
        error = float(worse.std(ddof=1)) * np.sqrt(len(worse))
        if worse.sum() <= min(_BETTER_SE * error, ((1 + _BETTER) ** 2 - 1) * best.sum()):
            return model
    raise AssertionError("the best is as good as the best")


def _bowed(views: Sequence[BoardView], bow_mm: float) -> list[BoardView]:
    if not bow_mm:
        return list(views)
    everything = np.concatenate([v.points for v in views])
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle, reach2 = (low + high) / 2, ((high - low)[:2] ** 2).sum() / 4
    found = []
    for v in views:
        r2 = ((v.points - middle)[:, :2] ** 2).sum(axis=1) / reach2
        points = v.points + np.stack([0 * r2, 0 * r2, bow_mm * (1 - r2)], axis=1)
        found.append(replace(v, points=points))
    return found


def _bow(
    views: Sequence[BoardView], image_size: tuple[int, int], model: str, start: Camera
) -> float:
    """The bow that fits best, by a search over the one number."""
    from scipy.optimize import minimize_scalar

    everything = np.concatenate([v.points for v in views])
    most = 0.05 * float(np.ptp(everything, axis=0).max())

    def cost(bow: float) -> float:
        return _fit(_bowed(views, bow), image_size, model, start).cost

    found = minimize_scalar(cost, bounds=(-most, most), method="bounded", options={"xatol": 1e-3})
    return float(found.x)


def _calibration(
    given: tuple[BoardView, ...],
    used: tuple[BoardView, ...],
    image_size: tuple[int, int],
    model: str,
    fit: Bundle,
    rejected: tuple[RejectedView, ...],
    scores: dict[str, float],
    bow_mm: float,
    sd_px: float | None,
) -> LensCalibration:
    camera = _camera(fit, image_size)
    freedom = 2 * len(fit.residuals) - fit.n_parameters
    sd = sd_px if sd_px is not None else float(np.sqrt(fit.cost / max(freedom, 1)))
    covariance = covariance_by_view(fit) * sd**2
    names = [*_PINHOLE, *LENS_MODELS[model]] if len(used) > 1 else ["f", *LENS_MODELS[model][:1]]
    row = dict(zip(("fx", "fy", "cx", "cy"), fit.cameras[0].intrinsics[:4], strict=True))
    row |= {n: fit.cameras[0].intrinsics[4 + i] for i, n in enumerate(
        ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"))}  # fmt: skip
    row["f"] = row["fx"]
    parameters = tuple(
        Parameter(n, float(row[n]), float(np.sqrt(max(c, 0))), "px" if n[0] in "fc" else "")
        for n, c in zip(names, np.diag(covariance), strict=True)
    )
    for p in parameters:
        if p.name in ("f", "fx", "fy") and not p.sd < _USELESS_SHARE * p.value:
            raise _no_focal(f"{p.name} {p.value:.3g} px with a standard deviation of {p.sd:.3g}")
    poses = tuple(
        Rigid.from_rotation(R, t)
        for R, t in zip(fit.target_rotation, fit.target_translation, strict=True)
    )
    residuals = tuple(_per_view(fit))
    thrown = {r.name for r in rejected}
    out = [v for v in given if v.name in thrown and not unusable(v)]
    squares = [(r**2).sum() for r in residuals]
    n_used = sum(len(r) for r in residuals)
    n_all, total = n_used, float(np.sum(squares))
    for view in out:
        R, t = board_pose(view, camera)
        off = camera.project(view.points @ R.T + t) - view.pixels
        off = off[np.isfinite(off).all(axis=1)]
        total, n_all = total + float((off**2).sum()), n_all + len(off)
    found = LensCalibration(
        camera, model, parameters, covariance, used, poses, residuals, rejected, sd,
        float(np.sqrt(total / n_all)), float(np.sqrt(np.sum(squares) / n_used)), scores, bow_mm, (),
    )  # fmt: skip
    return replace(found, warnings=tuple(_warnings(found, fit.converged)))


def _warnings(found: LensCalibration, converged: bool) -> list[str]:
    said = []
    if not converged:
        said.append("the least squares did not settle: the result is not to be trusted")
    n = len(found.views)
    if n == 1:
        said.append("one view only: one focal length was found, with the centre in the middle")
    elif n < 6:
        said.append(f"{n} views are few: 10 to 20 in different poses make a lens sure")
    turns = np.array([pose.rotation[:, 2] for pose in found.board_poses])
    tilt = np.rad2deg(np.arccos(np.clip(np.abs(turns[:, 2]), 0, 1)))
    if n > 1 and float(np.ptp(turns, axis=0).max()) < np.sin(np.deg2rad(_ALIKE_DEG)):
        said.append(
            "all views show the board at nearly the same slant: focal length, distance and centre "
            "cannot be told apart; tilt the board by 30° and more in every direction"
        )
    elif tilt.max() < 15:
        said.append(
            f"the board is never tilted by more than {tilt.max():.0f}°: tilt it by 30° and more"
        )
    for p in found.parameters:
        if p.name in ("f", "fx", "fy") and p.sd > _WEAK_SHARE * p.value:
            said.append(f"{p.name} is known to {100 * p.sd / p.value:.1f} % only")
    share = coverage(found.views, found.camera.image_size)
    if share < 0.5:
        said.append(
            f"corners cover {100 * share:.0f} % of the picture: outside them the distortion is a "
            "guess; bring the board into the corners"
        )
    return said


def coverage(views: Sequence[BoardView], image_size: tuple[int, int], cells: int = 8) -> float:
    """Share of a grid of cells over the picture in which some corner lies."""
    pixels = np.concatenate([v.pixels for v in views])
    at = np.floor(pixels / np.array(image_size) * cells).astype(int)
    at = np.clip(at, 0, cells - 1)
    return len({(int(x), int(y)) for x, y in at}) / cells**2


def point_sd_mm(
    found: LensCalibration, pixels: ArrayLike, distance_mm: float, *, gauge: str = "rotation"
) -> Floats:
    """What the lens's uncertainty amounts to at a distance, across the line of sight, mm.

    First order.

    Parameters
    ----------
    pixels : (..., 2) float, px
    distance_mm : float
        Depth before the camera.
    gauge : str
        ``"rotation"``: a turn of the camera that all its rays share is taken off, by least squares
        over the picture. Whoever finds the camera's pose with this lens turns it just so: a shift
        of the centre is harmless. ``"none"``: it is left in, as for a camera whose axes are known
        from elsewhere.

    Returns
    -------
    (...) float64, mm
        Root mean square of the two directions.

    Raises
    ------
    ValueError
        If there is no such gauge.
    """
    if gauge not in ("rotation", "none"):
        raise ValueError(f"gauge must be rotation or none, not {gauge}")
    xy = found.camera.undistort(pixels)
    flat = xy.reshape(-1, 2)
    moved = _ray_errors(found, flat)
    if gauge == "rotation":
        everywhere = _picture_grid(found.camera)
        errors = _ray_errors(found, everywhere)
        known = np.isfinite(errors).all(axis=(1, 2))
        turns = _under_rotation(everywhere[known]).reshape(-1, 3)
        fitted = np.linalg.lstsq(turns, errors[known].reshape(len(turns), -1), rcond=None)[0]
        moved = moved - _under_rotation(flat) @ fitted
    sd = np.sqrt((moved**2).sum(axis=(1, 2)) / 2) * distance_mm
    return np.asarray(sd.reshape(xy.shape[:-1]))


def _ray_errors(found: LensCalibration, xy: Floats) -> Floats:
    """How the ideal coordinates (N, 2) of fixed pixels change, (N, 2, P): errors = it @ z.

    z are independent standard normal numbers; NaN where the lens cannot be inverted.
    """
    names = [p.name for p in found.parameters]
    moves = {n: ({"fx": 1.0, "fy": 1.0} if n == "f" else {n: 1.0}) for n in names}
    _, matrix = selection(moves)
    root = matrix @ root_of(found.covariance)
    row, model = intrinsics_of(found.camera)
    at, J_row, J_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    errors = np.full((len(xy), 2, len(names)), np.nan)
    for i, (x, y) in enumerate(xy):
        if np.isfinite(x) and project_one(row, model, x, y, 1.0, at, J_row, J_point):
            errors[i] = -np.linalg.solve(J_point[:, :2], J_row @ root)
    return errors


def _picture_grid(camera: Camera) -> Floats:
    """Ideal coordinates (N, 2) of places all over the picture."""
    w, h = camera.image_size
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16 * w, (np.arange(12) + 0.5) / 12 * h)
    return camera.undistort(np.stack([x.ravel(), y.ravel()], axis=1) - 0.5)


def _under_rotation(xy: Floats) -> Floats:
    """How ideal coordinates (N, 2) change with a small rotation of the camera, (N, 2, 3)."""
    x, y = xy.T
    # p = (x, y, 1) + δ × (x, y, 1), divided by its depth
    by_x = np.stack([-x * y, 1 + x * x, -y], axis=1)
    by_y = np.stack([-1 - y * y, x * y, x], axis=1)
    return np.stack([by_x, by_y], axis=1)
