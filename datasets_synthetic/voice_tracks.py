"""From what is said to how the voice moves: durations, pitch, loudness, formants, per millisecond.

Formant targets of vowels are the talker's own, those of glides and nasals Klatt's (1980, table
II), scaled to the talker's tract. Loci of the other consonants, and durations of all, are our
choice within what textbooks give; a consonant's second formant is drawn towards the vowel beside
it (a locus equation).
"""

from __future__ import annotations

import csv
import itertools
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ..core.arrays import readonly
from ..core.phones import SILENCE, PhoneTrack
from .voice_phones import DIPHTHONGS, phone_kinds
from .voice_scripts import Script
from .voice_talkers import MEASURED_AT, Talker

#: F1, F2, F3 (Hz, for a man) that a closure at a place points to, and how far F1, F2, F3 go
#: towards the vowel's own instead.
LOCI = {
    "labial": ((250.0, 900.0, 2250.0), (0.1, 0.6, 0.5)),
    "labiodental": ((260.0, 1000.0, 2250.0), (0.1, 0.55, 0.5)),
    "dental": ((270.0, 1400.0, 2600.0), (0.1, 0.45, 0.4)),
    "alveolar": ((260.0, 1750.0, 2700.0), (0.1, 0.35, 0.4)),
    "postalveolar": ((260.0, 1850.0, 2550.0), (0.1, 0.3, 0.4)),
    "velar": ((250.0, 1700.0, 2250.0), (0.1, 0.75, 0.4)),
}
_STRESSED, _UNSTRESSED = 1.0, 0.65  # of a vowel's duration
_BANDWIDTH = {"man": 1.0, "woman": 1.2, "child": 1.3}  # Kent & Vorperian 2018, roughly
_B4_HZ = 230.0
_CONSONANT_BANDWIDTHS = (60.0, 100.0, 180.0)
_GLOTTAL = "glottal"
#: A stop is shut for this share of its time; then the burst, then breath if it is voiceless.
_SHUT = {"stop": 0.6, "affricate": 0.4}
_BURST_MS = {False: 12, True: 8}  # by whether it is voiced
_RAMP_MS = 15
_NASAL_RAMP_MS = 40


@dataclass(frozen=True, eq=False)
class Timeline:
    """When each phone of a script is said; everything on whole milliseconds.

    Attributes
    ----------
    script : Script
    edges_ms : (N + 1,) int64, ms
        Phone i lasts from edge i to edge i + 1.
    release_ms : (N,) int64, ms
        When a stop or an affricate opens; the phone's end for all others.
    """

    script: Script
    edges_ms: NDArray[np.int64]
    release_ms: NDArray[np.int64]

    def __post_init__(self) -> None:
        n = len(self.script.phones)
        object.__setattr__(
            self, "edges_ms", readonly(self.edges_ms, (n + 1,), "edges_ms", np.int64)
        )
        object.__setattr__(
            self, "release_ms", readonly(self.release_ms, (n,), "release_ms", np.int64)
        )

    @property
    def n_frames(self) -> int:
        """Milliseconds in all."""
        return int(self.edges_ms[-1])

    @property
    def phones(self) -> PhoneTrack:
        """The same as a `PhoneTrack`."""
        edges = self.edges_ms / 1000
        return PhoneTrack(tuple(p.phone for p in self.script.phones), edges[:-1], edges[1:])


@dataclass(frozen=True, eq=False)
class VoiceTracks:
    """What drives a synthesiser, one value a millisecond (`voice_source.FRAME_RATE_HZ`).

    Attributes
    ----------
    timeline : Timeline
    f0_hz : (T,) float64, Hz
        The melody; defined throughout, also where nothing is voiced.
    formants_hz, bandwidths_hz : (T, 4) float64, Hz
    voicing, aspiration, frication, velum : (T,) float64
        Amplitudes of pulses, breath and noise at the constriction; how open the nose is, 0 to 1.
    """

    timeline: Timeline
    f0_hz: NDArray[np.float64]
    formants_hz: NDArray[np.float64]
    bandwidths_hz: NDArray[np.float64]
    voicing: NDArray[np.float64]
    aspiration: NDArray[np.float64]
    frication: NDArray[np.float64]
    velum: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = self.timeline.n_frames
        for name in ("f0_hz", "voicing", "aspiration", "frication", "velum"):
            object.__setattr__(self, name, readonly(getattr(self, name), (n,), name))
        for name in ("formants_hz", "bandwidths_hz"):
            object.__setattr__(self, name, readonly(getattr(self, name), (n, 4), name))


