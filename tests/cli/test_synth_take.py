"""`facewright synth take` as a user meets it: help, wrong options, interruption, going on."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from facewright.cli.main import app

_SMALL = ("--size", "160x120", "--cameras", "1", "--seed", "3", "--rate", "10")
_HELP_S = 1.0
_WAIT_S = 240.0


def command(*words: str | Path) -> list[str]:
    """A real process's words: signals and the time to start are part of what is tested."""
    code = "from facewright.cli.main import app; app()"
    return [sys.executable, "-c", code, "synth", "take", *map(str, words)]


def test_help_is_there_at_once(repository: Path) -> None:
    took_s = []
    for _ in range(3):  # the best of three: other tests run beside this one
        start_s = time.perf_counter()
        done = subprocess.run(command("--help"), cwd=repository, capture_output=True, text=True)
        took_s.append(time.perf_counter() - start_s)
        assert done.returncode == 0 and "--with" in done.stdout

    assert min(took_s) < _HELP_S


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        ((), 2, "--out"),
        (("--size", "0x0"), 2, "1280x720"),
        (("--size", "161x120"), 1, "161x120"),
        (("--size", "99999x99999"), 1, "99999x99999"),
        (("--size", "²x³"), 2, "--size"),
        (("--size", "big"), 2, "1280x720"),
        (("--seconds", "-1"), 2, "--seconds"),
        (("--seconds", "nan"), 2, "--seconds"),
        (("--rate", "nan"), 1, "rate_hz"),
        (("--cameras", "9"), 2, "--cameras"),
        (("--kind", "film"), 1, "markers, plain, wand"),
        (("--markers", "stars"), 1, "dots, spheres"),
        (("--markers", "dots", "--kind", "plain"), 1, "has no markers"),
        (("--with", "rain"), 1, "rolling"),
        (("--with", "hand,hair"), 1, "choose one"),
        (("--actor", "nobody"), 1, "ruth"),
        (("--seed", "-1"), 2, "--seed"),
        (("--settings", "nothing.toml"), 1, "nothing.toml"),
    ],
)
def test_a_wrong_option_is_said_before_any_file(
    tmp_path: Path, given: tuple[str, ...], code: int, said: str
) -> None:
    out = tmp_path / "take"
    words = [*(("--out", str(out)) if given else ()), *given]

    result = CliRunner().invoke(app, ["synth", "take", *words])

    assert result.exit_code == code, result.output
    assert isinstance(result.exception, SystemExit)  # and no traceback
    assert said in result.stderr
    assert code == 2 or result.stderr.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("contents", "said"),
    [
        ("", "an empty file"),
        ("seconds = nan", "seconds"),
        ("[cameras]\ngamma = inf", "cameras.gamma"),
        ('[cameras]\ncount = "4"', "cameras.count"),
        ("[cameras]\ncount = 99999999999999999999", "cameras.count"),
        ("[cameras]\nimage_size = [640, 480, 3]", "cameras.image_size"),
        ('[markers]\nset = "mine"', "mine"),
        ("version = 9", "version"),
        ("[project]\nname = 'other'", "project"),
        ("\x00\x1f\ufffd", "TOML"),
        ("#" * 2_000_000, "1048576 bytes"),
    ],
)
def test_broken_settings_are_one_line(tmp_path: Path, contents: str, said: str) -> None:
    path, out = tmp_path / "given.toml", tmp_path / "take"
    path.write_text(contents, encoding="utf-8")

    words = ["synth", "take", "--out", str(out), "--settings", str(path)]
    result = CliRunner().invoke(app, words)

    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert said in result.stderr and result.stderr.count("\n") == 1
    assert result.stderr.count("given.toml") <= 1
    assert not out.exists()


def test_a_file_where_a_folder_is_wanted(tmp_path: Path) -> None:
    (tmp_path / "take").write_text("mine")

    result = CliRunner().invoke(app, ["synth", "take", "--out", str(tmp_path / "take")])

    assert result.exit_code == 1
    assert "cannot write there" in result.stderr and result.stderr.count("\n") == 1
    assert (tmp_path / "take").read_text() == "mine"


def test_a_new_take_leaves_nothing_of_an_earlier_one(tmp_path: Path) -> None:
    earlier = ("cam0.mp4", "cam3.mp4", "cam1.mkv", "audio.wav", "markers.toml", "take.toml")
    for name in (*earlier, "notes.txt", "camera.mp4"):
        (tmp_path / name).write_text("earlier")

    words = ["synth", "take", "--out", str(tmp_path), "--seconds", "0.5", "--kind", "wand", *_SMALL]
    result = CliRunner().invoke(app, words)

    assert result.exit_code == 0, result.output
    own = {"cam0.mp4", "take.toml", "rig.json", "truth.npz"}
    assert {p.name for p in tmp_path.iterdir()} == own | {"notes.txt", "camera.mp4"}
    assert (tmp_path / "notes.txt").read_text() == "earlier"
    assert (tmp_path / "cam0.mp4").read_bytes() != b"earlier"


@pytest.mark.slow
def test_an_interrupted_take_goes_on_and_comes_out_the_same(
    repository: Path, tmp_path: Path
) -> None:
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    words = ("--seconds", "16.5", *_SMALL)
    process = subprocess.Popen(
        command("--out", broken, *words), cwd=repository, stderr=subprocess.PIPE, text=True
    )
    end = time.monotonic() + _WAIT_S
    while not list((broken / ".filming").glob("piece_*")) and time.monotonic() < end:
        assert process.poll() is None, "it ended before it could be interrupted"
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=_WAIT_S)[1]

    assert process.returncode == 130, said
    assert "interrupted" in said and "Traceback" not in said
    assert [p.name for p in broken.iterdir()] == [".filming"]  # nothing half-written

    for folder in (broken, whole):
        done = subprocess.run(
            command("--out", folder, *words), cwd=repository, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert ("going on from an interrupted run" in done.stderr) == (folder is broken)

    assert not (broken / ".filming").exists()
    assert sorted(p.name for p in broken.iterdir()) == sorted(p.name for p in whole.iterdir())
    for name in ("cam0.mp4", "take.toml", "rig.json", "markers.toml"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()
    with np.load(broken / "truth.npz") as a, np.load(whole / "truth.npz") as b:
        assert a.files == b.files
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name])
