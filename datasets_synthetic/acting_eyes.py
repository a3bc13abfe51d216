"""Where the actor looks, and blinks.

Gaze jumps from target to target in saccades on the main sequence, rests with small drift and
microsaccades between, takes the head along on large shifts, and holds its target while the head
nods: the eyes turn against the head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .acting_curves import (
    CLOSURE,
    NEUTRAL_S,
    ActingEvent,
    Floats,
    Layer,
    smooth_pulse,
    smooth_step,
    wander,
)

#: How far ``eyeLook*`` of 1 turns an eyeball, degrees (`face_motion.FaceMotion.gaze`).
FULL_LOOK_DEG = {"In": 35.0, "Out": 35.0, "Up": 25.0, "Down": 30.0}
#: The main sequence: a saccade of A degrees lasts 21 ms + 2.2 ms A (Carpenter 1988).
SACCADE_S, SACCADE_S_PER_DEG = 0.021, 0.0022
#: Lids close in 100 to 150 ms, rest shut for a moment and open in 150 to 300 ms.
BLINK_CLOSING_S, BLINK_SHUT_S, BLINK_OPENING_S = (0.10, 0.15), (0.01, 0.04), (0.15, 0.30)
BLINKS_PER_MINUTE = 15.0
_MIN_BLINK_GAP_S = 0.7
_YAW_SD, _PITCH_SD = 9.0, 4.0
_YAW_MAX, _PITCH_UP_MAX, _PITCH_DOWN_MAX = 24.0, 9.0, 13.0
_AT_CAMERA = 0.35  # share of looks that return straight ahead
_HEAD_FROM_DEG, _HEAD_SHARE = 8.0, 0.6  # larger shifts take the head along by this share
_BLINK_WITH_SHIFT = 0.35  # chance of a blink with a shift that moves the head
_MICRO_PER_S, _MICRO_SD_DEG, _DRIFT_SD_DEG = 1.2, 0.3, 0.08
_BROW_WITH_UP = 0.012  # browInnerUp per degree of looking up


@dataclass(frozen=True)
class Look:
    """A gaze shift: when it starts, and the new direction in the world, degrees."""

    start_s: float
    yaw: float
    pitch: float


def draw_looks(
    rng: np.random.Generator, *, seconds: float, fixation_s: tuple[float, float]
) -> tuple[Look, ...]:
    """Gaze shifts until the end, each after a fixation of a length between the two given."""
    found = []
    now = NEUTRAL_S + float(rng.uniform(0.05, 0.4))
    while now < seconds:
        yaw = float(np.clip(rng.normal(0, _YAW_SD), -_YAW_MAX, _YAW_MAX))
        pitch = float(np.clip(rng.normal(1, _PITCH_SD), -_PITCH_UP_MAX, _PITCH_DOWN_MAX))
        ahead = rng.random() < _AT_CAMERA
        found.append(Look(now, 0.0, 0.0) if ahead else Look(now, yaw, pitch))
        now += float(rng.uniform(*fixation_s))
    return tuple(found)


def head_of_looks(rng: np.random.Generator, t: Floats, looks: tuple[Look, ...]) -> Layer:
    """The head's share of large gaze shifts; it starts later than the eyes and takes longer."""
    yaw, pitch = np.zeros(len(t)), np.zeros(len(t))
    at_yaw = at_pitch = 0.0
    events = []
    for look in looks:
        excess = max(0.0, np.hypot(look.yaw, look.pitch) - _HEAD_FROM_DEG)
        share = _HEAD_SHARE * excess / max(np.hypot(look.yaw, look.pitch), 1e-9)
        to_yaw, to_pitch = share * look.yaw, share * look.pitch
        way = float(np.hypot(to_yaw - at_yaw, to_pitch - at_pitch))
        delay, spread = float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.9, 1.2))
        if way < 0.1:
            continue
        duration = spread * (0.28 + 0.02 * way)
        step = smooth_step(t, look.start_s + delay, duration)
        yaw += (to_yaw - at_yaw) * step
        pitch += (to_pitch - at_pitch) * step
        start = look.start_s + delay
        events.append(ActingEvent("turn", "", start, start + duration, way))
        at_yaw, at_pitch = to_yaw, to_pitch
    return Layer({"head.yaw": yaw, "head.pitch": pitch}, tuple(events))


