"""FAPs 1 and 2, visemes and expressions, as low-level FAPs.

The blending rules of the standard: ``viseme.select1`` counts blend / 63 and ``viseme.select2`` the
rest; each expression counts its intensity / 63 and both are added. FAPs 3 to 68 that are set say
more than either and go before them. What the standard leaves to the decoder, and how it is done
here:

- A viseme that is spoken has the mouth: of an expression's mouth there stays, under a full viseme,
  what the corners do (a smile is heard), and no more, so that lips meet at /m/ in a smiling face.
- ``expression.init_face`` makes the expression the face's neutral: FAPs that are set are then
  added to it, instead of going before it.
- ``viseme.def`` and ``expression.def``: FAPs set in that frame are kept as the look of the viseme
  or expression selected there, if it stands alone, from that frame on.
- A field that a frame does not set keeps its value; before its first one nothing is selected.

The looks are the project's own tables (`heads.expressions`), told in FAPs by those of
`arkit.direct_table`, hence in units of whatever face they are put on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.mpeg4 import EXPRESSION_FIELDS, VISEME_FIELDS, fap_by_name, fap_table
from ..heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from .arkit_table import direct_table

Floats = NDArray[np.float64]

#: Source of a FAP that neither the clip nor a partner gives.
HIGH_LEVEL = "viseme/expression"
#: ``viseme.blend`` and the expressions' intensities run from 0 to this.
FULL = 63
#: FAPs of jaw, lips and tongue; the first of them are the corners of the mouth, that of an
#: expression stay under a viseme.
CORNER_FAPS = frozenset((6, 7, 12, 13, 53, 54, 59, 60))
MOUTH_FAPS = frozenset((3, 4, 5, *range(6, 19), *range(43, 48), *range(51, 61)))
#: Which amount goes with which choice.
_AMOUNTS = {
    "viseme.select1": "viseme.blend",
    "expression.select1": "expression.intensity1",
    "expression.select2": "expression.intensity2",
}
_FIELDS = (*VISEME_FIELDS, *EXPRESSION_FIELDS)
_TURNS = frozenset((48, 49, 50))
#: The chin goes with the jaw's bone, whoever says how far that opens.
_CHIN = "depress_chin"
#: Expressions do not grow evenly: intensities at which they are told.
_INTENSITIES = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True, eq=False)
class Looks:
    """What visemes and expressions are in low-level FAPs.

    Attributes
    ----------
    visemes : mapping from ``viseme_select`` to a mapping from FAP to value, table units
        1 to 14.
    expressions : mapping from ``expression_select`` to a mapping from FAP to (9,) float64
        1 to 6: at intensities 0, 1/8 … 1; linear between.
    """

    visemes: Mapping[int, Mapping[str, float]]
    expressions: Mapping[int, Mapping[str, Floats]]

    def __post_init__(self) -> None:
        for name in ("visemes", "expressions"):
            kept = {k: MappingProxyType(dict(v)) for k, v in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(kept))

    def viseme(self, select: int, share: float = 1.0) -> dict[str, float]:
        """A viseme's FAPs; none for silence, or for a number that the standard does not use."""
        return {n: share * v for n, v in self.visemes.get(select, {}).items()}

    def expression(self, select: int, intensity: float) -> dict[str, float]:
        """An expression's FAPs at an intensity from 0 to 1."""
        i = min(max(intensity, 0.0), 1.0)
        look = self.expressions.get(select, {})
        return {n: float(np.interp(i, _INTENSITIES, v)) for n, v in look.items()}


@cache
def standard_looks() -> Looks:
    """The 14 visemes and six expressions as FAPs of any face."""
    visemes = {i: _faps_of(viseme_weights(i)) for i in range(1, len(VISEMES))}
    expressions = {}
    for number, name in enumerate(EXPRESSIONS, start=1):
        steps = [_faps_of(expression_weights(name, float(i))) for i in _INTENSITIES]
        expressions[number] = {n: np.array([s.get(n, 0.0) for s in steps]) for n in steps[-1]}
    return Looks(visemes, expressions)


def _faps_of(weights: Mapping[str, float]) -> dict[str, float]:
    found: dict[str, float] = {}
    for shape, weight in weights.items():
        for row in direct_table()[shape]:
            if row.fap != _CHIN:
                found[row.fap] = found.get(row.fap, 0.0) + row.amount * weight
    return found


def speaks_high_level(clip: Clip) -> bool:
    """Whether a clip ever selects a viseme or an expression."""
    fields = ("viseme.select1", "viseme.select2", "expression.select1", "expression.select2")
    return any(bool(np.nan_to_num(clip[f]).any()) for f in fields if f in clip.channels)


def low_level_faps(clip: Clip, looks: Looks | None = None) -> Clip:
    """FAPs 1 and 2 turned into FAPs 3 to 68.

    A FAP that the clip sets goes before what visemes and expressions say of it, from the first
    frame on in which it is set (what it is afterwards, where it is not set, its own values say:
    decoders keep a FAP until it is set anew).

    Parameters
    ----------
    clip : Clip
        With fields of FAPs 1 and 2, and low-level FAPs, in the table's units.
    looks : Looks or None
        None: `standard_looks`.

    Returns
    -------
    Clip
        At the same times, without the fields of FAPs 1 and 2. Channels of its own come first; those
        that visemes and expressions move are set wherever the clip selects one, and 0 where it
        selects none.

    Raises
    ------
    InputError
        If the clip selects one without saying how much of it.
    """
    _check_amounts(clip)
    frames = [dict(look) for look, _ in _frames(clip, standard_looks() if looks is None else looks)]
    own = {n: clip[n] for n in clip.channels if n not in _FIELDS}
    moved = [f.name for f in fap_table() if any(f.name in look for look in frames)]
    n = len(clip.time_s)
    found = dict(own)
    for name in moved:
        said = np.array([look.get(name, 0.0) for look in frames])
        if name not in own:
            found[name] = said
            continue
        known = ~np.isnan(own[name])
        first = int(np.argmax(known)) if known.any() else n
        start = _held(clip, "expression.init_face") > 0
        base = np.where(start, said, 0.0)
        found[name] = np.concatenate([said[:first], (own[name] + base)[first:]])
    values = np.stack(list(found.values()), axis=1) if found else np.zeros((n, 0))
    return Clip(clip.time_s, tuple(found), values)


