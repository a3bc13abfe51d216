"""`facewright synth photos`: photographs of a head whose cameras are known exactly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import note, parse_size, writable_folder
from .progress import Ticks

if TYPE_CHECKING:
    from ..heads.head import Head

PersonOption = Annotated[
    str | None,
    typer.Option(
        "--head", metavar="HEAD", help="A built-in head: see synth head --list. Default: drawn."
    ),
]


def photos(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same photos.")] = 0,
    head: PersonOption = None,
    count: Annotated[int, typer.Option(min=3, max=5, help="Photographs.")] = 4,
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Size in pixels, up to 3040x2008.")
    ] = "1520x1004",
    mark_noise: Annotated[
        float,
        typer.Option(min=0, max=50, metavar="PX", help="Standard deviation of marked points."),
    ] = 1.5,
    points: Annotated[int, typer.Option(min=12, max=20, help="To mark on each photo.")] = 15,
    uniform: Annotated[
        bool, typer.Option("--uniform", help="Even light and neutral exposure.")
    ] = False,
    turned: Annotated[
        bool, typer.Option("--turned", help="The last photo upright, by its EXIF orientation.")
    ] = False,
) -> None:
    """Photographs of one head: photo*.jpg, head.ply, points/, photos.toml, and truth/."""
    from ..datasets_synthetic.photo_files import write_photos
    from ..datasets_synthetic.photos import PhotoSettings, plan_photos

    settings = PhotoSettings(
        count=count,
        size=parse_size(size),
        mark_noise_px=mark_noise,
        points=points,
        uniform=uniform,
        turned=turned,
    )
    session = plan_photos(person(head, seed), settings, seed)
    folder = writable_folder(out)
    with Ticks(count, "photographing") as tick:
        write_photos(folder, session, on_photo=tick)
    note(f"wrote {folder}/ photo*.jpg head.ply points/ photos.toml truth.npz truth/")


def person(name: str | None, seed: int) -> Head:
    """A built-in head, or one drawn by the seed."""
    import numpy as np

    from ..heads.catalogue import built_in_head
    from ..heads.identity import make_head, random_identity

    if name is not None:
        return built_in_head(name)
    return make_head(random_identity(np.random.default_rng([seed, 70]), f"person{seed}"))
