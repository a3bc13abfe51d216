"""The animatable head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.mesh import Mesh, SurfacePoints
from ..core.mpeg4 import Fapu
from .appearance import Appearance

#: The parts a head may have; a head without one lacks the group.
RIGID_PARTS = ("eye_right", "eye_left", "teeth_upper", "teeth_lower")


@dataclass(frozen=True, eq=False)
class Eye:
    """An eyeball: centre (3,) mm in the head frame, radius mm."""

    centre: NDArray[np.float64]
    radius: float


@dataclass(frozen=True, eq=False)
class Head:
    """A head at rest with all that moves it.

    Head frame: x to the subject's left, y up, z out of the face, origin between the eyeballs, mm.

    Attributes
    ----------
    name : str
    mesh : Mesh
        The neutral face. Groups: ``skin`` and those of ``eye_right``, ``eye_left``, ``lashes``,
        ``teeth_upper``, ``teeth_lower``, ``tongue`` that it has. Its landmarks, if it has any, are
        Farkas's (`landmarks`).
    feature_points : SurfacePoints
        MPEG-4 feature points on its surface, by id.
    eyes : mapping from ``"right"``, ``"left"`` to Eye
    jaw_pivot : (3,) float64, mm
        Middle of the hinge axis of the jaw, which runs along x.
    neck_pivot : (3,) float64, mm
        Feature point 7.1, the centre of head rotation.
    shape_names : tuple of str, length N
        ARKit names of its sculpted shapes; empty if it has none.
    shapes : (N, V, 3) float32, mm
        Offsets from the neutral face.
    appearance : Appearance
    regions : mapping from name to (n,) int32
        Triangle indices of regions of the skin; those of `regions.REGIONS` that it has.
    """

    name: str
    mesh: Mesh
    feature_points: SurfacePoints
    eyes: Mapping[str, Eye]
    jaw_pivot: NDArray[np.float64]
    neck_pivot: NDArray[np.float64]
    appearance: Appearance
    shape_names: tuple[str, ...] = ()
    shapes: NDArray[np.float32] | None = None
    regions: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "jaw_pivot", readonly(self.jaw_pivot, (3,), "jaw_pivot"))
        object.__setattr__(self, "neck_pivot", readonly(self.neck_pivot, (3,), "neck_pivot"))
        if self.shapes is not None:
            wanted = (len(self.shape_names), len(self.mesh.vertices), 3)
            shapes = readonly(self.shapes, wanted, "shapes", np.float32)
            object.__setattr__(self, "shapes", shapes)

    @cached_property
    def points(self) -> dict[str, NDArray[np.float64]]:
        """Neutral positions of the feature points, (3,) mm each, head frame.

        Those on the surface and two that are not: 7.1, the neck pivot, and 11.5, the top of the
        hair, which is that of the skull (11.4): heads have painted hair, without thickness.
        """
        at = self.feature_points.at(self.mesh.vertices)
        found = dict(zip(self.feature_points.names, at, strict=True))
        found["7.1"] = self.neck_pivot
        if "11.4" in found:
            found["11.5"] = found["11.4"]
        return found

    @cached_property
    def fapu(self) -> Fapu:
        """The facial animation units of the neutral face."""
        return Fapu.from_points(self.points)

    def part_vertices(self, part: str) -> NDArray[np.int64]:
        """Vertex indices of a part; empty if the head lacks it."""
        if part not in self.mesh.groups:
            return np.zeros(0, dtype=np.int64)
        return np.unique(self.mesh.triangles[self.mesh.groups[part]]).astype(np.int64)

    def shaped(self, weights: Mapping[str, float]) -> NDArray[np.float64]:
        """Vertices under sculpted shapes, (V, 3) mm.

        Parameters
        ----------
        weights : mapping from ARKit name to weight

        Raises
        ------
        InputError
            If the head lacks a shape.
        """
        found = np.array(self.mesh.vertices)
        for name, weight in weights.items():
            if name not in self.shape_names or self.shapes is None:
                raise InputError(f"head {self.name} has no shape {name}")
            found += weight * self.shapes[self.shape_names.index(name)]
        return found
