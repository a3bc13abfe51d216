"""How far head motion, units and FAPs are off, from markers whose places are known exactly.

    python benchmarks/head_and_faps.py [--seeds 10] [--first 300] [--seconds 4] [--noise 0.03]
                                       [--out FILE.md]

Each seed is another actor and performance; the ready set's markers take the places that the actor
gives them, plus white noise, so that no camera, label or gap is judged here: flat dots, spheres of
3 mm radius, and dots with a skull that is not quite rigid (each head marker strays by 0.5 mm, one
by 2 mm). Rows of filmed takes come from `demo_accuracy.py`.
"""

from __future__ import annotations

import argparse
import platform
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.cli.evaluation import fap_errors_percent
from facewright.core.head_motion import HeadMotion
from facewright.core.markers import MarkerSet
from facewright.core.mesh import vertex_normals
from facewright.core.rigid import rotation_from_quaternion
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.take_settings import TakeSettings
from facewright.datasets_synthetic.takes import Take, make_take, take_truth
from facewright.heads.marker_sets import ready_marker_set
from facewright.tracking.face_units import estimate_units
from facewright.tracking.performance import TrackedPerformance, analyse

Floats = NDArray[np.float64]
SPHERE_MM = 3.0
STRAY_MM = (0.5, 0.5, 2.0)
Rows = dict[tuple[str, str, str], list[float]]


def sphere_centres(take: Take, skin: Floats) -> Floats:
    """Centres of spheres that sit on the skin at markers' places, (T, M, 3) mm, world frame."""
    assert take.markers is not None
    normals = []
    for t in take.time_s:
        v = take.pose(float(t)).world_vertices
        n = take.markers.glue.at(vertex_normals(v, take.head.mesh.triangles))
        normals.append(n / np.linalg.norm(n, axis=1, keepdims=True))
    return skin + SPHERE_MM * np.stack(normals)


def judge_head(found: TrackedPerformance, truth: HeadMotion, place: str, rows: Rows) -> None:
    """Errors of the head's turn and of the place amid its markers, and what was stated."""
    assert found.skull is not None
    pivot = np.mean([*found.neutral.positions[found.skull.used]], axis=0)
    true_pivot = truth.rotation[0].T @ (
        found.neutral.rotation @ pivot + found.neutral.translation - truth.translation[0]
    )
    true_place = truth.world_from_head(true_pivot[None])[:, 0]

    def off(motion: HeadMotion) -> tuple[float, float]:
        # neutral to now, as the neutral frame has it
        turn = motion.rotation @ motion.rotation[0].T
        true = truth.rotation @ truth.rotation[0].T
        angle = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ turn).magnitude()
        shift = motion.world_from_head(pivot[None])[:, 0] - true_place
        return (
            float(np.rad2deg(np.sqrt((angle**2).mean()))),
            float(np.sqrt((shift**2).sum(axis=1).mean())),
        )

    for name, motion in (("head", found.head_motion), ("linear method", found.head_motion_linear)):
        if motion is not None:
            angle, shift = off(motion)
            rows[place, f"{name}: rotation", "°"].append(angle)
            rows[place, f"{name}: translation", "mm"].append(shift)
    C = found.head_motion.covariance
    assert C is not None
    stated = np.trace(C[:, :3, :3], axis1=1, axis2=2).mean()
    rows[place, "head: rotation as stated", "°"].append(float(np.rad2deg(np.sqrt(stated))))


def judge_faps(
    found: TrackedPerformance, truth: dict[str, NDArray[np.float64]], place: str, rows: Rows
) -> None:
    """FAP errors of observed points and of those that stand in."""
    percent = fap_errors_percent(found.faps, truth)
    observed = [v for n, v in percent.items() if n not in found.approximated]
    stood_in = [v for n, v in percent.items() if n in found.approximated]
    rows[place, "FAPs of observed points: median", "%"].append(float(np.median(observed)))
    rows[place, "FAPs of observed points: worst", "%"].append(float(np.max(observed)))
    if stood_in:
        rows[place, "inner lips: median", "%"].append(float(np.median(stood_in)))
        rows[place, "inner lips: worst", "%"].append(float(np.max(stood_in)))


def stray(rng: np.random.Generator, R: Floats, p: Floats, marker_set: MarkerSet) -> Floats:
    """The same markers, those of the head straying slowly."""
    found = np.array(p)
    rigid = [m for m, marker in enumerate(marker_set.markers) if marker.is_rigid]
    for m, sd in zip(rigid, STRAY_MM, strict=True):
        d = gaussian_filter1d(rng.normal(size=(len(p), 3)), 10, axis=0)
        d *= sd / d.std()
        found[:, m] += np.einsum("tij,tj->ti", R, d - d[0])
    return found


def judge_seed(seed: int, seconds: float, noise_mm: float, rows: Rows) -> None:
    """One actor."""
    take = make_take(seed, TakeSettings(seconds=seconds))
    truth = take_truth(take)
    marker_set = replace(ready_marker_set(), fapu=take.head.fapu)
    judged = {"fapu": np.array(list(take.head.fapu.as_dict().values())), "faps": truth.faps}
    motion = HeadMotion(truth.time_s, truth.head_quaternion, truth.head_translation)
    rng = np.random.default_rng(seed)

    def seen(p: Floats) -> Trajectories:
        C = np.broadcast_to(max(noise_mm, 1e-6) ** 2 * np.eye(3), (*p.shape, 3))
        noisy = p + rng.normal(0, noise_mm, size=p.shape)
        return Trajectories(truth.time_s, marker_set.labels, noisy, C)

    dots = seen(truth.marker_skin)
    found = analyse(dots, marker_set)
    judge_head(found, motion, "dots", rows)
    judge_faps(found, judged, "dots", rows)
    judge_faps(analyse(dots, marker_set, point_offsets=False), judged, "dots, as the paper", rows)
    centres = seen(sphere_centres(take, truth.marker_skin))
    for name, standoff in (("spheres", SPHERE_MM), ("spheres, uncorrected", 0.0)):
        spheres = replace(marker_set, standoff_mm=standoff)
        judge_faps(analyse(centres, spheres), judged, name, rows)
    R = rotation_from_quaternion(truth.head_quaternion)
    restless = seen(stray(rng, R, truth.marker_skin, marker_set))
    found = analyse(restless, marker_set)
    judge_head(found, motion, "restless skull", rows)
    units = estimate_units(found.neutral.positions, marker_set)
    for unit, true in take.head.fapu.as_dict().items():
        off = abs(units.fapu.as_dict()[unit] / true - 1)
        rows["units estimated", unit, "%"].append(100 * off)
        rows["units estimated", f"{unit} as stated", "%"].append(100 * units.sd_mm[unit] / true)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--noise", type=float, default=0.03, help="mm a coordinate")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: Rows = defaultdict(list)
    for seed in range(options.first, options.first + options.seeds):
        judge_seed(seed, options.seconds, options.noise, rows)
        print(f"seed {seed}", flush=True)
    lines = [
        f"facewright {__version__}, seeds {options.first} to {options.first + options.seeds - 1}, "
        f"{options.seconds:g} s each, noise {options.noise:g} mm; {platform.machine()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}",
        "",
        "| markers | measured | unit | median | worst |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {place} | {quantity} | {unit} | {np.median(v):.3g} | {np.max(v):.3g} |"
        for (place, quantity, unit), v in rows.items()
    ]
    text = "\n".join(lines)
    print(text)
    if options.out:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
