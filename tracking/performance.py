"""From labelled trajectories to head motion and FAPs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.markers import MarkerSet
from ..core.mpeg4 import Fapu, displacement_faps, fap_table, rotation_faps
from ..core.rigid import quaternion_from_rotation, rotation_from_quaternion
from ..core.trajectories import Trajectories
from ..heads.identity import Identity, make_head
from .labelling import template_positions
from .rigid_fit import fit_rigid, fit_similarity, linear_rotation

#: Frames around the neutral one are averaged while nine in ten markers stay this close to it.
STILL_MM = 0.25
MAX_NEUTRAL_FRAMES = 15
#: Up to this angle between the face and the world's axes, the world's are taken as the head's.
WORLD_AXES_WITHIN_RAD = np.deg2rad(20.0)
#: Heads turn slowly: above this frequency the motion of the skull is noise.
HEAD_CUTOFF_HZ = 8.0

#: FAPs of the inner lip that take the outer lip's displacement (Kshirsagar et al. 2000, section
#: 4: markers on the inner contour would touch). Feature point → the one that stands for it.
LIP_APPROXIMATIONS = {
    "2.2": "8.1",
    "2.3": "8.2",
    "2.4": "8.3",
    "2.5": "8.4",
    "2.6": "8.5",
    "2.7": "8.6",
    "2.8": "8.7",
    "2.9": "8.8",
}


@dataclass(frozen=True, eq=False)
class Neutral:
    """The neutral face as the markers show it.

    Attributes
    ----------
    frames : (n,) int
        The frames averaged.
    positions : (M, 3) float64, mm, head frame
        NaN where a marker was not seen.
    world_from_head : (3, 3), (3,)
        Where the head is in the neutral frame.
    axes : str
        ``"world"`` or ``"face"``: whose axes the head frame has.
    face_angle_rad : float
        Between the world's axes and those of the average head laid over the markers.
    """

    frames: NDArray[np.int64]
    positions: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    axes: str
    face_angle_rad: float


@dataclass(frozen=True, eq=False)
class TrackedPerformance:
    """What the markers say.

    Attributes
    ----------
    neutral : Neutral
    fapu : Fapu
    fapu_source : str
        ``"measured"`` (given with the marker set) or ``"estimated"`` (from the markers).
    head_motion : HeadMotion
        By least squares over the head markers, low-passed without lag.
    head_motion_linear : HeadMotion
        By the linear method of Kshirsagar et al., not filtered, for comparison; only with exactly
        three head markers, else None.
    faps : Clip
        Channels of all FAPs that the set observes; not set where a marker was not seen.
    approximated : tuple of str
        Names of FAPs that stand in for ones not observed (inner lip after outer).
    """

    neutral: Neutral
    fapu: Fapu
    fapu_source: str
    head_motion: HeadMotion
    head_motion_linear: HeadMotion | None
    faps: Clip
    approximated: tuple[str, ...]


def analyse(
    trajectories: Trajectories,
    marker_set: MarkerSet,
    *,
    neutral_frame: int = 0,
    axes: str = "auto",
) -> TrackedPerformance:
    """Head motion and FAPs of labelled trajectories.

    The head frame is that of the neutral face. MPEG-4 lets its axes be the world's; that is taken
    if the face looks along the world's +z within 20°, else the axes are those of the average head
    laid over the neutral markers (`axes` = ``"auto"``; ``"world"`` or ``"face"`` force one). The
    origin is between the eyes of that average head.

    Parameters
    ----------
    trajectories : Trajectories
        mm; names are the marker set's labels; others are ignored.
    marker_set : MarkerSet
    neutral_frame : int
    axes : str

    Raises
    ------
    InputError
        If head markers or all face markers are missing in the neutral frame, or the frame is
        outside the take.
    """
    T = len(trajectories.time_s)
    if not 0 <= neutral_frame < T:
        raise InputError(f"the neutral frame {neutral_frame} is outside the take of {T} frames")
    trajectories = _only_set(trajectories, marker_set)
    neutral = _neutral(trajectories, marker_set, neutral_frame, axes)
    head = [i for i, m in enumerate(marker_set.markers) if m.is_rigid]
    R, t = fit_rigid(neutral.positions[head], trajectories.positions[:, head])
    motion = _low_passed(HeadMotion(trajectories.time_s, quaternion_from_rotation(R), t), neutral)
    linear = None
    if len(head) == 3:
        R_lin, t_lin = linear_rotation(neutral.positions[head], trajectories.positions[:, head])
        linear = HeadMotion(
            trajectories.time_s, quaternion_from_rotation(_nearest_rotation(R_lin)), t_lin
        )
    fapu = marker_set.fapu or estimate_fapu(neutral.positions, marker_set)
    faps, approximated = _faps(trajectories, marker_set, neutral, motion, fapu)
    source = "measured" if marker_set.fapu else "estimated"
    return TrackedPerformance(neutral, fapu, source, motion, linear, faps, approximated)


def _only_set(trajectories: Trajectories, marker_set: MarkerSet) -> Trajectories:
    """The set's markers, in its order; NaN for those the trajectories lack."""
    T = len(trajectories.time_s)
    known = set(trajectories.names)
    if not known & set(marker_set.labels):
        raise InputError(
            f"none of the trajectories' names ({', '.join(trajectories.names[:4])}, …) is a label "
            f"of marker set {marker_set.name} ({', '.join(marker_set.labels[:4])}, …)"
        )
    absent = [label for label in marker_set.head_labels if label not in known]
    if absent:
        raise InputError(
            f"no trajectory is named {' or '.join(absent)}, which marker set {marker_set.name} "
            "needs for the head's motion"
        )
    positions = np.full((T, len(marker_set.labels), 3), np.nan)
    source = np.zeros((T, len(marker_set.labels)), np.uint8)
    for m, label in enumerate(marker_set.labels):
        if label in known:
            row = trajectories.names.index(label)
            positions[:, m] = trajectories.positions[:, row]
            source[:, m] = trajectories.source[:, row]
    return Trajectories(trajectories.time_s, marker_set.labels, positions, source=source)


