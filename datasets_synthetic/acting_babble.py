"""Babble: phones that sound like talk, for actors who have no sound to follow."""

from __future__ import annotations

import numpy as np

from ..core.phones import SILENCE, PhoneTrack

VOWELS = ("AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW")
ONSETS = (
    "B", "CH", "D", "DH", "F", "G", "HH", "JH", "K", "L", "M", "N", "P", "R", "S", "SH", "T",
    "TH", "V", "W", "Y", "Z", "P L", "B R", "S T", "S P", "F L", "T R", "K W",
)  # fmt: skip
CODAS = ("D", "F", "K", "L", "M", "N", "NG", "P", "R", "S", "T", "V", "Z", "N T", "S T", "M P")
#: Typical length of a phone in connected English, s, by kind; stops with their closure. Klatt
#: (1976) gives about 130 ms for stressed vowels, 70 ms for unstressed ones and for consonants.
_VOWEL_S, _DIPHTHONG_S, _SCHWA_S = 0.115, 0.15, 0.06
_FRICATIVE_S, _NASAL_S, _STOP_S, _GLIDE_S = 0.095, 0.065, 0.075, 0.06
_SPREAD = 0.22  # of lengths, as a standard deviation of the logarithm
_SHORTEST_S, _LONGEST_S = 0.04, 0.3
_PHRASE_END = 1.35  # the last syllable of a phrase is longer


def babble_phrase(rng: np.random.Generator, *, syllables: int) -> list[tuple[str, float]]:
    """Phones of a phrase with their lengths in seconds."""
    found: list[tuple[str, float]] = []
    for i in range(syllables):
        slow = _PHRASE_END if i == syllables - 1 else 1.0
        said: list[str] = []
        if rng.random() < 0.85:
            said += str(rng.choice(ONSETS)).split()
        said.append(str(rng.choice(VOWELS)))
        if rng.random() < (0.6 if i == syllables - 1 else 0.25):
            said += str(rng.choice(CODAS)).split()
        for phone in said:
            length = _typical_s(phone) * slow * float(np.exp(rng.normal(0, _SPREAD)))
            found.append((phone, float(np.clip(length, _SHORTEST_S, _LONGEST_S))))
    return found


def babble(rng: np.random.Generator, *, start_s: float, end_s: float) -> PhoneTrack:
    """Phrases of 2 to 9 syllables with breaths between, from a start to at most an end.

    Phones that would end too late are left out.
    """
    said: list[tuple[str, float, float]] = []
    now = start_s
    while now < end_s:
        for phone, length in babble_phrase(rng, syllables=int(rng.integers(2, 10))):
            said.append((phone, now, now + length))
            now += length
        pause = float(rng.uniform(0.2, 0.6))
        said.append((SILENCE, now, now + pause))
        now += pause
    kept = [s for s in said if s[2] <= end_s]
    return PhoneTrack(
        tuple(s[0] for s in kept), np.array([s[1] for s in kept]), np.array([s[2] for s in kept])
    )


def phone_track(said: list[tuple[str, float]], start_s: float) -> PhoneTrack:
    """Phones with their lengths, one after another from a start."""
    ends = start_s + np.cumsum([length for _, length in said])
    starts = np.concatenate([[start_s], ends[:-1]])
    return PhoneTrack(tuple(phone for phone, _ in said), starts, ends)


def _typical_s(phone: str) -> float:
    if phone in ("AW", "AY", "EY", "OW", "OY"):
        return _DIPHTHONG_S
    if phone in ("AH", "IH", "UH"):
        return _SCHWA_S if phone == "AH" else 0.8 * _VOWEL_S
    if phone in VOWELS:
        return _VOWEL_S
    if phone in ("F", "V", "TH", "DH", "S", "Z", "SH", "ZH", "CH", "JH", "HH"):
        return _FRICATIVE_S
    if phone in ("M", "N", "NG"):
        return _NASAL_S
    return _GLIDE_S if phone in ("L", "R", "W", "Y") else _STOP_S
