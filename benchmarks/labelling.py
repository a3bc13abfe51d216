"""How many markers get the right name, and how many a wrong one.

    python benchmarks/labelling.py [--people 120] [--frames 200] [--takes 30] [--real DIR]
        [--keep DIR] [--first 1000] [--out FILE.md]

Three questions:

- *A stranger's neutral face*: the ready set on people drawn from anthropometry, turned anyhow,
  0.9 to 1.1 times as large; with markers missing, ghosts within the face's box, glue aside.
- *Real markers, single frames* (AnimFace, in ``DIR/facial_markers``; left out if it is not there):
  the template is the other take; any rotation, scale 0.9 to 1.1, three ghosts within the face's
  box. The peer is what one would write first: iterated closest points with assignment, given the
  true rotation and scale, and no ghosts.
- *Takes*: another actor, rig and performance each (fast speech, expressions, a hurried medley in
  turn), seen as points: 10 % of dots dropped, besides 10 % of markers in all cameras at once,
  hands across the face, stray dots and lights; followed by the tracker, then labelled. A label is
  wrong if what is delivered lies more than 2.5 mm from its marker. Visible: seen by two cameras.
  *Spoilt*: the same tracks, of which 15 times two neighbours change places for good.

Motion takes some seconds a take; --keep DIR keeps it for another run.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.core.errors import InputError
from facewright.core.person import Person
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.sightings import (
    MarkerMotion,
    Sightings,
    Trouble,
    marker_motion,
    sight_markers,
)
from facewright.datasets_synthetic.take_settings import TakeSettings, settings_with
from facewright.datasets_synthetic.takes import Take, make_take
from facewright.heads.identity import make_head, random_identity
from facewright.heads.marker_sets import glue_markers, ready_marker_set
from facewright.tracking.constellation import find_constellation
from facewright.tracking.face_variation import anyone, person_of_take
from facewright.tracking.labelling import label_tracks
from facewright.tracking.rigid_fit import fit_rigid
from facewright.tracking.tracker import FrameDots, follow_markers
from facewright.tracking.videos import warm_up

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME_MM = 2.5
STYLES = ("speech", "expressions", "mixed")
TROUBLE = Trouble(noise_px=0.1, dropped=0.1, lost=0.1, n_passes=3)
N_SWAPS = 15


def disturbed(
    rng: np.random.Generator, face: Floats, n_missing: int, n_ghosts: int
) -> tuple[Floats, Ints]:
    """A face anywhere; whose each point is, −1 for a ghost."""
    keep = rng.permutation(len(face))[n_missing:]
    ghosts = rng.uniform(face.min(axis=0), face.max(axis=0), size=(n_ghosts, 3))
    points = np.concatenate([face[keep], ghosts])
    owners = np.concatenate([keep, np.full(n_ghosts, -1)])
    order = rng.permutation(len(points))
    R, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 200, 3)
    return rng.uniform(0.9, 1.1) * points[order] @ R.T + shift, owners[order]


def name_all(
    faces: list[Floats], person: Person, rng: np.random.Generator, n_missing: int, n_ghosts: int
) -> list[int | float]:
    """Markers seen, named right, named wrong; seconds a face."""
    seen = right = wrong = 0
    start = time.perf_counter()
    for face in faces:
        points, owners = disturbed(rng, face, n_missing, n_ghosts)
        seen += len(face) - n_missing
        try:
            found = find_constellation(points, person).point_of_label
        except InputError:
            continue
        named = np.flatnonzero(found >= 0)
        is_right = owners[found[named]] == named
        right, wrong = right + int(is_right.sum()), wrong + int((~is_right).sum())
    return [seen, right, wrong, (time.perf_counter() - start) / len(faces)]


def closest_points(face: Floats, mean: Floats, rng: np.random.Generator, n_missing: int) -> int:
    """How many of a face's markers plain ICP with assignment names right."""
    keep = rng.permutation(len(face))[n_missing:]
    points = face[keep]
    placed = mean + points.mean(axis=0) - mean.mean(axis=0)
    for _ in range(50):
        d = np.linalg.norm(placed[:, None] - points[None], axis=2)
        rows, columns = linear_sum_assignment(d)
        R, t = fit_rigid(mean[rows], points[columns])
        placed = mean @ R.T + t
    return int((keep[columns] == rows).sum())


