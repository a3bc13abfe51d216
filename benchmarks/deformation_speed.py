"""How many frames a second does the feature-point deformer make?

Kshirsagar, Garchery & Magnenat-Thalmann (2000) report 70 frames/s for 1,257 vertices on a 600 MHz
Pentium III. Facial animation tables of the same head are timed beside its drive. Run:
``python benchmarks/deformation_speed.py [--fine N]``
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable

import numpy as np
import scipy

from facewright.core.clip import Clip
from facewright.core.mesh import Mesh, SurfacePoints
from facewright.core.mpeg4 import fap_table
from facewright.heads.decimation import decimate
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.retarget.animation import HeadAnimation
from facewright.retarget.drive import HeadDrive
from facewright.retarget.fat import build_fat

SEED = 1
REPEATS = 15


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


def quartered(head: Head) -> Head:
    """A head whose skin has four triangles for each, with its feature points at vertices."""
    mesh = head.mesh
    skin = mesh.triangles[mesh.groups["skin"]]
    sides = np.sort(np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]], skin[:, [2, 0]]]), axis=1)
    edges, which = np.unique(sides, axis=0, return_inverse=True)
    ab, bc, ca = len(mesh.vertices) + which.reshape(3, -1)
    a, b, c = skin.T
    four = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    rest = np.delete(mesh.triangles, mesh.groups["skin"], axis=0)
    groups, first = {}, 0
    for name, rows in mesh.groups.items():
        if name != "skin":
            groups[name] = np.arange(first, first + len(rows))
            first += len(rows)
    groups["skin"] = np.arange(first, first + 4 * len(skin))
    vertices = np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)])
    triangles = np.concatenate([rest, *four]).astype(np.int32)
    nearest = [c[b.argmax()] for c, b in zip(
        head.feature_points.corners, head.feature_points.barycentric, strict=True)]  # fmt: skip
    _, corner = np.unique(triangles, return_index=True)
    at = corner[np.array(nearest)]
    names = head.feature_points.names
    points = SurfacePoints(names, triangles[at // 3], np.eye(3)[at % 3])
    fine = Mesh(vertices, triangles, groups=groups)
    return Head("fine", fine, points, head.eyes, head.jaw_pivot, head.neck_pivot, head.appearance)


def best(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """The quickest of some runs, s: other work on the machine only ever adds."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def measure(drive: HeadDrive) -> tuple[float, float, float, float, float]:
    """Frames/s one by one; ms/frame in batches of 100, into a new array and into one used again;
    error mm at the points; entries per vertex, of all axes."""
    deformer = drive.deformer
    moves = np.random.default_rng(SEED).normal(size=(100, len(deformer.points), 3))
    single = best(lambda: [deformer.displace(frame) for frame in moves]) / len(moves)
    batch = best(lambda: deformer.displace(moves)) / len(moves)
    out = deformer.displace(moves)
    again = best(lambda: deformer.displace(moves, out=out)) / len(moves)
    constraints = drive.controls.constraints
    free = [n for n in constraints if n not in drive.controls.still]
    rows = [deformer.points.index(n) for n in free]
    told = moves[:1].copy()
    told[:, [i for i, n in enumerate(deformer.points.names) if ".meet." in n]] = 0.0  # lids' own
    moved = deformer.points.at(deformer.displace(told[0]))[rows]
    followed = told if deformer.followers is None else deformer.followers.follow(told)
    wanted = np.where([constraints[n] for n in free], followed[0][rows], moved)
    error = float(np.abs(moved - wanted).max())
    per_vertex = sum(table.nnz for table in deformer.tables) / deformer.n_vertices
    return 1 / single, 1e3 * batch, 1e3 * again, error, per_vertex


def print_tables(drive: HeadDrive) -> None:
    """Time of a frame from FAPs to vertices: by the drive and by its tables."""
    fat = build_fat(drive)
    names = tuple(fap.name for fap in fap_table()[2:])
    values = np.random.default_rng(SEED).uniform(-100, 100, (100, len(names)))
    clip = Clip(np.arange(100) / 25, names, values)
    print("\n| from 66 FAPs to vertices | ms/frame, a clip of 100 | ms, a frame alone |")
    print("| --- | ---: | ---: |")
    one = Clip(np.zeros(1), names, values[:1])
    told = dict(zip(names, values[0], strict=True))

    def row(name: str, play: Callable[[Clip], HeadAnimation], alone: Callable[[], object]) -> None:
        def all_frames() -> None:
            animation = play(clip)
            for i in range(len(animation)):
                animation.vertices(i)

        ms = 1e3 * best(all_frames, 3) / len(values)
        print(f"| {name} | {ms:.3f} | {1e3 * best(alone):.3f} |")

    row("drive", drive.animate, lambda: drive.animate(one).vertices(0))
    row("tables", fat.animate, lambda: fat.vertices(told))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fine", type=int, default=1, help="finer heads: 1: 71,000 vertices")
    fine = parser.parse_args().fine
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}")
    print(f"seed {SEED}, best of {REPEATS} runs of 100 frames\n")
    full = make_head(Identity("average"))
    heads = [decimate(full, 1257), full, finer(full, 30000)]
    for _ in range(fine):
        heads.append(quartered(heads[-1] if len(heads) > 3 else full))
    print(
        "| vertices | ready s | frames/s | batch ms/frame | into the same array | "
        "error at points mm | entries/vertex |"
    )
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    HeadDrive(heads[0])  # compiled, before it is timed
    for head in heads:
        start = time.perf_counter()
        drive = HeadDrive(head)
        ready_s = time.perf_counter() - start
        rate, batch_ms, again_ms, error, entries = measure(drive)
        print(
            f"| {len(head.mesh.vertices)} | {ready_s:.2f} | {rate:.0f} | {batch_ms:.3f} | "
            f"{again_ms:.3f} | {error:.1e} | {entries:.1f} |",
            flush=True,
        )
    print_tables(HeadDrive(full))


if __name__ == "__main__":
    main()
