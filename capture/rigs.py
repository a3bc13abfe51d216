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
from .bundle import Bundle, BundleCamera, BundleData, covariance_of, solve_bundle
from .lens import LENS_MODELS, BoardView, RejectedView, board_pose, unusable
from .projection import camera_of, intrinsics_of, selection

Floats = NDArray[np.float64]
_PINHOLE = ("fx", "fy", "cx", "cy")
_WORSE_TIMES, _WORSE_PX = 5.0, 1.5
_MIN_SHARED = 1


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A camera rig and how sure it is.

    Attributes
    ----------
    rig : Rig
        The cameras that are connected; the world frame is as asked.
    covariance : mapping from camera to (6, 6) float64
        Of δrotation (rad, R = exp(δ) R_found) and centre (mm, world frame), against the first
        camera, which is held; zero for it.
    parameters : mapping from camera to names of estimated intrinsics
    intrinsics_covariance : mapping from camera to (K, K) float64
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
    covariance: Mapping[str, Floats]
    parameters: Mapping[str, tuple[str, ...]]
    intrinsics_covariance: Mapping[str, Floats]
    view_poses: Mapping[str, Rigid]
    residuals: Mapping[tuple[str, str], Floats]
    views_rejected: tuple[RejectedView, ...]
    unconnected: tuple[str, ...]
    sd_px: float
    rms_px: float
    rms_used_px: float
    warnings: tuple[str, ...]

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
    single = _single_poses(views, lenses)
    names = [n for n in views if any(camera == n for camera, _ in single)]
    if len(names) < 2:
        raise InputError("fewer than two cameras see the target")
    poses = _chain(names, single)
    unconnected = tuple(n for n in views if n not in poses)
    if len(poses) < 2:
        raise InputError(f"{names[0]} shares no view with any other camera")
    kept = {key: view for key, view in _by_key(views).items() if key[0] in poses and key in single}
    start = _view_poses(kept, single, poses)
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


Key = tuple[str, str]


def _by_key(views: Mapping[str, Sequence[BoardView]]) -> dict[Key, BoardView]:
    return {(camera, v.name): v for camera, seen in views.items() for v in seen}


def _single_poses(
    views: Mapping[str, Sequence[BoardView]], lenses: Mapping[str, Camera]
) -> dict[Key, tuple[Floats, Floats]]:
    """Camera from target, from each view alone."""
    found = {}
    for (camera, name), view in _by_key(views).items():
        if not unusable(view):
            found[camera, name] = _target_pose(view, lenses[camera])
    return found


