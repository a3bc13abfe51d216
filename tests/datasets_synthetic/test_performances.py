"""Performances: smooth, still at first, and blinks that close."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.datasets_synthetic.performances import (
    BROW_GESTURES,
    MOUTH_GESTURES,
    NEUTRAL_S,
    SYLLABLES,
    Performance,
    random_performance,
    smooth_pulse,
)
from facewright.heads.head import Head

Floats = NDArray[np.float64]
RATE_HZ = 60.0
LIDS = (("3.1", "3.3", "eyeBlinkLeft"), ("3.2", "3.4", "eyeBlinkRight"))


@pytest.fixture(scope="module")
def performances(people: tuple[Head, ...]) -> list[tuple[Head, Performance]]:
    return [
        (
            head,
            random_performance(np.random.default_rng(seed), head, seconds=4.0, rate_hz=RATE_HZ),
        )
        for seed, head in enumerate(people[:8])
    ]


def point_paths(head: Head, performance: Performance, names: tuple[str, ...]) -> Floats:
    """(T, N, 3) mm, head frame: the neutral points and each shape's share in their motion."""
    assert head.shapes is not None
    chosen = head.feature_points.select(names)
    moved = np.einsum("nc,sncx->snx", chosen.barycentric, head.shapes[:, chosen.corners])
    rest = np.stack([head.points[n] for n in names])
    return np.asarray(rest + np.einsum("ts,snx->tnx", performance.weights.values, moved))


def test_a_pulse_rises_holds_and_falls_smoothly() -> None:
    t = np.linspace(0, 1, 4001)
    pulse = smooth_pulse(t, 0.2, 0.2, 0.1, 0.25)

    assert (pulse[t <= 0.2] == 0).all()
    np.testing.assert_allclose(pulse[(t >= 0.4) & (t <= 0.5)], 1, atol=1e-12)
    np.testing.assert_allclose(pulse[t >= 0.75], 0, atol=1e-12)
    assert pulse.min() > -1e-12
    assert pulse.max() < 1 + 1e-12
    acceleration = np.diff(pulse, 2) * 4000**2
    assert np.abs(np.diff(acceleration)).max() < 2e-3 * 4000  # no steps: 60 / 0.2³ per s³


def test_it_begins_with_the_neutral_face_at_rest(
    performances: list[tuple[Head, Performance]],
) -> None:
    for _, performance in performances:
        still = performance.weights.time_s <= NEUTRAL_S
        assert still.sum() >= 18
        assert (performance.weights.values[still] == 0).all()
        np.testing.assert_array_equal(
            performance.head_motion.quaternion[still], [[1.0, 0, 0, 0]] * still.sum()
        )
        assert np.abs(performance.head_motion.translation[still]).max() < 1e-12


def test_weights_are_shares_and_channels_are_the_heads(
    performances: list[tuple[Head, Performance]],
) -> None:
    for head, performance in performances:
        weights = performance.weights
        assert weights.channels == head.shape_names
        assert weights.rate_hz == RATE_HZ
        assert len(weights.time_s) == 240
        assert weights.values.min() >= 0
        assert weights.values.max() <= 1.0 + 1e-9
        assert (weights.values.max(axis=0) > 0.1).sum() > 15  # a lot goes on


def test_nothing_jumps(performances: list[tuple[Head, Performance]]) -> None:
    """Speech and blinks are the fastest things faces do."""
    for head, performance in performances:
        names = ("2.1", "8.1", "8.2", "8.3", "4.3", "5.1")
        face = np.diff(point_paths(head, performance, names), axis=0) * RATE_HZ
        lids = np.diff(point_paths(head, performance, ("3.1", "3.3")), axis=0) * RATE_HZ
        assert np.linalg.norm(face, axis=2).max() < 450  # mm/s
        assert np.linalg.norm(lids, axis=2).max() < 400
        motion = performance.head_motion
        turn = np.abs((motion.quaternion[1:] * motion.quaternion[:-1]).sum(axis=1))
        assert np.rad2deg(2 * np.arccos(np.clip(turn, 0, 1))).max() * RATE_HZ < 90  # °/s
        assert np.linalg.norm(np.diff(motion.translation, axis=0), axis=1).max() * RATE_HZ < 300


def test_blinks_close_the_lids_and_do_not_cross_them(
    performances: list[tuple[Head, Performance]],
) -> None:
    for head, performance in performances:
        for upper, lower, shape in LIDS:
            paths = point_paths(head, performance, (upper, lower))
            gap = paths[:, 0, 1] - paths[:, 1, 1]
            assert gap.min() > -0.3, head.name
            blink = performance.weights[shape]
            peaks = [
                i
                for i in range(1, len(blink) - 1)
                if blink[i] > 0.3 and blink[i] >= blink[i - 1] and blink[i] > blink[i + 1]
            ]
            assert peaks
            # a blink of 30 ms of closure at 60 frames/s has a frame that is closed
            assert min(gap[max(0, i - 2) : i + 3].min() for i in peaks) < 0.3


def test_both_eyes_blink_together(performances: list[tuple[Head, Performance]]) -> None:
    for _, performance in performances:
        left, right = performance.weights["eyeBlinkLeft"], performance.weights["eyeBlinkRight"]
        np.testing.assert_array_equal(left > 0, right > 0)


def test_the_same_seed_gives_the_same_performance(average_head: Head) -> None:
    a, b, c = (
        random_performance(np.random.default_rng(s), average_head, seconds=2.0, rate_hz=30)
        for s in (1, 1, 2)
    )

    np.testing.assert_array_equal(a.weights.values, b.weights.values)
    np.testing.assert_array_equal(a.head_motion.quaternion, b.head_motion.quaternion)
    assert not np.array_equal(a.weights.values, c.weights.values)


def test_gestures_name_shapes_that_heads_have(average_head: Head) -> None:
    for gesture in (*MOUTH_GESTURES, *SYLLABLES, *BROW_GESTURES):
        for name in gesture:
            sides = [name.replace("L/R", side) for side in ("Left", "Right")]
            assert set(sides) <= set(average_head.shape_names), name


def test_the_head_turns_about_the_neck(performances: list[tuple[Head, Performance]]) -> None:
    for head, performance in performances:
        motion = performance.head_motion
        pivot = motion.world_from_head(head.neck_pivot[None])[:, 0]
        crown = motion.world_from_head(head.points["11.4"][None])[:, 0]
        assert np.ptp(pivot, axis=0).max() < np.ptp(crown, axis=0).max() + 30
        assert np.linalg.norm(pivot - head.neck_pivot, axis=1).max() < 60
