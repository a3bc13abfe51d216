"""Performances: smooth ARKit curves and a head motion, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.clip import Clip
from ..core.head_motion import HeadMotion
from ..core.mpeg4 import ANGLE_UNIT_RAD, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head

#: Every performance begins with this much stillness: the neutral face, looking along +z.
NEUTRAL_S = 0.3

#: Gestures of the mouth and jaw, one at a time: shape → weight. L/R stands for both sides.
MOUTH_GESTURES: tuple[dict[str, float], ...] = (
    {"mouthSmileL/R": 0.7, "cheekSquintL/R": 0.5, "eyeSquintL/R": 0.3},
    {"mouthSmileL/R": 0.5, "jawOpen": 0.25, "mouthUpperUpL/R": 0.3},
    {"mouthFrownL/R": 0.6, "mouthShrugLower": 0.4},
    {"mouthPucker": 0.7},
    {"mouthFunnel": 0.5, "jawOpen": 0.2},
    {"jawOpen": 0.5},
    {"jawOpen": 0.3, "mouthStretchL/R": 0.4, "mouthLowerDownL/R": 0.3},
    {"noseSneerL/R": 0.6, "mouthUpperUpL/R": 0.4},
    {"jawForward": 0.6},
    {"jawLeft": 0.5},
    {"jawRight": 0.5},
    {"cheekPuff": 0.6},
    {"mouthLeft": 0.5},
    {"mouthRight": 0.5},
    {"mouthRollLower": 0.4, "mouthRollUpper": 0.3},
)
#: Syllables: quick, small openings in a row.
SYLLABLES: tuple[dict[str, float], ...] = (
    {"jawOpen": 0.25, "mouthLowerDownL/R": 0.2},
    {"mouthFunnel": 0.35, "jawOpen": 0.12},
    {"mouthStretchL/R": 0.3, "jawOpen": 0.1},
    {"mouthPucker": 0.4, "jawOpen": 0.08},
)
BROW_GESTURES: tuple[dict[str, float], ...] = (
    {"browInnerUp": 0.6, "browOuterUpL/R": 0.6, "eyeWideL/R": 0.4},
    {"browDownL/R": 0.6},
    {"browInnerUp": 0.7},
    {"browOuterUpLeft": 0.6},
    {"browOuterUpRight": 0.6},
)
_SIDES = ("Left", "Right")


@dataclass(frozen=True, eq=False)
class Performance:
    """What an actor does.

    Attributes
    ----------
    weights : Clip
        ARKit weights, one channel a shape of the actor's head.
    head_motion : HeadMotion
        World from head; the identity during the first `NEUTRAL_S` seconds.
    """

    weights: Clip
    head_motion: HeadMotion


def smooth_pulse(
    t: NDArray[np.float64], start: float, attack: float, hold: float, release: float
) -> NDArray[np.float64]:
    """Rise, hold and fall with continuous acceleration (6 s⁵ − 15 s⁴ + 10 s³)."""
    up = np.clip((t - start) / attack, 0, 1)
    down = np.clip((t - start - attack - hold) / release, 0, 1)
    rise, fall = (s**3 * (10 + s * (6 * s - 15)) for s in (up, down))
    return np.asarray(rise - fall)


def random_performance(
    rng: np.random.Generator, head: Head, *, seconds: float, rate_hz: float
) -> Performance:
    """Draw a performance for a head.

    Parameters
    ----------
    rng : numpy Generator
    head : Head
        Its shapes name the channels, and its lids say how far a blink closes them.
    seconds, rate_hz : float
        Length and sampling.
    """
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    curves = {name: np.zeros(len(t)) for name in head.shape_names}
    start = NEUTRAL_S
    order = list(rng.permutation(len(MOUTH_GESTURES)))
    while start < seconds - 0.2:
        if rng.random() < 0.35:
            start = _speak(rng, curves, t, start)
        else:
            gesture = MOUTH_GESTURES[order.pop() if order else rng.integers(len(MOUTH_GESTURES))]
            hold = float(rng.uniform(0.05, 0.3))
            _add(rng, curves, gesture, smooth_pulse(t, start, 0.22, hold, 0.25))
            start += 0.22 + hold + 0.25 + float(rng.uniform(0.0, 0.1))
    start = NEUTRAL_S + float(rng.uniform(0, 0.8))
    while start < seconds - 0.3:
        gesture = BROW_GESTURES[rng.integers(len(BROW_GESTURES))]
        hold = float(rng.uniform(0.1, 0.5))
        _add(rng, curves, gesture, smooth_pulse(t, start, 0.2, hold, 0.3))
        start += 0.5 + hold + float(rng.uniform(0.2, 0.8))
    _look_about(rng, curves, t)
    for name, curve in curves.items():
        np.clip(curve, 0, 1, out=curve)
        curves[name] = curve
    _blink(rng, head, curves, t)
    values = np.stack(list(curves.values()), axis=1)
    weights = Clip(t, tuple(curves), values)
    return Performance(weights, _head_motion(rng, head, t))


def _add(
    rng: np.random.Generator,
    curves: dict[str, NDArray[np.float64]],
    gesture: dict[str, float],
    pulse: NDArray[np.float64],
) -> None:
    strength = float(rng.uniform(0.9, 1.25))
    for name, weight in gesture.items():
        if name.endswith("L/R"):
            for side in _SIDES:
                uneven = float(rng.uniform(0.85, 1.15))
                curves[name.removesuffix("L/R") + side] += strength * weight * uneven * pulse
        else:
            curves[name] += strength * weight * pulse


def _speak(
    rng: np.random.Generator,
    curves: dict[str, NDArray[np.float64]],
    t: NDArray[np.float64],
    start: float,
) -> float:
    for _ in range(int(rng.integers(3, 6))):
        half = float(rng.uniform(0.07, 0.12))
        gesture = SYLLABLES[rng.integers(len(SYLLABLES))]
        _add(rng, curves, gesture, smooth_pulse(t, start, half, 0.02, half))
        start += 1.6 * half
    return start + 0.1


def _look_about(
    rng: np.random.Generator, curves: dict[str, NDArray[np.float64]], t: NDArray[np.float64]
) -> None:
    start = NEUTRAL_S + float(rng.uniform(0, 0.5))
    while start < t[-1]:
        hold = float(rng.uniform(0.2, 0.7))
        pulse = smooth_pulse(t, start, 0.05, hold, 0.05)  # a saccade lasts about 50 ms
        yaw, pitch = rng.normal(0, 0.3, size=2)
        left, right = ("Out", "In") if yaw > 0 else ("In", "Out")
        curves[f"eyeLook{left}Left"] += abs(yaw) * pulse
        curves[f"eyeLook{right}Right"] += abs(yaw) * pulse
        for side in _SIDES:
            curves[f"eyeLook{'Up' if pitch > 0 else 'Down'}{side}"] += abs(pitch) * pulse
        start += hold + float(rng.uniform(0.3, 0.8))


def _blink(
    rng: np.random.Generator,
    head: Head,
    curves: dict[str, NDArray[np.float64]],
    t: NDArray[np.float64],
) -> None:
    """Close both lids until they meet, whatever else moves them: the shape alone overshoots."""
    closed = np.zeros(len(t))
    start = NEUTRAL_S + float(rng.uniform(0.1, 0.9))
    while start < t[-1]:
        closed = np.maximum(closed, smooth_pulse(t, start, 0.08, 0.03, 0.15))
        start += float(rng.uniform(0.8, 2.0))
    for side, upper, lower in (("Left", "3.1", "3.3"), ("Right", "3.2", "3.4")):
        blink = f"eyeBlink{side}"
        motion = _vertical(head, (upper, lower))  # (n_shapes, 2)
        others = np.stack([curves[n] for n in head.shape_names], axis=1)
        opening = head.points[upper][1] - head.points[lower][1]
        gap = opening + others @ (motion[:, 0] - motion[:, 1])
        i = head.shape_names.index(blink)
        travel = motion[i, 1] - motion[i, 0]
        curves[blink] = closed * np.clip(gap / travel, 0, 1)


def _vertical(head: Head, points: tuple[str, str]) -> NDArray[np.float64]:
    """How each shape moves two feature points in y, (n_shapes, 2) mm."""
    assert head.shapes is not None
    chosen = head.feature_points.select(points)
    moved = head.shapes[:, chosen.corners, 1]
    return np.asarray(np.einsum("nc,snc->sn", chosen.barycentric, moved))


def _head_motion(rng: np.random.Generator, head: Head, t: NDArray[np.float64]) -> HeadMotion:
    """Slow turns about the neck joint and small shifts, starting from rest."""
    envelope = smooth_pulse(t, NEUTRAL_S, 0.8, 1e6, 1.0)

    def wander(sd: float) -> NDArray[np.float64]:
        f = rng.uniform(0.15, 0.9, size=3)
        phase = rng.uniform(0, 2 * np.pi, size=3)
        waves = np.sin(2 * np.pi * f * t[:, None] + phase) - np.sin(phase)
        return np.asarray(sd / np.sqrt(3) * waves.sum(axis=1) * envelope)

    degrees = np.stack([wander(4.0), wander(7.0), wander(3.0)], axis=1)
    rotation = rotation_of_faps(np.deg2rad(degrees) / ANGLE_UNIT_RAD)
    shift = np.stack([wander(5.0), wander(4.0), wander(6.0)], axis=1)
    pivot = head.neck_pivot
    translation = pivot - rotation @ pivot + shift
    return HeadMotion(t, quaternion_from_rotation(rotation), translation)
