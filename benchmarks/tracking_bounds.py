"""How near tracked positions come to the Cramér-Rao bound, and whether stated covariances are true.

    python benchmarks/tracking_bounds.py [--seeds 30] [--first 400] [--seconds 3]
    python benchmarks/tracking_bounds.py --takes TAKE_DIR...

The first form projects the markers of synthetic takes of all styles through four cameras, with
noise of a known size, and tracks the dots: the bound of a sample is the inverse of its views'
information, Σ JᵀJ / σ². Dots are dropped, hands pass, ghosts and lamps shine. No pictures are made,
so thirty takes need minutes.

The second form tracks filmed takes (`facewright synth take`, lossless or not). There the bound is
from what the dots' centres were really off by, camera by camera.
"""

from __future__ import annotations

import argparse
import platform
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from facewright.core.camera import Camera
from facewright.core.formats.rig_json import read_rig
from facewright.core.rig import Rig
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.sightings import (
    Sightings,
    Trouble,
    marker_motion,
    sight_markers,
)
from facewright.datasets_synthetic.take_settings import TakeSettings, settings_with
from facewright.datasets_synthetic.takes import make_take
from facewright.tracking.tracker import FrameDots, follow_markers
from facewright.tracking.videos import track_videos, warm_up

Floats = NDArray[np.float64]
NOISE_PX = 0.05
STYLES = ("mixed", "speech", "expressions", "range")
TROUBLES = {
    "all dots": Trouble(NOISE_PX, 0.0, 0.0, 0, 0.0, False),
    "10 % of dots dropped": Trouble(NOISE_PX, 0.1, 0.0, 0, 0.0, False),
    "dropped, hands, ghosts, lamps": Trouble(NOISE_PX, 0.1, 0.0, 2, 0.5, True),
}
WRONG_MM = 1.0
COVERED = chi2.ppf(0.95, 3)


@dataclass(frozen=True)
class Score:
    """One take: squared errors and bounds summed, samples counted."""

    squares: float
    bound_squares: float
    n_covered: int
    n_delivered: int
    n_visible: int
    n_found: int
    n_wrong: int
    n_mixed: int


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--takes", type=Path, nargs="+", metavar="TAKE_DIR")
    options = parser.parse_args()
    warm_up()
    print(f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}")
    if options.takes:
        filmed(options.takes)
    else:
        projected(range(options.first, options.first + options.seeds), options.seconds)


