"""How far FAPs and head motion from plain video are off, and those of the network's scores.

    python benchmarks/markerless.py TAKES... [--out FILE.md] [--network] [--cache FOLDER]

TAKES are folders of plain takes as ``facewright synth take --kind plain`` writes them, with one
camera or several; ``strangeness`` in a take's settings makes an actor whom the fitter cannot
model, and such takes are reported apart. The peer in the same table: the network's own expression
scores taken as weights of the true head. ``--network`` takes the network's landmarks frame by
frame, without what the tracker adds. ``--cache`` keeps tracks, to try the analysis alone again: the
speed is then that of the analysis; otherwise it is from video to FAPs.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright import __version__
from facewright.core.formats.rig_json import read_rig
from facewright.core.mpeg4 import ANGLE_UNIT_RAD, Fapu, displacement_faps, fap_by_name
from facewright.core.rigid import rotation_from_quaternion
from facewright.core.video import read_frames
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.take_settings import read_take_settings
from facewright.datasets_synthetic.takes import make_take
from facewright.heads.face_finder import FaceFinder, FaceTracker
from facewright.heads.face_scores import SCORE_NAMES
from facewright.tracking.face_analysis import DEPTH_FAPS, FacePerformance, analyse_face
from facewright.tracking.face_following import track_landmarks
from facewright.tracking.landmark_tracks import LandmarkSource, LandmarkTracks

Floats = NDArray[np.float64]
Rows = dict[tuple[str, str, str], list[float]]
NETWORK_SD_PX = 0.3  # jitter that frames have of their own
LEAST_MM, LEAST_RAD = 3.0, np.deg2rad(3.0)
GROUPS = {
    "jaw": ("open_jaw", "shift_jaw", "depress_chin"), "lips": ("lip",), "lids": ("eyelid",),
    "brows": ("eyebrow",), "cheeks": ("cheek",), "gaze": ("eyeball",), "nose": ("nose",),
}  # fmt: skip


def network_tracks(video: Path, finder: FaceFinder) -> LandmarkTracks:
    """The network's landmarks of a video."""
    tracker = FaceTracker(finder)
    times, points, scores, presence = [], [], [], []
    for frame in read_frames(video):
        face = tracker.follow(frame.image)
        times.append(frame.time_s)
        points.append(np.full((478, 2), np.nan) if face is None else face.landmarks_px[:, :2])
        scores.append(np.full(len(SCORE_NAMES), np.nan) if face is None else finder.scores(face))
        presence.append(np.nan if face is None else face.presence)
    size = frame.image.shape[1], frame.image.shape[0]
    seen = np.isfinite(presence)
    sd = np.where(seen[:, None], NETWORK_SD_PX, np.nan) * np.ones(478)
    source = np.where(seen, LandmarkSource.NETWORK, LandmarkSource.MISSING)
    return LandmarkTracks(
        np.array(times), np.stack(points), sd, np.array(presence), source, size, np.stack(scores)
    )


def group_of(name: str) -> str:
    """The group of a FAP, "depth" before all others."""
    if name in DEPTH_FAPS:
        return "depth"
    words = ((g, w) for g, several in GROUPS.items() for w in several)
    return next((g for g, w in words if w in name), "other")


def errors(found: dict[str, Floats], truth: dict[str, NDArray[np.generic]]) -> dict[str, Floats]:
    """For each FAP: RMS error in per cent of its used range, correlation (NaN if it rests)."""
    fapu = Fapu(*(float(x) for x in np.asarray(truth["fapu"])))
    result = {}
    for name, values in found.items():
        fap = fap_by_name()[name]
        true = np.asarray(truth["faps"], dtype=np.float64)[:, fap.number - 1]
        unit = fapu.unit(fap)
        least = (LEAST_RAD if fap.fapu == "AU" else LEAST_MM) / unit
        span = float(np.percentile(true, 99) - np.percentile(true, 1))
        known = np.isfinite(values) & np.isfinite(true)
        off = float(np.sqrt(((values - true)[known] ** 2).mean()))
        moves = span > least / 2 and values[known].std() > 0
        r = float(np.corrcoef(values[known], true[known])[0, 1]) if moves else np.nan
        result[name] = np.array([100 * off / max(span, least), r])
    return result


def scores_as_weights(
    tracks: LandmarkTracks, motion: FaceMotion, still: NDArray[np.int64]
) -> dict[str, Floats]:
    """FAPs of the true head under the network's scores, those at rest taken off."""
    assert tracks.scores is not None
    head = motion.head
    scores = np.nan_to_num(tracks.scores - np.nanmean(tracks.scores[still], axis=0))
    weights = np.zeros((len(scores), len(head.shape_names)))
    for i, name in enumerate(head.shape_names):
        if name in SCORE_NAMES:
            weights[:, i] = np.clip(scores[:, SCORE_NAMES.index(name)], 0, 1)
    at = np.stack([head.feature_points.at(motion.vertices(w)) for w in weights])
    rest = head.feature_points.at(head.mesh.vertices)
    moved = {n: at[:, i] - rest[i] for i, n in enumerate(head.feature_points.names)}
    found = displacement_faps(moved, head.fapu)
    gaze = np.stack([motion.gaze(w) for w in weights]) / ANGLE_UNIT_RAD
    for k, axis in enumerate(("yaw", "pitch")):
        found[f"{axis}_r_eyeball"], found[f"{axis}_l_eyeball"] = gaze[:, 0, k], gaze[:, 1, k]
    return found


