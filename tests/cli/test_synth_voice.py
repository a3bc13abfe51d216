"""`facewright synth voice`."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from facewright.cli.main import build_app
from facewright.cli.synth_voice import voice
from facewright.core.audio import read_audio
from facewright.datasets_synthetic.espeak import has_espeak

APP = build_app({"synth voice": voice})


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(APP, ["synth", "voice", *arguments])
    return done.exit_code, done.output


def test_voices_are_written_as_asked(tmp_path: Path) -> None:
    code, output = run(
        "--out", str(tmp_path / "v"), "--count", "2", "--talker", "woman", "--seconds", "2",
        "--noise-db", "15", "--room", "--rate", "8000",
    )  # fmt: skip

    assert code == 0, output
    told = tomllib.loads((tmp_path / "v" / "voice.toml").read_text(encoding="utf-8"))["voice"]
    assert [t["group"] for t in told] == ["woman", "woman"]
    assert all(t["noise_db"] == 15 and "room_rt60_s" in t for t in told)
    for t in told:
        sound = read_audio(tmp_path / "v" / f"{t['name']}.wav")
        assert (sound.rate_hz, sound.duration_s) == (8000, 2.0)
    sounds = [(tmp_path / "v" / f"{t['name']}.wav").read_bytes() for t in told]
    assert sounds[0] != sounds[1]


def test_the_same_seed_writes_the_same_folder(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert run("--out", str(tmp_path / name), "--seed", "4", "--kind", "hvd")[0] == 0

    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_a_text_is_said_by_the_tube(tmp_path: Path) -> None:
    code, output = run("--out", str(tmp_path), "--synth", "tube", "--text", "go")

    assert code == 0, output
    with np.load(tmp_path / "voice0000.npz", allow_pickle=False) as z:
        assert z["phones"].tolist() == ["SIL", "G", "OW", "SIL"]
        assert z["areas_mm2"].shape[0] == len(z["time_s"])


@pytest.mark.skipif(not has_espeak(), reason="eSpeak NG is not installed")
def test_any_english_is_said_by_espeak(tmp_path: Path) -> None:
    code, output = run("--out", str(tmp_path), "--synth", "espeak", "--text", "A xylophone!")

    assert code == 0, output
    with np.load(tmp_path / "voice0000.npz", allow_pickle=False) as z:
        assert "Z" in z["phones"].tolist()


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--text", "xylophone"], 1, "does not know xylophone"),
        (["--kind", "song"], 2, "expected one of"),
        (["--kind", "hvd", "--text", "go"], 2, "not both"),
        (["--synth", "espeak", "--seconds", "3"], 1, "as long as it takes"),
        (["--talker", "robot"], 2, "robot"),
        (["--rate", "100"], 2, "8000"),
    ],
)
def test_wrong_input_is_told(arguments: list[str], code: int, said: str, tmp_path: Path) -> None:
    found, output = run("--out", str(tmp_path), *arguments)

    assert found == code
    assert said in " ".join(output.split())
    assert not list(tmp_path.glob("*.wav"))
