"""`facewright synth head`: people, built-in or drawn by chance, with all that is known of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError
from .options import find_marker_set, note, writable_folder
from .tables import print_table

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..heads.head import Head

_PORTRAIT_PX = (960, 1080)


def head(
    name: Annotated[
        str | None, typer.Option("--head", metavar="HEAD", help="A built-in head. Default: ruth.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder to write to.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="A random person instead; the same seed is the same person."),
    ] = None,
    age: Annotated[
        str | None,
        typer.Option(metavar="YEARS", help="Of a random person: 30, or 6-85. Default: 20-70."),
    ] = None,
    sex: Annotated[
        str | None, typer.Option(help="Of a random person: any (default), female or male.")
    ] = None,
    count: Annotated[
        int, typer.Option(min=1, max=100_000, help="That many random people, in folders.")
    ] = 1,
    markers: Annotated[
        str | None,
        typer.Option(
            metavar="SET.toml",
            help="Also markers.png, where to glue them, and markers.toml: a file or a ready set.",
        ),
    ] = None,
    list_heads: Annotated[bool, typer.Option("--list", help="List the built-in heads.")] = False,
) -> None:
    """A head: head.glb, portrait, chart, textures, points.csv and bones.

    points.csv holds the 84 MPEG-4 feature points and Farkas's landmarks, mm, head frame.
    """
    if list_heads:
        _list()
        return
    if out is None:
        raise typer.BadParameter("say where to with --out DIR, or use --list", param_hint="--out")
    if name is not None and seed is not None:
        raise typer.BadParameter("a built-in head has no seed", param_hint="--seed")
    marker_set = None if markers is None else find_marker_set(markers, out)
    if seed is None:
        from ..heads.catalogue import built_in_head

        if count != 1:
            raise typer.BadParameter("many people need a --seed", param_hint="--count")
        for option, given in (("--age", age), ("--sex", sex)):
            if given is not None:
                raise typer.BadParameter("a random person needs a --seed", param_hint=option)
        made = built_in_head(name or "ruth")
        _write(writable_folder(out), made)
        _write_marker_chart(out, made, marker_set)
        note(f"wrote {out}/ head.glb portrait.png chart.png points.csv bones.glb and textures")
        return
    from .progress import progress

    years, female = _years(age or "20-70"), _female(sex or "any")
    writable_folder(out)
    for number in progress(range(seed, seed + count), count, "heads"):
        folder = out if count == 1 else writable_folder(out / f"person-{number}")
        made = _someone(number, years, female)
        _write(folder, made)
        _write_marker_chart(folder, made, marker_set)
    note(f"wrote {out}/ with {count} {'person' if count == 1 else 'people'}")


def _list() -> None:
    from ..heads.catalogue import BUILT_IN, built_in_identity
    from ..heads.identity import make_head

    rows = []
    for known in BUILT_IN:
        units = make_head(built_in_identity(known), texture_px=256).fapu.as_dict()
        rows.append((known, *(round(v, 1) for v in units.values())))
    print_table(("head", "IRISD mm", "ES mm", "ENS mm", "MNS mm", "MW mm"), rows)


def _someone(seed: int, years: tuple[float, float], female: bool | None) -> Head:
    import numpy as np

    from ..heads.identity import make_head, random_identity

    rng = np.random.default_rng([seed, 1])
    return make_head(random_identity(rng, f"person-{seed}", age_years=years, female=female))


def _years(text: str) -> tuple[float, float]:
    from ..heads.identity import OLDEST_YEARS, YOUNGEST_YEARS

    low, _, high = text.partition("-")
    try:
        found = float(low), float(high or low)
    except ValueError:
        found = (1.0, 0.0)
    if not YOUNGEST_YEARS <= found[0] <= found[1] <= OLDEST_YEARS:
        raise InputError(
            f"--age {text}: expected years, 30 or 20-70, within {YOUNGEST_YEARS:g}-{OLDEST_YEARS:g}"
        )
    return found


def _female(text: str) -> bool | None:
    known = {"any": None, "female": True, "male": False}
    if text not in known:
        raise InputError(f"--sex {text}: expected any, female or male")
    return known[text]


def _write_marker_chart(folder: Path, made: Head, marker_set: MarkerSet | None) -> None:
    from ..core.formats.markers_toml import write_marker_set
    from ..heads.chart import marker_chart
    from .pictures import write_png

    if marker_set is None:
        return
    write_marker_set(folder / "markers.toml", marker_set)
    write_png(folder / "markers.png", marker_chart(made, marker_set))
    note(f"wrote {folder}/markers.png and markers.toml of {marker_set.name}")


def _write(folder: Path, made: Head) -> None:
    from ..core.clip import Clip
    from ..core.formats.gltf import write_glb
    from ..heads.chart import feature_point_chart
    from ..heads.render import HeadRenderer, portrait_camera
    from ..retarget.drive import HeadDrive
    from ..retarget.export import animation_glb, bones_glb
    from .pictures import write_png

    still = HeadDrive(made).animate(Clip([0.0], ("open_jaw",), [[0.0]]))  # type: ignore[arg-type]
    write_glb(folder / "head.glb", animation_glb(made, still, name=made.name))
    write_glb(folder / "bones.glb", bones_glb(made))
    portrait = HeadRenderer(made).render(made.mesh.vertices, portrait_camera(made, _PORTRAIT_PX))
    write_png(folder / "portrait.png", portrait)
    write_png(folder / "chart.png", feature_point_chart(made))
    _write_points(folder / "points.csv", made)
    looks = made.appearance
    for name in ("skin", "normal", "roughness", "eye"):
        picture = getattr(looks, name)
        if picture is not None:
            write_png(folder / f"{name}.png", picture)


def _write_points(path: Path, made: Head) -> None:
    from ..core.files import atomic_write

    marks = made.mesh.landmarks
    rows = [("feature point", name, p) for name, p in made.points.items()]
    if marks is not None:
        rows += [
            ("landmark", name, p)
            for name, p in zip(marks.names, marks.at(made.mesh.vertices), strict=True)
        ]
    with atomic_write(path) as stream:
        stream.write("kind,name,x_mm,y_mm,z_mm\n")
        for kind, name, p in rows:
            stream.write(f"{kind},{name},{p[0]:.4f},{p[1]:.4f},{p[2]:.4f}\n")
