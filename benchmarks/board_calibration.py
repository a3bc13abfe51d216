"""How well two cameras are calibrated from real pictures of a chessboard, and how fast.

    python benchmarks/board_calibration.py ../shared/data/real/chessboards [--repeats 5]

The folder holds leftNN and rightNN, 13 stereo pairs, 640x480, of a board with 9x6 inner corners
and squares of 25 mm. OpenCV's own path runs on the same pictures in the same run: its detector,
its corner refinement with the window of its samples (11) and with one of a third of the squares,
its calibration and its stereo calibration. Both sides estimate fx, fy, cx, cy and 5 coefficients.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facewright.capture.board_detection import detect_board
from facewright.capture.lens import BoardView, calibrate_board
from facewright.capture.rigs import calibrate_rig
from facewright.core.boards import Board, parse_board

SIDES = ("left", "right")
MODEL = "opencv5"
Pictures = dict[str, dict[str, NDArray[np.uint8]]]


@dataclass(frozen=True)
class Outcome:
    """One row of the table."""

    views: tuple[int, int]
    rms_px: tuple[float, float]
    stereo_px: float
    baseline_mm: float
    detection_s: float
    solution_s: float


def read_pictures(folder: Path) -> Pictures:
    """Pictures by side and number."""
    found: Pictures = {side: {} for side in SIDES}
    for side in SIDES:
        for path in sorted(folder.glob(f"{side}*.jpg")):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise SystemExit(f"{path}: no picture")
            found[side][path.stem.removeprefix(side)] = np.asarray(image, np.uint8)
        if not found[side]:
            raise SystemExit(f"{folder}: no {side}NN.jpg")
    return found


def ours(pictures: Pictures, board: Board) -> Outcome:
    """The way of `facewright calibrate rig`."""
    start = time.perf_counter()
    views: dict[str, list[BoardView]] = {}
    for side, images in pictures.items():
        found = [detect_board(image, board, name=name) for name, image in images.items()]
        views[side] = [d.view for d in found if d.view is not None]
    detected = time.perf_counter()
    size = next(iter(pictures["left"].values())).shape[::-1]
    lenses = {s: calibrate_board(views[s], (size[0], size[1]), model=MODEL) for s in SIDES}
    rig = calibrate_rig(
        views, {s: lenses[s].camera for s in SIDES}, refine=dict.fromkeys(SIDES, MODEL)
    )
    solved = time.perf_counter()
    left, right = (rig.rig[s].position for s in SIDES)
    return Outcome(
        (len(lenses["left"].views), len(lenses["right"].views)),
        (lenses["left"].rms_px, lenses["right"].rms_px),
        rig.rms_px,
        float(np.linalg.norm(left - right)),
        detected - start,
        solved - detected,
    )


def opencv(pictures: Pictures, board: Board, window: float) -> Outcome:
    """OpenCV's functions; `window` in pixels, or below 1 as a share of the smallest square."""
    start = time.perf_counter()
    points = board.object_points().astype(np.float32)
    size = (board.columns, board.rows)
    corners: dict[str, dict[str, NDArray[np.float32]]] = {side: {} for side in SIDES}
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.001)
    for side, images in pictures.items():
        for name, image in images.items():
            found, rough = cv2.findChessboardCorners(image, size)
            if not found:
                continue
            half = int(window) if window >= 1 else max(2, int(window * smallest_gap(rough, board)))
            fine = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), stop)
            corners[side][name] = fine.reshape(-1, 2)
    detected = time.perf_counter()
    shape = next(iter(pictures["left"].values())).shape[::-1]
    fits = [
        cv2.calibrateCamera([points] * len(c), list(c.values()), shape, None, None)
        for c in (corners[s] for s in SIDES)
    ]
    both = [n for n in corners["left"] if n in corners["right"]]
    stereo = cv2.stereoCalibrate(
        [points] * len(both), *([corners[s][n] for n in both] for s in SIDES),
        fits[0][1], fits[0][2], fits[1][1], fits[1][2], shape,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-6),
    )  # fmt: skip
    solved = time.perf_counter()
    return Outcome(
        (len(corners["left"]), len(corners["right"])),
        (float(fits[0][0]), float(fits[1][0])),
        float(stereo[0]),
        float(np.linalg.norm(stereo[6])),
        detected - start,
        solved - detected,
    )


def smallest_gap(rough: NDArray[np.float32], board: Board) -> float:
    """The smallest distance of neighbouring corners, px."""
    grid = rough.reshape(board.rows, board.columns, 2)
    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    return float(min(gaps))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    pictures = read_pictures(options.folder)
    board = parse_board("chessboard:9x6:25")
    ways: dict[str, Callable[[], Outcome]] = {
        "facewright": lambda: ours(pictures, board),
        "OpenCV, window 11": lambda: opencv(pictures, board, 11),
        "OpenCV, window 0.3 squares": lambda: opencv(pictures, board, 0.3),
    }
    print(f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, "
          f"OpenCV {cv2.__version__}; {len(pictures['left'])} pairs; medians of "
          f"{options.repeats} runs after one")  # fmt: skip
    print(
        "| way | views | left px | right px | stereo px | baseline mm "
        "| detection s | solution s |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for name, way in ways.items():
        way()
        runs = [way() for _ in range(options.repeats)]
        one = runs[0]
        seconds = np.median([(r.detection_s, r.solution_s) for r in runs], axis=0)
        print(f"| {name} | {one.views[0]} + {one.views[1]} | {one.rms_px[0]:.4f} "
              f"| {one.rms_px[1]:.4f} | {one.stereo_px:.4f} | {one.baseline_mm:.2f} "
              f"| {seconds[0]:.2f} | {seconds[1]:.2f} |")  # fmt: skip


if __name__ == "__main__":
    main()
