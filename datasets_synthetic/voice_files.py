"""Voices on disk: NAME.wav, NAME.npz, NAME.phones.csv, and one voice.toml for the folder.

``NAME.npz`` holds, where they are known (see `VoiceTruth` for what each is): ``time_s``,
``frame_class``, ``class_names``, ``lips_closed``, ``gain``, ``phones``, ``start_s``, ``end_s``,
``f0_hz``, ``glottal_closures_s``, ``formants_hz``, ``bandwidths_hz``, ``voicing``, ``aspiration``,
``frication``, ``velum``, and of a tube ``areas_mm2``, ``section_mm``, ``reflections`` (T, N - 1).
Tracks are float32; times and ``gain`` float64. It is read without pickle.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.audio import write_audio
from ..core.files import atomic_path, atomic_write
from .tube_voice import SECTION_MM, reflection_coefficients
from .voice_phones import CLASSES, phone_kinds
from .voices import Voice, VoiceTruth

_TRACKS = (
    "f0_hz", "formants_hz", "bandwidths_hz", "voicing", "aspiration", "frication", "velum",
    "areas_mm2",
)  # fmt: skip


def write_voice(folder: Path, name: str, voice: Voice) -> tuple[Path, Path, Path]:
    """Write a voice's sound, truth and phones; each file appears whole or not at all."""
    paths = (folder / f"{name}.wav", folder / f"{name}.npz", folder / f"{name}.phones.csv")
    write_audio(paths[0], voice.audio)
    with atomic_path(paths[1]) as part, open(part, "wb") as stream:
        np.savez_compressed(stream, **truth_arrays(voice.truth))
        stream.flush()
        os.fsync(stream.fileno())
    with atomic_write(paths[2]) as text:
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(("start_s", "end_s", "phone", "class", "viseme"))
        phones = voice.truth.phones
        for phone, start, end in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
            kind = phone_kinds()[phone]
            rows.writerow((f"{start:.6f}", f"{end:.6f}", phone, kind.class_, kind.viseme))
    return paths


def write_index(folder: Path, named: Sequence[tuple[str, Voice]]) -> Path:
    """Write ``voice.toml``: what was simulated, one ``[[voice]]`` each."""
    path = folder / "voice.toml"
    with atomic_write(path) as stream:
        stream.write("# Synthetic voices: NAME.wav with its truth in NAME.npz, NAME.phones.csv\n")
        stream.write("version = 1\n")
        for name, voice in named:
            stream.write("\n[[voice]]\n")
            for key, value in _facts(name, voice).items():
                stream.write(f"{key} = {_toml(value)}\n")
    return path


def truth_arrays(truth: VoiceTruth) -> dict[str, Any]:
    """The arrays of ``NAME.npz``."""
    found: dict[str, Any] = {
        "time_s": truth.time_s,
        "frame_class": truth.frame_class,
        "class_names": np.array(CLASSES),
        "lips_closed": truth.lips_closed,
        "gain": np.float64(truth.gain),
        "phones": np.array(truth.phones.phones),
        "start_s": truth.phones.start_s,
        "end_s": truth.phones.end_s,
    }
    for name in _TRACKS:
        value = getattr(truth, name)
        if value is not None:
            found[name] = value.astype(np.float32)
    if truth.glottal_closures_s is not None:
        found["glottal_closures_s"] = truth.glottal_closures_s
    if truth.areas_mm2 is not None:
        found["section_mm"] = np.float64(SECTION_MM)
        found["reflections"] = reflection_coefficients(truth.areas_mm2).astype(np.float32)
    return found


def _facts(name: str, voice: Voice) -> dict[str, float | str | bool]:
    return {
        "name": name,
        "synth": voice.synth,
        "talker": voice.talker,
        "group": voice.group,
        "kind": voice.kind,
        "text": voice.text,
        "seed": voice.seed,
        "rate_hz": voice.audio.rate_hz,
        "duration_s": voice.audio.duration_s,
        **voice.settings,
    }


def _toml(value: float | str | bool) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for DEL, which JSON leaves as it is
        return json.dumps(value).replace("\x7f", "\\u007f")
    return repr(value) if isinstance(value, int) else f"{value:.9g}"
