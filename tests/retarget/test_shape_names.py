from __future__ import annotations

import re

import pytest

from facewright.core.formats.live_link_csv import ARKIT_SHAPES
from facewright.retarget.shape_names import other_side_of, understand_shapes


def spelled(name: str) -> dict[str, str]:
    """A name as different programs write it."""
    words = re.findall(r"[A-Z]?[a-z]+", name)
    sided = {"Left": "L", "Right": "R"}.get(words[-1])
    is_sided = sided is not None and words[:-1] not in (["jaw"], ["mouth"])
    found = {
        "ARKit": name,
        "Live Link": name[0].upper() + name[1:],
        "screaming snake": "_".join(words).upper(),
        "snake": "_".join(words).lower(),
        "spaces": " ".join(words).title(),
        "with a mesh": f"Head_blendShape.{name}",
        "numbered": f"12_{name}",
        "kebab": "-".join(words).lower(),
    }
    if is_sided:
        found["ICT"] = "".join(words[:-1]) + f"_{sided}"
        found["before"] = f"{sided}_" + "".join(words[:-1])
        found["small letter"] = "_".join(words[:-1]).lower() + f"_{sided}".lower()
    return found


@pytest.mark.parametrize("name", ARKIT_SHAPES)
def test_arkits_shapes_are_known_in_any_spelling(name: str) -> None:
    for convention, written in spelled(name).items():
        found = understand_shapes([written])
        assert written in found.meanings, (convention, written)
        assert dict(found.meanings[written].amounts) == {name: 1.0}, (convention, written)
        assert found.meanings[written].kind == "arkit"
        assert found.of_arkit(name) == (written,)
        assert len(found.missing) == len(ARKIT_SHAPES) - 1


def test_sides_of_one_shape_are_two_of_a_head() -> None:
    found = understand_shapes(["browInnerUp_L", "browInnerUp_R", "cheekPuff_R", "jawLeft"])

    assert found.of_arkit("browInnerUp") == ("browInnerUp_L", "browInnerUp_R")
    assert [found.meanings[n].side for n in found.meanings] == ["left", "right", "right", ""]
    assert found.meanings["cheekPuff_R"].kind == "side"
    assert not found.unknown


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("aa", "jawOpen"),
        ("A", "jawOpen"),
        ("Fcl_MTH_A", "jawOpen"),
        ("Fcl_ALL_Joy", "mouthSmileLeft"),
        ("oh", "jawOpen"),
        ("ou", "mouthPucker"),
        ("blink", "eyeBlinkRight"),
        ("まばたき", "eyeBlinkLeft"),
        ("あ", "jawOpen"),
        ("viseme_PP", "mouthClose"),
        ("Happy", "mouthSmileLeft"),
        ("lookLeft", "eyeLookInRight"),
        ("surprised", "browInnerUp"),
        ("Relaxed", "mouthSmileRight"),
        ("VRM.fun", "mouthSmileRight"),
    ],
)
def test_poses_of_other_conventions(name: str, shape: str) -> None:
    found = understand_shapes([name])
    assert found.meanings[name].kind == "pose"
    assert found.meanings[name].amounts.get(shape, 0.0) > 0


def test_one_eyed_blinks_of_vrm_are_arkits() -> None:
    found = understand_shapes(["blink_l", "blinkRight", "Blink_R"])
    assert dict(found.meanings["blink_l"].amounts) == {"eyeBlinkLeft": 1.0}
    assert dict(found.meanings["blinkRight"].amounts) == {"eyeBlinkRight": 1.0}
    assert found.unknown == {"Blink_R": "blinkRight"}  # said twice


@pytest.mark.parametrize(
    "name",
    [
        "jawOpen_mouthSmileLeft",
        "jawOpen__mouthSmile_L",
        "corrective_jawOpen_mouthSmile_L",
        "jawOpen+mouthSmileLeft",
        "combo:jawOpen*mouthSmileLeft",
    ],
)
def test_correctives_name_what_they_correct(name: str) -> None:
    found = understand_shapes([name]).meanings[name]
    assert found.kind == "corrective"
    assert set(found.amounts) == {"jawOpen", "mouthSmileLeft"}


def test_unknown_names_come_with_a_guess() -> None:
    found = understand_shapes(["jawOpne", "mouthSmyle_L", "Pupil dilate", "", "47"])

    assert found.unknown["jawOpne"] == "jawOpen"
    assert found.unknown["mouthSmyle_L"] == "mouthSmileLeft"
    assert found.unknown["Pupil dilate"] == ""
    assert found.unknown[""] == found.unknown["47"] == ""
    assert "jawOpne (jawOpen?)" in found.unknown_text()
    assert not found.meanings


def test_the_same_shape_twice_counts_once() -> None:
    found = understand_shapes(["jawOpen", "JAW_OPEN"])
    assert list(found.meanings) == ["jawOpen"]
    assert found.unknown == {"JAW_OPEN": "jawOpen"}


def test_other_sides() -> None:
    assert other_side_of("mouthSmileLeft") == "mouthSmileRight"
    assert other_side_of("jawRight") == "jawLeft"
    assert other_side_of("jawOpen") is None
