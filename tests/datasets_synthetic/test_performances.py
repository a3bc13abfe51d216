"""Performances: still at first, smooth, alive, within what faces can do, and true at any rate."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.mesh import Mesh
from facewright.core.phones import PhoneTrack
from facewright.datasets_synthetic.acting_curves import ActingEvent
from facewright.datasets_synthetic.acting_range import RANGE_SCRIPT
from facewright.datasets_synthetic.performances import (
    NEUTRAL_S,
    PERFORMANCE_RATE_HZ,
    STYLES,
    Performance,
    perform_speech,
    random_performance,
    range_of_motion,
)
from facewright.heads.head import Head

Floats = NDArray[np.float64]
HELLO = ("SIL", "HH", "AH", "L", "OW", "M", "AA", "M", "AH", "SIL")


def hello() -> PhoneTrack:
    lengths = np.array([0.5, 0.06, 0.07, 0.07, 0.18, 0.08, 0.14, 0.08, 0.1, 0.4])
    ends = np.cumsum(lengths)
    return PhoneTrack(HELLO, ends - lengths, ends)


@pytest.fixture(scope="module")
def performances(people: tuple[Head, ...]) -> list[tuple[Head, Performance]]:
    return [
        (head, random_performance(np.random.default_rng(seed), head, seconds=4.0))
        for seed, head in enumerate(people[:8])
    ]


def events(performance: Performance, kind: str) -> list[ActingEvent]:
    return [e for e in performance.events if e.kind == kind]


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("rate_hz", [60.0, 240.0])
def test_it_begins_with_the_neutral_face_at_rest(
    average_head: Head, style: str, rate_hz: float
) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        performance = random_performance(
            rng, average_head, seconds=3.0, rate_hz=rate_hz, style=style
        )

        still = performance.weights.time_s <= NEUTRAL_S
        assert still.sum() >= 0.3 * rate_hz
        assert (performance.weights.values[still] == 0).all()
        np.testing.assert_array_equal(
            performance.head_motion.quaternion[still], [[1.0, 0, 0, 0]] * still.sum()
        )
        assert (performance.head_motion.translation[still] == 0).all()
        assert (performance.weights.values[~still] > 0).any()


def test_weights_are_shares_and_channels_are_the_heads(
    performances: list[tuple[Head, Performance]],
) -> None:
    for head, performance in performances:
        weights = performance.weights
        assert weights.channels == head.shape_names
        assert weights.rate_hz == PERFORMANCE_RATE_HZ
        assert len(weights.time_s) == 960
        assert weights.values.min() >= 0
        assert weights.values.max() <= 1
        assert (weights.values.max(axis=0) > 0.1).sum() > 20  # a lot goes on


@pytest.mark.parametrize("style", STYLES)
def test_the_same_seed_gives_the_same_motion_at_any_rate(average_head: Head, style: str) -> None:
    a, b, c = (
        random_performance(
            np.random.default_rng(s), average_head, seconds=4.0, rate_hz=rate, style=style
        )
        for s, rate in ((1, 240.0), (1, 60.0), (2, 60.0))
    )

    np.testing.assert_allclose(a.weights.values[::4], b.weights.values, atol=1e-12)
    np.testing.assert_allclose(a.head_motion.quaternion[::4], b.head_motion.quaternion, atol=1e-12)
    assert a.events == b.events
    assert not np.allclose(b.weights.values, c.weights.values)


@pytest.mark.parametrize("style", STYLES)
def test_acceleration_is_continuous(average_head: Head, style: str) -> None:
    """Halving the step halves the change of the second derivative from sample to sample.

    A curve with a corner would double it, one with a step in acceleration would leave it as it
    is. Curves of looks are left out: one eye's turn is split at zero into two weights.
    """
    jumps = []
    for rate in (2000.0, 4000.0):
        p = random_performance(
            np.random.default_rng(3), average_head, seconds=4.0, rate_hz=rate, style=style
        )
        looks = [c.startswith("eyeLook") for c in p.weights.channels]
        table = np.concatenate(
            [p.weights.values[:, ~np.array(looks)], p.head_motion.translation], 1
        )
        acceleration = np.diff(table, 2, axis=0) * rate**2
        jumps.append(np.abs(np.diff(acceleration, axis=0)).max(axis=0))

    moving = jumps[0] > 1e-3
    ratio = jumps[1][moving] / jumps[0][moving]
    assert moving.sum() > 5
    assert ratio.max() < 0.75, f"channel ratio {ratio.max():.2f}"


def test_eyes_turn_without_corners_and_stay_on_their_target_while_the_head_moves(
    average_head: Head,
) -> None:
    from facewright.datasets_synthetic.face_motion import FaceMotion

    p = random_performance(np.random.default_rng(5), average_head, seconds=8.0)
    motion = FaceMotion(average_head)
    gaze = np.array([motion.gaze(w) for w in p.weights.values])  # (T, eye, yaw and pitch) rad
    cosines, sines = np.cos(gaze), np.sin(gaze)
    in_head = np.stack(
        [sines[..., 0] * cosines[..., 1], -sines[..., 1], cosines[..., 0] * cosines[..., 1]],
        axis=-1,
    )
    in_world = np.einsum("tij,tej->tei", p.head_motion.rotation, in_head)

    # in the middle of a fixation
    saccades = events(p, "saccade")
    for a, b in itertools.pairwise(saccades):
        t = p.weights.time_s
        rows = np.flatnonzero((t > a.end_s + 0.02) & (t < b.start_s - 0.02))
        if len(rows) < 10:
            continue
        direction = in_world[rows, 0]
        middle = np.median(direction, axis=0)
        off = np.degrees(np.linalg.norm(direction - middle, axis=1))
        turned = np.degrees(np.ptp(p.head_motion.quaternion[rows, 2]) * 2)
        assert off.max() < 2.0 + 0.15 * turned, (a, off.max())


def test_nothing_is_faster_than_faces_are(performances: list[tuple[Head, Performance]]) -> None:
    """Saccades reach 500°/s, nods and turns 200°/s; lips and jaw some 300 mm/s."""
    from facewright.datasets_synthetic.face_motion import FaceMotion

    head, performance = performances[0]
    motion = FaceMotion(head)
    points = head.feature_points.select(("2.1", "8.1", "8.2", "8.3", "4.3", "5.1", "9.1"))
    paths = np.array([points.at(motion.vertices(w)) for w in performance.weights.values[::2]])
    speed = np.linalg.norm(np.diff(paths, axis=0), axis=2) * PERFORMANCE_RATE_HZ / 2
    assert speed.max() < 330  # mm/s
    for _, performance in performances:
        moves = performance.head_motion
        cosine = np.abs((moves.quaternion[1:] * moves.quaternion[:-1]).sum(axis=1))
        turn = np.rad2deg(2 * np.arccos(np.clip(cosine, 0, 1))) * PERFORMANCE_RATE_HZ
        assert turn.max() < 200  # °/s
        shift = np.linalg.norm(np.diff(moves.translation, axis=0), axis=1) * PERFORMANCE_RATE_HZ
        assert shift.max() < 300  # mm/s


def test_blinks_close_both_eyes_fully_in_the_time_that_blinks_take(
    performances: list[tuple[Head, Performance]],
) -> None:
    for _, performance in performances:
        blinks = [e for e in events(performance, "blink") if e.end_s < 4.0]
        assert blinks
        t = performance.weights.time_s
        left = performance.weights["eyeBlinkLeft"]
        for blink in blinks:
            during = (t >= blink.start_s) & (t <= blink.end_s)
            assert left[during].max() == 1
            closed = t[during][left[during] == 1]
            assert 0.09 < closed[0] - blink.start_s < 0.16
            assert 0.14 < blink.end_s - closed[-1] < 0.31
        shut = left > 0.9
        np.testing.assert_array_equal(shut, performance.weights["eyeBlinkRight"] > 0.9)


def test_blinks_come_as_often_as_people_blink(average_head: Head) -> None:
    p = random_performance(
        np.random.default_rng(1), average_head, seconds=240.0, rate_hz=30.0, style="speech"
    )
    assert 10 <= len(events(p, "blink")) / 4 <= 25  # a minute


def test_short_takes_are_full_of_variety(performances: list[tuple[Head, Performance]]) -> None:
    for _, performance in performances:
        kinds = {e.kind for e in performance.events}
        assert {"blink", "saccade", "brows"} <= kinds
        assert len([e for e in performance.events if e.kind in ("gesture", "expression")]) >= 2
    everything = {e.kind for _, p in performances for e in p.events}
    assert {"phrase", "nod", "shake", "turn", "beat"} <= everything


def test_events_tell_when_expressions_happen(average_head: Head) -> None:
    p = random_performance(
        np.random.default_rng(2), average_head, seconds=60.0, rate_hz=60.0, style="expressions"
    )
    told = {e.name for e in events(p, "expression")}
    assert len(told) >= 5
    t, smile = p.weights.time_s, p.weights["mouthSmileLeft"]
    joys = [e for e in events(p, "expression") if e.name == "joy"] + events(p, "laugh")
    assert joys
    within = np.zeros(len(t), dtype=bool)
    for e in joys:
        within |= (t > e.start_s) & (t < e.end_s)
        assert smile[(t > e.start_s) & (t < e.end_s)].max() > 0.2 * e.amount
    others = smile[~within]
    assert others.max() < 0.1  # nothing but idle motion outside


def test_speech_says_its_phones_and_shuts_the_lips_for_m(average_head: Head) -> None:
    phones = hello()
    p = perform_speech(np.random.default_rng(0), average_head, phones, mood={"joy": 0.6})

    assert p.phones is phones
    assert len(p.weights.time_s) == round((phones.end_s[-1] + 1) * PERFORMANCE_RATE_HZ)
    t = p.weights.time_s
    for phone, a, b in zip(phones.phones, phones.start_s, phones.end_s, strict=True):
        during = (t >= a) & (t <= b)
        if phone == "M":
            np.testing.assert_allclose(
                p.weights["mouthClose"][during], p.weights["jawOpen"][during], atol=1e-12
            )
            assert p.weights["mouthUpperUpLeft"][during].max() < 1e-12
    vowel = np.searchsorted(t, (phones.start_s[6] + phones.end_s[6]) / 2)
    assert p.weights["jawOpen"][vowel] - p.weights["mouthClose"][vowel] > 0.15
    assert [e.name for e in events(p, "phrase")] == [" ".join(HELLO[1:-1])]


def test_a_mood_shows_more_where_nobody_speaks(average_head: Head) -> None:
    phones = hello()
    p = perform_speech(
        np.random.default_rng(0), average_head, phones, mood={"joy": 1.0}, seconds=6.0
    )
    t, smile = p.weights.time_s, p.weights["mouthSmileRight"]
    assert smile[(t > 2.5) & (t < 4.5)].min() > 1.5 * np.median(smile[(t > 0.9) & (t < 1.3)])


def test_phones_may_be_given_to_a_medley(average_head: Head) -> None:
    phones = hello()
    p = random_performance(np.random.default_rng(0), average_head, seconds=4.0, phones=phones)
    assert p.phones is phones
    assert any(e.kind in ("expression", "gesture") for e in p.events)


def test_the_range_of_motion_shows_every_gesture_alone(average_head: Head) -> None:
    p = range_of_motion(average_head, rate_hz=60.0)

    assert [e.name for e in p.events] == list(RANGE_SCRIPT)
    used = p.weights.values.max(axis=0)
    idle = [c for c, w in zip(p.weights.channels, used, strict=True) if w < 0.2]
    assert not idle, f"never moved: {idle}"
    between = [
        row
        for a, b in zip(p.events[:-1], p.events[1:], strict=True)
        for row in np.flatnonzero(
            (p.weights.time_s > a.end_s + 1e-6) & (p.weights.time_s < b.start_s)
        )
    ]
    assert len(between) > 100
    assert p.weights.values[between].max() < 1e-12  # the face rests between gestures


def test_the_head_turns_about_the_neck(performances: list[tuple[Head, Performance]]) -> None:
    for head, performance in performances:
        motion = performance.head_motion
        pivot = motion.world_from_head(head.neck_pivot[None])[:, 0]
        assert np.linalg.norm(pivot - head.neck_pivot, axis=1).max() < 20
        assert np.ptp(motion.world_from_head(head.points["9.3"][None])[:, 0], axis=0).max() > 8


def test_wrong_calls_are_told(average_head: Head) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="no style 'opera'; there are mixed"):
        random_performance(rng, average_head, seconds=2.0, style="opera")
    with pytest.raises(ValueError, match="does not speak"):
        random_performance(rng, average_head, seconds=2.0, style="range", phones=hello())
    with pytest.raises(ValueError, match="two samples"):
        random_performance(rng, average_head, seconds=0.0)
    with pytest.raises(ValueError, match=r"first sound is at 0\.100 s"):
        early = PhoneTrack(("AA",), np.array([0.1]), np.array([0.3]))
        perform_speech(rng, average_head, early)
    stiff = Head(
        "stiff", Mesh(average_head.mesh.vertices, average_head.mesh.triangles),
        average_head.feature_points, average_head.eyes, average_head.jaw_pivot,
        average_head.neck_pivot, average_head.appearance,
    )  # fmt: skip
    with pytest.raises(InputError, match="stiff has no sculpted shapes"):
        random_performance(rng, stiff, seconds=2.0)
