"""How fast marker tracking is, decoding included, and its dot finder against peers.

    python benchmarks/tracking_speed.py TAKE_DIR [--repeats 5]

TAKE_DIR is a folder of `facewright synth take` (or demo). Peers run on the same decoded pictures
in the same run: OpenCV's SimpleBlobDetector and trackpy's locate; accuracy stands beside time.
"""

from __future__ import annotations

import argparse
import platform
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
from facewright.core.formats.rig_json import read_rig
from facewright.core.video import read_frames
from facewright.tracking.blobs import BlobSettings, find_blobs, find_level
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
    parser.add_argument("take", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    videos = sorted(options.take.glob("cam*.mp4"))
    rig, truth = read_rig(options.take / "rig.json"), load_truth(options.take / "truth.npz")
    warm_up()
    track_videos(videos, rig)
    n = len(truth["time_s"]) * len(videos)
    print(f"{platform.machine()}, Python {platform.python_version()}, OpenCV {cv2.__version__}, "
          f"trackpy {trackpy.__version__}; {n} camera frames, {len(videos)} cameras")  # fmt: skip
    rates, bare = [], []
    for _ in range(options.repeats):
        start = time.perf_counter()
        track_videos(videos, rig)
        rates.append(n / (time.perf_counter() - start))
        start = time.perf_counter()
        for path in videos:
            with closing(read_frames(path, gray=True)) as frames:
                for _frame in frames:
                    pass
        bare.append(n / (time.perf_counter() - start))
    print("| what | camera frames/s |\n| --- | --- |")
    print(f"| videos to trajectories, decoding included (median of {options.repeats}) "
          f"| {np.median(rates):.0f} |")  # fmt: skip
    print(f"| bare decoding of the same files, one after another | {np.median(bare):.0f} |")
    compare(videos, truth)


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
