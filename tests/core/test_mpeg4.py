"""The MPEG-4 tables: counts and facts of the standard."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.core.errors import InputError
from facewright.core.mpeg4 import (
    ANGLE_UNIT_RAD,
    N_FAPS,
    Fapu,
    fap_by_name,
    fap_channels,
    fap_table,
    feature_point_table,
)

NEUTRAL = {
    "2.2": (0, -66, 10),
    "3.1": (31, 6, 0),
    "3.2": (-31, 6, 0),
    "3.3": (31, -5, 0),
    "3.4": (-31, -5, 0),
    "3.5": (31, 0, 0),
    "3.6": (-31, 0, 0),
    "8.3": (25, -70, 0),
    "8.4": (-25, -70, 0),
    "9.15": (0, -45, 20),
}


def test_there_are_68_faps_in_order() -> None:
    table = fap_table()
    assert [fap.number for fap in table] == list(range(1, 69))
    assert len({fap.name for fap in table}) == N_FAPS == 68


def test_faps_1_and_2_take_ten_channels_and_the_others_one() -> None:
    channels = fap_channels()
    assert len(channels) == len(set(channels)) == 4 + 6 + 66
    assert channels[:4] == ("viseme.select1", "viseme.select2", "viseme.blend", "viseme.def")
    assert channels[10:] == tuple(fap.name for fap in fap_table()[2:])


@pytest.mark.parametrize(
    ("number", "name", "fapu", "axis"),
    [
        (3, "open_jaw", "MNS", "-y"),
        (16, "push_b_lip", "MNS", "+z"),
        (19, "close_t_l_eyelid", "IRISD", "-y"),
        (23, "yaw_l_eyeball", "AU", "rot+y"),
        (31, "raise_l_i_eyebrow", "ENS", "+y"),
        (37, "squeeze_l_eyebrow", "ES", "-x"),
        (38, "squeeze_r_eyebrow", "ES", "+x"),
        (48, "head_pitch", "AU", "rot+x"),
        (53, "stretch_l_cornerlip_o", "MW", "+x"),
    ],
)
def test_known_faps_have_their_unit_and_direction(
    number: int, name: str, fapu: str, axis: str
) -> None:
    fap = fap_by_name()[name]
    assert (fap.number, fap.fapu, fap.axis) == (number, fapu, axis)


def test_faps_move_feature_points_that_exist() -> None:
    points = feature_point_table()
    for fap in fap_table()[2:]:
        assert fap.feature_points, fap.name
        assert set(fap.feature_points) <= set(points), fap.name
        assert fap.fapu in {"MNS", "MW", "ENS", "ES", "IRISD", "AU"} or fap.fapu == "na", fap.name


def test_there_are_84_feature_points_in_ten_groups() -> None:
    points = feature_point_table()
    assert len(points) == 84
    sizes = [sum(p.split(".")[0] == str(g) for p in points) for g in range(2, 12)]
    assert sizes == [14, 14, 6, 4, 4, 1, 10, 15, 10, 6]


def test_mirroring_a_feature_point_twice_gives_it_back() -> None:
    points = feature_point_table()
    paired = [point for point in points.values() if point.mirror_id]
    assert len(paired) == 64
    for point in paired:
        assert points[point.mirror_id].mirror_id == point.id != point.mirror_id
    assert points["8.3"].mirror_id == "8.4"


def test_points_in_the_middle_have_no_mirror_image() -> None:
    """Nose tip, chin, mid lips, tongue tip."""
    for point in ("9.3", "2.1", "2.2", "2.3", "8.1", "8.2", "6.1"):
        assert feature_point_table()[point].mirror_id == ""


def test_units_are_the_standards_distances() -> None:
    fapu = Fapu.from_points(NEUTRAL)
    assert fapu.as_dict() == {"IRISD": 11, "ES": 62, "ENS": 45, "MNS": 21, "MW": 50}
    assert fapu.unit(fap_by_name()["open_jaw"]) == pytest.approx(21 / 1024)
    assert fapu.unit(fap_by_name()["head_yaw"]) == ANGLE_UNIT_RAD == 1e-5
    with pytest.raises(ValueError, match="has no unit"):
        fapu.unit(fap_table()[0])


def test_units_do_not_depend_on_where_the_head_is_but_on_its_size() -> None:
    moved = {k: 2.0 * np.array(v) + (3, -4, 5) for k, v in NEUTRAL.items()}
    one, two = Fapu.from_points(NEUTRAL).as_dict(), Fapu.from_points(moved).as_dict()
    assert two == {name: pytest.approx(2 * value) for name, value in one.items()}


def test_missing_points_of_the_neutral_face_are_named() -> None:
    some = {k: v for k, v in NEUTRAL.items() if k not in ("3.5", "9.15")}
    with pytest.raises(InputError, match=r"3\.5, 9\.15"):
        Fapu.from_points(some)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_units_that_are_no_lengths_are_refused(value: float) -> None:
    with pytest.raises(InputError, match="unit MW must be a length above 0"):
        Fapu(11, 62, 45, 21, value)
