"""Feature points from the markers around them.

A marker is glued beside its feature point where the point itself cannot carry one: beside the
corner of the mouth; and the inner lips carry none. How the point moves when the markers around it
move is read off the sculpted shapes of the average head (`heads`), as a correction to the point's
stand-in: its own marker, or for the inner lips the outer ones (Kshirsagar et al. 2000, section 4).
The correction is a linear regression on the markers near the point, over faces drawn from
expressions, visemes and single shapes. It is timid: it takes markers to be noisy and shapes to be
no more than alike from person to person. Lids are left alone: the skin above them folds in a
blink, which is not linear, and their markers' own displacement is nearer the truth.

In the same way the skin's normal under a marker follows the markers, from which the skin under
the centre of a sphere is found (`skin_displacements`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.markers import MarkerSet
from ..core.mesh import vertex_normals
from ..heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from ..heads.head import Head
from ..heads.marker_sets import glue_markers
from .face_units import average_head
from .rigid_fit import Floats

#: FAPs of the inner lip take the outer lip's displacement (Kshirsagar et al. 2000, section 4:
#: markers on the inner contour would touch). Feature point → the one that stands for it.
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
_LIDS = ("3.1", "3.2", "3.3", "3.4")
_NEAR_MM = 45.0  # markers farther from a point tell nothing of it
_DOUBT_MM = 0.3  # how far markers and shapes are trusted
_SHAPE_SD = 0.3  # of the weight of a single shape
_WHOLE_SD = 0.5  # of the intensity of a whole expression or viseme
_HALF = 0.5  # weight at which normals of shapes are measured: they turn less and less
_STANDOFF_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class PointRule:
    """How a feature point follows markers: ``stand-in + Σ weights (markers)``.

    Attributes
    ----------
    stand_in : str
        The marker whose displacement it takes first.
    labels : tuple of str
        The markers that correct it.
    weights : (len(labels), 3, 3) float64
        ``correction = Σ_m displacement_m @ weights[m]``.
    """

    stand_in: str
    labels: tuple[str, ...]
    weights: Floats

    def apply(self, moved: Mapping[str, Floats]) -> Floats:
        """(T, 3) mm displacement from those of the markers, (T, 3) mm each, by label.

        A marker that `moved` lacks, or that is NaN, does not correct: its part is taken as that
        of the stand-in.
        """
        own = moved[self.stand_in]
        found = np.array(own)
        for label, weight in zip(self.labels, self.weights, strict=True):
            d = moved.get(label, own)
            found += np.where(np.isnan(d), own, d) @ weight
        return found


def stand_ins(marker_set: MarkerSet, *, inner_lips: bool = True) -> dict[str, str]:
    """Feature point → label of the marker that stands for it, own markers first."""
    own = marker_set.label_by_feature_point
    found = dict(own)
    if inner_lips:
        found |= {
            inner: own[outer]
            for inner, outer in LIP_APPROXIMATIONS.items()
            if outer in own and inner not in own
        }
    return found


@cache
def point_rules(marker_set: MarkerSet) -> Mapping[str, PointRule]:
    """How the feature points that a set observes, or stands in for, follow its markers."""
    return point_rules_on(average_head(), marker_set)


def point_rules_on(head: Head, marker_set: MarkerSet) -> dict[str, PointRule]:
    """The same, read off a head; one without sculpted shapes gives rules without corrections."""
    stands = {fp: label for fp, label in stand_ins(marker_set).items() if fp in head.points}
    if head.shapes is None or not len(head.shape_names):
        empty = np.zeros((0, 3, 3))
        return {fp: PointRule(label, (), empty) for fp, label in stands.items()}
    glued = glue_markers(head, marker_set)
    markers = glued.at(head.mesh.vertices)
    shapes = np.asarray(head.shapes, dtype=np.float64)
    moved = np.stack([glued.at(s) for s in shapes])
    points = np.stack([head.feature_points.at(s) for s in shapes])
    spread = _weight_covariance(head.shape_names)
    rules = {}
    for fp, label in stands.items():
        if fp in _LIDS or fp not in head.feature_points.names:
            rules[fp] = PointRule(label, (), np.zeros((0, 3, 3)))
            continue
        own = marker_set.labels.index(label)
        near = _near(marker_set, markers, head.points[fp], own)
        if fp.startswith("8.") or fp in LIP_APPROXIMATIONS:
            near = _of_lips(marker_set, near)
        y = points[:, head.feature_points.index(fp)] - moved[:, own]
        labels = tuple(marker_set.labels[m] for m in near)
        rules[fp] = PointRule(label, labels, _regression(moved[:, near], y, spread))
    return rules


def _regression(moved: Floats, followed: Floats, spread: Floats) -> Floats:
    """Weights (m, 3, 3) with which (N, 3) follows markers (N, m, 3), a row for each shape."""
    x = moved.reshape(len(moved), -1)
    gram = x.T @ spread @ x + _DOUBT_MM**2 * np.eye(x.shape[1])
    return np.asarray(np.linalg.solve(gram, x.T @ spread @ followed).reshape(-1, 3, 3))


@dataclass(frozen=True, eq=False)
class NormalRules:
    """The skin's normals under a set's markers, and how they follow the markers' displacements.

    Attributes
    ----------
    rest : (M, 3) float64
        Unit normals of the neutral face.
    weights : (M, M, 3, 3) float64, 1/mm
        ``normal_i ∝ rest_i + Σ_m displacement_m @ weights[i, m]``.
    """

    rest: Floats
    weights: Floats

    def at(self, moved: Floats) -> Floats:
        """Unit normals (T, M, 3) under displacements (T, M, 3), mm; unknown ones count as 0."""
        turned = np.einsum("tmx,imxy->tiy", np.nan_to_num(moved), self.weights, optimize=True)
        n = self.rest + turned
        return np.asarray(n / np.linalg.norm(n, axis=2, keepdims=True))


@cache
def normal_rules(marker_set: MarkerSet) -> NormalRules:
    """Read off the average head and its sculpted shapes."""
    head = average_head()
    assert head.shapes is not None
    glued = glue_markers(head, marker_set)
    skin = head.mesh.triangles[head.mesh.groups["skin"]]

    def normals(vertices: Floats) -> Floats:
        n = glued.at(vertex_normals(vertices, skin))
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    rest = normals(head.mesh.vertices)
    shapes = np.asarray(head.shapes, dtype=np.float64)
    moved = np.stack([glued.at(s) for s in shapes])
    turned = np.stack([(normals(head.mesh.vertices + _HALF * s) - rest) / _HALF for s in shapes])
    spread = _weight_covariance(head.shape_names)
    markers = glued.at(head.mesh.vertices)
    weights = np.zeros((len(rest), len(rest), 3, 3))
    for m in range(len(rest)):
        near = _near(marker_set, markers, markers[m], m)
        if not marker_set.markers[m].is_rigid:
            weights[m, near] = _regression(moved[:, near], turned[:, m], spread)
    return NormalRules(rest, weights)


def skin_displacements(moved: Floats, marker_set: MarkerSet) -> Floats:
    """How the skin under spheres moved, from how their centres did.

    The skin lies the set's `standoff_mm` below a centre along its normal, which turns as the face
    moves. Flat dots, which stand off by 0, are left as they are.

    Parameters
    ----------
    moved : (T, M, 3) float64, mm, head frame
        Of the centres, from the neutral face; NaN where unknown.
    marker_set : MarkerSet

    Returns
    -------
    (T, M, 3) float64, mm
    """
    if marker_set.standoff_mm == 0:
        return moved
    rules = normal_rules(marker_set)
    skin = moved
    for _ in range(_STANDOFF_ROUNDS):  # normals follow the skin, not the centres
        skin = moved - marker_set.standoff_mm * (rules.at(skin) - rules.rest)
    return skin


def _near(marker_set: MarkerSet, markers: Floats, point: Floats, own: int) -> NDArray[np.int64]:
    """Markers of the face near a point; its own among them."""
    on_face = np.array([not m.is_rigid for m in marker_set.markers])
    near = on_face & (np.linalg.norm(markers - point, axis=1) <= _NEAR_MM)
    near[own] = True
    return np.flatnonzero(near)


def _of_lips(marker_set: MarkerSet, near: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lips follow lips: a jaw that drops behind held lips moves none of their points."""
    points = [marker_set.markers[m].feature_point for m in near]
    return near[[fp.startswith("8.") or fp in LIP_APPROXIMATIONS for fp in points]]


def _weight_covariance(shape_names: tuple[str, ...]) -> Floats:
    """Second moments (N, N) of the shapes' weights in faces that move."""
    wholes = [expression_weights(name) for name in EXPRESSIONS]
    wholes += [viseme_weights(name) for name in VISEMES]
    found = _SHAPE_SD**2 * np.eye(len(shape_names))
    for whole in wholes:
        w = np.array([whole.get(name, 0.0) for name in shape_names])
        found += _WHOLE_SD**2 * np.outer(w, w)
    return found
