"""Jaw, eyes, lids and lips of synthetic faces, on twenty people."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.datasets_synthetic.face_motion import SIDES, FaceMotion
from facewright.datasets_synthetic.lid_motion import lid_layout
from facewright.datasets_synthetic.lip_motion import lip_layout, parted, stopped
from facewright.heads.decimation import decimate
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity

Floats = NDArray[np.float64]

N_FAST = 3
PEOPLE = [pytest.param(i, marks=() if i < N_FAST else pytest.mark.slow) for i in range(20)]
#: Faces whose lips must be shut, and what shuts them.
SHUT: dict[str, dict[str, float]] = {
    "press": {"mouthPressL/R": 1.0},
    "roll": {"mouthRollLower": 1.0, "mouthRollUpper": 1.0},
    "m": {
        "jawOpen": 0.05,
        "mouthClose": 0.05,
        "mouthPressL/R": 0.4,
        "mouthRollLower": 0.3,
        "mouthRollUpper": 0.3,
    },
    "smile": {"mouthSmileL/R": 1.0},
    "slightly open jaw": {"jawOpen": 0.3, "mouthClose": 0.3},
    "half open jaw": {"jawOpen": 0.5, "mouthClose": 1.0},
    "open jaw": {"jawOpen": 1.0, "mouthClose": 1.0},
}


@lru_cache(maxsize=2)
def person(seed: int) -> tuple[Head, FaceMotion]:
    head = make_head(random_identity(np.random.default_rng(seed), f"person-{seed}"))
    return head, FaceMotion(head)


@lru_cache(maxsize=1)
def average() -> tuple[Head, FaceMotion]:
    head = make_head(Identity("average"))
    return head, FaceMotion(head)


def weights(head: Head, **shapes: float) -> Floats:
    """ARKit weights; ``L/R`` at the end of a name stands for both sides."""
    found = np.zeros(len(head.shape_names))
    for name, value in shapes.items():
        sides = ("Left", "Right") if name.endswith("L/R") else ("",)
        for side in sides:
            found[head.shape_names.index(name.removesuffix("L/R") + side)] = value
    return found


def distance_to_line(points: Floats, line: Floats) -> Floats:
    """Of each point from a polyline, mm."""
    a, b = line[:-1], line[1:]
    d = b - a
    t = ((points[:, None] - a) * d).sum(axis=2) / np.maximum((d * d).sum(axis=1), 1e-12)
    nearest = a + np.clip(t, 0, 1)[..., None] * d
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1))


def turned_globe(head: Head, motion: FaceMotion, w: Floats, side: str, p: Floats) -> Floats:
    """Distance of points above the eyeball's own mesh, turned as it is, mm along the radius."""
    ball = head.mesh.vertices[head.part_vertices(f"eye_{side}")] - head.eyes[side].centre
    pose = motion.rigid_parts(w)[f"eye_{side}"]
    local = pose.inverse().apply(p) - head.eyes[side].centre
    far = np.linalg.norm(local, axis=1)
    cosine = (local / far[:, None]) @ (ball / np.linalg.norm(ball, axis=1)[:, None]).T
    radius = np.linalg.norm(ball, axis=1)
    nearest = np.argsort(-cosine, axis=1)[:, :3]
    return np.asarray(far - radius[nearest].mean(axis=1))


def profiles(v: Floats, x: float) -> tuple[Floats, Floats]:
    """Sections of the upper and the lower lip at x: points (n, 2) of depth and height."""
    layout = lip_layout()
    found = []
    for grid in (layout.upper, layout.lower):
        points = []
        for ring in v[grid[6:-6]]:
            order = np.argsort(ring[:, 0], kind="stable")
            at = [np.interp(x, ring[order, 0], ring[order, axis]) for axis in (2, 1)]
            points.append(at)
        found.append(np.array(points))
    return found[0], found[1]


def overlap_and_slit(v: Floats, x: float) -> tuple[float, float]:
    """How deep the lips' sections overlap, and how high light shines through; mm, at x."""
    upper, lower = profiles(v, x)
    depth = 0.0
    z = np.arange(
        max(upper[:, 0].min(), lower[:, 0].min()), min(upper[:, 0].max(), lower[:, 0].max()), 0.05
    )
    if len(z):
        bottom, top = _at(upper, z, np.inf, np.minimum), _at(lower, z, -np.inf, np.maximum)
        depth = float(np.max(top - bottom, initial=0.0))
    return depth, float(upper[:, 1].min() - lower[:, 1].max())


