"""Range of motion: every gesture once, alone and large, as trackers like to begin a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..heads.expressions import EXPRESSIONS, expression_weights, shape_names
from .acting_curves import CLOSURE, NEUTRAL_S, ActingEvent, Floats, Layer, add_layers, smooth_pulse
from .acting_expressions import BROW_GESTURES, MOUTH_GESTURES
from .acting_eyes import look_weights

_ATTACK_S, _HOLD_S, _RELEASE_S, _PAUSE_S = 0.4, 0.25, 0.4, 0.1
_GAIN = 1.3  # gestures of the script are this much larger than in acting
_HEAD: Mapping[str, tuple[str, float]] = {
    "head down": ("head.pitch", 15.0),
    "head up": ("head.pitch", -12.0),
    "head left": ("head.yaw", 25.0),
    "head right": ("head.yaw", -25.0),
    "head tilted left": ("head.roll", -12.0),
    "head tilted right": ("head.roll", 12.0),
}
_LOOKS: Mapping[str, tuple[float, float]] = {
    "look left": (18.0, 0.0),
    "look right": (-18.0, 0.0),
    "look up": (0.0, -9.0),
    "look down": (0.0, 14.0),
}
_LIDS: Mapping[str, Mapping[str, float]] = {
    "lids shut": {CLOSURE: 1.0},
    "wink left": {"eyeBlinkLeft": 1.0, "cheekSquintLeft": 0.4},
    "wink right": {"eyeBlinkRight": 1.0, "cheekSquintRight": 0.4},
    "eyes wide": {"eyeWideL/R": 0.9},
    "squint": {"eyeSquintL/R": 0.9, "cheekSquintL/R": 0.6},
}
_MORE: Mapping[str, Mapping[str, float]] = {
    "tongue out": {"tongueOut": 0.5, "jawOpen": 0.2},
    "lips shrugged": {"mouthShrugLower": 0.7, "mouthShrugUpper": 0.5},
}
#: The gestures of the script, in its order.
RANGE_SCRIPT = (
    *MOUTH_GESTURES, *_MORE, *BROW_GESTURES, *_LIDS, *_LOOKS, *_HEAD, *EXPRESSIONS,
)  # fmt: skip
#: From one gesture to the next, s.
RANGE_STEP_S = _ATTACK_S + _HOLD_S + _RELEASE_S + _PAUSE_S


def range_seconds(n_gestures: int = len(RANGE_SCRIPT)) -> float:
    """How long so many gestures of the script take, with the stillness at the start."""
    return NEUTRAL_S + n_gestures * RANGE_STEP_S


def range_layer(t: Floats, gestures: Sequence[str] = RANGE_SCRIPT) -> Layer:
    """Gestures of the script, one after another.

    Raises ValueError if a gesture is not in `RANGE_SCRIPT`.
    """
    layers = []
    for i, name in enumerate(gestures):
        start = NEUTRAL_S + i * RANGE_STEP_S
        pulse = smooth_pulse(t, start, _ATTACK_S, _HOLD_S, _RELEASE_S)
        event = ActingEvent("range", name, start, start + RANGE_STEP_S - _PAUSE_S, 1.0)
        layers.append(Layer(_curves(name, pulse), (event,)))
    return add_layers(layers)


def _curves(name: str, pulse: Floats) -> dict[str, Floats]:
    if name in _HEAD:
        curve, degrees = _HEAD[name]
        return {curve: degrees * pulse}
    if name in _LOOKS:
        yaw, pitch = _LOOKS[name]
        return look_weights(yaw * pulse, pitch * pulse)
    if name in EXPRESSIONS:
        return {shape: w * pulse for shape, w in expression_weights(name).items()}
    for table, gain in ((MOUTH_GESTURES, _GAIN), (BROW_GESTURES, _GAIN), (_LIDS, 1), (_MORE, 1)):
        if name in table:
            return {s: gain * w * pulse for n, w in table[name].items() for s in shape_names(n)}
    raise ValueError(f"no gesture {name!r} in the script: {', '.join(RANGE_SCRIPT)}")
