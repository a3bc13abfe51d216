"""`facewright head`: a mesh becomes a head that loads again, with points to correct."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from facewright.cli.heads import find_head
from facewright.cli.main import app
from facewright.core.formats.head_points import read_head_points, write_head_points
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.mesh import Mesh
from facewright.datasets_synthetic.foreign_heads import ForeignHead, foreign_head
from facewright.heads.head import Head

CLICKS = ("3.7", "3.8", "9.3", "8.3", "8.4")


@pytest.fixture(scope="module")
def hero(people: tuple[Head, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person in decimetres, z up, with five clicks beside."""
    foreign = foreign_head(
        people[8], np.random.default_rng(12), skin_vertices=4000, unit_mm=100.0, turn="z up"
    )
    folder = tmp_path_factory.mktemp("hero")
    write(folder, foreign)
    return folder


def write(folder: Path, foreign: ForeignHead) -> None:
    path = folder / "hero.ply"
    write_ply(path, PlyMesh(Mesh(foreign.vertices, foreign.triangles)), double=True)
    clicks = {n: foreign.points[n] for n in CLICKS}
    write_head_points(folder / "clicks.csv", [("feature point", clicks)])


def run(*words: str) -> str:
    done = CliRunner().invoke(app, ["head", *words])
    assert done.exit_code == 0, done.output
    return done.output


def corrected(table: Path, name: str, moved: tuple[float, float, float]) -> None:
    """Write a point's other place as a person would."""
    rows = list(csv.reader(table.read_text().splitlines()))
    for row in rows:
        if row[1] == name:
            row[2:] = [f"{x:.4f}" for x in moved]
    table.write_text("\n".join(",".join(row) for row in rows) + "\n")


def test_a_mesh_becomes_a_head_that_loads_again(hero: Path, people: tuple[Head, ...]) -> None:
    out = hero / "out"
    said = run(
        str(hero / "hero.ply"), "--points", str(hero / "clicks.csv"), "--out", str(out),
        "--json", str(hero / "hero.json"),
    )  # fmt: skip

    results = json.loads((hero / "hero.json").read_text())
    assert "decimetres" in said
    assert "+Z is up" in said
    assert results["unit_mm"] == 100.0
    assert results["points_by"] == "given"
    assert results["lips_part"]
    assert sorted(p.name for p in out.iterdir()) == [
        "head.chart.png", "head.glb", "head.points.csv"
    ]  # fmt: skip
    found, table = find_head(str(out / "head.glb")), read_head_points(out / "head.points.csv")
    assert set(table) >= set(found.points)
    off = [np.linalg.norm(p - table[n]) for n, p in found.points.items()]
    assert max(off) < 1e-3
    # the same face as that of the person in disguise, though turned by how it was held
    for a, b in (("3.7", "8.4"), ("9.3", "2.1"), ("10.1", "11.4"), ("4.3", "5.2")):
        truth = np.linalg.norm(people[8].points[a] - people[8].points[b])
        assert abs(np.linalg.norm(found.points[a] - found.points[b]) - truth) < 3.0, (a, b)


def test_corrected_points_are_used_and_never_lost(hero: Path) -> None:
    out = hero / "corrected"
    run(str(hero / "hero.ply"), "--points", str(hero / "clicks.csv"), "--out", str(out))
    head = find_head(str(out / "head.glb"))
    skin = head.mesh.vertices[head.mesh.triangles[head.mesh.groups["skin"]]].mean(axis=1)
    near = skin[np.argmin(np.linalg.norm(skin - head.points["9.3"] - (0, 4, 0), axis=1))]
    corrected(out / "head.points.csv", "9.3", (near[0], near[1], near[2]))

    moved = find_head(str(out / "head.glb"))
    run(str(out / "head.glb"), "--out", str(out))
    kept = find_head(str(out / "head.glb"))
    (out / "head.points.csv").unlink()
    in_file = find_head(str(out / "head.glb"))
    corrected_text = (out / "head.points.csv").exists()

    for found in (moved, kept, in_file):
        np.testing.assert_allclose(found.points["9.3"], near, atol=0.01)
    assert not corrected_text  # finding a head writes nothing

    write_head_points(out / "head.points.csv", [("feature point", {"9.3": near})])
    mine = (out / "head.points.csv").read_bytes()
    run(str(hero / "hero.ply"), "--points", str(hero / "clicks.csv"), "--out", str(out))
    assert (out / "head.points.old.csv").read_bytes() == mine


def test_built_in_and_missing_heads_are_said() -> None:
    for name, said in (("ruth", "built-in head"), ("none.obj", "no such file")):
        done = CliRunner().invoke(app, ["head", name])
        assert done.exit_code == 1
        assert said in done.output