def _at(line: Floats, z: Floats, empty: float, pick: np.ufunc) -> Floats:
    """Heights of a section at depths: the lowest or the highest of its edges there."""
    found = np.full(len(z), empty)
    for (z0, y0), (z1, y1) in pairwise(line):
        if z0 == z1:
            continue
        t = (z - z0) / (z1 - z0)
        on = (t >= 0) & (t <= 1)
        found[on] = pick(found[on], y0 + t[on] * (y1 - y0))
    return found


def test_zero_weights_are_the_neutral_face_to_the_last_bit() -> None:
    head, motion = person(0)

    found = motion.vertices(np.zeros(52))

    assert (found == head.mesh.vertices).all()


@pytest.mark.parametrize("seed", PEOPLE)
def test_rims_meet_at_full_blink_whatever_else_the_eyes_do(seed: int) -> None:
    head, motion = person(seed)

    for others in ({}, {"eyeSquintL/R": 0.8}, {"eyeWideL/R": 1.0}, {"eyeLookDownL/R": 1.0}):
        v = motion.vertices(weights(head, **{"eyeBlinkL/R": 1.0}, **others))
        for side in SIDES:
            layout = lid_layout(side)
            gap = distance_to_line(v[layout.upper], v[layout.lower]).max()
            assert gap < 0.1, f"{side} rims {gap:.3f} mm apart with {others}"


@pytest.mark.parametrize("seed", PEOPLE)
def test_rims_never_cross(seed: int) -> None:
    head, motion = person(seed)
    rng = np.random.default_rng(seed)
    eyes = [n for n in head.shape_names if n.startswith(("eye", "cheek", "brow"))]

    for _ in range(20):
        v = motion.vertices(weights(head, **{n: rng.random() for n in eyes}))
        for side in SIDES:
            layout, centre = lid_layout(side), head.eyes[side].centre
            upper, lower = (v[rows][1:-1] - centre for rows in (layout.upper, layout.lower))
            beside = (upper[:, 0] > lower[:, 0].min()) & (upper[:, 0] < lower[:, 0].max())
            upper, order = upper[beside], np.argsort(lower[:, 0])
            low = np.interp(
                upper[:, 0], lower[order, 0], np.arctan2(lower[order, 1], lower[order, 2])
            )
            crossed = (low - np.arctan2(upper[:, 1], upper[:, 2])) * np.hypot(*upper[:, 1:].T)
            assert crossed.max() < 0.1, f"{side} rims overlap by {crossed.max():.3f} mm"


@pytest.mark.parametrize("seed", PEOPLE)
def test_lids_never_enter_the_globe(seed: int) -> None:
    head, motion = person(seed)
    looks = ("Up", "Down", "In", "Out")

    for look in looks:
        for blink in (0.0, 0.4, 0.8, 1.0):
            gaze = {f"eyeLook{look}L/R": 1.0}
            w = weights(head, **gaze, **{"eyeBlinkL/R": blink})
            v = motion.vertices(w)
            for side in SIDES:
                rim = np.concatenate([lid_layout(side).upper, lid_layout(side).lower])
                above = turned_globe(head, motion, w, side, v[rim])
                rest = turned_globe(head, motion, np.zeros(52), side, head.mesh.vertices[rim])
                worst = (above - np.minimum(rest, 0)).min()
                # 0.14 mm: how far the eyeball's coarse mesh is from the ellipsoid it samples
                assert worst > -0.14, f"{side} {look} blink {blink}: {-worst:.2f} mm inside"


