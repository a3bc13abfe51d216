"""The neutral face in a take: which frames show it, where its head is, whose axes it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.markers import MarkerSet
from ..core.trajectories import Trajectories
from .face_variation import template_positions
from .rigid_fit import Floats, fit_similarity

#: Frames around the neutral one are averaged while nine in ten markers stay this close to it.
STILL_MM = 0.25
MAX_NEUTRAL_FRAMES = 15
#: Up to this angle between the face and the world's axes, the world's are taken as the head's.
WORLD_AXES_WITHIN_RAD = np.deg2rad(20.0)


@dataclass(frozen=True, eq=False)
class Neutral:
    """The neutral face as the markers show it.

    Attributes
    ----------
    frames : (n,) int
        The frames averaged.
    positions : (M, 3) float64, mm, head frame
        NaN where a marker was not seen.
    rotation, translation : (3, 3), (3,)
        World from head in the neutral frame.
    axes : str
        ``"world"`` or ``"face"``: whose axes the head frame has.
    face_angle_rad : float
        Between the world's axes and those of the average head laid over the markers.
    """

    frames: NDArray[np.int64]
    positions: Floats
    rotation: Floats
    translation: Floats
    axes: str
    face_angle_rad: float


def find_neutral(
    trajectories: Trajectories, marker_set: MarkerSet, frame: int, axes: str = "auto"
) -> Neutral:
    """Average the still frames around one, and find the head there.

    Parameters
    ----------
    trajectories : Trajectories
        mm; the set's markers, in its order.
    marker_set : MarkerSet
    frame : int
    axes : str
        ``"auto"``, ``"world"`` or ``"face"``; see `performance.analyse`.

    Raises
    ------
    InputError
        If head markers or all face markers are missing in the frame.
    ValueError
        If `axes` is none of the three.
    """
    if axes not in ("auto", "world", "face"):
        raise ValueError(f'axes must be "auto", "world" or "face", not {axes!r}')
    p = trajectories.positions
    frames = _still_frames(p, frame)
    mean = np.array([_mean_known(p[frames, m]) for m in range(p.shape[1])])
    _check_seen(mean, marker_set, frame)
    R, t, angle = _head_axes(mean, marker_set)
    use_world = axes == "world" or (axes == "auto" and angle <= WORLD_AXES_WITHIN_RAD)
    R = np.eye(3) if use_world else R
    return Neutral(frames, (mean - t) @ R, R, t, "world" if use_world else "face", angle)


def _check_seen(mean: Floats, marker_set: MarkerSet, frame: int) -> None:
    unseen = {label for label, q in zip(marker_set.labels, mean, strict=True) if np.isnan(q[0])}
    missing = [label for label in marker_set.head_labels if label in unseen]
    if missing:
        raise InputError(
            f"head markers {', '.join(missing)} are not visible in the neutral frame {frame}: "
            "choose another one with --neutral"
        )
    if unseen >= {m.label for m in marker_set.markers if not m.is_rigid}:
        raise InputError(
            f"no face markers are visible in the neutral frame {frame}: choose another one with "
            "--neutral"
        )


def _mean_known(p: Floats) -> Floats:
    known = p[~np.isnan(p[:, 0])]
    return known.mean(axis=0) if len(known) else np.full(3, np.nan)


def _still_frames(p: Floats, frame: int) -> NDArray[np.int64]:
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


def _head_axes(positions: Floats, marker_set: MarkerSet) -> tuple[Floats, Floats, float]:
    """Average head → neutral markers: rotation, translation, angle from the world's axes."""
    template = template_positions(marker_set)
    seen = ~np.isnan(positions[:, 0])
    if seen.sum() < 3:
        raise InputError("fewer than three markers are visible in the neutral frame")
    _, R, t = fit_similarity(template[seen], positions[seen])
    angle = float(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    return R, t, angle
