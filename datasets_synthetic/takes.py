"""A take: who acts, what they do, who films it and when; and the exact truth. No pictures yet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.markers import MarkerSet
from ..core.mesh import vertex_normals
from ..core.mpeg4 import N_FAPS, displacement_faps, fap_by_name, fap_table, rotation_faps
from ..core.rig import Rig
from ..core.rigid import Rigid
from ..heads.catalogue import built_in_identity
from ..heads.head import Head
from ..heads.identity import make_head, random_identity
from ..heads.marker_sets import glue_markers, ready_marker_set
from .actor import Actor, Pose
from .clocks import CameraClock, FrameTimes, frame_times
from .markers_on_faces import DOT_LIGHT, SPHERE_LIGHT, GluedMarkers
from .optics import Optics, Sensor
from .performances import NEUTRAL_S
from .rigs import face_rig
from .scenes import SCENE_S, Scenes
from .strangeness import strange_head
from .take_settings import TakeSettings
from .take_sound import Clap
from .wand import Wand

LID_RADIUS_SHARE = 0.625  # of the other markers' radius: lids are small
_LID_POINTS = ("3.1", "3.2", "3.3", "3.4")
_CHILD_YEARS = 13.0


@dataclass(frozen=True)
class Knock:
    """A camera that is moved in mid-take.

    Attributes
    ----------
    camera : str
    time_s : float
        World time; from then on `after` is true.
    after : Camera
    """

    camera: str
    time_s: float
    after: Camera


@dataclass(frozen=True, eq=False)
class Take:
    """A performance before cameras, with its exact truth.

    Attributes
    ----------
    seed : int
    settings : TakeSettings
    head : Head
    rig : Rig
        Where the cameras stand at the start.
    clocks : mapping from camera name to CameraClock
    frames : mapping from camera name to FrameTimes
    marker_set : MarkerSet or None
    markers : GluedMarkers or None
    scenes : Scenes
    wand : Wand or None
        Waved before the cameras; then nobody acts.
    claps : tuple of Clap
    flash_s : float or None
        World time of the flash.
    knock : Knock or None
    """

    seed: int
    settings: TakeSettings
    head: Head
    rig: Rig
    clocks: Mapping[str, CameraClock]
    frames: Mapping[str, FrameTimes]
    marker_set: MarkerSet | None
    markers: GluedMarkers | None
    scenes: Scenes
    wand: Wand | None = None
    claps: tuple[Clap, ...] = ()
    flash_s: float | None = None
    knock: Knock | None = None

    @cached_property
    def actor(self) -> Actor:
        """The head in motion."""
        seconds = self.settings.seconds
        scene_s = SCENE_S if seconds > SCENE_S else float("inf")
        return Actor(self.head, self.scenes.performance, scene_s)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(T,) float64, s: the beats of the truth, on the world's clock."""
        rate_hz = self.settings.cameras.rate_hz
        return np.arange(round(self.settings.seconds * rate_hz)) / rate_hz

    def pose(self, time_s: float) -> Pose:
        """The actor at an instant of world time."""
        return self.actor.at(time_s)

    def camera(self, name: str, time_s: float) -> Camera:
        """A camera as it stands at an instant."""
        if self.knock is not None and self.knock.camera == name and time_s >= self.knock.time_s:
            return self.knock.after
        return self.rig[name]

    @property
    def optics(self) -> Optics:
        """Lens and shutter of every camera."""
        c = self.settings.cameras
        return Optics(
            exposure_s=c.exposure_s,
            readout_s=c.readout_s,
            pupil_mm=c.pupil_mm,
            psf_px=c.psf_px,
            vignetting=c.vignetting,
            ghost=c.ghost,
        )

    @property
    def sensor(self) -> Sensor:
        """Sensor of every camera."""
        c = self.settings.cameras
        if not c.noise:
            return Sensor(c.gain, float("inf"), 0.0, c.gamma)
        return Sensor(c.gain, c.full_well_e, c.read_noise_e, c.gamma)


