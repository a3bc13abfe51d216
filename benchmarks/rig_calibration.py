"""A rig of four from videos of a board: how near to the truth, and does it know how near.

    python benchmarks/rig_calibration.py [--seeds 20] [--frames 60] [--keep DIR] [--out FILE]

Each seed draws a rig around a face, a board waved before it, and films it as `facewright synth
board --video` does; of the smooth motion at 30 frames a second each fourth frame is drawn, as the
command looks at no more. Lenses and poses are then found from the videos alone, as `facewright
calibrate rig` does it. Compared with the truth:

- *cameras*: centres and rotations, after the rig as a whole is laid over the true one where the
  face is (whoever tracks a face does not care where the world's origin is), and with the first
  camera held;
- *millimetres at the face*: points of a face, exactly projected by the true cameras and
  triangulated by the found ones, relative to the best rigid fit of that face; over what the
  calibration states of them. Both are root mean squares over points and seeds. The 95 % interval
  of the ratio is by bootstrap over seeds.
- *z*: errors of all parameters over their stated deviations, root mean square.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.capture.board_turns import agree_on_turns
from facewright.capture.board_video import detect_in_video, views_of_frames
from facewright.capture.board_views import without_repeats
from facewright.capture.calibration_take import find_take
from facewright.capture.lens import BoardView, calibrate_board
from facewright.capture.projection import INTRINSIC_NAMES, intrinsics_of
from facewright.capture.rig_face import face_points
from facewright.capture.rig_uncertainty import triangulation_sd_mm
from facewright.capture.rigs import RigCalibration, calibrate_rig
from facewright.core.boards import parse_board
from facewright.core.files import atomic_write
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.boards import make_board_shots, shoot_board
from facewright.tracking.rigid_fit import fit_rigid
from facewright.tracking.triangulation import Views, triangulate

Floats = NDArray[np.float64]
BOARD = "chessboard:9x6:20"
DRAWN_EVERY = 4
CENTRE_MM, ROTATION_DEG, TRUE_WITHIN = 0.3, 0.01, 0.10


@dataclass(frozen=True, eq=False)
class Outcome:
    """One rig against its truth.

    Attributes
    ----------
    centres_mm, rotations_deg : (C,) float64
        Errors with the rig laid over the true one at the face.
    held_centres_mm, held_rotations_deg : (C - 1,) float64
        Errors with the first camera held.
    face_mm, stated_mm : (N,) float64
        Errors of a face's points, and what is stated of them.
    z : (S,) float64
        Errors of parameters over stated deviations.
    rms_px, corner_px : float
        RMS residual; and standard deviation of a corner's coordinate against the truth.
    n_views : int
    models : tuple of str
    """

    centres_mm: Floats
    rotations_deg: Floats
    held_centres_mm: Floats
    held_rotations_deg: Floats
    face_mm: Floats
    stated_mm: Floats
    z: Floats
    rms_px: float
    corner_px: float
    n_views: int
    models: tuple[str, ...]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60, help="drawn of each camera")
    parser.add_argument("--keep", type=Path, help="keep the videos in this folder, or take them")
    parser.add_argument("--out", type=Path, help="also write the tables to this file")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    head = (
        f"facewright {__version__}, seeds {seeds[0]} to {seeds[-1]}, {options.frames} frames of "
        f"4 cameras, {BOARD}; {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}"
    )
    print(head, flush=True)
    found = []
    for seed in seeds:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) if options.keep is None else options.keep / f"seed{seed}"
            film(seed, options.frames, folder)
            filmed = time.perf_counter()
            outcome = judge(folder)
        found.append(outcome)
        print(f"seed {seed}: {_line(outcome)}; filmed in {filmed - start:.0f} s, "
              f"solved in {time.perf_counter() - filmed:.0f} s", flush=True)  # fmt: skip
    lines = table(found)
    print("\n".join(["", *lines]))
    if options.out:
        with atomic_write(options.out) as stream:
            stream.write("\n".join([head, "", *lines]) + "\n")


def film(seed: int, n_frames: int, folder: Path) -> None:
    """Videos of a board before four cameras, unless they are there."""
    if (folder / "truth.npz").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    shots = make_board_shots(
        parse_board(BOARD), seed, n_cameras=4, n_views=n_frames * DRAWN_EVERY, moving=True
    )
    shots = replace(shots, world_from_board=shots.world_from_board[::DRAWN_EVERY])
    shoot_board(shots, folder, video=True)


def judge(folder: Path) -> Outcome:
    """Calibrate from the videos, compare with the truth."""
    from facewright.core.formats.rig_json import read_rig

    truth = read_rig(folder / "rig.json")
    views, found, models = calibrated(folder)
    return compared(truth, found, models, corner_sd_px(folder, views))


def calibrated(
    folder: Path,
) -> tuple[dict[str, list[BoardView]], RigCalibration, tuple[str, ...]]:
    """What `facewright calibrate rig` does with a folder of videos in step."""
    board = parse_board(BOARD)
    seen = {c.name: detect_in_video(c.video, board) for c in find_take(folder) if c.video}
    views = views_of_frames(seen, max_views=100)
    lenses = {}
    for name, mine in views.items():
        different, _ = without_repeats(mine)
        lenses[name] = calibrate_board(different, seen[name].image_size)
    cameras = {name: lens.camera for name, lens in lenses.items()}
    views, _ = agree_on_turns(views, cameras, board)
    models = {name: lens.model for name, lens in lenses.items()}
    return views, calibrate_rig(views, cameras, refine=models), tuple(models.values())


def corner_sd_px(folder: Path, views: dict[str, list[BoardView]]) -> float:
    """Of a corner's coordinate, against exact projections."""
    errors = [corner_errors(folder, n, v) for n, mine in views.items() for v in mine]
    return float(np.sqrt((np.concatenate(errors) ** 2).mean()))


