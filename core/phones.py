"""Phones in time: what is said when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly

#: The 39 phones of American English in ARPAbet, without stress marks.
ARPABET = (
    "AA", "AE", "AH", "AO", "AW", "AY", "B", "CH", "D", "DH", "EH", "ER", "EY", "F", "G", "HH",
    "IH", "IY", "JH", "K", "L", "M", "N", "NG", "OW", "OY", "P", "R", "S", "SH", "T", "TH", "UH",
    "UW", "V", "W", "Y", "Z", "ZH",
)  # fmt: skip
#: Silence and breath.
SILENCE = "SIL"


@dataclass(frozen=True, eq=False)
class PhoneTrack:
    """Phones of a recording, one after another, without overlap.

    Attributes
    ----------
    phones : tuple of str, length N
        From `ARPABET`, or `SILENCE`.
    start_s, end_s : (N,) float64, s
        Ascending; ``end_s[i] <= start_s[i + 1]``.
    """

    phones: tuple[str, ...]
    start_s: NDArray[np.float64]
    end_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        phones = tuple(self.phones)
        object.__setattr__(self, "phones", phones)
        for name in ("start_s", "end_s"):
            object.__setattr__(self, name, readonly(getattr(self, name), (len(phones),), name))
        unknown = sorted(set(phones) - set(ARPABET) - {SILENCE})
        if unknown:
            raise ValueError(f"unknown phones: {' '.join(unknown)}")
        if not (np.isfinite(self.start_s).all() and np.isfinite(self.end_s).all()):
            raise ValueError("times of phones must be finite")
        if (self.end_s <= self.start_s).any() or (self.end_s[:-1] > self.start_s[1:] + 1e-9).any():
            raise ValueError("phones must be ascending and must not overlap")

    def __len__(self) -> int:
        return len(self.phones)