def row(what: str, values: list[int | float]) -> str:
    seen, right, wrong, seconds = values
    correct = 100 * right / max(right + wrong, 1)
    return (
        f"| {what} | {seen} | {100 * (right + wrong) / seen:.2f} % | {wrong} | {correct:.2f} % "
        f"| {1e3 * seconds:.0f} |"
    )


HEADER = [
    "| what | markers seen | named | wrong | of the named, right | ms a face |",
    "| --- | ---: | ---: | ---: | ---: | ---: |",
]


def strangers(n: int, first: int) -> list[str]:
    """The ready set on people it has not seen."""
    marker_set = ready_marker_set()
    faces = []
    for seed in range(first, first + n):
        person = random_identity(np.random.default_rng(seed), "someone")
        head = make_head(person, texture_px=256)
        faces.append(glue_markers(head, marker_set).at(head.mesh.vertices))
    someone = anyone(marker_set, at_rest=True)
    lines = [f"A stranger's neutral face, {n} people, set {marker_set.name}", "", *HEADER]
    for missing, ghosts, glue_mm in (
        (0, 0, 0),
        (2, 0, 0),
        (0, 3, 0),
        (3, 3, 0),
        (0, 0, 2),
        (0, 0, 3),
    ):
        rng = np.random.default_rng([first, missing, ghosts, glue_mm])
        glued = [face + rng.normal(0, glue_mm, face.shape) for face in faces]
        what = f"{missing} missing, {ghosts} ghosts, glued ± {glue_mm} mm"
        lines.append(row(what, name_all(glued, someone, rng, missing, ghosts)))
    return lines


def read_real(path: Path) -> Trajectories:
    header = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    names = tuple(n.removesuffix("_x") for n in header[1::3])
    positions = table[:, 1:].reshape(len(table), -1, 3) * 10.0
    return Trajectories(np.arange(len(table)) / 60.0, names, positions)


def real_markers(folder: Path, n: int, first: int) -> list[str]:
    """Single frames of one take named from the other."""
    takes = {name: read_real(folder / f"{name}.csv") for name in ("Jaw", "Cheeks")}
    lines = [f"Real markers, single frames, {n} each, 3 ghosts", "", *HEADER]
    for template, other in (("Jaw", "Cheeks"), ("Cheeks", "Jaw")):
        person = person_of_take(takes[template])
        for percent in (0, 5, 10):
            rng = np.random.default_rng([first, percent])
            frames = rng.integers(len(takes[other].time_s), size=n)
            faces = [np.asarray(takes[other].positions[f]) for f in frames]
            missing = round(percent / 100 * len(person.labels))
            what = f"{other} from {template}, {percent} % missing"
            lines.append(row(what, name_all(faces, person, rng, missing, 3)))
            start = time.perf_counter()
            right = sum(closest_points(face, person.neutral, rng, missing) for face in faces)
            seen = n * (len(person.labels) - missing)
            seconds = (time.perf_counter() - start) / n
            lines.append(row("peer, upright, no ghosts", [seen, right, seen - right, seconds]))
    return lines


def motion_of(take: Take, keep: Path | None) -> MarkerMotion:
    names = ("time_s", "markers", "normals", "head_quaternion", "head_translation")
    path = None if keep is None else keep / f"motion-{take.seed}-{take.settings.seconds:g}s.npz"
    if path is not None and path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return MarkerMotion(*(stored[name] for name in names))
    motion = marker_motion(take)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **{name: getattr(motion, name) for name in names})
    return motion


