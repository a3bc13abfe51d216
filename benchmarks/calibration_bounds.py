"""How close calibration comes to the best that its data allow, and whether it knows how close.

    python benchmarks/calibration_bounds.py [--seeds 2000] [--rig-seeds 200] [--out FILE]

For each study a camera, a target and its pose are drawn anew with every seed; pixels are
projected exactly and Gaussian noise of known size is added. The Cramér-Rao bound is the inverse of
J'J/σ² with the exact Jacobian at the truth. Errors are divided by their own draw's bound before
they are pooled:

- *error / bound*: root mean square of error over bound; 1 is the best an unbiased estimator can do.
- *covered*: how often the stated 95 % interval (Student's t, the noise being estimated) holds the
  truth; *jointly*: how often the stated 95 % region of all parameters does (F).
- A parameter is *weak* in a draw if its bound exceeds 5 % of its value. Values that depend on where
  the origin is are measured against f (principal point), the distance (translation) and 1 rad
  (rotation). Weak parameters are judged jointly only. Joint regions of Tsai's parameters are
  judged in 1/f, κ1/f² and tz/f, in which pixels are nearly linear: a weak f has a curved region.

Then: pose against OpenCV's `solvePnP` on the same points, with and without 30 % wrong points; and
the time for 4 cameras of 100 views against OpenCV's `calibrateMultiview`.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.capture.bundle import Bundle, BundleCamera, BundleData, solve_bundle
from facewright.capture.lens import LENS_MODELS, BoardView, calibrate_board
from facewright.capture.pose import estimate_pose
from facewright.capture.projection import intrinsics_of, selection
from facewright.capture.rigs import RigCalibration, calibrate_rig
from facewright.capture.tsai import tsai
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.files import atomic_write
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.board_poses import camera_poses, rig_poses, sees

Floats = NDArray[np.float64]
SIZE = (1280, 960)
CENTRE = np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
LEVEL = 0.95
WEAK_SHARE = 0.05
BOUND_LIMIT, COVERED = 1.10, (0.93, 0.97)
TSAI_SD_PX, POSE_SD_PX, BOARD_SD_PX = 0.1, 0.5, 0.15
#: A wrong point lies at least so far from where it should, px.
WRONG_PX = 20.0


@dataclass(frozen=True, eq=False)
class Trial:
    """One calibration against its truth.

    Attributes
    ----------
    names : tuple of str, length P
        Parameters that are pooled under one name share it.
    errors : (P,) float64
    bound, stated : (P, P) float64
        Covariances: the Cramér-Rao bound, and what the calibration says.
    freedom : int
        Of the estimated noise.
    scale : (P,) float64
        What 5 % are taken of.
    truth : (P,) float64, optional
    bend : callable, optional
        From (P,) parameters to (P,) coordinates, each of the same place, in which the pixels are
        more nearly linear: joint regions are judged in them.
    """

    names: tuple[str, ...]
    errors: Floats
    bound: Floats
    stated: Floats
    freedom: int
    scale: Floats
    truth: Floats | None = None
    bend: Callable[[Floats], Floats] | None = None


Study = Callable[[np.random.Generator], Trial]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=2000)
    parser.add_argument("--rig-seeds", type=int, default=200)
    parser.add_argument("--views", type=int, default=100, help="of each camera, for the timing")
    parser.add_argument("--out", type=Path, help="also write the tables to this file")
    parser.add_argument("--only", nargs="*", help="some of the parts, by name")
    options = parser.parse_args()
    studies: dict[str, tuple[Study, int]] = {
        "tsai-coplanar": (tsai_coplanar, options.seeds),
        "tsai-telephoto": (tsai_telephoto, options.seeds),
        "tsai-non-coplanar": (tsai_solid, options.seeds),
        "pose": (pose_from_points, options.seeds),
        "board": (board_lens, options.seeds),
        "rig": (rig_of_cameras, options.rig_seeds),
        "rig-with-lenses": (rig_with_lenses, options.rig_seeds),
    }
    parts: dict[str, Callable[[], list[str]]] = {
        name: lambda name=name, study=study, n=n: study_rows(name, study, n)  # type: ignore[misc]
        for name, (study, n) in studies.items()
    }
    parts["peer"] = lambda: peer_rows(options.seeds)
    parts["speed"] = lambda: speed_rows(options.views)
    lines = [
        f"facewright {__version__}, seeds from 0; {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}",
    ]
    print(lines[0], flush=True)
    for name, part in parts.items():
        if not options.only or name in options.only:
            found = part()
            lines += found
            print("\n".join(found), flush=True)
    if options.out:
        with atomic_write(options.out) as stream:
            stream.write("\n".join(lines) + "\n")


def study_rows(name: str, study: Study, n: int) -> list[str]:
    """The table of one study."""
    start = time.perf_counter()
    trials = [study(np.random.default_rng(seed)) for seed in range(n)]
    took = time.perf_counter() - start
    rows = [
        "",
        f"## {name}: {n} seeds, {1e3 * took / n:.0f} ms each",
        "",
        "| parameter | draws | error / bound | covered | weak draws | reached |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    pooled: dict[str, list[tuple[float, float, bool]]] = {}
    for trial in trials:
        for found in _judged(trial):
            pooled.setdefault(found[0], []).append(found[1:])
    for parameter, seen in pooled.items():
        strong = np.array([(ratio, z) for ratio, z, weak in seen if not weak]).reshape(-1, 2)
        weak = len(seen) - len(strong)
        if len(strong) < max(10, len(seen) // 20):
            rows.append(f"| {parameter} | {len(strong)} | | | {weak} | jointly |")
            continue
        ratio, covered = float(np.sqrt((strong[:, 0] ** 2).mean())), float(strong[:, 1].mean())
        rows.append(
            f"| {parameter} | {len(strong)} | {ratio:.3f} | {100 * covered:.1f} % | {weak} | "
            f"{_verdict(ratio, covered)} |"
        )
    strong = np.array([(r, z) for seen in pooled.values() for r, z, weak in seen if not weak])
    ratio, covered = float(np.sqrt((strong[:, 0] ** 2).mean())), float(strong[:, 1].mean())
    rows.append(
        f"| pooled | {len(strong)} | {ratio:.3f} | {100 * covered:.1f} % | | "
        f"{_verdict(ratio, covered)} |"
    )
    rows.append(_joint_row("all, jointly", [(t, np.ones(len(t.names), bool)) for t in trials]))
    weak_ones = [(t, _is_weak(t)) for t in trials]
    rows.append(_joint_row("weak ones, jointly", [(t, w) for t, w in weak_ones if w.any()]))
    return rows


def _joint_row(name: str, judged: list[tuple[Trial, NDArray[np.bool_]]]) -> str:
    if len(judged) < 20:
        return f"| {name} | {len(judged)} | | | | too few to judge |"
    covered = float(np.mean([_jointly(t, which) for t, which in judged]))
    # so few draws that chance alone may leave the limits: the share's own 95 % interval is told
    spread = stats.binomtest(round(covered * len(judged)), len(judged)).proportion_ci()
    told = _verdict(1.0, covered)
    if told != "yes" and spread.low <= COVERED[1] and spread.high >= COVERED[0]:
        told += f" (chance allows {100 * spread.low:.1f} to {100 * spread.high:.1f} %)"
    return f"| {name} | {len(judged)} | | {100 * covered:.1f} % | | {told} |"


def _is_weak(trial: Trial) -> NDArray[np.bool_]:
    return np.asarray(np.sqrt(np.diag(trial.bound)) > WEAK_SHARE * trial.scale)


def _judged(trial: Trial) -> list[tuple[str, float, bool, bool]]:
    """Name, error over bound, whether the stated interval covers it, whether it is weak."""
    ratio = trial.errors / np.sqrt(np.diag(trial.bound))
    reach = stats.t.ppf((1 + LEVEL) / 2, trial.freedom) * np.sqrt(np.diag(trial.stated))
    covered = np.abs(trial.errors) <= reach
    rows = zip(trial.names, ratio, covered, _is_weak(trial), strict=True)
    return [(name, float(r), bool(c), bool(w)) for name, r, c, w in rows]


def _jointly(trial: Trial, which: NDArray[np.bool_]) -> bool:
    """Whether the stated joint region of some parameters holds the truth."""
    e, C = trial.errors, trial.stated
    if trial.truth is not None and trial.bend is not None:
        found = trial.truth - e
        steps = 1e-6 * np.maximum(np.abs(found), 1.0)
        D = np.column_stack(
            [
                (trial.bend(found + h * axis) - trial.bend(found - h * axis)) / (2 * h)
                for h, axis in zip(steps, np.eye(len(e)), strict=True)
            ]
        )
        e, C = trial.bend(trial.truth) - trial.bend(found), D @ C @ D.T
    e, C = e[which], C[np.ix_(which, which)]
    scale = np.sqrt(np.diag(C))
    d2 = float(e / scale @ np.linalg.solve(C / np.outer(scale, scale), e / scale))
    return d2 <= len(e) * float(stats.f.ppf(LEVEL, len(e), trial.freedom))


def _verdict(ratio: float, covered: float) -> str:
    low, high = COVERED
    said = [] if ratio <= BOUND_LIMIT else [f"no: {ratio:.2f} > {BOUND_LIMIT}"]
    said += [] if low <= covered <= high else [f"no: {100 * covered:.1f} %"]
    return "; ".join(said) or "yes"


def _turn(rng: np.random.Generator, least_deg: float, most_deg: float, roll_deg: float) -> Floats:
    """A rotation tilted by some angle any way, then rolled."""
    way, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(least_deg, most_deg))
    tilted = Rotation.from_rotvec(tilt * np.array([np.cos(way), np.sin(way), 0]))
    roll = Rotation.from_rotvec([0, 0, np.deg2rad(rng.uniform(-roll_deg, roll_deg))])
    return np.asarray((roll * tilted).as_matrix())


def _state_error(truth: Rigid, found: Rigid) -> Floats:
    """δrotation (R_true = exp(δ) R_found) and translation, true less found, (6,)."""
    turn = Rotation.from_matrix(truth.rotation @ found.rotation.T).as_rotvec()
    return np.concatenate([turn, truth.translation - found.translation])


def _at_truth(
    camera: Camera, free: dict[str, dict[str, float]], X: Floats, uv: Floats, sd_px: float
) -> Bundle:
    """The information of one target's points, at the truth."""
    row, model = intrinsics_of(camera)
    pose = camera.camera_from_world
    still = BundleCamera(row, model, selection(free)[1], np.eye(3), np.zeros(3), False)
    zeros = np.zeros(len(X), dtype=np.int64)
    data = BundleData(zeros, zeros, X, uv, np.full(len(X), sd_px))
    return solve_bundle([still], pose.rotation[None], pose.translation[None], data, max_steps=0)