def _neutral(trajectories: Trajectories, marker_set: MarkerSet, frame: int, axes: str) -> Neutral:
    p = trajectories.positions
    frames = _still_frames(p, frame)
    mean = np.array([_mean_known(p[frames, m]) for m in range(p.shape[1])])
    unseen = {label for label, q in zip(marker_set.labels, mean, strict=True) if np.isnan(q[0])}
    missing = [label for label in marker_set.head_labels if label in unseen]
    if missing:
        raise InputError(
            f"head markers {', '.join(missing)} are not visible in the neutral frame {frame}: "
            "choose another one with --neutral"
        )
    if unseen >= set(marker_set.label_by_feature_point.values()):
        raise InputError(
            f"no face markers are visible in the neutral frame {frame}: choose another one with "
            "--neutral"
        )
    R, t, angle = _head_axes(mean, marker_set)
    if axes not in ("auto", "world", "face"):
        raise ValueError(f'axes must be "auto", "world" or "face", not {axes!r}')
    use_world = axes == "world" or (axes == "auto" and angle <= WORLD_AXES_WITHIN_RAD)
    R = np.eye(3) if use_world else R
    positions = (mean - t) @ R
    return Neutral(frames, positions, R, t, "world" if use_world else "face", angle)


def _row(marker_set: MarkerSet, label: str) -> int:
    return marker_set.labels.index(label)


def _mean_known(p: NDArray[np.float64]) -> NDArray[np.float64]:
    known = p[~np.isnan(p[:, 0])]
    return known.mean(axis=0) if len(known) else np.full(3, np.nan)


def _still_frames(p: NDArray[np.float64], frame: int) -> NDArray[np.int64]:
    """The longest run of frames around one (at most 15) in which the markers keep their places."""

    def still(other: int) -> bool:
        distance = np.linalg.norm(p[other] - p[frame], axis=1)
        known = distance[~np.isnan(distance)]
        return bool(len(known)) and bool(np.percentile(known, 90) < STILL_MM)

    first = last = frame
    while last - first + 1 < MAX_NEUTRAL_FRAMES:
        if last + 1 < len(p) and still(last + 1):
            last += 1
        elif first > 0 and still(first - 1):
            first -= 1
        else:
            break
    return np.arange(first, last + 1)


