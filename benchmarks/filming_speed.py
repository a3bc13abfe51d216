"""How fast takes are filmed, all in: acting, pictures, noise, coding, truth.

    python benchmarks/filming_speed.py [--seconds 2] [--only dots plain]

Four cameras, 1280×720. Per mode: camera frames a second of wall-clock time; processor time a camera
frame, of all threads, which what else runs on the machine hardly changes; and the process's peak
memory so far. A short take is filmed before, so that everything is compiled.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

from facewright import __version__
from facewright.datasets_synthetic.film import film_take
from facewright.datasets_synthetic.take_settings import settings_for, settings_with
from facewright.datasets_synthetic.takes import make_take

MODES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "dots": ("markers", "dots", {}),
    "dots, lossless": ("markers", "dots", {"video.codec": "lossless"}),
    "dots, ghosts and vignetting": (
        "markers", "dots", {"cameras.ghost": 0.03, "cameras.vignetting": 0.4},
    ),
    "dots, gamma 2.2": ("markers", "dots", {"cameras.gamma": 2.2}),
    "spheres, 1 ms exposure": ("markers", "spheres", {}),
    "spheres, 8 ms exposure": ("markers", "spheres", {"cameras.exposure_s": 0.008}),
    "spheres, rolling shutter 12 ms": ("markers", "spheres", {"cameras.readout_s": 0.012}),
    "spheres, focus blur": ("markers", "spheres", {"cameras.pupil_mm": 8.0}),
    "dots, a hand before the face": ("markers", "dots", {"scene.occluder": "hand"}),
    "wand": ("wand", "dots", {}),
    "plain, 8 ms exposure": ("plain", "dots", {"scene.light": "studio"}),
    "plain, rolling shutter 12 ms": (
        "plain", "dots", {"scene.light": "studio", "cameras.readout_s": 0.012},
    ),
    "plain, a hand before the face": (
        "plain", "dots", {"scene.light": "studio", "scene.occluder": "hand"},
    ),
}  # fmt: skip


def film(kind: str, look: str, changes: dict[str, Any], seconds: float) -> tuple[int, float, float]:
    """Camera frames, wall-clock seconds and processor seconds of a take."""
    asked = {"seconds": seconds, "cameras.count": 4, **changes}
    take = make_take(1, settings_with(settings_for(kind, look), asked))
    take.pose(0.0)
    with tempfile.TemporaryDirectory() as name:
        wall, cpu = time.perf_counter(), time.process_time()
        film_take(take, Path(name))
        n = len(take.time_s) * len(take.rig.names)
        return n, time.perf_counter() - wall, time.process_time() - cpu


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--only", nargs="*", default=list(MODES))
    options = parser.parse_args()
    load = os.getloadavg()[0]
    print(f"facewright {__version__}; {platform.machine()}, Python {platform.python_version()}, "
          f"{os.cpu_count()} cores, load {load:.1f} at the start\n")  # fmt: skip
    print("| mode | camera frames/s | processor ms a frame | peak memory so far, MB |")
    print("| --- | ---: | ---: | ---: |")
    for mode in options.only:
        kind, look, changes = MODES[mode]
        film(kind, look, changes, 0.5)
        n, wall_s, cpu_s = film(kind, look, changes, options.seconds)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rate, each = n / wall_s, 1000 * cpu_s / n
        print(f"| {mode} | {rate:.1f} | {each:.0f} | {peak:.0f} |", flush=True)


if __name__ == "__main__":
    main()
