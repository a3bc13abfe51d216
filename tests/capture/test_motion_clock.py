"""Motions that tell an offset, and motions that do not and must not seem to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.synchronise import ClockFit, synchronise_motion
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rigid import Rigid

Floats = NDArray[np.float64]
Course = Callable[[Floats], Floats]
FRAME_S = 1 / 60
CORNERS = parse_board("chessboard:9x6:25").object_points()
K = np.array([[1100.0, 0, 640.0], [0, 1100.0, 360.0], [0, 0, 1]])
AIM = np.array([0.0, 0, 700.0])


def frames(n: int, late_s: float = 0.0) -> Floats:
    """Times of frames, (n,) s."""
    return np.asarray(np.arange(n) * FRAME_S + late_s, dtype=np.float64)


def waving(rng: np.random.Generator, slowest: float, fastest: float, n: int = 4) -> Course:
    """A point's course, (T,) s → (T, 2) px: sines of so many radians a second."""
    rates, phases = rng.uniform(slowest, fastest, (2, n)), rng.uniform(0, 6, (2, n))
    return lambda t: np.sin(t[:, None, None] * rates + phases).sum(axis=2) * 60


def fitted(
    seed: int, a: Course, b: Course, seconds: float, noise: float = 0.1
) -> tuple[ClockFit, float]:
    """What is found for two courses, and the true offset."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-0.5, 0.5)
    n = round(seconds / FRAME_S)
    ta, tb = frames(n), frames(n, rng.uniform(0, FRAME_S))
    seen_a = a(ta) + rng.normal(0, noise, (len(ta), 2))
    seen_b = b(frames(n, tb[0] - offset)) @ [[0.8, 0.3], [-0.4, 0.9]] + rng.normal(
        0, noise, (len(tb), 2)
    )
    return synchronise_motion(ta, seen_a, tb, seen_b), offset


@pytest.mark.parametrize(
    ("seconds", "rates", "told"), [(2.0, (2, 10), 9), (5.0, (2, 10), 10), (5.0, (0.5, 2.5), 8)]
)
def test_one_motion_seen_twice_gives_its_offset(
    seconds: float, rates: tuple[float, float], told: int
) -> None:
    off, z = [], []
    for seed in range(10):
        course = waving(np.random.default_rng(seed), *rates)
        try:
            fit, offset = fitted(seed, course, course, seconds)
        except InputError:
            continue  # some are short of bends
        off.append(fit.offset_s - offset)
        z.append(off[-1] / fit.offset_sd_s)

    assert len(off) >= told
    assert np.abs(off).max() < 0.05 * FRAME_S
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.7


@pytest.mark.parametrize("rates", [(2, 10), (0.5, 2.5), (0.1, 0.5)])
@pytest.mark.parametrize("seconds", [1.0, 2.0, 5.0])
def test_motions_that_are_not_the_same_get_no_offset(
    seconds: float, rates: tuple[float, float]
) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        with pytest.raises(InputError, match=r"about as well|too short|largest overlap|too slow"):
            fitted(seed, waving(rng, *rates), waving(rng, *rates), seconds)


def test_a_motion_that_repeats_itself_gets_no_offset() -> None:
    def circle(t: Floats) -> Floats:
        return 100 * np.stack([np.sin(4 * t), np.cos(4 * t)], axis=1)

    def beats(t: Floats) -> Floats:  # the same again after 1.5 s
        angle = 2 * np.pi * t / 1.5
        return 60 * np.stack(
            [np.sin(angle) + np.sin(3 * angle), np.cos(2 * angle + 1) + np.sin(4 * angle)], axis=1
        )

    for seed in range(8):
        with pytest.raises(InputError, match=r"fit|too short"):
            fitted(seed, circle, circle, 5.0)
    with pytest.raises(InputError, match=r"about as well at .*repeats itself"):
        fitted(0, beats, beats, 8.0)


def test_a_steady_push_tells_no_time() -> None:
    def push(t: Floats) -> Floats:
        return np.stack([40 * t, 15 * t**2], axis=1)

    with pytest.raises(InputError):
        fitted(0, push, push, 4.0)


def swung(rng: np.random.Generator) -> Course:
    """Four corners of a board in a hand, (T, 4, 3) mm."""
    rates, phases = rng.uniform(2, 8, (2, 6)), rng.uniform(0, 6, (2, 6))
    outer = CORNERS[[0, 8, 45, 53]] - CORNERS.mean(axis=0)

    def at(t: Floats) -> Floats:
        s = np.sin(t[:, None, None] * rates + phases).sum(axis=1) / 1.4
        turns = Rotation.from_euler("xyz", s[:, :3] * (0.3, 0.35, 0.4)).as_matrix()
        return np.asarray(np.einsum("tij,nj->tni", turns, outer) + s[:, None, 3:] * 50 + AIM)

    return at


def board_fit(seed: int, is_same: bool, seconds: float = 8.0) -> tuple[ClockFit, float]:
    """Two cameras, 35 degrees apart, see a board; or each another one."""
    rng = np.random.default_rng(seed)
    aside = Rotation.from_euler("y", -35, degrees=True).as_matrix()
    cameras = [
        Camera((1280, 720), K),
        Camera((1280, 720), K, Rigid.from_rotation(aside, AIM - aside @ AIM)),
    ]
    first = swung(rng)
    second = first if is_same else swung(rng)
    offset = rng.uniform(-0.4, 0.4)
    n = round(seconds / FRAME_S)
    ta, tb = frames(n), frames(n, rng.uniform(0, FRAME_S))
    a, b = (
        camera.project(course(t)).reshape(len(t), -1) + rng.normal(0, 0.05, (len(t), 8))
        for camera, course, t in zip(
            cameras, (first, second), (ta, frames(n, tb[0] - offset)), strict=True
        )
    )
    return synchronise_motion(ta, a, tb, b, max_offset_s=4.0), offset


def test_boards_that_perspective_bends_are_still_told_and_the_error_stated() -> None:
    off, z = [], []
    for seed in range(10):
        try:
            fit, offset = board_fit(seed, True)
        except InputError:
            continue
        off.append((fit.offset_s - offset) / FRAME_S)
        z.append(off[-1] * FRAME_S / fit.offset_sd_s)

    assert len(off) >= 8
    assert np.abs(off).max() < 1.0
    # lack of fit is no noise: taken for white noise, z would be 3 to 10
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.8


def test_two_different_boards_get_no_offset() -> None:
    for seed in range(8):
        with pytest.raises(InputError, match=r"about as well|too short|largest overlap"):
            board_fit(seed, False)


def test_times_must_grow() -> None:
    t = frames(60)
    motion = waving(np.random.default_rng(0), 2, 10)(t)
    with pytest.raises(InputError, match="must grow"):
        synchronise_motion(t, motion, t[::-1], motion)


def test_the_offset_does_not_lean_towards_half_frames() -> None:
    """Between frames a curve through noisy values is less noisy, which the fit must not like."""
    off = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        course = waving(rng, 1, 4)
        t = frames(600)
        late = rng.choice([0.1, 0.25, 0.4, 0.6, 0.75, 0.9]) * FRAME_S
        a = course(t) + rng.normal(0, 2.0, (600, 2))
        b = course(frames(600, -late)) + rng.normal(0, 2.0, (600, 2))
        off.append((synchronise_motion(t, a, t, b).offset_s - late) / FRAME_S)

    # with a curve through every value it is 0.12 frame
    assert np.sqrt(np.mean(np.square(off))) < 0.03
