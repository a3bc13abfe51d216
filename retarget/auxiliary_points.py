"""Auxiliary control points between the feature points, and what they do when those move.

Between MPEG-4's feature points the skin does not move as the smoothest surface would: cheeks rise
in a smile, folds run from the nose to the corners of the mouth. Auxiliary points hold the skin
there. Their displacements are the conditional mean of a Gaussian, given those that FAPs say:

    E[a | x] = C_ax (C_xx + noise² I)⁻¹ x

The covariance C has two parts: how faces move in expressions, visemes and single sculpted shapes
(`learn_auxiliary`), and a smooth local motion that takes up whatever these do not explain, so that
one FAP alone moves the skin around its own point. Lengths are relative to a head's size
(`AuxiliaryModel.size_of`), so that it transfers to other heads.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from ..core.arrays import readonly
from ..core.mesh import SurfacePoints, vertex_normals
from ..heads.head import Head
from ..heads.raycast import RayScene
from ..heads.template import load_template
from .surface_weights import surface_distances

Floats = NDArray[np.float64]
#: A component of a displacement: a point's name and its axis.
Component = tuple[str, int]

DATA = "auxiliary_points.npz"
#: Names of auxiliary points begin with this.
PREFIX = "aux."
#: Points of the two lips: what lies nearer to the one is not on the other.
UPPER_LIP = ("2.2", "2.6", "2.7", "8.1", "8.5", "8.6", "8.9", "8.10")
LOWER_LIP = ("2.3", "2.8", "2.9", "8.2", "8.7", "8.8")
#: A place that is further from the surface than this, on a head of average size, is not on it.
_FARTHEST_MM = 6.0
_LEAST_ALIKE = 0.3  # cosine between the normals of template and head


@dataclass(frozen=True, eq=False)
class AuxiliaryModel:
    """Where auxiliary points are on the template, and how they move.

    Attributes
    ----------
    points : SurfacePoints
        On the template's mesh.
    places, normals : (K, 3) float64, mm
        On the average head.
    lip : (K,) int
        1 on the upper lip, -1 on the lower one, 0 elsewhere.
    anchor_names : tuple of str, length A; anchors : (A, 3) float64, mm
        Feature points of the average head.
    inputs, outputs : tuples of Component, lengths I and O
        What FAPs say, and what is found from it: auxiliary points on all axes and feature points
        on those axes that no FAP moves.
    inner : (I, I) float64, mm²; cross : (O, I) float64, mm²
        C_xx and C_ax, at size 1.
    noise_mm : float
    eye_separation_mm : float
        Of the average head, whose size is 1.
    """

    points: SurfacePoints
    places: Floats
    normals: Floats
    lip: NDArray[np.int32]
    anchor_names: tuple[str, ...]
    anchors: Floats
    inputs: tuple[Component, ...]
    outputs: tuple[Component, ...]
    inner: Floats
    cross: Floats
    noise_mm: float
    eye_separation_mm: float

    def __post_init__(self) -> None:
        k, a, i, o = (len(x) for x in (self.points, self.anchor_names, self.inputs, self.outputs))
        shapes = {
            "places": (k, 3), "normals": (k, 3), "anchors": (a, 3), "inner": (i, i), "cross": (o, i)
        }  # fmt: skip
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        object.__setattr__(self, "lip", readonly(self.lip, (k,), "lip", np.int32))

    def size_of(self, head: Head) -> float:
        """A head's size relative to the average head."""
        return head.fapu.es / self.eye_separation_mm

    def regression(
        self, given: tuple[str, ...], wanted: tuple[str, ...]
    ) -> tuple[tuple[Component, ...], tuple[Component, ...], Floats]:
        """What the points that a head has tell of others.

        Parameters
        ----------
        given : tuple of str
            Points whose displacements are known, as far as FAPs move them; others are ignored.
        wanted : tuple of str

        Returns
        -------
        inputs, outputs : tuples of Component
        factors : (outputs, inputs) float64
        """
        at = [i for i, (name, _) in enumerate(self.inputs) if name in given]
        to = [i for i, (name, _) in enumerate(self.outputs) if name in wanted]
        inner = self.inner[np.ix_(at, at)] + self.noise_mm**2 * np.eye(len(at))
        factors = np.linalg.solve(inner, self.cross[np.ix_(to, at)].T).T
        inputs = tuple(self.inputs[i] for i in at)
        return inputs, tuple(self.outputs[i] for i in to), np.asarray(factors)


