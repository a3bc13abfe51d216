"""What a head's shapes are called: ARKit's names in any spelling, VRM's, ICT's and others'.

A name is cut into words (``JAW_OPEN``, ``jawOpen``, ``Jaw Open``, ``face.jaw-open``), the side is
found (``Left``, ``_L``, ``l_``), and the rest is looked up without case. Names of other conventions
are told as amounts of ARKit's shapes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType

from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..heads.expressions import VISEMES, expression_weights, viseme_weights

#: Kinds of meaning: an ARKit shape, one side of an ARKit shape that has none, another convention's
#: pose (amounts of several ARKit shapes), or what is added where several shapes meet.
KINDS = ("arkit", "side", "pose", "corrective")


@dataclass(frozen=True)
class ShapeMeaning:
    """What one shape of a head stands for.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    amounts : mapping from ARKit name to amount
        Of a shape at weight 1. For ``corrective``: the shapes that it corrects, each 1; its weight
        is the product of theirs.
    side : str
        ``"left"``, ``"right"`` or ``""``.
    """

    kind: str
    amounts: Mapping[str, float]
    side: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "amounts", MappingProxyType(dict(self.amounts)))


@dataclass(frozen=True, eq=False)
class ShapeNames:
    """What a head's shapes mean.

    Attributes
    ----------
    meanings : mapping from a shape's name, as the head has it, to ShapeMeaning
    unknown : mapping from the names that say nothing to us to the nearest name that does, or ""
    """

    meanings: Mapping[str, ShapeMeaning]
    unknown: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "meanings", MappingProxyType(dict(self.meanings)))
        object.__setattr__(self, "unknown", MappingProxyType(dict(self.unknown)))

    def of_arkit(self, name: str) -> tuple[str, ...]:
        """The head's shapes that are an ARKit shape, or its two sides; none if it lacks it."""
        return tuple(
            shape
            for shape, meaning in self.meanings.items()
            if meaning.kind in ("arkit", "side") and name in meaning.amounts
        )

    @property
    def missing(self) -> tuple[str, ...]:
        """ARKit's shapes that the head lacks."""
        return tuple(name for name in ARKIT_SHAPES if not self.of_arkit(name))

    def unknown_text(self) -> str:
        """The unknown names for people: ``JawOpn (jawOpen?), Hat``; empty if there is none."""
        return ", ".join(f"{n} ({guess}?)" if guess else n for n, guess in self.unknown.items())


def understand_shapes(names: Iterable[str]) -> ShapeNames:
    """Find out what shapes mean by their names.

    Where two names mean the same (a head may carry ARKit's shapes twice), the first one counts,
    and the others are unknown, with the first as the guess.

    Examples
    --------
    >>> found = understand_shapes(["JAW_OPEN", "browInnerUp_L", "blink", "mouthSmile_Lft", "Hat"])
    >>> dict(found.meanings["JAW_OPEN"].amounts)
    {'jawOpen': 1.0}
    >>> found.meanings["browInnerUp_L"].kind, found.meanings["browInnerUp_L"].side
    ('side', 'left')
    >>> sorted(found.meanings["blink"].amounts)
    ['eyeBlinkLeft', 'eyeBlinkRight']
    >>> found.unknown_text()
    'Hat'
    """
    meanings: dict[str, ShapeMeaning] = {}
    unknown: dict[str, str] = {}
    taken: dict[tuple[str, str, tuple[tuple[str, float], ...]], str] = {}
    for name in names:
        meaning = _meaning(name)
        if meaning is None:
            unknown[name] = _nearest(name)
            continue
        key = meaning.kind, meaning.side, tuple(sorted(meaning.amounts.items()))
        if key in taken:
            unknown[name] = taken[key]
        else:
            taken[key] = name
            meanings[name] = meaning
    return ShapeNames(meanings, unknown)


def other_side_of(name: str) -> str | None:
    """The ARKit shape that does on the other side what this one does; None if it has none."""
    for a, b in (("Left", "Right"), ("Right", "Left")):
        if name.endswith(a):
            other = name.removesuffix(a) + b
            return other if other in ARKIT_SHAPES else None
    return None


def _meaning(name: str) -> ShapeMeaning | None:
    for words, side in _readings(name):
        found = _table().get((words, side))
        if found is not None:
            return found
    return _corrective(name)


