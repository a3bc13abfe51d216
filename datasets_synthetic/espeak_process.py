"""Run as a process of its own: loads eSpeak NG's library, says one text, tells when what was said.

``python espeak_process.py REQUEST.json SOUND.raw`` writes 16-bit samples to the second file and
``{"rate_hz": ..., "events": [[sample, mnemonic], ...]}`` to stdout. It imports nothing of ours.
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Any

# names and numbers of espeak-ng/speak_lib.h
_OUTPUT_SYNCHRONOUS = 2
_PHONEME_EVENTS = 1
_EVENT_END, _EVENT_PHONEME = 0, 7
_RATE, _PITCH = 1, 3
_CHARACTERS, _UTF8 = 1, 1
_NAME_BYTES = 8


class _Id(ctypes.Union):
    _fields_ = [
        ("number", ctypes.c_int),
        ("name", ctypes.c_char_p),
        ("string", ctypes.c_char * _NAME_BYTES),
    ]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _Id),
    ]


def say(request: dict[str, Any]) -> tuple[int, bytes, list[tuple[int, str]]]:
    """Rate, samples and phoneme events of one text."""
    library = ctypes.CDLL(request["library"])
    rate_hz = library.espeak_Initialize(_OUTPUT_SYNCHRONOUS, 0, None, _PHONEME_EVENTS)
    if rate_hz <= 0:
        raise SystemExit("its voices are not installed")
    sound = bytearray()
    events: list[tuple[int, str]] = []

    def take(samples: Any, count: int, found: Any) -> int:
        if samples and count > 0:
            sound.extend(ctypes.string_at(samples, 2 * count))
        i = 0
        while found[i].type != _EVENT_END:
            if found[i].type == _EVENT_PHONEME:
                name = found[i].id.string.decode("utf-8", "replace")
                events.append((found[i].sample, name))
            i += 1
        return 0

    kind = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
    )
    callback = kind(take)
    library.espeak_SetSynthCallback(callback)
    if library.espeak_SetVoiceByName(request["voice"].encode()) != 0:
        raise SystemExit(f"it has no voice {request['voice']}")
    library.espeak_SetParameter(_RATE, request["words_per_minute"], 0)
    library.espeak_SetParameter(_PITCH, request["pitch"], 0)
    text = request["text"].encode()
    size = ctypes.c_size_t(len(text) + 1)
    if library.espeak_Synth(text, size, 0, _CHARACTERS, 0, _UTF8, None, None) != 0:
        raise SystemExit("it refused the text")
    library.espeak_Synchronize()
    return rate_hz, bytes(sound), events


def main() -> None:
    """The whole process."""
    request = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    rate_hz, sound, events = say(request)
    Path(sys.argv[2]).write_bytes(sound)
    json.dump({"rate_hz": rate_hz, "events": events}, sys.stdout)


if __name__ == "__main__":
    main()
