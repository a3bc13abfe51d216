from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.head_motion import HeadMotion
from facewright.core.mesh import vertex_normals
from facewright.core.mpeg4 import displacement_faps, fap_by_name, fap_table
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.raycast import RayScene
from facewright.retarget.drive import HeadDrive
from facewright.retarget.fap_rules import complete_faps, other_side
from facewright.retarget.jaw import jaw_motion


def clip_mm(head: Head, **mm: float) -> Clip:
    """Two frames: rest, and FAPs by their size in mm."""
    values = [v / head.fapu.unit(fap_by_name()[n]) for n, v in mm.items()]
    return Clip(np.array([0.0, 0.1]), tuple(mm), np.array([[0.0] * len(mm), values]))


def test_points_go_where_the_faps_say(head: Head, drive: HeadDrive) -> None:
    mm = {
        "raise_l_i_eyebrow": 5.0,
        "raise_r_i_eyebrow": 2.0,
        "squeeze_l_eyebrow": 3.0,
        "squeeze_r_eyebrow": 1.0,
        "open_jaw": 12.0,
        "raise_b_midlip": -9.0,
        "lower_t_midlip": -1.0,
        "stretch_l_cornerlip": 4.0,
        "stretch_r_cornerlip": 2.0,
        "raise_b_midlip_o": -8.0,
        "lift_l_cheek": 2.0,
        "lift_r_cheek": 4.0,
        "puff_l_cheek": 2.0,
        "puff_r_cheek": 3.0,
        "push_t_lip": 2.0,
        "push_b_lip": 3.0,
        "shift_jaw": 3.0,
        "thrust_jaw": 1.0,
        "depress_chin": -10.0,
        "raise_nose": 1.0,
        "close_t_l_eyelid": 3.0,
        "close_t_r_eyelid": 1.0,
    }
    clip = clip_mm(head, **mm)

    vertices = drive.animate(clip).vertices(1)

    moved = head.feature_points.at(vertices) - head.feature_points.at(head.mesh.vertices)
    found = displacement_faps(
        {n: d[None] for n, d in zip(head.feature_points.names, moved, strict=True)}, head.fapu
    )
    for name, value in mm.items():
        in_mm = found[name][0] * head.fapu.unit(fap_by_name()[name])
        assert in_mm == pytest.approx(value, abs=1e-6), name


def test_rest_is_rest(head: Head, drive: HeadDrive) -> None:
    animation = drive.animate(clip_mm(head, open_jaw=3.0))
    np.testing.assert_allclose(animation.vertices(0), head.mesh.vertices, atol=1e-9)
    np.testing.assert_allclose(
        animation.motion.world_from_head(np.ones((1, 3)))[0], np.ones((1, 3))
    )


def test_the_jaw_turns_about_its_hinge(head: Head, drive: HeadDrive) -> None:
    animation = drive.animate(clip_mm(head, open_jaw=15.0))
    jaw = animation.parts["teeth_lower"]
    chin = head.points["2.1"]

    at = jaw.moved(chin, 1)

    assert at[1] - chin[1] == pytest.approx(-15.0)
    assert np.linalg.norm(at - head.jaw_pivot) == pytest.approx(
        np.linalg.norm(chin - head.jaw_pivot)
    )
    teeth = head.part_vertices("teeth_lower")
    v = animation.vertices(1)
    np.testing.assert_allclose(v[teeth], jaw.moved(head.mesh.vertices[teeth], 1))
    assert (v[teeth, 1] < head.mesh.vertices[teeth, 1] - 5).all()
    upper = head.part_vertices("teeth_upper")
    np.testing.assert_array_equal(v[upper], head.mesh.vertices[upper])
    # a mouth opens by the lips' own FAPs, not by the jaw's
    lips = head.feature_points.select(("2.2", "2.3"))
    np.testing.assert_allclose((lips.at(v) - lips.at(head.mesh.vertices))[:, 1], 0, atol=1e-9)