def eyes_of_looks(
    rng: np.random.Generator,
    t: Floats,
    looks: tuple[Look, ...],
    head_yaw: Floats,
    head_pitch: Floats,
    *,
    seconds: float,
) -> Layer:
    """Both eyes on the targets, whatever the head does.

    Parameters
    ----------
    rng : numpy Generator
    t : (T,) float64, s
    looks : tuple of Look
    head_yaw, head_pitch : (T,) float64, degrees
        The head's whole turn, which the eyes undo.
    seconds : float
        Length of the performance.

    Returns
    -------
    Layer
        ``eyeLook*``, and brows that rise a little with a look up; an event for each saccade.
    """
    yaw, pitch = _fixational(rng, t, seconds)
    at = np.zeros(2)
    events = []
    for look in looks:
        to = np.array([look.yaw, look.pitch])
        size = float(np.linalg.norm(to - at))
        if size < 0.1:
            continue
        duration = SACCADE_S + SACCADE_S_PER_DEG * size
        step = smooth_step(t, look.start_s, duration)
        yaw += (to[0] - at[0]) * step
        pitch += (to[1] - at[1]) * step
        events.append(ActingEvent("saccade", "", look.start_s, look.start_s + duration, size))
        at = to
    return Layer(look_weights(yaw - head_yaw, pitch - head_pitch), tuple(events))


def look_weights(yaw: Floats, pitch: Floats) -> dict[str, Floats]:
    """``eyeLook*`` of a gaze in the head frame, degrees: yaw to the subject's left, pitch down."""
    left, right = np.maximum(yaw, 0), np.maximum(-yaw, 0)
    up, down = np.maximum(-pitch, 0), np.maximum(pitch, 0)
    found = {
        "eyeLookOutLeft": left / FULL_LOOK_DEG["Out"],
        "eyeLookInRight": left / FULL_LOOK_DEG["In"],
        "eyeLookInLeft": right / FULL_LOOK_DEG["In"],
        "eyeLookOutRight": right / FULL_LOOK_DEG["Out"],
        "browInnerUp": _BROW_WITH_UP * up**3 / (up**2 + 4.0),  # nothing for the smallest looks
    }
    for side in ("Left", "Right"):
        found[f"eyeLookUp{side}"] = up / FULL_LOOK_DEG["Up"]
        found[f"eyeLookDown{side}"] = down / FULL_LOOK_DEG["Down"]
    return found


def _fixational(rng: np.random.Generator, t: Floats, seconds: float) -> tuple[Floats, Floats]:
    """Drift and microsaccades, degrees; each microsaccade goes back on what the last one did."""
    eased = smooth_step(t, NEUTRAL_S, 0.3)
    yaw, pitch = (
        _DRIFT_SD_DEG * eased * wander(rng, t, slowest_hz=0.5, fastest_hz=5.0) for _ in range(2)
    )
    at = np.zeros(2)
    now = NEUTRAL_S + float(rng.exponential(1 / _MICRO_PER_S))
    while now < seconds:
        to = rng.normal(0, _MICRO_SD_DEG, size=2)
        step = smooth_step(t, now, SACCADE_S)
        yaw, pitch = yaw + (to[0] - at[0]) * step, pitch + (to[1] - at[1]) * step
        at = to
        now += 0.15 + float(rng.exponential(1 / _MICRO_PER_S))
    return yaw, pitch


def blinks(
    rng: np.random.Generator, t: Floats, *, seconds: float, looks: tuple[Look, ...] = ()
) -> Layer:
    """Blinks of both eyes together: one in the first seconds, then at `BLINKS_PER_MINUTE`.

    Some come with the large gaze shifts. The layer is `CLOSURE`, 0 to exactly 1.
    """
    first = NEUTRAL_S + float(rng.uniform(0.3, 1.5))
    times = [first if first < seconds - 0.5 else NEUTRAL_S + 0.05]
    while times[-1] < seconds:
        gap = float(rng.gamma(4.0, (60 / BLINKS_PER_MINUTE - _MIN_BLINK_GAP_S) / 4.0))
        times.append(times[-1] + _MIN_BLINK_GAP_S + gap)
    before = (0.0, 0.0)
    for look in looks:
        large = np.hypot(look.yaw - before[0], look.pitch - before[1]) > 1.5 * _HEAD_FROM_DEG
        if rng.random() < _BLINK_WITH_SHIFT and large:
            times.append(look.start_s)
        before = (look.yaw, look.pitch)
    closure, events, last = np.zeros(len(t)), [], -np.inf
    for start in sorted(times):
        closing, shut, opening = (
            float(rng.uniform(*span)) for span in (BLINK_CLOSING_S, BLINK_SHUT_S, BLINK_OPENING_S)
        )
        if start - last < _MIN_BLINK_GAP_S or start >= seconds:
            continue
        closure += smooth_pulse(t, start, closing, shut, opening)
        events.append(ActingEvent("blink", "", start, start + closing + shut + opening, 1.0))
        last = start
    return Layer({CLOSURE: closure}, tuple(events))
