"""The rotations of head, jaw and eyes of an animated head, as joints of a .bvh file."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.formats.bvh import BvhJoint, BvhMotion
from ..core.rigid import rotation_from_quaternion
from .animation import HeadAnimation
from .resampling import exact_rate

#: Joints below the head, and the part of the head that tells how each moves.
BVH_JOINTS = {"Jaw": "teeth_lower", "LeftEye": "eye_left", "RightEye": "eye_right"}


def animation_bvh(animation: HeadAnimation, rate: Fraction | None = None) -> BvhMotion:
    """The joint ``Head`` at the neck's pivot, and below it those of `BVH_JOINTS` that move.

    Parameters
    ----------
    animation : HeadAnimation
        Uniform in time: `HeadAnimation.resampled` makes it so.
    rate : Fraction or None
        Frames a second; None: as the times say.

    Raises
    ------
    InputError
        If the times are uneven and no rate is given.
    """
    if rate is None:
        if animation.rate_hz is None:
            raise InputError("a .bvh file has one rate, and the clip's times are uneven: say --fps")
        rate = exact_rate(animation.rate_hz)
    motion, neck = animation.motion, animation.head.neck_pivot
    turn = rotation_from_quaternion(motion.quaternion)
    shift = turn @ neck + motion.translation - neck
    joints = [BvhJoint("Head", -1, neck, motion.quaternion, _still(shift))]
    for name, part in BVH_JOINTS.items():
        rigid = animation.parts.get(part)
        if rigid is not None:
            hinge = animation.head.jaw_pivot if name == "Jaw" else rigid.pivot
            turn = rotation_from_quaternion(rigid.rotation)
            moved = rigid.pivot + rigid.translation + turn @ (hinge - rigid.pivot) - hinge
            joints.append(BvhJoint(name, 0, hinge - neck, rigid.rotation, _still(moved)))
    return BvhMotion(tuple(joints), rate)


def _still(shift: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shifts without rounding errors: below a nanometre is none."""
    return np.where(np.abs(shift) < 1e-6, 0.0, shift)
