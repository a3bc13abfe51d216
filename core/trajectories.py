"""Named markers over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .time_base import checked_times, uniform_rate_hz


class Source(IntEnum):
    """Where a sample comes from."""

    MISSING = 0
    MEASURED = 1
    INTERPOLATED = 2  # from the marker's own samples around it
    RECONSTRUCTED = 3  # from other markers too


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Positions of named markers over time. Missing is NaN in all three coordinates.

    Attributes
    ----------
    time_s : (T,) float64, s
        Strictly increasing.
    names : tuple of str, length M
    positions : (T, M, 3) float64, mm, world frame
    covariances : (T, M, 3, 3) float64, mm², or None
        NaN where a position is missing or nothing is known of its error.
    source : (T, M) uint8
        Values of `Source`; by default measured wherever there is a position.
    residual_px : (T, M) float64 or None
        RMS reprojection error over the views used; NaN where not measured.
    n_views : (T, M) int32 or None
        Cameras used; 0 where not measured.
    """

    time_s: NDArray[np.float64]
    names: tuple[str, ...]
    positions: NDArray[np.float64]
    covariances: NDArray[np.float64] | None = None
    source: NDArray[np.uint8] = None  # type: ignore[assignment]  # set below
    residual_px: NDArray[np.float64] | None = None
    n_views: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        names = tuple(self.names)
        if len(set(names)) != len(names):
            twice = sorted({n for n in names if names.count(n) > 1})
            raise ValueError(f"marker names must differ; twice: {', '.join(twice)}")
        times = checked_times(self.time_s)
        T, M = len(times), len(names)
        p = readonly(self.positions, (T, M, 3), "positions")
        unseen = np.isnan(p)
        if (unseen.any(axis=2) != unseen.all(axis=2)).any() or np.isinf(p).any():
            raise ValueError("positions must be finite, or NaN in all three coordinates")
        missing = unseen[..., 0]
        source = self.source
        if source is None:
            source = np.where(missing, Source.MISSING, Source.MEASURED)
        source = readonly(source, (T, M), "source", np.uint8)
        if source.max(initial=0) > max(Source) or ((source == Source.MISSING) != missing).any():
            raise ValueError("source must be MISSING where positions are NaN, and only there")
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "positions", p)
        object.__setattr__(self, "source", source)
        if self.covariances is not None:
            C = readonly(self.covariances, (T, M, 3, 3), "covariances")
            object.__setattr__(self, "covariances", C)
        if self.residual_px is not None:
            r = readonly(self.residual_px, (T, M), "residual_px")
            object.__setattr__(self, "residual_px", r)
        if self.n_views is not None:
            n = readonly(self.n_views, (T, M), "n_views", np.int32)
            object.__setattr__(self, "n_views", n)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second where the times are uniform, else None."""
        return uniform_rate_hz(self.time_s)

    @property
    def is_missing(self) -> NDArray[np.bool_]:
        """(T, M): no position."""
        return np.asarray(self.source == Source.MISSING)

    @property
    def is_measured(self) -> NDArray[np.bool_]:
        """(T, M): triangulated from what cameras saw."""
        return np.asarray(self.source == Source.MEASURED)

    @property
    def is_filled(self) -> NDArray[np.bool_]:
        """(T, M): put into a gap rather than measured."""
        return np.asarray(self.source >= Source.INTERPOLATED)

    def select(self, names: tuple[str, ...]) -> Trajectories:
        """Some of the markers, in the order of `names`."""
        rows = [self.names.index(n) for n in names]
        given = {name: getattr(self, name) for name in _PER_SAMPLE}
        parts: dict[str, Any] = {n: v[:, rows] for n, v in given.items() if v is not None}
        return replace(self, names=names, **parts)


_PER_SAMPLE = ("positions", "covariances", "source", "residual_px", "n_views")
