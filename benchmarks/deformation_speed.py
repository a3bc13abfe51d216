"""How many frames a second does the feature-point deformer make?

Kshirsagar, Garchery & Magnenat-Thalmann (2000) report 70 frames/s for 1,257 vertices on a 600 MHz
Pentium III. Run: ``python benchmarks/deformation_speed.py``
"""

from __future__ import annotations

import os
import platform
import time

import numpy as np
import scipy

from facewright.core.mesh import Mesh, SurfacePoints
from facewright.heads.decimation import decimate
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.retarget.drive import HeadDrive

SEED = 1
REPEATS = 7


def finer(head: Head, n_vertices: int) -> Head:
    """A head with more vertices: the longest edges' middles are not sought, triangles are quartered
    one by one (each gets a vertex in its middle), which is enough to be timed."""
    mesh = head.mesh
    skin = mesh.groups["skin"][: n_vertices - len(mesh.vertices)]
    middles = mesh.vertices[mesh.triangles[skin]].mean(axis=1)
    new = len(mesh.vertices) + np.arange(len(skin))
    a, b, c = mesh.triangles[skin].T
    split = np.concatenate([np.stack(t, axis=1) for t in ((a, b, new), (b, c, new), (c, a, new))])
    triangles = np.concatenate([np.delete(mesh.triangles, skin, axis=0), split])
    left_of_skin = len(mesh.groups["skin"]) - len(skin)
    groups, first = {}, 0
    for name, rows in mesh.groups.items():
        n = left_of_skin if name == "skin" else len(rows)
        groups[name] = np.arange(first, first + n)
        first += n
    groups["skin"] = np.concatenate([groups["skin"], np.arange(first, len(triangles))])
    fine = Mesh(np.concatenate([mesh.vertices, middles]), triangles.astype(np.int32), groups=groups)
    points: SurfacePoints = head.feature_points
    return Head("finer", fine, points, head.eyes, head.jaw_pivot, head.neck_pivot, head.appearance)


def measure(head: Head) -> tuple[float, float, float, float, float]:
    """Initialisation s; frames/s one by one; ms/frame in batches of 100; error mm at the points;
    entries per vertex."""
    start = time.perf_counter()
    drive = HeadDrive(head)
    ready_s = time.perf_counter() - start
    deformer = drive.deformer
    moves = np.random.default_rng(SEED).normal(size=(100, len(deformer.points), 3))
    deformer.displace(moves[0])
    single, batch = [], []
    for _ in range(REPEATS):
        start = time.perf_counter()
        for frame in moves:
            deformer.displace(frame)
        single.append((time.perf_counter() - start) / len(moves))
        start = time.perf_counter()
        deformer.displace(moves)
        batch.append((time.perf_counter() - start) / len(moves))
    constraints = drive.controls.constraints
    free = [n for n in constraints if n not in drive.controls.still]
    rows = [deformer.points.index(n) for n in free]
    moved = deformer.points.at(deformer.displace(moves[0]))[rows]
    wanted = np.where([constraints[n] for n in free], moves[0][rows], moved)
    error = float(np.abs(moved - wanted).max())
    per_vertex = deformer.matrix.nnz / deformer.n_vertices
    return ready_s, 1 / np.median(single), 1e3 * float(np.median(batch)), error, per_vertex


def main() -> None:
    """Print the table."""
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}")
    print(f"seed {SEED}, median of {REPEATS} runs of 100 frames\n")
    full = make_head(Identity("average"))
    heads = [decimate(full, 1257), full, finer(full, 30000)]
    print(
        "| vertices | ready s | frames/s | batch ms/frame | error at points mm | entries/vertex |"
    )
    print("| ---: | ---: | ---: | ---: | ---: | ---: |")
    for head in heads:
        ready_s, rate, batch_ms, error, entries = measure(head)
        n = len(head.mesh.vertices)
        print(
            f"| {n} | {ready_s:.2f} | {rate:.0f} | {batch_ms:.3f} | {error:.1e} | {entries:.1f} |"
        )


if __name__ == "__main__":
    main()