def rotation_error_deg(found: FacePerformance, truth: dict[str, NDArray[np.generic]]) -> float:
    """RMS of the head's turn from the neutral frame."""
    still = int(found.neutral_frames[0])
    R = found.head_motion.rotation
    true = rotation_from_quaternion(np.asarray(truth["head_quaternion"]))
    off = (R @ R[still].T) @ np.swapaxes(true @ true[still].T, 1, 2)
    known = np.isfinite(off).all(axis=(1, 2))
    return float(np.rad2deg(np.sqrt((Rotation.from_matrix(off[known]).magnitude() ** 2).mean())))


def landmarks(video: Path, finder: FaceFinder, network: bool, cache: Path | None) -> LandmarkTracks:
    """The face's landmarks in a video, from the cache if they are there."""
    name = f"{'network' if network else 'tracked'}-{'-'.join(video.resolve().parts[-3:])}.npz"
    kept = None if cache is None else cache / name
    if kept is not None and kept.exists():
        with np.load(kept, allow_pickle=False) as z:
            size = int(z["image_size"][0]), int(z["image_size"][1])
            arrays = {n: z[n] for n in z.files if n not in ("image_size", "cuts")}
            return LandmarkTracks(image_size=size, cuts=tuple(z["cuts"].tolist()), **arrays)
    tracks = network_tracks(video, finder) if network else track_landmarks(video, finder=finder)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        names = ("time_s", "points_px", "sd_px", "presence", "source", "scores", "iris_px")
        arrays = {n: getattr(tracks, n) for n in names if getattr(tracks, n) is not None}
        cuts = np.array(tracks.cuts, np.int64)
        np.savez(kept, image_size=np.array(tracks.image_size), cuts=cuts, **arrays)
    return tracks


def judge_take(
    folder: Path, finder: FaceFinder, rows: Rows, per_fap: Rows, network: bool, cache: Path | None
) -> None:
    """One take, with as many cameras as it has."""
    settings, seed = read_take_settings(folder / "take.toml")
    assert seed is not None
    with np.load(folder / "truth.npz", allow_pickle=False) as z:
        truth = {name: z[name] for name in z.files}
    rig = read_rig(folder / "rig.json")
    videos = [next(folder.glob(f"{name}.m*")) for name in rig]
    start = time.perf_counter()
    tracks = [landmarks(video, finder, network, cache) for video in videos]
    kind = f"{'strange' if settings.actor.strangeness else 'plain'}, {len(rig)} camera(s)"
    if len(rig) == 1:
        found = analyse_face(tracks[0], camera=rig[rig.names[0]])
    else:
        found = analyse_face(tracks, rig=rig)
    rows[kind, "speed", "frames/s"].append(len(truth["time_s"]) / (time.perf_counter() - start))
    rows[kind, "head rotation", "deg"].append(rotation_error_deg(found, truth))
    ours = errors({n: found.faps[n] for n in found.faps.channels}, truth)
    motion = FaceMotion(make_take(seed, settings, rig=rig).head)
    peer = errors(scores_as_weights(tracks[0], motion, found.neutral_frames), truth)
    for who, judged in (("ours", ours), ("scores", peer)):
        by_group = defaultdict(list)
        for name in ours:
            if name.startswith("head_"):
                continue
            by_group[group_of(name)].append(judged[name])
            per_fap[kind, name, who].append(float(judged[name][0]))
            per_fap[kind, name, f"{who}: r"].append(float(judged[name][1]))
        plane = np.concatenate([v for g, v in by_group.items() if g != "depth"])
        rows[kind, f"all in the image plane, {who}", "%"].append(float(np.median(plane[:, 0])))
        for group, values in by_group.items():
            rows[kind, f"{group}, {who}", "%"].append(float(np.median(np.array(values)[:, 0])))
            with np.errstate(all="ignore"):
                r = np.array(values)[:, 1]
            if np.isfinite(r).any():
                rows[kind, f"{group}, {who}: correlation", ""].append(float(np.nanmedian(r)))


def table(rows: Rows) -> list[str]:
    """Lines of Markdown."""
    lines = ["| takes | measured | unit | median | worst |", "| --- | --- | --- | --- | --- |"]
    for (kind, what, unit), values in rows.items():
        upwards = "correlation" in what or what == "speed"
        worst = np.nanmin(values) if upwards else np.nanmax(values)
        lines.append(f"| {kind} ({len(values)}) | {what} | {unit} | {np.nanmedian(values):.3g} | "
                     f"{worst:.3g} |")  # fmt: skip
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("takes", type=Path, nargs="+")
    parser.add_argument("--each", action="store_true", help="a line for every FAP, too")
    parser.add_argument("--network", action="store_true", help="landmarks of the network alone")
    parser.add_argument("--cache", type=Path, help="folder that keeps tracks")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: Rows = defaultdict(list)
    per_fap: Rows = defaultdict(list)
    finder = FaceFinder()
    for folder in options.takes:
        judge_take(folder, finder, rows, per_fap, options.network, options.cache)
        print(folder, flush=True)
    lines = [
        f"facewright {__version__}, {len(options.takes)} takes; {platform.machine()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}", "", *table(rows),
    ]  # fmt: skip
    if options.each:
        lines += ["", *table(per_fap)]
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
