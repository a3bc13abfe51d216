"""A head that moves: what the drive makes of a clip, and what exporters and renderers take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from ..core.arrays import readonly
from ..core.head_motion import HeadMotion
from ..core.rigid import rotation_from_quaternion
from ..core.time_base import checked_times, uniform_rate_hz
from ..heads.head import Head
from .deformer import FeaturePointDeformer


@dataclass(frozen=True, eq=False)
class PartMotion:
    """The rigid motion of a part relative to the head: ``pivot + translation + R (p - pivot)``.

    Attributes
    ----------
    pivot : (3,) float64, mm, head frame
    rotation : (T, 4) float64, w x y z
    translation : (T, 3) float64, mm, head frame
    """

    pivot: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pivot", readonly(self.pivot, (3,), "pivot"))
        object.__setattr__(self, "rotation", readonly(self.rotation, (None, 4), "rotation"))
        shape = (len(self.rotation), 3)
        object.__setattr__(self, "translation", readonly(self.translation, shape, "translation"))

    def moved(self, points: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
        """Points of the head frame, (..., 3) mm, where the part carries them in one frame."""
        rotation = rotation_from_quaternion(self.rotation[frame])
        moved = (points - self.pivot) @ rotation.T + self.pivot + self.translation[frame]
        return np.asarray(moved)


@dataclass(frozen=True, eq=False)
class HeadAnimation:
    """A head in motion.

    A vertex is at rest position plus the deformer's displacement; parts that move rigidly (eyes,
    lower teeth, tongue) then turn about their pivots; `motion` carries all of it to the world.

    Attributes
    ----------
    head : Head
    deformer : FeaturePointDeformer
        For all vertices of the head.
    time_s : (T,) float64, s
    displacements : (T, N, 3) float64, mm, head frame
        Of the deformer's points.
    parts : mapping from a part's name to PartMotion
    motion : HeadMotion
        At `time_s`; finite.
    """

    head: Head
    deformer: FeaturePointDeformer
    time_s: NDArray[np.float64]
    displacements: NDArray[np.float64]
    parts: Mapping[str, PartMotion]
    motion: HeadMotion

    def __post_init__(self) -> None:
        times = checked_times(self.time_s)
        shape = (len(times), len(self.deformer.points), 3)
        object.__setattr__(self, "time_s", times)
        moved = readonly(self.displacements, shape, "displacements")
        object.__setattr__(self, "displacements", moved)
        for name, part in self.parts.items():
            if len(part.rotation) != len(times):
                raise ValueError(f"{name} moves for {len(part.rotation)} frames of {len(times)}")
        if len(self.motion.time_s) != len(times):
            raise ValueError(f"motion has {len(self.motion.time_s)} frames of {len(times)}")
        object.__setattr__(self, "parts", MappingProxyType(dict(self.parts)))

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second where the times are uniform, else None."""
        return uniform_rate_hz(self.time_s)

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the deformer's points, in the order of `displacements`."""
        return self.deformer.points.names

    def resampled(self, time_s: ArrayLike) -> HeadAnimation:
        """The animation at other times: displacements linear, rotations on the shortest arc.

        Raises ValueError for times outside the animation.
        """
        t = checked_times(time_s)
        if len(t) and (t[0] < self.time_s[0] - 1e-9 or t[-1] > self.time_s[-1] + 1e-9):
            raise ValueError(f"times must lie in {self.time_s[0]}..{self.time_s[-1]} s")
        flat = self.displacements.reshape(len(self), -1)
        parts = {
            name: PartMotion(
                part.pivot,
                _turned(self.time_s, part.rotation, t),
                _between(self.time_s, part.translation, t),
            )
            for name, part in self.parts.items()
        }
        motion = HeadMotion(
            t,
            _turned(self.time_s, self.motion.quaternion, t),
            _between(self.time_s, self.motion.translation, t),
        )
        moved = _between(self.time_s, flat, t).reshape(len(t), *self.displacements.shape[1:])
        return replace(self, time_s=t, displacements=moved, parts=parts, motion=motion)

    def vertices(self, frame: int) -> NDArray[np.float64]:
        """All vertices in one frame, (V, 3) float64 mm, head frame (without the head's motion)."""
        found = self.deformer.displace(self.displacements[frame])
        found += self.head.mesh.vertices
        for name, part in self.parts.items():
            rows = self.head.part_vertices(name)
            found[rows] = part.moved(found[rows], frame)
        return found


def _between(
    key_s: NDArray[np.float64], values: NDArray[np.float64], time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(T, n) values linear between the keys."""
    if len(key_s) == 1:
        return np.repeat(values, len(time_s), axis=0)
    k = np.clip(np.searchsorted(key_s, time_s, side="right") - 1, 0, len(key_s) - 2)
    s = np.clip((time_s - key_s[k]) / (key_s[k + 1] - key_s[k]), 0.0, 1.0)[:, None]
    return np.asarray((1 - s) * values[k] + s * values[k + 1])


def _turned(
    key_s: NDArray[np.float64], quaternion: NDArray[np.float64], time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    if len(key_s) == 1:
        return np.repeat(quaternion, len(time_s), axis=0)
    keys = Rotation.from_quat(quaternion, scalar_first=True)
    inside = np.clip(time_s, key_s[0], key_s[-1])
    return np.asarray(Slerp(key_s, keys)(inside).as_quat(scalar_first=True))
