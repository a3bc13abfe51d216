"""How far a head's FAPs can go, and what becomes of those that ask for more.

A FAP is followed exactly up to `KNEE` of its range; beyond that it is bent over smoothly and never
passes the range's end. Lids and lips have limits of their own, where they meet (`lid_meeting`,
`lip_meeting`).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.mpeg4 import Fapu, fap_by_name, fap_table
from ..heads.head import Head
from .jaw import widest_opening_mm

Floats = NDArray[np.float64]

_log = logging.getLogger(__name__)

#: Up to this part of a range FAPs are followed exactly.
KNEE = 0.8
#: Less of a range is nothing that anybody sees, and is not remarked on.
_FELT = 0.01
#: The face on which the ranges below are told, mm; other faces' are in proportion.
AVERAGE = Fapu(irisd=8.564, es=60.256, ens=51.311, mns=14.125, mw=45.345)
_LIP_UP, _LIP_DOWN = 15.0, 48.0
#: FAP → lowest and highest displacement, mm on the average face; degrees for turns. Generous
#: estimates of what adults can do, the sculpted shapes' extremes included with a fifth to spare;
#: lips and corners count the jaw that carries them. FAPs that are not here have no limit here.
_RANGES: dict[tuple[int, ...], tuple[float, float]] = {
    (14,): (-30.0, 12.0),  # an open jaw swings back
    (15,): (-16.0, 16.0),
    (4, 8, 9, 51, 55, 56): (-_LIP_UP, 16.0),
    (5, 10, 11, 52, 57, 58): (-_LIP_DOWN, _LIP_UP),
    (6, 7, 53, 54): (-20.0, 24.0),
    (12, 13, 59, 60): (-28.0, 20.0),
    (16, 17): (-32.0, 18.0),
    (18,): (-55.0, 14.0),
    (23, 24): (-55.0, 55.0),
    (25, 26): (-50.0, 60.0),
    (27, 28): (-4.0, 8.0),
    (29, 30): (-3.0, 3.0),
    (31, 32, 33, 34, 35, 36): (-14.0, 18.0),
    (37, 38): (-6.0, 12.0),
    (39, 40): (-14.0, 24.0),
    (41, 42): (-6.0, 18.0),
    (43,): (-30.0, 30.0),
    (44, 46): (-45.0, 25.0),  # the tongue goes with the jaw
    (45,): (-45.0, 50.0),
    (48,): (-80.0, 80.0),
    (49,): (-95.0, 95.0),
    (50,): (-60.0, 60.0),
    (61, 62): (-8.0, 10.0),
    (63,): (-8.0, 8.0),
    (64,): (-10.0, 10.0),
    (65, 66, 67, 68): (-8.0, 8.0),
}


@dataclass(frozen=True)
class FapRange:
    """The lowest and highest value of a FAP, table units; 0 lies between, or is one of them."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= 0 <= self.high or self.low == self.high:
            raise ValueError(f"a range holds 0, got {self.low:g} to {self.high:g}")


@dataclass(frozen=True)
class Beyond:
    """A FAP that asked for more than a head can do.

    Attributes
    ----------
    fap : str
    asked, given : float, table units
        The value furthest beyond the range, and what became of it.
    n_frames : int
        In which it asked for more.
    """

    fap: str
    asked: float
    given: float
    n_frames: int

    def __str__(self) -> str:
        frames = "1 frame" if self.n_frames == 1 else f"{self.n_frames} frames"
        return f"{self.fap} {self.asked:.0f}, shown as {self.given:.0f} ({frames})"


class HeadLimits:
    """The ranges of one head's FAPs.

    Parameters
    ----------
    head : Head
    says : bool
        Whether what is beyond is logged.

    Attributes
    ----------
    ranges : mapping from FAP to FapRange
        Of those that have a limit. ``open_jaw`` goes from 0 to where the joint stops.
    """

    def __init__(self, head: Head, *, says: bool = True) -> None:
        self._name, self._says = head.name, says
        found = {}
        table = fap_table()
        for numbers, ends in _RANGES.items():
            for number in numbers:
                fap = table[number - 1]
                one = np.radians(1.0) if fap.fapu == "AU" else 1.0
                low, high = (end * one / AVERAGE.unit(fap) for end in ends)
                found[fap.name] = FapRange(low, high)
        jaw = fap_by_name()["open_jaw"]
        found[jaw.name] = FapRange(0.0, widest_opening_mm(head) / head.fapu.unit(jaw))
        self.ranges: Mapping[str, FapRange] = MappingProxyType(found)

    def bent(self, faps: Mapping[str, Floats]) -> dict[str, Floats]:
        """FAPs within the head's ranges; those that asked for more are logged as a warning.

        Parameters
        ----------
        faps : mapping from name to (T,) float64, table units

        Returns
        -------
        dict from name to (T,) float64, table units
            Values up to `KNEE` of a range, and FAPs without one, are as they were.
        """
        beyond = self.beyond(faps) if self._says else ()
        if beyond:
            shown = "; ".join(str(b) for b in beyond[:5])
            more = f"; and {len(beyond) - 5} more FAPs" if len(beyond) > 5 else ""
            _log.warning("more than head %s can do: %s%s", self._name, shown, more)
        return {n: bend(v, self.ranges[n]) if n in self.ranges else v for n, v in faps.items()}

    def beyond(self, faps: Mapping[str, Floats]) -> tuple[Beyond, ...]:
        """FAPs that ask for more than the head can do, by what one sees; the furthest first."""
        found: list[tuple[float, Beyond]] = []
        for name, values in faps.items():
            if name not in self.ranges or not len(values):
                continue
            r = self.ranges[name]
            over = np.maximum(values - r.high, r.low - values)
            is_felt = over > _FELT * (r.high - r.low)
            if not is_felt.any():
                continue
            worst = float(values[int(np.argmax(over))])
            given = float(bend(np.array([worst]), r)[0])
            frames = int(is_felt.sum())
            found.append((float(over.max()) / (r.high - r.low), Beyond(name, worst, given, frames)))
        return tuple(b for _, b in sorted(found, key=lambda item: -item[0]))


def bend(values: Floats, within: FapRange) -> Floats:
    """Values bent over at the ends of a range: C1, increasing, exact up to `KNEE` of it."""
    found = np.array(values, dtype=np.float64)
    for sign, end in ((-1.0, within.low), (1.0, within.high)):
        knee, room = KNEE * end, (1 - KNEE) * abs(end)
        over = sign * (found - knee)
        bent = room * np.tanh(over / room) if room else np.zeros_like(found)
        found = np.where(over > 0, knee + sign * bent, found)
    return found
