"""A head in one pose, of FAPs, ARKit weights and expressions together."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..core.mpeg4 import Fap, fap_by_name, fap_table
from ..heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from ..heads.head import Head

if TYPE_CHECKING:
    from ..retarget.animation import HeadAnimation

Floats = NDArray[np.float64]

#: The standard's groups of low-level FAPs: title, first and last number (ISO/IEC 14496-2, annex C).
FAP_GROUPS = (
    ("Jaw, chin, inner lips", 3, 18),
    ("Eyeballs, pupils, lids", 19, 30),
    ("Brows", 31, 38),
    ("Cheeks", 39, 42),
    ("Tongue", 43, 47),
    ("Head", 48, 50),
    ("Outer lips", 51, 60),
    ("Nose", 61, 64),
    ("Ears", 65, 68),
)
#: How far a slider goes, table units: about as far as a face does, on either side.
_REACH = {"MNS": 1200.0, "MW": 500.0, "ENS": 250.0, "ES": 250.0, "IRISD": 1100.0}
_TURN_REACH, _OTHER_REACH = 100_000.0, 1024.0
_JAW_REACH = (0.0, 2600.0)
_FAP_NAMES = tuple(fap.name for fap in fap_table()[2:])
_LOOKS = (*EXPRESSIONS, *VISEMES[1:])


def slider_range(fap: Fap) -> tuple[float, float]:
    """Least and greatest value of a FAP's slider, table units."""
    if fap.name == "open_jaw":
        return _JAW_REACH
    reach = _TURN_REACH if fap.fapu == "AU" else _REACH.get(fap.fapu, _OTHER_REACH)
    return -reach, reach


@dataclass(frozen=True, eq=False)
class Pose:
    """What a head is asked to do, all of it together; what is not named is 0.

    Attributes
    ----------
    faps : mapping from a FAP's name to its value, table units
    weights : mapping from an ARKit shape's name to its weight
    looks : mapping from an expression or viseme to its intensity, 0 to 1
    """

    faps: Mapping[str, float] = field(default_factory=dict)
    weights: Mapping[str, float] = field(default_factory=dict)
    looks: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {"faps": fap_by_name(), "weights": ARKIT_SHAPES, "looks": _LOOKS}
        for name, names in known.items():
            given = {k: float(v) for k, v in getattr(self, name).items() if v}
            unknown = sorted(set(given) - set(names))
            if unknown:
                raise ValueError(f"{name} has no {', '.join(unknown)}")
            object.__setattr__(self, name, MappingProxyType(given))

    def all_weights(self) -> dict[str, float]:
        """ARKit weights with those of the looks, at most 1 each."""
        found = dict(self.weights)
        for look, intensity in self.looks.items():
            of = expression_weights if look in EXPRESSIONS else viseme_weights
            for shape, weight in of(look, intensity).items():
                found[shape] = found.get(shape, 0.0) + weight
        return {shape: min(weight, 1.0) for shape, weight in found.items()}


@dataclass(frozen=True, eq=False)
class PosedHead:
    """A head in one pose.

    Attributes
    ----------
    vertices : (V, 3) float64, mm, head frame
    quaternion : (4,) float64, w x y z, world from head
    translation : (3,) float64, mm, world frame
    """

    vertices: Floats
    quaternion: Floats
    translation: Floats


class PoseDrive:
    """Poses a head: FAPs by its feature points, ARKit weights by its own shapes.

    A head without shapes that are understood gets its weights as FAPs by the fixed table.

    Raises
    ------
    InputError
        If the head lacks the feature points.
    """

    def __init__(self, head: Head) -> None:
        from ..retarget.conversion import has_known_shapes
        from ..retarget.drive import HeadDrive
        from ..retarget.shape_solver import ShapeDrive

        self.head = head
        self._points = HeadDrive(head)
        self._shapes = ShapeDrive(head, method="direct") if has_known_shapes(head) else None
        self._rows = {name: head.part_vertices(name) for name in head.mesh.groups}
        # a slider changes one of the two, so the other is kept
        self._by_points = lru_cache(maxsize=1)(self._moved_by_points)
        self._by_shapes = lru_cache(maxsize=1)(self._moved_by_shapes)

    @property
    def has_shapes(self) -> bool:
        """Whether ARKit weights are shown by the head's own shapes."""
        return self._shapes is not None

    def posed(self, pose: Pose) -> PosedHead:
        """The head in a pose."""
        weights = {} if self._shapes is None else pose.all_weights()
        faps = self.faps(pose) if self._shapes is None else _fap_clip(pose.faps)
        shaped = self._by_shapes(tuple(weights.items())) if weights else None
        return self._together(self._by_points(tuple(faps.values[0])), shaped)

    def _moved_by_points(self, values: tuple[float, ...]) -> HeadAnimation:
        """By the values of FAPs 3 to 68."""
        return self._points.animate(Clip(np.zeros(1), _FAP_NAMES, np.array([values])))

    def _moved_by_shapes(self, weights: tuple[tuple[str, float], ...]) -> HeadAnimation:
        assert self._shapes is not None
        return self._shapes.animate(_clip(dict(weights)))

    def faps(self, pose: Pose) -> Clip:
        """The pose as one frame of FAPs: those given, and those that the weights come to."""
        from ..retarget.conversion import faps_of

        values = dict(pose.faps)
        weights = pose.all_weights()
        if weights:
            made = faps_of(_clip(weights), self.head)
            for name, value in zip(made.channels, made.values[0], strict=True):
                if np.isfinite(value) and value:
                    values[name] = values.get(name, 0.0) + float(value)
        return _fap_clip(values)

    def _together(self, faps: HeadAnimation, shaped: HeadAnimation | None) -> PosedHead:
        """What both do to the skin is added; parts that move rigidly turn by both in turn."""
        found = self.head.mesh.vertices + faps.deformer.displace(faps.displacements[0])
        if shaped is not None:
            found += shaped.deformer.displace(shaped.displacements[0])
        for animation in (shaped, faps):
            for name, part in ({} if animation is None else animation.parts).items():
                rows = self._rows[name]
                found[rows] = part.moved(found[rows], 0)
        motion = faps.motion
        return PosedHead(found, motion.quaternion[0], motion.translation[0])


def fap_file(clip: Clip) -> bytes:
    """A .fap file's contents."""
    from ..core.formats.fap import write_fap

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pose.fap"
        write_fap(path, clip)
        return path.read_bytes()


def _fap_clip(values: Mapping[str, float]) -> Clip:
    """One frame of all low-level FAPs, 0 where none is given."""
    return Clip(np.zeros(1), _FAP_NAMES, np.array([[values.get(name, 0.0) for name in _FAP_NAMES]]))


def _clip(values: Mapping[str, float]) -> Clip:
    return Clip(np.zeros(1), tuple(values), np.array([list(values.values())]))
