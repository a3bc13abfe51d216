"""take.toml."""

from __future__ import annotations

from pathlib import Path

import pytest

from facewright.core.errors import FileFormatError, InputError
from facewright.datasets_synthetic.take_settings import (
    TROUBLES,
    TakeSettings,
    read_take_settings,
    settings_for,
    settings_with,
    write_take_settings,
)
from facewright.heads.stage_lights import LIGHT_NAMES, StageLights


@pytest.mark.parametrize("kind", ["markers", "plain", "wand"])
def test_what_is_written_reads_back(tmp_path: Path, kind: str) -> None:
    asked = settings_for(kind)
    for name, trouble in TROUBLES.items():
        if kind != "wand" or name not in ("hand", "hair"):
            asked = settings_with(asked, trouble)

    write_take_settings(tmp_path / "take.toml", asked, 17)

    assert read_take_settings(tmp_path / "take.toml") == (asked, 17)


def test_a_few_lines_are_enough(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[cameras]\ncount = 6\nimage_size = [640, 480]\n[clocks]\ndropped = 0.1\n")

    found, seed = read_take_settings(path)

    assert seed is None
    assert found == settings_with(
        TakeSettings(),
        {"cameras.count": 6, "cameras.image_size": (640, 480), "clocks.dropped": 0.1},
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[cameras]\ncuont = 4\n", "cameras.cuont: expected one of count"),
        ("[cameras]\ncount = 4.5\n", "cameras.count: expected a whole number, found 4.5"),
        ("[cameras]\ncount = true\n", "cameras.count: expected a whole number"),
        ("cameras = 4\n", "cameras: expected a table"),
        ("[cameras]\nimage_size = [640]\n", "cameras.image_size"),
        ("[cameras]\nrate_hz = nan\n", "cameras.rate_hz: expected a number"),
        ("[performance]\nvoice = 1\n", "performance.voice: expected true or false"),
        ("seed = -1\n", "seed: expected a whole number from 0"),
        ("version = 2\n", "version: expected 1"),
        ('kind = "film"\n', "kind: expected one of markers, plain, wand, found 'film'"),
        ("kind = \n", "valid TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "take.toml"
    path.write_text(text)

    with pytest.raises(FileFormatError) as caught:
        read_take_settings(path)

    assert said in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[cameras]\ncount = 9\n", "cameras.count: expected 1 to 8, got 9"),
        ("[cameras]\nimage_size = [641, 480]\n", "even numbers"),
        ('kind = "plain"\n[scene]\nbackground = "dark"\n', "studio or clutter"),
        ('[performance]\nvoice = true\nstyle = "range"\n', "a voice goes with the styles mixed"),
        ("[actor]\nyoungest_years = 80\n", "oldest_years lies below"),
        ("seconds = 1e9\n", "seconds: expected 0.5 to 7200"),
    ],
)
def test_values_out_of_range_are_refused_with_the_file(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "take.toml"
    path.write_text(text)

    with pytest.raises(InputError) as caught:
        read_take_settings(path)

    assert said in str(caught.value)
    assert str(path) in str(caught.value)


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(InputError, match=r"no setting cameras\.colour"):
        settings_with(TakeSettings(), {"cameras.colour": 1})
    with pytest.raises(InputError, match=r"no setting weather\.rain"):
        settings_with(TakeSettings(), {"weather.rain": 1})


def test_a_kind_brings_its_own_defaults(tmp_path: Path) -> None:
    path = tmp_path / "take.toml"
    path.write_text('kind = "plain"\n[cameras]\ncount = 2\n')

    found, _ = read_take_settings(path)

    assert found == settings_with(settings_for("plain"), {"cameras.count": 2})


def test_every_light_of_the_stage_may_be_asked_for() -> None:
    for name in LIGHT_NAMES:
        asked = settings_with(settings_for("plain"), {"scene.light": name})
        assert StageLights.preset(asked.scene.light) is not None
