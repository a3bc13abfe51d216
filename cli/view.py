"""`facewright view`: one self-contained page of any clips, heads, videos, markers and a sound."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import InputError
from .options import note, writable_file

_MIB = 2**20
#: A page larger than this opens slowly, and fails on small machines.
_LARGE_BYTES = 150 * _MIB


def view(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE",
            help=".glb, .fap, .npz, ARKit .csv, .c3d, .mp4, .webm or .wav files. Several clips or "
            "heads are compared side by side.",
        ),
    ] = None,
    head: Annotated[
        list[str] | None,
        typer.Option(
            "--head",
            metavar="HEAD",
            help="A built-in head or a file, to show clips on; may be given for each clip. "
            "Default: ruth, where no .glb is given.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="page.html", help="Default: the first file's name, .html."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Move a head by sliders in the browser instead.")
    ] = False,
    port: Annotated[
        int, typer.Option("--port", min=1, max=65535, help="Where --live is served.")
    ] = 8080,
) -> None:
    """Write a page that plays heads, videos and sound with their curves on one time line.

    Clips without a .glb are shown on a built-in head. Press ? on the page for its keys.
    """
    if live:
        if files or out is not None:
            raise typer.BadParameter("--live takes no files and no --out")
        if head is not None and len(head) > 1:
            raise typer.BadParameter("--live shows one --head")
        from .live import show_live

        show_live(head[0] if head else None, port)
        return
    if not files:
        raise typer.BadParameter("name a FILE to show, or give --live")
    _write(files, head, out)


def _write(files: list[Path], heads: list[str] | None, out: Path | None) -> None:
    from .heads import check_head
    from .page import write_page
    from .view_files import Shown

    out = writable_file(out or files[0].with_suffix(".html"), (".html", ".htm"))
    if out in files:
        raise InputError(f"{out}: give --out another name, or the file itself would be overwritten")
    for name in heads or ():
        check_head(name)
    shown = Shown()
    for path in files:
        shown.add(path)
    shown.add_heads(heads)
    write_page(
        out,
        title=", ".join(path.name for path in files),
        models=shown.models,
        videos=shown.videos,
        curves=shown.clips or None,
        sound=shown.sound,
    )
    size = out.stat().st_size
    note(f"wrote {out}, {size / _MIB:.1f} MiB")
    if size > _LARGE_BYTES:
        note("a page of this size opens slowly: cut the take or make its videos smaller")
