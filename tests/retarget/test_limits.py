from __future__ import annotations

import logging

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.mpeg4 import fap_by_name, fap_table
from facewright.heads.expressions import EXPRESSIONS, expression_weights, viseme_weights
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.retarget.arkit import direct_faps, direct_table
from facewright.retarget.drive import HeadDrive
from facewright.retarget.jaw import jaw_motion
from facewright.retarget.limits import KNEE, FapRange, HeadLimits, bend


def clip_mm(head: Head, **mm: float) -> Clip:
    values = [v / head.fapu.unit(fap_by_name()[n]) for n, v in mm.items()]
    return Clip(np.zeros(1), tuple(mm), np.array([values]))


@pytest.mark.parametrize("seed", range(20))
def test_bending_keeps_order_range_and_what_is_within(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = -rng.choice([0.0, 3.0, 400.0]), rng.choice([1.0, 50.0, 500.0])
    values = np.sort(np.append(rng.uniform(-3000, 3000, 300), [low, 0.0, high, 1e7, -1e7]))
    bent = bend(values, FapRange(low, high))
    assert (np.diff(bent) >= 0).all()
    assert low <= bent.min() and bent.max() <= high
    exact = (KNEE * low <= values) & (values <= KNEE * high)
    assert exact.any()
    np.testing.assert_array_equal(bent[exact], values[exact])


def test_the_bend_begins_without_a_corner() -> None:
    x = np.linspace(-200, 200, 4001)
    slope = np.gradient(bend(x, FapRange(-100.0, 50.0)), x)
    assert np.abs(np.diff(slope)).max() < 0.02
    assert slope.max() == pytest.approx(1.0) and slope.min() >= 0


def test_a_range_must_hold_rest() -> None:
    with pytest.raises(ValueError, match="holds 0"):
        FapRange(1.0, 2.0)


def test_what_people_do_is_followed_exactly(head: Head) -> None:
    """All sculpted shapes, expressions and visemes stay below the knee of every range."""
    limits = HeadLimits(head)
    poses = [{shape: 1.0} for shape in direct_table() if shape != "mouthClose"]
    poses.append({"jawOpen": 1.0, "mouthClose": 1.0})  # its corrective
    poses += [expression_weights(e) for e in EXPRESSIONS] + [
        viseme_weights(v) for v in range(1, 15)
    ]
    for weights in poses:
        clip = direct_faps(Clip(np.zeros(1), tuple(weights), np.array([[*weights.values()]])))
        faps = {n: clip[n] for n in clip.channels}
        bent = limits.bent(faps)
        for name, values in faps.items():
            assert bent[name][0] == values[0], f"{weights}: {name}"


def test_every_range_is_in_proportion_to_the_face(head: Head) -> None:
    other = make_head(random_identity(np.random.default_rng(4)))
    a, b = HeadLimits(head).ranges, HeadLimits(other).ranges
    assert set(a) == set(b)
    for name in set(a) - {"open_jaw"}:
        assert (a[name].low, a[name].high) == (b[name].low, b[name].high)
    covered = {fap_by_name()[n].number for n in a}
    # 1 and 2 are no displacements, lids stop where they meet, the tongue's roll is not shown
    assert {f.number for f in fap_table()} - covered == {1, 2, 19, 20, 21, 22, 47}


@pytest.mark.parametrize("seed", [None, 2, 3])
def test_the_jaw_stops_at_its_joints_limit(seed: int | None, head: Head) -> None:
    if seed is not None:
        head = make_head(random_identity(np.random.default_rng(seed)))
    unit = head.fapu.unit(fap_by_name()["open_jaw"])
    asked = np.array([-30.0, 0.0, 10.0, 15.0, 60.0, 500.0]) / unit
    faps = HeadLimits(head).bent({"open_jaw": asked})
    angle = 2 * np.arcsin(jaw_motion(head, faps, 6).rotation[:, 1])
    np.testing.assert_allclose(angle[:2], 0.0, atol=1e-12)
    assert (np.diff(angle[1:]) > 0).all()
    _, y, z = head.points["2.1"] - head.jaw_pivot
    below_hinge = 180 - np.degrees(np.arctan2(z, y))  # the chin comes no lower
    assert np.degrees(angle[-1]) == pytest.approx(min(38.0, below_hinge), abs=0.1)
    assert angle[-1] > np.radians(30)
    assert asked[3] == faps["open_jaw"][3]


def test_what_is_beyond_is_said(
    head: Head, drive: HeadDrive, caplog: pytest.LogCaptureFixture
) -> None:
    clip = clip_mm(head, raise_l_i_eyebrow=90.0, open_jaw=10.0, yaw_l_eyeball=0.0)
    with caplog.at_level(logging.WARNING, logger="facewright"):
        drive.feature_point_displacements(clip)
    (message,) = [r.getMessage() for r in caplog.records]
    assert (
        "more than head average can do: raise_l_i_eyebrow 1796, shown as 359 (1 frame)" in message
    )
    assert "open_jaw" not in message


def test_what_is_within_is_not_remarked_on(
    head: Head, drive: HeadDrive, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, logger="facewright"):
        drive.feature_point_displacements(clip_mm(head, raise_l_i_eyebrow=9.0, open_jaw=25.0))
    assert not caplog.records
