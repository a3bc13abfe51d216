"""Voices whose truth is known: who says what, when, with which pitch, formants and tract.

`make_voice` speaks with one of the measured talkers, through resonators (``formant``) or a tube
(``tube``); `record_voice` puts the sound into a room, under noise, before a microphone or onto a
telephone line. Truth is the clean voice's, and stays true: time does not shift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from ..core.arrays import readonly
from ..core.audio import Audio
from ..core.errors import InputError
from ..core.phones import SILENCE, PhoneTrack
from .formant_voice import formant_voice
from .tube_shapes import area_tracks, noise_sections
from .tube_voice import tube_voice
from .voice_phones import CLASSES, phone_kinds
from .voice_rooms import RoomSettings, add_noise, microphone, room_response, telephone
from .voice_scripts import KINDS, Script, join_scripts, random_script, script_of_text
from .voice_source import (
    FRAME_RATE_HZ,
    SOURCE_RATE_HZ,
    GlottalSource,
    VoiceQuality,
    glottal_source,
)
from .voice_talkers import GROUPS, Talker, group_talkers
from .voice_tracks import Timeline, VoiceTracks, plan_timeline, plan_tracks

SYNTHESISERS = ("formant", "tube")
RATES_HZ = (8_000, 48_000)
_RD = {"man": (0.8, 1.3), "woman": (1.1, 1.8), "child": (1.0, 1.8)}  # women's voices are breathier
_PEAK_DB = (-12.0, -1.0)
_VOICED = 0.02  # pulses weaker than this are not heard as voice
_TRIES = 12  # to find a phrase that still fits
_LIPS_SHUT = ("P", "B", "M")


@dataclass(frozen=True, eq=False)
class VoiceTruth:
    """What a voice did, at `FRAME_RATE_HZ`; frame i is the instant i / 1000 s.

    Attributes
    ----------
    phones : PhoneTrack
        Exact boundaries.
    frame_class : (T,) int8
        Index into `CLASSES`. Diphthongs and affricates change halfway, or when they open.
    lips_closed : (T,) bool
        While the lips are shut for /p b m/.
    f0_hz : (T,) float64, Hz, or None
        NaN where unvoiced; the melody, without jitter.
    glottal_closures_s : (K,) float64, s, or None
        Every pulse's, jitter included.
    formants_hz, bandwidths_hz : (T, 4) float64, Hz, or None
        NaN in silence, and in a tube while it is closed.
    voicing, aspiration, frication, velum : (T,) float64, or None
        Amplitudes in the synthesiser, before `gain`; how open the nose is, 0 to 1.
    areas_mm2 : (T, N) float64, mm², or None
        The tube's sections from glottis to lips, each 350 / 96 mm long.
    gain : float
        What the synthesiser's output was multiplied by.
    """

    phones: PhoneTrack
    frame_class: NDArray[np.int8]
    lips_closed: NDArray[np.bool_]
    gain: float
    f0_hz: NDArray[np.float64] | None = None
    glottal_closures_s: NDArray[np.float64] | None = None
    formants_hz: NDArray[np.float64] | None = None
    bandwidths_hz: NDArray[np.float64] | None = None
    voicing: NDArray[np.float64] | None = None
    aspiration: NDArray[np.float64] | None = None
    frication: NDArray[np.float64] | None = None
    velum: NDArray[np.float64] | None = None
    areas_mm2: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n = len(self.frame_class)
        shapes: dict[str, tuple[int | None, ...]] = {
            "frame_class": (n,),
            "lips_closed": (n,),
            "glottal_closures_s": (None,),
            "formants_hz": (n, 4),
            "bandwidths_hz": (n, 4),
            "areas_mm2": (n, None),
            **dict.fromkeys(("f0_hz", "voicing", "aspiration", "frication", "velum"), (n,)),
        }
        dtypes = {"frame_class": np.int8, "lips_closed": np.bool_}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None:
                dtype = dtypes.get(name, np.float64)
                object.__setattr__(self, name, readonly(value, shape, name, dtype))

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(T,) float64, s."""
        return np.arange(len(self.frame_class)) / FRAME_RATE_HZ


