"""A stretch of footage: its dots, followed as they come, and judged when they are all there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import InputError
from ..core.rig import Rig
from ..core.trajectories import Trajectories
from .rig_check import RigVerdict, check_rig
from .track_records import Followed, no_tracks
from .tracker import FrameDots, Tracker, TrackerSettings

_LEAVE_OUT_PX = 0.7  # a camera that is off by more does more harm than good


@dataclass(frozen=True, eq=False)
class TrackedFootage:
    """What was found in a stretch of footage.

    Attributes
    ----------
    followed : Followed
    verdict : RigVerdict
    """

    followed: Followed
    verdict: RigVerdict


class Footage:
    """Follows a stretch as its frames come, and once more if the rig turns out to be wrong.

    Holds the dots of all its frames (some megabytes a minute), but no pictures.
    """

    def __init__(self, rig: Rig, settings: TrackerSettings | None = None) -> None:
        self._rig, self._settings = rig, settings
        self._frames: list[FrameDots] = []
        self._tracker = Tracker(rig, settings)

    def __len__(self) -> int:
        return len(self._frames)

    def step(self, frame: FrameDots) -> None:
        """The next frame."""
        self._frames.append(frame)
        self._tracker.step(frame)

    def tail(self, n_frames: int) -> Sequence[FrameDots]:
        """The last frames."""
        return self._frames[-n_frames:] if n_frames else ()

    def tracked(self, *, refine_rig: bool = False) -> TrackedFootage:
        """All tracks, after the rig was held against the dots.

        Parameters
        ----------
        refine_rig : bool
            Track again with cameras where they stand now; else with those left out that moved.

        Raises
        ------
        InputError
            As `rig_check.check_rig`; or if no marker is seen by two cameras.
        """
        verdict = check_rig(self._rig, self._frames)
        followed = self._tracker.followed()
        if verdict.moved:
            followed = self._track_again(verdict, refine_rig)
            if not refine_rig:
                verdict = replace(verdict, notes=tuple(map(_without, verdict.notes)))
        if not len(followed.trajectories.names):
            raise InputError(
                "no marker was seen by two cameras at once: are the rig and the videos of one take?"
            )
        return TrackedFootage(followed, verdict)

    def nothing(self) -> Trajectories:
        """The stretch without any track."""
        return no_tracks(np.array([frame.time_s for frame in self._frames]))

    def _track_again(self, verdict: RigVerdict, refine_rig: bool) -> Followed:
        tracker = Tracker(self._rig, self._settings)
        rigs, names = dict(verdict.rigs), self._rig.names
        shifts = zip(verdict.moved, verdict.shifts, strict=True)
        bad = [
            (frame, names.index(name))
            for (frame, name), s in shifts
            if s.picture_px > _LEAVE_OUT_PX
        ]
        for index, frame in enumerate(self._frames):
            if refine_rig:
                if index in rigs:
                    tracker.change_rig(rigs[index])
                tracker.step(frame)
            else:
                out = {c for first, c in bad if index >= first}
                tracker.step(_blind(frame, out))
        return tracker.followed()


def _blind(frame: FrameDots, cameras: set[int]) -> FrameDots:
    if not cameras:
        return frame
    nothing = (np.zeros((0, 2)), np.zeros(0))
    centres = (nothing[0] if c in cameras else d for c, d in enumerate(frame.centres))
    sd_px = (nothing[1] if c in cameras else d for c, d in enumerate(frame.sd_px))
    return replace(frame, centres=tuple(centres), sd_px=tuple(sd_px))


def _without(note: str) -> str:
    return f"{note}; from then on it is left out: refine the rig to use it (--refine-rig)"