@pytest.mark.parametrize("seed", PEOPLE)
@pytest.mark.parametrize("face", SHUT)
def test_shut_lips_show_no_slit_and_do_not_overlap(seed: int, face: str) -> None:
    head, motion = person(seed)
    v = motion.vertices(weights(head, **SHUT[face]))
    half = 0.8 * float(np.abs(v[lip_layout().upper[15], 0]).max())

    for share in np.linspace(-1, 1, 17):
        x = share * half
        rest_depth, rest_slit = overlap_and_slit(
            head.mesh.vertices, x * float(head.points["8.3"][0]) / (half / 0.8)
        )
        depth, slit = overlap_and_slit(v, x)
        assert slit < max(rest_slit, 0) + 0.1, f"a slit of {slit:.2f} mm at x = {x:.0f} mm"
        allowed = max(rest_depth, 0.0) + 0.35
        assert depth < allowed, f"lips overlap by {depth:.2f} mm at x = {x:.0f} mm"


@pytest.mark.parametrize("seed", PEOPLE)
def test_teeth_tongue_and_eyes_move_rigidly(seed: int) -> None:
    head, motion = person(seed)
    rng = np.random.default_rng(seed)
    w = rng.random(52)
    w[head.shape_names.index("tongueOut")] = 0

    v = motion.vertices(w)

    parts = motion.rigid_parts(w)
    pairs = [("teeth_lower", "mandible"), ("tongue", "mandible")]
    pairs += [(f"eye_{side}", f"eye_{side}") for side in SIDES]
    for part, pose in pairs:
        rows = head.part_vertices(part)
        off = np.abs(v[rows] - parts[pose].apply(head.mesh.vertices[rows])).max()
        assert off < 1e-9, f"{part} is {off:.2g} mm off its pose"
    rows = head.part_vertices("teeth_upper")
    assert (v[rows] == head.mesh.vertices[rows]).all()


@pytest.mark.parametrize("seed", PEOPLE)
def test_open_jaw_has_the_gape_and_glide_of_a_real_one(seed: int) -> None:
    head, motion = person(seed)

    pose = motion.jaw_pose(weights(head, jawOpen=1.0))

    size = np.linalg.norm((head.points["9.11"] - head.jaw_pivot)[1:]) / 85
    gape = np.linalg.norm(pose.apply(head.points["9.11"]) - head.points["9.10"]) / size
    glide = (pose.apply(head.jaw_pivot) - head.jaw_pivot) / size
    assert 40 <= gape <= 50
    assert np.linalg.norm(glide) == pytest.approx(10, abs=1e-6)
    assert glide[1] < 0 < glide[2]  # down and forward


def test_sideways_jaw_turns_about_the_condyle_of_that_side() -> None:
    head, motion = average()
    pose = motion.jaw_pose(weights(head, jawLeft=1.0))
    half = 50 * np.linalg.norm((head.points["9.11"] - head.jaw_pivot)[1:]) / 85

    moved = [
        np.linalg.norm(pose.apply(head.jaw_pivot + d) - head.jaw_pivot - d)
        for d in half * np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    ]

    assert moved[0] < 2.5  # mm: shifts a little
    assert moved[1] > 5.0
    assert pose.apply(head.points["9.11"])[0] > 5.0


def test_gaze_is_what_the_pupils_do() -> None:
    head, motion = average()
    w = weights(head, eyeLookOutLeft=0.5, eyeLookInRight=0.5, **{"eyeLookDownL/R": 0.4})

    gaze, v = motion.gaze(w), motion.vertices(w)

    points = dict(zip(head.feature_points.names, head.feature_points.at(v), strict=True))
    for side, pupil, row in (("right", "3.6", 0), ("left", "3.5", 1)):
        yaw, pitch = gaze[row]
        rest = head.points[pupil] - head.eyes[side].centre
        # Ry(yaw) Rx(pitch), written out for a vector
        y = np.cos(pitch) * rest[1] - np.sin(pitch) * rest[2]
        z = np.sin(pitch) * rest[1] + np.cos(pitch) * rest[2]
        wanted = [
            np.cos(yaw) * rest[0] + np.sin(yaw) * z,
            y,
            np.cos(yaw) * z - np.sin(yaw) * rest[0],
        ]
        assert points[pupil] - head.eyes[side].centre == pytest.approx(np.array(wanted), abs=1e-9)
        assert yaw > 0.2  # to the subject's left
        assert points[pupil][1] < head.points[pupil][1] - 1  # and down


