"""A head driven by its own shapes."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.mesh import SurfacePoints
from ..core.mpeg4 import ANGLE_UNIT_RAD, fap_by_name, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from .animation import HeadAnimation, PartMotion
from .arkit import direct_weights
from .controls import joined_points
from .deformer import FeaturePointDeformer
from .drive import HeadDrive
from .fap_rules import complete_faps, gives_faps
from .rigid_teeth import RigidTeeth
from .shape_jacobian import (
    UNSURE,
    carried_by_jaw,
    rounding_mm,
    shape_jacobian,
    unobservable_shapes,
)
from .shape_weights import (
    CUTOFF_HZ,
    NOISE_MM,
    ShapeWeights,
    given_weights,
    head_turns,
    solve_weights,
    weights_to_faps,
)

__all__ = [
    "ShapeDeformer",
    "ShapeDrive",
    "ShapeWeights",
    "solve_weights",
    "unobservable_shapes",
    "weights_to_faps",
]

_log = logging.getLogger(__name__)
Floats = NDArray[np.float64]

METHODS = ("shapes", "direct")
_EYES = {"left": "l", "right": "r"}


class ShapeDeformer(FeaturePointDeformer):
    """Moves all vertices by weights of shapes.

    It has the interface of the deformer of feature points: its "points" are the shapes, placed
    where each moves the mesh most, and the first component of a point's "displacement" is the
    shape's weight; the other two do nothing.

    Attributes
    ----------
    shape_names : tuple of str
        In the order of `points`.
    """

    def __init__(self, head: Head, shapes: tuple[str, ...], rigid: tuple[str, ...]) -> None:
        """Of some shapes of a head; parts in `rigid` stay out of it."""
        assert head.shapes is not None
        offsets = np.array(head.shapes[[head.shape_names.index(n) for n in shapes]], np.float64)
        for part in rigid:
            offsets[:, head.part_vertices(part)] = 0.0
        n, n_vertices = offsets.shape[:2]
        flat = sparse.coo_matrix(offsets.reshape(n, -1).T)
        place = (flat.row, 3 * flat.col)
        self.shape_names = shapes
        self.points = _places_of_shapes(head, shapes, offsets)
        self.matrix = sparse.csr_matrix((flat.data, place), (3 * n_vertices, 3 * n))
        self.tables = tuple(sparse.csr_matrix(offsets[:, :, axis].T) for axis in range(3))
        self._shape = (n, 3)
        self._n_vertices = n_vertices

    def beside(self, points: FeaturePointDeformer) -> ShapeDeformer:
        """Shapes and points together: points behind the shapes, with displacements in mm."""
        found: ShapeDeformer = object.__new__(ShapeDeformer)
        found.shape_names = self.shape_names
        tables = zip(self.tables, points.tables, strict=True)
        found.tables = tuple(sparse.hstack(pair).tocsr() for pair in tables)
        found.points = joined_points(self.points, (points.points,))
        found.matrix = sparse.hstack([self.matrix, points.matrix]).tocsr()
        found._shape = (len(found.points), 3)
        found._n_vertices = self._n_vertices
        return found


def _places_of_shapes(head: Head, shapes: tuple[str, ...], offsets: Floats) -> SurfacePoints:
    flat = head.mesh.triangles.ravel()
    used, first = np.unique(flat, return_index=True)
    most = used[np.linalg.norm(offsets[:, used], axis=2).argmax(axis=1)]
    at = first[np.searchsorted(used, most)]
    return SurfacePoints(shapes, head.mesh.triangles[at // 3], np.eye(3)[at % 3])


class _Refinement:
    """What shapes miss at feature points, spread over the skin by the points' deformer."""

    def __init__(self, head: Head, shapes: ShapeDeformer) -> None:
        self.points = HeadDrive(head)
        on = self.points.deformer.points
        n, n_vertices = len(on), len(head.mesh.vertices)
        place = (np.repeat(np.arange(n), 3), on.corners.ravel())
        at = sparse.csr_matrix((on.barycentric.ravel(), place), (n, n_vertices))
        self._made = sparse.kron(at, sparse.identity(3)) @ shapes.matrix

    def missed(self, clip: Clip, weights: Floats, faps: dict[str, Floats]) -> Floats:
        """(T, N, 3) mm: along what FAPs say and lids do; 0 along all that is only guessed."""
        wanted = self.points.feature_point_displacements(clip)
        made = np.asarray((self._made[:, ::3] @ weights.T).T).reshape(wanted.shape)
        return np.asarray(np.where(self._is_said(faps), wanted - made, 0.0))

    def _is_said(self, faps: dict[str, Floats]) -> NDArray[np.bool_]:
        names = self.points.deformer.points.names
        letters = self.points.controls.letters
        found = np.array([[x == "L" for x in letters.get(n, "---")] for n in names])
        for fap in fap_by_name().values():
            if fap.name in faps and fap.direction is not None and not carried_by_jaw(fap):
                axis = int(np.abs(fap.direction).argmax())
                for i in (names.index(p) for p in fap.feature_points if p in names):
                    found[i, axis] |= letters.get(names[i], "---")[axis] == "F"
        return found