@dataclass(frozen=True, eq=False)
class Voice:
    """A recording and its truth.

    Attributes
    ----------
    audio : Audio
    truth : VoiceTruth
    synth : str
        ``formant``, ``tube`` or ``espeak``.
    talker : str
        A talker's name, or eSpeak's voice.
    group : str
        ``man``, ``woman`` or ``child``.
    kind, text : str
        What is said.
    seed : int
    settings : mapping
        Everything else that was simulated, for ``voice.toml``: numbers, strings and booleans.
    """

    audio: Audio
    truth: VoiceTruth
    synth: str
    talker: str
    group: str
    kind: str
    text: str
    seed: int
    settings: Mapping[str, float | str | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))


def make_voice(
    seed: int,
    *,
    talker: Talker | str | None = None,
    synth: str = "formant",
    kind: str | None = None,
    text: str | None = None,
    seconds: float | None = None,
    rate_hz: int = 16_000,
    quality: VoiceQuality | None = None,
) -> Voice:
    """Say something with a synthetic voice.

    Parameters
    ----------
    talker : Talker or str, optional
        A talker, or a group from which one is drawn; None draws the group too.
    synth : str
        ``formant`` or ``tube``.
    kind : str, optional
        What to say, from `KINDS`; None draws it.
    text : str, optional
        Words to say instead: see `script_of_text`.
    seconds : float, optional
        Length of the sound: phrases while they fit, then silence. None: one phrase, as long as it
        is.
    rate_hz : int
        8 to 48 kHz. The voice is the same at every rate (there is nothing above 11 kHz).
    quality : VoiceQuality, optional
        Of the glottis; None draws one that suits the group.

    Raises
    ------
    InputError
        If the text has unknown words, or does not fit into `seconds`.
    ValueError
        If there is no such group, synthesiser or kind, or the rate is out of range.
    """
    if synth not in SYNTHESISERS:
        raise ValueError(f"synth must be one of {', '.join(SYNTHESISERS)}, got {synth!r}")
    _check_rate(rate_hz)
    rng = np.random.default_rng([seed, 8])  # 8: not the stream of a take of the same seed
    who = _cast(talker, rng)
    if quality is None:
        quality = VoiceQuality(
            rd=rng.uniform(*_RD[who.group]),
            jitter=rng.uniform(0.002, 0.012),
            shimmer=rng.uniform(0.01, 0.06),
            breath=rng.uniform(0.003, 0.02),
        )
    pace = float(np.exp(rng.normal(0, 0.12)))
    timeline = _plan(who, kind, text, seconds, pace, rng)
    tracks = plan_tracks(who, timeline, rng)
    source = glottal_source(tracks.f0_hz, tracks.voicing, tracks.aspiration, rng, quality=quality)
    samples, found = _speak(who, synth, tracks, source, rng)
    audio, gain = _scaled(samples, rate_hz, rng)
    truth = replace(_tracks_truth(tracks, source), gain=gain, **found)
    settings = {
        "pace": pace,
        "tract_mm": who.tract_mm,
        "rd": quality.rd,
        "jitter": quality.jitter,
        "shimmer": quality.shimmer,
        "breath": quality.breath,
    }
    script = timeline.script
    return Voice(audio, truth, synth, who.name, who.group, script.kind, script.text, seed, settings)


