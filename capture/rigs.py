"""Several cameras that share views of one target: their poses, refined all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rig import Rig
from ..core.rigid import Rigid
from .bundle import Bundle, BundleCamera, BundleData, solve_bundle
from .lens import LENS_MODELS, BoardView, RejectedView
from .projection import camera_of, intrinsics_of, selection
from .rig_start import Key, Pose, chain, single_poses, view_poses, views_by_key
from .view_noise import covariance_by_view

Floats = NDArray[np.float64]
_PINHOLE = ("fx", "fy", "cx", "cy")
_WORSE_TIMES, _WORSE_PX = 5.0, 1.5


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A camera rig and how sure it is.

    Attributes
    ----------
    rig : Rig
        The cameras that are connected; the world frame is as asked.
    parameters : mapping from camera to names of estimated intrinsics
    joint_covariance : (S, S) float64
        Of everything that was estimated, with all cross terms. Camera by camera, in the order of
        `rig`: its `parameters`, then δrotation (rad, R = exp(δ) R_found) and centre (mm, world
        frame): `columns` tells where. The first camera is held: its six are zero.
    view_poses : mapping from view to Rigid
        World from target.
    residuals : mapping from (camera, view) to (N, 2) float64, px
    views_rejected : tuple of RejectedView
        Named CAMERA/VIEW.
    unconnected : tuple of str
        Cameras that share no view with the others.
    sd_px : float
    rms_px, rms_used_px : float
    warnings : tuple of str
    """

    rig: Rig
    parameters: Mapping[str, tuple[str, ...]]
    joint_covariance: Floats
    view_poses: Mapping[str, Rigid]
    residuals: Mapping[tuple[str, str], Floats]
    views_rejected: tuple[RejectedView, ...]
    unconnected: tuple[str, ...]
    sd_px: float
    rms_px: float
    rms_used_px: float
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        size = sum(len(self.parameters[n]) + 6 for n in self.rig)
        fixed = readonly(self.joint_covariance, (size, size), "joint_covariance")
        object.__setattr__(self, "joint_covariance", fixed)

    def columns(self, camera: str) -> tuple[slice, slice]:
        """Where a camera's intrinsics, and its δrotation and centre, stand in the covariance."""
        start = 0
        for name in self.rig:
            middle = start + len(self.parameters[name])
            if name == camera:
                return slice(start, middle), slice(middle, middle + 6)
            start = middle + 6
        raise KeyError(camera)

    @property
    def covariance(self) -> dict[str, Floats]:
        """Of each camera's δrotation (rad) and centre (mm, world frame), (6, 6)."""
        outer = {n: self.columns(n)[1] for n in self.rig}
        return {n: self.joint_covariance[at, at] for n, at in outer.items()}

    @property
    def intrinsics_covariance(self) -> dict[str, Floats]:
        """Of each camera's estimated intrinsics, (K, K)."""
        inner = {n: self.columns(n)[0] for n in self.rig}
        return {n: self.joint_covariance[at, at] for n, at in inner.items()}

    @property
    def intrinsics_sd(self) -> dict[str, Floats]:
        """Standard deviations (K,) of each camera's estimated intrinsics."""
        pairs = self.intrinsics_covariance.items()
        return {n: np.sqrt(np.maximum(np.diag(C), 0)) for n, C in pairs}


def calibrate_rig(
    views: Mapping[str, Sequence[BoardView]],
    lenses: Mapping[str, Camera],
    *,
    refine: Mapping[str, str] | None = None,
    world: str = "camera",
    sd_px: float | None = None,
) -> RigCalibration:
    """Poses of cameras from targets that several of them saw at the same time.

    Each camera's poses come from its own views; cameras are chained along the views that they
    share, the pairs that agree best first; then all poses, and the lenses if asked, are refined
    together under Huber's loss.

    Parameters
    ----------
    views : mapping from camera to its views
        Views of the same name were taken at the same moment. Targets need not be flat.
    lenses : mapping from camera to Camera
        Their intrinsics; poses are ignored.
    refine : mapping from camera to lens model, optional
        Cameras whose intrinsics are estimated anew, with a model of `lens.LENS_MODELS`.
    world : str
        ``"camera"``: the first camera's frame. Otherwise the name of a view: the frame of the
        target in it (for a flat board x and y lie in it).
    sd_px : float, optional
        Standard deviation of a corner's coordinate; found from the residuals if not given.

    Raises
    ------
    InputError
        If fewer than two cameras share views, or `world` names no view.
    """
    refine = refine or {}
    _check(views, lenses, refine)
    single = single_poses(views, lenses)
    names = [n for n in views if any(camera == n for camera, _ in single)]
    if len(names) < 2:
        raise InputError("fewer than two cameras see the target")
    poses = chain(names, single)
    unconnected = tuple(n for n in views if n not in poses)
    if len(poses) < 2:
        raise InputError(f"{names[0]} shares no view with any other camera")
    kept = {
        key: view for key, view in views_by_key(views).items() if key[0] in poses and key in single
    }
    start = view_poses(kept, single, poses)
    fit, order = _solve(kept, lenses, refine, poses, start, robust=True)
    kept, rejected = _consistent(kept, fit, order)
    robust_poses = _poses_of(fit, order[0])
    targets = _targets_of(fit, order[1])
    fit, order = _solve(
        kept, _lenses_of(fit, order[0], lenses), refine, robust_poses, targets, robust=False
    )
    return _calibration(
        views, fit, order, lenses, refine, tuple(rejected), unconnected, world, sd_px
    )


