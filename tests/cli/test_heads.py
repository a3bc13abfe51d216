"""HEAD of the commands: built-in names, files, points beside them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from facewright.cli.heads import check_head, find_head
from facewright.core.errors import InputError
from facewright.core.formats.head_points import read_head_points, write_head_points
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.mesh import Mesh
from facewright.datasets_synthetic.foreign_heads import foreign_head
from facewright.heads.head import Head

CLICKS = ("3.7", "3.8", "9.3", "8.3", "8.4")


def test_wrong_names_are_said_before_the_work(tmp_path: Path) -> None:
    check_head("ruth")
    for wrong, said in (
        ("nobody", "no built-in head nobody"),
        ("head.fbx", "or give a file"),
        (str(tmp_path / "none.obj"), "no such file"),
    ):
        with pytest.raises(InputError, match=said):
            check_head(wrong)
    with pytest.raises(InputError, match="has its points already"):
        find_head("ruth", tmp_path / "points.csv")


def test_a_file_with_clicks_gets_all_its_points_beside_it_and_keeps_corrections(
    tmp_path: Path, people: tuple[Head, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = foreign_head(people[5], np.random.default_rng(4), skin_vertices=4000, unit_mm=100.0)
    path, clicks = tmp_path / "hero.ply", tmp_path / "clicks.csv"
    write_ply(path, PlyMesh(Mesh(foreign.vertices, foreign.triangles)), double=True)
    write_head_points(clicks, [("feature point", {n: foreign.points[n] for n in CLICKS})])

    first = find_head(str(path), clicks)
    found = (
        read_head_points(tmp_path / "hero.points.csv")
        if (tmp_path / "hero.points.csv").is_file()
        else {}
    )

    assert "decimetres" in capsys.readouterr().err
    assert (tmp_path / "hero.chart.png").is_file()
    assert set(first.points) <= set(found)
    off = [np.linalg.norm(found[n] - 100.0 * foreign.points[n]) for n in first.points]
    assert np.mean(off) < 2.0

    # corrected by hand: the tip of the nose 4 mm up
    moved = found["9.3"] + 4.0 * foreign.turn @ (0.0, 1.0, 0.0)
    rows = list(csv.reader((tmp_path / "hero.points.csv").read_text().splitlines()))
    for row in rows:
        if row[1] == "9.3":
            row[2:] = [f"{x:.4f}" for x in moved]
    (tmp_path / "hero.points.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    before = (tmp_path / "hero.points.csv").read_bytes()

    again = find_head(str(path))

    assert "using feature points" in capsys.readouterr().err
    assert (tmp_path / "hero.points.csv").read_bytes() == before
    nearer = (
        again.points["9.3"] - again.points["9.15"] - (first.points["9.3"] - first.points["9.15"])
    )
    assert 2.0 < nearer[1] < 5.0  # along the surface of the nose