def record_voice(
    voice: Voice,
    *,
    room: RoomSettings | None = None,
    noise_db: float | None = None,
    noise_colour: str = "pink",
    through_microphone: bool = False,
    over_telephone: bool = False,
) -> Voice:
    """The same voice in a room, under noise, before a microphone, over a telephone; in that order.

    Parameters
    ----------
    noise_db : float, optional
        Signal-to-noise ratio, dB: the power of the voice (as it arrives) while it speaks over the
        noise's.

    Raises
    ------
    InputError
        If nothing sounds, so that no ratio can be set.
    """
    rng = np.random.default_rng([voice.seed, 9])
    sound = voice.audio.samples.astype(np.float64)
    rate_hz = voice.audio.rate_hz
    settings = dict(voice.settings)
    if room is not None:
        sound = np.convolve(sound, room_response(room, rate_hz, rng))[: len(sound)]
        settings |= {"room_rt60_s": room.rt60_s, "room_distance_m": room.distance_mm / 1000}
    if noise_db is not None:
        is_speech = speaking(voice)
        sound = add_noise(sound, noise_db, rng, is_speech=is_speech, colour=noise_colour)
        settings |= {"noise_db": float(noise_db), "noise_colour": noise_colour}
    if through_microphone:
        sound = microphone(sound, rate_hz, rng)
        settings["microphone"] = True
    if over_telephone:
        sound = telephone(sound, rate_hz)
        settings["telephone"] = True
    peak = float(np.abs(sound).max())
    if peak > 1:
        sound = sound / peak
        settings["turned_down"] = 1 / peak
    truth = replace(voice.truth, gain=voice.truth.gain / max(peak, 1.0))
    audio = Audio(sound.astype(np.float32), rate_hz)
    return replace(voice, audio=audio, truth=truth, settings=settings)


def speaking(voice: Voice) -> NDArray[np.bool_]:
    """Which samples lie within a phone that is not silence, (n,) bool."""
    t = np.arange(len(voice.audio.samples)) / voice.audio.rate_hz
    phones = voice.truth.phones
    found = np.zeros(len(t), bool)
    for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
        if phone != SILENCE:
            found |= (t >= start) & (t < end)
    return found


