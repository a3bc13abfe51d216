"""Talkers: the men, women and children whose vowels were measured.

References
----------
Hillenbrand, Getty, Clark & Wheeler, Acoustic characteristics of American English vowels, JASA
97(5), 1995: the tokens in ``data/``.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly

GROUPS = ("man", "woman", "child")
#: The twelve vowels of the table.
MEASURED_VOWELS = (
    "AA", "AE", "AH", "AO", "EH", "ER", "EY", "IH", "IY", "OW", "UH", "UW",
)  # fmt: skip
SOUND_MM_PER_S = 350_000.0  # speed of sound in warm, moist air
#: Where in a vowel its formants were measured, as fractions of its duration.
MEASURED_AT = (0.2, 0.5, 0.8)

_GROUP_OF_LETTER = {"m": "man", "w": "woman", "b": "child", "g": "child"}
_MAN_TRACT_MM = 172.0  # the average man's tract, to which others are scaled by their formants
_N_FORMANTS = 4


@dataclass(frozen=True, eq=False)
class Vowel:
    """How one talker says one vowel in h-V-d.

    Attributes
    ----------
    formants_hz : (3, 4) float64, Hz
        F1 to F4 at 20, 50 and 80 % of the duration. F4 was measured once and is constant.
    duration_s : float
    f0_hz : float
    is_measured : (4,) bool
        False for a formant that the table lacks: the group's mean, scaled to this talker's tract.
    """

    formants_hz: NDArray[np.float64]
    duration_s: float
    f0_hz: float
    is_measured: NDArray[np.bool_]

    def __post_init__(self) -> None:
        shape = (len(MEASURED_AT), _N_FORMANTS)
        object.__setattr__(self, "formants_hz", readonly(self.formants_hz, shape, "formants_hz"))
        measured = readonly(self.is_measured, (_N_FORMANTS,), "is_measured", np.bool_)
        object.__setattr__(self, "is_measured", measured)


@dataclass(frozen=True, eq=False)
class Talker:
    """One person of the table.

    Attributes
    ----------
    name : str
        As in the table: ``m01``, ``w12``, ``b03``, ``g07``.
    group : str
        ``man``, ``woman`` or ``child``.
    f0_hz : float
        Median over the vowels.
    tract_mm : float
        Length of the vocal tract from the glottis to the lips.
    scale : float
        The talker's formants over the average man's.
    vowels : mapping from ARPAbet to Vowel
        All of `MEASURED_VOWELS`.
    """

    name: str
    group: str
    f0_hz: float
    tract_mm: float
    scale: float
    vowels: Mapping[str, Vowel]

    def __post_init__(self) -> None:
        missing = sorted(set(MEASURED_VOWELS) - set(self.vowels))
        if missing:
            raise ValueError(f"talker {self.name} lacks the vowels {' '.join(missing)}")
        object.__setattr__(self, "vowels", MappingProxyType(dict(self.vowels)))

    @property
    def formant_spacing_hz(self) -> float:
        """Distance of the high formants: c / 2 L."""
        return SOUND_MM_PER_S / (2 * self.tract_mm)


@cache
def all_talkers() -> tuple[Talker, ...]:
    """The 139 talkers, in the order of their names."""
    tokens = _tokens()
    names = sorted({name for name, _ in tokens})
    means = {g: _group_means(tokens, g) for g in GROUPS}
    return tuple(_talker(name, tokens, means) for name in names)


def group_talkers(group: str) -> tuple[Talker, ...]:
    """The talkers of one group.

    Raises
    ------
    ValueError
        If there is no such group.
    """
    if group not in GROUPS:
        raise ValueError(f"group must be one of {', '.join(GROUPS)}, got {group!r}")
    return tuple(t for t in all_talkers() if t.group == group)


def talker_by_name(name: str) -> Talker:
    """The talker of a name.

    Raises
    ------
    ValueError
        If there is none.
    """
    for talker in all_talkers():
        if talker.name == name:
            return talker
    raise ValueError(
        f"no talker {name!r}; names are m01 to m50, w01 to w50, b01 to b29, g01 to g21"
    )


def mean_talker(group: str) -> Talker:
    """A talker with the mean formants, F0 and durations of a group."""
    people = group_talkers(group)
    vowels = {}
    for name in MEASURED_VOWELS:
        said = [t.vowels[name] for t in people]
        vowels[name] = Vowel(
            np.mean([v.formants_hz for v in said], axis=0),
            float(np.mean([v.duration_s for v in said])),
            float(np.mean([v.f0_hz for v in said])),
            np.ones(_N_FORMANTS, bool),
        )
    scale = float(np.exp(np.mean([np.log(t.scale) for t in people])))
    f0 = float(np.mean([t.f0_hz for t in people]))
    return Talker(f"mean-{group}", group, f0, _MAN_TRACT_MM / scale, scale, vowels)


def _tokens() -> dict[tuple[str, str], NDArray[np.float64]]:
    """(talker, vowel) → duration ms, f0, F1..F4, then F1-F3 at 20, 50, 80 %; NaN if missing."""
    table = files(__package__) / "data" / "hillenbrand1995_tokens.csv"
    columns = ["duration_ms", "f0", "f1", "f2", "f3", "f4"]
    columns += [f"f{k}_{at}" for at in (20, 50, 80) for k in (1, 2, 3)]
    found = {}
    with table.open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            values = np.array([float(row[c]) for c in columns])
            found[row["talker"], row["arpabet"]] = np.where(values > 0, values, np.nan)
    return found


def _group_means(
    tokens: dict[tuple[str, str], NDArray[np.float64]], group: str
) -> dict[str, NDArray[np.float64]]:
    members = {n for n, _ in tokens if _GROUP_OF_LETTER[n[0]] == group}
    return {
        v: np.nanmean([x for (n, w), x in tokens.items() if n in members and w == v], axis=0)
        for v in MEASURED_VOWELS
    }


def _talker(
    name: str,
    tokens: dict[tuple[str, str], NDArray[np.float64]],
    means: dict[str, dict[str, NDArray[np.float64]]],
) -> Talker:
    group = _GROUP_OF_LETTER[name[0]]
    nothing = np.full(15, np.nan)
    own = {v: tokens.get((name, v), nothing) for v in MEASURED_VOWELS}
    in_group = _formant_ratio(own, means[group])
    f0 = float(np.nanmedian([own[v][1] for v in MEASURED_VOWELS]))
    vowels = {v: _vowel(own[v], means[group][v], in_group, f0) for v in MEASURED_VOWELS}
    scale = in_group * _formant_ratio(means[group], means["man"])
    return Talker(name, group, f0, _MAN_TRACT_MM / scale, scale, vowels)


def _formant_ratio(
    own: dict[str, NDArray[np.float64]], reference: dict[str, NDArray[np.float64]]
) -> float:
    """How much higher one set of formants lies than another: mean over F1 to F3 of all vowels."""
    ratios = [np.log(own[v][2:5] / reference[v][2:5]) for v in MEASURED_VOWELS]
    return float(np.exp(np.nanmean(ratios)))


def _vowel(
    own: NDArray[np.float64], mean: NDArray[np.float64], ratio: float, f0_hz: float
) -> Vowel:
    measured = ~np.isnan(own[2:6])
    steady = np.where(measured, own[2:6], mean[2:6] * ratio)
    formants = np.tile(steady, (3, 1))
    moving = own[6:15].reshape(3, 3).copy()
    # where a formant was lost on the way, the mean's movement about this token's steady value
    drift = mean[6:15].reshape(3, 3) / mean[2:5] * steady[:3]
    # and where F3 was lost into F2 (one token of w14)
    moving[:, 2] = np.where(moving[:, 2] < 1.01 * moving[:, 1], np.nan, moving[:, 2])
    drift[:, 2] = np.maximum(drift[:, 2], 1.05 * moving[:, 1])
    formants[:, :3] = np.where(np.isnan(moving), drift, moving)
    formants[:, 3] = np.maximum(formants[:, 3], formants[:, 2].max() + 200.0)  # F4 stays above F3
    duration = own[0] if np.isfinite(own[0]) else mean[0]
    f0 = own[1] if np.isfinite(own[1]) else f0_hz
    return Vowel(formants, float(duration) / 1000, float(f0), measured)
