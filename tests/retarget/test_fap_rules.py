from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.formats.fap import read_fap
from facewright.core.mpeg4 import fap_by_name, fap_table
from facewright.retarget.fap_rules import (
    LIP_PAIRS,
    complete_faps,
    completed,
    from_partners,
    other_side,
)

NAN = np.nan
REAL = Path(__file__).parents[2] / "../shared/data/real/fap"


def frames(**columns: list[float]) -> Clip:
    n = len(next(iter(columns.values())))
    return Clip(
        0.1 * np.arange(n, dtype=np.float64), tuple(columns), np.array([*columns.values()]).T
    )


@pytest.mark.parametrize("pair", LIP_PAIRS)
@pytest.mark.parametrize("turned", [False, True])
def test_inner_and_outer_lip_stand_for_each_other(pair: tuple[int, int], turned: bool) -> None:
    here, there = (fap_table()[n - 1].name for n in (pair[::-1] if turned else pair))
    found = completed(frames(**{here: [1.0, 5.0]}))
    np.testing.assert_array_equal(found.clip[there], [1.0, 5.0])
    assert found.derived[there] == here
    assert here not in found.derived


def test_lip_pairs_are_the_same_motion_of_the_two_contours() -> None:
    table = fap_table()
    for inner, outer in LIP_PAIRS:
        a, b = table[inner - 1], table[outer - 1]
        assert b.name == f"{a.name}_o"
        assert (a.axis, a.fapu) == (b.axis, b.fapu)
    assert {b for _, b in LIP_PAIRS} == set(range(51, 61))


def test_the_other_side_moves_as_a_mirror_would_have_it() -> None:
    """The same sign means mirrored motion: axes across are opposite, all others equal.

    But for the eyes' yaw: both look the same way.
    """
    for fap in fap_by_name().values():
        other = other_side(fap.name)
        if other is None:
            continue
        theirs = fap_by_name()[other].axis
        if fap.axis.endswith("x") and not fap.is_rotation:
            assert theirs[0] != fap.axis[0], fap.name
        else:
            assert theirs == fap.axis, fap.name


def test_one_side_of_one_contour_gives_all_four() -> None:
    found = completed(frames(raise_l_cornerlip_o=[3.0, 4.0]))
    assert set(found.clip.channels) == {
        "raise_l_cornerlip", "raise_r_cornerlip", "raise_l_cornerlip_o", "raise_r_cornerlip_o",
    }  # fmt: skip
    np.testing.assert_array_equal(found.clip.values, [[3.0] * 4, [4.0] * 4])
    assert found.derived["raise_r_cornerlip_o"] == "raise_l_cornerlip_o"


def test_left_inner_and_right_outer_complete_each_other() -> None:
    found = complete_faps(frames(lower_t_lip_lm=[2.0], lower_t_lip_rm_o=[7.0]))
    assert {n: v[0] for n, v in found.items()} == {
        "lower_t_lip_lm": 2.0, "lower_t_lip_lm_o": 2.0,
        "lower_t_lip_rm": 7.0, "lower_t_lip_rm_o": 7.0,
    }  # fmt: skip


def test_a_partner_stands_in_before_the_first_value_only() -> None:
    clip = frames(
        raise_b_midlip=[NAN, NAN, 10.0, NAN, 20.0], raise_b_midlip_o=[1.0, 2.0, 3.0, 4.0, 5.0]
    )
    found = completed(clip)
    np.testing.assert_allclose(found.clip["raise_b_midlip"], [1.0, 2.0, 10.0, 15.0, 20.0])
    assert dict(found.n_filled) == {"raise_b_midlip": 3}
    assert found.derived == {}
    assert found.as_text() == "gaps filled: raise_b_midlip (3)"


def test_a_partner_that_was_not_set_does_not_stand_in() -> None:
    clip = frames(raise_l_i_eyebrow=[NAN, 5.0, 6.0], raise_r_i_eyebrow=[NAN, NAN, 9.0])
    found = complete_faps(clip)
    np.testing.assert_array_equal(found["raise_l_i_eyebrow"], [5.0, 5.0, 6.0])
    np.testing.assert_array_equal(found["raise_r_i_eyebrow"], [5.0, 5.0, 9.0])


def test_sides_do_not_pass_a_value_back_and_forth() -> None:
    clip = frames(raise_l_i_eyebrow=[NAN, 5.0], raise_r_i_eyebrow=[8.0, NAN])
    found, derived = from_partners(clip)
    np.testing.assert_array_equal(found["raise_l_i_eyebrow"], [8.0, 5.0])
    np.testing.assert_array_equal(found["raise_r_i_eyebrow"], [8.0, NAN])
    assert derived == {}


def test_what_is_given_throughout_is_left_as_it_is() -> None:
    rng = np.random.default_rng(5)
    names = tuple(f.name for f in fap_table()[2:])
    clip = Clip(np.arange(3) / 25, names, rng.normal(size=(3, 66)))
    found = completed(clip)
    np.testing.assert_array_equal(found.clip.values, clip.values)
    assert found.as_text() == ""


def test_completing_twice_changes_nothing() -> None:
    clip = frames(raise_b_midlip_o=[NAN, 2.0, NAN], close_t_l_eyelid=[4.0, NAN, 6.0])
    once = completed(clip)
    twice = completed(once.clip)
    assert twice.clip.channels == once.clip.channels
    np.testing.assert_array_equal(twice.clip.values, once.clip.values)
    assert twice.as_text() == ""


def test_a_clip_without_faps_is_told() -> None:
    with pytest.raises(InputError, match="no FAP; its channels are jawOpen"):
        completed(Clip(np.zeros(1), ("jawOpen",), np.ones((1, 1))))
    with pytest.raises(InputError, match="no FAP"):
        completed(frames(open_jaw=[NAN, NAN]))


def test_a_real_stream_of_outer_lips_gets_its_inner_ones() -> None:
    path = REAL / "vreng_joy.fap"
    if not path.exists():
        pytest.skip("real .fap streams are not there (shared/data/real/fap)")
    clip = read_fap(path)
    found = completed(clip)
    assert np.isnan(clip["stretch_l_cornerlip"]).all()
    np.testing.assert_array_equal(found.clip["stretch_l_cornerlip"], clip["stretch_l_cornerlip_o"])
    assert found.derived["raise_b_lip_rm"] == "raise_b_lip_rm_o"
    assert "derived: " in found.as_text()
