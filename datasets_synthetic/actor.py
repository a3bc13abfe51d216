"""An actor: a head that performs, at any instant."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.rigid import Rigid
from ..heads.head import Head
from .face_motion import FaceMotion
from .performances import Performance

_KEPT = 12  # poses


@dataclass(frozen=True, eq=False)
class Pose:
    """An actor at one instant.

    Attributes
    ----------
    time_s : float
    weights : (N,) float64
        Of the head's shapes.
    vertices : (V, 3) float64, mm, head frame
    world_from_head : Rigid
    """

    time_s: float
    weights: NDArray[np.float64]
    vertices: NDArray[np.float64]
    world_from_head: Rigid

    @property
    def world_vertices(self) -> NDArray[np.float64]:
        """(V, 3) float64, mm, world frame."""
        return self.world_from_head.apply(self.vertices)


class Actor:
    """A head and its performance, which is smooth between the performance's samples.

    Between samples the weights and the head's motion follow cubics through the four samples
    around (Catmull-Rom): that is the truth, at any instant. Before the first and after the last
    sample the actor stands still.

    Parameters
    ----------
    head : Head
    performance : Performance, or a function from a scene's number to one
        Long takes are acted scene by scene, each from neutral to neutral, so that memory does
        not grow with them.
    scene_s : float, s
        Length of a scene.
    """

    def __init__(
        self,
        head: Head,
        performance: Performance | Callable[[int], Performance],
        scene_s: float = math.inf,
    ) -> None:
        self.head = head
        self.motion = FaceMotion(head)
        self._scene_s = scene_s
        self._scenes = (
            (lambda _: performance) if isinstance(performance, Performance) else performance
        )
        self._samples: OrderedDict[int, _Samples] = OrderedDict()
        self._kept: OrderedDict[float, Pose] = OrderedDict()

    def at(self, time_s: float) -> Pose:
        """The actor at an instant; the last few are kept."""
        if time_s in self._kept:
            self._kept.move_to_end(time_s)
            return self._kept[time_s]
        scene = max(0, math.floor(time_s / self._scene_s))
        start_s = scene * self._scene_s if scene else 0.0
        row = self._samples_of(scene).at(time_s - start_s)
        n = len(self.head.shape_names)
        weights = np.clip(row[:n], 0, 1)
        pose = Pose(
            time_s, weights, self.motion.vertices(weights), Rigid(row[n : n + 4], row[n + 4 :])
        )
        self._kept[time_s] = pose
        if len(self._kept) > _KEPT:
            self._kept.popitem(last=False)
        return pose

    def _samples_of(self, scene: int) -> _Samples:
        if scene not in self._samples:
            performance = self._scenes(scene)
            if performance.weights.channels != self.head.shape_names:
                raise ValueError("a performance's channels must be the head's shapes, in order")
            self._samples[scene] = _Samples.of(performance)
            if len(self._samples) > 2:
                self._samples.popitem(last=False)
        return self._samples[scene]


@dataclass(frozen=True, eq=False)
class _Samples:
    """A performance as rows of one table: weights, quaternion, translation."""

    start_s: float
    rate_hz: float
    rows: NDArray[np.float64]

    @classmethod
    def of(cls, performance: Performance) -> _Samples:
        clip, moves = performance.weights, performance.head_motion
        q = moves.quaternion.copy()
        flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0))
        q[1:] *= flips[:, None]
        time_s = clip.time_s
        rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
        rows = np.concatenate([clip.values, q, moves.translation], axis=1)
        return cls(float(time_s[0]), rate_hz, rows)

    def at(self, time_s: float) -> NDArray[np.float64]:
        """The row at a time."""
        last = len(self.rows) - 1
        place = float(np.clip((time_s - self.start_s) * self.rate_hz, 0, last))
        i = min(int(place), last - 1)
        u = place - i
        if u == 0:
            return np.asarray(self.rows[i])
        a, b, c, d = self.rows[np.clip([i - 1, i, i + 1, i + 2], 0, last)]
        tangents = (c - a) / 2, (d - b) / 2
        return np.asarray(
            (2 * u**3 - 3 * u**2 + 1) * b
            + (u**3 - 2 * u**2 + u) * tangents[0]
            + (-2 * u**3 + 3 * u**2) * c
            + (u**3 - u**2) * tangents[1]
        )