def phone_truth(
    phones: PhoneTrack, n_frames: int, release_s: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
    """`frame_class` and `lips_closed` of `VoiceTruth` from phones and when stops open."""
    classes = np.full(n_frames, CLASSES.index("silence"), np.int8)
    lips = np.zeros(n_frames, bool)
    edges = np.rint(np.stack([phones.start_s, phones.end_s]) * FRAME_RATE_HZ).astype(int)
    for i, phone in enumerate(phones.phones):
        kind = phone_kinds()[phone]
        start, end = edges[:, i]
        opens = (start + end) // 2
        if release_s is not None and kind.manner in ("stop", "affricate"):
            opens = int(np.rint(release_s[i] * FRAME_RATE_HZ))
        classes[start:opens] = CLASSES.index(kind.class_)
        classes[opens:end] = CLASSES.index(kind.class_end)
        if phone in _LIPS_SHUT:
            lips[start : end if kind.manner == "nasal" or release_s is None else opens] = True
    return classes, lips


def _check_rate(rate_hz: int) -> None:
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise ValueError(f"rate_hz must lie in {RATES_HZ[0]}..{RATES_HZ[1]}, got {rate_hz}")


def _cast(talker: Talker | str | None, rng: np.random.Generator) -> Talker:
    if isinstance(talker, Talker):
        return talker
    people = group_talkers(str(rng.choice(GROUPS)) if talker is None else talker)
    return people[int(rng.integers(len(people)))]


def _plan(
    talker: Talker,
    kind: str | None,
    text: str | None,
    seconds: float | None,
    pace: float,
    rng: np.random.Generator,
) -> Timeline:
    if text is not None:
        timeline = plan_timeline(talker, script_of_text(text), rng, pace=pace)
        if seconds is not None and timeline.n_frames > seconds * FRAME_RATE_HZ:
            raise InputError(
                f"the text takes {timeline.n_frames / FRAME_RATE_HZ:.1f} s: give more --seconds"
            )
        return timeline if seconds is None else _padded(timeline, seconds)
    if seconds is None:
        return plan_timeline(talker, _something(kind, rng), rng, pace=pace)
    return _filled(talker, kind, seconds, pace, rng)


def _something(kind: str | None, rng: np.random.Generator) -> Script:
    return random_script(rng, str(rng.choice(KINDS)) if kind is None else kind)


def _filled(
    talker: Talker, kind: str | None, seconds: float, pace: float, rng: np.random.Generator
) -> Timeline:
    """Phrases while they fit into the time, then silence."""
    said: Timeline | None = None
    misses = 0
    while misses < _TRIES:
        script = _something(kind, rng)
        whole = script if said is None else join_scripts(said.script, script)
        # a phrase more must leave what was said before as it was
        tail = plan_timeline(talker, script, rng, pace=pace)
        longer = tail if said is None else _joined(said, tail, whole)
        if longer.n_frames <= seconds * FRAME_RATE_HZ:
            said = longer
        else:
            misses += 1
    if said is None:
        raise InputError(f"{seconds:g} s is too short for a phrase: give more --seconds")
    return _padded(said, seconds)


def _joined(first: Timeline, second: Timeline, script: Script) -> Timeline:
    """One after the other; the last pause of the first is the first pause of the second."""
    shift = first.edges_ms[-2]
    return Timeline(
        script,
        np.concatenate([first.edges_ms[:-2], second.edges_ms + shift]),
        np.concatenate([first.release_ms[:-1], second.release_ms + shift]),
    )


def _padded(timeline: Timeline, seconds: float) -> Timeline:
    """With the last silence so long that all lasts `seconds`."""
    edges, releases = timeline.edges_ms.copy(), timeline.release_ms.copy()
    edges[-1] = releases[-1] = round(seconds * FRAME_RATE_HZ)
    return replace(timeline, edges_ms=edges, release_ms=releases)


def _speak(
    talker: Talker,
    synth: str,
    tracks: VoiceTracks,
    source: GlottalSource,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Sound at `SOURCE_RATE_HZ`, and what a tube knows better than the plan."""
    if synth == "formant":
        return formant_voice(talker, tracks, source, rng), {}
    areas = area_tracks(talker, tracks.timeline)
    where = noise_sections(tracks.timeline, areas.shape[1])
    made = tube_voice(areas, source, tracks.frication, where, tracks.velum, rng)
    is_silent = _is_silent(tracks.timeline)
    return made.samples, {
        "areas_mm2": areas,
        "formants_hz": np.where(is_silent[:, None], np.nan, made.formants_hz),
        "bandwidths_hz": np.where(is_silent[:, None], np.nan, made.bandwidths_hz),
    }


def _scaled(
    samples: NDArray[np.float64], rate_hz: int, rng: np.random.Generator
) -> tuple[Audio, float]:
    """At the rate asked for, with a peak drawn between -12 and -1 dB of full scale."""
    level = 10 ** (rng.uniform(*_PEAK_DB) / 20)
    at_rate = samples
    if rate_hz != SOURCE_RATE_HZ:
        common = int(np.gcd(rate_hz, SOURCE_RATE_HZ))
        at_rate = resample_poly(samples, rate_hz // common, SOURCE_RATE_HZ // common)
    gain = level / max(float(np.abs(at_rate).max()), 1e-12)
    n = round(len(samples) * rate_hz / SOURCE_RATE_HZ)
    return Audio((at_rate[:n] * gain).astype(np.float32), rate_hz), gain


def _tracks_truth(tracks: VoiceTracks, source: GlottalSource) -> VoiceTruth:
    timeline = tracks.timeline
    releases = timeline.release_ms / FRAME_RATE_HZ
    classes, lips = phone_truth(timeline.phones, timeline.n_frames, releases)
    is_silent = _is_silent(timeline)[:, None]
    return VoiceTruth(
        phones=timeline.phones,
        frame_class=classes,
        lips_closed=lips,
        gain=1.0,
        f0_hz=np.where(tracks.voicing > _VOICED, tracks.f0_hz, np.nan),
        glottal_closures_s=source.closures_s,
        formants_hz=np.where(is_silent, np.nan, tracks.formants_hz),
        bandwidths_hz=np.where(is_silent, np.nan, tracks.bandwidths_hz),
        voicing=tracks.voicing,
        aspiration=tracks.aspiration,
        frication=tracks.frication,
        velum=tracks.velum,
    )


def _is_silent(timeline: Timeline) -> NDArray[np.bool_]:
    found = np.zeros(timeline.n_frames, bool)
    for i, p in enumerate(timeline.script.phones):
        if p.phone == SILENCE:
            found[timeline.edges_ms[i] : timeline.edges_ms[i + 1]] = True
    return found
