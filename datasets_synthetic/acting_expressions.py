"""What the face does besides speech: expressions, single gestures, and never quite nothing.

An expression grows for a quarter to half a second, stays, and fades more slowly; its parts do not
start together, nor are the face's halves equal: real expressions differ by some ten per cent
between left and right, and posed smiles unfold over about half a second (Schmidt et al. 2006).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..heads.expressions import EXPRESSIONS, expression_weights, shape_names
from .acting_curves import NEUTRAL_S, ActingEvent, Floats, Layer, smooth_pulse, smooth_step, wander

#: Gestures of the mouth and jaw, one at a time: name → shape → weight. L/R is both sides.
MOUTH_GESTURES: Mapping[str, Mapping[str, float]] = {
    "smile": {"mouthSmileL/R": 0.7, "cheekSquintL/R": 0.5, "eyeSquintL/R": 0.3},
    "grin": {"mouthSmileL/R": 0.55, "jawOpen": 0.2, "mouthUpperUpL/R": 0.35},
    "smirk left": {"mouthSmileLeft": 0.55, "mouthDimpleLeft": 0.3, "cheekSquintLeft": 0.3},
    "smirk right": {"mouthSmileRight": 0.55, "mouthDimpleRight": 0.3, "cheekSquintRight": 0.3},
    "pout": {"mouthFrownL/R": 0.6, "mouthShrugLower": 0.45},
    "pucker": {"mouthPucker": 0.75},
    "funnel": {"mouthFunnel": 0.6, "jawOpen": 0.15},
    "jaw open": {"jawOpen": 0.5},
    "jaw low, lips shut": {"jawOpen": 0.3, "mouthClose": 0.3},
    "stretch": {"jawOpen": 0.25, "mouthStretchL/R": 0.55, "mouthLowerDownL/R": 0.35},
    "sneer": {"noseSneerL/R": 0.7, "mouthUpperUpL/R": 0.45},
    "jaw forward": {"jawForward": 0.6},
    "jaw left": {"jawLeft": 0.55},
    "jaw right": {"jawRight": 0.55},
    "cheeks puffed": {"cheekPuff": 0.65, "mouthPressL/R": 0.2},
    "mouth left": {"mouthLeft": 0.55},
    "mouth right": {"mouthRight": 0.55},
    "lips rolled in": {"mouthRollLower": 0.55, "mouthRollUpper": 0.4, "mouthPressL/R": 0.3},
}
BROW_GESTURES: Mapping[str, Mapping[str, float]] = {
    "brows up": {"browInnerUp": 0.65, "browOuterUpL/R": 0.65, "eyeWideL/R": 0.4},
    "brows down": {"browDownL/R": 0.7, "eyeSquintL/R": 0.2},
    "brows worried": {"browInnerUp": 0.75},
    "left brow up": {"browOuterUpLeft": 0.7},
    "right brow up": {"browOuterUpRight": 0.7},
}
_UNEVEN_SD, _UNEVEN_MAX = 0.07, 0.18
_WAVER = 0.15  # an expression held is not frozen
_LATEST_S = 0.06  # the last shape to move starts this long after the first
_IDLE = {
    "browInnerUp": 0.04, "browOuterUpL/R": 0.03, "browDownL/R": 0.03, "mouthSmileL/R": 0.03,
    "mouthDimpleL/R": 0.03, "mouthFrownL/R": 0.02, "mouthPressL/R": 0.04, "eyeSquintL/R": 0.04,
}  # fmt: skip
_LAUGH_HZ = 4.6


def draw_expression(
    rng: np.random.Generator, t: Floats, start: float, *, quick: float = 1.0
) -> tuple[Layer, float]:
    """One expression, or a mixture of two, and when the next may begin.

    Parameters
    ----------
    rng : numpy Generator
    t : (T,) float64, s
    start : float, s
    quick : float
        Onset, apex and offset are divided by this.
    """
    names = [str(n) for n in rng.permutation(EXPRESSIONS)[: 2 if rng.random() < 0.3 else 1]]
    first = float(rng.uniform(0.5, 1.0))
    amounts = [first] if len(names) == 1 else [0.75 * first, float(rng.uniform(0.25, 0.5))]
    attack = float(rng.uniform(0.3, 0.55)) / quick
    hold, release = float(rng.uniform(0.3, 1.2)) / quick, float(rng.uniform(0.45, 0.8)) / quick
    if names[0] == "surprise":
        attack = max(0.2, 0.6 * attack)
    weights: dict[str, float] = {}
    events = []
    end = start + attack + hold + release
    for name, amount in zip(names, amounts, strict=True):
        for shape, weight in expression_weights(name, amount).items():
            weights[shape] = weights.get(shape, 0.0) + weight
        events.append(ActingEvent("expression", name, start, end, amount))
    curves = uneven_pulses(rng, t, weights, start, attack, hold, release)
    return Layer(curves, tuple(events)), start + attack + hold + 0.6 * release


def draw_gesture(
    rng: np.random.Generator, t: Floats, start: float, name: str
) -> tuple[Layer, float]:
    """One of `MOUTH_GESTURES` or `BROW_GESTURES`, and when the next may begin."""
    kind = "gesture" if name in MOUTH_GESTURES else "brows"
    gesture = MOUTH_GESTURES[name] if kind == "gesture" else BROW_GESTURES[name]
    amount = float(rng.uniform(0.8, 1.15))
    attack, release = float(rng.uniform(0.2, 0.3)), float(rng.uniform(0.24, 0.36))
    hold = float(rng.uniform(0.05, 0.35))
    weights = {s: amount * w for written, w in gesture.items() for s in shape_names(written)}
    curves = uneven_pulses(rng, t, weights, start, attack, hold, release)
    end = start + attack + hold + release
    event = ActingEvent(kind, name, start, end, min(1.0, amount))
    return Layer(curves, (event,)), start + attack + hold + 0.75 * release


def draw_laugh(rng: np.random.Generator, t: Floats, start: float) -> tuple[Layer, float]:
    """A laugh: full joy, the head back, jaw and head bouncing with each breath."""
    length, hz = float(rng.uniform(0.8, 1.6)), _LAUGH_HZ * float(rng.uniform(0.9, 1.1))
    curves = uneven_pulses(rng, t, expression_weights("joy"), start, 0.35, length, 0.6)
    dying = smooth_pulse(t, start + 0.15, 0.2, 0.2, length)
    bounce = dying * (1 - np.cos(2 * np.pi * hz * (t - start))) / 2
    curves["jawOpen"] = curves["jawOpen"] + 0.1 * bounce
    body = smooth_pulse(t, start, 0.4, length, 0.6)
    curves |= {"head.pitch": -4.0 * body - 0.8 * bounce, "head.y": -1.5 * bounce}
    end = start + 0.95 + length
    return Layer(curves, (ActingEvent("laugh", "", start, end, 1.0),)), end - 0.3


def uneven_pulses(
    rng: np.random.Generator,
    t: Floats,
    weights: Mapping[str, float],
    start: float,
    attack: float,
    hold: float,
    release: float,
) -> dict[str, Floats]:
    """Weights that rise and fall nearly together, left and right not quite alike."""
    curves = {}
    steady = 1 - _WAVER * (1 + wander(rng, t, slowest_hz=0.3, fastest_hz=2.0) / np.sqrt(8)) / 2
    for shape, weight in weights.items():
        late = float(rng.uniform(0, _LATEST_S))
        factor = 1.0
        if shape.endswith(("Left", "Right")) and not shape.startswith("eyeLook"):
            factor += float(np.clip(rng.normal(0, _UNEVEN_SD), -_UNEVEN_MAX, _UNEVEN_MAX))
        # what starts late stays shorter, so that all is over at one time
        shorter = max(0.0, late - hold)
        pulse = smooth_pulse(t, start + late, attack, max(0.0, hold - late), release - shorter)
        curves[shape] = weight * factor * pulse * steady
    return curves


def draw_brows(
    rng: np.random.Generator, t: Floats, *, seconds: float, pause_s: tuple[float, float]
) -> list[Layer]:
    """Brow gestures until the end, with pauses of a length between the two given."""
    found = []
    now = NEUTRAL_S + float(rng.uniform(0, 0.6))
    while now < seconds - 0.3:
        layer, now = draw_gesture(rng, t, now, str(rng.choice(list(BROW_GESTURES))))
        found.append(layer)
        now += float(rng.uniform(*pause_s))
    return found


def idle(rng: np.random.Generator, t: Floats) -> Layer:
    """The small motion of a face at rest: brows, lids and mouth corners, weights below 0.05."""
    eased = smooth_step(t, NEUTRAL_S, 0.8)
    curves = {}
    for written, most in _IDLE.items():
        together = wander(rng, t, slowest_hz=0.1, fastest_hz=1.5)
        for shape in shape_names(written):
            own = wander(rng, t, slowest_hz=0.1, fastest_hz=1.5)
            mixed = (0.85 * together + 0.5 * own) / 1.35 / np.sqrt(8)  # within ±1
            curves[shape] = most * eased * (1 + mixed) / 2
    return Layer(curves)
