"""How fast marker tracking is, decoding included, and its dot finder against peers.

    python benchmarks/tracking_speed.py TAKE_DIR [TAKE_DIR ...] [--repeats 5]

TAKE_DIR is a folder of `facewright synth take` (or demo); give one of a low and one of a high bit
rate (``--settings`` a file with ``max_bit_rate = 25000000`` and ``crf = 1`` under ``[video]``). The
whole way is timed, from videos to `.fap`: decode, find dots, track, label, fill, write C3D, head
motion, FAPs. Peers run on the same decoded pictures in the same run: OpenCV's SimpleBlobDetector
and trackpy's locate; accuracy stands beside time.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import trackpy
from numpy.typing import NDArray

from facewright.cli.evaluation import UNOCCLUDED, load_truth
from facewright.core.formats.c3d import read_c3d
from facewright.core.formats.fap import write_fap
from facewright.core.formats.markers_toml import read_marker_set
from facewright.core.formats.rig_json import read_rig
from facewright.core.video import probe_video, read_frames
from facewright.tracking.blobs import BlobSettings, find_blobs, find_level
from facewright.tracking.long_takes import track_long
from facewright.tracking.performance import analyse
from facewright.tracking.videos import track_videos, warm_up

PICTURES = 40  # a camera, for the peers
NEAR_PX = 3.0


def blob_detector(level: float) -> cv2.SimpleBlobDetector:
    """OpenCV's detector, set to the same level and sizes."""
    p = cv2.SimpleBlobDetector_Params()
    p.minThreshold, p.maxThreshold, p.thresholdStep = level, level + 60, 20
    p.minRepeatability, p.minDistBetweenBlobs = 1, 3
    p.filterByColor, p.blobColor = True, 255
    p.filterByArea, p.minArea, p.maxArea = True, 6, 2500
    p.filterByCircularity = p.filterByConvexity = p.filterByInertia = False
    return cv2.SimpleBlobDetector_create(p)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("takes", type=Path, nargs="+", metavar="TAKE_DIR")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, "
          f"OpenCV {cv2.__version__}, trackpy {trackpy.__version__}")  # fmt: skip
    warm_up()
    print("\n| take | Mbit/s a camera | camera frames | videos to .fap, camera frames/s "
          "| of bare decoding % | tracking alone | bare decoding, one after another |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for take in options.takes:
        time_take(take, options.repeats)
    videos, truth = videos_of(options.takes[0]), load_truth(options.takes[0] / "truth.npz")
    compare(videos, truth)


def videos_of(take: Path) -> list[Path]:
    """The videos of a take's cameras."""
    rig = read_rig(take / "rig.json")
    return sorted(p for p in take.iterdir() if p.stem in rig.cameras)


def time_take(take: Path, repeats: int) -> None:
    """One row: the medians."""
    videos, rig = videos_of(take), read_rig(take / "rig.json")
    marker_set = read_marker_set(take / "markers.toml")
    mbit_s = [p.stat().st_size * 8e-6 / probe_video(p).duration_s for p in videos]
    n = 0

    def whole() -> None:
        nonlocal n
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "markers.c3d"
            n = track_long(videos, rig, out, marker_set=marker_set).n_frames * len(videos)
            performance = analyse(read_c3d(out), marker_set)
            write_fap(Path(scratch) / "performance.fap", performance.faps)

    def tracking() -> None:
        track_videos(videos, rig)

    def bare() -> None:
        for path in videos:
            with closing(read_frames(path, gray=True)) as frames:
                for _frame in frames:
                    pass

    whole()  # compiles what is left, and makes what is kept of the marker set
    rates = []
    for work in (whole, tracking, bare):
        times = []
        for _ in range(repeats):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        rates.append(n / float(np.median(times)))
    print(f"| {take.name} | {np.mean(mbit_s):.1f} | {n} | {rates[0]:.0f} "
          f"| {100 * rates[0] / rates[2]:.0f} | {rates[1]:.0f} | {rates[2]:.0f} |",
          flush=True)  # fmt: skip


def compare(videos: list[Path], truth: dict[str, NDArray[np.generic]]) -> None:
    """Dot finders on the same pictures: time, error, how many of the visible dots were found."""
    names = [str(x) for x in truth["camera_names"]]
    images, centres = [], []
    for path in videos:
        step = max(1, len(truth["time_s"]) // PICTURES)
        c = names.index(path.stem)
        with closing(read_frames(path, gray=True)) as frames:
            for frame in frames:
                if frame.index % step == 0:
                    images.append(np.ascontiguousarray(frame.image))
                    seen = truth["marker_visible"][frame.index, c] >= UNOCCLUDED
                    centres.append(truth["marker_pixels"][frame.index, c][seen])
    level = find_level(images[0])
    settings, detector = BlobSettings(level), blob_detector(level)

    def opencv(image: NDArray[np.uint8]) -> NDArray[np.float64]:
        return np.array([k.pt for k in detector.detect(image)]).reshape(-1, 2)

    def tracked(image: NDArray[np.uint8]) -> NDArray[np.float64]:
        found = trackpy.locate(image, 9, minmass=600, threshold=level / 2, engine="numba")
        return np.asarray(found[["x", "y"]])

    finders: dict[str, Callable[[NDArray[np.uint8]], NDArray[np.float64]]] = {
        "facewright find_blobs": lambda image: find_blobs(image, settings).centres,
        "OpenCV SimpleBlobDetector": opencv,
        "trackpy locate": tracked,
    }
    print(
        "\n| dot finder, one thread | pictures/s | centre RMS px | visible dots found % | false |"
    )
    print("| --- | --- | --- | --- | --- |")
    cv2.setNumThreads(1)
    for name, find in finders.items():
        find(images[0])
        start = time.perf_counter()
        found = [find(image) for image in images]
        rate = len(images) / (time.perf_counter() - start)
        squares, hits, total, false = [], 0, 0, 0
        for f, t in zip(found, centres, strict=True):
            d = np.linalg.norm(f[None] - t[:, None], axis=2) if len(f) else np.zeros((len(t), 0))
            near = d.min(axis=1) < NEAR_PX if len(f) else np.zeros(len(t), bool)
            squares.append(d.min(axis=1)[near] ** 2 if len(f) else np.zeros(0))
            hits, total = hits + int(near.sum()), total + len(t)
            false += int((d.min(axis=0) > NEAR_PX).sum()) if len(f) else 0
        rms = float(np.sqrt(np.concatenate(squares).mean()))
        print(f"| {name} | {rate:.0f} | {rms:.3f} | {100 * hits / total:.1f} | {false} |")


if __name__ == "__main__":
    main()
