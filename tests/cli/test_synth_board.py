from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from facewright.cli.synth_board import board
from facewright.core.errors import InputError


@pytest.fixture
def app() -> typer.Typer:
    made = typer.Typer()
    made.command()(board)
    return made


def test_pictures_of_every_camera_are_written(app: typer.Typer, tmp_path: Path) -> None:
    out = tmp_path / "shots"
    arguments = ["--out", str(out), "--board", "circles:5x4:18", "--cameras", "2", "--views", "2"]

    result = CliRunner().invoke(app, [*arguments, "--ideal", "--seed", "3"])

    assert result.exit_code == 0, result.output
    assert len(list(out.glob("cam*/view_*.png"))) == 4
    with np.load(out / "truth.npz") as truth:
        assert truth["pixels"].shape == (2, 2, 20, 2)
        assert truth["centroids"].shape == (2, 2, 20, 2)


def test_board_that_is_none_leaves_no_folder(app: typer.Typer, tmp_path: Path) -> None:
    out = tmp_path / "shots"

    result = CliRunner().invoke(app, ["--out", str(out), "--board", "chess:9x6"])

    assert isinstance(result.exception, InputError)
    assert "chessboard:9x6:25" in str(result.exception)
    assert not out.exists()
