"""How near the skin comes to a performance that only its FAPs tell of, moved by feature points.

    python benchmarks/fap_to_vertices.py [--heads 10] [--first 100] [--seconds 4] [--every 20]
                                         [--foreign HEAD.glb] [--out FILE.md]

Two performances of each head. Truth: vertices and FAPs of `datasets_synthetic.face_motion` (a jaw
that turns, lids that slide, lips that touch). The heads are people that the auxiliary points were
not learnt from: those know the average head's sculpted shapes alone. All people here share these
shapes, so that two harder rows follow: people whose local features are twice as far from the
average as anybody's, and (`--foreign`) a head of another origin under its own morphs, which were
sculpted by others, with the feature points that we place.

Errors are root mean squares over all frames and over the skin that is seen at rest from in front
and from up to 60° aside; in brackets: below the deformer of the paper alone.
"""

from __future__ import annotations

import argparse
import logging
import platform
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from shape_solving import acted_faps, frames, mean_square, seen_skin

from facewright import __version__
from facewright.core.clip import Clip
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.performances import STYLES, random_performance
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity
from facewright.heads.own_head import read_own_head
from facewright.retarget.drive import HeadDrive
from facewright.retarget.shape_solver import ShapeDrive, weights_to_faps

Floats = NDArray[np.float64]
RATE_HZ = 60.0
PER_HEAD = 2
PAPER = "Kshirsagar 2000, equations as printed"
DRIVES: dict[str, dict[str, Any]] = {
    PAPER: {"auxiliary": False, "fade": False, "smoothing": 0.0},
    "Kshirsagar, fading and smoothed": {"auxiliary": False},
    "biharmonic": {"auxiliary": False, "weights": "biharmonic"},
    "as printed, auxiliary points": {"fade": False, "smoothing": 0.0},
    "default: fading and smoothed, auxiliary points": {},
    "biharmonic, auxiliary points": {"weights": "biharmonic"},
}
Rows = dict[str, list[float]]


def performances(
    rng: np.random.Generator, head: Head, first: int, n: int, seconds: float, every: int
) -> Iterator[Clip]:
    """Weights of a few frames each, the styles in turn."""
    for k in range(n):
        style = STYLES[(first + k) % len(STYLES)]
        acted = random_performance(rng, head, seconds=seconds, rate_hz=RATE_HZ, style=style)
        w = acted.weights
        rows = slice(every // 2, None, every)
        yield Clip(w.time_s[rows], w.channels, w.values[rows])


def judge(head: Head, clips: list[tuple[Clip, Floats]], rows: Rows) -> None:
    """Mean squares of one head, mm², by what moved it."""
    seen = seen_skin(head)
    for _, truth in clips:
        rest = np.broadcast_to(head.mesh.vertices, truth.shape)
        rows["motion"].append(mean_square(iter(rest), truth, seen))
    for name, options in DRIVES.items():
        drive = HeadDrive(head, **options)
        for faps, truth in clips:
            rows[name].append(mean_square(frames(drive, faps), truth, seen))


def built_in(seed: int, exaggerated: bool, seconds: float, every: int, rows: Rows) -> None:
    """A person under two performances."""
    rng = np.random.default_rng(seed)
    who: Identity = random_identity(rng, f"person {seed}")
    if exaggerated:
        who = replace(who, local={name: 2 * weight for name, weight in who.local.items()})
    head = make_head(who, texture_px=256)
    motion = FaceMotion(head)
    acted = performances(rng, head, PER_HEAD * seed, PER_HEAD, seconds, every)
    judge(head, [acted_faps(head, motion, weights) for weights in acted], rows)


def foreign(path: Path, seed: int, seconds: float, every: int, rows: Rows) -> None:
    """A head from a file under its own morphs, acted by a built-in one."""
    head = read_own_head(path).head
    shapes = ShapeDrive(head)
    rng = np.random.default_rng(seed)
    actor = make_head(random_identity(rng), texture_px=256)
    clips = []
    for weights in performances(rng, actor, 0, len(STYLES), seconds, every):
        truth = np.stack(list(frames(shapes, weights)))
        clips.append((weights_to_faps(shapes.jacobian, weights), truth))
    judge(head, clips, rows)


def table(columns: dict[str, Rows]) -> list[str]:
    """Roots of the means, and the part below the paper's."""
    lines = [
        "| moved by | " + " | ".join(f"{name}, mm" for name in columns) + " |",
        "| --- |" + " ---: |" * len(columns),
    ]
    for name in ("motion", *DRIVES):
        cells = []
        for rows in columns.values():
            value, paper = (float(np.sqrt(np.mean(rows[n]))) for n in (name, PAPER))
            below = "" if name in ("motion", PAPER) else f" ({100 * (1 - value / paper):.0f} %)"
            cells.append(f"{value:.3f}{below}")
        label = "nothing: the motion itself" if name == "motion" else name
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--heads", type=int, default=10)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--every", type=int, default=20, help="frames, 60 a second")
    parser.add_argument("--foreign", type=Path, help="a .glb with ARKit-like morphs")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    logging.getLogger("facewright").setLevel(logging.ERROR)  # clamped FAPs, once a drive
    seconds, every = options.seconds, options.every
    people, exaggerated, other = (defaultdict(list) for _ in range(3))
    for seed in range(options.first, options.first + options.heads):
        built_in(seed, False, seconds, every, people)
        print(f"person {seed}", flush=True)
    for seed in range(options.first, options.first + (options.heads + 1) // 2):
        built_in(seed, True, seconds, every, exaggerated)
        print(f"person {seed}, exaggerated", flush=True)
    n, m = PER_HEAD * options.heads, PER_HEAD * ((options.heads + 1) // 2)
    columns: dict[str, Rows] = {
        f"{n} performances": people,
        f"{m}, local features doubled": exaggerated,
    }
    if options.foreign:
        foreign(options.foreign, options.first, seconds, every, other)
        columns[f"{len(STYLES)}, head of another origin"] = other
    lines = [
        f"facewright {__version__}, people from {options.first}, {seconds:g} s each, every "
        f"{every}th frame of {RATE_HZ:g}/s; {platform.machine()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}",
        "",
        *table(columns),
    ]
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
