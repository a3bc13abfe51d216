"""The FAPs that a clip leaves unset: MPEG-4's interpolation rules, as far as we follow them.

A FAP that was set once keeps its own values: linear between them, and the last one on. Before its
first value, or if it has none at all, others stand in for it, in this order:

1. its partner on the other contour of the lips,
2. then its partner on the other side of the face,
3. what the visemes and expressions of FAPs 1 and 2 look like (`high_level_faps`),
4. else its own first value; and if it has none it moves nothing.

A partner stands in only where it has been set itself.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.mpeg4 import fap_by_name, fap_table
from .high_level_faps import HIGH_LEVEL, low_level_faps, speaks_high_level

_log = logging.getLogger(__name__)
Floats = NDArray[np.float64]

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


@dataclass(frozen=True, eq=False)
class CompletedFaps:
    """What a clip's FAPs are once those that it leaves unset are derived.

    Attributes
    ----------
    clip : Clip
        FAPs 3 to 68 that are given or implied, set in every frame, table units.
    derived : mapping from FAP to what stands in for it
        The partner's name, or ``"viseme/expression"``; of those that have no value of their own.
    n_filled : mapping from FAP to int
        Frames between or beyond its own values; of those that have some, but not in every frame.
    """

    clip: Clip
    derived: Mapping[str, str]
    n_filled: Mapping[str, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "derived", MappingProxyType(dict(self.derived)))
        object.__setattr__(self, "n_filled", MappingProxyType(dict(self.n_filled)))

    def as_text(self) -> str:
        """One line for people; empty if every FAP was given in every frame."""
        parts = []
        high = [n for n, source in self.derived.items() if source == HIGH_LEVEL]
        pairs = [f"{n} from {s}" for n, s in self.derived.items() if s != HIGH_LEVEL]
        if pairs:
            parts.append("derived: " + _listed(pairs))
        if high:
            parts.append(f"from visemes and expressions: {_listed(high)}")
        if self.n_filled:
            parts.append(
                "gaps filled: " + _listed([f"{n} ({k})" for n, k in self.n_filled.items()])
            )
        return "; ".join(parts)


def gives_faps(clip: Clip) -> bool:
    """Whether a clip has channels of FAPs, of high level or low."""
    return speaks_high_level(clip) or bool(set(clip.channels) & set(fap_by_name()))


def complete_faps(clip: Clip) -> dict[str, Floats]:
    """All FAPs that a clip gives or implies, by name, (T,) each and finite, table units.

    What is left is absent from the mapping (and moves nothing). See `completed`, which also says
    what was derived.

    Raises
    ------
    InputError
        If the clip holds no FAP.
    """
    found = completed(clip).clip
    return {name: np.array(found[name]) for name in found.channels}


def completed(clip: Clip) -> CompletedFaps:
    """A clip's FAPs, with those that it leaves unset derived by the rules of this module.

    Parameters
    ----------
    clip : Clip
        FAPs of low and high level; other channels are left out.

    Raises
    ------
    InputError
        If the clip holds no FAP.
    """
    given = [n for n in clip.channels if n in fap_by_name() and not np.isnan(clip[n]).all()]
    high = speaks_high_level(clip)
    if not given and not high:
        raise InputError(
            "the clip gives no FAP; its channels are "
            + (", ".join(clip.channels[:5]) + (" ..." if len(clip.channels) > 5 else "") or "none")
        )
    paired, derived = from_partners(clip)
    whole = low_level_faps(paired) if high else paired
    values, n_filled = {}, {}
    for name in (fap.name for fap in fap_table()):
        if name not in whole.channels or np.isnan(whole[name]).all():
            continue
        values[name] = _filled(clip.time_s, whole[name])
        if name not in given:
            derived.setdefault(name, HIGH_LEVEL)
        elif np.isnan(clip[name]).any():
            n_filled[name] = int(np.isnan(clip[name]).sum())
    stacked = np.stack(list(values.values()), axis=1)
    order = {name: derived[name] for name in values if name in derived}
    found = CompletedFaps(Clip(clip.time_s, tuple(values), stacked), order, n_filled)
    if found.as_text():
        _log.debug("unset FAPs: %s", found.as_text())
    return found


def from_partners(clip: Clip) -> tuple[Clip, dict[str, str]]:
    """The clip with unset FAPs taken from their partners: rules 1 and 2 of this module.

    Returns
    -------
    Clip
        The clip's channels, then those that were derived. NaN where still nothing is set.
    derived : dict from FAP to partner
        Of FAPs that the clip itself never sets.
    """
    names = fap_by_name()
    found = {n: clip[n] for n in clip.channels if n in names and not np.isnan(clip[n]).all()}
    own = set(found)
    derived: dict[str, str] = {}
    by_number = {fap.number: fap.name for fap in fap_table()}
    for inner, outer in LIP_PAIRS:
        for a, b in ((inner, outer), (outer, inner)):
            _stand_in(found, by_number[a], by_number[b], derived)
    sides = [(n, other_side(n)) for n in names]
    before = dict(found)  # so that left and right may stand in for each other in different frames
    for name, other in sides:
        if other is not None and other in before:
            _stand_in(found, name, other, derived, before)
    others = tuple(n for n in clip.channels if n not in found)
    channels = (*others, *found)
    columns = [*(clip[n] for n in others), *found.values()]
    values = np.stack(columns, axis=1) if columns else np.zeros((len(clip.time_s), 0))
    return Clip(clip.time_s, channels, values), {n: s for n, s in derived.items() if n not in own}


def _stand_in(
    found: dict[str, Floats],
    name: str,
    partner: str,
    derived: dict[str, str],
    source: Mapping[str, Floats] | None = None,
) -> None:
    """Let a partner's values stand before a FAP's first one."""
    values = (found if source is None else source).get(partner)
    if values is None:
        return
    if name not in found:
        found[name] = np.array(values)
        derived[name] = partner
        return
    first = int(np.argmax(~np.isnan(found[name])))
    if first and not np.isnan(values[:first]).all():
        found[name] = np.concatenate([values[:first], found[name][first:]])


def other_side(name: str) -> str | None:
    """The FAP that does on the right what this one does on the left, or the other way round."""
    for a, b in (("_l_", "_r_"), ("_lm", "_rm")):
        for this, that in ((a, b), (b, a)):
            swapped = name.replace(this, that)
            if swapped != name and swapped in fap_by_name():
                return swapped
    return None


def _filled(time_s: Floats, values: Floats) -> Floats:
    known = ~np.isnan(values)
    return np.interp(time_s, time_s[known], values[known])


def _listed(items: list[str], most: int = 6) -> str:
    more = len(items) - most
    return ", ".join(items[:most]) + (f" and {more} more" if more > 0 else "")
