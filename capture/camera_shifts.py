"""Which cameras of a rig moved: likelihood ratios against the rig as it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..core.camera import Camera
from ..core.rig import Rig
from ..core.rigid import Rigid
from .bundle import covariance_of
from .rays import Pose
from .rig_gauge import aligned, changed, deviation, scaled_to

Floats = NDArray[np.float64]
#: An unmoved rig is called moved in one of so many judgements.
FALSE_ALARM = 1e-3
#: Two cameras of which either may have moved: their likelihoods differ by less than this (χ²).
_TIE = 9.0
#: Where a moved camera may stand: holds what nobody sees, such as its way along the line to the one
#: camera that it is compared with.
_ANYWHERE_MM, _ANYWHERE_RAD = 100.0, 0.5
_FREEDOM = 6


@dataclass(frozen=True)
class PoseSd:
    """How well a rig's poses were known when it was calibrated: standard deviations an axis.

    Attributes
    ----------
    centre_mm : float
    rotation_rad : float
    """

    centre_mm: float = 0.15
    rotation_rad: float = 1.5e-4


@dataclass(frozen=True, eq=False)
class CameraShift:
    """How a camera stands against where it was calibrated.

    Attributes
    ----------
    camera : str
    is_moved : bool
    distance_mm, distance_sd_mm : float
        How far its centre is from where it was.
    angle_rad, angle_sd_rad : float
    picture_px : float
        RMS of how far the markers' pictures moved by it.
    camera_from_world : Rigid
        Where it stands now in the old rig's world, by the cameras that did not move.
    p_value : float
        How often noise and the old rig's own uncertainty alone would show as much.
    """

    camera: str
    is_moved: bool
    distance_mm: float
    distance_sd_mm: float
    angle_rad: float
    angle_sd_rad: float
    picture_px: float
    camera_from_world: Rigid
    p_value: float


@dataclass(frozen=True, eq=False)
class JudgedShifts:
    """The verdict, and the poses in the world of the cameras that did not move.

    Attributes
    ----------
    shifts : tuple of CameraShift
    poses : C poses
    steady : rows of the cameras that did not move
    warnings : tuple of str
    """

    shifts: tuple[CameraShift, ...]
    poses: tuple[Pose, ...]
    steady: tuple[int, ...]
    warnings: tuple[str, ...]


def judged_shifts(
    rig: Rig,
    found: Sequence[Pose],
    information: Floats,
    points: Floats,
    pose_sd: PoseSd,
) -> JudgedShifts:
    """Judge each camera of a rig whose poses were estimated anew.

    The new estimate has the information S of its deviations x from the old poses, without a gauge;
    a camera that did not move has its old pose as a prior besides (one that did, a very wide one).
    To free a camera of that prior lowers the least cost by a χ² of 6 degrees of freedom if it did
    not move. Cameras are freed one after the other, the one that lowers it most first, as long as
    that is more than chance and two cameras hold the world.

    Parameters
    ----------
    rig : Rig
        The old one, of C cameras.
    found : C poses
        In any world.
    information : (6 C, 6 C) float64
        Of changes of `found` (`rig_gauge`).
    points : (P, 3) float64, mm
        That were seen, in the world of `found`.
    pose_sd : PoseSd
    """
    old = [(c.camera_from_world.rotation, c.camera_from_world.translation)
           for c in rig.cameras.values()]  # fmt: skip
    judge = _Judge(old, tuple(found), information, pose_sd)
    moved: list[int] = []
    tied: set[int] = set()
    while len(moved) < max(1, len(old) - 2):
        gains = {c: judge.gain(moved, c) for c in range(len(old)) if c not in moved}
        best = max(gains, key=lambda c: gains[c])
        if gains[best] <= chi2.ppf(1 - FALSE_ALARM / len(old), _FREEDOM):
            break
        tied |= {c for c, gain in gains.items() if c != best and gain > gains[best] - _TIE}
        moved.append(best)
    tied -= set(moved)
    steady = tuple(c for c in range(len(old)) if c not in moved)
    if len(old) == 2:  # either may be the one
        steady, moved = (0, 1), moved + sorted(tied) if moved else []
    poses = scaled_to(judge.placed(moved if len(old) > 2 else []), old, steady)
    shifts = tuple(
        _shift(rig, c, judge, [m for m in moved if m != c], c in moved, points)
        for c in range(len(old))
    )
    return JudgedShifts(shifts, tuple(poses), steady, _ambiguity(rig.names, moved, tied))


def _ambiguity(names: Sequence[str], moved: Sequence[int], tied: set[int]) -> tuple[str, ...]:
    if not moved or not tied:
        return ()
    if len(names) == 2:
        return (
            f"{names[0]} and {names[1]} moved against each other; which of them moved, two cameras "
            "cannot tell",
        )
    others = ", ".join(names[c] for c in sorted(tied))
    told = ", ".join(names[c] for c in moved)
    return (f"it may as well be {others} that moved instead of {told}: the pictures fit both",)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Least costs under the prior of some cameras."""

    old: Sequence[Pose]
    found: tuple[Pose, ...]
    information: Floats
    pose_sd: PoseSd

    def placed(self, moved: Sequence[int]) -> list[Pose]:
        """The estimate in the world of the cameras that did not move."""
        return aligned(self.found, self.old, self._weights(moved))

    def gain(self, moved: Sequence[int], camera: int) -> float:
        """How much less is the cost if this camera is free too."""
        return self._fit(moved)[0] - self._fit([*moved, camera])[0]

    def change(self, moved: Sequence[int], camera: int) -> tuple[Floats, Floats]:
        """A free camera's change (6,) and its covariance, under the prior of the others."""
        free = [*moved, camera]
        rows = slice(6 * camera, 6 * camera + 6)
        covariance = covariance_of(self.information + np.diag(self._weights(free)))
        return self._fit(free)[1][rows], covariance[rows, rows]

    def _weights(self, moved: Sequence[int]) -> Floats:
        sd = np.repeat([self.pose_sd.rotation_rad, self.pose_sd.centre_mm], 3)
        weights = np.tile(1 / sd**2, len(self.old))
        anywhere = np.repeat([_ANYWHERE_RAD, _ANYWHERE_MM], 3)
        for c in moved:
            weights[6 * c : 6 * c + 6] = 1 / anywhere**2
        return weights

    def _fit(self, moved: Sequence[int]) -> tuple[float, Floats]:
        """Least cost, and the changes (6 C,) from the old poses that have it."""
        weights = self._weights(moved)
        free = deviation(aligned(self.found, self.old, weights), self.old)
        S = self.information
        x = np.asarray(np.linalg.solve(S + np.diag(weights), S @ free), dtype=np.float64)
        off = x - free
        return float(off @ S @ off + x @ (weights * x)), x


