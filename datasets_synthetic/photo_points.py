"""Points that someone marks on a photograph and on the mesh of a head, as exactly as people do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.mesh import vertex_normals
from ..heads.head import Head
from ..heads.raycast import RayScene
from .photos import PhotoSettings

#: Farkas's landmarks that can be seen on a photograph (others are felt, or under hair).
MARKABLE = ("tr", "n", "prn", "c", "sn", "ls", "sto", "li", "sl", "pg", "gn")
MARKABLE_BOTH = (
    "en", "ex", "ps", "pi", "al", "ac", "sbal", "cph", "ch", "os", "sci", "go", "sa", "sba",
    "pra", "pa", "obs", "obi", "t",
)  # fmt: skip
_FACING = 0.05  # least cosine of a surface and the line of sight for a point to be marked
_HIDDEN_MM = 1.5  # a point this far behind what is seen is hidden
_MARGIN = 0.012  # of the picture's long side, free of marks


@dataclass(frozen=True, eq=False)
class MarkedPoints:
    """Corresponding points of a mesh and a photograph.

    Attributes
    ----------
    names : tuple of str, length N
        Farkas's, with ``_l`` and ``_r``.
    on_mesh : (N, 3) float64, mm
    on_photo : (N, 2) float64, px
    """

    names: tuple[str, ...]
    on_mesh: NDArray[np.float64]
    on_photo: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "on_mesh", readonly(self.on_mesh, (n, 3), "on_mesh"))
        object.__setattr__(self, "on_photo", readonly(self.on_photo, (n, 2), "on_photo"))


def visible_points(head: Head, camera: Camera) -> MarkedPoints:
    """The markable landmarks that a photograph shows, exactly.

    Parameters
    ----------
    head : Head
        With Farkas's landmarks.
    camera : Camera
        In the head's frame.
    """
    landmarks = head.mesh.landmarks
    if landmarks is None:
        raise ValueError(f"head {head.name} has no landmarks to mark")
    both = tuple(f"{name}_{side}" for name in MARKABLE_BOTH for side in "lr")
    chosen = landmarks.select(MARKABLE + both)
    vertices = np.asarray(head.mesh.vertices)
    solid = np.delete(np.asarray(head.mesh.triangles), head.mesh.groups.get("lashes", ()), axis=0)
    p = chosen.at(vertices)
    way = p - camera.position
    far = np.linalg.norm(way, axis=1)
    t, *_ = RayScene(vertices, solid).cast(camera.position, way)
    normals = chosen.at(vertex_normals(vertices, solid))
    facing = -(normals * way).sum(axis=1) / far / np.linalg.norm(normals, axis=1)
    at = camera.project(p)
    margin = _MARGIN * max(camera.image_size)
    with np.errstate(invalid="ignore"):
        inside = (at > margin).all(axis=1) & (at < np.array(camera.image_size) - margin).all(axis=1)
    seen = inside & (facing > _FACING) & ((1 - t) * far < _HIDDEN_MM)
    names = tuple(name for name, yes in zip(chosen.names, seen, strict=True) if yes)
    return MarkedPoints(names, p[seen], at[seen])


def spread_points(points: MarkedPoints, count: int) -> MarkedPoints:
    """At most `count` of the points, each as far as can be from those taken before it."""
    first = int(np.argmin(np.linalg.norm(points.on_mesh - points.on_mesh.mean(axis=0), axis=1)))
    rows = [first]
    apart = np.linalg.norm(points.on_mesh - points.on_mesh[first], axis=1)
    while len(rows) < min(count, len(points.names)):
        rows.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(points.on_mesh - points.on_mesh[rows[-1]], axis=1))
    names = tuple(points.names[row] for row in rows)
    return MarkedPoints(names, points.on_mesh[rows], points.on_photo[rows])


def mark_points(
    exact: MarkedPoints, head: Head, settings: PhotoSettings, rng: np.random.Generator
) -> MarkedPoints:
    """Points as a person marks them: normal noise on the photo, and along the mesh's surface."""
    skin = np.asarray(head.mesh.triangles)[head.mesh.groups["skin"]]
    vertices = np.asarray(head.mesh.vertices)
    n = len(exact.names)
    off_px = settings.mark_noise_px * rng.standard_normal((n, 2))
    off_mm = settings.mark_noise_mm * rng.standard_normal((n, 3))
    scene = RayScene(vertices, skin)
    _, triangle, b = scene.closest(exact.on_mesh)
    normal = np.einsum("nc,ncx->nx", b, vertex_normals(vertices, skin)[skin[triangle]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = off_mm - (off_mm * normal).sum(axis=1, keepdims=True) * normal
    _, triangle, b = scene.closest(exact.on_mesh + along)
    # the marks lie on the mesh to the last digit, not to single precision
    placed = np.einsum("nc,ncx->nx", b, vertices[skin[triangle]])
    return MarkedPoints(exact.names, placed, exact.on_photo + off_px)
