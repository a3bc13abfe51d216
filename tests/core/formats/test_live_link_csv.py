from __future__ import annotations

import csv
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.live_link_csv import (
    ARKIT_SHAPES,
    CHANNELS,
    read_live_link_csv,
    write_live_link_csv,
)


def some_clip(n_frames: int = 90, rate: float = 60.0) -> Clip:
    rng = np.random.default_rng(3)
    values = rng.uniform(0, 1, size=(n_frames, len(CHANNELS)))
    return Clip(np.arange(n_frames) / rate, CHANNELS, values)


@pytest.mark.parametrize("rate", [24, 25, 30, 60])
def test_what_is_written_reads_back(tmp_path: Path, rate: int) -> None:
    clip = some_clip(3 * rate, rate)
    write_live_link_csv(tmp_path / "take.csv", clip, rate=rate)

    found = read_live_link_csv(tmp_path / "take.csv")

    assert found.channels == CHANNELS
    np.testing.assert_allclose(found.values, clip.values, atol=5.1e-7)
    np.testing.assert_allclose(found.time_s, clip.time_s, atol=1e-4)


def test_the_csv_module_reads_the_same_columns(tmp_path: Path) -> None:
    clip = some_clip()
    write_live_link_csv(tmp_path / "take.csv", clip)

    with open(tmp_path / "take.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))

    assert list(rows[0])[:4] == ["Timecode", "BlendShapeCount", "EyeBlinkLeft", "EyeLookDownLeft"]
    assert len(rows[0]) == 63
    assert rows[0]["BlendShapeCount"] == "61"
    assert [rows[i]["Timecode"] for i in (0, 59, 60)] == [
        "00:00:00:00.000", "00:00:00:59.000", "00:00:01:00.000",
    ]  # fmt: skip
    found = [float(row["MouthSmileLeft"]) for row in rows]
    np.testing.assert_allclose(found, clip["mouthSmileLeft"], atol=5.1e-7)


def test_what_is_not_set_is_written_as_zero(tmp_path: Path) -> None:
    values = np.array([[np.nan], [0.5]])
    write_live_link_csv(tmp_path / "a.csv", Clip(np.array([0.0, 1 / 60]), ("jawOpen",), values))

    found = read_live_link_csv(tmp_path / "a.csv")

    assert found["jawOpen"].tolist() == [0.0, 0.5]
    assert not found["tongueOut"].any()


def written(folder: Path, text: str) -> Path:
    path = folder / "take.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_in_any_order_and_case_over_midnight(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "jawopen;TIMECODE;Eyeblinkleft;Extra\n"
        "0.25;23:59:59:58.5;0.1;x\n"
        "0.5;23:59:59:59.25;;x\n"
        "0.75;00:00:00:00.5;0.3;x\n",
    )

    found = read_live_link_csv(path)

    assert found.channels == ("eyeBlinkLeft", "jawOpen")
    np.testing.assert_allclose(found.time_s, [0, 0.75 / 60, 2 / 60], atol=1e-9)
    np.testing.assert_array_equal(found["eyeBlinkLeft"], [0.1, np.nan, 0.3])


@pytest.mark.parametrize("rate", [24, 30])
def test_the_rate_of_time_codes_is_told_by_their_frames(tmp_path: Path, rate: int) -> None:
    lines = [f"00:00:{k // rate:02d}:{k % rate:02d}.000,0" for k in range(2 * rate + 2)]
    path = written(tmp_path, "\n".join(["Timecode,JawOpen", *lines]))

    found = read_live_link_csv(path)

    np.testing.assert_allclose(np.diff(found.time_s), 1 / rate, atol=1e-9)


def test_a_given_rate_is_taken(tmp_path: Path) -> None:
    path = written(tmp_path, "Timecode,JawOpen\n0:0:0:00.000,0\n0:0:0:10.000,1\n")
    assert read_live_link_csv(path, timecode_rate=30).time_s[1] == pytest.approx(1 / 3)
    assert read_live_link_csv(path).time_s[1] == pytest.approx(1 / 6)


