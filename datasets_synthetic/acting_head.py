"""What the head does: nods, shakes, tilts, beats of speech, sway and breath.

Speeds stay in the range of conversation: most below 60°/s, nods and shakes up to about 120°/s.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..core.head_motion import HeadMotion
from ..core.mpeg4 import ANGLE_UNIT_RAD, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from .acting_curves import (
    NEUTRAL_S,
    ActingEvent,
    Floats,
    Layer,
    smooth_pulse,
    smooth_step,
    wander,
)

#: Kind → (curve, amplitude in degrees from and to, beats a second from and to).
_SWINGS = {
    "nod": ("head.pitch", (3.5, 8.0), (1.5, 2.5)),
    "shake": ("head.yaw", (5.0, 10.0), (1.4, 2.3)),
}
_BREATHS_PER_S = (0.2, 0.3)
_SWAY_DEG = {"head.pitch": 1.4, "head.yaw": 1.8, "head.roll": 1.2}
_SWAY_MM = {"head.x": 2.5, "head.y": 1.0, "head.z": 3.0}


def head_gestures(
    rng: np.random.Generator, t: Floats, *, seconds: float, pause_s: tuple[float, float]
) -> Layer:
    """Nods, shakes and tilts, with pauses of a length between the two given."""
    curves = {name: np.zeros(len(t)) for name in ("head.pitch", "head.yaw", "head.roll")}
    events = []
    now = NEUTRAL_S + float(rng.uniform(0.1, 0.6))
    while now < seconds - 0.4:
        kind = str(rng.choice(("nod", "nod", "shake", "tilt")))
        if kind == "tilt":
            name, degrees = "head.roll", float(rng.uniform(4, 9) * rng.choice((-1, 1)))
            attack, hold = float(rng.uniform(0.35, 0.6)), float(rng.uniform(0.2, 1.0))
            curve, end = smooth_pulse(t, now, attack, hold, attack), now + 2 * attack + hold
        else:
            name, amplitude, rate = _SWINGS[kind]
            degrees, hz = float(rng.uniform(*amplitude)), float(rng.uniform(*rate))
            degrees /= hz / rate[0]  # quick ones are smaller
            length = float(rng.integers(1, 4)) / hz + 0.15
            curve, end = _swing(t, now, length, hz), now + length
        curves[name] += degrees * curve
        events.append(ActingEvent(kind, "", now, end, abs(degrees)))
        now = end + float(rng.uniform(*pause_s))
    return Layer(curves, tuple(events))


def speech_beats(
    rng: np.random.Generator, t: Floats, stressed: Iterable[tuple[float, float]]
) -> Layer:
    """Small, quick nods and brows that rise on some of the stressed syllables.

    Parameters
    ----------
    rng : numpy Generator
    t : (T,) float64, s
    stressed : iterable of (time in s, weight 0 to 1)
        See `acting_speech.accents`.
    """
    pitch, brows = np.zeros(len(t)), np.zeros(len(t))
    events = []
    for at, weight in stressed:
        degrees, late = float(rng.uniform(1.5, 4.0)) * weight, float(rng.normal(0, 0.02))
        raised = float(rng.uniform(0.1, 0.35)) * weight
        attack, release = float(rng.uniform(0.12, 0.18)), float(rng.uniform(0.22, 0.35))
        start = max(NEUTRAL_S, at + late - attack)
        if rng.random() < 0.6:
            pitch += degrees * smooth_pulse(t, start, attack, 0.03, release)
            events.append(ActingEvent("beat", "", start, start + attack + 0.03 + release, degrees))
        if rng.random() < 0.4:
            brows += raised * smooth_pulse(t, start, attack + 0.05, 0.1, release + 0.1)
    curves = {"head.pitch": pitch, "browInnerUp": brows}
    curves |= {f"browOuterUp{side}": 0.8 * brows for side in ("Left", "Right")}
    return Layer(curves, tuple(events))


def sway_and_breath(rng: np.random.Generator, t: Floats) -> Layer:
    """Slow sway of head and neck, and breath: a rise of the head, nostrils and jaw with it."""
    eased = smooth_step(t, NEUTRAL_S, 1.0)
    curves = {
        name: size * eased * wander(rng, t, slowest_hz=0.06, fastest_hz=0.8)
        for name, size in (_SWAY_DEG | _SWAY_MM).items()
    }
    hz, phase = float(rng.uniform(*_BREATHS_PER_S)), float(rng.uniform(0, 2 * np.pi))
    breath = eased * (1 - np.cos(2 * np.pi * hz * t + phase)) / 2
    curves["head.y"] = curves["head.y"] + 1.2 * breath
    curves["head.pitch"] = curves["head.pitch"] - 0.4 * breath
    for side in ("Left", "Right"):
        curves[f"noseSneer{side}"] = 0.02 * breath
    return Layer(curves)


def head_motion(t: Floats, layer: Layer, neck_pivot: Floats) -> HeadMotion:
    """The head's pose, world from head: turns about the neck joint, then shifts.

    Parameters
    ----------
    t : (T,) float64, s
    layer : Layer
        With any of `HEAD_CURVES`; what is absent is zero.
    neck_pivot : (3,) float64, mm, head frame
    """
    none = np.zeros(len(t))
    degrees, shift = (
        np.stack([layer.curves.get(f"head.{name}", none) for name in names], axis=1)
        for names in (("pitch", "yaw", "roll"), ("x", "y", "z"))
    )
    rotation = rotation_of_faps(np.deg2rad(degrees) / ANGLE_UNIT_RAD)
    translation = neck_pivot - rotation @ neck_pivot + shift
    return HeadMotion(t, quaternion_from_rotation(rotation), translation)


def _swing(t: Floats, start: float, length: float, hz: float) -> Floats:
    """A few swings to and fro that grow and die away."""
    envelope = smooth_pulse(t, start, 0.35 * length, 0.3 * length, 0.35 * length)
    return np.asarray(envelope * np.sin(2 * np.pi * hz * (t - start)))
