"""How near a head's own shapes come to a performance that only its FAPs tell of.

    python benchmarks/shape_solving.py [--heads 5] [--performances 4] [--first 100] [--seconds 4]
                                       [--foreign HEAD.glb] [--refine] [--out FILE.md]

Errors are root mean squares over all frames of all performances and over the skin that is seen at
rest from in front and from up to 60° aside. Three truths:

- *its own inverse*: vertices and FAPs from the sculpted shapes of the very head that is solved for;
- *faces that move otherwise*: vertices and FAPs from `datasets_synthetic.face_motion` (a jaw that
  turns, lids that slide, lips that touch), of which the shapes know nothing;
- *a head of another origin* (`--foreign`): its own morphs, under the same weights, with the feature
  points that we place.

Then weights → FAPs → weights, and the speed of the solver.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from facewright import __version__
from facewright.core.clip import Clip
from facewright.core.mesh import vertex_normals
from facewright.core.mpeg4 import ANGLE_UNIT_RAD, displacement_faps
from facewright.datasets_synthetic.face_motion import SIDES, FaceMotion
from facewright.datasets_synthetic.performances import STYLES, random_performance
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.own_head import read_own_head
from facewright.heads.raycast import RayScene
from facewright.retarget.drive import HeadDrive
from facewright.retarget.shape_solver import ShapeDrive, solve_weights, weights_to_faps

Floats = NDArray[np.float64]
Rows = dict[tuple[str, str, str], list[float]]
RATE_HZ = 60.0
JUDGED_EVERY = 6  # frames: vertices are compared ten times a second
EXACT_MM = 0.01  # noise of FAPs that come from our own floats, and rounding of integer ones


def seen_skin(head: Head) -> NDArray[np.bool_]:
    """Vertices of the skin that are seen at rest from in front or aside, (V,)."""
    v, skin = head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]]
    normals, used, scene = vertex_normals(v, skin), np.unique(skin), RayScene(v, skin)
    found = np.zeros(len(v), dtype=np.bool_)
    for yaw in np.deg2rad((-60, -30, 0, 30, 60)):
        for pitch in np.deg2rad((-20, 0, 20)):
            way = np.array(
                [np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)]
            )
            t, *_ = scene.cast(v[used] + 0.05 * normals[used], np.tile(way, (len(used), 1)))
            found[used[(normals[used] @ way > 0.1) & ~np.isfinite(t)]] = True
    return found


def acted_faps(head: Head, motion: FaceMotion, weights: Clip) -> tuple[Clip, Floats]:
    """FAPs and vertices, (T, V, 3), of a face that moves as `FaceMotion` does."""
    vertices = np.stack([motion.vertices(w) for w in weights.values])
    points = head.feature_points.at(vertices)
    names = head.feature_points.names
    moved = {n: points[:, i] - head.points[n] for i, n in enumerate(names)}
    faps = displacement_faps(moved, head.fapu)
    gaze = np.stack([motion.gaze(w) for w in weights.values]) / ANGLE_UNIT_RAD
    for row, side in enumerate(SIDES):
        faps[f"yaw_{side[0]}_eyeball"], faps[f"pitch_{side[0]}_eyeball"] = gaze[:, row].T
    return Clip(weights.time_s, tuple(faps), np.stack(list(faps.values()), axis=1)), vertices


def mean_square(found: Iterator[Floats], truth: Floats, seen: NDArray[np.bool_]) -> float:
    """Of vertices' errors, mm²."""
    errors = [((f - t)[seen] ** 2).sum(axis=1).mean() for f, t in zip(found, truth, strict=True)]
    return float(np.mean(errors))


def frames(drive: ShapeDrive | HeadDrive, clip: Clip) -> Iterator[Floats]:
    """Vertices of a driven head, frame by frame."""
    animation = drive.animate(clip)
    return (animation.vertices(frame) for frame in range(len(animation)))


def thinned(clip: Clip) -> Clip:
    """Every n-th frame."""
    return Clip(clip.time_s[::JUDGED_EVERY], clip.channels, clip.values[::JUDGED_EVERY])


def judge_head(seed: int, n_performances: int, seconds: float, refine: bool, rows: Rows) -> None:
    """One built-in head."""
    rng = np.random.default_rng(seed)
    head = make_head(random_identity(rng, f"person {seed}"), texture_px=256)
    seen, motion = seen_skin(head), FaceMotion(head)
    assert head.shapes is not None
    drives: dict[str, ShapeDrive | HeadDrive] = {
        "shapes": ShapeDrive(head),
        "direct table": ShapeDrive(head, method="direct"),
    }
    if refine:
        drives["shapes and points"] = ShapeDrive(head, refine=True)
        drives["points alone"] = HeadDrive(head)
    own = drives["shapes"]
    assert isinstance(own, ShapeDrive)
    for k in range(n_performances):
        style = STYLES[k % len(STYLES)]
        weights = random_performance(rng, head, seconds=seconds, rate_hz=RATE_HZ, style=style)
        judge_round_trip(own, weights.weights, rows)
        few = thinned(weights.weights)
        faps, truth = acted_faps(head, motion, few)
        rest = np.broadcast_to(head.mesh.vertices, truth.shape)
        place = "faces that move otherwise"
        rows[place, "motion", "mm"].append(mean_square(iter(rest), truth, seen))
        sculpted = (head.shaped(dict(zip(few.channels, w, strict=True))) for w in few.values)
        rows[place, "shapes, true weights", "mm"].append(mean_square(sculpted, truth, seen))
        for name, drive in drives.items():
            rows[place, name, "mm"].append(mean_square(frames(drive, faps), truth, seen))
        judge_own_inverse("its own inverse", own, few, seen, rows)


