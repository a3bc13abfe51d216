"""HEAD of the commands: built-in names, files, points beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.cli.heads import check_head, find_head
from facewright.core.errors import InputError
from facewright.core.formats.head_points import write_head_points
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


def test_a_file_with_clicks_becomes_a_head_and_nothing_is_written(
    tmp_path: Path, people: tuple[Head, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = foreign_head(people[5], np.random.default_rng(4), skin_vertices=4000, unit_mm=100.0)
    path, clicks = tmp_path / "hero.ply", tmp_path / "clicks.csv"
    write_ply(path, PlyMesh(Mesh(foreign.vertices, foreign.triangles)), double=True)
    write_head_points(clicks, [("feature point", {n: foreign.points[n] for n in CLICKS})])

    first = find_head(str(path), clicks)

    said = capsys.readouterr().err
    assert "decimetres" in said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clicks.csv", "hero.ply"]
    apart = np.linalg.norm(first.points["9.3"] - first.points["2.1"])
    truth = np.linalg.norm(people[5].points["9.3"] - people[5].points["2.1"])
    assert abs(apart - truth) < 2.0

    # the same points beside the head, the tip of the nose 4 mm up: they are used unasked
    moved = {n: foreign.points[n] for n in CLICKS}
    moved["9.3"] = moved["9.3"] + 0.04 * foreign.turn @ (0.0, 1.0, 0.0)
    write_head_points(tmp_path / "hero.points.csv", [("feature point", moved)])

    again = find_head(str(path))

    assert "using feature points" in capsys.readouterr().err
    higher = (
        again.points["9.3"] - again.points["9.15"] - (first.points["9.3"] - first.points["9.15"])
    )
    assert 2.0 < higher[1] < 5.0  # along the surface of the nose
