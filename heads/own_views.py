"""The face on a bare mesh: the mesh is drawn, a network finds the face, its landmarks are lifted.

Nothing is known of the mesh but its triangles: neither unit, nor which way is up, nor where the
face looks. It is drawn from six sides in plain grey; the finder looks at each picture in all four
turns. What it sees best is looked at again from the front and from both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.mesh import vertex_normals
from ..core.rigid import Rigid
from .face_finder import FaceFinder, FoundFace
from .face_landmarks import N_LANDMARKS, NAMED_LANDMARKS, FaceRegion
from .raycast import NO_HIT, RayScene

#: Directions that the first six pictures are taken from, the usual ones first.
_SIDES = ((0, 0, 1), (0, -1, 0), (0, 0, -1), (0, 1, 0), (1, 0, 0), (-1, 0, 0))
#: A face seen this surely needs no look from other sides (`FoundFace.presence`).
_SURE_PRESENCE = 18.0
_PICTURE_PX = 448
_DISTANCE = 6.0  # in radii of what is drawn
_YAWS_RAD = (0.0, -0.35, 0.35)
_FACE_RADII = 1.5  # of the landmarks: how much is in the picture of a close look
_SKIN, _BACKGROUND = (196, 160, 140), (74, 82, 92)
_LIGHTS = (((-0.35, 0.5, 0.8), 0.62), ((0.6, 0.1, 0.6), 0.25), ((0.0, 0.0, 1.0), 0.22))
_AMBIENT = 0.1
#: Landmarks on skin turned further away than this (cosine) are on the outline and slip.
_LEAST_FACING = 0.4
#: What tells the face's axes; these are kept however they are turned.
_AXES_FROM = ("eye_right_inner", "eye_left_inner", "mouth_right", "mouth_left")
#: How far the tip of the nose must stand out before these, in parts of their extent.
_NOSE_STANDS_OUT = 0.1


@dataclass(frozen=True, eq=False)
class FaceOnMesh:
    """The network's landmarks on a surface.

    Attributes
    ----------
    points : (478, 3) float64, the mesh's frame and unit
        NaN where a landmark's ray meets no surface, or skin that is turned away.
    presence : float
        How surely it is a face: `FoundFace.presence`.
    """

    points: NDArray[np.float64]
    presence: float

    def __post_init__(self) -> None:
        points = readonly(self.points, (N_LANDMARKS, 3), "points")
        object.__setattr__(self, "points", points)


def find_face_on_mesh(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], finder: FaceFinder
) -> FaceOnMesh:
    """Find the face of a mesh in any unit and any position.

    Parameters
    ----------
    vertices : (V, 3) float64, any unit and axes
    triangles : (F, 3) int32
        Counter-clockwise or clockwise seen from outside, but all alike.
    finder : FaceFinder

    Raises
    ------
    InputError
        If no face is seen from any side.
    """
    scene = _Drawn(vertices, triangles)
    best: FaceOnMesh | None = None
    for side in _SIDES:
        for up in _upwards(side):
            camera = scene.camera(scene.centre, scene.radius, np.array(side, float), up)
            face = scene.look(camera, finder)
            if face is not None and (best is None or face.presence > best.presence):
                best = face
        if best is not None and best.presence > _SURE_PRESENCE:
            break
    if best is None:
        raise InputError("no face is seen on the mesh from any side")
    for _ in range(2):  # the second time from the front that the first has found
        best = _looked_closely(scene, best, finder)
    return best


def _upwards(side: tuple[int, int, int]) -> list[NDArray[np.float64]]:
    """Four ways to hold the camera: a face that lies on its side is taken for another, unsurely."""
    up = np.array((0.0, 1.0, 0.0) if side[1] == 0 else (0.0, 0.0, 1.0))
    right = np.cross(up, np.array(side, float))
    return [up, right, -up, -right]


def _looked_closely(scene: _Drawn, face: FaceOnMesh, finder: FaceFinder) -> FaceOnMesh:
    """The mean of landmarks seen from the front and from both sides."""
    known = face.points[np.isfinite(face.points).all(axis=1)]
    centre = (known.min(axis=0) + known.max(axis=0)) / 2
    reach = float(np.linalg.norm(known - centre, axis=1).max())
    right, up, ahead = _axes(face.points)
    seen = []
    for yaw in _YAWS_RAD:
        towards = np.cos(yaw) * ahead - np.sin(yaw) * right
        camera = scene.camera(centre, _FACE_RADII * reach, towards, up)
        closer = scene.look_closely(camera, finder)
        if closer is not None:
            seen.append(closer)
    if not seen:
        return face
    stack = np.stack([one.points for one in seen])
    count = np.isfinite(stack[..., 0]).sum(axis=0)
    total = np.where(np.isfinite(stack), stack, 0.0).sum(axis=0)
    points = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan)
    return FaceOnMesh(points, max(one.presence for one in seen))


def _axes(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The face's own axes: to its right, up, out of it."""

    eye_right, eye_left, mouth_right, mouth_left = (
        points[NAMED_LANDMARKS[name]] for name in _AXES_FROM
    )
    right = eye_right - eye_left
    right /= np.linalg.norm(right)
    up = (eye_right + eye_left) / 2 - (mouth_right + mouth_left) / 2
    up -= (up @ right) * right
    up /= np.linalg.norm(up)
    return right, up, np.cross(up, right)