@cache
def auxiliary_model() -> AuxiliaryModel:
    """The model that comes with us; `learn_auxiliary` makes it."""
    path = files(__package__).joinpath("data", DATA)
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as z:
        names = tuple(str(n) for n in z["names"])
        return AuxiliaryModel(
            points=SurfacePoints(names, z["corners"], z["barycentric"]),
            places=z["places"],
            normals=z["normals"],
            lip=z["lip"],
            anchor_names=tuple(str(n) for n in z["anchor_names"]),
            anchors=z["anchors"],
            inputs=_components(z["input_points"], z["input_axes"]),
            outputs=_components(z["output_points"], z["output_axes"]),
            inner=z["inner"],
            cross=z["cross"],
            noise_mm=float(z["noise_mm"]),
            eye_separation_mm=float(z["eye_separation_mm"]),
        )


def _components(points: NDArray[np.str_], axes: NDArray[np.int8]) -> tuple[Component, ...]:
    return tuple((str(p), int(a)) for p, a in zip(points, axes, strict=True))


def place_auxiliary_points(head: Head, model: AuxiliaryModel) -> SurfacePoints:
    """The model's points on a head.

    On a head with the template's triangles they are where they are on the template. On others
    the average head is warped so that its feature points come to the head's own, and each point
    goes to the closest skin that faces the same way, those of a lip on their own lip. Points that
    find none are left out.
    """
    if np.array_equal(head.mesh.triangles, load_template().triangles):
        return model.points
    places, normals = _warped(head, model)
    v, skin = head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]]
    lip_of_triangle = _lip_of_triangles(head, skin)
    farthest = _FARTHEST_MM * model.size_of(head)
    names, corners, weights = [], [], []
    for lip in (0, 1, -1):
        rows = np.flatnonzero(model.lip == lip)
        surface = skin if lip == 0 else skin[lip_of_triangle == lip]
        if not len(rows) or not len(surface):
            continue
        at, triangle, b = RayScene(v, surface).closest(places[rows])
        facing = np.einsum("nc,ncx->nx", b, vertex_normals(v, skin)[surface[triangle]])
        near = np.linalg.norm(at - places[rows], axis=1) < farthest
        near &= (facing * normals[rows]).sum(axis=1) > _LEAST_ALIKE
        names += [model.points.names[i] for i in rows[near]]
        corners.append(surface[triangle[near]])
        weights.append(b[near] / b[near].sum(axis=1, keepdims=True))
    if not names:
        return SurfacePoints((), np.zeros((0, 3), np.int32), np.zeros((0, 3)))
    found = SurfacePoints(tuple(names), np.concatenate(corners), np.concatenate(weights))
    return found.select(tuple(n for n in model.points.names if n in names))


def _warped(head: Head, model: AuxiliaryModel) -> tuple[Floats, Floats]:
    """Places and unit normals of the average head's points on this one."""
    own = head.points
    known = [i for i, n in enumerate(model.anchor_names) if n in own]
    target = np.array([own[model.anchor_names[i]] for i in known])
    source, first = np.unique(model.anchors[known], axis=0, return_index=True)
    warp = RBFInterpolator(source, target[first], kernel="linear", degree=1, smoothing=0.5)
    places = warp(model.places)
    ahead = warp(model.places + model.normals) - places
    return places, ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)


def _lip_of_triangles(head: Head, skin: NDArray[np.int32]) -> NDArray[np.int32]:
    """1 for triangles nearer to the upper lip's points, along the surface, than to the lower's."""
    nearest = []
    for lip in (UPPER_LIP, LOWER_LIP):
        points = head.feature_points.select(tuple(n for n in lip if n in head.feature_points.names))
        mm, _ = surface_distances(head.mesh.vertices, skin, points).nearest()
        nearest.append(mm[skin].mean(axis=1))
    return np.where(nearest[0] < nearest[1], 1, -1).astype(np.int32)
