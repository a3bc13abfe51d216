"""Named markers over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .time_base import checked_times, uniform_rate_hz


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
        NaN where a position was not measured.
    is_filled : (T, M) bool
        True where the position was put into a gap rather than measured.
    residual_px : (T, M) float64 or None
        RMS reprojection error over the views used; NaN where not measured.
    n_views : (T, M) int32 or None
        Cameras used; 0 where not measured.
    """

    time_s: NDArray[np.float64]
    names: tuple[str, ...]
    positions: NDArray[np.float64]
    covariances: NDArray[np.float64] | None = None
    is_filled: NDArray[np.bool_] | None = None
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
        filled = np.zeros((T, M), bool) if self.is_filled is None else self.is_filled
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "positions", p)
        object.__setattr__(self, "is_filled", readonly(filled, (T, M), "is_filled", np.bool_))
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

    def select(self, names: tuple[str, ...]) -> Trajectories:
        """Some of the markers, in the order of `names`."""
        rows = [self.names.index(n) for n in names]

        def pick(a: NDArray[np.generic] | None) -> NDArray[np.generic] | None:
            return None if a is None else a[:, rows]

        return Trajectories(
            self.time_s,
            names,
            self.positions[:, rows],
            pick(self.covariances),  # type: ignore[arg-type]
            pick(self.is_filled),  # type: ignore[arg-type]
            pick(self.residual_px),  # type: ignore[arg-type]
            pick(self.n_views),  # type: ignore[arg-type]
        )