def _corrective(name: str) -> ShapeMeaning | None:
    """``jawOpen_mouthSmileLeft``, ``jawOpen+mouthSmile_L``, ``corrective:a*b``: two or more shapes
    that are known by themselves."""
    bare = re.sub(r"(?i)^(corrective|corr|combo|comb|fix)[\s_:.-]+", "", name)
    for mark in ("__", "+", "*", "&", " x ", "_"):
        parts = [part.strip(" _-.:") for part in bare.split(mark)]
        if len(parts) < 2 or not all(parts):
            continue
        found = [_alone(part) for part in _joined_sides(parts)]
        if len(found) > 1 and all(f is not None and f.kind == "arkit" for f in found):
            amounts = {n: 1.0 for f in found if f is not None for n in f.amounts}
            if len(amounts) == len(found):
                return ShapeMeaning("corrective", amounts)
    return None


def _alone(name: str) -> ShapeMeaning | None:
    for words, side in _readings(name):
        if (words, side) in _table():
            return _table()[words, side]
    return None


def _joined_sides(parts: list[str]) -> list[str]:
    """``[mouthSmile, L, jawOpen]`` as ``[mouthSmile_L, jawOpen]``."""
    found: list[str] = []
    for part in parts:
        if part.lower() in _SIDES and found:
            found[-1] = f"{found[-1]}_{part}"
        else:
            found.append(part)
    return found


_SIDES = {
    "l": "left",
    "r": "right",
    "left": "left",
    "right": "right",
    "lft": "left",
    "rgt": "right",
}
#: Words before or behind the name proper that tell nothing.
_EMPTY_WORDS = frozenset(
    re.findall(
        r"\w+",
        "blendshape blendshapes bs shape morph target head face facial arkit fcl vrm expression"
        " body mesh key ctrl model geo all",
    )
)


def _readings(name: str) -> Iterable[tuple[str, str]]:
    """(letters, side) that a name may mean, the fullest first."""
    text = name.strip()
    for tail in (text, re.split(r"[|:./]", text)[-1]):
        words = _words(tail)
        while words:
            yield from _sided(words)
            if words[0] in _EMPTY_WORDS or words[0].isdigit():
                words = words[1:]
            elif words[-1] in _EMPTY_WORDS or words[-1].isdigit():
                words = words[:-1]
            else:
                break


def _sided(words: list[str]) -> Iterable[tuple[str, str]]:
    for at in (len(words) - 1, 0):
        if words[at] in _SIDES and len(words) > 1:
            yield "".join(words[:at] + words[at + 1 :]), _SIDES[words[at]]
    yield "".join(words), ""


