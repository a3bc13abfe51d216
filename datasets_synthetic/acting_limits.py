"""What a face can do at once: weights that fight each other give way.

Curves are drawn independently and added, so a smile may meet a frown, or a pressed mouth an open
jaw. The rules here are products of smooth factors, so what was smooth stays smooth, and a weight
that meets no rival stays what it was.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .acting_curves import CLOSURE, HEAD_CURVES, SEAL, SPEAKING, Floats, saturate, smooth_step

_SIDES = ("Left", "Right")
#: They fight where together they pass `_PEACE`; both at full leave nothing of either.
ANTAGONISTS = (
    ("mouthSmile*", "mouthFrown*"),
    ("mouthSmile*", "mouthPucker"),
    ("mouthStretch*", "mouthPucker"),
    ("mouthStretch*", "mouthFunnel"),
    ("mouthDimple*", "mouthFunnel"),
    ("mouthSmile*", "cheekPuff"),
    ("mouthRollLower", "mouthFunnel"),
    ("mouthRollUpper", "mouthFunnel"),
    ("mouthRollLower", "mouthLowerDown*"),
    ("mouthRollUpper", "mouthUpperUp*"),
    ("mouthShrugLower", "mouthLowerDown*"),
    ("mouthLeft", "mouthRight"),
    ("jawLeft", "jawRight"),
    ("browDown*", "browOuterUp*"),
    ("eyeWide*", "eyeSquint*"),
    ("eyeLookUp*", "eyeLookDown*"),
    ("eyeLookIn*", "eyeLookOut*"),
)
#: Shapes that part the lips: a seal undoes them.
PARTING = ("mouthFunnel", "mouthLowerDown*", "mouthUpperUp*", "tongueOut")
#: Shapes that only closed lips make: an open jaw undoes them.
CLOSED_ONLY = ("mouthPress*", "cheekPuff", "mouthShrugUpper")
#: Of expressions around the mouth this share is left while the actor speaks.
WHILE_SPEAKING = 0.45
MOUTH = (
    "jawOpen", "mouthFrown*", "mouthFunnel", "mouthLowerDown*", "mouthPress*", "mouthPucker",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthSmile*",
    "mouthStretch*", "mouthUpperUp*", "cheekPuff",
)  # fmt: skip
_PEACE = 0.8  # expressions hold some rivals at once: fear both raises and draws down the brows
_FULL_OPEN = 0.35  # jawOpen at which closed-only shapes are gone
_TONGUE_GAP = 0.08  # jawOpen that lets the whole tongue through


def sides(pattern: str) -> tuple[str, ...]:
    """Both sides' shapes for a name that ends in ``*``, else the name itself."""
    if pattern.endswith("*"):
        return tuple(pattern[:-1] + side for side in _SIDES)
    return (pattern,)


def yield_to_speech(acted: Mapping[str, Floats], speaking: Floats) -> dict[str, Floats]:
    """Expressions and gestures with their mouths fainter while the actor speaks.

    Parameters
    ----------
    acted : mapping from curve to (T,) float64
    speaking : (T,) float64 in [0, 1]
    """
    found = dict(acted)
    for name in (n for pattern in MOUTH for n in sides(pattern)):
        if name in found:
            found[name] = found[name] * (1 - (1 - WHILE_SPEAKING) * speaking)
    return found


def limit(curves: Mapping[str, Floats]) -> dict[str, Floats]:
    """Weights that one face can have at once, all in [0, 1].

    Parameters
    ----------
    curves : mapping from curve to (T,) float64, not below zero
        ARKit weights, `SEAL` where lips must be shut, `CLOSURE` where lids must. Curves of the
        head are left alone.

    Returns
    -------
    mapping from curve to (T,) float64
        Without `SEAL`, `CLOSURE` and `SPEAKING`. Lips that are sealed are shut at any opening of
        the jaw: ``mouthClose`` rises to ``jawOpen``, which it never exceeds, and parting shapes
        vanish. Closed lids are ``eyeBlink`` of exactly 1.
    """
    n_frames = len(next(iter(curves.values())))
    seal = curves.get(SEAL, np.zeros(n_frames))
    closure = curves.get(CLOSURE, np.zeros(n_frames))
    w = {
        n: c if n in HEAD_CURVES or n.startswith("eyeBlink") else saturate(c)
        for n, c in curves.items()
        if n not in (SEAL, CLOSURE, SPEAKING)
    }
    _rival(w)
    for name in (n for pattern in PARTING for n in sides(pattern)):
        _scale(w, name, 1 - seal)
    jaw = w.get("jawOpen", np.zeros(n_frames))
    if "mouthClose" in w or seal.any():
        shut = w.get("mouthClose", np.zeros(n_frames))
        # a smooth minimum with jawOpen is jawOpen times a share
        share = saturate(shut / np.maximum(jaw, 1e-3), 0.7)
        w["mouthClose"] = jaw * (seal + (1 - seal) * share)
    gap = jaw - w.get("mouthClose", 0.0)
    open_share = saturate(gap / _FULL_OPEN, 0.5)
    for name in (n for pattern in CLOSED_ONLY for n in sides(pattern)):
        _scale(w, name, 1 - open_share)
    _scale(w, "tongueOut", saturate(gap / _TONGUE_GAP, 0.5))
    for side in _SIDES:  # a lid that shuts is neither wide nor turned up with the eye
        blink = 1 - (1 - w.get(f"eyeBlink{side}", 0.0)) * (1 - closure)
        w[f"eyeBlink{side}"] = blink
        _scale(w, f"eyeWide{side}", 1 - blink)
        _scale(w, f"eyeSquint{side}", 1 - 0.5 * blink)
    return w


def _rival(w: dict[str, Floats]) -> None:
    """Let antagonists take from each other, in place; all see the weights as they were."""
    before = dict(w)
    for one, other in ANTAGONISTS:
        for a, b in _pairs(one, other):
            if a in before and b in before:
                fight = smooth_step(before[a] + before[b], _PEACE, _PEACE)
                w[a] = w[a] * (1 - fight * before[b])
                w[b] = w[b] * (1 - fight * before[a])


def _pairs(one: str, other: str) -> tuple[tuple[str, str], ...]:
    a, b = sides(one), sides(other)
    n = max(len(a), len(b))
    return tuple(zip(a * (n // len(a)), b * (n // len(b)), strict=True))


def _scale(w: dict[str, Floats], name: str, factor: Floats) -> None:
    if name in w:
        w[name] = w[name] * factor
