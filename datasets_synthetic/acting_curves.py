"""Curves that acting is made of, and how they add up.

All are functions of time alone: a performance drawn from a seed is the same motion at any rate.
Each has a continuous second derivative.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

#: Every performance begins with this much stillness: the neutral face, looking along +z.
NEUTRAL_S = 0.3
#: Curves of a layer that turn or move the head; all others are ARKit weights.
HEAD_CURVES = ("head.pitch", "head.yaw", "head.roll", "head.x", "head.y", "head.z")
#: Curves, 0 to 1, that say what must be whatever else goes on (`acting_limits`): lips shut, lids
#: shut, the mouth busy with speech.
SEAL, CLOSURE, SPEAKING = "lips.seal", "lids.closure", "lips.speaking"

_STEP_SLOPE = 15 / 8  # the steepest slope of `smooth_step`


@dataclass(frozen=True)
class ActingEvent:
    """Something the actor does.

    Attributes
    ----------
    kind : str
        ``expression``, ``gesture``, ``brows``, ``phrase``, ``blink``, ``saccade``, ``nod``,
        ``shake``, ``tilt``, ``turn``, ``beat``, ``laugh`` or ``range``.
    name : str
        Which: ``joy``, ``jawOpen``, the phones of a phrase; empty where the kind says it all.
    start_s, end_s : float
        From the first to the last moment that differs from rest.
    amount : float
        Intensity 0 to 1; degrees for saccades and movements of the head.
    """

    kind: str
    name: str
    start_s: float
    end_s: float
    amount: float


@dataclass(frozen=True, eq=False)
class Layer:
    """One thing the actor does, as curves to add to what else goes on.

    Attributes
    ----------
    curves : mapping from ARKit name, or one of `HEAD_CURVES`, to (T,) float64
        Weights; degrees for pitch (down), yaw (left) and roll (right); mm.
    events : tuple of ActingEvent
    """

    curves: Mapping[str, Floats]
    events: tuple[ActingEvent, ...] = field(default=())


def add_layers(layers: Iterable[Layer]) -> Layer:
    """The sum of layers, with all their events in order of time."""
    curves: dict[str, Floats] = {}
    events: list[ActingEvent] = []
    for layer in layers:
        for name, curve in layer.curves.items():
            curves[name] = curves[name] + curve if name in curves else np.array(curve)
        events.extend(layer.events)
    return Layer(curves, tuple(sorted(events, key=lambda e: (e.start_s, e.kind, e.name))))


def smooth_step(t: ArrayLike, start: float, duration: float) -> Floats:
    """0 before `start`, 1 after `duration` more: 6 s⁵ − 15 s⁴ + 10 s³, of least jerk."""
    s = np.clip((np.asarray(t, dtype=np.float64) - start) / duration, 0, 1)
    return np.asarray(s**3 * (10 + s * (6 * s - 15)))


def smooth_pulse(t: Floats, start: float, attack: float, hold: float, release: float) -> Floats:
    """Rise, hold and fall with continuous acceleration."""
    return smooth_step(t, start, attack) - smooth_step(t, start + attack + hold, release)


def duration_of_step(amount: float, top_speed: float) -> float:
    """How long a smooth step of an amount takes if it may be as fast as `top_speed`."""
    return _STEP_SLOPE * abs(amount) / top_speed


def wander(
    rng: np.random.Generator, t: Floats, *, slowest_hz: float, fastest_hz: float, n: int = 4
) -> Floats:
    """A sum of sines of random frequency and phase, of standard deviation 1, never beyond 2√(n/2).

    Frequencies are spread over the octaves between; faster sines are smaller (1/f), as in the
    sway of a standing body.
    """
    edges = np.geomspace(slowest_hz, fastest_hz, n + 1)
    f = rng.uniform(edges[:-1], edges[1:])
    share = 1 / f
    phase = rng.uniform(0, 2 * np.pi, size=n)
    waves = np.sin(2 * np.pi * f * t[:, None] + phase) @ share
    return np.asarray(waves / np.sqrt((share**2).sum() / 2))


def saturate(x: Floats, knee: float = 0.85) -> Floats:
    """x below the knee, then bending so as never to pass 1; the curvature is continuous."""
    room = 1 - knee
    return np.where(x <= knee, x, knee + room * np.tanh(np.maximum(x - knee, 0) / room))