def judge_own_inverse(
    place: str, drive: ShapeDrive, weights: Clip, seen: NDArray[np.bool_], rows: Rows
) -> None:
    """Truth from the head's own morphs; FAPs as floats, and rounded."""
    truth = np.stack(list(frames(drive, weights)))
    faps = weights_to_faps(drive.jacobian, weights)
    rest = np.broadcast_to(drive.head.mesh.vertices, truth.shape)
    rows[place, "motion", "mm"].append(mean_square(iter(rest), truth, seen))
    rounded = replace(faps, values=np.rint(faps.values))
    for name, clip in (("shapes", faps), ("shapes, integer FAPs", rounded)):
        rows[place, name, "mm"].append(mean_square(frames(drive, clip), truth, seen))


def judge_round_trip(drive: ShapeDrive, weights: Clip, rows: Rows) -> None:
    """Weights of each channel there and back; frames a second."""
    jacobian = drive.jacobian
    truth = np.stack([weights[str(jacobian.arkit(s))] for s in jacobian.shapes], axis=1)
    faps = weights_to_faps(jacobian, weights)
    rounded = replace(faps, values=np.rint(faps.values))
    for name, clip in (("float FAPs", faps), ("integer FAPs", rounded)):
        found = solve_weights(jacobian, clip, noise_mm=EXACT_MM).clip.values
        error = ((found[:, : truth.shape[1]] - truth) ** 2).mean(axis=0)
        for shape, value in zip(jacobian.shapes, error, strict=True):
            rows[f"round trip, {name}", shape, ""].append(float(value))
    start = time.process_time()
    solved = solve_weights(jacobian, faps)
    rows["speed", "frames per second of one core", "1/s"].append(
        len(truth) / (time.process_time() - start)
    )
    rows["speed", "not converged", ""].append(float(not solved.converged))


def judge_foreign(path: Path, seed: int, n: int, seconds: float, rows: Rows) -> None:
    """A head from a file, under performances of a built-in one."""
    head = read_own_head(path).head
    drive, seen = ShapeDrive(head), seen_skin(head)
    rng = np.random.default_rng(seed)
    actor = make_head(random_identity(rng), texture_px=256)
    for k in range(n):
        style = STYLES[k % len(STYLES)]
        acted = random_performance(rng, actor, seconds=seconds, rate_hz=RATE_HZ, style=style)
        judge_own_inverse("a head of another origin", drive, thinned(acted.weights), seen, rows)


def table(rows: Rows) -> list[str]:
    """Rows for people: roots of means, medians of speeds, channels in one line."""
    lines = ["| truth | measured | unit | value |", "| --- | --- | --- | --- |"]
    for (place, name, unit), values in rows.items():
        if unit == "mm":
            lines.append(f"| {place} | {name} | mm | {np.sqrt(np.mean(values)):.3f} |")
        elif place == "speed":
            lines.append(f"| {place} | {name} | {unit} | {np.median(values):.0f} |")
    for kind in ("float FAPs", "integer FAPs"):
        place = f"round trip, {kind}"
        rms = {n: float(np.sqrt(np.mean(v))) for (p, n, _), v in rows.items() if p == place}
        lost = sorted((n for n in rms if rms[n] > 0.03), key=lambda n: -rms[n])
        shown = ", ".join(f"{n} {rms[n]:.3f}" for n in lost) or "none"
        lines += [
            f"| {place} | channels of {len(rms)} within 0.03 | | {len(rms) - len(lost)} |",
            f"| {place} | median of the channels | | {np.median(list(rms.values())):.4f} |",
            f"| {place} | the others | | {shown} |",
        ]
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--heads", type=int, default=5)
    parser.add_argument("--performances", type=int, default=4, help="of each head")
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--foreign", type=Path, help="a .glb with ARKit-like morphs")
    parser.add_argument("--refine", action="store_true", help="judge feature points as well")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: Rows = defaultdict(list)
    n, seconds = options.performances, options.seconds
    for seed in range(options.first, options.first + options.heads):
        judge_head(seed, n, seconds, options.refine, rows)
        print(f"head {seed}", flush=True)
    if options.foreign:
        judge_foreign(options.foreign, options.first, 2 * n, seconds, rows)
    lines = [
        f"facewright {__version__}, heads {options.first} to "
        f"{options.first + options.heads - 1}, {n} performances each, {seconds:g} s; "
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, "
        f"SciPy {scipy.__version__}",
        "",
        *table(rows),
    ]
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
