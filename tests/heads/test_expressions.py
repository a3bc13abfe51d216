"""Expressions and visemes as tables: complete, within what heads have, and what their words say."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from facewright.core.mpeg4 import displacement_faps
from facewright.core.phones import ARPABET, SILENCE
from facewright.heads.expressions import (
    EXPRESSIONS,
    VISEMES,
    expression_weights,
    phone_visemes,
    viseme_weights,
)
from facewright.heads.head import Head


def faps_of(head: Head, weights: dict[str, float]) -> dict[str, float]:
    """FAPs by name, of the head's own sculpted shapes."""
    moved = head.feature_points.at(head.shaped(weights)) - head.feature_points.at(
        head.mesh.vertices
    )
    by_id = {name: d[None] for name, d in zip(head.feature_points.names, moved, strict=True)}
    return {name: float(v[0]) for name, v in displacement_faps(by_id, head.fapu).items()}


def core_table(repository: Path, name: str, column: str) -> list[str]:
    with open(repository / "core" / "data" / name, encoding="utf-8", newline="") as f:
        return [row[column] for row in csv.DictReader(f)]


def test_names_are_mpeg4s_in_its_order(repository: Path) -> None:
    assert ["neutral", *EXPRESSIONS] == core_table(repository, "expressions.csv", "name")
    assert list(VISEMES) == core_table(repository, "visemes.csv", "short_name")


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions_are_within_what_heads_have_and_grow_with_intensity(
    average_head: Head, name: str
) -> None:
    previous = dict.fromkeys(expression_weights(name), 0.0)
    assert set(expression_weights(name, 0.0).values()) == {0.0}
    for intensity in (0.2, 0.5, 0.8, 1.0):
        weights = expression_weights(name, intensity)
        assert set(weights) <= set(average_head.shape_names)
        assert all(previous[s] < w <= 1 for s, w in weights.items())
        previous = weights
    for shape, w in previous.items():
        if shape.endswith("Left"):
            assert previous[f"{shape.removesuffix('Left')}Right"] == w


def test_expressions_move_the_face_as_mpeg4_describes_them(average_head: Head) -> None:
    """The signs of FAPs that the standard's words name (raise_* is upwards, open_jaw downwards)."""
    faps = {name: faps_of(average_head, expression_weights(name)) for name in EXPRESSIONS}

    joy = faps["joy"]  # corners pulled back towards the ears, mouth open
    assert joy["stretch_l_cornerlip_o"] > 0
    assert joy["raise_l_cornerlip_o"] > 0
    assert joy["lower_t_midlip"] + joy["raise_b_midlip"] < 0  # the lips part
    sad = faps["sadness"]  # inner brows bent upward
    assert sad["raise_l_i_eyebrow"] > sad["raise_l_o_eyebrow"]
    assert sad["raise_l_i_eyebrow"] > 0 > sad["raise_l_cornerlip_o"]
    anger = faps["anger"]  # inner brows down and together
    assert anger["raise_l_i_eyebrow"] < 0 < anger["squeeze_l_eyebrow"]
    assert anger["squeeze_r_eyebrow"] > 0
    fear = faps["fear"]  # brows raised and together, eyes alert
    assert fear["raise_l_i_eyebrow"] > 0
    assert fear["squeeze_l_eyebrow"] > 0 > fear["close_t_l_eyelid"]
    disgust = faps["disgust"]  # the upper lip raised
    assert disgust["lower_t_lip_lm"] < 0
    assert disgust["lower_t_lip_rm"] < 0
    surprise = faps["surprise"]  # brows and upper lids up, jaw open
    for fap in ("raise_l_i_eyebrow", "raise_l_m_eyebrow", "raise_l_o_eyebrow", "open_jaw"):
        assert surprise[fap] > 0
    assert surprise["close_t_r_eyelid"] < 0


def test_visemes_shape_the_mouth_as_phonetics_says(average_head: Head) -> None:
    moved = {}
    for name in VISEMES[1:]:
        weights = viseme_weights(name)
        assert set(weights) <= set(average_head.shape_names)
        assert all(0 < w <= 1 for w in weights.values())
        p = average_head.feature_points.at(average_head.shaped(weights))
        at = dict(zip(average_head.feature_points.names, p, strict=True))
        opening = at["2.2"][1] - at["2.3"][1]
        moved[name] = (opening, at["8.3"][0] - at["8.4"][0], at["8.1"][2])
    opening, width, protrusion = ({name: m[i] for name, m in moved.items()} for i in range(3))

    assert min(opening, key=opening.__getitem__) in ("PP", "FF")
    assert opening["aa"] > opening["E"] > opening["ih"]  # open, mid and close vowels
    assert opening["oh"] > opening["ou"]
    assert opening["SS"] < opening["kk"]  # teeth nearly together
    for rounded in ("oh", "ou", "CH", "RR"):
        assert width[rounded] < min(width[n] for n in ("aa", "E", "ih", "SS"))
        assert protrusion[rounded] > max(protrusion[n] for n in ("aa", "E", "ih", "SS"))


def test_silence_has_no_shape_and_numbers_are_names() -> None:
    assert viseme_weights(0) == viseme_weights("sil") == {}
    for number, name in enumerate(VISEMES):
        assert viseme_weights(number) == viseme_weights(name)
    half, full = viseme_weights("aa", 0.5), viseme_weights("aa")
    np.testing.assert_allclose([2 * half[s] for s in full], list(full.values()))


def test_every_phone_has_visemes() -> None:
    for phone in ARPABET:
        visemes = phone_visemes(phone)
        assert 1 <= len(visemes) <= 2
        assert all(1 <= v <= 14 for v in visemes) or phone == "HH"
    assert phone_visemes(SILENCE) == phone_visemes("HH") == (0,)
    for phones, viseme in (("P B M", 1), ("F V", 2), ("TH DH", 3), ("T D", 4), ("S Z", 7)):
        assert {phone_visemes(p) for p in phones.split()} == {(viseme,)}
    assert {p for p in ARPABET if len(phone_visemes(p)) == 2} == {"AW", "AY", "EY", "OW", "OY"}


def test_wrong_names_and_amounts_are_told() -> None:
    with pytest.raises(ValueError, match="no expression 'bored'; there are joy"):
        expression_weights("bored")
    with pytest.raises(ValueError, match=r"intensity must lie in 0\.\.1, got 1\.5"):
        expression_weights("joy", 1.5)
    with pytest.raises(ValueError, match="no viseme 15"):
        viseme_weights(15)
    with pytest.raises(ValueError, match="no viseme 'zz'"):
        viseme_weights("zz")
    with pytest.raises(ValueError, match=r"strength must lie in 0\.\.1"):
        viseme_weights("aa", -0.1)
    with pytest.raises(ValueError, match="no ARPAbet phone 'AA1'"):
        phone_visemes("AA1")
