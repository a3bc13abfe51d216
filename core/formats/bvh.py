"""Motion of a few joints as Biovision hierarchies (``.bvh``).

A joint's rotation is written as ``Yrotation Xrotation Zrotation`` in degrees: R = Ry Rx Rz, as FAPs
48 to 50 have it, so that the numbers are yaw, pitch and roll. Lengths are centimetres, as most
programs take them. Position channels hold the whole place relative to the parent, offset included.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..arrays import readonly
from ..errors import InputError
from ..files import atomic_write

Floats = NDArray[np.float64]

MM_PER_UNIT = 10.0
_ORDER = "YXZ"
_STILL_MM = 1e-6


@dataclass(frozen=True, eq=False)
class BvhJoint:
    """A joint and how it moves relative to its parent.

    Attributes
    ----------
    name : str
        Without blanks.
    parent : int
        Index of a joint before it; -1 for the root, which is the first.
    offset : (3,) float64, mm
        From the parent at rest.
    rotation : (T, 4) float64, w x y z
    translation : (T, 3) float64, mm
        Beside `offset`.
    """

    name: str
    parent: int
    offset: Floats
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        if not self.name or any(c.isspace() for c in self.name):
            raise ValueError(f"a joint's name has no blanks, got {self.name!r}")
        object.__setattr__(self, "offset", readonly(self.offset, (3,), "offset"))
        object.__setattr__(self, "rotation", readonly(self.rotation, (None, 4), "rotation"))
        shape = (len(self.rotation), 3)
        object.__setattr__(self, "translation", readonly(self.translation, shape, "translation"))


@dataclass(frozen=True, eq=False)
class BvhMotion:
    """Joints, the root first and each after its parent, at a fixed rate."""

    joints: tuple[BvhJoint, ...]
    rate: Fraction

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "rate", Fraction(self.rate))
        names = [joint.name for joint in self.joints]
        if not names or len(set(names)) != len(names) or not self.rate > 0:
            raise ValueError("joints must have different names, and the rate must be above 0")
        for i, joint in enumerate(self.joints):
            if joint.parent >= i or (joint.parent < 0) != (i == 0):
                raise ValueError(f"joint {joint.name} must come after its parent")
            if len(joint.rotation) != len(self):
                raise ValueError(f"{joint.name} moves for {len(joint.rotation)} frames")
            for what in ("offset", "rotation", "translation"):
                if not np.isfinite(getattr(joint, what)).all():
                    raise ValueError(f"{what} of {joint.name} must be finite")

    def __len__(self) -> int:
        return len(self.joints[0].rotation)


def write_bvh(path: Path, motion: BvhMotion) -> None:
    """Write joints and their motion, atomically.

    The root, and joints that are shifted, have six channels; others turn only.

    Raises
    ------
    InputError
        If there are no frames.
    """
    if not len(motion):
        raise InputError(f"{path}: there is no frame to write")
    columns = np.concatenate([_columns(motion, i) for i in range(len(motion.joints))], axis=1)
    with atomic_write(path) as stream:
        stream.write("HIERARCHY\n")
        stream.writelines(line + "\n" for line in _hierarchy(motion, 0, ""))
        seconds = float(1 / motion.rate)
        stream.write(f"MOTION\nFrames: {len(motion)}\nFrame Time: {seconds:.10f}\n")
        for row in columns:
            stream.write(" ".join(_number(x) for x in row) + "\n")


def _hierarchy(motion: BvhMotion, index: int, indent: str) -> list[str]:
    joint = motion.joints[index]
    deeper = indent + "  "
    x, y, z = (_number(v) for v in joint.offset / MM_PER_UNIT)
    channels = "Yrotation Xrotation Zrotation"
    n_channels = 3
    if _is_shifted(motion, index):
        channels, n_channels = "Xposition Yposition Zposition " + channels, 6
    lines = [
        f"{indent}{'ROOT' if index == 0 else 'JOINT'} {joint.name}",
        indent + "{",
        f"{deeper}OFFSET {x} {y} {z}",
        f"{deeper}CHANNELS {n_channels} {channels}",
    ]
    children = [i for i, other in enumerate(motion.joints) if other.parent == index]
    for child in children:
        lines += _hierarchy(motion, child, deeper)
    if not children:
        lines += [f"{deeper}End Site", deeper + "{", f"{deeper}  OFFSET 0 0 1", deeper + "}"]
    return [*lines, indent + "}"]


def _is_shifted(motion: BvhMotion, index: int) -> bool:
    shift = motion.joints[index].translation
    return index == 0 or bool(np.abs(shift).max(initial=0.0) > _STILL_MM)


def _columns(motion: BvhMotion, index: int) -> Floats:
    joint = motion.joints[index]
    turns = Rotation.from_quat(joint.rotation, scalar_first=True).as_euler(_ORDER, degrees=True)
    turns = np.asarray(np.rad2deg(np.unwrap(np.deg2rad(turns), axis=0)), dtype=np.float64)
    if not _is_shifted(motion, index):
        return turns
    place = (joint.offset + joint.translation) / MM_PER_UNIT
    return np.asarray(np.concatenate([place, turns], axis=1))


def _number(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
