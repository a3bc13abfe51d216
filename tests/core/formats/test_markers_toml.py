"""markers.toml."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.markers_toml import read_marker_set, write_marker_set
from facewright.core.markers import Marker, MarkerSet
from facewright.core.mpeg4 import Fapu

HEADS = "\n".join(
    f'[[marker]]\nlabel = "h{n}"\nfeature_point = "head"\ntemplate_mm = [{n}, 1.5, -2]'
    for n in range(3)
)
START = 'version = 1\nname = "lab"\n'


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_written_by_hand_is_read(tmp_path: Path) -> None:
    text = f'# ours\n{START}{HEADS}\n[[marker]]\nlabel = "chin"\nfeature_point = "2.1" # below\n'
    found = read_marker_set(write(tmp_path / "markers.toml", text))
    heads = tuple(Marker(f"h{n}", "head", (float(n), 1.5, -2.0)) for n in range(3))
    assert found == MarkerSet("lab", (*heads, Marker("chin", "2.1")))


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    odd = 'a "b" \\ ä\t\x01\x7f\n'
    heads = tuple(Marker(f"h{n}", "head", (n / 3, -1e-7, 1e5)) for n in range(3))
    markers = MarkerSet(odd, (*heads, Marker(odd, "8.1"), Marker("b", "9.3", (0.1, 0.2, 0.3))))
    face = Marker("c", "face", (1.0, 2.0, 3.0), "#20a040")
    measured = replace(markers, fapu=Fapu(9.5, 62.0, 45.5, 1 / 3, 50.5))
    balls = replace(markers, markers=(*heads, face), diameter_mm=1 / 3, standoff_mm=2.5)
    for given in (markers, measured, balls):
        write_marker_set(tmp_path / "m.toml", given)
        assert read_marker_set(tmp_path / "m.toml") == given


FAPU = "[fapu]\nirisd = 9.5\nes = 62\nens = 45.5\nmns = 17.0\nmw = 50.5\n"


def test_measured_units_are_read(tmp_path: Path) -> None:
    found = read_marker_set(write(tmp_path / "markers.toml", f"{START}{HEADS}\n{FAPU}"))
    assert found.fapu == Fapu(9.5, 62.0, 45.5, 17.0, 50.5)


@pytest.mark.parametrize("line", ["irisd = 0", "irisd = -1", "irisd = nan", "irisd = 'x'", ""])
def test_units_that_are_no_lengths_are_refused(tmp_path: Path, line: str) -> None:
    text = f"{START}{HEADS}\n{FAPU.replace('irisd = 9.5', line)}"
    with pytest.raises((FileFormatError, InputError), match=r"(?i)markers\.toml.*irisd"):
        read_marker_set(write(tmp_path / "markers.toml", text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "an empty file"),
        ("version = 1\nname = lab\n", "line 2, column 8: expected valid TOML"),
        ("name = 'x'", "version: expected 1, found nothing"),
        ("version = 1\n", "name: expected a text in quotes, found nothing"),
        (START, r"tables headed \[\[marker\]\], found nothing"),
        (START + "marker = [1]", r"marker 1: expected a table headed"),
        (START + HEADS + "\n[extra]", 'only the keys version, name, .*, found "extra"'),
        (START + HEADS + "\n[[marker]]\nfeature_point='8.1'", "marker 4, label: .* found nothing"),
        (START + HEADS + "\n[[marker]]\nlabel='a'", 'marker "a", feature_point: .* found nothing'),
        (
            START + HEADS + "\n[[marker]]\nlabel='a'\nfeature_point='99.1'",
            'marker "a", feature_point: expected a feature point like "8.1", .* found "99.1"',
        ),
        (START + HEADS + "\n[[marker]]\nlabel='a'\nfeature_point=8.1", "found 8.1"),
        (START + HEADS + "\n[[marker]]\nlabel='a'\nfeaturepoint='8.1'", 'found "featurepoint"'),
        (START + HEADS.replace("[2, 1.5, -2]", "[2, 1.5]"), 'marker "h2", template_mm: expected'),
        (START + HEADS.replace("[2, 1.5, -2]", "[2, nan, 1]"), "template_mm"),
        (START + "diameter_mm = '4'\n" + HEADS, 'diameter_mm: expected a length in mm, found "4"'),
        (START + HEADS + "\ncolour = 3", 'marker "h2", colour: expected a text'),
        (START + HEADS.replace("[2, 1.5, -2]", "[2, true, 1]"), "template_mm"),
    ],
)
def test_errors_name_the_place(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path / "markers.toml", text)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_marker_set(path)
    assert str(caught.value).startswith(f"{path}, ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADS.replace('"h2"', '"h1"'), "label h1 is given twice"),
        (HEADS[: HEADS.rindex("[[")], "at least 3 markers"),
        (HEADS[: HEADS.rindex("template")], "head marker h2 needs template_mm"),
        (
            HEADS + "\n[[marker]]\nlabel='a'\nfeature_point='face'",
            "face marker a needs template_mm",
        ),
        (HEADS + "\ncolour = 'red'", 'marker h2 has colour "red"'),
        ("standoff_mm = -1\n" + HEADS, "standoff_mm is -1"),
        ("diameter_mm = 0\n" + HEADS, "diameter_mm is 0"),
    ],
)
def test_sets_that_cannot_be_used_name_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path / "markers.toml", START + text)
    with pytest.raises(InputError, match=message) as caught:
        read_marker_set(path)
    assert str(path) in str(caught.value)