def _inverse(information: Floats) -> Floats:
    return np.asarray(np.linalg.inv(information), np.float64)


def tsai_coplanar(rng: np.random.Generator) -> Trial:
    """A plate of 12 × 10 points, tilted by 35° to 50°, through a lens of strong distortion.

    With little distortion a plane does not tell where the principal point is.
    """
    x, y = np.meshgrid(np.arange(12) - 5.5, np.arange(10) - 4.5)
    plate = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]) * 20.0
    return _tsai_trial(rng, plate, _turn(rng, 35, 50, 180), fill=0.9)


def tsai_telephoto(rng: np.random.Generator) -> Trial:
    """Like Willson's set: a plate far away through a long lens, where f and depth are weak."""
    x, y = np.meshgrid(np.arange(10) - 4.5, np.arange(10) - 4.5)
    plate = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]) * 20.0
    tilted = Rotation.from_euler("xyz", [20, 5, rng.uniform(0, 360)], degrees=True).as_matrix()
    return _tsai_trial(rng, plate, tilted, fill=0.42, f=11700.0, kappa=-43.0, sd_px=0.08)


def tsai_solid(rng: np.random.Generator) -> Trial:
    """40 points in a box of 250 × 200 × 200 mm."""
    box = rng.uniform(-0.5, 0.5, (40, 3)) * (250.0, 200.0, 200.0)
    return _tsai_trial(rng, box, Rotation.random(random_state=rng).as_matrix(), fill=0.9)


