"""How well are feature points placed on heads that come from elsewhere?

    python benchmarks/feature_point_placement.py [--heads 50] [--seed 5000]

Unseen people (seeds that nothing else uses) are disguised as other makers' heads: another topology
(edges collapsed at random sizes), unit (mm to m), axes (four turns, some degrees of tilt), no
lashes, no names, no texture. Each is written to a .ply and read as any user's file: the face is
found on drawn views of the mesh, the template laid onto it. The error is the distance from where
the point lies on the person, in mm. The heads are drawn from the same space of shapes that the
warp's model of people spans; heads of another origin are judged by eye (charts) and in the tests.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from pathlib import Path

import numpy as np

from facewright.core.errors import FacewrightError
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.mesh import Mesh
from facewright.datasets_synthetic.foreign_heads import foreign_head
from facewright.heads.face_finder import FaceFinder
from facewright.heads.identity import make_head, random_identity
from facewright.heads.own_head import read_own_head

MEAN_LIMIT_MM, WORST_LIMIT_MM = 2.0, 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--heads", type=int, default=50)
    parser.add_argument("--seed", type=int, default=5000)
    options = parser.parse_args()
    print(f"{platform.platform()}, {os.cpu_count()} cores, NumPy {np.__version__}")
    print(f"{options.heads} heads from seed {options.seed}\n")
    finder = FaceFinder()
    errors: dict[str, list[float]] = {}
    per_head, seconds, lost, n_missing = [], [], 0, 0
    for seed in range(options.seed, options.seed + options.heads):
        rng = np.random.default_rng([seed, 6])
        head = make_head(random_identity(np.random.default_rng(seed), f"p{seed}"), texture_px=256)
        foreign = foreign_head(head, rng)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "head.ply"
            mesh = Mesh(foreign.vertices, foreign.triangles)
            write_ply(path, PlyMesh(mesh), double=True)
            start = time.perf_counter()
            try:
                own = read_own_head(path, finder=finder)
            except FacewrightError as error:
                print(f"seed {seed}: {error}")
                lost += 1
                continue
            seconds.append(time.perf_counter() - start)
        found = own.points_in_file()["feature point"]
        here = {
            name: float(np.linalg.norm(found[name] - foreign.unit_mm * p))
            for name, p in foreign.points.items()
            if name in found and name != "11.5"
        }
        missing = sorted(set(foreign.points) - set(found))
        n_missing += len(missing)
        worst = max(here, key=lambda name: here[name])
        per_head.append((float(np.mean(list(here.values()))), here[worst]))
        print(
            f"seed {seed}: {len(foreign.vertices)} vertices, unit {foreign.unit_mm:g} mm: mean "
            f"{per_head[-1][0]:.2f}, worst {here[worst]:.2f} mm ({worst})"
            + (f", missing {missing}" if missing else ""),
            flush=True,
        )
        for name, value in here.items():
            errors.setdefault(name, []).append(value)
    everything = np.concatenate([np.array(v) for v in errors.values()])
    print("\n| measured | value | limit |\n| --- | ---: | ---: |")
    print(f"| mean over points and heads, mm | {everything.mean():.2f} | {MEAN_LIMIT_MM} |")
    print(f"| worst point of any head, mm | {everything.max():.2f} | {WORST_LIMIT_MM} |")
    print(f"| heads not recognised | {lost} | 0 |")
    print(f"| points not placed | {n_missing} | 0 |")
    print(f"| seconds a head (median) | {np.median(seconds):.1f} | |")
    rows = sorted(errors.items(), key=lambda item: -float(np.mean(item[1])))[:12]
    print("\nworst points: " + ", ".join(f"{n} {np.mean(v):.2f} ({max(v):.1f})" for n, v in rows))


if __name__ == "__main__":
    main()