def _check_amounts(clip: Clip) -> None:
    for select, amount in _AMOUNTS.items():
        selects = select in clip.channels and np.nan_to_num(clip[select]).any()
        if selects and (amount not in clip.channels or np.isnan(clip[amount]).all()):
            raise InputError(f"the clip gives {select} without {amount} (0 to {FULL})")


def taught_looks(clip: Clip, looks: Looks | None = None) -> Looks:
    """Looks as a clip leaves them behind, with what its ``def`` bits taught."""
    found = standard_looks() if looks is None else looks
    for _, known in _frames(clip, found):
        found = known
    return found


def _held(clip: Clip, field: str) -> Floats:
    """A field's value in every frame: the last that was set, 0 before."""
    if field not in clip.channels:
        return np.zeros(len(clip.time_s))
    known = ~np.isnan(clip[field])
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    return np.where(last >= 0, clip[field][np.maximum(last, 0)], 0.0)


def _frames(clip: Clip, looks: Looks) -> Iterator[tuple[dict[str, float], Looks]]:
    """What visemes and expressions say in each frame, FAP by FAP; and the looks known by then."""
    rows = np.stack([_held(clip, f) for f in _FIELDS], axis=1)
    previous, answer = None, dict[str, float]()
    for frame, row in enumerate(rows):
        before = looks
        looks = _taught(looks, clip, row, frame)
        if looks is not before or previous is None or not np.array_equal(row, previous):
            answer = _look(looks, row)
        previous = row
        yield answer, looks


def _look(looks: Looks, row: Floats) -> dict[str, float]:
    v1, v2, blend, _, e1, i1, e2, i2, _, _ = row
    share = float(np.clip(blend / FULL, 0.0, 1.0))
    spoken = _sum(looks.viseme(int(v1), share), looks.viseme(int(v2), 1 - share))
    felt = _sum(looks.expression(int(e1), i1 / FULL), looks.expression(int(e2), i2 / FULL))
    strength = share * (int(v1) in looks.visemes) + (1 - share) * (int(v2) in looks.visemes)
    return _together(spoken, felt, strength)


def _taught(looks: Looks, clip: Clip, row: Floats, frame: int) -> Looks:
    """The looks after a frame whose ``def`` bits may be set."""
    v1, v2, blend, v_def, e1, i1, e2, i2, _, e_def = row
    if v_def and (alone := _alone((v1, blend), (v2, FULL - blend))):
        looks = _with_viseme(looks, alone[0], _set_in(clip, frame))
    if e_def and (alone := _alone((e1, i1), (e2, i2))):
        looks = _with_expression(looks, alone[0], alone[1] / FULL, _set_in(clip, frame))
    return looks


def _together(
    spoken: dict[str, float], felt: dict[str, float], strength: float
) -> dict[str, float]:
    """Speech and expression in one face; `strength` of the speech, 0 to 1."""
    kept = {}
    for name, value in felt.items():
        number = fap_by_name()[name].number
        leaves = number in MOUTH_FAPS and number not in CORNER_FAPS
        kept[name] = value * (1 - strength) if leaves else value
    return _sum(spoken, kept)


def _sum(a: Mapping[str, float], b: Mapping[str, float]) -> dict[str, float]:
    return {n: a.get(n, 0.0) + b.get(n, 0.0) for n in (*a, *(k for k in b if k not in a))}


def _alone(first: tuple[float, float], second: tuple[float, float]) -> tuple[int, float] | None:
    """Number and share of the one that is selected, if the other is not."""
    there = [(int(n), s) for n, s in (first, second) if n > 0 and s > 0]
    return there[0] if len({n for n, _ in there}) == 1 else None


def _set_in(clip: Clip, frame: int) -> dict[str, float]:
    """The low-level FAPs that a frame sets."""
    row = clip.values[frame]
    return {
        n: float(v)
        for n, v in zip(clip.channels, row, strict=True)
        if n in fap_by_name() and not np.isnan(v)
    }


def _with_viseme(looks: Looks, select: int, faps: dict[str, float]) -> Looks:
    heard = {n: v for n, v in faps.items() if fap_by_name()[n].number in MOUTH_FAPS}
    visemes = {**looks.visemes, select: {**looks.visemes.get(select, {}), **heard}}
    return Looks(visemes, looks.expressions)


def _with_expression(looks: Looks, select: int, intensity: float, faps: dict[str, float]) -> Looks:
    """The FAPs of an expression at one intensity, in proportion at others."""
    seen = {
        n: v / min(intensity, 1.0) * _INTENSITIES
        for n, v in faps.items()
        if fap_by_name()[n].number not in _TURNS
    }
    expressions = {**looks.expressions, select: {**looks.expressions.get(select, {}), **seen}}
    return Looks(looks.visemes, expressions)