def _check(
    views: Mapping[str, Sequence[BoardView]],
    lenses: Mapping[str, Camera],
    refine: Mapping[str, str],
) -> None:
    lacking = [n for n in views if n not in lenses]
    if lacking:
        raise InputError(f"no lens for {', '.join(lacking)}: calibrate each camera's lens first")
    for name, model in refine.items():
        if name not in views:
            raise InputError(f"no camera {name} to refine; there are {', '.join(views)}")
        if model not in LENS_MODELS:
            raise InputError(f"no lens model {model}; there are {', '.join(LENS_MODELS)}")
        if lenses[name].distortion_model == "tsai":
            raise InputError(f"{name} has Tsai's distortion, which a rig does not refine")


Order = tuple[list[str], list[str], list[Key]]


def _solve(
    kept: Mapping[Key, BoardView],
    lenses: Mapping[str, Camera],
    refine: Mapping[str, str],
    poses: Mapping[str, Pose],
    targets: Mapping[str, Pose],
    *,
    robust: bool,
) -> tuple[Bundle, Order]:
    used = {camera for camera, _ in kept}
    cameras = [n for n in poses if n in used]
    views = list(dict.fromkeys(view for _, view in kept))
    keys = sorted(kept, key=lambda k: views.index(k[1]))
    bundle_cameras = []
    for i, name in enumerate(cameras):
        row, model = intrinsics_of(lenses[name])
        free = [*_PINHOLE, *LENS_MODELS[refine[name]]] if name in refine else []
        _, matrix = selection({n: {n: 1.0} for n in free})
        bundle_cameras.append(BundleCamera(row, model, matrix, *poses[name], pose_is_free=i > 0))
    sizes = [len(kept[k].points) for k in keys]
    data = BundleData(
        np.repeat([cameras.index(c) for c, _ in keys], sizes),
        np.repeat([views.index(v) for _, v in keys], sizes),
        np.concatenate([kept[k].points for k in keys]),
        np.concatenate([kept[k].pixels for k in keys]),
        np.ones(sum(sizes)),
    )
    R = np.stack([targets[v][0] for v in views])
    t = np.stack([targets[v][1] for v in views])
    return solve_bundle(bundle_cameras, R, t, data, robust=robust), (cameras, views, keys)


def _poses_of(fit: Bundle, cameras: Sequence[str]) -> dict[str, Pose]:
    pairs = zip(cameras, fit.cameras, strict=True)
    return {n: (c.rotation, c.translation) for n, c in pairs}


def _targets_of(fit: Bundle, views: Sequence[str]) -> dict[str, Pose]:
    return {v: (fit.target_rotation[i], fit.target_translation[i]) for i, v in enumerate(views)}


def _lenses_of(
    fit: Bundle, cameras: Sequence[str], lenses: Mapping[str, Camera]
) -> dict[str, Camera]:
    found = dict(lenses)
    for name, c in zip(cameras, fit.cameras, strict=True):
        size = lenses[name].image_size
        found[name] = camera_of(c.intrinsics, c.model, size, Rigid.identity())
    return found


def _split(fit: Bundle, keys: Sequence[Key], kept: Mapping[Key, BoardView]) -> dict[Key, Floats]:
    ends = np.cumsum([len(kept[k].points) for k in keys])[:-1]
    return dict(zip(keys, np.split(fit.residuals, ends), strict=True))


def _consistent(
    kept: dict[Key, BoardView], fit: Bundle, order: Order
) -> tuple[dict[Key, BoardView], list[RejectedView]]:
    """Pictures of the target that do not fit all the others go."""
    sizes = {k: _rms(r) for k, r in _split(fit, order[2], kept).items()}
    limit = max(_WORSE_TIMES * float(np.median(list(sizes.values()))), _WORSE_PX)
    rejected = [
        RejectedView("/".join(k), f"residual of {s:.2g} px where {limit:.2g} px would be much")
        for k, s in sizes.items()
        if s > limit
    ]
    bad = {k for k, s in sizes.items() if s > limit}
    return {k: v for k, v in kept.items() if k not in bad}, rejected