def spoilt(tracks: Trajectories, rng: np.random.Generator) -> Trajectories:
    """Tracks of which neighbours change places for good."""
    p = np.array(tracks.positions)
    n = 0
    while n < N_SWAPS:
        f = int(rng.integers(30, len(p) - 10))
        here = np.flatnonzero(~np.isnan(p[f - 1 : f + 1, :, 0]).any(axis=0))
        if len(here) < 2:
            continue
        a = int(rng.choice(here))
        others = here[here != a]
        b = int(others[np.linalg.norm(p[f, others] - p[f, a], axis=1).argmin()])
        p[f:, [a, b]] = p[f:, [b, a]]
        n += 1
    return Trajectories(tracks.time_s, tracks.names, p)


def judge(found: Trajectories, sightings: Sightings) -> list[int]:
    """Visible samples, those delivered right, those delivered wrong."""
    there = ~np.isnan(found.positions[..., 0])
    with np.errstate(invalid="ignore"):
        is_right = np.linalg.norm(found.positions - sightings.markers, axis=2) < SAME_MM
    visible = sightings.n_seen() >= 2
    right = int((there & is_right & visible).sum())
    return [int(visible.sum()), right, int((there & ~is_right).sum())]


def takes(n: int, first: int, seconds: float, keep: Path | None) -> list[str]:
    """Whole takes through tracker and labelling."""
    marker_set = ready_marker_set()
    sums = {what: np.zeros(3) for what in ("as tracked", "spoilt")}
    worst = dict.fromkeys(sums, 1.0)
    took, repairs = dict.fromkeys(sums, 0.0), dict.fromkeys(sums, 0)
    for seed in range(first, first + n):
        changes = {"seconds": seconds, "performance.style": STYLES[seed % len(STYLES)]}
        take = make_take(seed, settings_with(TakeSettings(), changes))
        motion = motion_of(take, keep)
        rng = np.random.default_rng([seed, 20])
        sightings = sight_markers(take, motion, TROUBLE, rng=rng)
        dots = (
            FrameDots(float(t), c, tuple(np.full(len(x), TROUBLE.noise_px) for x in c))
            for t, c in zip(sightings.time_s, sightings.centres, strict=True)
        )
        tracks = follow_markers(take.rig, dots).trajectories
        for what, given in (("as tracked", tracks), ("spoilt", spoilt(tracks, rng))):
            start = time.perf_counter()
            found = label_tracks(given, marker_set)
            took[what] += time.perf_counter() - start
            result = judge(found.trajectories, sightings)
            sums[what] += result
            worst[what] = min(worst[what], result[1] / result[0])
            repairs[what] += len(found.repairs)
            print(f"seed {seed}, {what}: {result}", flush=True)
    lines = [
        f"{n} takes of {seconds:g} s at 60 frames/s, 4 cameras",
        "",
        "| what | visible samples | labelled right | in the worst take | wrong | repairs "
        "| s a take |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for what, (visible, right, wrong) in sums.items():
        lines.append(
            f"| {what} | {visible:.0f} | {100 * right / visible:.2f} % | {100 * worst[what]:.2f} % "
            f"| {wrong:.0f} | {repairs[what]} | {took[what] / n:.2f} |"
        )
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--people", type=int, default=120)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--takes", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--first", type=int, default=1000, help="First seed.")
    parser.add_argument("--real", type=Path, default=Path("../shared/data/real"))
    parser.add_argument("--keep", type=Path, help="Keep motions here, and use them again.")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    warm_up()
    lines = [
        f"facewright {__version__}, seeds from {options.first}; {platform.machine()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}",
        "",
    ]
    if options.people:
        lines += [*strangers(options.people, options.first), ""]
    real = options.real / "facial_markers"
    if options.frames and real.is_dir():
        lines += [*real_markers(real, options.frames, options.first), ""]
    elif options.frames:
        lines += [f"Real markers: left out, there is no {real}", ""]
    if options.takes:
        lines += takes(options.takes, options.first, options.seconds, options.keep)
    text = "\n".join(lines)
    print(text)
    if options.out:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
