"""What a rig's cameras see of a marker take, as points: no pictures, minutes in seconds.

For studies of tracking and labelling over many takes. Markers are projected through the forward
camera model with noise; a marker is hidden where its skin looks away and where a hand passes, a
share of dots is dropped, and dots that are nobody's are put in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import vertex_normals
from ..core.rigid import Rigid
from .takes import Take

Floats = NDArray[np.float64]

_FACING = 0.2  # least cosine between a marker's normal and the way to the camera
#: The hand: a palm and four fingers, as capsules (from, to, radius), mm, about the palm's middle.
_HAND = (
    ((0.0, -25.0, 0.0), (0.0, 25.0, 0.0), 42.0),
    ((-30.0, 40.0, 0.0), (-42.0, 115.0, 0.0), 9.5),
    ((-10.0, 45.0, 0.0), (-14.0, 130.0, 0.0), 9.5),
    ((10.0, 45.0, 0.0), (14.0, 130.0, 0.0), 9.5),
    ((30.0, 40.0, 0.0), (40.0, 115.0, 0.0), 9.0),
)
_HAND_BEFORE_MM = (70.0, 120.0)  # how far before the eyes it passes
_HAND_WAY_MM = 260.0  # from side to side
#: What else shines: one spot that moves with the head (an ear-ring), one that stands in the room.
_EAR_RING_MM = (78.0, -55.0, -70.0)
_LAMP_MM = (-210.0, 90.0, -60.0)


@dataclass(frozen=True)
class Trouble:
    """What befalls the dots.

    Attributes
    ----------
    noise_px : float
        Standard deviation of each coordinate.
    dropped : float
        Share of dots that single pictures lack.
    lost : float
        Share of markers that all cameras lack at an instant.
    n_passes : int
        How often a hand crosses the face.
    ghosts_per_picture : float
        Dots at random places around the face, on average.
    lights : bool
        Whether an ear-ring and a lamp shine besides.
    """

    noise_px: float = 0.05
    dropped: float = 0.1
    lost: float = 0.0
    n_passes: int = 2
    ghosts_per_picture: float = 0.3
    lights: bool = True


@dataclass(frozen=True, eq=False)
class Sightings:
    """Dots by instant and camera, with whose they are.

    Attributes
    ----------
    time_s : (T,) float64
    markers : (T, M, 3) float64, mm, world frame
        The truth.
    centres : tuple, an instant each, of tuples, a camera each, of (N, 2) float64, px
    owners : the same of (N,) int64
        Index of the marker, −1 for nobody's.
    """

    time_s: Floats
    markers: Floats
    centres: tuple[tuple[Floats, ...], ...]
    owners: tuple[tuple[NDArray[np.int64], ...], ...]

    def n_seen(self) -> NDArray[np.int64]:
        """(T, M): cameras that see each marker."""
        found = np.zeros(self.markers.shape[:2], dtype=np.int64)
        for t, frame in enumerate(self.owners):
            for owners in frame:
                found[t, owners[owners >= 0]] += 1
        return found


@dataclass(frozen=True, eq=False)
class MarkerMotion:
    """Markers of a take at its beats, and where their skin looks.

    Attributes
    ----------
    time_s : (T,) float64
    markers, normals : (T, M, 3) float64, mm, world frame
    head_quaternion : (T, 4); head_translation : (T, 3), mm
        World from head.
    """

    time_s: Floats
    markers: Floats
    normals: Floats
    head_quaternion: Floats
    head_translation: Floats


def marker_motion(take: Take) -> MarkerMotion:
    """The exact motion of a take's markers (tens of milliseconds a beat).

    Raises
    ------
    ValueError
        If nothing is glued on the face.
    """
    if take.markers is None:
        raise ValueError("the take has no markers")
    rows: list[tuple[Floats, Floats, Floats, Floats]] = []
    for t in take.time_s:
        pose = take.pose(float(t))
        v = pose.world_vertices
        placed, normals = take.markers.places(v, vertex_normals(v, take.head.mesh.triangles))
        head = pose.world_from_head
        rows.append((placed, normals, head.quaternion, head.translation))
    markers, normals, q, t_mm = (np.stack(c) for c in zip(*rows, strict=True))
    return MarkerMotion(take.time_s, markers, normals, q, t_mm)


def sight_markers(
    take: Take, motion: MarkerMotion, trouble: Trouble, *, rng: np.random.Generator
) -> Sightings:
    """See a take's markers with all its cameras.

    Parameters
    ----------
    take : Take
        Whose rig and picture sizes are used; its clocks are not.
    motion : MarkerMotion
        Of it.
    trouble : Trouble
    rng : numpy Generator
    """
    passes = [_Pass.draw(rng, motion.time_s[-1]) for _ in range(trouble.n_passes)]
    cameras = {name: take.rig[name] for name in take.rig}
    centres, owners = [], []
    for i, time_s in enumerate(motion.time_s):
        head = Rigid(motion.head_quaternion[i], motion.head_translation[i])
        hands = [c for p in passes for c in p.capsules(float(time_s), head)]
        lost = np.asarray(rng.random(motion.markers.shape[1]) < trouble.lost)
        points, who = _shining(motion.markers[i], head, trouble)
        frame_centres, frame_owners = [], []
        for camera in cameras.values():
            eye = camera.position
            way = eye - points
            away = np.linalg.norm(way, axis=1)
            way = way / away[:, None]
            seen = np.asarray(rng.random(len(points)) >= trouble.dropped)
            n = len(motion.normals[i])
            faces_it = np.asarray((motion.normals[i] * way[:n]).sum(axis=1) > _FACING)
            seen[:n] &= faces_it & ~lost
            for a, b, radius in hands:
                seen &= _distance(points, eye, a, b) > radius
            xy = camera.project(points) + rng.normal(0, trouble.noise_px, (len(points), 2))
            size = np.array(camera.image_size)
            seen &= ((xy >= 0) & (xy <= size - 1)).all(axis=1)
            ghosts = _ghosts(rng, xy[:n], trouble.ghosts_per_picture)
            found = np.concatenate([xy[seen], ghosts])
            whose = np.concatenate([who[seen], np.full(len(ghosts), -1)]).astype(np.int64)
            order = rng.permutation(len(found))
            frame_centres.append(found[order])
            frame_owners.append(whose[order])
        centres.append(tuple(frame_centres))
        owners.append(tuple(frame_owners))
    return Sightings(motion.time_s, motion.markers, tuple(centres), tuple(owners))


def _shining(markers: Floats, head: Rigid, trouble: Trouble) -> tuple[Floats, NDArray[np.int64]]:
    who = np.arange(len(markers))
    if not trouble.lights:
        return markers, who
    more = np.stack([head.apply(np.array(_EAR_RING_MM)), np.array(_LAMP_MM)])
    return np.concatenate([markers, more]), np.append(who, (-1, -1))


def _ghosts(rng: np.random.Generator, around: Floats, mean: float) -> Floats:
    low, high = np.nanmin(around, axis=0), np.nanmax(around, axis=0)
    return np.asarray(rng.uniform(low, high, size=(rng.poisson(mean), 2)))


@dataclass(frozen=True)
class _Pass:
    """A hand that goes by before a face."""

    start_s: float
    lasts_s: float
    height_mm: float
    before_mm: float
    tilt_rad: float
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float) -> _Pass:
        lasts = float(rng.uniform(0.5, 1.4))
        return cls(
            float(rng.uniform(0.4, max(seconds - lasts, 0.5))),
            lasts,
            float(rng.uniform(-100, 10)),
            float(rng.uniform(*_HAND_BEFORE_MM)),
            float(rng.uniform(-0.6, 0.6)),
            float(rng.choice([-1.0, 1.0])),
        )

    def capsules(self, time_s: float, head: Rigid) -> list[tuple[Floats, Floats, float]]:
        u = (time_s - self.start_s) / self.lasts_s
        if not 0 <= u <= 1:
            return []
        middle = np.array(
            [self.side * (u - 0.5) * 2 * _HAND_WAY_MM, self.height_mm, self.before_mm]
        )
        c, s = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return [
            (head.apply(turn @ np.array(a) + middle), head.apply(turn @ np.array(b) + middle), r)
            for a, b, r in _HAND
        ]


def _distance(points: Floats, eye: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) least distances between the segments from points to an eye and the segment a b."""
    d1, d2 = eye - points, b - a
    r = points - a
    A, E = (d1**2).sum(axis=1), float(d2 @ d2)
    f, c, m = r @ d2, (d1 * r).sum(axis=1), d1 @ d2
    det = np.maximum(A * E - m * m, 1e-9)
    s = np.clip((m * f - c * E) / det, 0, 1)
    t = np.clip((m * s + f) / E, 0, 1)
    s = np.clip((m * t - c) / A, 0, 1)
    gap = points + s[:, None] * d1 - (a + t[:, None] * d2)
    return np.asarray(np.linalg.norm(gap, axis=1))