def _head_axes(
    positions: NDArray[np.float64], marker_set: MarkerSet
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Average head → neutral markers: rotation, translation, angle from the world's axes."""
    template = template_positions(marker_set)
    seen = ~np.isnan(positions[:, 0])
    if seen.sum() < 3:
        raise InputError("fewer than three markers are visible in the neutral frame")
    _, R, t = fit_similarity(template[seen], positions[seen])
    angle = float(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    return R, t, angle


def estimate_fapu(neutral: NDArray[np.float64], marker_set: MarkerSet) -> Fapu:
    """Units of a face of which only the markers are known.

    The average head is adapted to the neutral markers by an affine map; distances between points
    that no marker shows (pupils, base of the nose, inner lip, lid edges) are taken from it,
    distances between markers are measured.

    Parameters
    ----------
    neutral : (M, 3) float64, mm, head frame
        NaN where a marker is missing.
    marker_set : MarkerSet
    """
    head = make_head(Identity("average"))
    template = template_positions(marker_set)
    seen = ~np.isnan(neutral[:, 0])
    if seen.sum() < 8:
        raise InputError(
            "too few markers in the neutral frame to estimate the face's units: give them in the "
            "marker set ([fapu] irisd, es, ens, mns, mw in mm)"
        )
    A = np.column_stack([template[seen], np.ones(int(seen.sum()))])
    M, *_ = np.linalg.lstsq(A, neutral[seen], rcond=None)
    points = {n: np.append(p, 1.0) @ M for n, p in head.points.items()}
    labels = marker_set.label_by_feature_point
    for fp in ("8.3", "8.4"):
        row = _row(marker_set, labels[fp]) if fp in labels else None
        if row is not None and seen[row]:
            # the marker is glued beside the corner: what it is off by, the corner is too
            points[fp] = points[fp] + neutral[row] - np.append(template[row], 1.0) @ M
    return Fapu.from_points(points)


def _low_passed(motion: HeadMotion, neutral: Neutral) -> HeadMotion:
    """Zero-phase low-pass of rotation and of the motion of a point amid the head markers.

    Runs between unknown frames are filtered by themselves; short runs stay as they are.
    """
    rate = motion.rate_hz
    if rate is None or rate <= 2.5 * HEAD_CUTOFF_HZ:
        return motion
    sos = butter(2, HEAD_CUTOFF_HZ, fs=rate, output="sos")
    q = np.array(motion.quaternion)
    for i in range(1, len(q)):
        if (q[i] * q[i - 1]).sum() < 0:
            q[i] = -q[i]
    # filtering the middle of the head, not the far origin, keeps rotation noise out of it
    pivot = np.nanmean(neutral.positions, axis=0)
    middle = motion.world_from_head(pivot[None])[:, 0]
    values = np.concatenate([q, middle], axis=1)
    known = ~np.isnan(values[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if end - first > 18:
            values[first:end] = sosfiltfilt(sos, values[first:end], axis=0)
    with np.errstate(invalid="ignore"):
        q = values[:, :4] / np.linalg.norm(values[:, :4], axis=1, keepdims=True)
    t = values[:, 4:] - np.einsum("tij,j->ti", rotation_from_quaternion(q), pivot)
    return HeadMotion(motion.time_s, q, t)


def _nearest_rotation(R: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.full_like(R, np.nan)
    known = ~np.isnan(R).any(axis=(1, 2))
    U, _, Vt = np.linalg.svd(R[known])
    found[known] = U @ Vt
    return found


def _faps(
    trajectories: Trajectories,
    marker_set: MarkerSet,
    neutral: Neutral,
    motion: HeadMotion,
    fapu: Fapu,
) -> tuple[Clip, tuple[str, ...]]:
    in_head = motion.head_from_world(trajectories.positions)
    moved = {
        fp: in_head[:, _row(marker_set, label)] - neutral.positions[_row(marker_set, label)]
        for fp, label in marker_set.label_by_feature_point.items()
    }
    moved = {fp: d for fp, d in moved.items() if not np.isnan(d).all()}
    measured = displacement_faps(moved, fapu)
    stand_ins = {
        inner: moved[outer]
        for inner, outer in LIP_APPROXIMATIONS.items()
        if outer in moved and inner not in moved
    }
    approximated = displacement_faps(stand_ins, fapu)
    angles = rotation_faps(neutral.rotation.T @ motion.rotation)
    channels = {**measured, **approximated}
    channels |= {fap.name: angles[:, i] for i, fap in enumerate(fap_table()[47:50])}
    order = [fap.name for fap in fap_table() if fap.name in channels]
    values = np.stack([channels[n] for n in order], axis=1)
    return Clip(trajectories.time_s, tuple(order), values), tuple(approximated)