@dataclass(frozen=True, eq=False)
class Truth:
    """What a take's estimators should have found, at some of its beats.

    Attributes
    ----------
    time_s : (T,) float64, s, world clock
    weights : (T, N) float64, ARKit weights
    head_quaternion : (T, 4) float64, wxyz; head_translation : (T, 3) float64, mm
        World from head.
    feature_points : mapping from id to (T, 3) float64, mm, head frame
    landmarks : mapping from name to (T, 3) float64, mm, head frame
        Farkas's.
    marker_positions : (T, M, 3) float64, mm, world frame
        Faces of dots, centres of spheres.
    marker_skin : (T, M, 3) float64, mm, world frame
        The skin that they are glued to.
    gaze : (T, 2, 2) float64, rad
        Yaw and pitch of the right and the left eye against the neutral; positive to the
        subject's left, and down.
    jaw_quaternion : (T, 4); jaw_translation : (T, 3) float64, mm, head frame
        The mandible against its rest.
    faps : (T, 68) float64, table units
        NaN for FAPs that the head does not have.
    """

    time_s: NDArray[np.float64]
    weights: NDArray[np.float64]
    head_quaternion: NDArray[np.float64]
    head_translation: NDArray[np.float64]
    feature_points: dict[str, NDArray[np.float64]]
    landmarks: dict[str, NDArray[np.float64]]
    marker_positions: NDArray[np.float64]
    marker_skin: NDArray[np.float64]
    gaze: NDArray[np.float64]
    jaw_quaternion: NDArray[np.float64]
    jaw_translation: NDArray[np.float64]
    faps: NDArray[np.float64]


def make_take(seed: int, settings: TakeSettings | None = None, *, rig: Rig | None = None) -> Take:
    """Cast an actor, write the performance, glue the markers, set up cameras and clocks.

    Parameters
    ----------
    seed : int
    settings : TakeSettings, optional
        By default what ``facewright demo`` films.
    rig : Rig, optional
        Cameras instead of those that the settings describe; the world is the head at rest.
    """
    settings = settings or TakeSettings()
    head, talker = _cast(seed, settings)
    marker_set = ready_marker_set(settings.markers.set) if settings.kind == "markers" else None
    cameras = settings.cameras
    rig = rig or face_rig(
        np.random.default_rng([seed, 3]),
        n_cameras=cameras.count,
        image_size=cameras.image_size,
        distortion=cameras.distortion,
    )
    clocks = _clocks(np.random.default_rng([seed, 4]), settings, rig.names)
    c = settings.clocks
    frames = {
        name: frame_times(
            np.random.default_rng([seed, 5, i]),
            clocks[name],
            seconds=settings.seconds,
            rate_hz=cameras.rate_hz,
            dropped=c.dropped,
            jitter=c.jitter_frames,
            stamps_tell=c.stamps_tell,
        )
        for i, name in enumerate(rig.names)
    }
    events = np.random.default_rng([seed, 6])
    return Take(
        seed=seed,
        settings=settings,
        head=head,
        rig=rig,
        clocks=clocks,
        frames=frames,
        marker_set=marker_set,
        markers=None if marker_set is None else _glued(head, marker_set, settings),
        scenes=Scenes(
            head,
            seed,
            seconds=settings.seconds,
            style=settings.performance.style,
            talker=talker if settings.performance.voice else None,
        ),
        wand=Wand.random(np.random.default_rng([seed, 10])) if settings.kind == "wand" else None,
        claps=_claps(events, settings),
        flash_s=NEUTRAL_S * float(events.uniform(0.3, 0.7)) if settings.events.flash else None,
        knock=_knock(events, settings, rig) if settings.events.knocked else None,
    )


def _cast(seed: int, settings: TakeSettings) -> tuple[Head, str]:
    """The actor, and what kind of voice suits them."""
    if settings.actor.head:
        identity = built_in_identity(settings.actor.head)
    else:
        years = (settings.actor.youngest_years, settings.actor.oldest_years)
        rng = np.random.default_rng([seed, 1])
        identity = random_identity(rng, f"actor-{seed}", age_years=years)
    # drawn by a seed of its own: everything else of the take stays
    strange = np.random.default_rng([seed, 11])
    head = strange_head(make_head(identity), strange, settings.actor.strangeness)
    if identity.age_years < _CHILD_YEARS:
        return head, "child"
    return head, "woman" if identity.female > 0.5 else "man"


def _glued(head: Head, marker_set: MarkerSet, settings: TakeSettings) -> GluedMarkers:
    is_lid = [m.feature_point in _LID_POINTS for m in marker_set.markers]
    radius = settings.markers.radius_mm * np.where(is_lid, LID_RADIUS_SHARE, 1.0)
    light = DOT_LIGHT if settings.markers.look == "dots" else SPHERE_LIGHT
    return GluedMarkers(
        glue_markers(head, marker_set),
        settings.markers.look,
        radius,
        np.full(len(marker_set.markers), light),
    )


