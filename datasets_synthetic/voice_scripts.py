"""What is said: single vowels, vowel sequences, h-V-d words, nonsense, sentences."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ..core.errors import InputError
from ..core.phones import ARPABET, SILENCE
from .voice_phones import phone_kinds
from .voice_talkers import MEASURED_VOWELS

KINDS = ("vowel", "vowels", "hvd", "nonsense", "sentence")

#: Words that the synthesisers know; the stressed vowel is marked with 1.
WORDS: Mapping[str, str] = MappingProxyType(
    {
        "a": "AH",
        "about": "AH B AW1 T",
        "and": "AE N D",
        "apple": "AE1 P AH L",
        "baby": "B EY1 B IY",
        "beach": "B IY1 CH",
        "big": "B IH1 G",
        "bird": "B ER1 D",
        "blue": "B L UW1",
        "book": "B UH1 K",
        "boy": "B OY1",
        "bring": "B R IH1 NG",
        "brother": "B R AH1 DH ER",
        "cheese": "CH IY1 Z",
        "cold": "K OW1 L D",
        "come": "K AH1 M",
        "dog": "D AO1 G",
        "down": "D AW1 N",
        "father": "F AA1 DH ER",
        "feet": "F IY1 T",
        "five": "F AY1 V",
        "food": "F UW1 D",
        "garden": "G AA1 R D AH N",
        "give": "G IH1 V",
        "go": "G OW1",
        "good": "G UH1 D",
        "green": "G R IY1 N",
        "happy": "HH AE1 P IY",
        "he": "HH IY",
        "hot": "HH AA1 T",
        "house": "HH AW1 S",
        "in": "IH N",
        "is": "IH Z",
        "job": "JH AA1 B",
        "judge": "JH AH1 JH",
        "law": "L AO1",
        "long": "L AO1 NG",
        "make": "M EY1 K",
        "man": "M AE1 N",
        "measure": "M EH1 ZH ER",
        "money": "M AH1 N IY",
        "moon": "M UW1 N",
        "mother": "M AH1 DH ER",
        "name": "N EY1 M",
        "never": "N EH1 V ER",
        "new": "N UW1",
        "no": "N OW1",
        "open": "OW1 P AH N",
        "over": "OW1 V ER",
        "people": "P IY1 P AH L",
        "play": "P L EY1",
        "read": "R IY1 D",
        "red": "R EH1 D",
        "river": "R IH1 V ER",
        "sea": "S IY1",
        "see": "S IY1",
        "she": "SH IY",
        "shoes": "SH UW1 Z",
        "sing": "S IH1 NG",
        "small": "S M AO1 L",
        "soup": "S UW1 P",
        "spoon": "S P UW1 N",
        "table": "T EY1 B AH L",
        "the": "DH AH",
        "they": "DH EY",
        "thin": "TH IH1 N",
        "think": "TH IH1 NG K",
        "three": "TH R IY1",
        "to": "T UW",
        "toy": "T OY1",
        "under": "AH1 N D ER",
        "very": "V EH1 R IY",
        "water": "W AO1 T ER",
        "we": "W IY",
        "window": "W IH1 N D OW",
        "with": "W IH DH",
        "yellow": "Y EH1 L OW",
        "yes": "Y EH1 S",
        "you": "Y UW",
        "zoo": "Z UW1",
    }
)

#: Sentences made of `WORDS`; a comma is a pause.
SENTENCES = (
    "the big dog is under the table",
    "we see the blue moon over the water",
    "mother and father bring cheese to the beach",
    "she never read the yellow book",
    "people think the law is very cold",
    "yes, you make good hot soup",
    "the baby is in the green garden",
    "come and play with the toy, boy",
    "five small people sing in the house",
    "bring the new shoes down to the river",
    "no, the judge is happy about the job",
    "the bird is over the window",
    "the thin man is cold",
    "open the window, and see the sea",
    "they measure the food with a spoon",
    "brother, give the money to the judge",
    "you go to the zoo, we go to the sea",
    "the long name is new to you",
    "he is three feet under the house",
    "the baby is happy with the apple",
)


@dataclass(frozen=True)
class ScriptPhone:
    """One phone to say.

    Attributes
    ----------
    phone : str
    is_stressed : bool
        Long, loud and high; only vowels are.
    word : int
        The index of its word; -1 in a pause.
    """

    phone: str
    is_stressed: bool
    word: int


@dataclass(frozen=True)
class Script:
    """Phones to say, with silence at both ends.

    Attributes
    ----------
    kind : str
        From `KINDS`, or ``text``.
    text : str
        What it says, for people.
    phones : tuple of ScriptPhone
    pace : float
        1 for words said alone, as the vowels of the table were; less for running speech.
    """

    kind: str
    text: str
    phones: tuple[ScriptPhone, ...]
    pace: float

    def __post_init__(self) -> None:
        ends = [p.phone for p in (self.phones[:1] + self.phones[-1:])]
        if ends != [SILENCE, SILENCE]:
            raise ValueError("a script begins and ends with silence")


def script_of_text(text: str) -> Script:
    """The script of a text made of `WORDS`.

    Raises
    ------
    InputError
        If there are no words, or one that is not known.
    """
    words = re.findall(r"[a-z']+|[,.;:!?]", text.lower())
    spoken = [w for w in words if w[0].isalpha()]
    unknown = sorted({w for w in spoken if w not in WORDS})
    if unknown:
        raise InputError(
            f"the synthesiser does not know {', '.join(unknown)}: use its words "
            f"({', '.join(sorted(WORDS))}), or eSpeak NG (--synth espeak), which reads anything"
        )
    if not spoken:
        raise InputError("the text has no words to say")
    return _script("text", text, [WORDS.get(w, SILENCE) for w in words], pace=0.55)


def random_script(rng: np.random.Generator, kind: str) -> Script:
    """Something to say, of a kind from `KINDS`.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    if kind == "vowel":
        vowel = str(rng.choice(MEASURED_VOWELS))
        return _script(kind, vowel, [vowel + "1"], pace=1.0)
    if kind == "vowels":
        said = rng.choice(MEASURED_VOWELS, size=int(rng.integers(3, 7)))
        different = [v for i, v in enumerate(said) if i == 0 or v != said[i - 1]]
        return _script(kind, " ".join(different), [f"{v}1" for v in different], pace=0.7)
    if kind == "hvd":
        vowel = str(rng.choice(MEASURED_VOWELS))
        return _script(kind, f"HH {vowel} D", [f"HH {vowel}1 D"], pace=1.0)
    if kind == "nonsense":
        words = [_nonsense(rng) for _ in range(int(rng.integers(3, 7)))]
        return _script(kind, ", ".join(w.replace("1", "") for w in words), words, pace=0.6)
    if kind == "sentence":
        text = SENTENCES[int(rng.integers(len(SENTENCES)))]
        found = script_of_text(text)
        return Script(kind, text, found.phones, found.pace)
    raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")


