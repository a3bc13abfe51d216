"""Sentences by eSpeak NG, a program the user may have, with its own phoneme times.

The program is not part of this package and not linked to it: it is loaded by a process of its own
(`espeak_process`), which hands back sound and events. What it needs is the program on the path and
the library beside it, as its installers put them.
"""

from __future__ import annotations

import ctypes.util
import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from ..core.audio import Audio
from ..core.errors import InputError
from ..core.phones import SILENCE, PhoneTrack
from .voice_phones import phone_kinds
from .voice_source import FRAME_RATE_HZ
from .voices import Voice, VoiceTruth, phone_truth

PROGRAM = "espeak-ng"
#: Voices by group: names of eSpeak's own variants of American English.
GROUP_VOICES = {
    "man": ("en-us", "en-us+m1", "en-us+m3", "en-us+m5", "en-us+m7"),
    "woman": ("en-us+f1", "en-us+f2", "en-us+f3", "en-us+f4"),
    "child": ("en-us+f5",),
}
#: eSpeak's mnemonics for en-us (version 1.5x) in ARPAbet. Marks of length and variant (``:``,
#: ``2``, ``-``) are removed if the whole is not listed.
MNEMONICS: dict[str, tuple[str, ...]] = {
    "p": ("P",), "b": ("B",), "t": ("T",), "d": ("D",), "k": ("K",), "g": ("G",),
    "t#": ("T",), "*": ("T",), "tS": ("CH",), "dZ": ("JH",), "f": ("F",), "v": ("V",),
    "T": ("TH",), "D": ("DH",), "s": ("S",), "z": ("Z",), "S": ("SH",), "Z": ("ZH",),
    "h": ("HH",), "x": ("K",), "m": ("M",), "n": ("N",), "N": ("NG",), "l": ("L",), "L": ("L",),
    "r": ("R",), "w": ("W",), "j": ("Y",), "a": ("AE",), "aa": ("AE",), "a#": ("AH",),
    "A": ("AA",), "A:": ("AA",), "0": ("AA",), "O": ("AO",), "O:": ("AO",), "O2": ("AA",),
    "E": ("EH",), "E2": ("EH",), "I": ("IH",), "I2": ("IH",), "i": ("IY",), "i:": ("IY",),
    "V": ("AH",), "@": ("AH",), "@2": ("AH",), "@5": ("AH",), "U": ("UH",), "u": ("UW",),
    "u:": ("UW",), "3": ("ER",), "3:": ("ER",), "aI": ("AY",), "aU": ("AW",), "OI": ("OY",),
    "eI": ("EY",), "oU": ("OW",), "@L": ("AH", "L"), "e@": ("EH", "R"), "i@": ("IH", "R"),
    "i@3": ("IH", "R"), "U@": ("UH", "R"), "A@": ("AA", "R"), "O@": ("AO", "R"),
    "o@": ("AO", "R"), "aI@": ("AY", "AH"), "aI3": ("AY", "ER"), "aU@": ("AW", "AH"),
    "IR": ("ER",), "VR": ("ER",), "nn": ("N",),
}  # fmt: skip
_PAUSES = ("_", "?", "|")
_TIME_LIMIT_S = 120.0
_SHORTEST_S = 0.002
_CLOSURE_DB = -18.0  # of the loudest within the search; eSpeak's closures are silence
_CLOSURE_SEARCH_S = 0.12
_WINDOW_S = 0.005


@dataclass(frozen=True)
class EspeakSettings:
    """How eSpeak speaks.

    Attributes
    ----------
    voice : str
        One of eSpeak's names for American English, with a variant: ``en-us+f3``.
    words_per_minute, pitch : int
        80 to 450; 0 to 99.
    """

    voice: str = "en-us"
    words_per_minute: int = 165
    pitch: int = 50

    def __post_init__(self) -> None:
        if not self.voice.startswith("en-us"):
            raise ValueError(f"voice must be a variant of en-us, got {self.voice!r}")
        if not 80 <= self.words_per_minute <= 450 or not 0 <= self.pitch <= 99:
            raise ValueError("words_per_minute must lie in 80..450, pitch in 0..99")


def has_espeak() -> bool:
    """Whether the program and its library are there."""
    return shutil.which(PROGRAM) is not None and _library() is not None


