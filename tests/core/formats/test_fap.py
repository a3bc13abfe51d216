"""The ASCII .fap format: files by other programs, the grammar, its traps."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.fap import read_fap, write_fap
from facewright.core.mpeg4 import EXPRESSION_FIELDS, VISEME_FIELDS, fap_channels, fap_table


def mask(*numbers: int, columns: int = 68) -> str:
    return " ".join("1" if n + 1 in numbers else "0" for n in range(columns))


def fap_file(tmp_path: Path, *lines: str, end: str = "\n") -> Path:
    path = tmp_path / "x.fap"
    path.write_bytes((end.join(lines) + end).encode())
    return path


def columns_of_file(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The simple FAPs (3 to 68) of a file by nothing but splitting at blanks: values and mask."""
    lines = [line.split() for line in path.read_text().split("\n") if line.strip()][1:]
    masks = np.array([[bit == "1" for bit in line[:68]] for line in lines[::2]])
    values = np.full(masks.shape, np.nan)
    for frame, line in enumerate(lines[1::2]):
        values[frame, masks[frame]] = [float(v) for v in line[1:]]
    return values[:, 2:], masks[:, 2:]


@pytest.mark.parametrize(
    ("name", "frames", "rate_hz"),
    [
        ("vreng_jag.fap", 169, 5),  # CRLF, tabs
        ("vreng_joy.fap", 20, 10),
        ("greta_au_interpolation_1131.fap", 1, None),  # 69 columns, a name with spaces
    ],
)
def test_files_by_other_programs_are_read(
    real_data: Path, name: str, frames: int, rate_hz: float | None
) -> None:
    clip = read_fap(real_data / "fap" / name)

    values, is_given = columns_of_file(real_data / "fap" / name)
    assert clip.channels == fap_channels()
    assert clip.values.shape == (frames, 76)
    assert clip.rate_hz == rate_hz
    assert np.isnan(clip.values[:, :10]).all()
    np.testing.assert_array_equal(clip.values[:, 10:], values)
    np.testing.assert_array_equal(clip.is_set[:, 10:], is_given)  # type: ignore[index]


def test_known_values_of_a_file_by_another_program(real_data: Path) -> None:
    clip = read_fap(real_data / "fap" / "greta_au_interpolation_1131.fap")
    assert clip["close_t_l_eyelid"][0] == 626
    assert clip["close_b_r_eyelid"][0] == 133
    clip = read_fap(real_data / "fap" / "vreng_jag.fap")
    assert clip["open_jaw"][0] == 57
    assert clip["head_pitch"][168] == -186 and clip["head_yaw"][168] == 9486


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", " \n", "\t\r\n", "\n\n"])
def test_line_ends_and_comments_do_not_matter(tmp_path: Path, end: str) -> None:
    lines = ("# by hand", "2.1 a name  of words 25 2", mask(3), "# why", "5 10", mask(4), "7 -2.5")
    clip = read_fap(fap_file(tmp_path, *lines, end=end))
    np.testing.assert_allclose(clip.time_s, [0, 2 / 25])
    np.testing.assert_array_equal(clip["open_jaw"], [10, np.nan])
    np.testing.assert_array_equal(clip["lower_t_midlip"], [np.nan, -2.5])


@pytest.mark.parametrize("header", ["2.1 x 25 2", "2.0 25 2", "2.2 a b c 25.0 10000"])
def test_headers_are_read_from_both_ends(tmp_path: Path, header: str) -> None:
    clip = read_fap(fap_file(tmp_path, header, mask(3), "0 1", mask(3), "1 2"))
    np.testing.assert_allclose(clip.time_s, [0, 0.04])


def test_visemes_take_four_and_expressions_six_values(tmp_path: Path) -> None:
    line = "0 4 11 32 0 1 63 2 10 0 1 99"
    clip = read_fap(fap_file(tmp_path, "2.1 x 25 1", mask(1, 2, 3), line))
    assert [clip[name][0] for name in VISEME_FIELDS] == [4, 11, 32, 0]
    assert [clip[name][0] for name in EXPRESSION_FIELDS] == [1, 63, 2, 10, 0, 1]
    assert clip["open_jaw"][0] == 99


