"""Lighter heads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.mesh import Mesh, SurfacePoints
from .head import Head
from .raycast import RayScene, import_open3d

#: How strongly open borders (the neck) hold their shape against the skin.
_BORDER_WEIGHT = 4.0
#: Parts that are left out, in this order, where vertices are short.
_DROPPED_FIRST = ("tongue", "lashes", "teeth_upper", "teeth_lower")
#: Eyeballs are made lighter too: to this share of all vertices each, but no less than the minimum.
_EYE_SHARE, _FEWEST_OF_EYE = 0.05, 42
#: The skin gets at least this share of the vertices before a part is kept.
_SKIN_SHARE = 0.6


def decimate(head: Head, n_vertices: int) -> Head:
    """A head with fewer vertices, by quadric edge collapse of the skin and the eyeballs.

    The other parts are kept whole, or left out where they would take too many of the vertices
    (tongue and lashes first, then teeth). Edge collapse takes away one or two vertices at a time,
    so that the result may hold a vertex or two less than asked for, never more. Feature points
    move to the nearest surface of what is left; those on parts that are left out are dropped, and
    so are sculpted shapes and texture coordinates.

    Parameters
    ----------
    head : Head
    n_vertices : int

    Raises
    ------
    InputError
        If the head has fewer vertices already, or `n_vertices` is too small for a face.
    """
    total = len(head.mesh.vertices)
    if not _FEWEST <= n_vertices <= total:
        raise InputError(
            f"head {head.name} can be decimated to {_FEWEST}..{total} vertices, not {n_vertices}"
        )
    sizes = _part_sizes(head, n_vertices)
    sizes["skin"] = n_vertices
    vertices, triangles, groups = [], [], {}
    n_done = n_triangles = 0
    for part in sorted(sizes, key=lambda name: name == "skin"):  # the skin takes what is left
        wanted = n_vertices - n_done if part == "skin" else sizes[part]
        v, t = _collapsed(head, part, wanted)
        groups[part] = np.arange(n_triangles, n_triangles + len(t), dtype=np.int32)
        vertices.append(v)
        triangles.append(t + n_done)
        n_done, n_triangles = n_done + len(v), n_triangles + len(t)
    mesh = Mesh(np.concatenate(vertices), np.concatenate(triangles), groups=groups)
    return Head(
        name=head.name,
        mesh=mesh,
        feature_points=_relocated(head, mesh),
        eyes={side: eye for side, eye in head.eyes.items() if f"eye_{side}" in groups},
        jaw_pivot=head.jaw_pivot,
        neck_pivot=head.neck_pivot,
        appearance=head.appearance,
    )


_FEWEST = 300
_SEARCH = 8


def _part_sizes(head: Head, n_vertices: int) -> dict[str, int]:
    """Vertices of each part but the skin; parts that are left out are absent."""
    sizes = {part: len(head.part_vertices(part)) for part in head.mesh.groups if part != "skin"}
    for part in sizes:
        if part.startswith("eye_"):
            share = max(_FEWEST_OF_EYE, round(_EYE_SHARE * n_vertices))
            sizes[part] = min(sizes[part], share)
    for part in _DROPPED_FIRST:
        if sum(sizes.values()) <= (1 - _SKIN_SHARE) * n_vertices:
            break
        sizes.pop(part, None)
    return sizes


def _collapsed(
    head: Head, part: str, n_vertices: int
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and triangles of a lighter part, of at most `n_vertices`."""
    o3d = import_open3d()
    used, rows = np.unique(head.mesh.triangles[head.mesh.groups[part]], return_inverse=True)
    triangles = rows.reshape(-1, 3).astype(np.int32)
    if n_vertices >= len(used):
        return head.mesh.vertices[used], triangles
    full = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(head.mesh.vertices[used]), o3d.utility.Vector3iVector(triangles)
    )
    target = 2 * n_vertices + 2 * _SEARCH  # Euler: about two triangles a vertex
    while True:
        light = full.simplify_quadric_decimation(target, boundary_weight=_BORDER_WEIGHT)
        light.remove_unreferenced_vertices()
        excess = len(light.vertices) - n_vertices
        if excess <= 0:
            return np.asarray(light.vertices), np.asarray(light.triangles).astype(np.int32)
        target -= max(2 * (excess - 1), 1)


def _relocated(head: Head, mesh: Mesh) -> SurfacePoints:
    """Feature points on the nearest surface of the part that they were on."""
    part_of_vertex = {}
    for part in mesh.groups:
        part_of_vertex.update(dict.fromkeys(head.part_vertices(part).tolist(), part))
    names, corners, barycentric = [], [], []
    for part in mesh.groups:
        on_part = [
            name
            for name, corner in zip(
                head.feature_points.names, head.feature_points.corners, strict=True
            )
            if part_of_vertex.get(int(corner[0])) == part
        ]
        if not on_part:
            continue
        triangles = mesh.triangles[mesh.groups[part]]
        wanted = np.array([head.points[name] for name in on_part])
        _, triangle, b = RayScene(mesh.vertices, triangles).closest(wanted)
        names += on_part
        corners.append(triangles[triangle])
        barycentric.append(np.clip(b, 0, 1) / np.clip(b, 0, 1).sum(axis=1, keepdims=True))
    order = np.argsort([head.feature_points.names.index(name) for name in names])
    return SurfacePoints(
        tuple(names[i] for i in order),
        np.concatenate(corners)[order],
        np.concatenate(barycentric)[order],
    )
