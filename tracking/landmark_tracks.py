"""The landmarks of a face through an ordinary video: what was measured, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.time_base import checked_times
from ..heads.face_landmarks import N_LANDMARKS
from ..heads.face_scores import SCORE_NAMES


class LandmarkSource(IntEnum):
    """Where a frame's landmarks come from."""

    MISSING = 0
    NETWORK = 1  # the landmark network saw a face, refined by flow
    FOLLOWED = 2  # flow and templates only
    BRIDGED = 3  # from the frames around it


@dataclass(frozen=True, eq=False)
class LandmarkTracks:
    """A face's 478 landmarks over time. Missing is NaN in both coordinates.

    Attributes
    ----------
    time_s : (T,) float64, s
        Strictly increasing: the file's own time stamps.
    points_px : (T, 478, 2) float64, px
        NaN where unknown; x, y in the picture as shown.
    sd_px : (T, 478) float64, px
        Standard deviation of each coordinate's error, as far as it differs from frame to frame;
        what the network does to all frames of a face alike is not in it. NaN where unknown.
    presence : (T,) float64
        The landmark network's logit of there being a face; NaN where it saw none.
    source : (T,) int64
        Values of `LandmarkSource`.
    image_size : (int, int), px
        Width and height.
    scores : (T, 52) float64 or None
        The network's expression scores, 0 to 1, in the order of `heads.face_scores.SCORE_NAMES`;
        NaN where it did not see a whole face; None where there is no network.
    cuts : tuple of int
        Frames that begin a new shot: nothing was carried over from the frame before.
    notes : tuple of str
        What a user should know: several faces, frames without one.
    iris_px : (T, 2, 2) float64, px, or None
        Centres of the right and the left iris, measured in the pictures; NaN where an eye is shut,
        hidden or shows none. None where they were not looked for.
    """

    time_s: NDArray[np.float64]
    points_px: NDArray[np.float64]
    sd_px: NDArray[np.float64]
    presence: NDArray[np.float64]
    source: NDArray[np.int64]
    image_size: tuple[int, int]
    scores: NDArray[np.float64] | None = None
    cuts: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    iris_px: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        times = checked_times(self.time_s)
        T = len(times)
        points = readonly(self.points_px, (T, N_LANDMARKS, 2), "points_px")
        sd = readonly(self.sd_px, (T, N_LANDMARKS), "sd_px")
        source = readonly(self.source, (T,), "source", np.int64)
        _check_points(points, sd, source)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "points_px", points)
        object.__setattr__(self, "sd_px", sd)
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "presence", readonly(self.presence, (T,), "presence"))
        if self.scores is not None:
            scores = readonly(self.scores, (T, len(SCORE_NAMES)), "scores")
            object.__setattr__(self, "scores", scores)
        if self.iris_px is not None:
            object.__setattr__(self, "iris_px", readonly(self.iris_px, (T, 2, 2), "iris_px"))
        cuts = tuple(int(frame) for frame in self.cuts)
        if any(not 0 < frame < T for frame in cuts) or sorted(set(cuts)) != list(cuts):
            raise ValueError(f"cuts must grow and lie between 1 and {T - 1}, got {cuts}")
        object.__setattr__(self, "cuts", cuts)
        object.__setattr__(self, "notes", tuple(self.notes))
        if min(self.image_size) < 1:
            raise ValueError(f"image_size must be positive, got {self.image_size}")
        object.__setattr__(self, "image_size", (int(self.image_size[0]), int(self.image_size[1])))

    @property
    def is_missing(self) -> NDArray[np.bool_]:
        """(T,): no landmark in this frame."""
        return np.asarray(self.source == LandmarkSource.MISSING)

    @property
    def shots(self) -> tuple[slice, ...]:
        """The frames between cuts."""
        edges = (0, *self.cuts, len(self.time_s))
        return tuple(slice(a, b) for a, b in pairwise(edges))


def _check_points(
    points: NDArray[np.float64], sd: NDArray[np.float64], source: NDArray[np.int64]
) -> None:
    unknown = np.isnan(points)
    if (unknown.any(axis=2) != unknown.all(axis=2)).any() or np.isinf(points).any():
        raise ValueError("points_px must be finite, or NaN in both coordinates")
    if (np.isnan(sd) != unknown[..., 0]).any() or (sd <= 0).any():
        raise ValueError("sd_px must be positive where a point is known, and NaN elsewhere")
    if len(source) and not set(source.tolist()) <= set(LandmarkSource):
        raise ValueError(f"source must hold values of LandmarkSource, got {set(source.tolist())}")
    if (unknown[..., 0].all(axis=1) != (source == LandmarkSource.MISSING)).any():
        raise ValueError("source must be MISSING where no point is known, and only there")