def test_the_jaw_does_not_close_beyond_rest(head: Head, drive: HeadDrive) -> None:
    animation = drive.animate(clip_mm(head, open_jaw=-8.0))
    np.testing.assert_allclose(animation.vertices(1), head.mesh.vertices, atol=1e-9)


def test_eyes_turn_about_their_centres(head: Head, drive: HeadDrive) -> None:
    faps = {"yaw_l_eyeball": 30000.0, "pitch_l_eyeball": 10000.0}
    clip = Clip(np.zeros(1), tuple(faps), np.array([list(faps.values())]))
    animation = drive.animate(clip)
    rows = head.part_vertices("eye_left")
    eye = head.eyes["left"].centre

    before, after = head.mesh.vertices[rows] - eye, animation.vertices(0)[rows] - eye

    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    front = np.argmax(before[:, 2])
    gaze = after[front] - before[front]
    assert gaze[0] > 3 and gaze[1] < -1  # to the left, and down


@pytest.mark.parametrize("seed", [None, 1, 5])
def test_closed_lids_meet_and_cover_the_eye(seed: int | None, head: Head, drive: HeadDrive) -> None:
    if seed is not None:
        head = make_head(random_identity(np.random.default_rng(seed)))
        drive = HeadDrive(head)
    clip = clip_mm(head, close_t_l_eyelid=20.0, close_b_l_eyelid=1.0)

    v = drive.animate(clip).vertices(1)

    eye_mm2, seen = visible_eye(head, v), visible_eye(head, head.mesh.vertices)
    assert seen > 100
    assert eye_mm2 < 0.03 * seen, f"{eye_mm2:.1f} of {seen:.1f} mm² of the eyes still show"
    top, bottom = (head.feature_points.select((n,)).at(v)[0] for n in ("3.1", "3.3"))
    assert abs(top[1] - bottom[1]) < 1.0


