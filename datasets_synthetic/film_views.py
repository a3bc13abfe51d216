"""A take's pictures, whichever kind of take it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..heads.hair_strands import loose_strands
from ..heads.stage_lights import StageLights
from .hands import random_gesture
from .marker_views import MarkerFilmer, Room
from .markers_on_faces import Triangles
from .optics import Flash
from .plain_views import PlainFilmer, Scenery
from .takes import Take

FLASH_STRENGTH, FLASH_DECAY_S = 3.0, 0.03
_DIM = 0.35  # of the room's light, where markers shine


@dataclass(frozen=True, eq=False)
class Filmed:
    """One picture and what is true of it.

    Attributes
    ----------
    image : (h, w) or (h, w, 3) uint8
    centres, outlines : (K, 2) float64, px
        Of markers, of a wand's balls, or of a plain take's feature points (which have no outlines:
        the same).
    visible : (K,) float64
        Unhidden shares.
    """

    image: NDArray[np.uint8]
    centres: NDArray[np.float64]
    outlines: NDArray[np.float64]
    visible: NDArray[np.float64]


class Views(Protocol):
    """What films a take. Frames of one camera are asked for in turn."""

    #: Whether several cameras may be filmed at the same time.
    in_threads: bool

    def film(self, name: str, time_s: float, rng: np.random.Generator) -> Filmed:
        """A camera's picture at a world time."""


def open_views(take: Take) -> Views:
    """What films a take."""
    return _PlainViews(take) if take.settings.kind == "plain" else _MarkerViews(take)


def flash_of(take: Take) -> Flash | None:
    """How many times brighter a flash makes everything: at once, then dying away."""
    start_s = take.flash_s
    if start_s is None:
        return None

    def factor(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        late = np.maximum(time_s - start_s, 0.0)
        return np.where(time_s < start_s, 1.0, 1 + FLASH_STRENGTH * np.exp(-late / FLASH_DECAY_S))

    return factor


class _MarkerViews:
    in_threads = True

    def __init__(self, take: Take) -> None:
        self._take = take
        is_wand = take.wand is not None
        room = Room(
            backdrops=_backdrops(take),
            occluder=_occluder(take),
            lights=None if take.wand is None else take.wand.lights,
            flash=flash_of(take),
        )
        self._pose_at = None if is_wand else take.pose
        self._filmer = MarkerFilmer(
            None if is_wand else take.head,
            take.markers,
            take.rig.cameras,
            dict.fromkeys(take.rig, take.optics),
            dict.fromkeys(take.rig, take.sensor),
            room=room,
        )

    def film(self, name: str, time_s: float, rng: np.random.Generator) -> Filmed:
        camera = self._take.camera(name, time_s)
        view = self._filmer.view(name, self._pose_at, time_s, rng, camera=camera)
        if self._take.wand is not None:
            return Filmed(view.image, view.extra_centres, view.extra_outlines, view.extra_visible)
        return Filmed(view.image, view.centres, view.outlines, view.visible)


def _occluder(take: Take) -> Callable[[float], tuple[NDArray[np.float64], Triangles]] | None:
    """From a time to the mesh that hides parts of the face; None for none."""
    kind, rng = take.settings.scene.occluder, np.random.default_rng([take.seed, 8])
    if take.wand is not None or kind == "none":
        return None
    if kind == "hand":
        hand = random_gesture(rng, take.head)

        def hand_at(time_s: float) -> tuple[NDArray[np.float64], Triangles]:
            pose = take.pose(time_s)
            return hand.at(time_s, pose.vertices, pose.world_from_head), hand.triangles

        return hand_at
    hair = loose_strands(rng, take.head)

    def hair_at(time_s: float) -> tuple[NDArray[np.float64], Triangles]:
        pose = take.pose(time_s)
        return pose.world_from_head.apply(hair.at(pose.vertices)), hair.triangles

    return hair_at


def _backdrops(take: Take) -> dict[str, NDArray[np.float32]]:
    """The dim room behind a marker take that asks for clutter."""
    kind = take.settings.scene.background
    if kind == "dark":
        return {}
    from .backgrounds import Room as PaintedRoom

    room = PaintedRoom("clutter" if kind == "clutter" else "studio", take.seed)
    found = {}
    for name, camera in take.rig.cameras.items():
        light = room.seen_by(camera, take.optics).mean(axis=2)
        found[name] = (_DIM * light).astype(np.float32)
    return found


class _PlainViews:
    in_threads = False  # a frame is drawn by all cores already

    def __init__(self, take: Take) -> None:
        self._take = take
        scene = take.settings.scene
        light = np.random.default_rng([take.seed, 9])
        lights = (
            StageLights.random(light) if scene.light == "any" else StageLights.preset(scene.light)
        )
        occluders: dict[str, Literal["hand", "hair"] | None] = {
            "none": None, "hand": "hand", "hair": "hair",
        }  # fmt: skip
        self._filmer = PlainFilmer(
            take.head,
            take.rig.cameras,
            dict.fromkeys(take.rig, take.optics),
            dict.fromkeys(take.rig, take.sensor),
            scenery=Scenery(
                seed=take.seed,
                background="studio" if scene.background == "studio" else "clutter",
                lights=lights,
                occluder=occluders[scene.occluder],
                flash=flash_of(take),
            ),
        )

    def film(self, name: str, time_s: float, rng: np.random.Generator) -> Filmed:
        take = self._take
        view = self._filmer.view(name, take.pose, time_s, rng, camera=take.camera(name, time_s))
        return Filmed(
            view.image, view.landmarks, view.landmarks, view.landmarks_visible.astype(np.float64)
        )