def plan_timeline(
    talker: Talker, script: Script, rng: np.random.Generator, *, pace: float = 1.0
) -> Timeline:
    """Give each phone its time: the talker's for vowels, the table's for consonants, ± 10 %."""
    kinds = phone_kinds()
    edges, releases = [0], []
    for p in script.phones:
        kind = kinds[p.phone]
        wobble = np.exp(0.1 * np.clip(rng.standard_normal(), -2, 2))
        if kind.is_vowel:
            own = 1000 * talker.vowels[DIPHTHONGS.get(p.phone, (p.phone,))[0]].duration_s
            own *= script.pace * (_STRESSED if p.is_stressed else _UNSTRESSED)
        else:
            own = kind.duration_ms
        ms = max(round(own * wobble * pace), 30)
        shut = _SHUT.get(kind.manner)
        releases.append(edges[-1] + (ms if shut is None else round(ms * shut)))
        edges.append(edges[-1] + ms)
    return Timeline(script, np.array(edges), np.array(releases))


def plan_tracks(talker: Talker, timeline: Timeline, rng: np.random.Generator) -> VoiceTracks:
    """Melody, loudness and formants of a talker who says what the timeline asks for."""
    formants, bandwidths = _formant_tracks(talker, timeline)
    voicing, aspiration, frication = _loudness(timeline)
    return VoiceTracks(
        timeline=timeline,
        f0_hz=_melody(talker, timeline, rng),
        formants_hz=formants,
        bandwidths_hz=bandwidths,
        voicing=voicing,
        aspiration=aspiration,
        frication=frication,
        velum=_velum(timeline),
    )


def vowel_keys(talker: Talker, phone: str) -> NDArray[np.float64]:
    """F1 to F4 of a vowel or diphthong at `MEASURED_AT`, (3, 4) Hz."""
    if phone not in DIPHTHONGS:
        return talker.vowels[phone].formants_hz
    first, last = (talker.vowels[v].formants_hz[1] for v in DIPHTHONGS[phone])
    return np.stack([first, np.sqrt(first * last), last])


@cache
def klatt_targets() -> dict[str, NDArray[np.float64]]:
    """(2, 6) a phone: F1-F3 and B1-B3, Hz, at its beginning and end, for a man."""
    table = files(__package__) / "data" / "klatt1980_targets.csv"
    names = ("f1", "f2", "f3", "b1", "b2", "b3")
    with table.open(encoding="utf-8") as stream:
        return {
            row["phoneme"].upper(): np.array(
                [[float(row[f"{n}_{at}"]) for n in names] for at in ("on", "off")]
            )
            for row in csv.DictReader(stream)
        }


