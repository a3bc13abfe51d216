"""Whether a mesh has a slit between the lips, so that they can part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .head import Head
from .skin_surface import Surface

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

#: (upper, lower) feature points of the lips at the seam.
LIP_PAIRS = (("2.2", "2.3"), ("2.7", "2.9"), ("2.6", "2.8"))
_AROUND_MM = 9.0  # the lips' middles: within it no way leads round the corners of the mouth


def lips_part(head: Head) -> bool:
    """Whether a head's lips can part; without such a slit they must move together.

    True where it lacks the feature points that would tell.
    """
    surface = Surface(head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]])
    parted = [
        is_slit(surface, head.points[upper], head.points[lower])
        for upper, lower in LIP_PAIRS
        if upper in head.points and lower in head.points
    ]
    return 2 * sum(parted) > len(parted) if parted else True


def is_slit(surface: Surface, upper: Floats, lower: Floats) -> bool:
    """Whether the way over the surface between two points is far longer than the straight one."""
    ends = surface.points_at(("upper", "lower"), np.stack([upper, lower]))
    near = np.linalg.norm(surface.vertices - (upper + lower) / 2, axis=1) < _AROUND_MM
    inside = near[surface.triangles].all(axis=1)
    return not _hang_together(surface.triangles[inside], ends.corners[0], ends.corners[1])


def _hang_together(
    triangles: Triangles, first: NDArray[np.int32], second: NDArray[np.int32]
) -> bool:
    """Whether any corner of one triangle is joined to any of another by edges of `triangles`."""
    n = int(max(triangles.max(initial=0), first.max(), second.max())) + 1
    a = np.concatenate([triangles.ravel(), first, second])
    b = np.concatenate(
        [np.roll(triangles, 1, axis=1).ravel(), np.roll(first, 1), np.roll(second, 1)]
    )
    graph = sparse.coo_matrix((np.ones(len(a)), (a, b)), (n, n))
    _, label = connected_components(graph, directed=False)
    return bool(np.isin(label[first], label[second]).any())
