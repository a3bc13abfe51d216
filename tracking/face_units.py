"""Units of a face (FAPU) of which only the markers are known, and how sure they are.

People's heads vary along a few dozen directions (`face_variation.people_modes`). Together with
place, turn and size of the head and with glue that is never quite where the set says, they make a
Gaussian of markers and feature points. Given the neutral markers, the feature points follow with
a mean and a covariance (Gaussian conditioning), and so do the five distances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.markers import FACE, HEAD, MarkerSet
from ..core.mpeg4 import Fapu
from ..heads.head import Head
from ..heads.identity import Identity, make_head, target_weights
from ..heads.marker_sets import glue_markers
from ..heads.template import load_template
from .face_variation import LOG_SCALE_SD, people_modes
from .rigid_fit import Floats

_POINTS = ("2.2", "3.1", "3.2", "3.3", "3.4", "3.5", "3.6", "8.3", "8.4", "9.15")
_PLACE_SD_MM, _TURN_SD_RAD = 30.0, 0.15  # of the neutral head frame against the average head's
#: How far off its place a marker is glued: on a feature point, between them, on the skull.
_GLUE_MM, _FACE_GLUE_MM, _SKULL_GLUE_MM = 0.7, 5.0, 7.0
_MIN_MARKERS = 8
#: Where lips meet is no linear matter: what the modes leave open of the mouth-nose separation.
_LIP_SEAL_SD_MM = 0.9


@dataclass(frozen=True, eq=False)
class EstimatedUnits:
    """Units, and the standard deviations of their errors, mm, by name (``"MW"``)."""

    fapu: Fapu
    sd_mm: Mapping[str, float]


def estimate_fapu(neutral: Floats, marker_set: MarkerSet) -> Fapu:
    """The units alone; see `estimate_units`."""
    return estimate_units(neutral, marker_set).fapu


def estimate_units(neutral: Floats, marker_set: MarkerSet) -> EstimatedUnits:
    """The most likely units of a face with these neutral markers.

    Parameters
    ----------
    neutral : (M, 3) float64, mm, head frame
        NaN where a marker is missing.
    marker_set : MarkerSet

    Raises
    ------
    InputError
        If fewer than 8 markers are known.
    """
    seen = ~np.isnan(neutral[:, 0])
    if seen.sum() < _MIN_MARKERS:
        raise InputError(
            "too few markers in the neutral frame to estimate the face's units: give them in the "
            "marker set ([fapu] irisd, es, ens, mns, mw in mm)"
        )
    markers, marker_modes, points, point_modes = _people(marker_set)
    by_kind = {HEAD: _SKULL_GLUE_MM, FACE: _FACE_GLUE_MM}
    glue = np.array([by_kind.get(m.feature_point, _GLUE_MM) for m in marker_set.markers])
    x, A = markers[seen], marker_modes[:, seen]
    pose = _pose_modes(x)
    K = len(A)
    J = np.concatenate([A, pose]).reshape(K + len(pose), -1).T
    precision = np.repeat(1 / glue[seen] ** 2, 3)
    cov = np.asarray(np.linalg.inv(np.eye(J.shape[1]) + J.T @ (J * precision[:, None])))
    theta = cov @ (J.T @ (precision * (neutral[seen] - x).ravel()))
    # pose but not form: the units are distances along the face's own axes
    face = points + np.tensordot(theta[:K], point_modes, 1)
    size = 1 + LOG_SCALE_SD * theta[-1]
    fapu = Fapu.from_points(dict(zip(_POINTS, size * face, strict=True)))
    return EstimatedUnits(fapu, _unit_sds(fapu, size * face, point_modes, cov, K))


def _pose_modes(points: Floats) -> Floats:
    """(7, M, 3): shifts, turns and size, each at one standard deviation."""
    axes = np.eye(3)
    shifts = np.broadcast_to(_PLACE_SD_MM * axes[:, None], (3, *points.shape))
    turns = np.stack([_TURN_SD_RAD * np.cross(axis, points) for axis in axes])
    return np.concatenate([shifts, turns, LOG_SCALE_SD * points[None]])


def _unit_sds(
    fapu: Fapu, face: Floats, point_modes: Floats, cov: Floats, K: int
) -> dict[str, float]:
    """Standard deviations of the five distances, which are linear in the points."""
    rows = np.concatenate([point_modes, LOG_SCALE_SD * face[None]])
    kept = np.r_[:K, len(cov) - 1]
    names = list(fapu.as_dict())
    base = np.array(list(fapu.as_dict().values()))
    slopes = (
        np.stack(
            [
                np.array(list(Fapu.from_points(_named(face + 1e-3 * row)).as_dict().values()))
                - base
                for row in rows
            ]
        )
        / 1e-3
    )
    sds = np.sqrt(np.einsum("ku,kl,lu->u", slopes, cov[np.ix_(kept, kept)], slopes))
    sds[names.index("MNS")] = np.hypot(sds[names.index("MNS")], _LIP_SEAL_SD_MM)
    return {name: float(sd) for name, sd in zip(names, sds, strict=True)}


def _named(face: Floats) -> dict[str, Floats]:
    return dict(zip(_POINTS, face, strict=True))


@cache
def average_head() -> Head:
    """The average head, sparsely painted."""
    return make_head(Identity("average"), texture_px=256)


@cache
def _people(marker_set: MarkerSet) -> tuple[Floats, Floats, Floats, Floats]:
    """Markers (M, 3) and feature points (10, 3) of the mean person, and how people differ,
    (K, M, 3) and (K, 10, 3), mm each."""
    head = average_head()
    glue = glue_markers(head, marker_set)
    template = load_template()
    eyes = np.concatenate([template.vertices_of("eye_right"), template.vertices_of("eye_left")])
    mean, modes = people_modes()
    average = np.zeros(len(mean))
    for name, weight in target_weights(Identity("average")).items():
        average[template.identity_names.index(name)] = weight
    weights = np.concatenate([(mean - average)[None], modes])
    offsets = np.asarray(weights @ template.identity).reshape(len(weights), 3, -1).swapaxes(1, 2)
    offsets -= offsets[:, eyes].mean(axis=1)[:, None]  # the origin lies between the eyeballs
    points = head.feature_points.select(_POINTS)
    found: list[NDArray[np.float64]] = []
    for on_head in (glue, points):
        moved = on_head.at(offsets)
        found += [on_head.at(head.mesh.vertices) + moved[0], moved[1:]]
    return found[0], found[1], found[2], found[3]
