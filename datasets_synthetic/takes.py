"""A marker take: who, what they did, and where every marker was. No pictures yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.head_motion import HeadMotion
from ..core.markers import MarkerSet
from ..core.mesh import SurfacePoints, vertex_normals
from ..core.mpeg4 import N_FAPS, displacement_faps, fap_by_name, fap_table, rotation_faps
from ..core.rig import Rig
from ..heads.head import Head
from ..heads.identity import make_head, random_identity
from ..heads.marker_sets import glue_markers, ready_marker_set
from .performances import Performance, random_performance
from .rigs import face_rig

STICKER_MM = 0.2  # thickness of a dot: its face lies this far above the skin
DOT_RADIUS_MM = 1.6
LID_DOT_RADIUS_MM = 1.0
_LID_POINTS = ("3.1", "3.2", "3.3", "3.4")


@dataclass(frozen=True, eq=False)
class Take:
    """A performance before cameras, with its exact truth.

    Attributes
    ----------
    seed : int
    head : Head
    performance : Performance
    rig : Rig
    marker_set : MarkerSet
    glue : SurfacePoints
        Where the dots are glued.
    dot_radius_mm : (M,) float64
    """

    seed: int
    head: Head
    performance: Performance
    rig: Rig
    marker_set: MarkerSet
    glue: SurfacePoints
    dot_radius_mm: NDArray[np.float64]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(T,) float64, s."""
        return self.performance.weights.time_s

    @property
    def head_motion(self) -> HeadMotion:
        """World from head."""
        return self.performance.head_motion

    def vertices(self, frame: int) -> NDArray[np.float64]:
        """The actor's vertices at a frame, (V, 3) mm, head frame."""
        assert self.head.shapes is not None
        w = self.performance.weights.values[frame]
        used = np.flatnonzero(w)
        moved = np.tensordot(w[used].astype(np.float32), self.head.shapes[used], axes=1)
        return self.head.mesh.vertices + moved

    def markers(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres and unit normals of the dots, both (M, 3), in the vertices' frame."""
        n = self.glue.at(normals)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        return self.glue.at(vertices) + STICKER_MM * n, n


@dataclass(frozen=True, eq=False)
class Truth:
    """What a take's estimators should have found.

    Attributes
    ----------
    marker_positions : (T, M, 3) float64, mm, world
    feature_points : mapping from id to (T, 3) float64, mm, head frame
    faps : (T, 68) float64, table units
        NaN for FAPs that the head does not have.
    """

    marker_positions: NDArray[np.float64]
    feature_points: dict[str, NDArray[np.float64]]
    faps: NDArray[np.float64]


def make_take(seed: int, *, seconds: float = 4.0, rate_hz: float = 60.0) -> Take:
    """Cast an actor, write the performance, glue the markers, set up four cameras."""
    rng = np.random.default_rng(seed)
    head = make_head(random_identity(rng, f"actor-{seed}"))
    marker_set = ready_marker_set()
    radius = [
        LID_DOT_RADIUS_MM if m.feature_point in _LID_POINTS else DOT_RADIUS_MM
        for m in marker_set.markers
    ]
    return Take(
        seed=seed,
        head=head,
        performance=random_performance(rng, head, seconds=seconds, rate_hz=rate_hz),
        rig=face_rig(rng),
        marker_set=marker_set,
        glue=glue_markers(head, marker_set),
        dot_radius_mm=np.array(radius),
    )


def take_truth(take: Take) -> Truth:
    """Exact positions and FAPs of every frame."""
    T = len(take.time_s)
    triangles = take.head.mesh.triangles
    markers = np.empty((T, len(take.glue), 3))
    points = np.empty((T, len(take.head.feature_points), 3))
    for frame in range(T):
        v = take.vertices(frame)
        markers[frame], _ = take.markers(v, vertex_normals(v, triangles))
        points[frame] = take.head.feature_points.at(v)
    by_id = {n: points[:, i] for i, n in enumerate(take.head.feature_points.names)}
    return Truth(take.head_motion.world_from_head(markers), by_id, _truth_faps(take, by_id))


def _truth_faps(take: Take, points: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    moved = {name: p - take.head.points[name] for name, p in points.items()}
    found = np.full((len(take.time_s), N_FAPS), np.nan)
    numbers = {name: fap.number for name, fap in fap_by_name().items()}
    for name, values in displacement_faps(moved, take.head.fapu).items():
        found[:, numbers[name] - 1] = values
    # The eyeballs are turned by sculpted shapes; their angle is that of the foremost point.
    for number, side, fp in ((23, "left", "3.5"), (24, "right", "3.6")):
        d = points[fp] - take.head.eyes[side].centre
        rest = d[0]
        yaw = np.arctan2(d[:, 0], d[:, 2]) - np.arctan2(rest[0], rest[2])
        pitch = -np.arctan2(d[:, 1], d[:, 2]) + np.arctan2(rest[1], rest[2])
        unit = take.head.fapu.unit(fap_table()[number - 1])
        found[:, number - 1] = yaw / unit
        found[:, number + 1] = pitch / unit
        found[:, number + 3] = 0.0  # the eyeballs do not come forward
    found[:, 47:50] = rotation_faps(take.head_motion.rotation)
    return found
