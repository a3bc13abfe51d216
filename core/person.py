"""A person, as a marker tracker knows one: where the markers sit, and how they move together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly
from .errors import InputError
from .markers import MarkerSet


@dataclass(frozen=True, eq=False)
class Person:
    """Markers of a face at rest, and the Gaussian of how they stand off it.

    In the head frame, a face shows marker m at ``neutral[m] + Σ_k c_k modes[k, m] + own_m``, with
    c_k of standard deviation 1, and own_m of `noise_mm` along each axis.

    Attributes
    ----------
    marker_set : str
        Name of the set that the face wears.
    labels : tuple of str, length M
    neutral : (M, 3) float64, mm, head frame
        The face at rest. Of a marker that was not seen at rest, where it is expected.
    modes : (K, M, 3) float64, mm
        What markers do together: expressions, and what is not known of the face's form.
    noise_mm : (M,) float64
        What each marker does by itself, above 0.
    is_known : (M,) bool
        Whether the marker has been seen on this face.
    log_scale_sd : float
        Of the face's size against `neutral`; 0 for a face that has been measured.
    n_frames : int
        Frames of this person that were learnt from.
    """

    marker_set: str
    labels: tuple[str, ...]
    neutral: NDArray[np.float64]
    modes: NDArray[np.float64]
    noise_mm: NDArray[np.float64]
    is_known: NDArray[np.bool_]
    log_scale_sd: float = 0.0
    n_frames: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", tuple(self.labels))
        M = len(self.labels)
        if len(set(self.labels)) != M:
            raise ValueError("labels must differ")
        shapes = {"neutral": (M, 3), "modes": (None, M, 3), "noise_mm": (M,)}
        for name, shape in shapes.items():
            value = readonly(getattr(self, name), shape, name)
            if not np.isfinite(value).all():
                raise ValueError(f"{name} must be finite")
            object.__setattr__(self, name, value)
        if not (self.noise_mm > 0).all():
            raise ValueError("noise_mm must lie above 0")
        object.__setattr__(self, "is_known", readonly(self.is_known, (M,), "is_known", np.bool_))
        if not (np.isfinite(self.log_scale_sd) and self.log_scale_sd >= 0):
            raise ValueError("log_scale_sd must be 0 or more")
        if self.n_frames < 0:
            raise ValueError("n_frames must be 0 or more")

    def check_wears(self, marker_set: MarkerSet) -> None:
        """InputError unless this person was learnt with the labels of `marker_set`."""
        if set(self.labels) != set(marker_set.labels):
            missing = sorted(set(self.labels) ^ set(marker_set.labels))
            raise InputError(
                f"the person was learnt with marker set {self.marker_set}, which has other labels "
                f"than {marker_set.name} ({', '.join(missing[:4])}): label without the person"
            )

    def select(self, labels: tuple[str, ...]) -> Person:
        """The person with some of the labels, in their order."""
        rows = [self.labels.index(n) for n in labels]
        return replace(
            self,
            labels=labels,
            neutral=self.neutral[rows],
            modes=self.modes[:, rows],
            noise_mm=self.noise_mm[rows],
            is_known=self.is_known[rows],
        )
