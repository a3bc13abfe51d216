"""One camera at one frame: what is there around the frame's time, and where it is pictured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.mesh import SurfacePoints, vertex_normals
from ..heads.head import Head
from .discs import Course, pixels_of, row_delay_s
from .markers_on_faces import GluedMarkers, Lights
from .mesh_pictures import SeenMesh, lambert
from .optics import Optics

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

_MESH_ROW_STEPS = 2
KEY_LIGHT = np.array([0.36, 0.48, 0.8])  # unit vector to the lamp, world
_PART_ALBEDO = {
    "skin": 1.0,
    "eye_right": 1.3,
    "eye_left": 1.3,
    "lashes": 0.3,
    "teeth_upper": 1.2,
    "teeth_lower": 1.2,
    "tongue": 0.8,
}


@dataclass(frozen=True, eq=False)
class ActorAt:
    """An actor at one time: vertices, triangles; the markers' centres and normals; mm, world."""

    vertices: Floats
    triangles: Triangles
    albedo: NDArray[np.float32]
    centres: Floats
    normals: Floats

    @cached_property
    def shade(self) -> NDArray[np.float32]:
        """(V,) light from the vertices, of that of skin that faces the lamp."""
        return lambert(self.vertices, self.triangles, self.albedo, KEY_LIGHT)


@dataclass(frozen=True, eq=False)
class Scene:
    """All that is there at one time."""

    actor: ActorAt | None
    occluder: tuple[Floats, Triangles] | None
    lights: Lights | None


class ActorLooks:
    """What of a head's drawing and of its markers does not change."""

    def __init__(self, head: Head, markers: GluedMarkers | None) -> None:
        mesh = head.mesh
        albedo = np.ones(len(mesh.vertices), np.float32)
        for part, rows in mesh.groups.items():
            albedo[mesh.triangles[rows]] = _PART_ALBEDO.get(part, 1.0)
        self._albedo = albedo
        # lashes are thin hair, which does not hide a dot; as solid strips they would
        lashes = mesh.groups.get("lashes", np.zeros(0, np.int32))
        self._triangles = np.ascontiguousarray(np.delete(mesh.triangles, lashes, axis=0))
        self._markers = markers
        if markers is not None:
            around = np.isin(mesh.triangles, markers.glue.corners).any(axis=1)
            near, flat = np.unique(mesh.triangles[around], return_inverse=True)
            self._near = near
            self._near_triangles = flat.reshape(-1, 3).astype(np.int32)
            place = np.full(len(mesh.vertices), -1, np.int32)
            place[near] = np.arange(len(near))
            corners = place[markers.glue.corners]
            glue = SurfacePoints(markers.glue.names, corners, markers.glue.barycentric)
            self._near_markers = GluedMarkers(glue, markers.kind, markers.radius_mm, markers.light)

    def at(self, vertices: Floats) -> ActorAt:
        """An actor whose vertices are (V, 3), mm, world."""
        centres = normals = np.zeros((0, 3))
        if self._markers is not None:
            near = vertices[self._near]
            centres, normals = self._near_markers.places(
                near, vertex_normals(near, self._near_triangles)
            )
        return ActorAt(vertices, self._triangles, self._albedo, centres, normals)


@dataclass(frozen=True, eq=False)
class Shot:
    """One camera at one frame.

    Attributes
    ----------
    camera : Camera
    optics : Optics
    time_s : float, s
        The frame's.
    scenes : tuple of Scene
        At the times that `times_around` gives.
    """

    camera: Camera
    optics: Optics
    time_s: float
    scenes: tuple[Scene, ...]

    @property
    def middle(self) -> Scene:
        """The scene at the frame's time."""
        return self.scenes[len(self.scenes) // 2]

    def course(self, points: list[Floats]) -> Course:
        """Through points of the scenes, (..., 3) mm, world, in the camera's frame."""
        pose = self.camera.camera_from_world
        if len(points) < 3:
            return Course.still(points[0]).turned(pose.rotation, pose.translation)
        half_s = half_time_s(self.optics)
        course = Course.through(points[0], points[1], points[2], half_s)
        return course.turned(pose.rotation, pose.translation)

    def meshes(self, late_s: float) -> list[SeenMesh]:
        """The actor's mesh, then the occluder's, as seen at an instant of the rows' exposure."""
        found = []
        actors = [s.actor for s in self.scenes if s.actor is not None]
        if actors:
            course = self.course([a.vertices for a in actors])
            found.append(self._seen(course, late_s, actors[0].triangles, is_closed=True))
        if self.middle.occluder is not None:
            points, triangles = self.middle.occluder
            there = [s.occluder[0] for s in self.scenes if s.occluder is not None]
            # what comes or goes within the exposure stands still in it
            course = self.course(there if len(there) == len(self.scenes) else [points])
            triangles = np.ascontiguousarray(triangles, dtype=np.int32)
            found.append(self._seen(course, late_s, triangles, is_closed=False))
        return found

    def _seen(
        self, course: Course, late_s: float, triangles: Triangles, *, is_closed: bool
    ) -> SeenMesh:
        points = course.at(late_s)
        pixels = pixels_of(self.camera, points)
        rolling = self.optics.readout_s > 0 and not course.is_still
        for _ in range(_MESH_ROW_STEPS if rolling else 0):
            delay = row_delay_s(self.camera, self.optics, np.nan_to_num(pixels[:, 1]))
            points = course.at(late_s + delay)
            pixels = pixels_of(self.camera, points)
        return SeenMesh(pixels, np.ascontiguousarray(points[:, 2]), triangles, is_closed)


def half_time_s(optics: Optics) -> float:
    """Half of the time from the first row's first light to the last row's last."""
    return (optics.exposure_s + optics.readout_s) / 2


def times_around(optics: Optics, time_s: float) -> tuple[float, ...]:
    """Times at which a frame needs to know the scene: one, or before, at and after."""
    half_s = half_time_s(optics)
    return (time_s - half_s, time_s, time_s + half_s) if half_s > 0 else (time_s,)
