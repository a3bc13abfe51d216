from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.heads.face_landmarks import N_LANDMARKS
from facewright.tracking.landmark_filter import LandmarkMeasurements, filter_landmarks
from facewright.tracking.landmark_regions import IS_EYE, IS_QUICK, QUICK_REGIONS

Floats = NDArray[np.float64]
T = 120
TIME_S = np.arange(T) / 30.0
JITTER_PX = 0.3
FLOW_PX = 0.05


def waving(rng: np.random.Generator) -> Floats:
    """Points that go round in ellipses of their own, (T, 478, 2) px, up to 3 Hz."""
    phase = 2 * np.pi * rng.uniform(0.3, 3.0, N_LANDMARKS) * TIME_S[:, None]
    start = rng.uniform(100, 400, (N_LANDMARKS, 2))
    swing = rng.uniform(2, 10, (N_LANDMARKS, 2))
    return np.asarray(start + swing * np.stack([np.cos(phase), np.sin(phase)], axis=2))


def seen_of(truth: Floats, rng: np.random.Generator) -> LandmarkMeasurements:
    """Jittering network, nearly exact flow, no template; 2 px of the picture in one rectified."""
    step = np.diff(truth, axis=0, prepend=truth[:1])
    return LandmarkMeasurements(
        TIME_S,
        np.full(T, 2.0),
        truth + rng.normal(scale=JITTER_PX, size=truth.shape),
        step + rng.normal(scale=FLOW_PX, size=truth.shape),
        np.full(truth.shape[:2], FLOW_PX),
        np.full(truth.shape, np.nan),
        np.full(truth.shape[:2], np.nan),
        np.ones(T),
    )


def leaning(rng: np.random.Generator, sd_px: float, lasts_s: float) -> Floats:
    """Slow errors (T, 478, 2) px: first-order, stationary."""
    rho = np.exp(-1 / 30 / lasts_s)
    found = np.zeros((T, N_LANDMARKS, 2))
    found[0] = rng.normal(scale=sd_px, size=found[0].shape)
    for t in range(1, T):
        fresh = rng.normal(scale=sd_px * np.sqrt(1 - rho**2), size=found[0].shape)
        found[t] = rho * found[t - 1] + fresh
    return found


def test_flow_carries_motion_so_that_jitter_is_taken_away_without_lag() -> None:
    rng = np.random.default_rng(1)
    truth = waving(rng)

    points, _ = filter_landmarks(seen_of(truth, rng))

    off = (points - truth)[10:-10, ~IS_QUICK]
    left = np.diff(off, 2, axis=0).std() / np.sqrt(6)  # of white noise this is its deviation
    assert left < 0.15 * JITTER_PX
    later = np.gradient(truth, axis=0)[10:-10, ~IS_QUICK]
    lag_frames = -(off * later).sum() / (later**2).sum()
    assert abs(lag_frames) < 0.01


def test_stated_deviations_are_those_of_the_errors() -> None:
    rng = np.random.default_rng(6)
    truth = waving(rng)
    seen = seen_of(truth, rng)
    seen = replace(seen, network=seen.network + leaning(rng, 1.4, 0.5))  # 0.7 px rectified

    points, sd = filter_landmarks(seen)

    skin = ~IS_QUICK
    found = np.sqrt(((points - truth)[20:-20, skin] ** 2).mean())
    lasting = 0.27 * 2.0  # stated besides: what this simulation does not have
    stated = np.sqrt((sd[20:-20, skin] ** 2 - lasting**2).mean())
    assert stated == pytest.approx(found, rel=0.1)
    assert found < 0.5 * np.sqrt(((seen.network - truth)[:, skin] ** 2).mean())


def test_a_lid_that_flow_does_not_see_is_followed_at_once() -> None:
    rng = np.random.default_rng(2)
    truth = np.tile(rng.uniform(100, 400, (1, N_LANDMARKS, 2)), (T, 1, 1))
    seen = seen_of(truth, rng)
    upper = list(QUICK_REGIONS["lid_right_upper"])
    network = seen.network.copy()
    network[60:63, upper, 1] += 12.0  # shut for three frames; flow says nothing

    points, _ = filter_landmarks(replace(seen, network=network))

    down = points[:, upper, 1] - truth[:, upper, 1]
    assert down[60:63].mean(axis=1).min() > 0.9 * 12.0
    assert np.abs(down[[57, 65]]).mean() < 1.0
    others = np.delete(np.arange(N_LANDMARKS), upper)
    assert np.abs(points[55:70, others] - truth[55:70, others]).max() < 1.0


def test_a_template_takes_away_how_the_network_leans() -> None:
    rng = np.random.default_rng(3)
    truth = waving(rng)
    seen = seen_of(truth, rng)
    leans = replace(seen, network=seen.network + leaning(rng, 2.0, 1.5))
    template = truth + rng.normal(scale=0.2, size=truth.shape)
    helped = replace(leans, template=template, template_sd=np.full(truth.shape[:2], 0.2))

    without, _ = filter_landmarks(leans)
    with_template, _ = filter_landmarks(helped)

    skin = ~IS_QUICK
    # over time: a template stands where the network does on average
    assert (with_template - truth)[:, skin].std(axis=0).mean() < 0.08
    assert (without - truth)[:, skin].std(axis=0).mean() > 0.15
    # eyes change their looks: no template is believed there
    np.testing.assert_array_equal(with_template[:, IS_EYE], without[:, IS_EYE])


def test_a_patch_found_in_a_wrong_place_is_not_believed() -> None:
    rng = np.random.default_rng(4)
    truth = waving(rng)
    seen = seen_of(truth, rng)
    template = truth.copy()
    template[50:60] += 15.0
    wrong = replace(seen, template=template, template_sd=np.full(truth.shape[:2], 0.2))

    points, _ = filter_landmarks(wrong)

    assert np.abs(points[50:60, ~IS_QUICK] - truth[50:60, ~IS_QUICK]).max() < 1.5


def test_deviations_grow_in_a_gap_and_shrink_after_it() -> None:
    rng = np.random.default_rng(5)
    truth = waving(rng)
    seen = seen_of(truth, rng)
    network, step_sd = seen.network.copy(), seen.step_sd.copy()
    network[50:57], step_sd[50:58] = np.nan, np.inf
    gone = replace(seen, network=network, step_sd=step_sd)

    _, sd = filter_landmarks(gone)

    typical = np.median(sd, axis=1)
    assert typical[53] > 1.5 * typical[40]
    assert typical[70] == pytest.approx(typical[40], rel=0.05)


def test_long_takes_are_filtered_some_landmarks_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = seen_of(waving(np.random.default_rng(7)), np.random.default_rng(8))
    whole = filter_landmarks(seen)
    monkeypatch.setattr("facewright.tracking.landmark_filter._FRAMES_AT_ONCE", 30)

    parts = filter_landmarks(seen)

    np.testing.assert_array_equal(whole[0], parts[0])
    np.testing.assert_array_equal(whole[1], parts[1])
