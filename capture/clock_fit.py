"""How one recording's time runs against another's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class ClockFit:
    """How one recording's time runs against another's.

    Attributes
    ----------
    offset_s : float, s
        Time on the other's line of the reference's 0.
    drift : float
        1e-5 is 10 ppm: the other's clock counts that much more.
    offset_sd_s : float, s
        Standard deviation in the middle of what was compared.
    drift_sd : float
        Infinite where one moment only was compared.
    n_used, n_given : int
        Moments (pieces of sound, flashes) that agreed, and that were compared.
    method : str
    """

    offset_s: float
    drift: float
    offset_sd_s: float
    drift_sd: float
    n_used: int
    n_given: int
    method: str

    def other_s(self, reference_s: ArrayLike) -> NDArray[np.float64]:
        """Times on the other's line."""
        return np.asarray(self.offset_s + (1 + self.drift) * np.asarray(reference_s, dtype=float))
