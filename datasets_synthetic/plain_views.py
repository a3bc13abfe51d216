"""Plain takes: what an ordinary camera sees of a person who sits in a room.

One instant is rendered a frame: head, bust, and what may pass before the face. Its flow spreads it
over exposure and read-out (`image_motion`), focus, lens and sensor follow, and the room stands
behind, painted once for each camera. Cameras of one frame share the light on the head.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.rigid import Rigid
from ..heads.bust import Bust, breath_at, make_bust
from ..heads.hair_strands import HairStrands, loose_strands
from ..heads.head import Head
from ..heads.layers import ExtraMesh, Layers
from ..heads.raycast import NO_HIT, RayScene
from ..heads.render import HeadRenderer
from ..heads.stage_lights import StageLights
from .actor import Pose
from .backgrounds import Room
from .focus_blur import blur_by_depth
from .hands import HandGesture, random_gesture
from .image_motion import (
    expose,
    half_span_s,
    in_threads,
    pixel_flow,
    row_time_points,
)
from .lens_light import apply_lens_light
from .optics import Flash, Optics, Sensor, flash_rows
from .sensor import develop

Floats = NDArray[np.float32]
PoseAt = Callable[[float], Pose]

_SHOULDER = 0.5  # of white: light above is compressed, as cameras' own curves do
_HIDDEN_MM = 1.0  # a landmark this far behind what is seen is hidden
_SHIRTS = (
    (54, 66, 92), (112, 38, 44), (46, 84, 70), (200, 198, 192), (38, 38, 42), (150, 128, 96),
    (92, 108, 128), (126, 76, 98), (196, 160, 84), (70, 110, 148),
)  # fmt: skip


@dataclass(frozen=True)
class Scenery:
    """What is around an actor's head.

    Attributes
    ----------
    seed : int
        Of room, shirt, hand and hair.
    background : "clutter" or "studio"
    lights : StageLights or None
        None for those of a studio.
    bust : bool
        Shoulders in a shirt; without, a head floats.
    shirt : sRGB triple 0 to 255, or None for one drawn by the seed
    sleeves : "long", "short", or None for one drawn by the seed
    occluder : "hand", "hair" or None
        What passes before, or hangs into, the face.
    breathing : bool
    flash : Flash or None
    world_from_seat : Rigid
        `world_from_head` of the actor sitting at rest: where bust, lights and room stand.
    """

    seed: int = 0
    background: Literal["clutter", "studio"] = "clutter"
    lights: StageLights | None = None
    bust: bool = True
    shirt: tuple[float, float, float] | None = None
    sleeves: Literal["long", "short"] | None = None
    occluder: Literal["hand", "hair"] | None = None
    breathing: bool = True
    flash: Flash | None = None
    world_from_seat: Rigid = field(default_factory=Rigid.identity)


@dataclass(frozen=True, eq=False)
class PlainView:
    """One picture and what is seen in it.

    Attributes
    ----------
    image : (h, w, 3) uint8, RGB
    landmarks : (N, 2) float64, px
        The head's feature points, each at the time of its row; NaN behind the camera.
    landmarks_visible : (N,) bool
        Inside the picture and unhidden in the middle of the exposure.
    """

    image: NDArray[np.uint8]
    landmarks: NDArray[np.float64]
    landmarks_visible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Shot:
    """The scene at a frame's time and at the ends of its span, all in the world frame."""

    time_s: float
    half_span: float
    head: NDArray[np.float64]
    extra: tuple[ExtraMesh, ...]
    points: NDArray[np.float64]  # (3, V, 3) mm: before, now, after; head, then extra meshes
    triangles: NDArray[np.int32]
    lashes: NDArray[np.int32]  # rows of `triangles` that hide nothing

    @cached_property
    def _scene(self) -> tuple[RayScene, NDArray[np.float64]]:
        """What is solid, about an origin near it: rays are cast in single precision."""
        origin = self.head.mean(axis=0)
        solid = np.delete(self.triangles, self.lashes, axis=0)
        return RayScene(self.points[1] - origin, solid), origin

    def hidden(self, points: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of points (N, 3) on the head something hides from a place (3,)."""
        scene, origin = self._scene
        way = points - eye
        t, _, _ = scene.cast(eye - origin, way)
        return np.asarray((1 - t) * np.linalg.norm(way, axis=1) > _HIDDEN_MM)


class PlainFilmer:
    """Films an actor without markers.

    Parameters
    ----------
    head : Head
    cameras : mapping from name to Camera
    optics : mapping from name to Optics
        Of every camera.
    sensors : mapping from name to Sensor
        Of every camera; a gamma of 2.2 makes pictures to be looked at.
    scenery : Scenery
    quick : bool
        One ray a pixel and more at edges; False takes four everywhere.

    Raises
    ------
    ValueError
        If a camera has no optics or sensor.
    """

    def __init__(
        self,
        head: Head,
        cameras: Mapping[str, Camera],
        optics: Mapping[str, Optics],
        sensors: Mapping[str, Sensor],
        *,
        scenery: Scenery | None = None,
        quick: bool = True,
    ) -> None:
        for what, given in (("optics", optics), ("sensors", sensors)):
            missing = [name for name in cameras if name not in given]
            if missing:
                raise ValueError(f"{what} must name every camera; {missing[0]} is missing")
        self.head = head
        self.cameras, self.optics, self.sensors = dict(cameras), dict(optics), dict(sensors)
        self.scenery = Scenery() if scenery is None else scenery
        s = self.scenery
        rng = np.random.default_rng([s.seed, 50])
        shirt = _SHIRTS[rng.integers(len(_SHIRTS))] if s.shirt is None else s.shirt
        sleeves = str(rng.choice(["long", "short"])) if s.sleeves is None else s.sleeves
        broadness, self._phase = float(rng.uniform(0.1, 1)), float(rng.uniform())
        self._bust: Bust | None = None
        if s.bust:
            self._bust = make_bust(
                head, shirt=shirt, sleeves=sleeves, broadness=broadness, seed=s.seed
            )
        self._hand: HandGesture | None = None
        if s.occluder == "hand":
            sleeve = shirt if sleeves == "long" else None
            self._hand = random_gesture(np.random.default_rng([s.seed, 51]), head, sleeve=sleeve)
        self._hair: HairStrands | None = None
        if s.occluder == "hair":
            self._hair = loose_strands(np.random.default_rng([s.seed, 52]), head)
        self._renderer = HeadRenderer(head, quick=quick, lights=s.lights, stage=s.world_from_seat)
        self._rooms: dict[str, Floats] = {}
        self._room = Room(s.background, s.seed)
        self._moved_room: tuple[Camera, Floats] | None = None
        self._kept: _Shot | None = None

    def view(
        self,
        name: str,
        pose_at: PoseAt,
        time_s: float,
        rng: np.random.Generator,
        *,
        camera: Camera | None = None,
    ) -> PlainView:
        """One camera's picture of one frame.

        Parameters
        ----------
        name : str
            Of the camera.
        pose_at : callable from time, s, to Pose
        time_s : float
            Middle of the middle row's exposure.
        rng : numpy Generator
            For the sensor's noise.
        camera : Camera, optional
            In place of the camera of that name: one that was knocked, for example.
        """
        optics = self.optics[name]
        if camera is None or camera is self.cameras[name]:
            camera, room = self.cameras[name], self.room(name)
        else:
            room = self._seen_room(camera, optics)
        shot = self._shot(pose_at, time_s, half_span_s(optics))
        layers = self._renderer.render_layers(shot.head, camera, extra=shot.extra)
        light = room.copy()
        if layers.light.size:
            layers = _padded(layers, camera, _reach_px(shot, layers, camera, optics))
            _expose_over(light, layers, shot, camera, optics)
        light = apply_lens_light(light, optics, camera)
        if self.scenery.flash is not None:
            light *= flash_rows(self.scenery.flash, optics, camera.image_size[1], time_s)[..., None]
        in_threads(_shoulder, (light,), light.shape[0])
        landmarks, visible = self._landmarks(shot, camera, optics)
        return PlainView(develop(light, self.sensors[name], rng), landmarks, visible)

    def room(self, name: str) -> Floats:
        """The empty room before a camera, (h, w, 3) float32, linear; made once and kept."""
        if name not in self._rooms:
            self._rooms[name] = self._seen_room(self.cameras[name], self.optics[name])
        return self._rooms[name]

    def _seen_room(self, camera: Camera, optics: Optics) -> Floats:
        """The empty room before a camera; the last is kept, for one that was knocked."""
        kept = self._moved_room
        if kept is not None and kept[0] is camera:
            return kept[1]
        seat = self.scenery.world_from_seat
        seated = replace(camera, camera_from_world=camera.camera_from_world @ seat)
        found = self._room.seen_by(seated, optics)
        found.flags.writeable = False
        self._moved_room = camera, found
        return found

    def centres(
        self,
        name: str,
        points_at: Callable[[float], NDArray[np.float64]],
        time_s: float,
    ) -> NDArray[np.float64]:
        """Where moving points are in a frame: each projected at the time of its own row.

        Parameters
        ----------
        name : str
            Of the camera.
        points_at : callable from time, s, to (N, 3) float, mm, world frame
        time_s : float

        Returns
        -------
        (N, 2) float64, px
        """
        return row_time_points(self.cameras[name], self.optics[name], points_at, time_s)

    def _shot(self, pose_at: PoseAt, time_s: float, half_span: float) -> _Shot:
        """The scene of a frame; the last is kept for the rig's other cameras."""
        kept = self._kept
        if kept is not None and kept.time_s == time_s and kept.half_span == half_span:
            return kept
        times = [time_s - half_span, time_s, time_s + half_span] if half_span else [time_s]
        poses = [pose_at(t) for t in times]
        worlds = [pose.world_vertices for pose in poses]
        moving = [self._extras(pose, t) for pose, t in zip(poses, times, strict=True)]
        middle = len(times) // 2
        extra = tuple(
            ExtraMesh(m[middle], triangles, colour.astype(np.float32), "world", roughness)
            for m, (triangles, colour, roughness) in zip(
                zip(*moving, strict=True), self._extra_looks(), strict=True
            )
        )
        points = [np.concatenate([w, *m]) for w, m in zip(worlds, moving, strict=True)]
        triangles = [np.asarray(self.head.mesh.triangles)]
        first = len(worlds[0])
        for mesh in extra:
            triangles.append(mesh.triangles + np.int32(first))
            first += len(mesh.vertices)
        self._kept = _Shot(
            time_s,
            half_span,
            worlds[middle],
            extra,
            np.stack(points if half_span else points * 3),
            np.ascontiguousarray(np.concatenate(triangles), dtype=np.int32),
            np.asarray(self.head.mesh.groups.get("lashes", np.zeros(0, np.int32))),
        )
        return self._kept

    def _extras(self, pose: Pose, time_s: float) -> list[NDArray[np.float64]]:
        """Vertices of what stands beside the head, world frame."""
        found = []
        seat = self.scenery.world_from_seat
        if self._bust is not None:
            breath = breath_at(time_s, self._phase) if self.scenery.breathing else 0.0
            found.append(
                self._bust.at(
                    pose.vertices, pose.world_from_head, breath=breath, world_from_bust=seat
                )
            )
        if self._hand is not None:
            found.append(
                self._hand.at(time_s, pose.vertices, pose.world_from_head, world_from_body=seat)
            )
        if self._hair is not None:
            found.append(pose.world_from_head.apply(self._hair.at(pose.vertices)))
        return found

    def _extra_looks(self) -> list[tuple[NDArray[np.int32], NDArray[np.float64], float]]:
        """Triangles, colours and roughness, in the order of `_extras`."""
        found = []
        if self._bust is not None:
            found.append((self._bust.triangles, self._bust.colour, 0.85))
        if self._hand is not None:
            found.append((self._hand.triangles, self._hand.colour, 0.6))
        if self._hair is not None:
            found.append((self._hair.triangles, self._hair.colour, 0.45))
        return found

    def _landmarks(
        self, shot: _Shot, camera: Camera, optics: Optics
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        points = self.head.feature_points.at(shot.points)
        before, now, after = (camera.project(p) for p in points)
        width, height = camera.image_size
        with np.errstate(invalid="ignore"):
            inside = (now > -0.5).all(axis=1) & (now < (width - 0.5, height - 0.5)).all(axis=1)
        visible = inside & ~shot.hidden(points[1], camera.position)
        if optics.readout_s == 0:
            return now, visible
        # a parabola through three poses; `centres` follows the points' own motion
        velocity, bend = (after - before) / 2, (after + before) / 2 - now
        found = now
        share = optics.readout_s / (2 * shot.half_span)
        for _ in range(8):
            s = share * (2 * np.clip(found[:, 1] / max(height - 1, 1), 0, 1) - 1)[:, None]
            found = now + velocity * s + bend * s * s
        return found, visible


def _depth(layers: Layers, shot: _Shot, camera: Camera) -> Floats:
    """Depth of every pixel of the layers' box, (h, w) float32, mm; NaN where nothing is."""
    z = camera.camera_from_world.apply(shot.points[1])[:, 2].astype(np.float32)
    found = np.full(layers.triangle.shape, np.nan, np.float32)
    in_threads(
        _spread_depth,
        (layers.triangle, layers.weights, shot.triangles, z, found),
        layers.triangle.shape[0],
    )
    return found


def _expose_over(
    behind: Floats, layers: Layers, shot: _Shot, camera: Camera, optics: Optics
) -> None:
    """Lay the person over the room as lens and shutter show them, in place."""
    light, cover = layers.light, layers.cover
    if optics.pupil_mm > 0:
        depth = _depth(layers, shot, camera)
        light, cover = blur_by_depth(light, cover, depth, optics, camera.focal_px)
    x0, y0, x1, y1 = layers.box
    if shot.half_span > 0:
        before, now, after = _projected(shot, layers, camera)
        flow = pixel_flow(
            layers.triangle, layers.weights, shot.triangles, before, now, after, shot.half_span
        )
        light, cover = expose(light, cover, flow, optics, camera.image_size[1], y0)
    in_threads(_lay_over, (behind[y0:y1, x0:x1], light, cover), y1 - y0)


def _projected(
    shot: _Shot, layers: Layers, camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pixels of the vertices at the span's ends and middle; of those that are seen."""
    seen = np.zeros(len(shot.triangles) + 1, bool)
    seen[np.minimum(layers.triangle.ravel(), len(shot.triangles))] = True
    rows = np.unique(shot.triangles[seen[:-1]])
    at = camera.project(shot.points[:, rows])
    found = np.zeros((3, shot.points.shape[1], 2))
    found[:, rows] = at
    return found[0], found[1], found[2]


def _reach_px(shot: _Shot, layers: Layers, camera: Camera, optics: Optics) -> int:
    """How far light may go within the frame: by motion, and by blur."""
    x0, y0, x1, y1 = layers.box
    now = camera.project(shot.points[1, ::11])
    seen = (now[:, 0] > x0) & (now[:, 0] < x1) & (now[:, 1] > y0) & (now[:, 1] < y1)
    if not seen.any():
        return 0
    reach = 0.0
    if shot.half_span > 0:
        before, after = (camera.project(shot.points[k, ::11][seen]) for k in (0, 2))
        ends = np.abs(np.stack([before - now[seen], after - now[seen]]))
        reach = 1.2 * float(np.nanmax(ends, initial=0.0))
    if optics.pupil_mm > 0:
        z = camera.camera_from_world.apply(shot.points[1, ::11][seen])[:, 2]
        ends_mm = float(z.min()), float(z.max())
        reach += max(optics.blur_diameter_px(d, camera.focal_px) for d in ends_mm)
    return int(np.ceil(reach)) + 2 if reach else 0


def _padded(layers: Layers, camera: Camera, reach: int) -> Layers:
    """Layers with room for motion around them, inside the picture."""
    width, height = camera.image_size
    x0, y0, x1, y1 = layers.box
    box = max(x0 - reach, 0), max(y0 - reach, 0), min(x1 + reach, width), min(y1 + reach, height)
    if box == layers.box:
        return layers
    pad = ((y0 - box[1], box[3] - y1), (x0 - box[0], box[2] - x1))
    return Layers(
        np.pad(layers.light, (*pad, (0, 0))),
        np.pad(layers.cover, pad),
        np.pad(layers.triangle, pad, constant_values=NO_HIT),
        np.pad(layers.weights, (*pad, (0, 0))),
        box,
    )


@njit(cache=True, nogil=True)
def _spread_depth(triangle, weights, triangles, z, out, first, last):  # type: ignore[no-untyped-def]
    for y in range(first, last):
        for x in range(triangle.shape[1]):
            f = triangle[y, x]
            if f != 4294967295:
                w1, w2 = weights[y, x, 0], weights[y, x, 1]
                out[y, x] = (
                    (1 - w1 - w2) * z[triangles[f, 0]]
                    + w1 * z[triangles[f, 1]]
                    + w2 * z[triangles[f, 2]]
                )


@njit(cache=True, nogil=True)
def _lay_over(behind, light, cover, first, last):  # type: ignore[no-untyped-def]
    for y in range(first, last):
        for x in range(cover.shape[1]):
            clear = 1 - cover[y, x]
            for k in range(3):
                behind[y, x, k] = light[y, x, k] + clear * behind[y, x, k]


@njit(cache=True, nogil=True)
def _shoulder(light, first, last):  # type: ignore[no-untyped-def]
    """As `heads.layers.film_curve`, in place."""
    for y in range(first, last):
        for x in range(light.shape[1]):
            for k in range(3):
                over = light[y, x, k] - np.float32(_SHOULDER)
                if over > 0:
                    room = np.float32(1 - _SHOULDER)
                    light[y, x, k] = np.float32(1) - room * np.exp(-over / room)