def _tsai_trial(
    rng: np.random.Generator, X: Floats, R: Floats, *, fill: float, f: float | None = None,
    kappa: float | None = None, sd_px: float = TSAI_SD_PX,
) -> Trial:  # fmt: skip
    f = f or rng.uniform(1100, 1500)
    centre = CENTRE + rng.uniform(-12, 12, 2)
    K = np.array([[f, 0, centre[0]], [0, f, centre[1]], [0, 0, 1.0]])
    kappa = kappa or rng.uniform(0.25, 0.45)
    turned = X @ R.T
    # so far that the points fill a share of the picture
    depth = 300.0
    while True:
        camera = Camera(SIZE, K, Rigid.from_rotation(R, (0, 0, depth)), "tsai", np.array([kappa]))
        uv = camera.project(X)
        inside = np.abs(uv - CENTRE) <= fill * (CENTRE + 0.5)
        if (turned[:, 2] + depth > 50).all() and np.isfinite(uv).all() and inside.all():
            break
        depth *= 1.02
    names = ("f", "k1", "cx", "cy")
    free = {"f": {"fx": 1.0, "fy": 1.0}} | {n: {n: 1.0} for n in names[1:]}
    bound = _inverse(_at_truth(camera, free, X, uv, sd_px).full_information)
    found = tsai(X, uv + rng.normal(0, sd_px, uv.shape), SIZE)
    truth = np.array([f, kappa, *centre])
    errors = truth - [found[n].value for n in names]
    pose = _state_error(camera.camera_from_world, found.camera.camera_from_world)
    return Trial(
        (*names, "rotation x", "rotation y", "rotation z", "tx", "ty", "tz"),
        np.concatenate([errors, pose]),
        bound,
        found.state_covariance,
        2 * int(found.is_used.sum()) - 10,
        np.array([f, abs(kappa), f, f, 1, 1, 1, depth, depth, depth]),
        np.concatenate([truth, np.zeros(3), camera.camera_from_world.translation]),
        _perspective,
    )


