"""`facewright info` on what `facewright synth` writes, against the values that were written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from facewright.cli.main import app
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.mesh import Mesh
from facewright.datasets_synthetic.film import FilmedTake
from facewright.datasets_synthetic.take_settings import (
    TROUBLES,
    settings_for,
    settings_with,
    write_take_settings,
)


def info_of(tmp_path: Path, path: Path) -> dict[str, Any]:
    report = tmp_path / "info.json"
    result = CliRunner().invoke(app, ["info", str(path), "--json", str(report)])
    assert result.exit_code == 0, result.output
    [found] = json.loads(report.read_text())["files"]
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("trouble", sorted(set(TROUBLES) - {"clutter"}))
def test_a_takes_difficulty_is_named(tmp_path: Path, trouble: str) -> None:
    changed = settings_with(settings_for("markers"), {"seconds": 2.5, **TROUBLES[trouble]})
    write_take_settings(tmp_path / "take.toml", changed, 17)

    found = info_of(tmp_path, tmp_path / "take.toml")

    assert found["contents"] == "synthetic take"
    assert (found["seed"], found["duration_s"], found["difficulties"]) == (17, 2.5, trouble)
    named = {item["setting"] for item in found["settings"]}
    assert named == {"seconds", *TROUBLES[trouble]}


@pytest.mark.parametrize("kind", ["markers", "plain", "wand"])
def test_a_take_by_default_differs_in_nothing(tmp_path: Path, kind: str) -> None:
    write_take_settings(tmp_path / "take.toml", settings_for(kind), 0)

    found = info_of(tmp_path, tmp_path / "take.toml")

    assert (found["kind"], found["difficulties"], found["settings"]) == (kind, "none", [])


def test_every_file_of_a_take_is_described(tmp_path: Path, filmed_take: FilmedTake) -> None:
    contents = {
        path.name: info_of(tmp_path, path)["contents"]
        for path in filmed_take.folder.iterdir()
        if path.name != "done"
    }

    assert contents["take.toml"] == "synthetic take"
    assert contents["truth.npz"] == "truth of a synthetic take"
    assert contents["markers.toml"] == "marker set"
    assert contents["cam0.mp4"] == "video"


def test_a_mesh_is_measured(tmp_path: Path) -> None:
    vertices = np.array([[0.0, 0, 0], [200, 0, 0], [0, 300, 0], [0, 0, 250]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], np.int32)
    colour = np.full((4, 3), 90, np.uint8)
    write_ply(tmp_path / "scan.ply", PlyMesh(Mesh(vertices, triangles), colour))

    found = info_of(tmp_path, tmp_path / "scan.ply")

    assert (found["n_vertices"], found["n_triangles"], found["colours"]) == (4, 3, True)
    assert (found["size_x_mm"], found["size_y_mm"], found["size_z_mm"]) == (200, 300, 250)


@pytest.mark.parametrize(
    ("name", "mode", "bits"), [("a.jpg", "RGB", 8), ("a.png", "L", 8), ("r.png", "I;16", 16)]
)
def test_a_pictures_size_is_width_then_height(
    tmp_path: Path, name: str, mode: str, bits: int
) -> None:
    Image.new(mode, (40, 30)).save(tmp_path / name)

    found = info_of(tmp_path, tmp_path / name)

    assert (found["width_px"], found["height_px"], found["bits"]) == (40, 30, bits)


def test_a_tables_columns_and_rows(tmp_path: Path) -> None:
    (tmp_path / "photo0.csv").write_text('X,Y,Z,u,v\n1,2,3,4,5\n"6,5",7,8,9,10\n')

    found = info_of(tmp_path, tmp_path / "photo0.csv")

    assert (found["n_rows"], found["columns"]) == (2, "X, Y, Z, u, v")


def test_voices_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "voice.toml"
    path.write_text(
        'version = 1\n[[voice]]\nname = "a"\nrate_hz = 16000\n'
        '[[voice]]\nname = "b"\nrate_hz = 8000\nroom = true\n'
    )

    found = info_of(tmp_path, path)

    assert (found["contents"], found["n_voices"]) == ("synthetic voices", 2)
    assert found["voices"][0] == {"name": "a", "rate_hz": 16000, "room": None}
    assert found["voices"][1] == {"name": "b", "rate_hz": 8000, "room": True}


@pytest.mark.parametrize("name", ["a.ply", "a.png", "a.jpg", "a.csv", "take.toml"])
@pytest.mark.parametrize(
    "contents",
    [b"", b"\x93\x00junk\xff\xfe" * 50, b"\x89PNG\r\n\x1a\nxx", b"\xff\xd8\xffxx", b"ply\nxx\n"],
    ids=["empty", "junk", "broken PNG", "broken JPEG", "broken PLY"],
)
def test_what_is_broken_is_one_line(tmp_path: Path, name: str, contents: bytes) -> None:
    (tmp_path / name).write_bytes(contents)

    result = CliRunner().invoke(app, ["info", str(tmp_path / name)])

    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert str(tmp_path / name) in result.stderr and result.stderr.count("\n") == 1


def test_a_takes_broken_setting_is_named(tmp_path: Path) -> None:
    (tmp_path / "take.toml").write_text("seconds = 2.0\n[cameras]\ncount = 99\n")

    result = CliRunner().invoke(app, ["info", str(tmp_path / "take.toml")])

    assert result.exit_code == 1
    assert "cameras.count" in result.stderr and "take.toml" in result.stderr
