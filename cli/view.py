"""`facewright view`: one self-contained page of any clips, heads, videos and trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import InputError
from .options import HeadOption, note, writable_file

_VIDEOS = (".mp4", ".m4v", ".webm", ".mov")


def view(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help=".glb, .fap, .npz, .mp4 or .webm files.")
    ],
    head: HeadOption = "ruth",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="page.html", help="Default: the first file's name, .html."),
    ] = None,
) -> None:
    """Write a page that plays heads and videos with their curves on one time line.

    Curves without a model are shown on a built-in head.
    """
    from ..core.formats.gltf import glb_bytes
    from .page import PageModel, PageVideo, write_page
    from .retarget import read_clip

    out = writable_file(out or files[0].with_suffix(".html"), (".html", ".htm"))
    models, videos, curves = [], [], None
    for path in files:
        suffix = path.suffix.lower()
        if suffix == ".glb":
            models.append(PageModel(path.stem, path.read_bytes()))
        elif suffix in _VIDEOS:
            videos.append(PageVideo(path.stem, path.read_bytes()))
        elif suffix in (".fap", ".npz"):
            if curves is not None:
                raise InputError(f"{path}: a page shows the curves of one file, and has some")
            curves = read_clip(path)
        else:
            raise InputError(f"{path}: expected .glb, .fap, .npz, .mp4 or .webm")
    if curves is not None and not models:
        from ..heads.catalogue import built_in_head
        from ..retarget.drive import HeadDrive
        from ..retarget.export import animation_glb

        target = built_in_head(head)
        scene = animation_glb(target, HeadDrive(target).animate(curves), name=head)
        models.append(PageModel(head, glb_bytes(scene)))
    title = ", ".join(path.name for path in files)
    write_page(out, title=title, models=models, videos=videos, curves=curves)
    note(f"wrote {out}")
