"""The judge judged: perfect estimates, and estimates spoilt by a known amount."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.cli.evaluation import (
    Stage,
    centre_errors,
    evaluate,
    fap_errors_percent,
    identity_switches,
    load_truth,
    position_errors_mm,
    rotation_errors_rad,
)
from facewright.core.clip import Clip
from facewright.core.head_motion import HeadMotion
from facewright.core.mpeg4 import Fapu, fap_by_name, fap_table
from facewright.core.trajectories import Source, Trajectories
from facewright.core.video_writer import VideoWriter
from facewright.datasets_synthetic.film import FilmedTake
from facewright.tracking.performance import Neutral, TrackedPerformance

Truth = dict[str, NDArray[Any]]


@pytest.fixture(scope="module")
def truth(filmed_take: FilmedTake) -> Truth:
    return load_truth(filmed_take.truth)


def labels(truth: Truth) -> tuple[str, ...]:
    return tuple(str(n) for n in truth["marker_names"])


def perfect_trajectories(truth: Truth) -> Trajectories:
    return Trajectories(truth["time_s"], labels(truth), truth["marker_positions"])


def perfect_motion(truth: Truth) -> HeadMotion:
    return HeadMotion(truth["time_s"], truth["head_quaternion"], truth["head_translation"])


def perfect_faps(truth: Truth) -> Clip:
    known = [f for f in fap_table() if not np.isnan(truth["faps"][:, f.number - 1]).all()]
    values = truth["faps"][:, [f.number - 1 for f in known]]
    return Clip(truth["time_s"], tuple(f.name for f in known), values)


def perfect_performance(truth: Truth) -> TrackedPerformance:
    neutral = Neutral(
        np.arange(1), truth["marker_positions"][0], np.eye(3), np.zeros(3), "world", 0.0
    )
    fapu = Fapu(*(float(x) for x in truth["fapu"]))
    motion = perfect_motion(truth)
    return TrackedPerformance(neutral, fapu, "measured", motion, motion, perfect_faps(truth), ())


def test_the_truth_has_no_error(truth: Truth) -> None:
    assert position_errors_mm(perfect_trajectories(truth), truth).max() == 0
    assert identity_switches(perfect_trajectories(truth), truth) == 0
    assert rotation_errors_rad(perfect_motion(truth), truth).max() < 1e-7
    percent = fap_errors_percent(perfect_faps(truth), truth)
    assert len(percent) >= 55
    assert max(percent.values()) < 1e-9


def test_the_truth_passes_every_stage(filmed_take: FilmedTake, truth: Truth) -> None:
    stages = evaluate(
        filmed_take.videos, truth, perfect_trajectories(truth), perfect_performance(truth),
        centre_step=10,
    )  # fmt: skip

    assert all(stage.passed for stage in stages)
    values = {(s.stage, s.quantity): s.value for s in stages}
    assert 0.005 < values["dots", "centre in the image, RMS"] < 0.1  # these come from the videos
    zero = [v for (stage, _), v in values.items() if stage in ("labels", "head", "markers", "FAPs")]
    assert len(zero) >= 8
    assert max(zero) < 1e-4
    assert {s.limit for s in stages} >= {None, 0, 0.10, 2, 5}


def test_a_known_offset_is_found_again(filmed_take: FilmedTake, truth: Truth) -> None:
    rng = np.random.default_rng(0)
    way = rng.normal(size=truth["marker_positions"].shape)
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    off = truth["marker_positions"] + 0.25 * way
    source = np.ones(off.shape[:2], np.uint8)
    source[5:8, 3] = Source.INTERPOLATED
    source[9, 4] = Source.MISSING
    off[5:8, 3] += 3.0 * way[5:8, 3]  # 3.25 mm off, but put into a gap
    off[9, 4] = np.nan
    given = Trajectories(truth["time_s"], labels(truth), off, source=source)

    errors = position_errors_mm(given, truth)
    stages = evaluate(
        filmed_take.videos[:1], truth, given, perfect_performance(truth), centre_step=30
    )

    np.testing.assert_allclose(np.delete(errors, [3, 4], axis=1), 0.25, atol=1e-12)
    values = {s.quantity: s for s in stages}
    assert values["position in space, RMS"].value == pytest.approx(0.25)
    assert not values["position in space, RMS"].passed
    assert values["positions put into gaps, RMS"].value == pytest.approx(3.25)
    n = errors.size
    assert values["samples without position"].value == pytest.approx(100 / n)


def test_two_markers_exchanged_are_switches_in_every_frame(truth: Truth) -> None:
    p = np.array(truth["marker_positions"])
    p[10:14, [2, 7]] = p[10:14, [7, 2]]

    assert identity_switches(Trajectories(truth["time_s"], labels(truth), p), truth) == 8


def test_unseen_samples_are_no_switches(truth: Truth) -> None:
    p = np.array(truth["marker_positions"])
    p[::2, 5] = np.nan
    p[4] = np.nan

    assert identity_switches(Trajectories(truth["time_s"], labels(truth), p), truth) == 0


def test_the_order_of_the_markers_does_not_matter(truth: Truth) -> None:
    order = np.random.default_rng(1).permutation(30)
    names = tuple(labels(truth)[i] for i in order)
    given = Trajectories(truth["time_s"], names, truth["marker_positions"][:, order])

    assert position_errors_mm(given, truth).max() == 0
    assert identity_switches(given, truth) == 0


@pytest.mark.parametrize("angle_deg", [0.05, 2.0, 89.0, 120.0, 180.0])
def test_a_known_turn_is_found_again(truth: Truth, angle_deg: float) -> None:
    true = Rotation.from_quat(truth["head_quaternion"], scalar_first=True)
    axis = np.array([0.48, -0.6, 0.64])
    off = true * Rotation.from_rotvec(np.deg2rad(angle_deg) * axis)
    given = HeadMotion(truth["time_s"], off.as_quat(scalar_first=True), truth["head_translation"])

    errors = np.rad2deg(rotation_errors_rad(given, truth))

    np.testing.assert_allclose(errors, angle_deg, atol=1e-5)


def test_an_unknown_turn_is_nan(truth: Truth) -> None:
    q = np.array(truth["head_quaternion"])
    q[3] = np.nan
    given = HeadMotion(truth["time_s"], q, truth["head_translation"])

    assert np.flatnonzero(np.isnan(rotation_errors_rad(given, truth))).tolist() == [3]


def test_fap_errors_are_shares_of_the_used_range_but_of_3_mm_at_least(truth: Truth) -> None:
    fapu = Fapu(*(float(x) for x in truth["fapu"]))
    T = len(truth["time_s"])
    made = {k: np.array(v) for k, v in truth.items()}
    jaw, yaw, nose = (fap_by_name()[n] for n in ("open_jaw", "head_yaw", "stretch_l_nose"))
    ramp = np.linspace(0, 1, T)
    made["faps"][:, jaw.number - 1] = 20.0 / fapu.unit(jaw) * ramp  # 20 mm
    made["faps"][:, yaw.number - 1] = np.deg2rad(1.0) / fapu.unit(yaw) * ramp
    made["faps"][:, nose.number - 1] = 0.5 / fapu.unit(nose) * ramp
    off = {jaw: 0.5 / fapu.unit(jaw), yaw: np.deg2rad(0.3) / fapu.unit(yaw)}
    off[nose] = 0.06 / fapu.unit(nose)
    values = np.stack([made["faps"][:, f.number - 1] + d for f, d in off.items()], axis=1)
    values[2, 0] = np.nan  # not set: not judged
    clip = Clip(truth["time_s"], tuple(f.name for f in off), values)

    percent = fap_errors_percent(clip, made)

    spread = float(np.percentile(ramp, 99) - np.percentile(ramp, 1))
    assert percent["open_jaw"] == pytest.approx(100 * 0.5 / (20 * spread))
    assert percent["head_yaw"] == pytest.approx(100 * 0.3 / 3)
    assert percent["stretch_l_nose"] == pytest.approx(100 * 0.06 / 3)


def test_faps_that_the_actor_lacks_are_not_judged(truth: Truth) -> None:
    made = {k: np.array(v) for k, v in truth.items()}
    made["faps"][:, fap_by_name()["open_jaw"].number - 1] = np.nan

    assert "open_jaw" not in fap_errors_percent(perfect_faps(truth), made)


def test_approximated_faps_are_told_apart(filmed_take: FilmedTake, truth: Truth) -> None:
    faps = perfect_faps(truth)
    values = np.array(faps.values)
    i = faps.channels.index("lower_t_midlip")
    values[:, i] += 5000.0
    spoilt = replace(
        perfect_performance(truth),
        faps=Clip(faps.time_s, faps.channels, values),
        approximated=("lower_t_midlip",),
    )

    stages = evaluate(
        filmed_take.videos[:1], truth, perfect_trajectories(truth), spoilt, centre_step=30
    )

    values_by = {s.quantity: s.value for s in stages}
    assert values_by["tracked points, worst RMS of used range"] < 1e-6
    assert values_by["inner lip after outer, median RMS"] > 100


def test_centre_errors_are_found_again_in_a_drawn_video(truth: Truth, tmp_path: Path) -> None:
    """Discs drawn at the true places but for 0.4 px to the right; one is not drawn at all."""
    made = {k: np.array(v) for k, v in truth.items()}
    n = 3
    pixels = np.zeros((n, 4, 6, 2))
    pixels[..., 0] = 40.3 + 40 * np.arange(6)
    pixels[..., 1] = 50.6
    made |= {"marker_pixels": pixels, "marker_visible": np.ones((n, 4, 6))}
    made["marker_visible"][:, :, 0] = 0.5  # hidden ones are not judged
    y, x = np.mgrid[:100, :300]
    path = tmp_path / "cam1.mp4"
    with VideoWriter(path, (300, 100), 30, crf=1) as writer:
        for t in range(n):
            level = np.full(x.shape, 30.0)
            for m in range(5):
                distance = np.hypot(x - pixels[t, 1, m, 0] - 0.4, y - pixels[t, 1, m, 1])
                level += 190 * np.clip(4.5 - distance, 0, 1)
            writer.write(np.clip(np.rint(level), 0, 255).astype(np.uint8))

    errors = centre_errors([path], made)
    some = centre_errors([path], made, step=2)

    assert errors.shape == (n * 5, 2)
    lost = np.isnan(errors[:, 0])
    assert lost.sum() == n  # the one that is not there
    np.testing.assert_allclose(errors[~lost], [[0.4, 0.0]] * (n * 4), atol=0.05)
    assert some.shape == (2 * 5, 2)


def test_a_stage_passes_up_to_its_limit() -> None:
    assert Stage("a", "b", "px", 0.1, 0.1).passed
    assert not Stage("a", "b", "px", 0.11, 0.1).passed
    assert Stage("a", "b", "px", 0.11).passed
    assert Stage("a", "speed", "fps", 130, 120, at_least=True).passed
    assert not Stage("a", "speed", "fps", 110, 120, at_least=True).passed
    assert not Stage("a", "b", "px", float("nan"), 0.1).passed
    assert Stage("a", "b", "px", 0.5, 0.1).as_dict() == {
        "stage": "a", "quantity": "b", "unit": "px", "value": 0.5, "limit": 0.1, "passed": False,
    }  # fmt: skip
