"""Expressions and visemes as ARKit weights.

Three tables of the project's own, tuned on renders of the built-in heads:

- ``data/expressions_arkit.csv``: MPEG-4's six expressions at full intensity. A shape's weight at
  intensity i is ``weight * i ** power``: a faint smile is of the corners, and the lips part late.
- ``data/visemes_arkit.csv``: MPEG-4's 14 visemes, spoken clearly and alone.
- ``data/phones_mpeg4.csv``: ARPAbet phones and the MPEG-4 visemes they pass through, two for
  diphthongs. The standard gives one example set of sounds a viseme; glides, HH, ER and the
  open-mid vowels are assigned by likeness.

In the tables ``L/R`` in a shape's name stands for ``Left`` and ``Right``, both.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

#: MPEG-4's expressions in the order of ``expression_select`` 1 to 6.
EXPRESSIONS = ("joy", "sadness", "anger", "fear", "disgust", "surprise")
#: MPEG-4's visemes in the order of ``viseme_select`` 0 to 14.
VISEMES = (
    "sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "ih", "oh", "ou",
)  # fmt: skip
BOTH_SIDES = "L/R"


def expression_weights(name: str, intensity: float = 1.0) -> dict[str, float]:
    """ARKit weights of an expression.

    Parameters
    ----------
    name : str
        One of `EXPRESSIONS`.
    intensity : float
        0 neutral to 1 full.

    Raises
    ------
    ValueError
        If there is no such expression, or the intensity lies outside [0, 1].

    Examples
    --------
    >>> faint, full = (expression_weights("joy", i) for i in (0.4, 1.0))
    >>> faint["mouthSmileLeft"] > 0.3 * full["mouthSmileLeft"]
    True
    >>> faint["jawOpen"] < 0.2 * full["jawOpen"]
    True
    """
    if name not in EXPRESSIONS:
        raise ValueError(f"no expression {name!r}; there are {', '.join(EXPRESSIONS)}")
    if not 0 <= intensity <= 1:
        raise ValueError(f"intensity must lie in 0..1, got {intensity:g}")
    return {
        shape: weight * intensity**power
        for shape, (weight, power) in expression_table()[name].items()
    }


def viseme_weights(viseme: int | str, strength: float = 1.0) -> dict[str, float]:
    """ARKit weights of a viseme spoken alone.

    Parameters
    ----------
    viseme : int or str
        ``viseme_select``, 0 to 14, or one of `VISEMES`; silence has no weights.
    strength : float
        0 neutral to 1 clearly spoken.

    Raises
    ------
    ValueError
        If there is no such viseme, or the strength lies outside [0, 1].
    """
    name = VISEMES[viseme] if isinstance(viseme, int) and 0 <= viseme < len(VISEMES) else viseme
    if name not in VISEMES:
        raise ValueError(f"no viseme {viseme!r}; there are 0 to 14, or {', '.join(VISEMES)}")
    if not 0 <= strength <= 1:
        raise ValueError(f"strength must lie in 0..1, got {strength:g}")
    return {shape: strength * weight for shape, weight in viseme_table()[str(name)].items()}


def phone_visemes(phone: str) -> tuple[int, ...]:
    """The MPEG-4 visemes, 0 to 14, that an ARPAbet phone (or ``SIL``) passes through.

    Raises ValueError if there is no such phone.

    Examples
    --------
    >>> phone_visemes("M"), phone_visemes("AY")
    ((1,), (10, 12))
    """
    if phone not in _phone_table():
        raise ValueError(f"no ARPAbet phone {phone!r}; write it in capitals, without stress marks")
    return _phone_table()[phone]


@cache
def expression_table() -> Mapping[str, Mapping[str, tuple[float, float]]]:
    """Expression → shape → (weight at full intensity, power of intensity)."""
    found: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in EXPRESSIONS}
    for row in _rows("expressions_arkit.csv"):
        for shape in shape_names(row["shape"]):
            found[row["expression"]][shape] = float(row["weight"]), float(row["power"])
    return MappingProxyType({name: MappingProxyType(v) for name, v in found.items()})


@cache
def viseme_table() -> Mapping[str, Mapping[str, float]]:
    """Viseme → shape → weight."""
    found: dict[str, dict[str, float]] = {name: {} for name in VISEMES}
    for row in _rows("visemes_arkit.csv"):
        for shape in shape_names(row["shape"]):
            found[row["viseme"]][shape] = float(row["weight"])
    return MappingProxyType({name: MappingProxyType(v) for name, v in found.items()})


def shape_names(written: str) -> tuple[str, ...]:
    """The shape, or both sides' shapes, that a name with or without ``L/R`` stands for."""
    if written.endswith(BOTH_SIDES):
        stem = written.removesuffix(BOTH_SIDES)
        return f"{stem}Left", f"{stem}Right"
    return (written,)


@cache
def _phone_table() -> Mapping[str, tuple[int, ...]]:
    return {
        row["arpabet"]: tuple(int(v) for v in row["mpeg4_visemes"].split())
        for row in _rows("phones_mpeg4.csv")
    }


def _rows(name: str) -> list[dict[str, str]]:
    text = files(__package__).joinpath("data", name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))
