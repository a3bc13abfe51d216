"""How far every stage of the marker pipeline is off, over many synthetic takes.

    python benchmarks/demo_accuracy.py --seeds 20 [--first 100] [--takes DIR] [--out FILE.md]

Each seed is another actor, performance and camera rig, filmed as `facewright demo` films it
(4 cameras, 4 s at 60 frames/s, 30 flat dots, H.264 below 2 Mbit/s), tracked from the video files
and compared with the exact truth. Seed 0 is the demo's own and is left out by default.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

from facewright import __version__
from facewright.cli.evaluation import Stage, evaluate, fap_errors_percent, load_truth
from facewright.core.clip import Clip
from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.markers import MarkerSet
from facewright.core.mpeg4 import fap_by_name
from facewright.core.trajectories import Trajectories
from facewright.core.video import probe_video
from facewright.datasets_synthetic.film import FilmedTake, film_take
from facewright.datasets_synthetic.take_settings import TakeSettings
from facewright.datasets_synthetic.takes import make_take
from facewright.tracking.gaps import fill_gaps
from facewright.tracking.labelling import label_tracks
from facewright.tracking.performance import TrackedPerformance, analyse, estimate_fapu
from facewright.tracking.videos import track_videos, warm_up


def filmed_take(seed: int, seconds: float, folder: Path) -> tuple[FilmedTake, float]:
    """Film a take, or find it filmed before; the seconds it took (NaN for the latter)."""
    names = ("rig.json", "markers.toml", "truth.npz")
    rig, marker_set, truth = (folder / n for n in names)
    if all((folder / n).exists() for n in names):
        videos = tuple(sorted(folder.glob("cam*.mp4")))
        return FilmedTake(folder, rig, truth, folder / "take.toml", videos, marker_set), np.nan
    folder.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    filmed = film_take(make_take(seed, TakeSettings(seconds=seconds)), folder)
    return filmed, time.perf_counter() - start


def judge_seed(seed: int, seconds: float, takes: Path | None) -> list[Stage]:
    """All stages of one take."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) if takes is None else takes / f"seed-{seed}-{seconds:g}s"
        filmed, filming_s = filmed_take(seed, seconds, folder)
        assert filmed.marker_set is not None
        marker_set = read_marker_set(filmed.marker_set)
        start = time.perf_counter()
        tracked = track_videos(filmed.videos, read_rig(filmed.rig)).trajectories
        tracking_s = time.perf_counter() - start
        labelled = fill_gaps(label_tracks(tracked, marker_set).trajectories)
        truth = load_truth(filmed.truth)
        performance = analyse(labelled, marker_set)
        stages = evaluate(filmed.videos, truth, labelled, performance)
        estimated = estimate_fapu(performance.neutral.positions, marker_set).as_dict().values()
        off = float(100 * np.abs(np.array(list(estimated)) / truth["fapu"] - 1).max())
        measured = where_seen(performance, labelled, marker_set)
        seen = max(fap_errors_percent(measured, truth).values())
        n = len(truth["time_s"]) * len(filmed.videos)
        rates = [p.stat().st_size * 8e-6 / probe_video(p).duration_s for p in filmed.videos]
    return [
        Stage("filming", "camera frames per second", "1/s", n / filming_s),
        Stage("filming", "largest video", "Mbit/s", max(rates), 2.0),
        Stage("tracking", "camera frames per second", "1/s", n / tracking_s, 120, at_least=True),
        *stages,
        Stage("FAPs", "tracked points while their markers are seen, worst", "%", seen),
        Stage("FAPs", "units if estimated from the markers, largest error", "%", off),
    ]


def where_seen(found: TrackedPerformance, markers: Trajectories, marker_set: MarkerSet) -> Clip:
    """The FAPs of observed points, only where a FAP's own marker was measured."""
    of_point = marker_set.label_by_feature_point
    values = {}
    for name in found.faps.channels:
        points = [p for p in fap_by_name()[name].feature_points if p in of_point]
        if name in found.approximated or not points:
            continue
        is_measured = markers.select(tuple(of_point[p] for p in points)).is_measured.all(axis=1)
        values[name] = np.where(is_measured, found.faps[name], np.nan)
    return Clip(found.faps.time_s, tuple(values), np.column_stack(list(values.values())))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--takes", type=Path, help="keep filmed takes here, and use them again")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    warm_up()
    values: dict[tuple[str, str], list[Stage]] = defaultdict(list)
    for seed in range(options.first, options.first + options.seeds):
        missed = []
        for stage in judge_seed(seed, options.seconds, options.takes):
            values[stage.stage, stage.quantity].append(stage)
            if not stage.passed:
                missed.append(f"{stage.quantity} {stage.value:.4g}")
        print(f"seed {seed}: {', '.join(missed) or 'all limits kept'}", flush=True)
    lines = [
        f"facewright {__version__}, seeds {options.first} to {options.first + options.seeds - 1}, "
        f"{options.seconds:g} s each; {platform.machine()}, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, OpenCV {cv2.__version__}",
        "",
        "| stage | measured | unit | median | worst | limit | seeds within |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (stage_name, quantity), stages in values.items():
        v = np.array([s.value for s in stages])
        if np.isnan(v).all():  # takes that were filmed before tell no speed
            continue
        at_least, limit = stages[0].at_least, stages[0].limit
        lowest = at_least or quantity.endswith(("per second", "found"))
        worst = np.nanmin(v) if lowest else np.nanmax(v)
        sign = "≥" if at_least else "≤"
        kept = "" if limit is None else f"{sum(s.passed for s in stages)} of {len(stages)}"
        bound = "" if limit is None else f"{sign} {limit:g}"
        lines.append(
            f"| {stage_name} | {quantity} | {stages[0].unit} | {np.nanmedian(v):.4g} | {worst:.4g} "
            f"| {bound} | {kept} |"
        )
    text = "\n".join(lines)
    print(text)
    if options.out:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