def _rms(residuals: Floats) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def _calibration(
    views: Mapping[str, Sequence[BoardView]],
    fit: Bundle,
    order: Order,
    lenses: Mapping[str, Camera],
    refine: Mapping[str, str],
    rejected: tuple[RejectedView, ...],
    unconnected: tuple[str, ...],
    world: str,
    sd_px: float | None,
) -> RigCalibration:
    cameras, view_names, keys = order
    kept = {k: v for k, v in views_by_key(views).items() if k in set(keys)}
    residuals = _split(fit, keys, kept)
    freedom = 2 * len(fit.residuals) - fit.n_parameters
    sd = sd_px if sd_px is not None else float(np.sqrt(fit.cost / max(freedom, 1)))
    from_first = _world_from_first(world, fit, view_names)
    placed, names = {}, {}
    for i, name in enumerate(cameras):
        c = fit.cameras[i]
        pose = Rigid.from_rotation(c.rotation, c.translation) @ from_first.inverse()
        placed[name] = camera_of(c.intrinsics, c.model, lenses[name].image_size, pose)
        names[name] = (*_PINHOLE, *LENS_MODELS[refine[name]]) if name in refine else ()
    found = RigCalibration(
        Rig(placed),
        names,
        joint_covariance(fit, sd, from_first),
        {
            v: from_first @ Rigid.from_rotation(fit.target_rotation[i], fit.target_translation[i])
            for i, v in enumerate(view_names)
        },
        residuals,
        rejected,
        unconnected,
        sd,
        _rms_of_all(views, residuals, placed, fit, view_names, from_first),
        fit.rms_px,
        (),
    )
    return replace(found, warnings=tuple(_warnings(found, fit, kept)))


def _world_from_first(world: str, fit: Bundle, views: Sequence[str]) -> Rigid:
    if world == "camera":
        return Rigid.identity()
    if world not in views:
        raise InputError(f"no view {world} to take the world from; there are {', '.join(views)}")
    i = list(views).index(world)
    return Rigid.from_rotation(fit.target_rotation[i], fit.target_translation[i]).inverse()


def joint_covariance(fit: Bundle, sd_px: float, world_from_first: Rigid) -> Floats:
    """`RigCalibration.joint_covariance` of a solution; errors of one view may go together.

    Parameters
    ----------
    fit : Bundle
        In a frame of its own; cameras of fixed pose get zeros.
    sd_px : float
        Times the `sd_px` of the solution's data, the standard deviation of a coordinate.
    world_from_first : Rigid
        From the solution's frame to the world.
    """
    widths = [c.free.shape[1] for c in fit.cameras]
    to_state = np.zeros((sum(widths) + 6 * len(widths), len(fit.information)))
    row = 0
    for i, (camera, width) in enumerate(zip(fit.cameras, widths, strict=True)):
        inner, outer = fit.columns(i)
        to_state[row : row + width, inner] = np.eye(width)
        row += width
        if camera.pose_is_free:
            to_state[row : row + 6, outer] = _centre_from_shift(camera, world_from_first)
        row += 6
    return np.asarray(to_state @ covariance_by_view(fit) @ to_state.T * sd_px**2)


def _centre_from_shift(c: BundleCamera, world_from_first: Rigid) -> Floats:
    """From (δrotation, translation) to (δrotation, centre in the world)."""
    # C = -R't; R -> exp(δ)R: dC = -R'(dt + t × δ) = -R'dt - R'[t]× δ
    t = c.translation
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    D = np.eye(6)
    D[3:, :3], D[3:, 3:] = -c.rotation.T @ cross, -c.rotation.T
    D[3:] = world_from_first.rotation @ D[3:]
    return D


def _rms_of_all(
    views: Mapping[str, Sequence[BoardView]],
    residuals: Mapping[Key, Floats],
    placed: Mapping[str, Camera],
    fit: Bundle,
    view_names: Sequence[str],
    from_first: Rigid,
) -> float:
    """Over all points given whose camera and view are placed, used or not."""
    total, count = 0.0, 0
    for (camera, name), view in views_by_key(views).items():
        if (camera, name) in residuals:
            off = residuals[camera, name]
        elif camera in placed and name in view_names:
            i = list(view_names).index(name)
            target = Rigid.from_rotation(fit.target_rotation[i], fit.target_translation[i])
            off = view.pixels - placed[camera].project((from_first @ target).apply(view.points))
            off = off[np.isfinite(off).all(axis=1)]
        else:
            continue
        total, count = total + float((off**2).sum()), count + len(off)
    return float(np.sqrt(total / count))


def _warnings(found: RigCalibration, fit: Bundle, kept: Mapping[Key, BoardView]) -> list[str]:
    said = []
    if not fit.converged:
        said.append("the least squares did not settle: the result is not to be trusted")
    if found.unconnected:
        named = ", ".join(found.unconnected)
        said.append(f"{named}: shares no view with the other cameras, and is left out")
    counts: dict[str, int] = {}
    for view in {v for _, v in kept}:
        seen = [c for c, v in kept if v == view]
        for camera in seen:
            counts[camera] = counts.get(camera, 0) + (len(seen) > 1)
    for camera, n in counts.items():
        if n < 3:
            said.append(f"{camera} shares only {n} views with others: show the target to both")
    return said
