"""Gaze on the main sequence, lids that blink like lids, heads that move like heads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.datasets_synthetic.acting_curves import (
    CLOSURE,
    Layer,
    add_layers,
    saturate,
    smooth_pulse,
    smooth_step,
    wander,
)
from facewright.datasets_synthetic.acting_eyes import (
    FULL_LOOK_DEG,
    Look,
    blinks,
    draw_looks,
    eyes_of_looks,
    head_of_looks,
    look_weights,
)
from facewright.datasets_synthetic.acting_head import head_gestures, head_motion, sway_and_breath

RATE_HZ = 1000.0


def test_a_step_is_the_path_of_least_jerk() -> None:
    """Its sixth derivative is zero: it is the quintic with rest at both ends."""
    t = np.linspace(0, 1, 1001)
    step = smooth_step(t, 0.2, 0.5)
    inside = (t > 0.2) & (t < 0.7)
    quintic = np.polynomial.Polynomial.fit(t[inside], step[inside], 5)
    np.testing.assert_allclose(quintic(t[inside]), step[inside], atol=1e-12)
    for order in (1, 2):
        np.testing.assert_allclose(quintic.deriv(order)([0.2, 0.7]), 0, atol=1e-6)
    assert step[0] == 0
    assert step[-1] == 1


def test_a_pulse_rises_holds_and_falls() -> None:
    t = np.linspace(0, 1, 4001)
    pulse = smooth_pulse(t, 0.2, 0.2, 0.1, 0.25)
    assert (pulse[t <= 0.2] == 0).all()
    np.testing.assert_allclose(pulse[(t >= 0.4) & (t <= 0.5)], 1, atol=1e-12)
    np.testing.assert_allclose(pulse[t >= 0.75], 0, atol=1e-12)


def test_saturation_keeps_small_weights_and_never_passes_one() -> None:
    x = np.linspace(0, 20, 20001)
    y = saturate(x)
    np.testing.assert_array_equal(y[x <= 0.85], x[x <= 0.85])
    assert (np.diff(y) >= 0).all()
    assert y.max() <= 1
    bend = np.abs(np.diff(y, 2)) / 1e-6
    assert np.abs(np.diff(bend)).max() < 2.0  # curvature without a step (tanh'' reaches 5 here)


def test_wander_has_the_spread_it_promises() -> None:
    t = np.arange(0, 3000, 0.05)
    w = wander(np.random.default_rng(0), t, slowest_hz=0.1, fastest_hz=2.0)
    assert np.std(w) == pytest.approx(1.0, abs=0.02)
    assert np.abs(w).max() <= np.sqrt(8)
    spectrum = np.abs(np.fft.rfft(w))
    f = np.fft.rfftfreq(len(t), 0.05)
    assert spectrum[(f < 0.09) | (f > 2.1)].max() < 0.02 * spectrum.max()


def test_saccades_lie_on_the_main_sequence() -> None:
    """Peak speeds of 10° and 20°: 300 to 450°/s and 450 to 650°/s (Bahill et al. 1975)."""
    t = np.arange(0, 1, 1 / RATE_HZ)
    still = np.zeros(len(t))
    for size, low, high in ((5.0, 180, 320), (10.0, 300, 450), (20.0, 450, 650)):
        looks = (Look(0.5, size, 0.0),)
        layer = eyes_of_looks(np.random.default_rng(0), t, looks, still, still, seconds=0.0)
        yaw = layer.curves["eyeLookOutLeft"] * FULL_LOOK_DEG["Out"]
        speed = np.gradient(yaw[t > 0.45], 1 / RATE_HZ).max()
        assert low < speed < high, f"{size}°: {speed:.0f}°/s"
        assert layer.events[0].kind == "saccade"
        assert layer.events[0].amount == pytest.approx(size)


def test_both_eyes_turn_to_the_same_side() -> None:
    angle = np.array([-12.0, 0.0, 7.0])
    w = look_weights(angle, angle / 2)
    left = FULL_LOOK_DEG["Out"] * w["eyeLookOutLeft"] - FULL_LOOK_DEG["In"] * w["eyeLookInLeft"]
    right = FULL_LOOK_DEG["In"] * w["eyeLookInRight"] - FULL_LOOK_DEG["Out"] * w["eyeLookOutRight"]
    np.testing.assert_allclose(left, angle)
    np.testing.assert_allclose(right, angle)
    down = FULL_LOOK_DEG["Down"] * w["eyeLookDownLeft"] - FULL_LOOK_DEG["Up"] * w["eyeLookUpLeft"]
    np.testing.assert_allclose(down, angle / 2)


def test_eyes_undo_the_turn_of_the_head() -> None:
    t = np.arange(0, 2, 1 / RATE_HZ)
    turn = 8 * smooth_step(t, 0.5, 0.6)
    rng = np.random.default_rng
    still = eyes_of_looks(rng(1), t, (), np.zeros(len(t)), np.zeros(len(t)), seconds=2.0)
    turned = eyes_of_looks(rng(1), t, (), turn, np.zeros(len(t)), seconds=2.0)

    def yaw(layer: Layer) -> np.ndarray:
        out, into = layer.curves["eyeLookOutLeft"], layer.curves["eyeLookInLeft"]
        return np.asarray(FULL_LOOK_DEG["Out"] * out - FULL_LOOK_DEG["In"] * into)

    np.testing.assert_allclose(yaw(turned) - yaw(still), -turn, atol=1e-9)


def test_the_head_goes_along_with_large_looks_only() -> None:
    t = np.arange(0, 2, 1 / RATE_HZ)
    small, large = (
        head_of_looks(np.random.default_rng(0), t, (Look(0.5, yaw, 0.0),)) for yaw in (6.0, 20.0)
    )
    assert (small.curves["head.yaw"] == 0).all()
    assert 5 < large.curves["head.yaw"][-1] < 15
    begins = t[np.argmax(large.curves["head.yaw"] > 0.01)]
    assert begins > 0.53  # later than the eyes


def test_looks_stay_within_what_eyes_and_head_reach() -> None:
    looks = draw_looks(np.random.default_rng(0), seconds=500.0, fixation_s=(0.3, 2.0))
    assert max(abs(look.yaw) for look in looks) <= 24
    assert sum(look.yaw == 0 for look in looks) / len(looks) == pytest.approx(0.35, abs=0.08)
    gaps = np.diff([look.start_s for look in looks])
    assert gaps.min() >= 0.3
    assert gaps.max() <= 2.0


def test_blinks_never_overlap_and_touch_exactly_one() -> None:
    t = np.arange(0, 120, 1 / 240)
    looks = draw_looks(np.random.default_rng(5), seconds=120.0, fixation_s=(0.3, 2.0))
    layer = blinks(np.random.default_rng(5), t, seconds=120.0, looks=looks)
    starts = np.array([e.start_s for e in layer.events])
    assert np.diff(starts).min() >= 0.7
    assert layer.curves[CLOSURE].max() == 1
    assert all(0.25 < e.end_s - e.start_s < 0.5 for e in layer.events)


def test_head_motion_is_a_turn_about_the_neck_and_a_shift() -> None:
    """Yaw to the left, pitch down, roll to the right, by SciPy's intrinsic YXZ angles."""
    t = np.array([0.0, 1.0, 2.0])
    curves = {
        "head.yaw": np.array([0, 20.0, 5.0]),
        "head.pitch": np.array([0, 10.0, -3.0]),
        "head.roll": np.array([0, -5.0, 8.0]),
        "head.y": np.array([0, 0.0, 4.0]),
    }
    pivot = np.array([1.0, -60.0, -85.0])

    motion = head_motion(t, Layer(curves), pivot)

    angles = np.stack([curves[f"head.{n}"] for n in ("yaw", "pitch", "roll")], axis=1)
    truth = Rotation.from_euler("YXZ", angles, degrees=True)
    np.testing.assert_allclose(motion.rotation, truth.as_matrix(), atol=1e-12)
    at_pivot = motion.world_from_head(pivot[None])[:, 0]
    np.testing.assert_allclose(at_pivot, pivot + [[0, 0, 0], [0, 0, 0], [0, 4.0, 0]], atol=1e-12)