def projected(seeds: range, seconds: float) -> None:
    """Exact projections and noise."""
    scores: dict[tuple[str, str], list[Score]] = defaultdict(list)
    for seed in seeds:
        style = STYLES[seed % len(STYLES)]
        changes = {"seconds": seconds, "performance.style": style}
        take = make_take(seed, settings_with(TakeSettings(), changes))
        motion = marker_motion(take)
        for name, trouble in TROUBLES.items():
            dots = sight_markers(take, motion, trouble, rng=np.random.default_rng(seed))
            scores[name, style].append(judged(take.rig, dots))
            scores[name, "all"].append(scores[name, style][-1])
    print(f"seeds {seeds[0]} to {seeds[-1]}, {seconds:g} s each; noise {NOISE_PX} px\n")
    print(
        "| dots | style | RMS error mm | / bound | worst take | covered at 95 % "
        "| visible samples found % | off by > 1 mm | tracks of two markers |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for (name, style), rows in sorted(scores.items()):
        sums = {field: sum(getattr(r, field) for r in rows) for field in Score.__annotations__}
        rms = np.sqrt(sums["squares"] / sums["n_delivered"])
        ratio = np.sqrt(sums["squares"] / sums["bound_squares"])
        worst = max(np.sqrt(r.squares / r.bound_squares) for r in rows)
        print(
            f"| {name} | {style} | {rms:.4f} | {ratio:.3f} | {worst:.3f} "
            f"| {100 * sums['n_covered'] / sums['n_delivered']:.1f} "
            f"| {100 * sums['n_found'] / sums['n_visible']:.2f} | {sums['n_wrong']} "
            f"| {sums['n_mixed']} |"
        )


def judged(rig: Rig, seen: Sightings) -> Score:
    """Track dots and hold what is delivered against the truth."""
    sd = NOISE_PX
    frames = [
        FrameDots(float(t), centres, tuple(np.full(len(c), sd) for c in centres))
        for t, centres in zip(seen.time_s, seen.centres, strict=True)
    ]
    tracks = follow_markers(rig, frames).trajectories
    visible = seen.n_seen() >= 2
    bound = bounds_mm2(list(rig.cameras.values()), seen)
    own, at = owners(tracks, seen.markers)
    squares = bound_squares = 0.0
    n_covered = n_delivered = n_wrong = 0
    found = np.zeros(visible.shape, bool)
    assert tracks.covariances is not None
    for t, m in zip(*np.nonzero(at), strict=True):
        marker = own[m]
        if marker < 0 or not visible[t, marker]:  # a lamp, an ear-ring
            continue
        error = tracks.positions[t, m] - seen.markers[t, marker]
        if np.linalg.norm(error) > WRONG_MM:
            n_wrong += 1
            continue
        found[t, marker] = True
        n_delivered += 1
        squares += float(error @ error)
        bound_squares += bound[t, marker]
        distance2 = float(error @ np.linalg.solve(tracks.covariances[t, m], error))
        n_covered += distance2 < COVERED
    return Score(
        squares, bound_squares, n_covered, n_delivered, int(visible.sum()), int(found.sum()),
        n_wrong, n_mixed(tracks, seen.markers),
    )  # fmt: skip


def owners(tracks: Trajectories, truth: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(M,) the marker nearest to most of each track's samples, −1 for nobody's; (T, M) seen."""
    at = ~np.isnan(tracks.positions[..., 0])
    own = np.full(len(tracks.names), -1, dtype=np.int64)
    for m in range(len(own)):
        near, d = nearest(tracks.positions[at[:, m], m], truth[at[:, m]])
        if np.median(d) < WRONG_MM:
            own[m] = np.bincount(near).argmax()
    return own, at


def nearest(points: Floats, truth: Floats) -> tuple[NDArray[np.int64], Floats]:
    """For each of (n, 3) points its marker among (n, K, 3), and how far it is."""
    d = np.linalg.norm(points[:, None] - truth, axis=2)
    return np.asarray(d.argmin(axis=1)), np.asarray(d.min(axis=1))


def n_mixed(tracks: Trajectories, truth: Floats) -> int:
    """Tracks that lie on two markers at different times."""
    count = 0
    for m in range(len(tracks.names)):
        at = ~np.isnan(tracks.positions[:, m, 0])
        near, d = nearest(tracks.positions[at, m], truth[at])
        count += len(np.unique(near[d < WRONG_MM])) > 1
    return count


def bounds_mm2(cameras: list[Camera], seen: Sightings) -> Floats:
    """(T, M) traces of the inverse information of the views that there are; NaN below two."""
    T, M = seen.markers.shape[:2]
    information = np.zeros((T, M, 3, 3))
    for c, camera in enumerate(cameras):
        J = jacobian(camera, seen.markers.reshape(-1, 3)).reshape(T, M, 2, 3)
        there = np.zeros((T, M), bool)
        for t, frame in enumerate(seen.owners):
            there[t, frame[c][frame[c] >= 0]] = True
        own = np.einsum("tmia,tmib->tmab", J, J) / NOISE_PX**2
        information += np.where(there[..., None, None], own, 0)
    bound = np.full((T, M), np.nan)
    good = seen.n_seen() >= 2
    bound[good] = np.trace(np.linalg.inv(information[good]), axis1=1, axis2=2)
    return bound


def jacobian(camera: Camera, points: Floats) -> Floats:
    """(N, 2, 3) px/mm, by central differences of the forward model."""
    h = 1e-3
    ways = [camera.project(points + h * e) - camera.project(points - h * e) for e in np.eye(3)]
    return np.stack(ways, axis=-1) / (2 * h)


def filmed(folders: list[Path]) -> None:
    """Takes with pictures."""
    print("\n| take | RMS error mm | / bound of the dots' own errors | covered at 95 % | found % |")
    print("| --- | --- | --- | --- | --- |")
    ratios, shares = [], []
    for folder in folders:
        rms, ratio, covered, found = judged_film(folder)
        ratios.append(ratio)
        shares.append(covered)
        print(f"| {folder.name} | {rms:.4f} | {ratio:.3f} | {covered:.1f} | {found:.2f} |")
    print(f"| median of {len(folders)} | | {np.median(ratios):.3f} | {np.median(shares):.1f} | |")


def judged_film(folder: Path) -> tuple[float, float, float, float]:
    """RMS mm, its ratio to the bound, per cent covered, per cent of visible samples found."""
    rig = read_rig(folder / "rig.json")
    videos = sorted(p for p in folder.iterdir() if p.stem in rig.cameras)
    truth = np.load(folder / "truth.npz")
    tracks = track_videos(videos, rig).trajectories
    markers = truth["marker_positions"]
    seen = truth["marker_visible"] > 0.5
    names = [str(n) for n in truth["camera_names"]]
    own, at = owners(tracks, markers)
    squares, n, n_covered = 0.0, 0, 0
    assert tracks.covariances is not None
    information = np.zeros((*markers.shape[:2], 3, 3))
    for m, marker in enumerate(own):
        if marker < 0:
            continue
        rows = np.flatnonzero(at[:, m])
        error = tracks.positions[rows, m] - markers[rows, marker]
        squares += float((error**2).sum())
        n += len(rows)
        C = tracks.covariances[rows, m]
        distance2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(C), error)
        n_covered += int((distance2 < COVERED).sum())
    sd = dot_errors(videos, rig, truth)
    for c, name in enumerate(names):
        J = jacobian(rig[name], markers.reshape(-1, 3)).reshape(*markers.shape[:2], 2, 3)
        part = np.einsum("tmia,tmib->tmab", J, J) / sd[name] ** 2
        information += np.where(seen[:, c, :, None, None], part, 0)
    two = seen.sum(axis=1) >= 2
    bound = np.trace(np.linalg.inv(information[two]), axis1=1, axis2=2).mean()
    rms = float(np.sqrt(squares / n))
    return rms, rms / float(np.sqrt(bound)), 100 * n_covered / n, 100 * n / int(two.sum())


def dot_errors(videos: list[Path], rig: Rig, truth: Any) -> dict[str, float]:
    """RMS an axis of what unhidden dots' centres are off from the projected markers, px."""
    from facewright.tracking.dot_streams import stream_dots
    from facewright.tracking.video_clocks import read_clocks
    from facewright.tracking.videos import blob_settings

    paths = {p.stem: p for p in videos}
    squares: dict[str, list[float]] = {name: [] for name in rig}
    names = [str(n) for n in truth["camera_names"]]
    frames = stream_dots({n: paths[n] for n in rig}, read_clocks(paths), blob_settings(paths))
    for t, frame in enumerate(frames):
        for dots, name in zip(frame.centres, rig, strict=True):
            c = names.index(name)
            whole = truth["marker_visible"][t, c] > 0.99
            places = truth["marker_pixels"][t, c][whole]
            if len(dots) and len(places):
                d = np.linalg.norm(dots[:, None] - places, axis=2).min(axis=1)
                squares[name] += list(d[d < 1.0] ** 2 / 2)
    return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}


if __name__ == "__main__":
    main()
