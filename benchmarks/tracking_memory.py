"""How much memory a take of ten seconds needs, and one of ten minutes.

    python benchmarks/tracking_memory.py TAKE_DIR [--minutes 10] [--seconds 10]

TAKE_DIR is a folder of `facewright synth take`. Its videos are cut or joined to themselves without
coding them again until they are as long as asked; each length is tracked to C3D, labelled and
filled, in a process of its own, whose largest resident memory counts.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.video import probe_video
from facewright.core.video_writer import join_videos
from facewright.tracking.long_takes import track_long
from facewright.tracking.videos import warm_up


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("take", type=Path)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(tracked(options.take)))
        return
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for seconds in (options.seconds, 60 * options.minutes):
            folder = Path(scratch) / f"{seconds:g}"
            lasts_s = lengthen(options.take, folder, seconds)
            command = [sys.executable, __file__, str(folder), "--one"]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rows.append({"seconds": lasts_s, **json.loads(done.stdout)})
    print(f"{platform.machine()}, Python {platform.python_version()}\n")
    print("| take s | camera frames | largest memory MB | camera frames/s |")
    print("| --- | --- | --- | --- |")
    for row in rows:
        print(f"| {row['seconds']:.0f} | {row['frames']} | {row['mb']:.0f} | {row['rate']:.0f} |")
    print(f"\nDifference: {rows[1]['mb'] - rows[0]['mb']:+.0f} MB (limit 20)")


def lengthen(take: Path, folder: Path, seconds: float) -> float:
    """The take, over and over, in a folder; how long it is, s."""
    folder.mkdir()
    for name in ("rig.json", "markers.toml"):
        (folder / name).write_bytes((take / name).read_bytes())
    rig = read_rig(take / "rig.json")
    lasts_s = 0.0
    for path in (p for p in sorted(take.iterdir()) if p.stem in rig.cameras):
        one_s = probe_video(path).duration_s
        count = max(1, round(seconds / one_s))
        starts = [i * one_s for i in range(count)]
        join_videos([path] * count, folder / path.name, starts_s=starts)
        lasts_s = count * one_s
    return lasts_s


def tracked(folder: Path) -> dict[str, float]:
    """Track a take; frames of all cameras, largest memory, frames a second."""
    rig = read_rig(folder / "rig.json")
    videos = sorted(p for p in folder.iterdir() if p.stem in rig.cameras)
    marker_set = read_marker_set(folder / "markers.toml")
    warm_up()
    start = time.perf_counter()
    found = track_long(videos, rig, folder / "markers.c3d", marker_set=marker_set)
    took_s = time.perf_counter() - start
    frames = found.n_frames * len(videos)
    kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"frames": frames, "mb": kb / 1024, "rate": frames / took_s}


if __name__ == "__main__":
    main()