def _target_pose(view: BoardView, lens: Camera) -> tuple[Floats, Floats]:
    import cv2

    if np.ptp(view.points[:, 2]) <= 1e-3 * np.ptp(view.points[:, :2]):
        return board_pose(view, lens)
    _, turn, shift = cv2.solvePnP(
        view.points, lens.undistort(view.pixels), np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    return cv2.Rodrigues(turn)[0], shift.ravel()


def _chain(
    names: Sequence[str], single: Mapping[Key, tuple[Floats, Floats]]
) -> dict[str, tuple[Floats, Floats]]:
    """Camera from first camera, along a spanning tree of the pairs with most shared views."""
    seen_by: dict[str, set[str]] = {n: set() for n in names}
    for camera, view in single:
        seen_by[camera].add(view)
    first = names[0]
    found: dict[str, tuple[Floats, Floats]] = {first: (np.eye(3), np.zeros(3))}
    while True:
        pairs = [
            (len(seen_by[a] & seen_by[b]), a, b)
            for a in found
            for b in names
            if b not in found and len(seen_by[a] & seen_by[b]) >= _MIN_SHARED
        ]
        if not pairs:
            return found
        _, a, b = max(pairs, key=lambda p: p[0])
        R, t = _relative(a, b, sorted(seen_by[a] & seen_by[b]), single)
        Ra, ta = found[a]
        found[b] = R @ Ra, R @ ta + t


def _relative(
    a: str, b: str, shared: Sequence[str], single: Mapping[Key, tuple[Floats, Floats]]
) -> tuple[Floats, Floats]:
    """b from a: the view's pose under which most of the others agree (a median of poses)."""
    candidates = []
    for view in shared:
        (Ra, ta), (Rb, tb) = single[a, view], single[b, view]
        R = Rb @ Ra.T
        candidates.append((R, tb - R @ ta))
    turns = np.stack([c[0] for c in candidates])
    shifts = np.stack([c[1] for c in candidates])
    cosine = (np.einsum("aij,bij->ab", turns, turns) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    apart = np.linalg.norm(shifts[:, None] - shifts[None], axis=2)
    size = max(float(np.median(np.linalg.norm(shifts, axis=1))), 1e-9)
    best = int(np.argmin(np.median(angle + apart / size, axis=1)))
    return candidates[best]


def _view_poses(
    kept: Mapping[Key, BoardView],
    single: Mapping[Key, tuple[Floats, Floats]],
    poses: Mapping[str, tuple[Floats, Floats]],
) -> dict[str, tuple[Floats, Floats]]:
    """First camera from target, by the camera that sees most of it."""
    best: dict[str, tuple[int, tuple[Floats, Floats]]] = {}
    for (camera, view), seen in kept.items():
        R, t = poses[camera]
        Rv, tv = single[camera, view]
        placed = R.T @ Rv, R.T @ (tv - t)
        if view not in best or len(seen.points) > best[view][0]:
            best[view] = len(seen.points), placed
    return {view: pose for view, (_, pose) in best.items()}


Order = tuple[list[str], list[str], list[Key]]


def _solve(
    kept: Mapping[Key, BoardView],
    lenses: Mapping[str, Camera],
    refine: Mapping[str, str],
    poses: Mapping[str, tuple[Floats, Floats]],
    targets: Mapping[str, tuple[Floats, Floats]],
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


def _poses_of(fit: Bundle, cameras: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
    pairs = zip(cameras, fit.cameras, strict=True)
    return {n: (c.rotation, c.translation) for n, c in pairs}


def _targets_of(fit: Bundle, views: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
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
    kept = {k: v for k, v in _by_key(views).items() if k in set(keys)}
    residuals = _split(fit, keys, kept)
    freedom = 2 * len(fit.residuals) - fit.n_parameters
    sd = sd_px if sd_px is not None else float(np.sqrt(fit.cost / max(freedom, 1)))
    covariance = covariance_of(fit.information) * sd**2
    from_first = _world_from_first(world, fit, view_names)
    placed, spread, names, intrinsics_covariance = {}, {}, {}, {}
    for i, name in enumerate(cameras):
        c = fit.cameras[i]
        pose = Rigid.from_rotation(c.rotation, c.translation) @ from_first.inverse()
        placed[name] = camera_of(c.intrinsics, c.model, lenses[name].image_size, pose)
        inner, outer = fit.columns(i)
        free = (*_PINHOLE, *LENS_MODELS[refine[name]]) if name in refine else ()
        names[name] = free
        intrinsics_covariance[name] = covariance[inner, inner]
        spread[name] = _centre_covariance(c, covariance[outer, outer], from_first)
    found = RigCalibration(
        Rig(placed),
        spread,
        names,
        intrinsics_covariance,
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


def _centre_covariance(c: BundleCamera, covariance: Floats, from_first: Rigid) -> Floats:
    """From (δrotation, translation) to (δrotation, centre in the world)."""
    if not covariance.size:
        return readonly(np.zeros((6, 6)), (6, 6), "covariance")
    # C = -R't; R -> exp(δ)R: dC = -R'(dt + t × δ) = -R'dt - R'[t]× δ
    t = c.translation
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    D = np.eye(6)
    D[3:, :3], D[3:, 3:] = -c.rotation.T @ cross, -c.rotation.T
    D[3:] = from_first.rotation @ D[3:]
    return readonly(D @ covariance @ D.T, (6, 6), "covariance")


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
    for (camera, name), view in _by_key(views).items():
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
