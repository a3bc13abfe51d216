"""How far fillings of gaps are off, and whether they say so, on real markers.

    python benchmarks/gap_filling.py FOLDER [--gaps 200] [--seed 0] [--out FILE.md]

FOLDER holds `Jaw.csv` and `Cheeks.csv` of AnimFace (41 facial markers at 60 Hz, cm: `frame`, then
`NAME_x,_y,_z`). One random marker at a time is hidden for 30 or 120 frames; everything else of the
take is there to learn from. RMS distance over all hidden samples of all gaps.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from facewright import __version__
from facewright.core.trajectories import Trajectories
from facewright.tracking.gaps import fill_gaps

Floats = NDArray[np.float64]
RATE_HZ = 60.0
LIMITS_MM = {("Jaw", 30): 0.45, ("Jaw", 120): 0.80, ("Cheeks", 30): 0.60, ("Cheeks", 120): 1.15}


def read_take(path: Path) -> Trajectories:
    """The recording, mm."""
    header = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    names = tuple(n.removesuffix("_x") for n in header[1::3])
    positions = table[:, 1 : 1 + 3 * len(names)].reshape(len(table), -1, 3) * 10.0
    return Trajectories(np.arange(len(table)) / RATE_HZ, names, positions)


def judge(take: Trajectories, length: int, n_gaps: int, seed: int) -> dict[str, float]:
    """RMS errors of ours and of two usual ways, mm; ours as stated; share within two sigma."""
    rng = np.random.default_rng(seed)
    squares: dict[str, list[Floats]] = {n: [] for n in ("ours", "stated", "lines", "cubics")}
    within: list[NDArray[np.bool_]] = []
    spent = 0.0
    for _ in range(n_gaps):
        m = int(rng.integers(len(take.names)))
        first = int(rng.integers(1, len(take.time_s) - length - 1))
        rows = slice(first, first + length)
        positions = np.array(take.positions)
        positions[rows, m] = np.nan
        start = time.perf_counter()
        found = fill_gaps(Trajectories(take.time_s, take.names, positions))
        spent += time.perf_counter() - start
        assert found.covariances is not None
        true, C = take.positions[rows, m], found.covariances[rows, m]
        error = found.positions[rows, m] - true
        squares["ours"].append((error**2).sum(axis=1))
        squares["stated"].append(np.trace(C, axis1=1, axis2=2))
        within.append((error**2).sum(axis=1) < 4 * np.trace(C, axis1=1, axis2=2))
        known = np.flatnonzero(~np.isnan(positions[:, m, 0]))
        near = known[np.abs(known - first - length / 2) < length / 2 + 9]
        t = np.arange(first, first + length)
        line = np.stack([np.interp(t, known, positions[known, m, k]) for k in range(3)], axis=1)
        cubic = CubicSpline(near, positions[near, m], bc_type="natural")(t)
        for name, way in (("lines", line), ("cubics", cubic)):
            squares[name].append(((way - true) ** 2).sum(axis=1))
    found_rms = {name: float(np.sqrt(np.mean(v))) for name, v in squares.items()}
    return {**found_rms, "within": float(np.mean(within)), "ms": 1e3 * spent / n_gaps}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--gaps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        f"facewright {__version__}, {options.gaps} gaps a row, seed {options.seed}; "
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, "
        f"SciPy {scipy.__version__}",
        "",
        "| take | frames | ours mm | limit | stated mm | stated/ours | within 2 σ % | lines mm "
        "| cubics mm | ms a gap |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (name, length), limit in LIMITS_MM.items():
        take = read_take(options.folder / f"{name}.csv")
        v = judge(take, length, options.gaps, options.seed)
        lines.append(
            f"| {name} | {length} | {v['ours']:.3f} | ≤ {limit:g} | {v['stated']:.3f} "
            f"| {v['stated'] / v['ours']:.2f} | {100 * v['within']:.0f} | {v['lines']:.2f} "
            f"| {v['cubics']:.2f} | {v['ms']:.0f} |"
        )
        print(lines[-1], flush=True)
    text = "\n".join(lines)
    print(text)
    if options.out:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
