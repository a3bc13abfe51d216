"""What cameras see of marker takes: bright markers on a dim face, exactly where truth says.

A marker is a polygon through the camera's own projection, and its share of each pixel is exact
(`discs`, `coverage`); the skin, a hand or hair hide parts of it tile by tile (`marker_painting`).
The face itself only has to be there: it is drawn dimly with a depth buffer (`dim_faces`).
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..heads.head import Head
from .dim_faces import draw_dimly
from .discs import Course, Discs, pictured_course
from .lens_light import apply_lens_light
from .marker_painting import Shining, join_shining, paint_shining
from .markers_on_faces import DOT_LIGHT, SPHERE_LIGHT, GluedMarkers, Lights, Room
from .mesh_pictures import lambert
from .optics import Optics, Sensor, flash_rows
from .sensor import develop
from .shots import KEY_LIGHT, ActorLooks, Scene, Shot, times_around

if TYPE_CHECKING:
    from .actor import Pose

__all__ = [
    "DOT_LIGHT",
    "SPHERE_LIGHT",
    "GluedMarkers",
    "Lights",
    "MarkerFilmer",
    "MarkerView",
    "Room",
]

Floats = NDArray[np.float64]

#: Skin this much nearer than a dot is the patch it is glued to, bent up around it.
STICKER_TOLERANCE_MM = 2.4
SPHERE_TOLERANCE_MM = 0.3
_DOT_FLAT_SHARE = 0.55  # of a dot's light, at any angle; the rest goes with the cosine
_SCENES_KEPT = 24


@dataclass(frozen=True, eq=False)
class MarkerView:
    """One picture and what is true of it.

    A frame's time is the middle of the middle row's exposure; with a rolling shutter each marker
    is where it is when its row is exposed.

    Attributes
    ----------
    image : (h, w) uint8
    centres : (M, 2) float64, px
        Projections of the markers' centres in space; NaN behind the camera.
    outlines : (M, 2) float64, px
        Centroids of the light of the markers' pictures as the lens makes them, if nothing hid
        them: perspective, distortion, exposure and vignetting included. NaN for dots that face
        away.
    visible : (M,) float64
        Share of each marker's picture that is unhidden and inside; 0 for dots facing away.
    extra_centres, extra_outlines, extra_visible : likewise
        Of the room's lights.
    """

    image: NDArray[np.uint8]
    centres: Floats
    outlines: Floats
    visible: Floats
    extra_centres: Floats
    extra_outlines: Floats
    extra_visible: Floats


class MarkerFilmer:
    """Films a marker take, a camera and a frame at a time.

    One for a take; cameras whose frames have equal times share what does not depend on the camera.
    Views may be asked for in several threads at once, a generator each; the callables handed in
    are called by one of them at a time.

    Parameters
    ----------
    head : Head or None
        None for a room without an actor.
    markers : GluedMarkers or None
        None for a face without markers.
    cameras, optics, sensors : mappings from name
    room : Room
    """

    def __init__(
        self,
        head: Head | None,
        markers: GluedMarkers | None,
        cameras: Mapping[str, Camera],
        optics: Mapping[str, Optics],
        sensors: Mapping[str, Sensor],
        *,
        room: Room | None = None,
    ) -> None:
        if markers is not None and head is None:
            raise ValueError("markers need a head to be glued on")
        for name in cameras:
            if name not in optics or name not in sensors:
                raise ValueError(f"optics and sensors must hold camera {name}")
        self.room = Room() if room is None else room
        for name, picture in self.room.backdrops.items():
            size = cameras[name].image_size
            if picture.shape != size[::-1]:
                raise ValueError(f"backdrop of {name} must be {size[::-1]}, got {picture.shape}")
        self.cameras = MappingProxyType(dict(cameras))
        self._optics, self._sensors = dict(optics), dict(sensors)
        self._actor = ActorLooks(head, markers) if head is not None else None
        self._markers = markers
        self._kept: OrderedDict[float, Scene] = OrderedDict()
        self._pose_at: Callable[[float], Pose] | None = None
        self._lock = threading.Lock()

    def view(
        self,
        name: str,
        pose_at: Callable[[float], Pose] | None,
        time_s: float,
        rng: np.random.Generator,
        *,
        camera: Camera | None = None,
    ) -> MarkerView:
        """What a camera sees.

        Parameters
        ----------
        name : str
            The camera.
        pose_at : callable
            The actor at a time, s; None without one.
        time_s : float, s
            Time of the frame.
        rng : numpy Generator
            For the noise.
        camera : Camera, optional
            In place of the camera of that name: one that was knocked, for example.
        """
        light, truth = self.light(name, pose_at, time_s, camera=camera)
        image = develop(light, self._sensors[name], rng)
        n = len(self._markers) if self._markers is not None else 0
        return MarkerView(
            image,
            *(values[:n] for values in truth),
            *(values[n:] for values in truth),
        )

    def light(
        self,
        name: str,
        pose_at: Callable[[float], Pose] | None,
        time_s: float,
        *,
        camera: Camera | None = None,
    ) -> tuple[NDArray[np.float32], tuple[Floats, Floats, Floats]]:
        """What falls on a camera's sensor.

        Parameters are those of `view`.

        Returns
        -------
        (h, w) float32
            Linear light at gain 1.
        ((M + K, 2), (M + K, 2), (M + K,)) float64
            Centres, outlines and visible shares of the markers and the room's lights.
        """
        if (pose_at is None) != (self._actor is None):
            raise ValueError("pose_at must be given with a head, and only then")
        optics = self._optics[name]
        scenes = self._scenes(pose_at, times_around(optics, time_s))
        shot = Shot(camera or self.cameras[name], optics, time_s, scenes)
        meshes = shot.meshes(0.0)
        bare = draw_dimly(self._backdrop(name, shot), shot, meshes, self._shades(shot.middle))
        level = bare.copy()
        shining = join_shining([*self._glued(shot), *_lights(shot)])
        outlines, visible = paint_shining(level, bare, shot, shining, meshes)
        centres = pictured_course(shot.camera, optics, shining.discs.centres)
        level = apply_lens_light(level, optics, shot.camera, psf=False)
        if self.room.flash is not None:
            height = shot.camera.image_size[1]
            level = level * flash_rows(self.room.flash, optics, height, time_s)
        return level, (centres, outlines, visible)

    def _scenes(
        self, pose_at: Callable[[float], Pose] | None, times_s: tuple[float, ...]
    ) -> tuple[Scene, ...]:
        with self._lock:
            if pose_at != self._pose_at:
                self._kept.clear()
                self._pose_at = pose_at
            return tuple(self._scene(pose_at, t) for t in times_s)

    def _scene(self, pose_at: Callable[[float], Pose] | None, time_s: float) -> Scene:
        if time_s in self._kept:
            self._kept.move_to_end(time_s)
            return self._kept[time_s]
        room, actor = self.room, None
        if self._actor is not None and pose_at is not None:
            actor = self._actor.at(pose_at(time_s).world_vertices)
        occluder = room.occluder(time_s) if room.occluder is not None else None
        lights = room.lights(time_s) if room.lights is not None else None
        scene = Scene(actor, occluder, lights)
        self._kept[time_s] = scene
        if len(self._kept) > _SCENES_KEPT:
            self._kept.popitem(last=False)
        return scene

    def _backdrop(self, name: str, shot: Shot) -> NDArray[np.float32]:
        backdrop = self.room.backdrops.get(name)
        if backdrop is not None:
            return backdrop
        width, height = shot.camera.image_size
        return np.full((height, width), self.room.background, np.float32)

    def _shades(self, scene: Scene) -> list[NDArray[np.float32]]:
        """Light from the vertices of the scene's meshes."""
        shades: list[NDArray[np.float32]] = []
        if scene.actor is not None:
            shades.append(scene.actor.shade * np.float32(self.room.skin))
        if scene.occluder is not None:
            vertices, triangles = scene.occluder
            matte = np.full(len(vertices), self.room.occluder_light, np.float32)
            triangles = np.ascontiguousarray(triangles, dtype=np.int32)
            shades.append(lambert(np.asarray(vertices), triangles, matte, KEY_LIGHT))
        return shades

    def _glued(self, shot: Shot) -> list[Shining]:
        """The markers in the camera's frame."""
        markers, actors = self._markers, [s.actor for s in shot.scenes if s.actor is not None]
        if markers is None or not actors:
            return []
        ones, is_sphere = np.ones(len(markers)), markers.kind == "spheres"
        centres = shot.course([a.centres for a in actors])
        # tips of the normals: a difference of places turns with the camera as a normal does
        tips = shot.course([a.centres + a.normals for a in actors])
        discs = Discs(
            centres, tips.minus(centres), markers.radius_mm, np.full(len(markers), is_sphere)
        )
        shares = _DOT_FLAT_SHARE + (1 - _DOT_FLAT_SHARE) * np.clip(discs.facing(), 0, 1)
        tolerance_mm = SPHERE_TOLERANCE_MM if is_sphere else STICKER_TOLERANCE_MM
        return [Shining(discs, markers.light * shares, tolerance_mm * ones)]


def _lights(shot: Shot) -> list[Shining]:
    """The room's lights in the camera's frame."""
    lights = [s.lights for s in shot.scenes if s.lights is not None]
    if not lights:
        return []
    middle = lights[len(lights) // 2]
    n = len(middle.radius_mm)
    centres = shot.course([x.centres for x in lights])
    discs = Discs(centres, Course.still(np.ones((n, 3))), middle.radius_mm, np.ones(n, bool))
    return [Shining(discs, middle.light, np.zeros(n))]