def test_a_wrong_count_in_the_header_is_logged_unless_it_is_the_placeholder(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        read_fap(fap_file(tmp_path, "2.1 x 25 10000", mask(3), "0 1"))
        assert not caplog.records
        read_fap(fap_file(tmp_path, "2.1 x 25 7", mask(3), "0 1"))
    assert "promises 7 frames, the file holds 1" in caplog.text


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["2.1 x 25 1"], "line 1: expected frames after it"),
        (["# only this"], "only comments"),
        (["3.0 x 25 1", mask(3), "0 1"], "line 1: expected VERSION NAME FPS NFRAMES"),
        (["hello world"], "line 1"),
        (["2.1 x fast 1", mask(3), "0 1"], "line 1: expected a number of frames per second"),
        (["2.1 x 0 1", mask(3), "0 1"], "line 1: expected a rate above 0"),
        (["2.1 x -25 1", mask(3), "0 1"], "line 1: expected a rate above 0"),
        (["2.1 x nan 1", mask(3), "0 1"], "line 1: expected a rate above 0"),
        (["2.1 x inf 1", mask(3), "0 1"], "line 1: expected a rate above 0"),
        (["2.1 x 25 many", mask(3), "0 1"], "line 1: expected a number of frames, found"),
        (["2.1 x 25 1", mask(3)], "line 2: expected a line with the frame's values"),
        (["2.1 x 25 1", mask(3, columns=67), "0 1"], "line 2: expected a mask of 68 .* found 67"),
        (["2.1 x 25 1", mask(3).replace("1", "2"), "0 1"], 'line 2: .* found "2"'),
        (["2.1 x 25 1", mask(3, 69, columns=69), "0 1 2"], "line 2: expected 0 in mask column 69"),
        (["2.1 x 25 1", "", mask(3), "0"], 'line 4: expected a frame number and 1 values, .* "0"'),
        (["2.1 x 25 1", mask(3), "0 1 2"], "line 3: .* and 2"),
        (["2.1 x 25 1", mask(3), "0 x"], 'line 3: expected numbers, found "x"'),
        (["2.1 x 25 1", mask(3), "0 1_0"], "line 3: expected numbers"),
        (["2.1 x 25 1", mask(3), "0 inf"], 'line 3: expected finite values, found "inf"'),
        (["2.1 x 25 1", mask(3), "0 -inf"], 'line 3: expected finite values, found "-inf"'),
        (["2.1 x 25 1", mask(3), "0 nan"], 'line 3: expected finite values, found "nan"'),
        (["2.1 x 25 1", mask(3), "0 1e999"], "line 3: expected finite values"),
        (["2.1 x 25 1", mask(3), "zero 1"], "line 3: expected a frame number"),
        (["2.1 x 25 1", mask(3), "-1 1"], "line 3: expected a frame number"),
        (["2.1 x 25 1", mask(3), "99999999999 1"], "at most 2147483647"),
        (["2.1 x 25 2", mask(3), "4 1", mask(3), "4 1"], "line 5: expected a frame number above 4"),
        (["2.1 x 25 2", mask(3), "4 1", mask(3), "3 1"], "line 5: expected a frame number above 4"),
        (["2.1 x 25 1", mask(1), "0 1 2 3"], "line 3: expected a frame number and 4 values"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        read_fap(fap_file(tmp_path, *lines))


def test_binary_and_empty_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.fap"
    for data in (b"", b"\x00" * 1000, bytes(range(256)) * 10, b"\xff\xfe2\x00.\x001\x00"):
        path.write_bytes(data)
        with pytest.raises(FileFormatError):
            read_fap(path)


def full_clip(frames: int, rate_hz: float, seed: int = 0) -> Clip:
    """Every channel, with gaps; FAPs 1 and 2 whole."""
    rng = np.random.default_rng(seed)
    values = np.round(rng.normal(scale=400, size=(frames, 76)), 3)
    values[:, :10] = rng.integers(0, 15, (frames, 10))
    values[:, 10:][rng.random((frames, 66)) < 0.3] = np.nan
    values[rng.random(frames) < 0.5, :4] = np.nan
    values[rng.random(frames) < 0.5, 4:10] = np.nan
    return Clip(np.arange(frames) / rate_hz, fap_channels(), values)


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 29.97, 30000 / 1001])
@pytest.mark.parametrize("decimals", [0, 3])
def test_what_is_written_reads_back(tmp_path: Path, rate_hz: float, decimals: int) -> None:
    clip = full_clip(40, rate_hz)

    write_fap(tmp_path / "a take.fap", clip, decimals=decimals)
    found = read_fap(tmp_path / "a take.fap")

    np.testing.assert_allclose(found.time_s, clip.time_s, atol=1e-9)
    np.testing.assert_array_equal(found.is_set, clip.is_set)
    np.testing.assert_allclose(found.values, np.round(clip.values, decimals), atol=1e-9)


