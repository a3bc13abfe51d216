"""`facewright synth voice`: synthetic speech whose truth is known exactly."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError
from .options import note, writable_folder
from .progress import progress

if TYPE_CHECKING:
    from ..datasets_synthetic.voices import Voice


class Group(StrEnum):
    """Who speaks."""

    man = "man"
    woman = "woman"
    child = "child"


class Synth(StrEnum):
    """What makes the sound."""

    formant = "formant"
    tube = "tube"
    espeak = "espeak"


def voice(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same voices.")] = 0,
    talker: Annotated[Group | None, typer.Option(help="Who speaks. Default: drawn.")] = None,
    synth: Annotated[
        Synth,
        typer.Option(help="Resonators, an acoustic tube, or eSpeak NG where it is installed."),
    ] = Synth.formant,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.5, max=600.0, help="Length of each. Default: one phrase's."),
    ] = None,
    text: Annotated[
        str | None,
        typer.Option(help="What to say, in words the synthesiser knows (eSpeak: any English)."),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(help="vowel, vowels, hvd, nonsense or sentence. Default: drawn."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, max=100_000, help="How many.")] = 1,
    rate: Annotated[int, typer.Option(min=8000, max=48000, help="Samples per second.")] = 16000,
    noise_db: Annotated[
        float | None,
        typer.Option(min=-20.0, max=100.0, help="Add noise at this signal-to-noise ratio, dB."),
    ] = None,
    room: Annotated[bool, typer.Option("--room", help="In a room drawn at random.")] = False,
    telephone: Annotated[bool, typer.Option("--telephone", help="Over a telephone line.")] = False,
) -> None:
    """Speech with its truth: NAME.wav, NAME.npz (tracks), NAME.phones.csv, and voice.toml."""
    import numpy as np

    from ..datasets_synthetic.voice_files import write_index, write_voice
    from ..datasets_synthetic.voice_rooms import random_room
    from ..datasets_synthetic.voice_scripts import KINDS
    from ..datasets_synthetic.voices import record_voice

    if kind is not None and kind not in KINDS:
        raise typer.BadParameter(f"expected one of {', '.join(KINDS)}", param_hint="--kind")
    if kind is not None and text is not None:
        raise typer.BadParameter("give --kind or --text, not both", param_hint="--kind")
    if synth is Synth.espeak and (seconds is not None or kind is not None):
        raise InputError("eSpeak NG says a text, as long as it takes: leave out --seconds, --kind")
    folder = writable_folder(out)
    written: list[tuple[str, Voice]] = []
    for index in progress(range(count), count, "speaking"):
        own = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        made = _speak(own, talker, synth, kind, text, seconds, rate)
        if room or noise_db is not None or telephone:
            made = record_voice(
                made,
                room=random_room(np.random.default_rng([own, 10])) if room else None,
                noise_db=noise_db,
                over_telephone=telephone,
            )
        name = f"voice{index:04d}"
        write_voice(folder, name, made)
        written.append((name, made))
    write_index(folder, written)
    note(f"wrote {folder}/ voice.toml and {count} each of .wav .npz .phones.csv")


def _speak(
    seed: int,
    talker: Group | None,
    synth: Synth,
    kind: str | None,
    text: str | None,
    seconds: float | None,
    rate_hz: int,
) -> Voice:
    """One clean voice."""
    from ..datasets_synthetic.voices import make_voice

    if synth is not Synth.espeak:
        return make_voice(
            seed,
            talker=None if talker is None else talker.value,
            synth=synth.value,
            kind=kind,
            text=text,
            seconds=seconds,
            rate_hz=rate_hz,
        )
    import numpy as np

    from ..datasets_synthetic.espeak import espeak_voice, random_espeak
    from ..datasets_synthetic.voice_scripts import SENTENCES

    rng = np.random.default_rng([seed, 11])
    group = str(rng.choice(list(Group))) if talker is None else talker.value
    said = str(rng.choice(SENTENCES)) if text is None else text
    return espeak_voice(said, settings=random_espeak(rng, group), rate_hz=rate_hz, seed=seed)