def espeak_voice(
    text: str,
    *,
    settings: EspeakSettings | None = None,
    rate_hz: int = 16_000,
    seed: int = 0,
) -> Voice:
    """A text spoken by eSpeak NG, with its phones.

    Boundaries are eSpeak's events, except that a stop begins where its closure does: the event
    comes with the burst, and the closure is found as the silence before it. What eSpeak does not
    tell (F0, formants) is None in the truth.

    Raises
    ------
    InputError
        If eSpeak NG is not installed, cannot say the text, or uses a phoneme we have no name for.
    """
    if not 8_000 <= rate_hz <= 48_000:
        raise ValueError(f"rate_hz must lie in 8000..48000, got {rate_hz}")
    settings = settings or EspeakSettings()
    if not any(c.isalnum() for c in text):
        raise InputError("the text has no words to say")
    own_rate, sound, events = _run(text, settings)
    phones, release_s = _phone_track(events, sound, own_rate)
    common = int(np.gcd(rate_hz, own_rate))
    samples = resample_poly(sound.astype(np.float64) / 32768, rate_hz // common, own_rate // common)
    gain = min(1.0, 1.0 / float(np.abs(samples).max()))
    audio = Audio((samples * gain).astype(np.float32), rate_hz)
    n_frames = round(len(sound) / own_rate * FRAME_RATE_HZ)
    classes, lips = phone_truth(phones, n_frames, release_s)
    group = next((g for g, names in GROUP_VOICES.items() if settings.voice in names), "man")
    more: dict[str, float | str | bool] = {
        "words_per_minute": settings.words_per_minute,
        "pitch": settings.pitch,
    }
    truth = VoiceTruth(phones, classes, lips, gain)
    return Voice(audio, truth, "espeak", settings.voice, group, "text", text, seed, more)


def random_espeak(rng: np.random.Generator, group: str) -> EspeakSettings:
    """A voice of a group at a random pace and pitch."""
    return EspeakSettings(
        str(rng.choice(GROUP_VOICES[group])),
        int(rng.integers(130, 200)),
        int(rng.integers(60, 90)) if group == "child" else int(rng.integers(30, 65)),
    )


def arpabet_of(mnemonic: str) -> tuple[str, ...]:
    """ARPAbet phones of one of eSpeak's mnemonics; nothing for a pause.

    Raises
    ------
    InputError
        If there is no such phone in American English.
    """
    bare = mnemonic.strip(",'%=;")
    if not bare or bare.startswith(_PAUSES):
        return ()
    for name in (bare, bare.rstrip("-:;"), bare.rstrip("-:;#2345")):
        if name in MNEMONICS:
            return MNEMONICS[name]
    raise InputError(
        f"eSpeak NG says [{mnemonic}], which has no ARPAbet name: use English words only"
    )


def _library() -> str | None:
    return ctypes.util.find_library("espeak-ng") or ctypes.util.find_library("libespeak-ng")


def _run(
    text: str, settings: EspeakSettings
) -> tuple[int, NDArray[np.int16], list[tuple[int, str]]]:
    """Rate, samples and (sample, mnemonic) events, from a process of its own."""
    library = _library()
    if shutil.which(PROGRAM) is None or library is None:
        raise InputError(
            "eSpeak NG is not installed: install the package espeak-ng of your system, or use "
            "--synth formant"
        )
    request = {
        "library": library,
        "text": text,
        "voice": settings.voice,
        "words_per_minute": settings.words_per_minute,
        "pitch": settings.pitch,
    }
    with tempfile.TemporaryDirectory() as folder:
        wanted = Path(folder) / "request.json"
        sound = Path(folder) / "sound.raw"
        wanted.write_text(json.dumps(request), encoding="utf-8")
        child = Path(__file__).with_name("espeak_process.py")
        try:
            done = subprocess.run(
                [sys.executable, "-I", str(child), str(wanted), str(sound)],
                capture_output=True,
                text=True,
                timeout=_TIME_LIMIT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"eSpeak NG did not finish within {_TIME_LIMIT_S:g} s") from None
        if done.returncode != 0:
            last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
            raise InputError(f"eSpeak NG could not say the text: {last[0]}")
        answer = json.loads(done.stdout)
        samples = np.frombuffer(sound.read_bytes(), "<i2")
    if not len(samples) or not answer["events"]:
        raise InputError("eSpeak NG said nothing: is the text English?")
    return int(answer["rate_hz"]), samples, [(int(s), str(name)) for s, name in answer["events"]]


def _phone_track(
    events: list[tuple[int, str]], sound: NDArray[np.int16], rate_hz: int
) -> tuple[PhoneTrack, NDArray[np.float64]]:
    """Phones without gaps from first to last sample, and when each stop opens."""
    starts: list[float] = [0.0]
    names: list[str] = [SILENCE]
    releases: list[float] = [0.0]
    for i, (sample, mnemonic) in enumerate(events):
        at = sample / rate_hz
        until = (events[i + 1][0] if i + 1 < len(events) else len(sound)) / rate_hz
        said = arpabet_of(mnemonic) or (SILENCE,)
        for k, phone in enumerate(said):
            begins = at + k * (until - at) / len(said)
            opens = begins
            if phone_kinds()[phone].manner in ("stop", "affricate"):
                begins = max(_closure_start(sound, rate_hz, opens), starts[-1] + _SHORTEST_S)
            if phone == SILENCE and names[-1] == SILENCE:
                continue
            starts.append(begins)
            names.append(phone)
            releases.append(opens)
    end = len(sound) / rate_hz
    edges = np.append(starts, end)
    kept = [i for i in range(len(names)) if edges[i + 1] - edges[i] > _SHORTEST_S / 2]
    kept_edges = np.append(edges[kept], end)
    phones = PhoneTrack(tuple(names[i] for i in kept), kept_edges[:-1], kept_edges[1:])
    opened = np.clip(np.array(releases)[kept], kept_edges[:-1], kept_edges[1:])
    return phones, opened


def _closure_start(sound: NDArray[np.int16], rate_hz: int, opens_s: float) -> float:
    """When the silence begins that ends with a stop's burst; the burst itself if there is none."""
    step = round(_WINDOW_S * rate_hz)
    end = round(opens_s * rate_hz)
    first = max(0, end - round(_CLOSURE_SEARCH_S * rate_hz))
    n = (end - first) // step
    if n < 2:
        return opens_s
    blocks = sound[end - n * step : end].astype(np.float64).reshape(n, step)
    level = 10 * np.log10((blocks**2).mean(axis=1) + 1e-3)
    loud = np.flatnonzero(level > level.max() + _CLOSURE_DB)
    quiet_from = int(loud[-1]) + 1
    return (end - (n - quiet_from) * step) / rate_hz
