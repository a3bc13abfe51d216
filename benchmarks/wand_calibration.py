"""How well a waved wand places cameras, against the Cramér-Rao bound.

    python benchmarks/wand_calibration.py [--seeds 20] [--moments 400] [--filmed 0]

Four cameras around a head, lenses known, a wand of three balls (0, 45, 120 mm) or of its two ends
alone (then in any order), pictures of the balls by exact projection with a noise of 0.1 px. Errors
are those of the other cameras in the first one's frame. Error / bound pools all parameters of all
seeds: the root of the mean of squared errors over their bound's variances. Inside 95 %: how many
single parameters lie within 1.96 stated standard deviations. `--filmed N` films N takes of 6 s and
goes the whole way from their videos (half a minute each and more).
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.capture.calibration_take import find_take
from facewright.capture.rigs import RigCalibration
from facewright.capture.wand_rig import calibrate_wand
from facewright.cli.rig_from_markers import rig_by_wand
from facewright.core.rig import Rig
from facewright.datasets_synthetic.film import film_take
from facewright.datasets_synthetic.rigs import face_rig
from facewright.datasets_synthetic.take_settings import settings_for, settings_with
from facewright.datasets_synthetic.takes import make_take
from facewright.datasets_synthetic.wand import BALLS_MM, Wand

Floats = NDArray[np.float64]
SD_PX, RATE_HZ = 0.1, 30.0
LIMIT_MM, LIMIT_DEG = 0.3, 0.01


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--moments", type=int, default=400)
    parser.add_argument("--filmed", type=int, default=0)
    args = parser.parse_args()
    print(
        f"facewright {__version__}, seeds 0 to {args.seeds - 1}, {args.moments} moments; "
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"NumPy {np.__version__}; limits {LIMIT_MM} mm, {LIMIT_DEG}°\n"
    )
    print(
        "| wand | error / bound | inside 95 % | centre RMS mm | largest | rotation RMS ° | largest "
        "| s each |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for label, picked in (("three balls", (0, 1, 2)), ("two balls, any order", (0, 2))):
        _print(label, [_exact(seed, args.moments, picked) for seed in range(args.seeds)])
    if args.filmed:
        _print(f"three balls, {args.filmed} filmed", [_filmed(seed) for seed in range(args.filmed)])


#: Errors (C - 1, 6) as rotation vector and centre, their stated covariances, and the time taken.
Outcome = tuple[Floats, Floats, float]


def _exact(seed: int, n: int, picked: tuple[int, ...]) -> Outcome:
    rng = np.random.default_rng(seed)
    rig, wand = face_rig(rng), Wand.random(rng)
    balls = np.stack([wand.balls(t) for t in np.arange(n) / RATE_HZ])[:, list(picked)]
    seen = {}
    for name, camera in rig.cameras.items():
        uv = camera.project(balls) + rng.normal(0, SD_PX, (*balls.shape[:2], 2))
        size = np.array(camera.image_size)
        uv[~((uv > 5) & (uv < size - 6)).all(axis=-1)] = np.nan
        if len(picked) == 2:
            turned = rng.random(n) < 0.5
            uv[turned] = uv[turned][:, ::-1]
        seen[name] = uv
    start = time.perf_counter()
    # with the true noise, the stated covariance is the bound, at the solution
    found = calibrate_wand(seen, rig.cameras, [BALLS_MM[i] for i in picked], sd_px=SD_PX)
    return (*_against(found, rig), time.perf_counter() - start)


def _filmed(seed: int) -> Outcome:
    settings = settings_with(settings_for("wand"), {"seconds": 6.0})
    with tempfile.TemporaryDirectory() as folder:
        take = make_take(seed, settings)
        film_take(take, Path(folder))
        start = time.perf_counter()
        result = rig_by_wand(find_take(Path(folder)), BALLS_MM, take.rig.cameras)
        return (*_against(result.found, take.rig), time.perf_counter() - start)


def _against(found: RigCalibration, truth: Rig) -> tuple[Floats, Floats]:
    first = truth[found.rig.names[0]].camera_from_world
    errors, stated = [], []
    for name in found.rig.names[1:]:
        true = truth[name].camera_from_world @ first.inverse()
        got = found.rig[name].camera_from_world
        turn = Rotation.from_matrix(true.rotation @ got.rotation.T).as_rotvec()
        centre = true.inverse().translation - got.inverse().translation
        errors.append(np.concatenate([turn, centre]))
        stated.append(found.covariance[name])
    return np.array(errors), np.array(stated)


def _print(label: str, outcomes: list[Outcome]) -> None:
    errors = np.concatenate([o[0] for o in outcomes])
    variance = np.concatenate([np.diagonal(o[1], axis1=1, axis2=2) for o in outcomes])
    z = errors / np.sqrt(variance)
    mm = np.linalg.norm(errors[:, 3:], axis=1)
    degrees = np.rad2deg(np.linalg.norm(errors[:, :3], axis=1))
    print(
        f"| {label} | {np.sqrt((z**2).mean()):.3f} | {100 * (np.abs(z) < 1.96).mean():.1f} % | "
        f"{np.sqrt((mm**2).mean()):.4f} | {mm.max():.4f} | {np.sqrt((degrees**2).mean()):.5f} | "
        f"{degrees.max():.5f} | {np.median([o[2] for o in outcomes]):.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