def test_seconds_may_stand_in_place_of_time_codes(tmp_path: Path) -> None:
    found = read_live_link_csv(written(tmp_path, "time_s,jawOpen\n2.5,0\n2.75,1\n"))
    assert found.time_s.tolist() == [0.0, 0.25]


@pytest.mark.parametrize(
    ("text", "where", "expected"),
    [
        ("Timecode,JawOpen\n", "file", "frames"),
        ("JawOpen,TongueOut\n0,0\n", "line 1", "a column Timecode"),
        ("Timecode,Foo\n0:0:0:0.0,1\n", "line 1", "ARKit's shapes"),
        ("Timecode,JawOpen,jawopen\n0:0:0:0.0,1,1\n", "line 1", "one column jawOpen"),
        ("Timecode,JawOpen\n0:0:0:0.0,1,2\n", "line 2", "2 values"),
        ("Timecode,JawOpen\n0:0:0:0.0,1\n0:0:0:1.0,n/a\n", "line 3, jawOpen", "a number"),
        ("Timecode,JawOpen\n0:0:0:0.0,inf\n", "line 2, jawOpen", "a number"),
        ("Timecode,JawOpen\n0:0:0:1.0,1\n0:0:0:1.0,1\n", "line 3", "a time after"),
        ("Timecode,JawOpen\n0:0:0:1.0,1\nlater,1\n", "line 3", "a time code"),
        ("Timecode,JawOpen\nsoon,1\n", "line 2", "a time code"),
        ("\x00\x01\x02,\x00\n\x03\n", "line 1", "a column Timecode"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, text: str, where: str, expected: str) -> None:
    path = written(tmp_path, text)

    with pytest.raises(FileFormatError) as error:
        read_live_link_csv(path)

    assert error.value.args[0] == path
    assert error.value.args[1] == where
    assert expected in error.value.args[2]


def test_a_frame_number_beyond_the_rate_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "Timecode,JawOpen\n0:0:0:31.0,1\n")
    with pytest.raises(FileFormatError, match="a frame below 30"):
        read_live_link_csv(path, timecode_rate=30)


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="an empty file"):
        read_live_link_csv(written(tmp_path, ""))


def test_clips_that_do_not_fit_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with pytest.raises(InputError, match="no ARKit weight"):
        write_live_link_csv(path, Clip(np.zeros(1), ("open_jaw",), np.zeros((1, 1))))
    with pytest.raises(InputError, match="resample it"):
        write_live_link_csv(path, some_clip(10, 30.0))
    assert not path.exists()


def test_the_shapes_are_arkits(repository: Path) -> None:
    table = repository.parent / "shared" / "data" / "arkit_blendshapes.csv"
    if not table.is_file():
        pytest.skip(f"the table of shapes is not on this machine (expected at {table})")
    with open(table, newline="", encoding="utf-8") as stream:
        assert {row["name"] for row in csv.DictReader(stream)} == set(ARKIT_SHAPES)


@pytest.mark.parametrize(
    "rate", [Fraction(n) for n in (24, 25, 50, 120)] + [Fraction(n, 1001) for n in (30000, 60000)]
)
def test_evenly_counted_frames_tell_the_rate_at_the_first_whole_second(
    tmp_path: Path, rate: Fraction
) -> None:
    times = np.arange(math.floor(1.3 * rate)) / float(rate)
    clip = Clip(times, ("jawOpen",), np.zeros((len(times), 1)))
    write_live_link_csv(tmp_path / "take.csv", clip, rate=rate)

    found = read_live_link_csv(tmp_path / "take.csv")

    np.testing.assert_allclose(found.time_s, times, atol=1e-4)


def test_frames_that_were_dropped_tell_nothing_of_the_rate(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "Timecode,JawOpen\n"
        "00:00:00:20.0,0\n00:00:00:21.0,0\n00:00:00:22.0,0\n00:00:00:24.0,0\n00:00:01:00.0,0\n",
    )
    expected = [0, 1 / 60, 2 / 60, 4 / 60, 40 / 60]
    assert read_live_link_csv(path).time_s.tolist() == pytest.approx(expected)
