"""`facewright synth take`: a performance before cameras, filmed, with its exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .options import note, parse_size, writable_folder
from .progress import Ticks

if TYPE_CHECKING:
    from ..datasets_synthetic.film import FilmedTake
    from ..datasets_synthetic.take_settings import TakeSettings
    from ..datasets_synthetic.takes import Take

SecondsOption = Annotated[float, typer.Option(min=0.5, max=7200.0, help="Length of the take.")]
SeedOption = Annotated[int, typer.Option(min=0, help="The same seed makes the same take.")]


def take(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="The same seed makes the same take. Default: 0.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.5, max=7200.0, help="Length. Default: 4.")
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(help="markers (default), plain: an ordinary video, or wand: for calibration."),
    ] = None,
    markers: Annotated[str | None, typer.Option(help="dots (default) or spheres.")] = None,
    cameras: Annotated[int | None, typer.Option(min=1, max=8, help="How many.")] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Of the pictures, px.")] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Frames a second.")] = None,
    style: Annotated[
        str | None, typer.Option(help="mixed (default), expressions, speech or range.")
    ] = None,
    voice: Annotated[bool, typer.Option("--voice", help="Speech is heard.")] = False,
    actor: Annotated[
        str | None, typer.Option(metavar="HEAD", help="A built-in head instead of a random person.")
    ] = None,
    troubles: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="A,B,...",
            help="Difficulties: blur rolling focus vignetting ghosts noise drops clocks vfr claps "
            "flash knock rotated clutter hand hair.",
        ),
    ] = None,
    lossless: Annotated[bool, typer.Option("--lossless", help="FFV1 instead of H.264.")] = False,
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="A take.toml, or a part of one, to start from."),
    ] = None,
    vertices: Annotated[
        bool, typer.Option("--vertices", help="Put all vertices into the truth (large).")
    ] = False,
) -> None:
    """A performance before cameras: videos, rig.json, truth.npz, take.toml and more.

    Interrupted, it goes on from the last whole piece when called again.
    """
    from ..datasets_synthetic.take_settings import read_take_settings, settings_for, settings_with

    told_seed = None
    if settings is not None:
        base, told_seed = read_take_settings(settings)
    else:
        base = settings_for(kind or "markers", markers or "dots")
    changes: dict[str, Any] = {
        "seconds": seconds,
        "cameras.count": cameras,
        "cameras.image_size": None if size is None else parse_size(size),
        "cameras.rate_hz": rate,
        "performance.style": style,
        "performance.voice": True if voice else None,
        "actor.head": actor,
        "video.codec": "lossless" if lossless else None,
    }
    if settings is not None:
        changes |= {"kind": kind, "markers.look": markers}
    changes = {key: value for key, value in changes.items() if value is not None}
    asked = settings_with(base, changes | _troubles(troubles))
    if markers is not None and asked.kind != "markers":
        raise InputError(f"--markers {markers}: a take of kind {asked.kind} has no markers")
    _check_names(asked)
    chosen = next((s for s in (seed, told_seed) if s is not None), 0)
    filmed = run_take(writable_folder(out), asked, chosen, keep_vertices=vertices)
    files = [p.name for p in (filmed.settings, filmed.rig, filmed.truth)]
    files += [p.name for p in (filmed.marker_set, filmed.sound) if p is not None]
    note(f"wrote {out}/ {' '.join(files + [p.name for p in filmed.videos])}")


def run_take(
    folder: Path, settings: TakeSettings, seed: int, *, keep_vertices: bool = False
) -> FilmedTake:
    """Film a take, with a progress bar."""
    from ..datasets_synthetic.film import film_take, pieces_done
    from ..datasets_synthetic.takes import make_take

    made: Take = make_take(seed, settings)
    with Ticks(len(made.time_s), "filming") as tick:
        filmed = film_take(made, folder, keep_vertices=keep_vertices, on_frame=tick, on_resume=_say)
    assert not pieces_done(folder)
    return filmed


def _check_names(asked: TakeSettings) -> None:
    """Refuse names that nobody has, before any folder is made."""
    from ..heads.catalogue import built_in_identity
    from ..heads.marker_sets import ready_marker_set

    if asked.actor.head:
        built_in_identity(asked.actor.head)
    if asked.kind == "markers":
        ready_marker_set(asked.markers.set)


def _say(n_pieces: int) -> None:
    note(f"going on from an interrupted run: {n_pieces} pieces are there")


def _troubles(text: str | None) -> dict[str, Any]:
    from ..datasets_synthetic.take_settings import TROUBLES

    found: dict[str, Any] = {}
    for word in (text or "").replace(",", " ").split():
        if word not in TROUBLES:
            raise InputError(f"--with {word}: expected some of {', '.join(TROUBLES)}")
        for key, value in TROUBLES[word].items():
            if found.get(key, value) != value:
                raise InputError(f"--with {text}: {word} excludes one of the others, choose one")
            found[key] = value
    return found