def _words(text: str) -> list[str]:
    """Letters and digits by word, lower case."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text)
    return [word.lower() for word in re.split(r"[\s_\-.:|/+*&()\[\]]+", spaced) if word]


def _nearest(name: str) -> str:
    keys = {words + side: label for (words, side), label in _labels().items()}
    for words, side in _readings(name):
        near = get_close_matches(words + side, keys, n=1, cutoff=0.75)
        if near:
            return keys[near[0]]
    return ""


@cache
def _labels() -> Mapping[tuple[str, str], str]:
    """What keys of the table are called in a guess."""
    return {
        key: next(iter(meaning.amounts)) if meaning.kind == "arkit" else key[0]
        for key, meaning in _table().items()
        if len(key[0]) > 2
    }


@cache
def _table() -> Mapping[tuple[str, str], ShapeMeaning]:
    """(letters, side) → meaning."""
    found: dict[tuple[str, str], ShapeMeaning] = {}
    for name in ARKIT_SHAPES:
        meaning = ShapeMeaning("arkit", {name: 1.0}, _side_of(name))
        found["".join(_words(name)), ""] = meaning
        words = _words(name)
        if words[-1] in _SIDES:
            found["".join(words[:-1]), _SIDES[words[-1]]] = meaning
    for name in ("browInnerUp", "cheekPuff"):  # one shape with ARKit, two in other rigs
        for side in ("left", "right"):
            found[name.lower(), side] = ShapeMeaning("side", {name: 1.0}, side)
    for letters, shape in _SYNONYMS.items():
        _add_synonym(found, letters, shape)
    for letters, amounts in _poses().items():
        found.setdefault((letters, ""), ShapeMeaning("pose", amounts))
    for letters, stem in _SIDED_POSES.items():
        for side in ("left", "right"):
            meaning = ShapeMeaning("arkit", {f"{stem}{side.title()}": 1.0}, side)
            found.setdefault((letters, side), meaning)
    return MappingProxyType(found)


def _side_of(name: str) -> str:
    """The side of the face that a shape is on; jaw and mouth to the left are on both."""
    if name in ("jawLeft", "jawRight", "mouthLeft", "mouthRight"):
        return ""
    return next((s for s in ("left", "right") if name.endswith(s.title())), "")


def _add_synonym(found: dict[tuple[str, str], ShapeMeaning], letters: str, shape: str) -> None:
    """A synonym of a shape, or of both of a pair whose stem is given."""
    stem = shape.lower()
    if shape in ARKIT_SHAPES:
        for side in ("", "left", "right"):
            if (stem, side) in found:
                found.setdefault((letters, side), found[stem, side])
        return
    for side in ("left", "right"):
        found.setdefault((letters, side), found[stem, side])
    both = {f"{shape}Left": 1.0, f"{shape}Right": 1.0}
    found.setdefault((letters, ""), ShapeMeaning("pose", both))


#: Other rigs' words. A stem without Left or Right stands for both sides.
_SYNONYMS = {
    "cheekraise": "cheekSquint", "eyeclose": "eyeBlink", "eyesclosed": "eyeBlink",
    "browraiseinner": "browInnerUp", "innerbrowraise": "browInnerUp",
    "browraiseouter": "browOuterUp", "browdrop": "browDown", "browlower": "browDown",
    "jawdrop": "jawOpen", "mouthopen": "jawOpen",
    "mouthcornerpull": "mouthSmile", "mouthcornerdepress": "mouthFrown", "nosewrinkle": "noseSneer",
    "mouthupperlipup": "mouthUpperUp", "mouthlowerlipdown": "mouthLowerDown",
    "mouthlippress": "mouthPress", "mouthupup": "mouthUpperUp", "mouthdown": "mouthLowerDown",
    "mouthkiss": "mouthPucker", "cheekpuffed": "cheekPuff", "mouthrollinlower": "mouthRollLower",
    "mouthrollinupper": "mouthRollUpper",
    # FACS
    "au1": "browInnerUp", "au2": "browOuterUp", "au4": "browDown", "au5": "eyeWide",
    "au6": "cheekSquint", "au7": "eyeSquint", "au9": "noseSneer", "au10": "mouthUpperUp",
    "au12": "mouthSmile", "au14": "mouthDimple", "au15": "mouthFrown", "au16": "mouthLowerDown",
    "au17": "mouthShrugLower", "au18": "mouthPucker", "au20": "mouthStretch",
    "au22": "mouthFunnel", "au24": "mouthPress", "au26": "jawOpen", "au43": "eyeBlink",
    "au45": "eyeBlink",
}  # fmt: skip
#: Poses with a side: VRM's ``blink_l`` and ``blinkLeft``, MMD's winks by their English names.
_SIDED_POSES = {"blink": "eyeBlink", "wink": "eyeBlink"}


def _both(stem: str) -> dict[str, float]:
    return {f"{stem}Left": 1.0, f"{stem}Right": 1.0}


@cache
def _poses() -> Mapping[str, Mapping[str, float]]:
    """Letters of another convention's pose → ARKit amounts."""
    looks = {
        "lookup": _both("eyeLookUp"), "lookdown": _both("eyeLookDown"),
        "lookleft": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
        "lookright": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
    }  # fmt: skip
    found: dict[str, Mapping[str, float]] = {"blink": _both("eyeBlink"), **looks}
    found["まばたき"] = found["blink"]
    found["wink"] = {"eyeBlinkLeft": 1.0}
    for letters in ("ウィンク", "ウィンク２", "ウィンク2"):
        found[letters] = {"eyeBlinkLeft": 1.0}
    for letters in ("ウィンク右", "ウィンク２右", "ウィンク2右"):
        found[letters] = {"eyeBlinkRight": 1.0}
    vowels = {
        "aa": "aa", "ih": "ih", "ou": "ou", "ee": "E", "oh": "oh",  # VRM 1
        "a": "aa", "i": "ih", "u": "ou", "e": "E", "o": "oh",  # VRM 0
        "あ": "aa", "い": "ih", "う": "ou", "え": "E", "お": "oh",  # MMD
    }  # fmt: skip
    for letters, viseme in vowels.items():
        found[letters] = viseme_weights(viseme)
    for letters in ("a", "i", "u", "e", "o"):  # VRoid: Fcl_MTH_A
        found[f"mth{letters}"] = found[letters]
    for viseme in VISEMES[1:]:
        found[f"viseme{viseme.lower()}"] = viseme_weights(viseme)
    for viseme, ours in (("i", "ih"), ("o", "oh"), ("u", "ou"), ("e", "E")):  # as some write them
        found[f"viseme{viseme}"] = viseme_weights(ours)
    expressions = {
        "happy": "joy", "joy": "joy", "angry": "anger", "anger": "anger", "sad": "sadness",
        "sorrow": "sadness", "sadness": "sadness", "surprised": "surprise", "surprise": "surprise",
        "fear": "fear", "disgust": "disgust",
    }  # fmt: skip
    for letters, expression in expressions.items():
        found[letters] = expression_weights(expression)
    found["relaxed"] = found["fun"] = expression_weights("joy", 0.5)
    return MappingProxyType(found)