def _is_solid(points: NDArray[np.float64], camera: Camera) -> bool:
    """Whether the nose comes towards the camera: a mask seen from behind looks like a face too."""
    rows = [NAMED_LANDMARKS[name] for name in _AXES_FROM]
    tip = points[NAMED_LANDMARKS["nose_tip"]]
    if not np.isfinite(tip).all():
        return False
    ahead = camera.camera_from_world.rotation[2]
    extent = float(np.linalg.norm(np.ptp(points[rows], axis=0)))
    return bool((points[rows].mean(axis=0) - tip) @ ahead > _NOSE_STANDS_OUT * extent)


class _Drawn:
    """A mesh that can be drawn."""

    def __init__(self, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
        used = np.unique(triangles)
        low, high = vertices[used].min(axis=0), vertices[used].max(axis=0)
        self.centre = (low + high) / 2
        self.radius = float(np.linalg.norm(vertices[used] - self.centre, axis=1).max())
        self._triangles = triangles
        self._unit = self.radius / 100.0  # the caster is in single precision
        self._vertices = (vertices - self.centre) / self._unit
        self._normals = vertex_normals(self._vertices, triangles)
        self._scene = RayScene(self._vertices, triangles)

    def camera(
        self,
        centre: NDArray[np.float64],
        radius: float,
        towards: NDArray[np.float64],
        up: NDArray[np.float64],
    ) -> Camera:
        """A camera that looks at a ball from the direction `towards`; in the scene's units."""
        right = np.cross(up, towards)
        R = np.stack([right, -up, -towards])
        place = (centre - self.centre + _DISTANCE * radius * towards) / self._unit
        focal = 0.5 * _PICTURE_PX * _DISTANCE
        middle = (_PICTURE_PX - 1) / 2
        K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
        return Camera((_PICTURE_PX, _PICTURE_PX), K, Rigid.from_rotation(R, -R @ place))

    def look(self, camera: Camera, finder: FaceFinder) -> FaceOnMesh | None:
        """The surest face in a picture of the mesh, lifted onto it; None if there is none."""
        found = finder.find(self._picture(camera))
        if not found:
            return None
        return self._on_mesh(camera, max(found, key=lambda one: one.presence))

    def look_closely(self, camera: Camera, finder: FaceFinder) -> FaceOnMesh | None:
        """The face in a picture that it fills, upright; None if it is not there."""
        picture = self._picture(camera)
        middle = np.full(2, (_PICTURE_PX - 1) / 2)
        face = finder.follow(picture, FaceRegion(middle, float(_PICTURE_PX), 0.0))
        if face is not None:
            face = finder.follow(picture, face.region)
        return None if face is None else self._on_mesh(camera, face)

    def _on_mesh(self, camera: Camera, face: FoundFace) -> FaceOnMesh | None:
        points, facing = self._lifted(camera, face.landmarks_px[:, :2])
        kept = facing >= _LEAST_FACING
        kept[[NAMED_LANDMARKS[name] for name in (*_AXES_FROM, "nose_tip")]] = True
        points[~kept] = np.nan
        named = points[[NAMED_LANDMARKS[name] for name in _AXES_FROM]]
        if not np.isfinite(named).all() or np.isfinite(points[:, 0]).sum() < N_LANDMARKS // 3:
            return None
        if not _is_solid(points, camera):
            return None
        return FaceOnMesh(points * self._unit + self.centre, face.presence)

    def _lifted(
        self, camera: Camera, pixels: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where the rays through pixels meet the mesh, scene's units; how far it faces them."""
        rays = camera.ray(pixels)
        t, triangle, uv = self._scene.cast(camera.position, rays)
        hit = triangle != NO_HIT
        points = np.where(hit[:, None], camera.position + t[:, None] * rays, np.nan)
        normals = self._normals_at(np.where(hit, triangle, 0), uv)
        return points, np.where(hit, np.abs((normals * rays).sum(axis=1)), 0.0)

    def _normals_at(
        self, triangle: NDArray[np.uint32], uv: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        b = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        n = np.einsum("nc,ncx->nx", b, self._normals[self._triangles[triangle]])
        return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12))

    def _picture(self, camera: Camera) -> NDArray[np.uint8]:
        """(h, w, 3) uint8, sRGB: plain skin under three lights that go with the camera."""
        width, height = camera.image_size
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        rays = camera.ray(np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64))
        _, triangle, uv = self._scene.cast(camera.position, rays)
        hit = triangle != NO_HIT
        normals = self._normals_at(np.where(hit, triangle, 0), uv)
        away = (normals * rays).sum(axis=1) > 0  # inside-out meshes look like others
        normals[away] *= -1
        seen = normals @ camera.camera_from_world.rotation.T * (1, -1, -1)
        light = np.full(len(rays), _AMBIENT)
        for direction, strength in _LIGHTS:
            towards = np.array(direction) / np.linalg.norm(direction)
            light += strength * np.maximum(seen @ towards, 0.0)
        colour = np.clip(light[:, None] * np.array(_SKIN), 0, 255)
        picture = np.where(hit[:, None], colour, np.array(_BACKGROUND))
        return np.asarray(picture.reshape(height, width, 3).astype(np.uint8))
