"""`facewright synth scan`: scans of a head whose surface is known exactly."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .options import note, writable_folder
from .synth_photos import PersonOption, person


class ScanKind(StrEnum):
    """What the scanner gives."""

    cylinder = "cylinder"
    mesh = "mesh"


def scan(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same scan.")] = 0,
    head: PersonOption = None,
    kind: Annotated[
        ScanKind, typer.Option(help="Range and colour over a cylinder, or a mesh with holes.")
    ] = ScanKind.cylinder,
    triangles: Annotated[
        int, typer.Option(min=2_000, max=300_000, help="Of the mesh, at most.")
    ] = 120_000,
    patches: Annotated[
        bool, typer.Option("--patches", help="Leave the mesh in overlapping patches.")
    ] = False,
) -> None:
    """A scan of one head: range.png, colour.png, scan.npz or scan.ply; truth.*, scan.toml."""
    from ..datasets_synthetic.scan_files import write_cylinder_scan, write_mesh_scan
    from ..datasets_synthetic.scan_meshes import scan_mesh
    from ..datasets_synthetic.scan_target import ScanTarget
    from ..datasets_synthetic.scans import scan_cylinder

    if patches and kind is not ScanKind.mesh:
        raise typer.BadParameter("goes with --kind mesh only", param_hint="--patches")
    target = ScanTarget(person(head, seed), seed)
    folder = writable_folder(out)
    if kind is ScanKind.cylinder:
        write_cylinder_scan(folder, target, scan_cylinder(target, seed), seed)
        note(f"wrote {folder}/ range.png colour.png scan.npz truth.ply truth.npz scan.toml")
        return
    made = scan_mesh(target, seed, triangles=triangles, patches=patches)
    write_mesh_scan(folder, target, made, seed)
    note(f"wrote {folder}/ scan.ply truth.ply truth.npz scan.toml")