def join_scripts(first: Script, second: Script) -> Script:
    """Both, with one pause between them."""
    shift = 1 + max(p.word for p in first.phones)
    later = [
        ScriptPhone(p.phone, p.is_stressed, p.word + shift if p.word >= 0 else -1)
        for p in second.phones
    ]
    kind = first.kind if first.kind == second.kind else "mixed"
    text = f"{first.text}. {second.text}"
    return Script(kind, text, first.phones + tuple(later[1:]), min(first.pace, second.pace))


def _script(kind: str, text: str, words: list[str], *, pace: float) -> Script:
    phones = [ScriptPhone(SILENCE, False, -1)]
    index = 0
    for word in words:
        if word == SILENCE:
            if phones[-1].phone != SILENCE:
                phones.append(ScriptPhone(SILENCE, False, -1))
            continue
        phones += [ScriptPhone(p.rstrip("1"), p.endswith("1"), index) for p in word.split()]
        index += 1
    if phones[-1].phone != SILENCE:
        phones.append(ScriptPhone(SILENCE, False, -1))
    return Script(kind, text, tuple(phones), pace)


def _nonsense(rng: np.random.Generator) -> str:
    """A consonant, a vowel, a consonant; sometimes another syllable."""
    kinds = phone_kinds()
    vowels = [p for p in ARPABET if kinds[p].is_vowel]
    consonants = [p for p in ARPABET if not kinds[p].is_vowel]
    onsets = [p for p in consonants if p not in ("NG", "ZH")]
    codas = [p for p in consonants if p not in ("HH", "W", "Y", "R")]
    word = [str(rng.choice(onsets)), str(rng.choice(vowels)) + "1", str(rng.choice(codas))]
    if rng.random() < 0.4:
        word += [str(rng.choice(vowels)), str(rng.choice(codas))]
    return " ".join(word)
