from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.formats.live_link_csv import ARKIT_SHAPES
from facewright.core.mpeg4 import fap_by_name, fap_table
from facewright.heads.head import Head
from facewright.retarget.arkit import direct_faps, direct_table, direct_weights, is_arkit
from facewright.retarget.fap_rules import other_side
from facewright.retarget.shape_jacobian import shape_jacobian
from facewright.retarget.shape_names import other_side_of
from facewright.retarget.shape_solver import ShapeDrive, weights_to_faps

#: The table tells these from a faint smile only in part.
LIKE_A_SMILE = ("mouthDimple", "mouthPress")


def one_frame(**values: float) -> Clip:
    return Clip(np.zeros(1), tuple(values), np.array([list(values.values())]))


def test_the_table_knows_all_shapes() -> None:
    table = direct_table()
    assert set(table) == set(ARKIT_SHAPES)
    assert all(any(row.is_key for row in rows) for rows in table.values())


def test_keys_have_the_signs_that_others_give(repository: Path) -> None:
    path = repository.parent / "shared" / "data" / "arkit_blendshapes.csv"
    if not path.is_file():
        pytest.skip(f"the table of shapes is not on this machine (expected at {path})")
    with open(path, newline="", encoding="utf-8") as stream:
        published = {row["name"]: row["nearest_faps"] for row in csv.DictReader(stream)}
    numbers = {fap.name: fap.number for fap in fap_table()}
    for shape, rows in direct_table().items():
        for row in rows:
            number, sign = numbers[row.fap], "+" if row.amount > 0 else "-"
            other = "-" if sign == "+" else "+"
            if row.is_key:
                assert f" {number}{other}" not in f" {published[shape]}", (shape, number)


def test_left_and_right_are_mirrored() -> None:
    for shape, rows in direct_table().items():
        other = other_side_of(shape)
        if other is None or shape.startswith("eyeLook"):
            continue
        here = {row.fap: row.amount for row in rows}
        there = {row.fap: row.amount for row in direct_table()[other]}
        for fap, amount in here.items():
            mirrored = -amount if fap in ("shift_jaw", "shift_tongue_tip") else amount
            wanted = there.get(other_side(fap) or fap)
            assert wanted == pytest.approx(mirrored, abs=0.02 * abs(amount) + 3), (shape, fap)


def test_the_table_is_the_average_heads(average_head: Head) -> None:
    jacobian = shape_jacobian(average_head)
    for shape, rows in direct_table().items():
        faps = weights_to_faps(jacobian, one_frame(**{shape: 1.0}))
        for row in rows:
            if fap_by_name()[row.fap].is_rotation or row.fap.endswith("tongue_tip"):
                continue
            assert faps[row.fap][0] == pytest.approx(row.amount, abs=0.6), (shape, row.fap)


@pytest.mark.parametrize("shape", ARKIT_SHAPES)
def test_a_shape_alone_is_found_again(shape: str) -> None:
    weights = {shape: 0.6} if shape != "mouthClose" else {"jawOpen": 0.7, shape: 0.6}
    faps = direct_faps(one_frame(**weights))

    found = direct_weights(faps)

    again = direct_faps(found).values
    assert np.linalg.norm(again - faps.values) < 0.55 * np.linalg.norm(faps.values)
    if not shape.startswith(LIKE_A_SMILE):
        for name, weight in weights.items():
            assert found[name][0] == pytest.approx(weight, abs=0.1)


def test_rest_is_exactly_rest_both_ways() -> None:
    faps = direct_faps(one_frame(**dict.fromkeys(ARKIT_SHAPES, 0.0)))
    assert not faps.values.any()
    assert not direct_weights(faps).values.any()


def test_turns_of_the_head_go_both_ways() -> None:
    clip = one_frame(jawOpen=0.2, headYaw=0.3, headPitch=-0.1, headRoll=0.05)
    faps = direct_faps(clip)
    assert faps["head_yaw"][0] == pytest.approx(30000)
    back = direct_weights(faps)
    for name in ("headYaw", "headPitch", "headRoll"):
        assert back[name][0] == pytest.approx(clip[name][0])


def test_a_mouth_closes_no_further_than_its_jaw_opens() -> None:
    more = direct_faps(one_frame(jawOpen=0.3, mouthClose=0.9))
    same = direct_faps(one_frame(jawOpen=0.3, mouthClose=0.3))
    np.testing.assert_array_equal(more.values, same.values)
    found = direct_weights(one_frame(open_jaw=500.0, raise_b_midlip=2000.0))
    assert found["mouthClose"][0] <= found["jawOpen"][0]


def test_a_clip_without_weights_is_refused() -> None:
    assert not is_arkit(one_frame(open_jaw=1.0))
    with pytest.raises(InputError, match="no ARKit weights; its channels are open_jaw"):
        direct_faps(one_frame(open_jaw=1.0))


def test_the_direct_drive_moves_a_head(average_head: Head) -> None:
    drive = ShapeDrive(average_head, method="direct")
    smile = one_frame(
        raise_l_cornerlip=800.0,
        raise_l_cornerlip_o=870.0,
        stretch_l_cornerlip=140.0,
        stretch_l_cornerlip_o=150.0,
    )
    found = drive.weights(smile).clip
    assert found["mouthSmileLeft"][0] == pytest.approx(1.0, abs=0.05)
    assert found["jawOpen"][0] == 0
    moved = drive.animate(smile).vertices(0) - average_head.mesh.vertices
    corner = average_head.feature_points.index("8.3")
    assert average_head.feature_points.at(moved)[corner, 1] > 8.0
