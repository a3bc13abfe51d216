"""The FAPs that a clip leaves unset: MPEG-4's interpolation rules, as far as we follow them."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from ..core.clip import HELD_PREFIXES, Clip
from ..core.errors import InputError
from ..core.mpeg4 import fap_by_name, fap_table

_log = logging.getLogger(__name__)

#: FAPs of the inner and of the outer lip contour that stand for each other: by number.
LIP_PAIRS = (
    (4, 51),
    (5, 52),
    (6, 53),
    (7, 54),
    (8, 55),
    (9, 56),
    (10, 57),
    (11, 58),
    (12, 59),
    (13, 60),
)


def complete_faps(clip: Clip) -> dict[str, NDArray[np.float64]]:
    """All FAPs that a clip gives or implies, by name, (T,) each and finite, table units.

    A FAP is given if any frame sets it; frames in between are filled linearly, frames before the
    first and after the last hold its value. Of a pair of inner and outer lip FAPs, or of left and
    right, the one that is not given takes the other's values: inner and outer lip first. What is
    left is absent from the mapping (and moves nothing).

    Raises
    ------
    InputError
        If the clip holds no FAP.
    """
    names = fap_by_name()
    found = {}
    for channel in clip.channels:
        if channel in names and not np.isnan(clip[channel]).all():
            found[channel] = _filled(clip.time_s, clip[channel])
    high_level = [c for c in clip.channels if c.startswith(HELD_PREFIXES)]
    if not found:
        raise InputError(
            "the clip gives no low-level FAP; its channels are "
            + (", ".join(clip.channels[:5]) + (" ..." if len(clip.channels) > 5 else "") or "none")
        )
    if any(np.nan_to_num(clip[c]).any() for c in high_level):
        _log.warning("visemes and expressions (FAPs 1 and 2) are not applied; FAPs 3 to 68 are")
    by_number = {fap.number: fap.name for fap in fap_table()}
    for inner, outer in LIP_PAIRS:
        _copy_to_missing(found, by_number[inner], by_number[outer])
    for name in tuple(found):
        other = other_side(name)
        if other:
            _copy_to_missing(found, name, other)
    return found


def other_side(name: str) -> str | None:
    """The FAP that does on the right what this one does on the left, or the other way round."""
    for a, b in (("_l_", "_r_"), ("_lm", "_rm")):
        for this, that in ((a, b), (b, a)):
            swapped = name.replace(this, that)
            if swapped != name and swapped in fap_by_name():
                return swapped
    return None


def _filled(time_s: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    known = ~np.isnan(values)
    return np.interp(time_s, time_s[known], values[known])


def _copy_to_missing(found: dict[str, NDArray[np.float64]], a: str, b: str) -> None:
    if a in found and b not in found:
        found[b] = found[a]
    elif b in found and a not in found:
        found[a] = found[b]