def test_integers_are_written_as_integers_and_rates_too(tmp_path: Path) -> None:
    values = np.array([[-0.2, 12.6], [3.0, np.nan]])
    clip = Clip(np.array([0, 1 / 30]), ("open_jaw", "head_yaw"), values)
    write_fap(tmp_path / "a take.fap", clip)
    assert (tmp_path / "a take.fap").read_text().split("\n") == [
        "2.1 a_take 30 2",
        mask(3, 49),
        "0 0 13",
        mask(3),
        "1 3",
        "",
    ]


def test_the_mask_stands_in_the_order_of_the_table(tmp_path: Path) -> None:
    """Channels in any order come out as FAPs in theirs."""
    names = tuple(fap.name for fap in reversed(fap_table()[2:]))
    clip = Clip(np.zeros(1), names, np.arange(68, 2, -1.0)[None])
    write_fap(tmp_path / "a.fap", clip)
    lines = (tmp_path / "a.fap").read_text().split("\n")
    assert lines[1] == mask(*range(3, 69))
    assert lines[2].split() == ["0", *(str(number) for number in range(3, 69))]


def test_a_files_own_frames_survive_rewriting(tmp_path: Path, real_data: Path) -> None:
    for source in sorted((real_data / "fap").glob("*.fap")):
        clip = read_fap(source)
        write_fap(tmp_path / "copy.fap", clip)
        again = read_fap(tmp_path / "copy.fap")
        np.testing.assert_array_equal(again.values, clip.values)
        np.testing.assert_allclose(again.time_s, clip.time_s)


@pytest.mark.parametrize(
    ("times", "channels", "row", "message"),
    [
        ([0, 0.04, 0.2], ("open_jaw",), [1.0], "uneven: resample it"),
        ([0.0], ("jawOpen", "mouthClose", "x", "y"), [1.0, 1, 1, 1], "not jawOpen, .* and 1 more"),
        ([0.0], VISEME_FIELDS[:3], [1.0, 2, 3], r"frame 0: FAP 1 needs all .* viseme.def is not"),
        ([0.0], EXPRESSION_FIELDS[1:], [1.0, 2, 3, 0, 0], "FAP 2 needs all of .*select1 is not"),
        ([0.0], VISEME_FIELDS, [1.5, 2, 3, 0], "viseme.select1 selects by whole numbers, got 1.5"),
        ([0.0], ("open_jaw",), [1e12], "frame 0, open_jaw: 1e\\+12 is beyond"),
        ([], ("open_jaw",), [1.0], "at least one frame"),
    ],
)
def test_clips_the_format_cannot_hold_are_refused(
    tmp_path: Path, times: list[float], channels: tuple[str, ...], row: list[float], message: str
) -> None:
    clip = Clip(np.array(times), channels, np.tile(row, (len(times), 1)))
    with pytest.raises(InputError, match=message):
        write_fap(tmp_path / "a.fap", clip)
    assert list(tmp_path.iterdir()) == []


def test_ten_minutes_at_60_hz_are_read_in_seconds(tmp_path: Path) -> None:
    clip = full_clip(36_000, 60)
    write_fap(tmp_path / "a.fap", clip)
    start = time.process_time()
    found = read_fap(tmp_path / "a.fap")
    assert time.process_time() - start < 4, "measured 1.2 s"
    assert found.values.shape == (36_000, 76)