def smooth(values: NDArray[np.float64], ms: int) -> NDArray[np.float64]:
    """`values` (T,) averaged under a Hann window of `ms` milliseconds."""
    window = np.hanning(ms + 2)[1:-1]
    padded = np.pad(values, (len(window) // 2, (len(window) - 1) // 2), mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def _formant_tracks(
    talker: Talker, timeline: Timeline
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    times: list[float] = []
    keys: list[NDArray[np.float64]] = []
    for i in range(len(timeline.script.phones)):
        start, end = timeline.edges_ms[i : i + 2]
        at, targets = _targets(talker, timeline, i)
        times += [start + a * (end - start) for a in at]
        keys += list(targets)
    if not keys:
        raise ValueError("nothing is said")
    frames = np.clip(np.arange(timeline.n_frames), times[0], times[-1])
    if len(keys) == 1:
        tracks = np.tile(keys[0], (len(frames), 1))
    else:
        tracks = np.exp(PchipInterpolator(times, np.log(np.array(keys)))(frames))
    return tracks[:, :4], tracks[:, 4:]


def _targets(
    talker: Talker, timeline: Timeline, index: int
) -> tuple[tuple[float, ...], list[NDArray[np.float64]]]:
    """When in a phone (0 to 1) its formants and bandwidths are what, (8,) Hz each."""
    kind = phone_kinds()[timeline.script.phones[index].phone]
    wider = _BANDWIDTH[talker.group]
    if kind.is_vowel:
        parts = DIPHTHONGS.get(kind.phone, (kind.phone, kind.phone))
        b_on, b_off = (klatt_targets()[p][k, 3:] for p, k in zip(parts, (0, 1), strict=True))
        b = np.linspace(b_on, b_off, 3)
        b = np.column_stack([b, np.full(3, _B4_HZ)]) * wider
        f = vowel_keys(talker, kind.phone)
        return MEASURED_AT, [np.concatenate(pair) for pair in zip(f, b, strict=True)]
    f4 = _usual_f4(talker)
    if kind.phone in klatt_targets():
        found = klatt_targets()[kind.phone]
        rows = [
            np.concatenate([row[:3] * talker.scale, [f4], row[3:] * wider, [_B4_HZ * wider]])
            for row in found
        ]
        return (0.25, 0.75), rows
    if kind.place not in LOCI:
        return (), []
    locus, towards = (np.array(x) for x in LOCI[kind.place])
    bandwidths = np.array([*_CONSONANT_BANDWIDTHS, _B4_HZ]) * wider
    rows = []
    for step in (-1, 1):
        vowel = _beside(talker, timeline, index, step)
        f = locus * talker.scale
        if vowel is not None:
            f = f + towards * (vowel[:3] - f)
        rows.append(np.concatenate([f, [f4], bandwidths]))
    return (0.15, 0.9), rows


def _usual_f4(talker: Talker) -> float:
    return float(np.median([v.formants_hz[1, 3] for v in talker.vowels.values()]))


def _beside(
    talker: Talker, timeline: Timeline, index: int, step: int
) -> NDArray[np.float64] | None:
    """Formants of the nearest vowel before or after, else of the nearest on the other side."""
    phones = timeline.script.phones
    kinds = phone_kinds()
    for direction in (step, -step):
        i = index + direction
        while 0 <= i < len(phones) and phones[i].phone != SILENCE:
            if kinds[phones[i].phone].is_vowel:
                keys = vowel_keys(talker, phones[i].phone)
                return np.asarray(keys[0] if direction > 0 else keys[-1])
            i += direction
    return None


def _loudness(
    timeline: Timeline,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pulses, breath and noise of each millisecond."""
    n = timeline.n_frames
    voicing, aspiration, frication, burst = (np.zeros(n) for _ in range(4))
    for i, p in enumerate(timeline.script.phones):
        kind = phone_kinds()[p.phone]
        start, end = timeline.edges_ms[i : i + 2]
        release = timeline.release_ms[i]
        voicing[start:end] = kind.voicing
        if kind.is_vowel and not p.is_stressed:
            voicing[start:end] *= 0.75
        if kind.place == _GLOTTAL:
            aspiration[start:end] = 0.12
        elif kind.manner == "fricative":
            frication[start:end] = kind.frication
        elif kind.manner == "affricate":
            frication[release:end] = kind.frication
        elif kind.manner == "stop":
            is_voiced = kind.voicing > 0
            burst[release : min(release + _BURST_MS[is_voiced], end)] = kind.frication
            if is_voiced:
                voicing[release:end] = 0.5 if _goes_on(timeline, i) else 0.0
            else:
                aspiration[release:end] = 0.09 if _goes_on(timeline, i) else 0.02
    voicing = smooth(voicing, _RAMP_MS)
    voicing[voicing < 1e-3] = 0.0
    return voicing, smooth(aspiration, _RAMP_MS), smooth(frication, _RAMP_MS) + smooth(burst, 4)


def _goes_on(timeline: Timeline, index: int) -> bool:
    """Whether something voiced follows."""
    following = timeline.script.phones[index + 1 : index + 2]
    return bool(following) and phone_kinds()[following[0].phone].voicing > 0


def _velum(timeline: Timeline) -> NDArray[np.float64]:
    is_open = np.zeros(timeline.n_frames)
    for i, p in enumerate(timeline.script.phones):
        if phone_kinds()[p.phone].manner == "nasal":
            start, end = timeline.edges_ms[i : i + 2]
            is_open[max(start - _NASAL_RAMP_MS // 2, 0) : end + _NASAL_RAMP_MS // 2] = 1.0
    return smooth(is_open, _NASAL_RAMP_MS)


def _melody(talker: Talker, timeline: Timeline, rng: np.random.Generator) -> NDArray[np.float64]:
    """Falls over each phrase, rises on stressed vowels; now and then a question at the end."""
    n = timeline.n_frames
    semitones = np.zeros(n)
    phones = timeline.script.phones
    frames = np.arange(n)
    pauses = [i for i, p in enumerate(phones) if p.phone == SILENCE]
    for first, last in itertools.pairwise(pauses):
        start, end = timeline.edges_ms[first], timeline.edges_ms[last]
        fall = rng.uniform(2.0, 4.5)
        if rng.random() < 0.2:  # a question
            semitones[start:end] += _rise(end - start, rng.uniform(3.0, 6.0))
        at = np.linspace(0, 1, end - start)
        semitones[start:end] += fall * (0.5 - at)
    for i, p in enumerate(phones):
        if p.is_stressed:
            middle = timeline.edges_ms[i : i + 2].mean()
            width = rng.uniform(60, 110)
            height = rng.uniform(0.5, 3.5)
            semitones += height * np.exp(-0.5 * ((frames - middle) / width) ** 2)
    semitones -= semitones.mean()
    return talker.f0_hz * 2 ** (smooth(semitones, 60) / 12)


def _rise(n: int, semitones: float) -> NDArray[np.float64]:
    """Zero, then a smooth rise over the last third."""
    at = np.clip(np.linspace(-2, 1, n), 0, 1)
    return np.asarray(semitones * at**2 * (3 - 2 * at))