def _perspective(p: Floats) -> Floats:
    """1/f for f, κ1 in px⁻² for κ1, and tz/f for tz."""
    bent = p.copy()
    bent[0], bent[1], bent[-1] = 1 / p[0], p[1] / p[0] ** 2, p[-1] / p[0]
    return bent


def _head_points(rng: np.random.Generator) -> tuple[Floats, Floats, Camera]:
    """12 to 15 points over the front of a head, their exact pixels, and the camera."""
    side, up = rng.uniform(-1.4, 1.4, 200), rng.uniform(-1.1, 1.1, 200)
    head = np.column_stack(
        [75 * np.sin(side) * np.cos(up), 110 * np.sin(up), 90 * np.cos(side) * np.cos(up)]
    )
    X = _spread(head + rng.normal(0, 6, head.shape), int(rng.integers(12, 16)))
    f = rng.uniform(1200, 2200)
    K = np.array([[f, 0, CENTRE[0]], [0, f, CENTRE[1]], [0, 0, 1]])
    k = np.array([rng.uniform(-0.25, 0.05), rng.uniform(0, 0.1), 1e-3, -1e-3, 0.0])
    half_turn = Rotation.from_euler("x", np.pi)  # the face looks at the camera
    R = _turn(rng, 0, 40, 30) @ half_turn.as_matrix()
    shift = (*rng.uniform(-40, 40, 2), f * rng.uniform(0.35, 0.7))
    camera = Camera(SIZE, K, Rigid.from_rotation(R, shift), "opencv", k)
    return X, camera.project(X), camera


def _spread(points: Floats, n: int) -> Floats:
    """n of the points, each as far as can be from those before: as one marks a head."""
    picked = [0]
    near = np.linalg.norm(points - points[0], axis=1)
    while len(picked) < n:
        picked.append(int(np.argmax(near)))
        near = np.minimum(near, np.linalg.norm(points - points[picked[-1]], axis=1))
    return points[picked]


def pose_from_points(rng: np.random.Generator) -> Trial:
    """A camera's pose from 12 to 15 points of a head, known intrinsics."""
    X, uv, camera = _head_points(rng)
    bound = _inverse(_at_truth(camera, {}, X, uv, POSE_SD_PX).full_information)
    found = estimate_pose(X, uv + rng.normal(0, POSE_SD_PX, uv.shape), camera, rng=rng)
    depth = float(camera.camera_from_world.translation[2])
    return Trial(
        ("rotation x", "rotation y", "rotation z", "tx", "ty", "tz"),
        _state_error(camera.camera_from_world, found.camera_from_world),
        bound,
        found.covariance,
        2 * int(found.is_used.sum()) - 6,
        np.array([1, 1, 1, depth, depth, depth]),
    )


