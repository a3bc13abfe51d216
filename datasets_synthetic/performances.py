"""Performances: what an actor's face and head do, drawn from a seed or timed to phones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.phones import SILENCE, PhoneTrack
from ..heads.expressions import expression_weights
from ..heads.head import Head
from .acting_babble import babble, babble_phrase
from .acting_curves import (
    HEAD_CURVES,
    SPEAKING,
    ActingEvent,
    Floats,
    Layer,
    add_layers,
)
from .acting_curves import (
    NEUTRAL_S as NEUTRAL_S,
)
from .acting_curves import (
    smooth_pulse as smooth_pulse,
)
from .acting_expressions import (
    MOUTH_GESTURES,
    draw_brows,
    draw_expression,
    draw_gesture,
    draw_laugh,
    idle,
    uneven_pulses,
)
from .acting_eyes import blinks, draw_looks, eyes_of_looks, head_of_looks
from .acting_head import head_gestures, head_motion, speech_beats, sway_and_breath
from .acting_limits import limit, yield_to_speech
from .acting_range import RANGE_SCRIPT, range_layer, range_seconds
from .acting_speech import FIRST_SOUND_S, accents, mouth_of_speech

#: Performances are sampled at this rate. A cubic between samples keeps within 0.001 of the curves,
#: and within 0.012 for ``eyeLook*`` during a saccade, which lasts six samples or more.
PERFORMANCE_RATE_HZ = 240.0
STYLES = ("mixed", "expressions", "speech", "range")

_LAUGH = 0.12  # chance, among expressions
_FAST = 1.4  # mixed performances hurry: much happens in little time
_MOOD_ATTACK_S, _MOOD_RELEASE_S = 0.8, 0.8


@dataclass(frozen=True, eq=False)
class Performance:
    """What an actor does.

    Attributes
    ----------
    weights : Clip
        ARKit weights, one channel a shape of the actor's head; 0 during the first `NEUTRAL_S`
        seconds.
    head_motion : HeadMotion
        World from head; the identity during the first `NEUTRAL_S` seconds.
    phones : PhoneTrack, optional
        What is said; None if nothing is.
    events : tuple of ActingEvent
        What happens, in order of time.
    """

    weights: Clip
    head_motion: HeadMotion
    phones: PhoneTrack | None = None
    events: tuple[ActingEvent, ...] = ()


def random_performance(
    rng: np.random.Generator,
    head: Head,
    *,
    seconds: float,
    rate_hz: float = PERFORMANCE_RATE_HZ,
    style: str = "mixed",
    phones: PhoneTrack | None = None,
) -> Performance:
    """Draw a performance for a head.

    The same seed gives the same motion at every rate.

    Parameters
    ----------
    rng : numpy Generator
    head : Head
        Its shapes name the channels; what an ARKit shape it lacks would do stays undone.
    seconds, rate_hz : float
        Length and sampling.
    style : str
        ``"mixed"``: a hurried medley of gestures, expressions and babble; ``"expressions"``:
        expressions and laughter, at their own pace; ``"speech"``: talk, with eyes, brows and head
        to it; ``"range"``: the script of `range_of_motion` in random order, as far as time allows.
    phones : PhoneTrack, optional
        What to say, for "mixed" and "speech"; else babble is drawn.

    Raises
    ------
    ValueError
        If there is no such style, it does not speak, or the phones begin before `FIRST_SOUND_S`.
    InputError
        If the head has no shapes.
    """
    if style not in STYLES:
        raise ValueError(f"no style {style!r}; there are {', '.join(STYLES)}")
    if phones is not None and style in ("expressions", "range"):
        raise ValueError(f"style {style!r} does not speak: leave out phones, or choose another")
    if style == "speech":
        if phones is None:
            phones = babble(rng, start_s=FIRST_SOUND_S + 0.1, end_s=seconds - 0.1)
        strength = float(rng.uniform(0.8, 1.05))
        return perform_speech(
            rng, head, phones, seconds=seconds, rate_hz=rate_hz, strength=strength
        )
    t = _times(seconds, rate_hz)
    if style == "range":
        order = [RANGE_SCRIPT[i] for i in rng.permutation(len(RANGE_SCRIPT))]
        while range_seconds(len(order)) > seconds and len(order) > 1:
            order.pop()
        return _performance(head, t, [range_layer(t, order)], None)
    if style == "expressions":
        layers = _expressions(rng, t, seconds)
        return _alive(rng, head, t, layers, None, seconds=seconds, calm=1.0)
    layers, phones = _medley(rng, t, seconds, phones)
    return _alive(rng, head, t, layers, phones, seconds=seconds, calm=0.0)


def perform_speech(
    rng: np.random.Generator,
    head: Head,
    phones: PhoneTrack,
    *,
    seconds: float | None = None,
    rate_hz: float = PERFORMANCE_RATE_HZ,
    mood: Mapping[str, float] | None = None,
    strength: float = 1.0,
) -> Performance:
    """Someone saying phones: mouth, beats of head and brows, gaze, blinks, breath.

    Parameters
    ----------
    rng : numpy Generator
    head : Head
    phones : PhoneTrack
        In the performance's time: the first sound not before `FIRST_SOUND_S`.
    seconds : float, optional
        Length; by default until a second after the last sound.
    rate_hz : float
    mood : mapping from expression to intensity in [0, 1], optional
        Worn all the while; fainter about the mouth while it speaks.
    strength : float
        Of articulation: 0.7 mumbles, 1.2 is emphatic.

    Raises
    ------
    ValueError
        If the first sound is before `FIRST_SOUND_S`, or a mood is unknown.
    InputError
        If the head has no shapes.
    """
    if seconds is None:
        seconds = (float(phones.end_s[-1]) if len(phones) else NEUTRAL_S) + 1.0
    t = _times(seconds, rate_hz)
    layers = [speech_beats(rng, t, accents(phones))]
    spoken = mouth_of_speech(t, phones, strength=strength)
    for name, intensity in (mood or {}).items():
        hold = max(0.1, seconds - NEUTRAL_S - _MOOD_ATTACK_S - _MOOD_RELEASE_S - 0.1)
        curves = uneven_pulses(
            rng, t, expression_weights(name, intensity), NEUTRAL_S, _MOOD_ATTACK_S, hold,
            _MOOD_RELEASE_S,
        )  # fmt: skip
        end = NEUTRAL_S + _MOOD_ATTACK_S + hold + _MOOD_RELEASE_S
        layers.append(Layer(curves, (ActingEvent("expression", name, NEUTRAL_S, end, intensity),)))
    layers += draw_brows(rng, t, seconds=seconds, pause_s=(1.5, 4.0))
    layers = [*_yielding(layers, spoken), spoken]
    return _alive(rng, head, t, layers, phones, seconds=seconds, calm=0.7)


def range_of_motion(
    head: Head, *, rate_hz: float = PERFORMANCE_RATE_HZ, seconds: float | None = None
) -> Performance:
    """Every gesture of `RANGE_SCRIPT` once, alone and large: nothing is random.

    Parameters
    ----------
    head : Head
    rate_hz : float
    seconds : float, optional
        Length; by default that of the script.
    """
    t = _times(range_seconds() if seconds is None else seconds, rate_hz)
    return _performance(head, t, [range_layer(t)], None)


def _times(seconds: float, rate_hz: float) -> Floats:
    n = round(seconds * rate_hz)
    if n < 2:
        raise ValueError(
            f"a performance needs two samples; {seconds:g} s at {rate_hz:g} Hz give {n}"
        )
    return np.arange(n) / rate_hz


def _medley(
    rng: np.random.Generator, t: Floats, seconds: float, phones: PhoneTrack | None
) -> tuple[list[Layer], PhoneTrack | None]:
    """Gestures, expressions and babble in turn; with phones given, these instead of babble."""
    acted: list[Layer] = []
    said: list[tuple[str, float, float]] = []
    gestures = [str(n) for n in rng.permutation(list(MOUTH_GESTURES))]
    now, bag = NEUTRAL_S, list[str]()
    while now < seconds - 0.4:
        bag = bag or [str(k) for k in rng.permutation(_MEDLEY)]
        kind = bag.pop()
        if kind == "phrase" and phones is None:
            start = max(now, FIRST_SOUND_S)
            for phone, length in babble_phrase(rng, syllables=int(rng.integers(2, 6))):
                said.append((phone, start, start + length))
                start += length
            now = start + 0.1
            continue
        if kind == "expression":
            layer, now = draw_expression(rng, t, now, quick=_FAST)
        else:
            gestures = gestures or [str(n) for n in rng.permutation(list(MOUTH_GESTURES))]
            layer, now = draw_gesture(rng, t, now, gestures.pop())
        acted.append(layer)
    acted += draw_brows(rng, t, seconds=seconds, pause_s=(0.2, 1.0))
    if phones is None:
        phones = _track(said, seconds)
    if phones is None:
        return acted, None
    spoken = mouth_of_speech(t, phones, strength=float(rng.uniform(0.9, 1.1)))
    beats = speech_beats(rng, t, accents(phones))
    return [*_yielding(acted, spoken), beats, spoken], phones


_MEDLEY = ("gesture", "gesture", "gesture", "expression", "expression", "phrase")


def _expressions(rng: np.random.Generator, t: Floats, seconds: float) -> list[Layer]:
    found = []
    now = NEUTRAL_S + float(rng.uniform(0.1, 0.5))
    while now < seconds - 0.4:
        if rng.random() < _LAUGH:
            layer, now = draw_laugh(rng, t, now)
        else:
            layer, now = draw_expression(rng, t, now)
        found.append(layer)
        now += float(rng.uniform(0.0, 0.6))
    return found


def _track(said: list[tuple[str, float, float]], seconds: float) -> PhoneTrack | None:
    """Phones of a medley that end in time, with silences between; None if there are none."""
    kept: list[tuple[str, float, float]] = []
    for phone, start, end in said:
        if end > seconds - 0.05:
            break
        if kept and start - kept[-1][2] > 1e-6:
            kept.append((SILENCE, kept[-1][2], start))
        kept.append((phone, start, end))
    if not kept:
        return None
    return PhoneTrack(
        tuple(k[0] for k in kept), np.array([k[1] for k in kept]), np.array([k[2] for k in kept])
    )


def _yielding(layers: list[Layer], spoken: Layer) -> list[Layer]:
    speaking = spoken.curves[SPEAKING]
    return [Layer(yield_to_speech(layer.curves, speaking), layer.events) for layer in layers]


def _alive(
    rng: np.random.Generator,
    head: Head,
    t: Floats,
    layers: list[Layer],
    phones: PhoneTrack | None,
    *,
    seconds: float,
    calm: float,
) -> Performance:
    """Add what living faces do besides: eyes, blinks, head, breath, idle motion.

    `calm`, 0 to 1, lengthens fixations and the pauses between movements of the head.
    """
    looks = draw_looks(rng, seconds=seconds, fixation_s=(0.25 + 0.4 * calm, 0.9 + 1.8 * calm))
    pause = (0.2 + 0.8 * calm, 0.8 + 3.0 * calm)
    body = add_layers(
        [
            *layers,
            head_of_looks(rng, t, looks),
            head_gestures(rng, t, seconds=seconds, pause_s=pause),
            sway_and_breath(rng, t),
        ]
    )
    yaw, pitch = body.curves["head.yaw"], body.curves["head.pitch"]
    eyes = eyes_of_looks(rng, t, looks, yaw, pitch, seconds=seconds)
    lids = blinks(rng, t, seconds=seconds, looks=looks)
    return _performance(head, t, [body, eyes, lids, idle(rng, t)], phones)


def _performance(
    head: Head, t: Floats, layers: list[Layer], phones: PhoneTrack | None
) -> Performance:
    if not head.shape_names:
        raise InputError(f"head {head.name} has no sculpted shapes to act with")
    whole = add_layers(layers)
    curves = limit(whole.curves)
    none = np.zeros(len(t))
    values = np.stack([curves.get(name, none) for name in head.shape_names], axis=1)
    weights = Clip(t, head.shape_names, np.clip(values, 0, 1))
    moves = Layer({n: c for n, c in curves.items() if n in HEAD_CURVES})
    events = tuple(e for e in whole.events if e.start_s < t[-1])
    return Performance(weights, head_motion(t, moves, head.neck_pivot), phones, events)