def test_head_gestures_do_what_they_are_called() -> None:
    t = np.arange(0, 60, 1 / 240)
    layer = head_gestures(np.random.default_rng(2), t, seconds=60.0, pause_s=(0.3, 0.5))
    curve_of = {"nod": "head.pitch", "shake": "head.yaw", "tilt": "head.roll"}
    assert {e.kind for e in layer.events} == set(curve_of)
    for event in layer.events:
        during = (t > event.start_s) & (t < event.end_s)
        moved = np.abs(layer.curves[curve_of[event.kind]][during]).max()
        assert 0.4 * event.amount < moved <= event.amount * (1 + 1e-9)
        for other in set(curve_of.values()) - {curve_of[event.kind]}:
            assert np.abs(layer.curves[other][during]).max() == 0
    for curve in layer.curves.values():
        assert np.abs(np.gradient(curve, 1 / 240)).max() < 130  # °/s


def test_breath_lifts_the_head_at_the_pace_of_rest() -> None:
    t = np.arange(0, 400, 1 / 60)
    layer = sway_and_breath(np.random.default_rng(0), t)
    nose = layer.curves["noseSneerLeft"][t > 10]
    spectrum = np.abs(np.fft.rfft(nose - nose.mean()))
    assert 0.2 <= np.fft.rfftfreq(len(nose), 1 / 60)[spectrum.argmax()] <= 0.3  # 12 to 18 a minute
    assert nose.min() >= 0
    assert nose.max() <= 0.02 + 1e-12


def test_layers_add_and_events_come_in_order() -> None:
    t = np.arange(0, 3, 1 / 240)
    looks = (Look(1.0, 20.0, 0.0), Look(2.0, 0.0, 0.0))
    one = head_of_looks(np.random.default_rng(0), t, looks)
    both = add_layers([one, Layer({"head.yaw": np.ones(len(t))}), one])
    np.testing.assert_allclose(both.curves["head.yaw"], 2 * one.curves["head.yaw"] + 1)
    starts = [e.start_s for e in both.events]
    assert len(starts) == 4
    assert starts == sorted(starts)