def _lens(rng: np.random.Generator) -> Camera:
    f = rng.uniform(1000, 1600)
    centre = CENTRE + rng.uniform(-15, 15, 2)
    K = np.array([[f, 0, centre[0]], [0, f * rng.uniform(0.998, 1.002), centre[1]], [0, 0, 1]])
    k = [rng.uniform(-0.3, -0.15), rng.uniform(0.05, 0.12), *rng.uniform(-1e-3, 1e-3, 2), 0.0]
    return Camera(SIZE, K, Rigid.identity(), "opencv", np.array(k))


def board_lens(rng: np.random.Generator) -> Trial:
    """A lens from 12 views of a 9 × 6 board, four distortion coefficients."""
    board, camera = parse_board("chessboard:9x6:25"), _lens(rng)
    X = board.object_points()
    poses = camera_poses(board, camera, 12, rng)
    exact = [camera.project(pose.apply(X)) for pose in poses]
    views = [
        BoardView(f"view {i}", X, uv + rng.normal(0, BOARD_SD_PX, uv.shape))
        for i, uv in enumerate(exact)
    ]
    names = ("fx", "fy", "cx", "cy", *LENS_MODELS["opencv4"])
    row, model = intrinsics_of(camera)
    free = selection({n: {n: 1.0} for n in names})[1]
    n = len(X)
    data = BundleData(
        np.zeros(n * len(poses), dtype=np.int64),
        np.repeat(np.arange(len(poses)), n),
        np.tile(X, (len(poses), 1)),
        np.concatenate(exact),
        np.full(n * len(poses), BOARD_SD_PX),
    )
    truth = solve_bundle(
        [BundleCamera(row, model, free, np.eye(3), np.zeros(3), False)],
        np.stack([p.rotation for p in poses]),
        np.stack([p.translation for p in poses]),
        data,
        max_steps=0,
    )
    found = calibrate_board(views, SIZE, model="opencv4")
    true_values = row[: len(names)]
    return Trial(
        names,
        true_values - [found[name].value for name in names],
        _inverse(truth.information),
        found.covariance,
        2 * sum(map(len, found.residuals)) - len(names) - 6 * len(found.views),
        _lens_scale(row),
    )


def _lens_scale(row: Floats) -> Floats:
    """For fx fy cx cy k1 k2 p1 p2: tangential terms, near zero, are measured against 1."""
    return np.concatenate([np.full(4, row[0]), np.abs(row[4:6]), [1.0, 1.0]])


def _rig(rng: np.random.Generator, n_cameras: int) -> Rig:
    """Cameras on an arc about a head 900 mm away."""
    cameras = {}
    for i, yaw in enumerate(np.linspace(-0.5, 0.5, n_cameras) * min(0.35 * n_cameras, 1.6)):
        lens = _lens(rng)
        yaw, pitch = yaw + rng.normal(0, 0.03), rng.normal(0, 0.1)
        R = Rotation.from_euler("yx", [-yaw, pitch]).as_matrix()
        shift = np.array([0, 0, 900.0]) + rng.normal(0, 15, 3)
        pose = Rigid.from_rotation(R, shift)
        cameras[f"cam{i}"] = Camera(SIZE, lens.matrix, pose, "opencv", lens.distortion)
    return Rig(cameras)


def _rig_views(
    rig: Rig, n_views: int, rng: np.random.Generator
) -> tuple[list[Rigid], dict[str, list[BoardView]], Floats]:
    board = parse_board("chessboard:9x6:20")
    X = board.object_points()
    poses = list(rig_poses(board, rig, n_views, rng))
    views: dict[str, list[BoardView]] = {name: [] for name in rig}
    for i, pose in enumerate(poses):
        for name, camera in rig.cameras.items():
            seen = sees(camera, pose, X)
            if seen.sum() >= 20:
                uv = camera.project(pose.apply(X[seen]))
                noisy = uv + rng.normal(0, BOARD_SD_PX, uv.shape)
                views[name].append(BoardView(f"view {i}", X[seen], noisy))
    return poses, views, X


def rig_of_cameras(rng: np.random.Generator) -> Trial:
    """Poses of 2 to 8 cameras of known lenses; parameters pooled over cameras."""
    return _rig_trial(rng, {})


