from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from facewright.cli.options import parse_size
from facewright.cli.synth_photos import photos
from facewright.cli.synth_scan import scan
from facewright.core.formats.ply import read_ply


@pytest.fixture()
def app() -> typer.Typer:
    made = typer.Typer()
    made.command("photos")(photos)
    made.command("scan")(scan)
    return made


def test_photos_of_a_drawn_person_are_the_same_for_the_same_seed(
    app: typer.Typer, tmp_path: Path
) -> None:
    found = []
    for name in ("a", "b"):
        given = ["photos", "--out", str(tmp_path / name), "--seed", "3", "--count", "3"]
        result = CliRunner().invoke(app, [*given, "--size", "300x240", "--uniform"])
        assert result.exit_code == 0, result.output
        files = sorted(p for p in (tmp_path / name).rglob("*") if p.is_file())
        found.append([hashlib.sha256(p.read_bytes()).hexdigest() for p in files])

    assert found[0] == found[1] and len(found[0]) == 15
    said = tomllib.loads((tmp_path / "a" / "photos.toml").read_text())
    assert said["uniform"] is True and said["seed"] == 3 and len(said["photo"]) == 3


@pytest.mark.parametrize("kind", ["cylinder", "mesh"])
def test_scans_are_written(app: typer.Typer, tmp_path: Path, kind: str) -> None:
    given = ["scan", "--out", str(tmp_path), "--head", "maya", "--kind", kind]
    more = ["--triangles", "4000", "--patches"] if kind == "mesh" else []

    result = CliRunner().invoke(app, [*given, *more])

    assert result.exit_code == 0, result.output
    assert tomllib.loads((tmp_path / "scan.toml").read_text())["kind"] == kind
    if kind == "mesh":
        assert len(read_ply(tmp_path / "scan.ply").mesh.triangles) <= 4000
    else:
        with np.load(tmp_path / "scan.npz") as z:
            assert z["range_mm"].shape == (512, 512)


@pytest.mark.parametrize(
    "given",
    [
        ["photos", "--size", "big"],
        ["photos", "--count", "6"],
        ["photos", "--points", "3"],
        ["scan", "--patches"],
        ["scan", "--kind", "sphere"],
        ["scan", "--triangles", "1"],
    ],
)
def test_wrong_usage_is_said_before_any_file(
    app: typer.Typer, tmp_path: Path, given: list[str]
) -> None:
    result = CliRunner().invoke(app, [*given, "--out", str(tmp_path / "out")])

    assert result.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_sizes_are_read() -> None:
    assert parse_size("3040x2008") == (3040, 2008)
    with pytest.raises(typer.BadParameter):
        parse_size("3040")
