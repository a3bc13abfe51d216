"""How `tracking/data/landmark_noise.npz` came about: faces drawn by us, as the network sees them.

    python benchmarks/learn_landmark_noise.py draw --out FOLDER [--first 7000] [--people 70]
    python benchmarks/learn_landmark_noise.py lean TAKES... --out lean.csv
    python benchmarks/learn_landmark_noise.py learn FOLDER --lean lean.csv \\
        --out tracking/data/landmark_noise.npz

Everybody is drawn with a neutral face from some sides, then acting: moments of a performance and
shapes mixed by chance, any light, any side up to 35 degrees. What the network says is kept beside
what is true. `lean` compares the tracker's landmarks of plain takes (``facewright synth take --kind
plain``) with the network's (`tracking.tracked_lean`). `learn` fits the measurement model
(`tracking.landmark_noise`). What comes with the package was learnt with the table beside this
script, measured on the takes of seeds 500 to 509 (4 s, one camera).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from markerless import network_tracks
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.camera import Camera
from facewright.core.files import atomic_path
from facewright.core.formats.rig_json import read_rig
from facewright.core.rigid import Rigid, rotation_from_quaternion
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.performances import random_performance
from facewright.datasets_synthetic.take_settings import read_take_settings
from facewright.datasets_synthetic.takes import make_take
from facewright.heads.face_finder import FaceFinder
from facewright.heads.face_landmarks import FaceRegion
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.place_face_landmarks import template_face_landmarks
from facewright.heads.render import HeadRenderer
from facewright.heads.stage_lights import StageLights
from facewright.tracking.face_fit import landmark_shapes
from facewright.tracking.face_following import track_landmarks
from facewright.tracking.landmark_noise import write_landmark_model
from facewright.tracking.landmark_tracks import LandmarkTracks
from facewright.tracking.learn_correction import with_correction
from facewright.tracking.learn_landmark_noise import equations, joined, learn
from facewright.tracking.tracked_lean import (
    TrackedLean,
    as_tracked,
    measure_lean,
    read_tracked_lean,
    write_tracked_lean,
)

Floats = NDArray[np.float64]
SIDE_PX = 448
LEAN = Path(__file__).parent / "tracked_lean.csv"
N_STILL = 8  # frames that a take begins with, neutral
N_NEUTRAL, N_ACTING, N_MIXED = 8, 36, 20
TURN_DEG = {"neutral": (8.0, 6.0, 5.0), "acting": (14.0, 10.0, 8.0)}  # sd of yaw, pitch, roll
MOST_DEG = 35.0
YEARS = (16.0, 75.0)
NOISE_LEVELS, JPEG_QUALITY = (0.5, 4.0), (70, 96)


def mixed_weights(rng: np.random.Generator, n_shapes: int) -> Floats:
    """A few shapes at any strength."""
    w = np.zeros(n_shapes)
    chosen = rng.choice(n_shapes, size=int(rng.integers(1, 6)), replace=False)
    w[chosen] = rng.uniform(0, 0.9, size=len(chosen))
    return w


def weights_to_draw(rng: np.random.Generator, head: Head) -> Floats:
    """(N, 52): neutral ones first."""
    acted = random_performance(rng, head, seconds=40.0, rate_hz=30.0).weights.values
    some = np.sort(rng.choice(len(acted), N_ACTING, replace=False))
    mixed = [mixed_weights(rng, len(head.shape_names)) for _ in range(N_MIXED)]
    return np.concatenate([np.zeros((N_NEUTRAL, acted.shape[1])), acted[some], mixed])


def random_camera(rng: np.random.Generator, size_mm: float) -> Camera:
    """A camera before the face: any distance, the face filling much of the picture."""
    distance = float(rng.uniform(450, 1300))
    focal = SIDE_PX * rng.uniform(0.52, 0.7) * distance / size_mm
    middle = (SIDE_PX - 1) / 2
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    return Camera(
        (SIDE_PX, SIDE_PX),
        K,
        camera_from_world=Rigid(np.array([0.0, 1, 0, 0]), np.array([0.0, -30.0, distance])),
    )


def random_turn(rng: np.random.Generator, kind: str) -> Rigid:
    """World from head."""
    angles = np.clip(rng.normal(0, TURN_DEG[kind]), -MOST_DEG, MOST_DEG)
    R = Rotation.from_euler("YXZ", angles, degrees=True).as_matrix()
    return Rigid.from_rotation(R, rng.normal(0, 8, 3))


def degraded(rng: np.random.Generator, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Noise and a codec."""
    soft = cv2.GaussianBlur(picture, (0, 0), float(rng.uniform(0.3, 1.0)))
    noisy = soft + rng.normal(0, rng.uniform(*NOISE_LEVELS), picture.shape)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*JPEG_QUALITY))]
    _, coded = cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), quality)
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.uint8)