def rig_with_lenses(rng: np.random.Generator) -> Trial:
    """The same with every lens estimated too (four distortion coefficients)."""
    return _rig_trial(rng, {f"cam{i}": "opencv4" for i in range(8)})


def _rig_trial(rng: np.random.Generator, refine: dict[str, str]) -> Trial:
    rig = _rig(rng, int(rng.integers(2, 9)))
    refine = {n: m for n, m in refine.items() if n in rig.cameras}
    poses, views, _ = _rig_views(rig, 12 * (len(rig) - 1), rng)
    truth = _rig_at_truth(rig, poses, views, refine)
    found = calibrate_rig(views, rig.cameras, refine=refine)
    return _rig_compared(rig, truth, found, refine)


def _rig_at_truth(
    rig: Rig, poses: list[Rigid], views: dict[str, list[BoardView]], refine: dict[str, str]
) -> Bundle:
    """The information at the truth, in the first camera's frame."""
    from_world = next(iter(rig.cameras.values())).camera_from_world
    cameras = []
    for i, (name, camera) in enumerate(rig.cameras.items()):
        row, model = intrinsics_of(camera)
        names = ["fx", "fy", "cx", "cy", *LENS_MODELS[refine[name]]] if name in refine else []
        free = selection({n: {n: 1.0} for n in names})[1]
        pose = camera.camera_from_world @ from_world.inverse()
        cameras.append(BundleCamera(row, model, free, pose.rotation, pose.translation, i > 0))
    seen = [(i, view) for i, name in enumerate(rig) for view in views[name]]
    sizes = [len(view.points) for _, view in seen]
    data = BundleData(
        np.repeat([i for i, _ in seen], sizes),
        np.repeat([int(view.name.split()[1]) for _, view in seen], sizes),
        np.concatenate([view.points for _, view in seen]),
        np.concatenate([view.pixels for _, view in seen]),
        np.full(sum(sizes), BOARD_SD_PX),
    )
    boards = [from_world @ pose for pose in poses]
    R, t = np.stack([b.rotation for b in boards]), np.stack([b.translation for b in boards])
    return solve_bundle(cameras, R, t, data, max_steps=0)


def _rig_compared(rig: Rig, truth: Bundle, found: RigCalibration, refine: dict[str, str]) -> Trial:
    """Errors of all cameras but the first's pose, with their joint covariances."""
    n_points = sum(len(r) for r in found.residuals.values())
    names: list[str] = []
    errors, scale, rows, to_state = [], [], [], []
    for i, name in enumerate(rig):
        true, camera = truth.cameras[i], found.rig.cameras[name]
        inner, outer = found.columns(name)
        if name in refine:
            row, _ = intrinsics_of(camera)
            names += found.parameters[name]
            errors.append(true.free.T @ (true.intrinsics - row))
            scale.append(_lens_scale(true.intrinsics))
            rows.append(np.arange(inner.start, inner.stop))
            to_state.append(np.eye(true.free.shape[1]))
        if i == 0:
            continue
        names += ["rotation"] * 3 + ["centre"] * 3
        centre = -true.rotation.T @ true.translation
        turn = Rotation.from_matrix(true.rotation @ camera.camera_from_world.rotation.T)
        errors.append(np.concatenate([turn.as_rotvec(), centre - camera.position]))
        scale.append(np.array([1.0, 1, 1, 900, 900, 900]))
        rows.append(np.arange(outer.start, outer.stop))
        t = true.translation
        cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        D = np.eye(6)
        D[3:, :3], D[3:, 3:] = -true.rotation.T @ cross, -true.rotation.T
        to_state.append(D)
    turned = block_diag(*to_state)
    at = np.concatenate(rows)
    bound: Floats = np.asarray(turned @ np.linalg.inv(truth.information) @ turned.T, np.float64)
    return Trial(
        tuple(names), np.concatenate(errors), bound, found.joint_covariance[np.ix_(at, at)],
        2 * n_points - truth.n_parameters, np.concatenate(scale),
    )  # fmt: skip