def visible_eye(head: Head, v: NDArray[np.float64]) -> float:
    """Area of the eyeballs that is seen from the front, mm² (lashes taken away)."""
    groups = head.mesh.groups
    n_skin = len(groups["skin"])
    triangles = head.mesh.triangles[
        np.concatenate([groups["skin"], groups["eye_left"], groups["eye_right"]])
    ]
    x, y = np.meshgrid(np.arange(-60, 60, 0.2), np.arange(-18, 18, 0.2))
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, 300.0)], axis=1)
    t, hit, _ = RayScene(v, triangles).cast(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    return float(((hit >= n_skin) & np.isfinite(t)).sum()) * 0.04


def test_lips_are_pressed_but_do_not_cross(head: Head, drive: HeadDrive) -> None:
    clip = clip_mm(head, lower_t_midlip=6.0, raise_b_midlip=4.0)
    lips = head.feature_points.select(("2.2", "2.3"))
    v = drive.animate(clip).vertices(1)
    moved = (lips.at(v) - lips.at(head.mesh.vertices))[:, 1]
    assert 0.05 < moved[1] - moved[0] <= 0.0601  # pressed no further
    assert moved.mean() == pytest.approx(-1.0)  # both give way alike


def test_no_triangle_of_the_face_flips_or_spikes(head: Head, drive: HeadDrive) -> None:
    clip = clip_mm(
        head,
        open_jaw=15.0,
        raise_b_midlip=-13.0,
        raise_b_lip_lm=-11.0,
        raise_l_cornerlip=-3.0,
        stretch_l_cornerlip=3.0,
        raise_l_i_eyebrow=4.0,
        lift_l_cheek=2.0,
    )
    v0, v = head.mesh.vertices, drive.animate(clip).vertices(1)
    triangles = head.mesh.triangles[head.mesh.groups["skin"]]
    outside = v0[triangles].mean(axis=1)
    normals = vertex_normals(v0, triangles)[triangles].mean(axis=1)
    # the outside of the face, lips' inner side and nostrils apart
    far = np.linalg.norm(outside - (0, head.points["2.2"][1], outside[:, 2].max()), axis=1) > 45
    face = (normals[:, 2] > 0.5) & far
    edges = v[triangles] - np.roll(v[triangles], 1, axis=1)
    edges0 = v0[triangles] - np.roll(v0[triangles], 1, axis=1)
    stretch = np.linalg.norm(edges, axis=2) / np.maximum(np.linalg.norm(edges0, axis=2), 0.3)
    assert stretch[face].max() < 3.0
    new = np.cross(edges[:, 0], edges[:, 1])
    old = np.cross(edges0[:, 0], edges0[:, 1])
    assert ((new * old).sum(axis=1)[face] > 0).mean() > 0.999


def test_lashes_go_with_the_lid(head: Head, drive: HeadDrive) -> None:
    v = drive.animate(clip_mm(head, close_t_l_eyelid=4.0)).vertices(1)
    rows = head.part_vertices("lashes")
    moved = (v - head.mesh.vertices)[rows]
    left_middle = np.abs(head.mesh.vertices[rows, 0] - head.points["3.1"][0]) < 4
    assert left_middle.any()
    assert (moved[left_middle, 1] < -2.5).all()


def test_the_tongue_bends_at_its_tip(head: Head, drive: HeadDrive) -> None:
    v = drive.animate(clip_mm(head, thrust_tongue_tip=10.0, raise_tongue=3.0)).vertices(1)
    tongue = head.feature_points.select(("6.1", "6.2"))
    moved = tongue.at(v) - tongue.at(head.mesh.vertices)
    np.testing.assert_allclose(moved[0], [0, 0, 10], atol=0.01)
    assert moved[1, 1] == pytest.approx(3.0, abs=0.01)
    rows = head.part_vertices("tongue")
    root = rows[np.argmin(head.mesh.vertices[rows, 2])]
    np.testing.assert_allclose(v[root], head.mesh.vertices[root], atol=1e-9)


def test_the_tongue_goes_where_its_faps_say_whatever_the_jaw_does(
    head: Head, drive: HeadDrive
) -> None:
    tongue = head.feature_points.select(("6.1", "6.2"))
    rest = tongue.at(head.mesh.vertices)

    def moved(**mm: float) -> NDArray[np.float64]:
        return np.asarray(tongue.at(drive.animate(clip_mm(head, **mm)).vertices(1)) - rest)

    both = moved(open_jaw=12.0, shift_jaw=2.0, raise_tongue_tip=4.0, thrust_tongue_tip=6.0)
    np.testing.assert_allclose(both[0, 1:], [4.0, 6.0], atol=0.01)
    # what no FAP says, or says 0 throughout, goes with the jaw
    jaw = drive.animate(clip_mm(head, open_jaw=12.0, shift_jaw=2.0)).parts["tongue"]
    carried = np.stack([jaw.moved(p, 1) for p in rest]) - rest
    assert carried[0, 1] < -4.0
    np.testing.assert_allclose(both[0, 0], carried[0, 0], atol=0.01)
    np.testing.assert_allclose(both[1], carried[1], atol=0.01)
    np.testing.assert_allclose(
        moved(open_jaw=12.0, shift_jaw=2.0, raise_tongue_tip=0.0), carried, atol=1e-6
    )


def test_faps_that_a_head_does_not_show_are_named(head: Head, drive: HeadDrive) -> None:
    assert drive.dead_faps == ("dilate_l_pupil", "dilate_r_pupil", "tongue_roll")
    rest = drive.animate(clip_mm(head, open_jaw=0.0)).vertices(1)
    turns = ("head_pitch", "head_yaw", "head_roll")  # the whole head's, not the vertices'
    for fap in fap_table()[2:]:
        moved = drive.animate(Clip(np.zeros(1), (fap.name,), np.full((1, 1), 90.0))).vertices(0)
        is_dead = fap.name in drive.dead_faps or fap.name in turns
        assert (np.abs(moved - rest).max() < 1e-9) == is_dead, fap.name


def test_a_head_without_tongue_and_eyeballs_says_so(head: Head) -> None:
    kept = ("skin", "lashes", "teeth_upper", "teeth_lower")
    mesh = replace(head.mesh, groups={n: head.mesh.groups[n] for n in kept})
    dead = HeadDrive(replace(head, mesh=mesh)).dead_faps
    assert {"raise_tongue", "thrust_tongue_tip", "yaw_l_eyeball", "thrust_r_eyeball"} <= set(dead)
    assert "close_t_l_eyelid" not in dead and "open_jaw" not in dead


def test_the_head_turns_about_the_neck(head: Head, drive: HeadDrive) -> None:
    faps = {"head_yaw": 50000.0, "head_pitch": 10000.0, "head_roll": -20000.0}
    clip = Clip(np.zeros(1), tuple(faps), np.array([list(faps.values())]))
    motion = drive.animate(clip).motion
    np.testing.assert_allclose(motion.world_from_head(head.neck_pivot[None])[0, 0], head.neck_pivot)
    c, s = np.cos(0.5), np.sin(0.5)
    yaw = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(0.1), np.sin(0.1)
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = np.cos(-0.2), np.sin(-0.2)
    roll = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(motion.rotation[0], yaw @ pitch @ roll, atol=1e-12)


def test_unset_faps_follow_their_partners() -> None:
    nan = np.nan
    clip = Clip(
        np.array([0.0, 1.0, 2.0]),
        ("raise_b_midlip_o", "raise_l_i_eyebrow", "close_t_l_eyelid", "close_t_r_eyelid"),
        np.array([[1.0, 5.0, 7.0, 0.0], [2.0, nan, 7.0, 0.0], [3.0, 9.0, nan, 0.0]]),
    )
    faps = complete_faps(clip)
    np.testing.assert_array_equal(faps["raise_b_midlip"], [1, 2, 3])  # the other contour's
    np.testing.assert_array_equal(faps["raise_r_i_eyebrow"], [5, 7, 9])  # the other side's, filled
    np.testing.assert_array_equal(faps["close_t_l_eyelid"], [7, 7, 7])
    np.testing.assert_array_equal(faps["close_t_r_eyelid"], [0, 0, 0])  # a wink stays a wink
    assert "open_jaw" not in faps


def test_every_paired_fap_has_a_partner_on_the_other_side() -> None:
    names = [n for n in fap_by_name() if "_l_" in n or "_r_" in n or "_lm" in n or "_rm" in n]
    assert len(names) == 46
    for name in names:
        partner = other_side(name)
        assert partner is not None and other_side(partner) == name


def test_the_chin_follows_the_jaw_unless_its_own_fap_speaks(head: Head, drive: HeadDrive) -> None:
    chin = head.feature_points.select(("2.10",))
    rest = chin.at(head.mesh.vertices)[0]

    def moved(**mm: float) -> NDArray[np.float64]:
        return np.asarray(chin.at(drive.animate(clip_mm(head, **mm)).vertices(1))[0] - rest)

    free = moved(open_jaw=15.0)
    bone = jaw_motion(head, complete_faps(clip_mm(head, open_jaw=15.0)), 2).displacement(rest)[1]
    np.testing.assert_allclose(free, bone, atol=1e-6)
    np.testing.assert_allclose(moved(open_jaw=15.0, depress_chin=0.0), free, atol=1e-6)
    assert moved(open_jaw=15.0, depress_chin=-9.0)[1] == pytest.approx(-9.0)


def test_wrong_clips_and_motions_are_told(head: Head, drive: HeadDrive) -> None:
    with pytest.raises(InputError, match="no FAP; its channels are jawOpen"):
        drive.animate(Clip(np.zeros(1), ("jawOpen",), np.ones((1, 1))))
    clip = clip_mm(head, open_jaw=1.0)
    other_times = HeadMotion(
        np.array([0.0, 0.5]), np.tile([1.0, 0, 0, 0], (2, 1)), np.zeros((2, 3))
    )
    with pytest.raises(InputError, match="other times"):
        drive.animate(clip, other_times)
    gaps = HeadMotion(clip.time_s, np.full((2, 4), np.nan), np.zeros((2, 3)))
    with pytest.raises(InputError, match="gaps"):
        drive.animate(clip, gaps)