def _shift(
    rig: Rig, c: int, judge: _Judge, others: Sequence[int], is_moved: bool, points: Floats
) -> CameraShift:
    change, covariance = judge.change(others, c)
    p = float(chi2.sf(max(judge.gain(others, c), 0.0), _FREEDOM))
    (angle, angle_sd), (distance, distance_sd) = (
        _length(change[rows], covariance[rows, rows]) for rows in (slice(0, 3), slice(3, 6))
    )
    px = _picture_px(rig[rig.names[c]], judge.found[c], change, points)
    now = Rigid.from_rotation(*changed(judge.old[c], change))
    return CameraShift(
        rig.names[c], is_moved, distance, distance_sd, angle, angle_sd, px, now, p
    )  # fmt: skip


def _length(v: Floats, covariance: Floats) -> tuple[float, float]:
    """Length of a vector, and its standard deviation along it."""
    size = float(np.linalg.norm(v))
    way = v / size if size > 0 else np.full(3, 1 / np.sqrt(3))
    return size, float(np.sqrt(max(float(way @ covariance @ way), 0.0)))


def _picture_px(camera: Camera, pose: Pose, change: Floats, points: Floats) -> float:
    """RMS of how far points' pictures lie from where they would be without the change."""
    before = changed(pose, -change)
    now, then = (
        replace(camera, camera_from_world=Rigid.from_rotation(*p)).project(points)
        for p in (pose, before)
    )
    off2 = ((now - then) ** 2).sum(axis=1)
    return float(np.sqrt(off2[np.isfinite(off2)].mean())) if np.isfinite(off2).any() else np.nan