def peer_rows(n: int) -> list[str]:
    """Pose against solvePnP on the same points; and with 30 % of them wrong."""
    ours, peers, dirty, named, peers_dirty, oracle = [], [], [], [], [], []
    took = [0.0, 0.0]
    for seed in range(n):
        rng = np.random.default_rng([1, seed])
        X, exact, camera = _head_points(rng)
        uv = exact + rng.normal(0, POSE_SD_PX, exact.shape)
        start = time.perf_counter()
        mine = estimate_pose(X, uv, camera, rng=rng).camera_from_world
        middle = time.perf_counter()
        theirs = _solve_pnp(X, uv, camera)
        took[0] += middle - start
        took[1] += time.perf_counter() - middle
        ours.append(_pose_error(camera, mine))
        peers.append(_pose_error(camera, theirs))
        n_wrong = int(0.3 * len(X) + rng.random())  # 30 % on average
        wrong = rng.choice(len(X), n_wrong, replace=False)
        good = np.setdiff1d(np.arange(len(X)), wrong)
        oracle.append(_pose_error(camera, _solve_pnp(X[good], uv[good], camera)))
        uv[wrong] = _wrong_pixels(exact[wrong], rng)
        robust = estimate_pose(X, uv, camera, rng=rng)
        dirty.append(_pose_error(camera, robust.camera_from_world))
        peers_dirty.append(_pose_error(camera, _solve_pnp(X, uv, camera)))
        named.append(not robust.is_used[wrong].any())
    a, b, c, d, e = (np.array(x) for x in (ours, peers, dirty, peers_dirty, oracle))
    rows = [
        "",
        f"## Pose from 12 to 15 points against solvePnP (SQPNP, then LM): {n} draws",
        "",
        "| | rotation RMSE, ° | position RMSE, mm | ms |",
        "| --- | --- | --- | --- |",
    ]
    for name, x, seconds in (("facewright", a, took[0]), ("solvePnP", b, took[1])):
        turn, place = np.sqrt((x**2).mean(axis=0))
        rows.append(f"| {name} | {turn:.4f} | {place:.4f} | {1e3 * seconds / n:.1f} |")
    rng = np.random.default_rng(0)
    picks = rng.integers(0, n, (2000, n))
    for i, what in enumerate(("rotation", "position")):
        boot = np.sqrt((a[picks, i] ** 2).mean(axis=1) / (b[picks, i] ** 2).mean(axis=1))
        low, high = np.quantile(boot, [0.005, 0.995])
        rows.append(f"\n{what}: ratio of RMSE, 99 % interval {low:.4f} to {high:.4f}: "
                    f"{'reached' if low <= 1 else 'missed'}.")  # fmt: skip
    clean, medians = np.median(a, axis=0), np.median(c, axis=0)
    share, peer_medians = float(np.mean(named)), np.median(d, axis=0)
    best = np.median(e, axis=0) / clean
    is_reached = bool((medians <= 1.3 * clean).all() and share >= 0.95)
    rows.append(
        f"\nWith 30 % wrong points (at least {WRONG_PX:g} px off): median error "
        f"{medians[0]:.4f}° and {medians[1]:.3f} mm, {medians[0] / clean[0]:.2f} and "
        f"{medians[1] / clean[1]:.2f} × the clean case (solvePnP told which points are right: "
        f"{best[0]:.2f} and {best[1]:.2f} ×; not told: {peer_medians[0]:.2f}°, "
        f"{peer_medians[1]:.1f} mm); all wrong points named in {100 * share:.1f} % of draws: "
        f"{'reached' if is_reached else 'missed'}."
    )
    return rows


def _wrong_pixels(exact: Floats, rng: np.random.Generator) -> Floats:
    """Anywhere in the picture, but not near the right place."""
    found = rng.uniform(0, SIZE, exact.shape)
    while (near := np.linalg.norm(found - exact, axis=1) < WRONG_PX).any():
        found[near] = rng.uniform(0, SIZE, (int(near.sum()), 2))
    return found


def _solve_pnp(X: Floats, uv: Floats, camera: Camera) -> Rigid:
    K, k = camera.matrix, camera.distortion
    _, turn, shift = cv2.solvePnP(X, uv, K, k, flags=cv2.SOLVEPNP_SQPNP)
    turn, shift = cv2.solvePnPRefineLM(X, uv, K, k, turn, shift)
    return Rigid.from_rotation(cv2.Rodrigues(turn)[0], shift.ravel())


