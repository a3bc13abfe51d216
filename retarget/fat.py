"""Facial animation tables of a head, made of its drive.

Each FAP alone is driven through its range, and what it does to the vertices becomes straight
pieces: as few as keep within an error bound. FAPs are then superposed, as MPEG-4's own tables are:
what several of them do only together (lids that meet, lips that stop each other) is not in the
tables. `superposition_error` says what that costs. FAPs that say where a point is though the jaw
carries it are made relative to the jaw's tables first (`fat_carried`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.fat import FacialTables
from ..core.head_motion import HeadMotion
from ..core.mpeg4 import fap_table, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from .animation import HeadAnimation
from .drive import HeadDrive
from .fap_rules import complete_faps
from .fat_carried import CARRIED, CarriedFaps
from .fat_deformer import KnotDeformer
from .fat_pieces import few_pieces
from .limits import FapRange, HeadLimits

Floats = NDArray[np.float64]

#: FAPs that turn the head as a whole; they are motion, and in no table.
HEAD_TURNS = ("head_pitch", "head_yaw", "head_roll")
#: Of FAPs without a range of their own, such as the lids', which stop where they meet.
_RANGE = FapRange(-2560.0, 2560.0)
#: Tables go on this far beyond a range, until what is bent over there is at its end.
_BEYOND = 1.7
#: And those of `CARRIED` FAPs so far, which are not bent over: as far as a jaw can carry.
_CARRIED_BEYOND = 4.0
_LOWLEVEL = tuple(fap.name for fap in fap_table()[2:] if fap.name not in HEAD_TURNS)


@dataclass(frozen=True, eq=False)
class SuperpositionError:
    """How far superposed tables are from the drive.

    Attributes
    ----------
    rms_mm, max_mm : (T,) float64
        For each frame, over the vertices that the drive moves, and of all.
    """

    rms_mm: Floats
    max_mm: Floats


class FacialAnimationTable:
    """Moves a head by tables alone.

    Parameters
    ----------
    head : Head
    tables : FacialTables
        Of this head.

    Raises
    ------
    InputError
        If the tables belong to another mesh.
    """

    def __init__(self, head: Head, tables: FacialTables) -> None:
        rest = head.mesh.vertices
        if tables.rest.shape != rest.shape or np.abs(tables.rest - rest).max() > 1e-3:
            raise InputError(
                f"the tables are of another mesh than head {head.name}: they have "
                f"{len(tables.rest)} vertices, it has {len(rest)}; make them anew for this head"
            )
        self.head = head
        self.tables = tables
        moving = [t for t in tables.tables if len(t.vertices)]
        self._faps = tuple(t.fap for t in moving)
        self._deformer = KnotDeformer(head, moving)
        self._carried = CarriedFaps(head, tables)

    def vertices(self, faps: Mapping[str, float]) -> Floats:
        """All vertices for one frame's FAPs, (V, 3) float64 mm, head frame.

        FAPs that are not given are 0: no rule fills them in.
        """
        counts = self._counts({name: np.array([value]) for name, value in faps.items()}, 1)
        found = self._deformer.displace(counts[0])
        found += self.head.mesh.vertices
        return found

    def _counts(self, faps: Mapping[str, Floats], n: int) -> Floats:
        """How much each knot counts in n frames, (n, N, 3): the same on all axes."""
        relative = self._carried.relative(faps)
        none = np.zeros(n)
        values = np.stack([relative.get(name, none) for name in self._faps], axis=1)
        return np.repeat(self._deformer.counts(values)[:, :, None], 3, axis=2)

    def animate(self, clip: Clip, motion: HeadMotion | None = None) -> HeadAnimation:
        """The head moving as a clip says.

        Parameters
        ----------
        clip : Clip
            Of FAPs; those that it leaves unset follow `complete_faps`.
        motion : HeadMotion or None
            World from head, at the clip's times; None: FAPs 48 to 50 about the neck's pivot.

        Returns
        -------
        HeadAnimation
            Its "points" are the knots of the tables (0 left out): a point's "displacement" is how
            much its knot counts, the same on all axes. Eyes, teeth and tongue are in the tables
            and no parts.

        Raises
        ------
        InputError
            If the clip holds no FAP.
        """
        faps = complete_faps(clip)
        displacements = self._counts(faps, len(clip.time_s))
        if motion is None:
            motion = _head_motion(self.head, faps, clip.time_s)
        return HeadAnimation(self.head, self._deformer, clip.time_s, displacements, {}, motion)


def build_fat(
    drive: HeadDrive, *, max_error_mm: float = 0.1, faps: Iterable[str] = _LOWLEVEL
) -> FacialAnimationTable:
    """The facial animation tables of a driven head.

    Parameters
    ----------
    drive : HeadDrive
    max_error_mm : float
        How far a vertex may be from where the drive has it, under one FAP at any value.
    faps : iterable of str
        FAPs to make tables of; all by default.

    Raises
    ------
    ValueError
        If `max_error_mm` is not above 0, or a name is of no FAP that tables hold.
    """
    if not max_error_mm > 0:
        raise ValueError(f"max_error_mm must be above 0, got {max_error_mm}")
    tables = []
    for name in faps:
        if name not in _LOWLEVEL:
            raise ValueError(f"no table holds {name!r}: FAPs 3 to 47 and 51 to 68 do")
        limits = drive.limits.ranges.get(name, _RANGE)
        beyond = _CARRIED_BEYOND if name in CARRIED else _BEYOND
        within = FapRange(beyond * limits.low, beyond * limits.high)
        table = few_pieces(name, _Alone(drive, name), within, max_error_mm)
        if table is not None:
            tables.append(table)
    rest = drive.head.mesh.vertices.astype(np.float32)
    return FacialAnimationTable(drive.head, FacialTables(rest, max_error_mm, tuple(tables)))


def superposition_error(
    fat: FacialAnimationTable, drive: HeadDrive, clip: Clip
) -> SuperpositionError:
    """How far the tables are from the drive they were made of, frame by frame of a clip."""
    mine, theirs = fat.animate(clip), drive.animate(clip)
    rms, most = np.zeros(len(mine)), np.zeros(len(mine))
    for i in range(len(mine)):
        there = theirs.vertices(i)
        off = np.linalg.norm(mine.vertices(i) - there, axis=1)
        moved = np.linalg.norm(there - fat.head.mesh.vertices, axis=1) > 0.01
        rms[i] = np.sqrt((off[moved] ** 2).mean()) if moved.any() else 0.0
        most[i] = off.max()
    return SuperpositionError(rms, most)


class _Alone:
    """What one FAP does to all vertices when all others are 0."""

    def __init__(self, drive: HeadDrive, fap: str) -> None:
        self._drive, self._column = copy(drive), _LOWLEVEL.index(fap)
        limits = HeadLimits(drive.head, says=False)  # it is asked too much on purpose
        if fap in CARRIED:
            limits.ranges = {}
        self._drive.limits = limits

    def __call__(self, values: Floats) -> Floats:
        """Displacements at values (T,) of the FAP, (T, V, 3) mm."""
        faps = np.zeros((len(values), len(_LOWLEVEL)))
        faps[:, self._column] = values
        clip = Clip(np.arange(len(values), dtype=np.float64), _LOWLEVEL, faps)
        animation = self._drive.animate(clip)
        found = animation.deformer.displace(animation.displacements)
        rest = self._drive.head.mesh.vertices
        for name, part in animation.parts.items():
            rows = self._drive.head.part_vertices(name)
            for i in range(len(values)):
                found[i, rows] = part.moved(rest[rows] + found[i, rows], i) - rest[rows]
        return found


def _head_motion(head: Head, faps: Mapping[str, Floats], time_s: Floats) -> HeadMotion:
    none = np.zeros(len(time_s))
    R = rotation_of_faps(np.stack([faps.get(n, none) for n in HEAD_TURNS], axis=1))
    return HeadMotion(time_s, quaternion_from_rotation(R), head.neck_pivot - R @ head.neck_pivot)
