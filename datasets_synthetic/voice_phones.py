"""What each phone is: how it is made, which class a recogniser of five vowels should give it."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

#: Everything that a frame of speech may be called.
CLASSES = ("a", "e", "i", "o", "u", "glide", "nasal", "fricative", "stop", "silence")
VOWEL_CLASSES = CLASSES[:5]

#: Vowels that begin as one of Hillenbrand's twelve and end as another.
DIPHTHONGS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {"AW": ("AA", "UH"), "AY": ("AA", "IH"), "OY": ("AO", "IH")}
)


@dataclass(frozen=True)
class PhoneKind:
    """One row of ``data/voice_phones.csv``.

    Attributes
    ----------
    phone : str
        ARPAbet, or ``SIL``.
    manner : str
        vowel, glide, nasal, fricative, stop, affricate or silence.
    place : str
        Where the tract is narrowest; empty for vowels and silence.
    class_, class_end : str
        From `CLASSES`: what the phone counts as, at first and at last. They differ for diphthongs
        and affricates.
    is_core : bool
        True for vowels that are one of a e i o u; False for those that are only next to one.
    viseme, viseme_end : int
        MPEG-4's.
    duration_ms : float
        Of a consonant in running speech; 0 for vowels, which have the talker's own.
    voicing, frication : float
        Amplitude of the glottal pulses and of the noise at the constriction.
    noise1_hz, noise1_bw, noise1, noise2_hz, noise2_bw, noise2, bypass : float
        Two resonances (Hz, Hz, amplitude) and the unfiltered share of that noise, for a man.
    """

    phone: str
    manner: str
    place: str
    class_: str
    class_end: str
    is_core: bool
    viseme: int
    viseme_end: int
    duration_ms: float
    voicing: float
    frication: float
    noise1_hz: float
    noise1_bw: float
    noise1: float
    noise2_hz: float
    noise2_bw: float
    noise2: float
    bypass: float

    @property
    def is_vowel(self) -> bool:
        """A vowel or a diphthong."""
        return self.manner == "vowel"


@cache
def phone_kinds() -> Mapping[str, PhoneKind]:
    """Every phone's kind by its name."""
    table = files(__package__) / "data" / "voice_phones.csv"
    convert: dict[str, Callable[[str], Any]] = {
        "str": str,
        "int": int,
        "float": float,
        "bool": lambda text: text == "1",
    }
    found = {}
    with table.open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            values = {
                f.name: convert[str(f.type)](row[f.name.rstrip("_")]) for f in fields(PhoneKind)
            }
            found[row["phone"]] = PhoneKind(**values)
    return MappingProxyType(found)