def _pose_error(camera: Camera, found: Rigid) -> tuple[float, float]:
    """Angle, °, and distance of the centre, mm."""
    error = camera.camera_from_world @ found.inverse()
    angle = Rotation.from_matrix(error.rotation).magnitude()
    return np.rad2deg(angle), float(np.linalg.norm(camera.position - found.inverse().translation))


def speed_rows(n_views: int) -> list[str]:
    """Four cameras, lenses and poses, from the same views; against calibrateMultiview."""
    rng = np.random.default_rng(5)
    rig = _rig(rng, 4)
    _, seen, X = _rig_views(rig, n_views, rng)
    # whole boards only: the peer gives up on parts of boards
    views = {n: [view for view in v if len(view.points) == len(X)] for n, v in seen.items()}
    _calibrate_all(rig, {n: v[:12] for n, v in views.items()})  # compiled before it is timed
    rows = [
        "",
        f"## Speed: 4 cameras, {n_views} moments, "
        f"{sum(len(v) for v in views.values())} views of {len(X)} corners; lenses and poses",
        "",
        "| | s | rms px | largest error of a centre, mm |",
        "| --- | --- | --- | --- |",
    ]
    times = []
    for _ in range(3):
        start = time.perf_counter()
        found = _calibrate_all(rig, views)
        times.append(time.perf_counter() - start)
    ours = float(np.median(times))
    rows.append(
        f"| facewright | {ours:.2f} | {found.rms_px:.4f} | {_worst_mm(rig, found.rig):.3f} |"
    )
    start = time.perf_counter()
    rms, peer = _multiview(rig, views, X, n_views)
    theirs = time.perf_counter() - start
    rows.append(f"| calibrateMultiview | {theirs:.2f} | {rms:.4f} | {_worst_mm(rig, peer):.3f} |")
    said = "reached" if ours <= 2 * theirs else "missed"
    rows.append(f"\nTime over the peer's: {ours / theirs:.2f} (at most 2): {said}.")
    return rows


def _calibrate_all(rig: Rig, views: dict[str, list[BoardView]]) -> RigCalibration:
    lenses = {n: calibrate_board(v, SIZE, model="opencv5").camera for n, v in views.items()}
    return calibrate_rig(views, lenses, refine=dict.fromkeys(rig.names, "opencv5"))


def _multiview(
    rig: Rig, views: dict[str, list[BoardView]], X: Floats, n_views: int
) -> tuple[float, Rig]:
    """OpenCV's calibration of the same views; corners not seen are (-1, -1)."""
    mask = np.zeros((len(rig), n_views), np.uint8)
    pixels = [[np.full((len(X), 2), -1.0, np.float32) for _ in range(n_views)] for _ in rig]
    for c, name in enumerate(rig):
        for view in views[name]:
            v = int(view.name.split()[1])
            mask[c, v] = 1
            pixels[c][v] = view.pixels.astype(np.float32)
    rms, Ks, ks, Rs, Ts = cv2.calibrateMultiview(  # type: ignore[call-overload]
        # in metres: with millimetres it takes any board's points for collinear
        [(X / 1e3).astype(np.float32)] * n_views, pixels, [SIZE] * len(rig), mask,
        np.full((len(rig), 1), cv2.CALIB_MODEL_PINHOLE, np.uint8), None, None, None, None,
    )  # fmt: skip
    cameras = {}
    for c, name in enumerate(rig):
        R = np.asarray(Rs[c], dtype=np.float64)
        R = R if R.shape == (3, 3) else cv2.Rodrigues(R)[0]
        pose = Rigid.from_rotation(R, 1e3 * np.ravel(Ts[c]))
        cameras[name] = Camera(SIZE, Ks[c], pose, "opencv", np.ravel(ks[c])[:5])
    return float(rms), Rig(cameras)


def _worst_mm(truth: Rig, found: Rig) -> float:
    """Largest distance of a centre from its true place, in the first camera's frame."""
    first = next(iter(truth.cameras.values())).camera_from_world
    start = next(iter(found.cameras.values())).camera_from_world
    off = [
        first.apply(camera.position) - start.apply(found.cameras[name].position)
        for name, camera in truth.cameras.items()
    ]
    return float(np.linalg.norm(off, axis=1).max())


if __name__ == "__main__":
    main()
