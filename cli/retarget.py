"""`facewright retarget`: curves to a moving head, or to curves of another kind."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError
from .heads import check_head
from .options import note, parse_size, writable_file
from .retarget_files import CURVES, OUTPUTS, USD, VIDEOS, Drive, write_animation, write_curves

if TYPE_CHECKING:
    from ..core.clip import Clip
    from ..retarget.resampling import FittedSound

METHODS = ("points", "shapes", "direct")
MORPHS = ("curves", "frames")


def retarget(
    clip: Annotated[
        Path,
        typer.Argument(metavar="CLIP", help="FAPs or ARKit weights: .fap, .npz, Live Link .csv."),
    ],
    head: Annotated[
        str,
        typer.Option(
            "--head", metavar="HEAD", help="A built-in head (see synth head --list) or a file."
        ),
    ] = "ruth",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="A moving head: .glb, .usd, .usda, .usdz, .mp4, .webm; its rotations: .bvh; "
            "curves: .fap, .csv (ARKit), .npz. Default: the clip's name, .glb.",
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", metavar="CSV", help="Feature points of a head from a file."),
    ] = None,
    audio: Annotated[
        Path | None,
        typer.Option("--audio", metavar="FILE", help="Sound for a video or .usd, from time 0 on."),
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(
            "--fps",
            metavar="RATE",
            help="Resample: 24, 25, 29.97, 30, 50, 59.94, 60, other whole numbers, 30000/1001. "
            "Default: the clip's own times.",
        ),
    ] = None,
    drive: Annotated[
        str | None,
        typer.Option(
            "--drive",
            metavar="|".join(METHODS),
            help="By feature points; by the head's own shapes, solved for; or by a fixed table of "
            "shapes. Default: points for FAPs, shapes for weights.",
        ),
    ] = None,
    morphs: Annotated[
        str,
        typer.Option(
            metavar="|".join(MORPHS),
            help="Blendshapes of a .glb or .usd: one a curve, or one a frame (at most two weights "
            "at a time are then above 0).",
        ),
    ] = "curves",
    size: Annotated[str, typer.Option(help="Picture size of a video.")] = "720x720",
) -> None:
    """Drive a head by FAPs or ARKit weights, and write it as a file that other programs read."""
    out = writable_file(out or clip.with_suffix(".glb"), OUTPUTS)
    _check_word(drive, METHODS, "--drive")
    _check_word(morphs, MORPHS, "--morphs")
    rate, width_height = _rate(fps), _size(size)
    _check_together(clip, out, audio, drive)
    check_head(head)
    curves = read_clip(clip)
    if not len(curves.time_s):
        raise InputError(f"{clip}: the clip has no frames")
    sound = None if audio is None else _sound(audio, curves)
    if rate is not None:
        from ..retarget.resampling import resample_clip

        resampled = resample_clip(curves, rate)
        curves = resampled.clip
        if resampled.is_changed:
            note(resampled.text())
    _check_rate(out, curves)
    how = Drive(head, points, drive)
    if out.suffix.lower() in CURVES:
        write_curves(out, curves, how, rate)
    else:
        animation = how.animate(curves)
        write_animation(
            out, animation, rate=rate, sound=sound, size=width_height, morphs=morphs
        )  # fmt: skip
    note(f"wrote {out}")


def _check_together(clip: Path, out: Path, audio: Path | None, drive: str | None) -> None:
    """Options that exclude each other, before any work is done."""
    suffix = out.suffix.lower()
    if out.exists() and clip.exists() and out.samefile(clip):
        raise InputError(f"{out} is the clip itself: give --out another name")
    if audio is not None and suffix not in (*VIDEOS, *USD):
        raise InputError(f"{audio}: sound goes into videos and .usd only, and --out is {out}")
    if suffix in (".csv", ".fap") and drive == "points":
        raise InputError(
            f"{out}: curves are not driven; --drive shapes (the head's own) or direct (a fixed "
            "table) say how FAPs and weights are turned into each other"
        )
    if suffix in USD:
        from ..core.formats.usd import check_usd

        check_usd()


def _check_rate(out: Path, curves: Clip) -> None:
    needs_one = out.suffix.lower() in (".csv", ".fap", ".bvh") and len(curves.time_s) > 1
    if needs_one and curves.rate_hz is None:
        raise InputError(
            f"{out.suffix} files have one frame rate, and the clip's times are uneven: resample it "
            "by --fps 60, or another rate"
        )


def _sound(path: Path, curves: Clip) -> FittedSound:
    from ..core.audio import read_audio
    from ..retarget.resampling import fit_sound

    fitted = fit_sound(read_audio(path), float(curves.time_s[0]), float(curves.time_s[-1]))
    for line in fitted.notes:
        note(f"{path.name}: {line}")
    return fitted


def _rate(text: str | None) -> Fraction | None:
    from ..retarget.resampling import parse_rate

    if text is None:
        return None
    try:
        return parse_rate(text)
    except InputError as error:
        raise typer.BadParameter(str(error), param_hint="--fps") from None


def _check_word(word: str | None, known: tuple[str, ...], option: str) -> None:
    if word is not None and word not in known:
        expected = f"expected {', '.join(known[:-1])} or {known[-1]}, got {word}"
        raise typer.BadParameter(expected, param_hint=option)


def _size(text: str) -> tuple[int, int]:
    found = parse_size(text)
    if not all(64 <= n <= 4096 and n % 2 == 0 for n in found):
        raise typer.BadParameter("width and height: even, 64 to 4096", param_hint="--size")
    return found


def read_clip(path: Path) -> Clip:
    """Curves of any clip format we read, by suffix.

    Raises
    ------
    InputError
        If the suffix is of no clip format.
    """
    from ..core.formats.clip_npz import read_clip_npz
    from ..core.formats.fap import read_fap
    from ..core.formats.live_link_csv import read_live_link_csv

    readers = {".fap": read_fap, ".npz": read_clip_npz, ".csv": read_live_link_csv}
    if path.suffix.lower() not in readers:
        raise InputError(
            f"{path}: expected curves in a .fap or .npz file, or in a .csv of Live Link Face"
        )
    return readers[path.suffix.lower()](path)
