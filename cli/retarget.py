"""`facewright retarget`: curves to a moving head."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError
from .options import HeadOption, note, parse_size, writable_file
from .progress import Ticks

if TYPE_CHECKING:
    from ..core.clip import Clip

_VIDEO_RATE_HZ = 30.0


def retarget(
    clip: Annotated[Path, typer.Argument(metavar="CLIP", help="FAPs: a .fap or .npz file.")],
    head: HeadOption = "ruth",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="animation.glb or .mp4. Default: the clip's name, .glb."
        ),
    ] = None,
    audio: Annotated[
        Path | None, typer.Option("--audio", metavar="FILE", help="Sound for an .mp4.")
    ] = None,
    size: Annotated[str, typer.Option(help="Picture size of an .mp4.")] = "720x720",
) -> None:
    """Drive a head by FAPs: an animated .glb, or a video of it."""
    from ..heads.catalogue import built_in_head, built_in_identity

    out = writable_file(out or clip.with_suffix(".glb"), (".glb", ".mp4"))
    if audio is not None and out.suffix.lower() != ".mp4":
        raise InputError(f"{audio}: sound goes into an .mp4 only, and --out is {out}")
    width_height = _size(size)
    built_in_identity(head)
    curves = read_clip(clip)
    from ..retarget.drive import HeadDrive

    target = built_in_head(head)
    animation = HeadDrive(target).animate(curves)
    if out.suffix.lower() == ".glb":
        from ..core.formats.gltf import write_glb
        from ..retarget.export import animation_glb

        write_glb(out, animation_glb(target, animation, name=out.stem))
    else:
        from ..core.audio import read_audio
        from ..retarget.video import write_head_video

        sound = read_audio(audio) if audio is not None else None
        seconds = float(animation.time_s[-1] - animation.time_s[0])
        with Ticks(int(seconds * _VIDEO_RATE_HZ) + 1, "drawing") as tick:
            write_head_video(
                out, target, animation, size=width_height, rate_hz=_VIDEO_RATE_HZ, audio=sound,
                on_frame=tick,
            )  # fmt: skip
    note(f"wrote {out}")


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

    readers = {".fap": read_fap, ".npz": read_clip_npz}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: expected curves in a .fap or .npz file")
    return readers[path.suffix.lower()](path)
