"""Teeth that keep their form: the rigid motion nearest to where shapes take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from .animation import PartMotion

Floats = NDArray[np.float64]


class RigidTeeth:
    """The lower teeth under a head's shapes.

    What the nearest rigid motion needs of the vertices is linear in the shapes' weights: twelve
    numbers a shape, worked out once. A frame then costs the same whatever the head's size.

    Parameters
    ----------
    head : Head
        With lower teeth.
    shapes : tuple of str
        Names of K of its shapes.

    References
    ----------
    Kabsch: A Solution for the Best Rotation to Relate Two Sets of Vectors, 1976.
    """

    def __init__(self, head: Head, shapes: tuple[str, ...]) -> None:
        assert head.shapes is not None
        rows = head.part_vertices("teeth_lower")
        offsets = np.array(
            [head.shapes[head.shape_names.index(name), rows] for name in shapes], np.float64
        ).reshape(len(shapes), len(rows), 3)
        rest = head.mesh.vertices[rows]
        self._pivot = rest.mean(axis=0)
        arm = rest - self._pivot
        self._shifts = offsets.mean(axis=1)  # (K, 3)
        self._at_rest = arm.T @ arm
        self._crosses = np.einsum("vi,kvj->kij", arm, offsets)  # (K, 3, 3)

    def motion(self, weights: Floats) -> PartMotion:
        """Their motion for weights (T, K) of the shapes."""
        shift = weights @ self._shifts
        cross = self._at_rest + np.tensordot(weights, self._crosses, axes=1)
        U, _, Vt = np.linalg.svd(cross)
        flip = np.linalg.det(U) * np.linalg.det(Vt)
        U[:, :, 2] *= flip[:, None]
        rotation = np.swapaxes(U @ Vt, 1, 2)
        return PartMotion(self._pivot, quaternion_from_rotation(rotation), shift)
