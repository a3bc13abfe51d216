"""Mouth shapes of speech: visemes that flow into each other, lips that meet.

Every phone pulls each articulator (jaw, rounding, lower lip, upper lip, tongue) towards its own
shape, with a strength of its own and within a window that opens before the sound and closes after
it; what is seen is the mean, weighted by pull. That is the idea of dominance (Löfqvist 1990), with
windows of least jerk in place of exponentials, so that curves have no corners. A phone with little
say over an articulator, as /k/ over the lips, takes the shape its neighbours have there; rounding
starts earliest. Lips of /m b p/ are beyond bargaining: they seal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.phones import SILENCE, PhoneTrack
from ..heads.expressions import VISEMES, phone_visemes, viseme_weights
from .acting_curves import NEUTRAL_S, SEAL, SPEAKING, ActingEvent, Floats, Layer, smooth_step

#: The first sound may come this early: before it the lips get ready, and before that is stillness.
FIRST_SOUND_S = NEUTRAL_S + 0.15


@dataclass(frozen=True)
class Articulator:
    """Shapes that move together, and how long before and after a sound they are under way."""

    shapes: tuple[str, ...]
    lead_s: float
    lag_s: float


JAW, ROUND, LOWER, UPPER, TONGUE = range(5)
#: Leads of about 90 ms for jaw and lips and above 120 ms for rounding are in the range that
#: studies of anticipatory coarticulation report (50 to 200 ms).
ARTICULATORS = (
    Articulator(("jawOpen",), 0.09, 0.09),
    Articulator(
        ("mouthPucker", "mouthFunnel", "mouthStretch", "mouthSmile"),
        0.14,
        0.09,
    ),
    Articulator(("mouthLowerDown", "mouthRollLower", "mouthShrugLower"), 0.085, 0.085),
    Articulator(("mouthUpperUp", "mouthRollUpper"), 0.085, 0.085),
    Articulator(("tongueOut",), 0.07, 0.06),
)
#: How much each viseme insists on its shape: jaw, rounding, lower lip, upper lip, tongue.
PULL: Mapping[str, tuple[float, float, float, float, float]] = {
    "sil": (0.7, 0.5, 0.7, 0.7, 0.7),
    "PP": (0.6, 0.15, 1.0, 1.0, 0.5),
    "FF": (1.2, 0.3, 3.0, 2.0, 0.5),
    "TH": (0.9, 0.2, 0.8, 0.6, 2.0),
    "DD": (0.6, 0.15, 0.5, 0.4, 0.5),
    "kk": (0.25, 0.1, 0.25, 0.25, 0.5),
    "CH": (1.2, 1.5, 0.8, 0.8, 0.5),
    "SS": (1.6, 0.4, 1.0, 0.8, 0.5),
    "nn": (0.4, 0.15, 0.4, 0.4, 0.5),
    "RR": (0.6, 0.9, 0.5, 0.5, 0.5),
    "aa": (1.0, 0.7, 0.8, 0.8, 0.5),
    "E": (1.0, 0.8, 0.8, 0.8, 0.5),
    "ih": (1.0, 0.9, 0.8, 0.8, 0.5),
    "oh": (1.0, 1.3, 0.8, 0.8, 0.5),
    "ou": (1.0, 1.5, 0.8, 0.8, 0.5),
}
_VOWELS = ("aa", "E", "ih", "oh", "ou")
_BEFORE_S, _AFTER_S = 0.15, 0.25  # the mouth is busy with speech this much longer than it sounds
_INSIDE_S = 0.03  # how far into a sound its window is still opening
_SEAL_BEFORE_S, _SEAL_AFTER_S = 0.08, 0.085
_SEAL_MIN_S = 0.035  # lips stay shut this long even for the shortest sound
_LITTLE = 0.02  # of pull where nothing pulls
_FULL_VOWEL_S = 0.15  # shorter vowels stay short of their target
_FIRST_PART = 0.55  # of a diphthong


@dataclass(frozen=True)
class _Target:
    viseme: str
    start_s: float
    end_s: float
    strength: float


def mouth_of_speech(t: Floats, phones: PhoneTrack, *, strength: float = 1.0) -> Layer:
    """The mouth saying phones.

    Parameters
    ----------
    t : (T,) float64, s
    phones : PhoneTrack
        Times that no phone covers are silent.
    strength : float
        Of articulation: 0.7 mumbles, 1.2 is emphatic.

    Returns
    -------
    Layer
        Weights of mouth and jaw, `SEAL` and `SPEAKING`; an event ``phrase`` between silences.

    Raises
    ------
    ValueError
        If the first sound is before `FIRST_SOUND_S`.
    """
    phrases = spoken_phrases(phones)
    if phrases and phrases[0][0] < FIRST_SOUND_S - 1e-9:
        raise ValueError(
            f"the first sound is at {phrases[0][0]:.3f} s; performances begin with a neutral face, "
            f"so it must not be before {FIRST_SOUND_S:g} s: move phones and sound together"
        )
    targets = _targets(phones, strength, float(t[-1]) if len(t) else 0.0)
    curves = {SEAL: _seal(t, targets)}
    for k, articulator in enumerate(ARTICULATORS):
        curves.update(_blend(t, targets, k, articulator))
    for side in ("Left", "Right"):
        curves[f"mouthPress{side}"] = viseme_weights("PP")[f"mouthPress{side}"] * curves[SEAL]
    silent = np.ones(len(t))
    for start, end, _ in phrases:
        silent *= 1 - smooth_step(t, start - _BEFORE_S, _BEFORE_S) + smooth_step(t, end, _AFTER_S)
    curves[SPEAKING] = 1 - silent
    events = (ActingEvent("phrase", said, a, b, min(1.0, strength)) for a, b, said in phrases)
    return Layer(curves, tuple(events))


def spoken_phrases(phones: PhoneTrack) -> tuple[tuple[float, float, str], ...]:
    """Runs of phones without silence: (start_s, end_s, the phones); gaps below 50 ms join."""
    found: list[tuple[float, float, list[str]]] = []
    for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
        if phone == SILENCE:
            continue
        if found and start - found[-1][1] < 0.05:
            found[-1] = (found[-1][0], float(end), [*found[-1][2], phone])
        else:
            found.append((float(start), float(end), [phone]))
    return tuple((start, end, " ".join(said)) for start, end, said in found)


def accents(phones: PhoneTrack) -> tuple[tuple[float, float], ...]:
    """Where syllables are stressed: (middle_s, weight 0 to 1) of vowels that outlast neighbours.

    A phone track knows no stress; length is its best sign in English.
    """
    vowels = [
        ((s + e) / 2, e - s)
        for phone, s, e in zip(phones.phones, phones.start_s, phones.end_s, strict=True)
        if VISEMES[phone_visemes(phone)[0]] in _VOWELS and phone not in ("Y", "W")
    ]
    found = []
    for i, (middle, length) in enumerate(vowels):
        around = [d for _, d in vowels[max(0, i - 1) : i + 2]]
        if length >= max(around) and length > 0.08:
            found.append((float(middle), float(min(1.0, length / 0.2))))
    return tuple(found)


def _targets(phones: PhoneTrack, strength: float, end_s: float) -> list[_Target]:
    """Visemes in time; what no phone covers is silence, from long before to long after."""
    found: list[_Target] = []
    last = -10.0
    breath: float | None = None
    for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
        if phone == "HH":  # breath through the shape of what follows
            breath = start if breath is None else breath
            continue
        if breath is not None and phone != SILENCE:
            start = breath
        breath = None
        if start - last > 1e-6:
            found.append(_Target("sil", last, float(start), 1.0))
        visemes = [VISEMES[v] for v in phone_visemes(phone)]
        edges = [float(start), float(end)]
        if len(visemes) == 2:
            edges.insert(1, float(start + _FIRST_PART * (end - start)))
        for viseme, a, b in zip(visemes, edges[:-1], edges[1:], strict=False):
            s = strength
            if viseme in _VOWELS:
                s *= 0.7 + 0.3 * min(1.0, (end - start) / _FULL_VOWEL_S)
            found.append(_Target(viseme, a, b, s))
        last = float(end)
    found.append(_Target("sil", last, max(end_s, last) + 10.0, 1.0))
    return found


def _window(t: Floats, start: float, end: float, lead: float, lag: float) -> Floats:
    inside = min(_INSIDE_S, 0.35 * (end - start))
    opens = smooth_step(t, start - lead, lead + inside)
    closes = smooth_step(t, end - inside, inside + lag)
    return np.asarray(opens * (1 - closes))


def _blend(
    t: Floats, targets: list[_Target], k: int, articulator: Articulator
) -> dict[str, Floats]:
    total = np.full(len(t), _LITTLE)
    sums: dict[str, Floats] = {}
    for target in targets:
        pull = PULL[target.viseme][k] * _window(
            t, target.start_s, target.end_s, articulator.lead_s, articulator.lag_s
        )
        total += pull
        for shape, weight in viseme_weights(target.viseme).items():
            if shape.removesuffix("Left").removesuffix("Right") in articulator.shapes:
                curve = sums.setdefault(shape, np.zeros(len(t)))
                curve += target.strength * weight * pull
    return {shape: curve / total for shape, curve in sums.items()}


def _seal(t: Floats, targets: list[_Target]) -> Floats:
    """1 where lips must be shut."""
    is_open = np.ones(len(t))
    for target in targets:
        if target.viseme != "PP":
            continue
        start, end = target.start_s, target.end_s
        spare = max(0.0, _SEAL_MIN_S - (end - start)) / 2
        start, end = start - spare, end + spare
        shut = smooth_step(t, start - _SEAL_BEFORE_S, _SEAL_BEFORE_S) - smooth_step(
            t, end, _SEAL_AFTER_S
        )
        is_open *= 1 - shut
    return np.asarray(1 - is_open)
