"""`facewright synth`: captures and heads whose truth is known exactly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import note, writable_folder
from .progress import Ticks
from .tables import print_table

if TYPE_CHECKING:
    from ..datasets_synthetic.film import FilmedTake

SecondsOption = Annotated[float, typer.Option(min=0.5, max=600.0, help="Length of the take.")]
SeedOption = Annotated[int, typer.Option(min=0, help="The same seed makes the same take.")]


def take(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    seconds: SecondsOption = 4.0,
    seed: SeedOption = 0,
) -> None:
    """An actor with 30 dots before four cameras: videos, rig.json, markers.toml, truth.npz."""
    run_take(writable_folder(out), seconds, seed)
    note(f"wrote {out}/ rig.json markers.toml truth.npz cam*.mp4")


def run_take(folder: Path, seconds: float, seed: int) -> FilmedTake:
    """Film a take, with a progress bar."""
    from ..datasets_synthetic.film import film_take
    from ..datasets_synthetic.takes import make_take

    made = make_take(seed, seconds=seconds)
    with Ticks(len(made.time_s), "filming") as tick:
        return film_take(made, folder, on_frame=tick)


def head(
    name: Annotated[str, typer.Option("--head", help="A built-in head.")] = "ruth",
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder to write to.")
    ] = None,
    list_heads: Annotated[bool, typer.Option("--list", help="List the built-in heads.")] = False,
) -> None:
    """A built-in head: head.glb, a portrait, and a chart of its feature points."""
    from ..heads.catalogue import BUILT_IN, built_in_head

    if list_heads:
        rows = []
        for known in BUILT_IN:
            units = built_in_head(known).fapu.as_dict()
            rows.append((known, *(round(v, 1) for v in units.values())))
        print_table(("head", "IRISD mm", "ES mm", "ENS mm", "MNS mm", "MW mm"), rows)
        return
    if out is None:
        raise typer.BadParameter("say where to with --out DIR, or use --list", param_hint="--out")
    from ..core.clip import Clip
    from ..core.formats.gltf import write_glb
    from ..heads.chart import feature_point_chart
    from ..heads.render import HeadRenderer, portrait_camera
    from ..retarget.drive import HeadDrive
    from ..retarget.export import animation_glb
    from .pictures import write_png

    made = built_in_head(name)
    folder = writable_folder(out)
    still = HeadDrive(made).animate(Clip([0.0], ("open_jaw",), [[0.0]]))  # type: ignore[arg-type]
    write_glb(folder / "head.glb", animation_glb(made, still, name=name))
    size = (960, 1080)
    portrait = HeadRenderer(made).render(made.mesh.vertices, portrait_camera(made, size))
    write_png(folder / "portrait.png", portrait)
    write_png(folder / "chart.png", feature_point_chart(made))
    note(f"wrote {folder}/ head.glb portrait.png chart.png")