class ShapeDrive:
    """Moves a head by its own shapes, from FAPs or ARKit weights.

    Skin, lashes and tongue follow the shapes. Eyes turn rigidly, by FAPs 23 to 26 where the clip
    gives them, else as far as the ``eyeLook`` shapes say; lower teeth move rigidly, as near as can
    be to where the shapes take them. The head turns by FAPs 48 to 50.

    Parameters
    ----------
    head : Head
        With shapes whose names are understood (`shape_names`).
    method : str
        ``"shapes"``: weights solved so that feature points go where FAPs say. ``"direct"``: by
        a fixed table (`arkit.direct_weights`), which needs no feature points but knows nothing of
        this head.
    refine : bool
        Take what the shapes miss along the FAPs as displacements of the feature points, so that
        these go where FAPs say and lids meet. The animation then has more curves than the shapes'.
    noise_mm : float, mm
    cutoff_hz : float, Hz
        See `solve_weights`.

    Raises
    ------
    InputError
        If the head has no shapes that are understood, or `refine` is asked of one whose feature
        points do not suffice.
    ValueError
        If there is no such method.
    """

    def __init__(
        self,
        head: Head,
        *,
        method: str = "shapes",
        refine: bool = False,
        noise_mm: float = NOISE_MM,
        cutoff_hz: float = CUTOFF_HZ,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
        self.head = head
        self.jacobian = shape_jacobian(head)
        self.method = method
        self._noise_mm, self._cutoff_hz = noise_mm, cutoff_hz
        unknown = self.jacobian.names.unknown_text()
        if unknown:
            _log.warning("shapes of head %s that stay at rest: %s", head.name, unknown)
        parts = ("eye_left", "eye_right", "teeth_lower")
        eyes = {f"eye_{side}" for side in head.eyes}
        self._rigid = tuple(
            p for p in parts if p in head.mesh.groups and (p == "teeth_lower" or p in eyes)
        )
        shapes = (*self.jacobian.shapes, *self.jacobian.correctives)
        self.deformer = ShapeDeformer(head, shapes, self._rigid)
        if "teeth_lower" in self._rigid:
            self._teeth = RigidTeeth(head, shapes)
        self._refinement = _Refinement(head, self.deformer) if refine else None
        if self._refinement is not None:
            self.deformer = self.deformer.beside(self._refinement.points.deformer)

    @property
    def unobservable(self) -> tuple[str, ...]:
        """Shapes whose weights integer FAPs do not tell; see `unobservable_shapes`."""
        unsure = self.jacobian.weight_sd(rounding_mm(self.jacobian)) > UNSURE
        return tuple(n for n, u in zip(self.jacobian.shapes, unsure, strict=True) if u)

    def weights(self, clip: Clip) -> ShapeWeights:
        """Weights of the head's shapes for a clip of FAPs, of ARKit weights, or of the head's own.

        Raises
        ------
        InputError
            If the clip holds nothing that the head knows.
        """
        jacobian = self.jacobian
        if gives_faps(clip):
            if self.method == "shapes":
                return solve_weights(
                    jacobian, clip, noise_mm=self._noise_mm, cutoff_hz=self._cutoff_hz
                )
            clip = direct_weights(clip)
        values = given_weights(jacobian, clip)
        channels = (*jacobian.shapes, *jacobian.correctives)
        none = np.zeros(len(values))
        return ShapeWeights(jacobian, Clip(clip.time_s, channels, values), none, 0, True)

    def animate(self, clip: Clip, motion: HeadMotion | None = None) -> HeadAnimation:
        """The head moving as a clip says.

        Parameters
        ----------
        clip : Clip
            Of FAPs, ARKit weights, or the head's own shapes by name.
        motion : HeadMotion or None
            World from head, at the clip's times; None: FAPs 48 to 50, or the clip's rotations of
            the head, about the neck's pivot.

        Raises
        ------
        InputError
            If the clip holds nothing that the head knows, or the motion has other times or gaps.
        """
        weights = self.weights(clip)
        faps = complete_faps(clip) if gives_faps(clip) else {}
        if motion is None:
            motion = self._motion(clip, faps)
        _check_motion(motion, clip)
        moved = np.zeros((len(clip.time_s), len(self.deformer.points), 3))
        n_shapes = len(weights.clip.channels)
        moved[:, :n_shapes, 0] = weights.clip.values
        if self._refinement is not None and faps:
            missed = self._refinement.missed(clip, weights.clip.values, faps)
            moved[:, n_shapes:] = missed
        parts = self._parts(clip, faps, weights)
        return HeadAnimation(self.head, self.deformer, clip.time_s, moved, parts, motion)

    def _parts(
        self, clip: Clip, faps: dict[str, Floats], weights: ShapeWeights
    ) -> dict[str, PartMotion]:
        found: dict[str, PartMotion] = {}
        n = len(clip.time_s)
        for side, letter in _EYES.items():
            if f"eye_{side}" not in self._rigid:
                continue
            turns = self._looks(side, letter, faps, weights)
            quaternion = Rotation.from_euler("YX", turns).as_quat(scalar_first=True)
            shift = np.zeros((n, 3))
            thrust = f"thrust_{letter}_eyeball"
            if thrust in faps:
                shift[:, 2] = faps[thrust] * self.head.fapu.unit(fap_by_name()[thrust])
            found[f"eye_{side}"] = PartMotion(self.head.eyes[side].centre, quaternion, shift)
        if "teeth_lower" in self._rigid:
            found["teeth_lower"] = self._teeth.motion(weights.clip.values)
        return found

    def _looks(
        self, side: str, letter: str, faps: dict[str, Floats], weights: ShapeWeights
    ) -> Floats:
        """Yaw and pitch of an eye, (T, 2) rad."""
        found = np.zeros((len(weights.clip.time_s), 2))
        rows = {fap.name: i for i, fap in enumerate(self.jacobian.faps)}
        k = len(self.jacobian.shapes)
        for axis, turn in enumerate(("yaw", "pitch")):
            name = f"{turn}_{letter}_eyeball"
            if name in faps:
                found[:, axis] = faps[name] * ANGLE_UNIT_RAD
            elif name in rows:
                mm = weights.clip.values[:, :k] @ self.jacobian.mm[rows[name]]
                found[:, axis] = mm / self.head.eyes[side].radius
        return found

    def _motion(self, clip: Clip, faps: dict[str, Floats]) -> HeadMotion:
        none = np.zeros(len(clip.time_s))
        names = ("head_pitch", "head_yaw", "head_roll")
        turns = np.stack([faps.get(n, none) for n in names], axis=1)
        of_arkit = head_turns(clip)
        if not faps and of_arkit is not None:
            turns = of_arkit / ANGLE_UNIT_RAD
        R = rotation_of_faps(turns)
        pivot = self.head.neck_pivot
        return HeadMotion(clip.time_s, quaternion_from_rotation(R), pivot - R @ pivot)


def _check_motion(motion: HeadMotion, clip: Clip) -> None:
    same = motion.time_s.shape == clip.time_s.shape
    if not same or not np.allclose(motion.time_s, clip.time_s, atol=1e-3):
        raise InputError("the head's motion and the clip have other times: resample one of them")
    if not (np.isfinite(motion.quaternion).all() and np.isfinite(motion.translation).all()):
        raise InputError("the head's motion has gaps: fill them first")