def corner_errors(folder: Path, camera: str, view: BoardView) -> Floats:
    """Seen minus true, (N, 2) px."""
    truth = np.load(folder / "truth.npz")
    c, frame = list(truth["camera_names"]).index(camera), int(view.name.split()[1])
    points, exact = truth["object_points"], truth["pixels"][c, frame]
    rows = np.abs(points[None] - view.points[:, None]).max(axis=2).argmin(axis=1)
    ways = [rows, len(points) - 1 - rows]  # the board looks alike after half a turn
    offs = [view.pixels - exact[way] for way in ways]
    return np.asarray(min(offs, key=lambda off: float(np.abs(off).sum())))


def compared(
    truth: Rig, found: RigCalibration, models: tuple[str, ...], corner_px: float
) -> Outcome:
    """Errors of cameras and of the points of a face, in the first camera's frame."""
    first = next(iter(truth.cameras.values())).camera_from_world
    face = first.apply(face_points())  # the synthetic world is the head's
    cameras = [found.rig[n] for n in truth]
    xy = [c.undistort(truth[n].project(face_points())) for n, c in zip(truth, cameras, strict=True)]
    points = triangulate(Views.of(cameras), np.stack(xy, axis=1), tolerance_px=np.inf).positions
    R, t = fit_rigid(points, face)
    true_from_found = Rigid.from_rotation(R, t)
    stated = triangulation_sd_mm(found, face)
    centres, turns = _camera_errors(truth, found, true_from_found)
    held_centres, held_turns = _camera_errors(truth, found, Rigid.identity())
    return Outcome(
        np.linalg.norm(centres, axis=1),
        np.rad2deg(np.linalg.norm(turns, axis=1)),
        np.linalg.norm(held_centres, axis=1)[1:],
        np.rad2deg(np.linalg.norm(held_turns, axis=1))[1:],
        np.linalg.norm(points @ R.T + t - face, axis=1),
        stated.calibration_mm,
        _z(truth, found, held_turns, held_centres),
        found.rms_used_px,
        corner_px,
        len(found.view_poses),
        models,
    )