@pytest.mark.parametrize("seed", PEOPLE)
def test_motion_is_smooth_in_the_weights(seed: int) -> None:
    """Where the speed along a line through the weights changes most, smaller steps show no jump."""
    _, motion = person(seed)
    rng = np.random.default_rng(100 + seed)
    a, b = rng.random((2, 52)) * (rng.random((2, 52)) < 0.3)

    def speeds(steps: Floats) -> Floats:
        v = np.array([motion.vertices((1 - s) * a + s * b) for s in steps])
        return np.asarray(np.diff(v, axis=0) / (steps[1] - steps[0]))  # mm for the whole way

    coarse = np.linspace(0, 1, 101)
    speed = speeds(coarse)
    change = np.abs(np.diff(speed, axis=0)).max(axis=(1, 2))
    worst = int(change.argmax())
    fine = np.linspace(coarse[worst], coarse[worst + 2], 129)
    refined = np.abs(np.diff(speeds(fine), axis=0)).max()

    assert np.abs(speed).max() < 150
    assert refined < max(0.2 * change[worst], 1.0), f"{change[worst]:.1f} → {refined:.1f} mm"


def test_a_symmetric_face_moves_symmetrically() -> None:
    head, motion = average()
    rest = head.mesh.vertices
    distance, mirror = _mirror(rest)
    paired = distance < 1e-3
    rng = np.random.default_rng(3)
    w = rng.random(52) * (rng.random(52) < 0.4)
    swapped = np.array([w[head.shape_names.index(_other_side(n))] for n in head.shape_names])

    one, other = motion.vertices(w), motion.vertices(swapped)

    assert paired.mean() > 0.95
    off = np.abs(one[paired] - other[mirror[paired]] * (-1, 1, 1))
    # the sculpted shapes themselves are mirror images to 0.6 mm only (mouthSmile)
    assert np.quantile(off, 0.99) < 0.2


def _mirror(rest: Floats) -> tuple[Floats, NDArray[np.int64]]:
    from scipy.spatial import cKDTree

    distance, row = cKDTree(rest * (-1, 1, 1)).query(rest)
    return distance, row


def _other_side(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name


def test_same_weights_same_face() -> None:
    head, motion = person(1)
    w = np.random.default_rng(0).random(52)

    assert (motion.vertices(w) == FaceMotion(head).vertices(w)).all()


def test_lips_part_in_the_middle_first() -> None:
    head, motion = average()
    layout = lip_layout()
    opened = []
    for jaw in (0.02, 0.04, 0.08):
        v = motion.vertices(weights(head, jawOpen=jaw))
        half = float(v[layout.upper[15], 0].max())
        slits = [overlap_and_slit(v, share * half)[1] for share in (0.0, 0.5, 0.85)]
        opened.append(slits)

    assert all(middle > side > corner for middle, side, corner in opened[1:])
    assert opened[0][0] < opened[1][0] < opened[2][0]


def test_contact_functions_are_smooth_and_monotone() -> None:
    g = np.linspace(-3, 3, 60001)
    for f in (parted, lambda x: x + stopped(-x)):
        slope = np.gradient(f(g), g)
        assert (np.diff(f(g)) > -1e-12).all()
        assert np.abs(np.diff(slope)).max() < 5e-3  # C1: no jump at a step of 1e-4 mm
    assert parted(np.array([2.0]))[0] == 2.0
    assert stopped(np.array([1.0]))[0] == pytest.approx(1.0, abs=0.08)


def test_children_move_too() -> None:
    head = make_head(Identity("child", age=0.0))
    motion = FaceMotion(head)

    v = motion.vertices(weights(head, **{"eyeBlinkL/R": 1.0}))

    for side in SIDES:
        layout = lid_layout(side)
        assert distance_to_line(v[layout.upper], v[layout.lower]).max() < 0.1


def test_wrong_heads_and_weights_are_refused() -> None:
    head, motion = average()
    with pytest.raises(InputError, match="cannot act"):
        FaceMotion(decimate(head, 3000))
    with pytest.raises(ValueError, match=r"weights must have shape \(52,\)"):
        motion.vertices(np.zeros(51))
    bad = np.zeros(52)
    bad[head.shape_names.index("jawOpen")] = np.nan
    with pytest.raises(ValueError, match="jawOpen"):
        motion.vertices(bad)
    with pytest.raises(ValueError, match="gaze"):
        motion.vertices(np.zeros(52), gaze=np.zeros(2))
