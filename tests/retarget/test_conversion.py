"""Clips of one kind as clips of another. Truth: weights that made the FAPs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.mpeg4 import ANGLE_UNIT_RAD
from facewright.heads.head import Head
from facewright.retarget.arkit import direct_faps, direct_weights
from facewright.retarget.conversion import arkit_of, clip_kind, faps_of, has_known_shapes


@pytest.fixture(scope="module")
def shapeless(head: Head) -> Head:
    return replace(head, shape_names=(), shapes=None)


@pytest.fixture(scope="module")
def acted() -> Clip:
    t = np.arange(30) / 30
    curves = {
        "jawOpen": 0.4 * np.sin(3 * t) ** 2,
        "eyeBlinkLeft": 0.7 * np.sin(5 * t) ** 2,
        "eyeBlinkRight": 0.7 * np.sin(5 * t) ** 2,
        "mouthSmileLeft": 0.5 * np.sin(4 * t) ** 2,
        "headYaw": 0.2 * np.sin(4 * t),
        "leftEyeYaw": 0.3 * np.sin(6 * t),
    }
    return Clip(t, tuple(curves), np.stack(list(curves.values()), axis=1))


def test_kinds_are_told_by_what_is_set(head: Head, acted: Clip) -> None:
    assert clip_kind(acted) == "arkit"
    assert clip_kind(faps_of(acted, head)) == "faps"
    only_looks = Clip(acted.time_s, ("leftEyeYaw",), acted["leftEyeYaw"][:, None])
    assert clip_kind(only_looks) == "arkit"
    viseme = Clip(np.zeros(1), ("viseme.select1",), np.ones((1, 1)))
    assert clip_kind(viseme) == "faps"
    own = replace(head, shape_names=tuple(f"my_{n}" for n in head.shape_names))
    assert clip_kind(Clip(np.zeros(1), ("my_jawOpen",), np.ones((1, 1))), own) == "shapes"


def test_a_clip_without_a_known_channel_is_refused_with_what_it_has(head: Head) -> None:
    clip = Clip(np.zeros(1), tuple("abcdefg"), np.zeros((1, 7)))
    with pytest.raises(InputError, match=r"shape of head average.* a, b, c, d, e \.\.\."):
        clip_kind(clip, head)
    unset = Clip(np.zeros(1), ("open_jaw",), np.full((1, 1), np.nan))
    with pytest.raises(InputError, match="that is set"):
        faps_of(unset, head)


def test_weights_come_back_through_faps(head: Head, acted: Clip) -> None:
    back = arkit_of(faps_of(acted, head), head)

    for name in ("jawOpen", "eyeBlinkLeft", "mouthSmileLeft"):
        rms = float(np.sqrt(np.mean((back[name] - acted[name]) ** 2)))
        assert rms < 0.05, f"{name}: {rms:.3f}"
    for name in ("headYaw", "leftEyeYaw"):
        np.testing.assert_allclose(back[name], acted[name], atol=1e-9)


def test_turns_of_the_eyes_are_exact(head: Head, acted: Clip) -> None:
    faps = faps_of(acted, head)

    np.testing.assert_allclose(faps["yaw_l_eyeball"] * ANGLE_UNIT_RAD, acted["leftEyeYaw"])


@pytest.mark.parametrize("which", ["shapeless", "direct", "none"])
def test_without_shapes_or_on_request_the_table_is_taken(
    head: Head, shapeless: Head, acted: Clip, which: str
) -> None:
    chosen = {"shapeless": shapeless, "direct": head, "none": None}[which]
    faps = direct_faps(acted)

    found = arkit_of(faps, chosen, direct=which == "direct")

    truth = direct_weights(faps)
    for name in truth.channels:
        np.testing.assert_array_equal(found[name], truth[name])
    made = faps_of(acted, chosen, direct=which == "direct")
    np.testing.assert_array_equal(made["open_jaw"], faps["open_jaw"])
    assert has_known_shapes(chosen) == (which == "direct")


def test_what_is_of_the_kind_already_keeps_its_values(head: Head, acted: Clip) -> None:
    same = arkit_of(acted, head)
    for name in acted.channels:
        np.testing.assert_array_equal(same[name], acted[name])
    faps = Clip(np.zeros(1), ("open_jaw", "something"), np.ones((1, 2)))
    assert faps_of(faps, head).channels == ("open_jaw",)
