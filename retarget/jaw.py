"""How the jaw bone moves under FAPs 3, 14 and 15."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.mpeg4 import fap_by_name
from ..core.rigid import rotation_from_quaternion
from ..heads.head import Head
from .animation import PartMotion

#: The point that FAPs 3, 14 and 15 move, and the one that FAP 18 moves.
CHIN_BOTTOM, CHIN = "2.1", "2.10"
#: No jaw opens further.
WIDEST_RAD = np.radians(38.0)


@dataclass(frozen=True, eq=False)
class JawMotion(PartMotion):
    """The jaw's rigid motion: a turn about its hinge, and a shift."""

    def displacement(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """How a point fixed to the jaw bone moves, (T, 3) mm."""
        arm = point - self.pivot
        moved = rotation_from_quaternion(self.rotation) @ arm - arm + self.translation
        return np.asarray(moved)


_FAPS = ("open_jaw", "thrust_jaw", "shift_jaw")


def jaw_motion(head: Head, faps: Mapping[str, NDArray[np.float64]], n_frames: int) -> JawMotion:
    """The motion that takes the chin's lowest point (2.1) where FAPs 3, 14 and 15 say.

    The turn about the hinge gives the chin its vertical displacement (FAP 3), never upwards; the
    shift adds what is then missing sideways (FAP 15) and in depth (FAP 14). Where no frame's
    FAP 14 differs from 0 the chin swings back as the turn makes it.
    """
    units = {name: head.fapu.unit(fap_by_name()[name]) for name in _FAPS}
    rest = np.zeros(n_frames)
    opening, forward, right = (faps.get(name, rest) * units[name] for name in _FAPS)
    chin = head.points[CHIN_BOTTOM]
    angle = _turn(chin - head.jaw_pivot, np.maximum(opening, 0.0))
    shift = np.zeros((n_frames, 3))
    shift[:, 0] = -right
    if forward.any():
        _, y, z = chin - head.jaw_pivot
        shift[:, 2] = forward - (y * np.sin(angle) + z * np.cos(angle) - z)
    quaternion = np.zeros((n_frames, 4))
    quaternion[:, 0], quaternion[:, 1] = np.cos(angle / 2), np.sin(angle / 2)
    return JawMotion(head.jaw_pivot, quaternion, shift)


def widest_opening_mm(head: Head) -> float:
    """How far down the chin's lowest point comes: where the joint stops, or below the hinge."""
    _, y, z = head.points[CHIN_BOTTOM] - head.jaw_pivot
    turn = min(WIDEST_RAD, float(np.pi - np.arctan2(z, y)))
    return float(y - (y * np.cos(turn) - z * np.sin(turn)))


def _turn(arm: NDArray[np.float64], down_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """The angle about +x by which the end of an arm comes down so far, rad."""
    length, rest = np.hypot(arm[1], arm[2]), np.arctan2(arm[2], arm[1])
    # y' = length cos(rest + angle); the chin hangs below the hinge, so rest is beyond 90 degrees
    angle = np.arccos(np.clip((arm[1] - down_mm) / length, -1, 1)) - rest
    return np.asarray(np.clip(angle, 0.0, WIDEST_RAD))