def _camera_errors(truth: Rig, found: RigCalibration, move: Rigid) -> tuple[Floats, Floats]:
    """Centres, mm, and rotation vectors, rad, true less found, in the true first camera's frame."""
    first = next(iter(truth.cameras.values())).camera_from_world
    centres, turns = [], []
    for name, camera in truth.cameras.items():
        true = camera.camera_from_world @ first.inverse()
        got = found.rig[name].camera_from_world @ move.inverse()
        centres.append(true.inverse().translation - got.inverse().translation)
        turns.append(Rotation.from_matrix(true.rotation @ got.rotation.T).as_rotvec())
    return np.array(centres), np.array(turns)


def _z(truth: Rig, found: RigCalibration, turns: Floats, centres: Floats) -> Floats:
    """Of each camera's estimated intrinsics, and of all poses but the first's."""
    z = []
    for i, (name, camera) in enumerate(truth.cameras.items()):
        true, _ = intrinsics_of(camera)
        got, _ = intrinsics_of(found.rig[name])
        rows = [INTRINSIC_NAMES.index(p) for p in found.parameters[name]]
        errors = (true - got)[rows]
        z.append(errors / found.intrinsics_sd[name])
        if i:
            sd = np.sqrt(np.diag(found.covariance[name]))
            z.append(np.concatenate([turns[i], centres[i]]) / sd)
    return np.concatenate(z)


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def _line(o: Outcome) -> str:
    return (
        f"{o.n_views} views, RMS {o.rms_px:.3f} px, corners {o.corner_px:.3f} px, centres "
        f"{_rms(o.centres_mm):.3f} mm, rotations {_rms(o.rotations_deg):.4f}°, face "
        f"{_rms(o.face_mm):.5f} mm, stated {_rms(o.stated_mm):.5f}, z {_rms(o.z):.2f}, "
        f"{' '.join(o.models)}"
    )


def table(found: list[Outcome]) -> list[str]:
    """What was reached, as markdown."""

    def pooled(name: str) -> Floats:
        return np.concatenate([getattr(o, name) for o in found])

    rows = ["| quantity | RMS | 95 % below | largest | reach |", "| --- | --- | --- | --- | --- |"]
    for name, said, limit in (
        ("centres_mm", "camera centres, mm", CENTRE_MM),
        ("rotations_deg", "camera rotations, °", ROTATION_DEG),
        ("held_centres_mm", "centres, first camera held, mm", None),
        ("held_rotations_deg", "rotations, first camera held, °", None),
        ("face_mm", "points of a face, mm", None),
        ("stated_mm", "stated of them, mm", None),
    ):
        v = pooled(name)
        verdict = "" if limit is None else f"{limit:g}: {'yes' if _rms(v) <= limit else 'no'}"
        rows.append(
            f"| {said} | {_rms(v):.3g} | {np.quantile(v, 0.95):.3g} | {v.max():.3g} | {verdict} |"
        )
    actual = np.array([(o.face_mm**2).mean() for o in found])
    stated = np.array([(o.stated_mm**2).mean() for o in found])
    ratio = float(np.sqrt(actual.sum() / stated.sum()))
    picks = np.random.default_rng(0).integers(0, len(found), (4000, len(found)))
    boot = np.sqrt(actual[picks].sum(axis=1) / stated[picks].sum(axis=1))
    low, high = np.quantile(boot, [0.025, 0.975])
    reached = "yes" if abs(ratio - 1) <= TRUE_WITHIN else "no"
    z = pooled("z")
    return [
        *rows,
        "",
        f"Millimetres at the face, actual over stated: {ratio:.3f} (95 % interval {low:.2f} to "
        f"{high:.2f}); within {100 * TRUE_WITHIN:.0f} %: {reached}. "
        f"z of {len(z)} parameters: {_rms(z):.3f}; {100 * np.mean(np.abs(z) < 1.96):.1f} % "
        f"within 1.96. Corners: {_rms(np.array([o.corner_px for o in found])):.3f} px a "
        f"coordinate; views {np.mean([o.n_views for o in found]):.0f} each.",
    ]


if __name__ == "__main__":
    main()
