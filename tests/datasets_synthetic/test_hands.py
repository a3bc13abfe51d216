"""A hand before the face touches and never enters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from facewright.core.mesh import vertex_normals
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.hands import GESTURES, HandGesture, random_gesture
from facewright.heads.head import Head
from facewright.heads.raycast import RayScene

Floats = NDArray[np.float64]


def heights_mm(head: Head, vertices: Floats, points: Floats) -> Floats:
    """Of points above the skin, by the nearest place on it and the normal there."""
    skin = np.asarray(head.mesh.triangles)[np.asarray(head.mesh.groups["skin"])]
    at, triangle, b = RayScene(vertices, skin).closest(points)
    normals = vertex_normals(vertices, skin)
    normal = np.einsum("nc,ncx->nx", b, normals[skin[triangle]])
    off = points - at
    distance = np.linalg.norm(off, axis=1)
    return np.asarray(np.where((off * normal).sum(axis=1) < 0, -distance, distance))


def touching_times(hand: HandGesture, count: int) -> list[float]:
    t = np.linspace(hand.start_s, hand.start_s + hand.period_s, 200)
    near = [float(s) for s in t if hand.presence(float(s)) > 0.999]
    return [near[i] for i in np.linspace(0, len(near) - 1, count).astype(int)]


@pytest.mark.parametrize("gesture", GESTURES)
@pytest.mark.parametrize("person", range(4))
def test_the_hand_touches_but_stays_before_the_skin(
    people: tuple[Head, ...], gesture: str, person: int
) -> None:
    head = people[7 * person]
    hand = random_gesture(np.random.default_rng(person), head, gesture=gesture)
    v = np.array(head.mesh.vertices)
    jaw = v + 0.6 * head.shapes[head.shape_names.index("jawOpen")]  # type: ignore[index]

    for face in (v, jaw):
        for t in touching_times(hand, 4):
            points = hand.at(t, face, Rigid.identity())
            height = heights_mm(head, face, points)
            assert height.min() > -0.1, f"{-height.min():.2f} mm deep at {t:.2f} s"
            assert np.abs(height).min() < 6


@pytest.mark.parametrize("gesture", GESTURES)
def test_the_hand_comes_and_goes_without_entering_or_jumping(
    average_head: Head, gesture: str
) -> None:
    hand = random_gesture(np.random.default_rng(5), average_head, gesture=gesture)
    v = np.array(average_head.mesh.vertices)
    times = np.arange(0, hand.start_s + hand.period_s, 1 / 60)

    path = np.stack([hand.at(float(t), v, Rigid.identity()) for t in times])

    for points in path[:: len(path) // 15]:
        assert heights_mm(average_head, v, points).min() > -0.1
    speed_mm_s = np.linalg.norm(np.diff(path, axis=0), axis=2).max(axis=1) * 60
    assert speed_mm_s.max() < 4500  # quick hands reach 3 m/s; finger tips turn besides
    assert path[0, :, 1].max() < average_head.points["2.1"][1] - 60  # at rest: below the chin
    np.testing.assert_allclose(path[0], hand.at(hand.start_s + hand.period_s, v, Rigid.identity()))


def test_the_hand_is_rigid(average_head: Head) -> None:
    hand = random_gesture(np.random.default_rng(1), average_head, gesture="wipe")
    v = np.array(average_head.mesh.vertices)
    some = [
        pdist(hand.at(t, v, Rigid.identity())[::97])
        for t in (0.0, *touching_times(hand, 2), hand.start_s + 0.3)
    ]

    for other in some[1:]:
        np.testing.assert_allclose(other, some[0], atol=1e-6)


def test_the_hand_goes_with_the_head(average_head: Head) -> None:
    """Moving head and seat together moves the hand as a whole."""
    hand = random_gesture(np.random.default_rng(2), average_head, gesture="scratch")
    v = np.array(average_head.mesh.vertices)
    seat = Rigid.from_rotation(Rotation.from_euler("y", 0.7).as_matrix(), (100, 50, -30))
    for t in (hand.start_s + 0.25, *touching_times(hand, 2)):
        here = hand.at(t, v, Rigid.identity())
        there = hand.at(t, v, seat, world_from_body=seat)
        # rays are cast in single precision
        np.testing.assert_allclose(there, seat.apply(here), atol=5e-3)


def test_hands_come_from_both_sides(average_head: Head) -> None:
    v = np.array(average_head.mesh.vertices)
    places: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(12):
        hand = random_gesture(np.random.default_rng(seed), average_head)
        places[hand.left].append(float(hand.at(0.0, v, Rigid.identity())[:, 0].mean()))
    assert max(places[False]) < 0 < min(places[True])


def test_a_sleeve_covers_the_arm_and_leaves_the_hand(average_head: Head) -> None:
    bare, dressed = (
        random_gesture(np.random.default_rng(3), average_head, gesture="wipe", sleeve=colour)
        for colour in (None, (200, 10, 10))
    )
    v = np.array(average_head.mesh.vertices)
    t = touching_times(bare, 1)[0]
    skin, both = (h.at(t, v, Rigid.identity()) for h in (bare, dressed))
    red = dressed.colour[:, 0] > 5 * dressed.colour[:, 1]

    assert red.sum() > 100
    np.testing.assert_allclose(both[~red], skin, atol=2.0)
    # rays from outside to the arm's middle meet cloth first
    some = np.flatnonzero(red)[::7]
    gap = np.linalg.norm(both[some][:, None] - skin, axis=2)
    nearest = np.argsort(gap, axis=1)[:, :60]
    middle = skin[nearest].mean(axis=1)
    outside = middle + 6 * (both[some] - middle)
    _, triangle, _ = RayScene(both, dressed.triangles).cast(outside, middle - outside)
    assert red[dressed.triangles[triangle, 0]].mean() > 0.9  # not at its ends


def test_a_hand_is_not_inside_out(average_head: Head) -> None:
    """The signed volume of the hand, closed at its end, is positive for either side."""
    v = np.array(average_head.mesh.vertices)
    lefts = set()
    for seed in range(8):
        hand = random_gesture(np.random.default_rng(seed), average_head, gesture="wipe")
        p = hand.at(0.0, v, Rigid.identity())
        p = p - p[-20:].mean(axis=0)  # the open end's cone has then no volume
        a, b, c = (p[hand.triangles[:, k]] for k in range(3))
        assert np.einsum("nx,nx->", a, np.cross(b, c)) / 6 > 3e5  # mm³
        lefts.add(hand.left)
    assert lefts == {False, True}


def test_an_unknown_gesture_is_refused(average_head: Head) -> None:
    with pytest.raises(ValueError, match="gesture must be one of wipe, scratch, chin"):
        random_gesture(np.random.default_rng(0), average_head, gesture="wave")
