"""From labelled trajectories to head motion and FAPs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.markers import MarkerSet
from ..core.mpeg4 import Fapu, displacement_faps, fap_table, rotation_faps
from ..core.rigid import quaternion_from_rotation
from ..core.trajectories import Trajectories
from .face_units import estimate_fapu as estimate_fapu
from .face_units import estimate_units
from .high_level_faps import high_level_faps
from .neutral_face import STILL_MM as STILL_MM
from .neutral_face import WORLD_AXES_WITHIN_RAD as WORLD_AXES_WITHIN_RAD
from .neutral_face import Neutral as Neutral
from .neutral_face import find_neutral
from .rigid_fit import Floats, linear_rotation
from .skin_points import LIP_APPROXIMATIONS as LIP_APPROXIMATIONS
from .skin_points import point_rules, skin_displacements, stand_ins
from .skull_motion import SkullMotion, estimate_skull_motion


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
        Robust, smoothed, with covariance (`skull_motion`).
    head_motion_linear : HeadMotion
        By the linear method of Kshirsagar et al., not filtered, for comparison; only with exactly
        three head markers, else None.
    faps : Clip
        Channels of all FAPs that the set observes; not set where a marker was not seen.
    approximated : tuple of str
        Names of FAPs that stand in for ones not observed (inner lip after outer).
    fapu_sd_mm : mapping from unit to mm, or None
        Standard deviations of estimated units' errors; None for measured ones.
    skull : SkullMotion or None
        How the head motion was found: which markers, how much each wobbled.
    """

    neutral: Neutral
    fapu: Fapu
    fapu_source: str
    head_motion: HeadMotion
    head_motion_linear: HeadMotion | None
    faps: Clip
    approximated: tuple[str, ...]
    fapu_sd_mm: dict[str, float] | None = None
    skull: SkullMotion | None = None


def analyse(
    trajectories: Trajectories,
    marker_set: MarkerSet,
    *,
    neutral_frame: int = 0,
    axes: str = "auto",
    point_offsets: bool = True,
    high_level: bool = False,
) -> TrackedPerformance:
    """Head motion and FAPs of labelled trajectories.

    The head frame is that of the neutral face. MPEG-4 lets its axes be the world's; that is taken
    if the face looks along the world's +z within 20°, else the axes are those of the average head
    laid over the neutral markers (`axes` = ``"auto"``; ``"world"`` or ``"face"`` force one). The
    origin is between the eyes of that average head. FAPs are the skin's: where the set's markers
    stand off it, the skin below is found first.

    Parameters
    ----------
    trajectories : Trajectories
        mm; names are the marker set's labels; others are ignored.
    marker_set : MarkerSet
    neutral_frame : int
    axes : str
    point_offsets : bool
        Correct for where markers are glued beside their feature points, and for inner lips moving
        unlike outer ones (`skin_points`). False takes each marker's displacement as its point's,
        and the outer lips' as the inner ones', as Kshirsagar et al. do.
    high_level : bool
        Add FAPs 1 and 2, the nearest mix of visemes and expressions (`high_level_faps`).

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
    neutral = find_neutral(trajectories, marker_set, neutral_frame, axes)
    is_rigid = np.array([m.is_rigid for m in marker_set.markers])
    skull = estimate_skull_motion(
        trajectories.time_s,
        trajectories.positions,
        neutral.positions,
        is_rigid,
        trajectories.covariances,
    )
    fapu, sd = marker_set.fapu, None
    if fapu is None:
        units = estimate_units(neutral.positions, marker_set)
        fapu, sd = units.fapu, dict(units.sd_mm)
    moved = skull.motion.head_from_world(trajectories.positions) - neutral.positions
    moved = skin_displacements(moved, marker_set)
    faps, approximated = _faps(moved, marker_set, neutral, skull.motion, fapu, point_offsets)
    if high_level:
        faps = _joined(high_level_faps(faps, fapu), faps)
    return TrackedPerformance(
        neutral,
        fapu,
        "estimated" if sd else "measured",
        skull.motion,
        _linear_motion(trajectories, neutral, is_rigid),
        faps,
        approximated,
        sd,
        skull,
    )


def _only_set(trajectories: Trajectories, marker_set: MarkerSet) -> Trajectories:
    """The set's markers, in its order; NaN for those the trajectories lack."""
    T, M = len(trajectories.time_s), len(marker_set.labels)
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
    positions = np.full((T, M, 3), np.nan)
    source = np.zeros((T, M), np.uint8)
    covariances = None
    if trajectories.covariances is not None:
        covariances = np.full((T, M, 3, 3), np.nan)
    for m, label in enumerate(marker_set.labels):
        if label in known:
            row = trajectories.names.index(label)
            positions[:, m] = trajectories.positions[:, row]
            source[:, m] = trajectories.source[:, row]
            if covariances is not None and trajectories.covariances is not None:
                covariances[:, m] = trajectories.covariances[:, row]
    return Trajectories(trajectories.time_s, marker_set.labels, positions, covariances, source)


def _linear_motion(
    trajectories: Trajectories, neutral: Neutral, is_rigid: NDArray[np.bool_]
) -> HeadMotion | None:
    if is_rigid.sum() != 3:
        return None
    R, t = linear_rotation(neutral.positions[is_rigid], trajectories.positions[:, is_rigid])
    return HeadMotion(trajectories.time_s, quaternion_from_rotation(_nearest_rotation(R)), t)


def _nearest_rotation(R: Floats) -> Floats:
    found = np.full_like(R, np.nan)
    known = ~np.isnan(R).any(axis=(1, 2))
    U, _, Vt = np.linalg.svd(R[known])
    found[known] = U @ Vt
    return found


def _faps(
    moved: Floats,
    marker_set: MarkerSet,
    neutral: Neutral,
    motion: HeadMotion,
    fapu: Fapu,
    point_offsets: bool,
) -> tuple[Clip, tuple[str, ...]]:
    """FAPs of markers' displacements (T, M, 3) mm, and the names of those that stand in."""
    by_label = {
        label: moved[:, m]
        for m, label in enumerate(marker_set.labels)
        if not np.isnan(moved[:, m]).all()
    }
    stands = {fp: n for fp, n in stand_ins(marker_set).items() if n in by_label}
    points = {fp: by_label[label] for fp, label in stands.items()}
    if point_offsets:
        rules = point_rules(marker_set)
        points |= {fp: rules[fp].apply(by_label) for fp in stands if fp in rules}
    own = marker_set.label_by_feature_point
    channels = displacement_faps(points, fapu)
    approximated = displacement_faps({fp: d for fp, d in points.items() if fp not in own}, fapu)
    angles = rotation_faps(neutral.rotation.T @ motion.rotation)
    channels |= {fap.name: angles[:, i] for i, fap in enumerate(fap_table()[47:50])}
    order = [fap.name for fap in fap_table() if fap.name in channels]
    values = np.stack([channels[n] for n in order], axis=1)
    return Clip(motion.time_s, tuple(order), values), tuple(approximated)


def _joined(first: Clip, second: Clip) -> Clip:
    values = np.concatenate([first.values, second.values], axis=1)
    return Clip(first.time_s, (*first.channels, *second.channels), values)