def draw_person(seed: int, finder: FaceFinder) -> dict[str, NDArray[np.generic]]:
    """One person's samples."""
    rng = np.random.default_rng(seed)
    head = make_head(random_identity(rng, age_years=YEARS), texture_px=512)
    motion, marks = FaceMotion(head), template_face_landmarks()
    lights = StageLights.random(rng)
    background = tuple(float(x) for x in rng.uniform(20, 220, 3))
    renderer = HeadRenderer(head, background=background, lights=lights, quick=True)  # type: ignore[arg-type]
    weights = weights_to_draw(rng, head)
    rows: dict[str, list[NDArray[np.generic]]] = {}
    for i, w in enumerate(weights):
        camera = random_camera(rng, 190.0)
        pose = random_turn(rng, "neutral" if i < N_NEUTRAL else "acting")
        vertices = motion.vertices(w)
        picture = degraded(rng, renderer.render(vertices, camera, pose))
        true = marks.at(vertices)
        shown = np.full((478, 2), np.nan)
        shown[[int(n) for n in marks.names]] = camera.project(pose.apply(true))
        shown = np.where(np.isnan(shown), np.nanmean(shown, axis=0), shown)
        face = finder.follow(picture, FaceRegion.of_landmarks(shown))
        face = None if face is None else finder.follow(picture, face.region)
        if face is None:
            continue
        view = camera.camera_from_world @ pose
        here = {
            "weights": w, "landmarks_px": face.landmarks_px[:, :2], "scores": finder.scores(face),
            "presence": np.array(face.presence), "focal_px": np.array(camera.matrix[0, 0]),
            "rotation": view.rotation, "translation": view.translation,
            "points": head.feature_points.at(vertices), "marks": true, "gaze": motion.gaze(w),
            "jaw": motion.jaw_pose(w).rotation, "is_neutral": np.array(i < N_NEUTRAL),
        }  # fmt: skip
        for name, value in here.items():
            rows.setdefault(name, []).append(value)
    found = {name: np.stack(values) for name, values in rows.items()}
    found["rest_points"] = head.feature_points.at(head.mesh.vertices)
    found["rest_marks"] = marks.at(head.mesh.vertices)
    found["vertices"] = head.mesh.vertices
    return found


def draw(folder: Path, first: int, people: int) -> None:
    """Draw people that are not there yet."""
    finder = FaceFinder()
    for seed in range(first, first + people):
        path = folder / f"person_{seed}.npz"
        if not path.exists():
            np.savez_compressed(path, **draw_person(seed, finder))  # type: ignore[arg-type]
            print(path.name, flush=True)


def write_learnt(folder: Path, lean: TrackedLean, out: Path) -> None:
    """Learn from all people of a folder."""
    drawn = []
    for path in sorted(folder.glob("person_*.npz")):
        with np.load(path, allow_pickle=False) as z:
            drawn.append({name: z[name] for name in z.files})
    rng = np.random.default_rng(0)
    model = learn(as_tracked(joined(drawn, SIDE_PX), lean, rng))
    people = [as_tracked(joined([person], SIDE_PX), lean, rng) for person in drawn]
    model = with_correction(model, people, N_NEUTRAL, N_ACTING)
    with atomic_path(out) as part, open(part, "wb") as stream:
        write_landmark_model(stream, model)
    error = np.sqrt(model.sd**2 + (model.modes**2).sum(axis=0))
    print(f"{len(people)} people; error of a coordinate {np.median(error):.2f} mm, "
          f"of a person's {np.median(model.person_sd):.2f} mm")  # fmt: skip


def write_lean(takes: list[Path], out: Path) -> None:
    """Measure the lean that the tracker leaves, on takes with one camera."""
    finder, network, tracked = FaceFinder(), [], []
    for folder in takes:
        rig = read_rig(folder / "rig.json")
        video = next(folder.glob(f"{rig.names[0]}.m*"))
        both = network_tracks(video, finder), track_landmarks(video, finder=finder)
        errors = [landmark_errors(folder, tracks, rig[rig.names[0]]) for tracks in both]
        network.append(errors[0])
        tracked.append(errors[1])
        print(folder, flush=True)
    numbers = np.array([int(n) for n in template_face_landmarks().names])
    write_tracked_lean(out, measure_lean(numbers, landmark_shapes()[0], network, tracked))


def landmark_errors(folder: Path, tracks: LandmarkTracks, camera: Camera) -> Floats:
    """Errors (T, n, 2) mm of a take's landmarks, less those of its first, neutral frames."""
    settings, seed = read_take_settings(folder / "take.toml")
    assert seed is not None
    motion, marks = FaceMotion(make_take(seed, settings).head), template_face_landmarks()
    with np.load(folder / "truth.npz", allow_pickle=False) as z:
        weights, q, t = (z[n] for n in ("arkit_weights", "head_quaternion", "head_translation"))
    true = np.stack([marks.at(motion.vertices(w)) for w in weights])
    pose = camera.camera_from_world
    R = pose.rotation @ rotation_from_quaternion(q)
    xy = camera.undistort(tracks.points_px[:, [int(n) for n in marks.names]])
    _, error = equations(R, t @ pose.rotation.T + pose.translation, xy, true)
    return np.asarray(error - error[:N_STILL].mean(axis=0))


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("--out", type=Path, required=True)
    drawing.add_argument("--first", type=int, default=7000)
    drawing.add_argument("--people", type=int, default=70)
    learning = commands.add_parser("learn")
    learning.add_argument("folder", type=Path)
    learning.add_argument("--lean", type=Path, default=LEAN)
    learning.add_argument("--out", type=Path, required=True)
    leaning = commands.add_parser("lean")
    leaning.add_argument("takes", type=Path, nargs="+")
    leaning.add_argument("--out", type=Path, default=LEAN)
    options = parser.parse_args()
    if options.command == "draw":
        options.out.mkdir(parents=True, exist_ok=True)
        draw(options.out, options.first, options.people)
    elif options.command == "lean":
        write_lean(options.takes, options.out)
    else:
        write_learnt(options.folder, read_tracked_lean(options.lean), options.out)


if __name__ == "__main__":
    main()
