"""Weights that fight each other give way; those that do not are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.datasets_synthetic.acting_curves import CLOSURE, SEAL, SPEAKING
from facewright.datasets_synthetic.acting_limits import (
    ANTAGONISTS,
    MOUTH,
    PARTING,
    WHILE_SPEAKING,
    limit,
    sides,
    yield_to_speech,
)
from facewright.heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from facewright.heads.head import Head


def faced(**weights: float) -> dict[str, float]:
    """`limit` of single values."""
    return {
        n: float(c[0]) for n, c in limit({n: np.array([w]) for n, w in weights.items()}).items()
    }


def test_rules_name_shapes_that_heads_have(average_head: Head) -> None:
    patterns = [p for pair in ANTAGONISTS for p in pair] + [*PARTING, *MOUTH]
    assert {s for p in patterns for s in sides(p)} <= set(average_head.shape_names)


@pytest.mark.parametrize("pair", ANTAGONISTS)
def test_rivals_at_full_do_not_both_stay(pair: tuple[str, str]) -> None:
    a, b = (sides(p)[0] for p in pair)
    together = faced(**{a: 1.0, b: 1.0})
    assert together[a] + together[b] < 0.15
    strong = faced(**{a: 0.8, b: 0.3})
    assert strong[a] > 2 * strong[b]
    gentle = faced(**{a: 0.4, b: 0.3})
    assert gentle[a] == 0.4
    assert gentle[b] == 0.3


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions_by_themselves_are_hardly_touched(name: str) -> None:
    """The rules are for what is added, not for what was sculpted together."""
    weights = expression_weights(name, 0.8)
    found = faced(**weights)
    for shape, w in weights.items():
        assert found[shape] == pytest.approx(w, abs=0.06), shape


@pytest.mark.parametrize("name", VISEMES[1:])
def test_visemes_by_themselves_are_hardly_touched(name: str) -> None:
    weights = viseme_weights(name)
    found = faced(**weights)
    for shape, w in weights.items():
        assert found[shape] == pytest.approx(w, abs=0.06), shape


def test_a_seal_shuts_the_lips_over_any_jaw() -> None:
    for jaw in (0.0, 0.1, 0.5, 1.0):
        found = faced(
            jawOpen=jaw, mouthFunnel=0.5, mouthUpperUpLeft=0.5, tongueOut=0.6, **{SEAL: 1.0}
        )
        assert found["mouthClose"] == pytest.approx(found["jawOpen"])
        assert found["mouthFunnel"] == found["mouthUpperUpLeft"] == found["tongueOut"] == 0


def test_mouth_close_never_exceeds_the_jaw() -> None:
    rng = np.random.default_rng(0)
    curves = {n: rng.uniform(0, 1.5, 1000) for n in ("jawOpen", "mouthClose", SEAL)}
    curves[SEAL] = np.clip(curves[SEAL], 0, 1)
    found = limit(curves)
    assert (found["mouthClose"] <= found["jawOpen"] + 1e-12).all()
    assert found["jawOpen"].max() <= 1
    np.testing.assert_allclose(  # closing in proportion is kept
        faced(jawOpen=0.3, mouthClose=0.2)["mouthClose"], 0.2, atol=1e-9
    )


def test_an_open_mouth_neither_presses_nor_puffs() -> None:
    found = faced(jawOpen=1.0, mouthPressLeft=1.0, cheekPuff=1.0)
    assert found["mouthPressLeft"] < 0.05
    assert found["cheekPuff"] < 0.05
    held = faced(jawOpen=0.4, mouthClose=0.4, mouthPressLeft=0.6)
    assert held["mouthPressLeft"] > 0.55


def test_the_tongue_stays_in_a_closed_mouth() -> None:
    assert faced(tongueOut=1.0, jawOpen=0.0)["tongueOut"] == 0
    assert faced(tongueOut=0.6, jawOpen=0.2)["tongueOut"] > 0.55


def test_closed_lids_are_closed_whatever_else() -> None:
    found = faced(eyeBlinkLeft=0.3, eyeWideLeft=0.8, **{CLOSURE: 1.0})
    assert found["eyeBlinkLeft"] == found["eyeBlinkRight"] == 1
    assert found["eyeWideLeft"] == 0
    half = faced(eyeBlinkLeft=0.5, **{CLOSURE: 0.5})
    assert half["eyeBlinkLeft"] == 0.75


def test_while_speaking_the_mouth_of_a_mood_is_fainter_and_the_eyes_are_not() -> None:
    acted = {n: np.array([w, w]) for n, w in expression_weights("joy").items()}
    found = yield_to_speech(acted, np.array([0.0, 1.0]))
    smile, squint = found["mouthSmileLeft"], found["cheekSquintLeft"]
    assert smile[1] == pytest.approx(WHILE_SPEAKING * smile[0])
    assert squint[1] == squint[0]


def test_helper_curves_do_not_stay() -> None:
    found = faced(jawOpen=0.2, **{SEAL: 0.0, CLOSURE: 0.0, SPEAKING: 1.0, "head.yaw": -20.0})
    assert set(found) == {"jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "head.yaw"}
    assert found["head.yaw"] == -20