def _clocks(
    rng: np.random.Generator, settings: TakeSettings, names: Sequence[str]
) -> dict[str, CameraClock]:
    """The first camera's clock is the world's."""
    c = settings.clocks
    offsets = rng.uniform(-1, 1, len(names)) * c.max_offset_s
    drifts = rng.uniform(-1, 1, len(names)) * c.max_drift_ppm * 1e-6
    offsets[0] = drifts[0] = 0.0
    return {
        n: CameraClock(float(o), float(d)) for n, o, d in zip(names, offsets, drifts, strict=True)
    }


def _claps(rng: np.random.Generator, settings: TakeSettings) -> tuple[Clap, ...]:
    """One at the start, the others anywhere."""
    n = settings.events.claps
    late = settings.clocks.max_offset_s  # every camera runs by then
    times = sorted(rng.uniform(late + 0.05, max(settings.seconds - late - 0.3, late + 0.2), n))
    if n:
        times[0] = late + 0.1
    return tuple(Clap(float(t), int(rng.integers(2**31))) for t in times)


def _knock(rng: np.random.Generator, settings: TakeSettings, rig: Rig) -> Knock:
    from scipy.spatial.transform import Rotation

    name = rig.names[int(rng.integers(len(rig.names)))]
    axis, way = rng.standard_normal((2, 3))
    axis, way = axis / np.linalg.norm(axis), way / np.linalg.norm(way)
    turn = Rotation.from_rotvec(np.deg2rad(settings.events.knock_deg) * axis).as_matrix()
    before = rig[name]
    moved = Rigid.from_rotation(turn, settings.events.knock_mm * way) @ before.camera_from_world
    time_s = settings.seconds * float(rng.uniform(0.4, 0.7))
    return Knock(name, time_s, replace(before, camera_from_world=moved))


def take_truth(take: Take, beats: slice | None = None) -> Truth:
    """Exact positions and FAPs at the take's beats, or at some of them."""
    time_s = take.time_s[beats or slice(None)]
    head, motion = take.head, take.actor.motion
    marks = head.mesh.landmarks
    assert marks is not None
    n = 0 if take.markers is None else len(take.markers.glue)
    rows: dict[str, list[NDArray[np.float64]]] = {}
    for t in time_s:
        pose = take.pose(float(t))
        placed, skin = np.empty((n, 3)), np.empty((n, 3))
        if take.markers is not None:
            v = pose.world_vertices
            placed, _ = take.markers.places(v, vertex_normals(v, head.mesh.triangles))
            skin = take.markers.glue.at(v)
        jaw, gaze = motion.jaw_pose(pose.weights), motion.gaze(pose.weights)
        here = {
            "weights": pose.weights,
            "head_quaternion": pose.world_from_head.quaternion,
            "head_translation": pose.world_from_head.translation,
            "points": head.feature_points.at(pose.vertices),
            "landmarks": marks.at(pose.vertices),
            "marker_positions": placed,
            "marker_skin": skin,
            "gaze": gaze,
            "jaw_quaternion": jaw.quaternion,
            "jaw_translation": jaw.translation,
        }
        for name, value in here.items():
            rows.setdefault(name, []).append(value)
    found = {name: np.stack(values) for name, values in rows.items()}
    points, landmarks = found.pop("points"), found.pop("landmarks")
    by_id = {name: points[:, i] for i, name in enumerate(head.feature_points.names)}
    return Truth(
        time_s=time_s,
        feature_points=by_id,
        landmarks={name: landmarks[:, i] for i, name in enumerate(marks.names)},
        faps=_truth_faps(take.head, by_id, found["gaze"], found["head_quaternion"]),
        **found,
    )


def _truth_faps(
    head: Head,
    points: Mapping[str, NDArray[np.float64]],
    gaze: NDArray[np.float64],
    head_quaternion: NDArray[np.float64],
) -> NDArray[np.float64]:
    from ..core.rigid import rotation_from_quaternion

    moved = {name: p - head.points[name] for name, p in points.items()}
    found = np.full((len(gaze), N_FAPS), np.nan)
    numbers = {name: fap.number for name, fap in fap_by_name().items()}
    for name, values in displacement_faps(moved, head.fapu).items():
        found[:, numbers[name] - 1] = values
    for number, eye in ((23, 1), (24, 0)):  # yaw of the left and the right eye
        unit = head.fapu.unit(fap_table()[number - 1])
        found[:, number - 1] = gaze[:, eye, 0] / unit
        found[:, number + 1] = gaze[:, eye, 1] / unit
        found[:, number + 3] = 0.0  # the eyeballs do not come forward
    found[:, 47:50] = rotation_faps(rotation_from_quaternion(head_quaternion))
    return found
