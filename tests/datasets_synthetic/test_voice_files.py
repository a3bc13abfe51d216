"""What is written of a voice, read back."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from facewright.core.audio import read_audio
from facewright.datasets_synthetic.voice_files import write_index, write_voice
from facewright.datasets_synthetic.voice_phones import phone_kinds
from facewright.datasets_synthetic.voices import make_voice, record_voice


@pytest.mark.parametrize("synth", ["formant", "tube"])
def test_files_hold_the_voice(synth: str, tmp_path: Path) -> None:
    voice = make_voice(1, talker="child", synth=synth, text="we sing")

    sound, arrays, phones = write_voice(tmp_path, "first", voice)

    heard = read_audio(sound)
    assert heard.rate_hz == voice.audio.rate_hz
    np.testing.assert_allclose(heard.samples, voice.audio.samples, atol=0.6 / 32768)
    with np.load(arrays, allow_pickle=False) as z:
        saved = {name: z[name] for name in z.files}
    truth = voice.truth
    assert truth.f0_hz is not None
    np.testing.assert_array_equal(saved["f0_hz"], truth.f0_hz.astype(np.float32))
    assert saved["phones"].tolist() == list(truth.phones.phones)
    np.testing.assert_array_equal(saved["end_s"], truth.phones.end_s)
    assert saved["class_names"][saved["frame_class"]][10] == "silence"
    assert len(saved["time_s"]) == len(saved["formants_hz"]) == len(saved["lips_closed"])
    assert ("areas_mm2" in saved) == (synth == "tube")
    if synth == "tube":
        a = saved["areas_mm2"]
        np.testing.assert_allclose(
            saved["reflections"], (a[:, :-1] - a[:, 1:]) / (a[:, :-1] + a[:, 1:]), atol=1e-5
        )
    with open(phones, encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [r["phone"] for r in rows] == list(truth.phones.phones)
    assert [float(r["start_s"]) for r in rows] == pytest.approx(truth.phones.start_s, abs=1e-6)
    assert all(r["class"] == phone_kinds()[r["phone"]].class_ for r in rows)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "first.npz",
        "first.phones.csv",
        "first.wav",
    ]


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        voice = record_voice(make_voice(2, kind="hvd"), noise_db=10.0)
        write_voice(tmp_path / folder, "v", voice)
        write_index(tmp_path / folder, [("v", voice)])

    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == ["v.npz", "v.phones.csv", "v.wav", "voice.toml"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_index_tells_what_was_simulated(tmp_path: Path) -> None:
    voice = record_voice(make_voice(2, talker="man", text='the "big" dog'), noise_db=10.0)

    path = write_index(tmp_path, [("v", voice)])

    told = tomllib.loads(path.read_text(encoding="utf-8"))["voice"][0]
    assert told["name"] == "v"
    assert told["text"] == 'the "big" dog'
    assert told["noise_db"] == 10.0
    assert told["seed"] == 2
    assert told["talker"][0] == "m"
    assert told["duration_s"] == pytest.approx(voice.audio.duration_s)


def test_an_interruption_leaves_no_half_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    voice = make_voice(2, kind="hvd")

    def interrupted(stream: object, **arrays: object) -> None:
        assert hasattr(stream, "write")
        stream.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_voice(tmp_path, "v", voice)

    assert [p.name for p in tmp_path.iterdir()] == ["v.wav"]
