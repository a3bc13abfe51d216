"""Heads of other makers become heads that can be driven.

Truth: people of ours in disguise (every point is known), a mask whose vertices carry the numbers of
a published index map, and a head of another origin whose own shapes tell what is lip, lid and jaw.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.datasets_synthetic.foreign_heads import ForeignHead, foreign_head
from facewright.heads import own_start
from facewright.heads.face_landmarks import NAMED_LANDMARKS
from facewright.heads.face_network import face_networks_path
from facewright.heads.head import Head
from facewright.heads.lip_slit import lips_part
from facewright.heads.own_head import OwnHead, own_head, read_own_head
from facewright.heads.own_mesh import OwnMesh
from facewright.heads.own_points import near_surface
from facewright.heads.place_face_landmarks import template_face_landmarks
from facewright.heads.raycast import import_open3d
from facewright.heads.skin_surface import Surface
from facewright.heads.subdivision import icosphere
from facewright.retarget.drive import HeadDrive

CLICKS = ("3.7", "3.8", "9.3", "8.3", "8.4")
needs_networks = pytest.mark.skipif(
    face_networks_path() is None, reason="the face networks are not installed (facewright doctor)"
)


def as_mesh(foreign: ForeignHead) -> OwnMesh:
    none = np.zeros(len(foreign.triangles), np.int32)
    return OwnMesh(foreign.vertices, foreign.triangles, ("mesh",), none)


def errors_mm(own: OwnHead, foreign: ForeignHead) -> dict[str, float]:
    found = own.points_in_file()["feature point"]
    return {
        name: float(np.linalg.norm(found[name] - foreign.unit_mm * p))
        for name, p in foreign.points.items()
        if name in found
    }


@pytest.fixture(scope="module")
def stranger(people: tuple[Head, ...]) -> ForeignHead:
    """A person in centimetres, z up, some degrees tilted."""
    rng = np.random.default_rng(8)
    return foreign_head(people[3], rng, skin_vertices=5000, unit_mm=10.0, turn="z up")


@pytest.fixture(scope="module")
def clicked(stranger: ForeignHead) -> OwnHead:
    """The stranger by five clicks, in millimetres though the mesh is in centimetres."""
    clicks = {name: 10.0 * stranger.points[name] for name in CLICKS}
    return own_head(as_mesh(stranger), "stranger", clicks)


def test_five_clicks_place_all_feature_points(clicked: OwnHead, stranger: ForeignHead) -> None:
    off = errors_mm(clicked, stranger)

    assert set(stranger.points) <= set(off)
    assert np.mean(list(off.values())) < 2.0
    assert max(off.values()) < 5.0, sorted(off.items(), key=lambda item: -item[1])[:4]
    for name in CLICKS:  # what a person gives is taken as it is, on the nearest surface
        assert off[name] < 0.3


def test_unit_axes_and_parts_are_recognised_and_said(
    clicked: OwnHead, people: tuple[Head, ...]
) -> None:
    said = " | ".join(clicked.notes)
    truth, found = people[3], clicked.head

    assert clicked.unit_mm == 10.0
    assert "centimetres" in said
    assert "+Z is up" in said and "-Y" in said
    assert set(found.mesh.groups) == set(truth.mesh.groups) - {"lashes"}
    for part in ("teeth_upper", "teeth_lower", "tongue", "eye_left", "eye_right"):
        assert len(found.mesh.groups[part]) == len(truth.mesh.groups[part])
    for side, eye in found.eyes.items():
        assert abs(eye.radius - truth.eyes[side].radius) < 0.6
        assert np.linalg.norm(eye.centre - truth.eyes[side].centre) < 1.5
    assert np.linalg.norm(found.jaw_pivot - truth.jaw_pivot) < 5.0


def test_the_head_frame_is_straight(clicked: OwnHead, stranger: ForeignHead) -> None:
    """The file's axes from the head's are what the disguise says, up to a degree or two."""
    between = clicked.file_from_head.rotation @ stranger.turn.T

    assert np.degrees(np.arccos(min(1.0, (np.trace(between) - 1) / 2))) < 2.5
    eyes = [eye.centre for eye in clicked.head.eyes.values()]
    np.testing.assert_allclose(np.mean(eyes, axis=0), 0.0, atol=1e-9)


def test_the_stranger_moves(clicked: OwnHead) -> None:
    """Lips part, lids close, eyes turn, the jaw takes teeth and tongue along."""
    head = clicked.head
    drive = HeadDrive(head)
    faps = {
        "open_jaw": 600.0,
        "raise_b_midlip": -500.0,
        "close_t_l_eyelid": 1024.0,
        "close_t_r_eyelid": 0.0,
        "yaw_l_eyeball": 30000.0,
    }
    clip = Clip(np.zeros(1), tuple(faps), np.array([list(faps.values())]))

    moved = drive.animate(clip).vertices(0)

    at = dict(zip(head.feature_points.names, head.feature_points.at(moved), strict=True))
    went = {name: at[name] - head.points[name] for name in at}
    assert clicked.lips_part
    assert lips_part(head)
    assert went["2.3"][1] < -4.0
    assert abs(went["2.2"][1]) < 0.5
    assert went["2.1"][1] < -4.0
    assert at["3.1"][1] - at["3.3"][1] < 0.3 * (head.points["3.1"] - head.points["3.3"])[1]
    assert abs(went["3.2"][1]) < 0.3
    assert abs(went["3.5"][0]) > 1.0
    lower, upper = (head.part_vertices(f"teeth_{part}") for part in ("lower", "upper"))
    assert (moved - head.mesh.vertices)[lower, 1].mean() < -2.0
    assert np.abs((moved - head.mesh.vertices)[upper]).max() < 1e-9


@pytest.mark.parametrize(
    "names",
    [
        ("nose_tip", "mouth_left", "mouth_right"),
        ("eye_right_outer", "eye_left_outer", "mouth_left"),
    ],
)
def test_three_rough_clicks_with_plain_names_are_enough(
    people: tuple[Head, ...], names: tuple[str, ...]
) -> None:
    """Each 1.5 mm off along every axis, as a hand with a mouse may be; mean 0.4 to 0.8 mm."""
    rng = np.random.default_rng(21)
    foreign = foreign_head(people[9], rng, unit_mm=1.0, turn="x up")
    marks = template_face_landmarks()
    at = dict(zip(marks.names, marks.at(people[9].mesh.vertices), strict=True))
    rough = {n: at[str(NAMED_LANDMARKS[n])] + rng.normal(0, 1.5, 3) for n in names}
    clicks = {n: foreign.turn @ p + foreign.shift for n, p in rough.items()}

    found = own_head(as_mesh(foreign), "rough", clicks)

    off = errors_mm(found, foreign)
    assert np.mean(list(off.values())) < 1.2
    assert max(off.values()) < 5.0


@pytest.mark.slow
def test_two_hundred_thousand_vertices_are_taken(people: tuple[Head, ...]) -> None:
    rng = np.random.default_rng(22)
    foreign = foreign_head(people[1], rng, skin_vertices=14_000, unit_mm=1.0, turn="y up")
    o3d = import_open3d()
    coarse = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(foreign.vertices)),
        o3d.utility.Vector3iVector(np.array(foreign.triangles)),
    )
    fine = coarse.subdivide_midpoint(2)
    triangles = np.asarray(fine.triangles).astype(np.int32)
    none = np.zeros(len(triangles), np.int32)

    found = own_head(
        OwnMesh(np.asarray(fine.vertices), triangles, ("mesh",), none),
        "fine",
        {n: foreign.points[n] for n in CLICKS},
    )

    assert len(found.head.mesh.vertices) > 200_000
    off = errors_mm(found, foreign)
    assert set(foreign.points) <= set(off)
    assert np.mean(list(off.values())) < 1.5
    assert max(off.values()) < 5.0


def test_gums_of_both_jaws_in_one_shell_are_cut(
    clicked: OwnHead, stranger: ForeignHead, people: tuple[Head, ...]
) -> None:
    """A bridge of skin between the two arches makes one shell of them; each can move alone."""
    arches = [people[3].mesh.groups[f"teeth_{part}"] for part in ("upper", "lower")]
    parts = [np.unique(people[3].mesh.triangles[rows]) for rows in arches]
    seat = [people[3].mesh.vertices[rows] for rows in parts]
    back = [p[np.argsort(p[:, 2])[:2]] for p in seat]
    place = np.concatenate(back) @ stranger.turn.T / stranger.unit_mm + stranger.shift
    rows = [int(np.argmin(np.linalg.norm(stranger.vertices - p, axis=1))) for p in place]
    bridge = np.array([[rows[0], rows[1], rows[2]], [rows[1], rows[3], rows[2]]], np.int32)
    mesh = as_mesh(stranger)
    joined = replace(
        mesh,
        triangles=np.concatenate([mesh.triangles, bridge]),
        label_of_triangle=np.zeros(len(mesh.triangles) + 2, np.int32),
    )

    found = own_head(joined, "bridged", {n: stranger.points[n] for n in CLICKS})

    assert any("it is cut" in note for note in found.notes)
    assert not any("it is cut" in note for note in clicked.notes)
    upper, lower = (
        set(found.head.part_vertices(f"teeth_{p}").tolist()) for p in ("upper", "lower")
    )
    assert upper and lower and not upper & lower


def test_hair_and_hats_are_no_skin(stranger: ForeignHead) -> None:
    """A cap over the skull with more triangles than the face, unnamed, is left aside as other."""
    ball, sides = icosphere(5)
    crown = stranger.points["11.4"]
    n = len(stranger.vertices)
    radius = 1.2 * np.linalg.norm(crown - stranger.points["11.1"])
    cap = OwnMesh(
        np.concatenate([stranger.vertices, crown + radius * ball]),
        np.concatenate([stranger.triangles, sides + n]),
        ("mesh",),
        np.zeros(len(stranger.triangles) + len(sides), np.int32),
    )

    found = own_head(cap, "hat", {n: stranger.points[n] for n in CLICKS})

    assert len(found.head.mesh.groups["other"]) == len(sides)
    assert max(errors_mm(found, stranger).values()) < 5.0


def test_inside_out_meshes_are_turned_over(clicked: OwnHead, stranger: ForeignHead) -> None:
    turned = replace(as_mesh(stranger), triangles=stranger.triangles[:, ::-1])
    clicks = {name: stranger.points[name] for name in stranger.points}

    found = own_head(turned, "turned", clicks)

    assert any("inside out" in note for note in found.notes)
    skin = clicked.head.mesh.groups["skin"]
    there = found.head.mesh.vertices[found.head.mesh.triangles[found.head.mesh.groups["skin"]]]
    here = clicked.head.mesh.vertices[clicked.head.mesh.triangles[skin]]
    assert signed_volume(there) * signed_volume(here) > 0


def signed_volume(corners: NDArray[np.float64]) -> float:
    return float(np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def test_a_head_without_eyes_gets_eyeballs_behind_its_lids(people: tuple[Head, ...]) -> None:
    rng = np.random.default_rng(10)
    without = ("lashes", "eye_left", "eye_right", "tongue")
    foreign = foreign_head(people[6], rng, unit_mm=1.0, turn="y up", without=without)

    found = own_head(as_mesh(foreign), "hollow", {n: foreign.points[n] for n in CLICKS})

    assert sum("eyeball" in note for note in found.notes) == 2
    assert "tongue" not in found.head.mesh.groups
    for side, eye in found.head.eyes.items():
        truth = people[6].eyes[side]
        assert len(found.head.mesh.groups[f"eye_{side}"]) > 0
        assert np.linalg.norm(eye.centre - truth.centre) < 3.0
        assert abs(eye.radius - truth.radius) < 1.5
    assert max(errors_mm(found, foreign).values()) < 5.0


def test_a_whole_body_is_cut_below_the_shoulders(people: tuple[Head, ...]) -> None:
    rng = np.random.default_rng(11)
    foreign = foreign_head(people[7], rng, unit_mm=1000.0, turn="facing back")
    feet = (np.eye(3) * 0.2 + (0.0, -1.7, 0.0)) @ foreign.turn.T + foreign.shift
    n = len(foreign.vertices)
    body = OwnMesh(
        np.concatenate([foreign.vertices, feet]),
        np.concatenate([foreign.triangles, [[n, n + 1, n + 2]]]),
        ("avatar",),
        np.zeros(len(foreign.triangles) + 1, np.int32),
    )

    found = own_head(body, "avatar", foreign.points)

    assert any("whole body" in note for note in found.notes)
    assert found.head.mesh.vertices[:, 1].min() > -400.0
    assert len(found.head.mesh.triangles) == len(foreign.triangles)


def test_points_that_do_not_fit_are_refused(stranger: ForeignHead) -> None:
    mesh = as_mesh(stranger)
    elsewhere = {n: stranger.points[n] * (1, -1, 3) + 99 for n in CLICKS}

    with pytest.raises(InputError, match="do not lie on the mesh"):
        own_head(mesh, "stranger", elsewhere)
    with pytest.raises(InputError, match="at least 3 are needed"):
        own_head(mesh, "stranger", {n: stranger.points[n] for n in CLICKS[:2]})
    with pytest.raises(InputError, match="at least 3 are needed"):
        own_head(mesh, "stranger", {f"my {n}": stranger.points[n] for n in CLICKS})


def test_without_networks_it_is_said_which_points_to_give(
    stranger: ForeignHead, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_start, "face_networks_path", lambda: None)

    with pytest.raises(InputError, match=r"face networks must be installed.*--points"):
        own_head(as_mesh(stranger), "stranger")


@needs_networks
def test_what_has_no_face_is_refused() -> None:
    ball, sides = icosphere(3)

    with pytest.raises(InputError, match=r"no face is seen on the mesh from any side; give 3 to 7"):
        own_head(OwnMesh(ball, sides, ("ball",), np.zeros(len(sides), np.int32)), "ball")


def test_a_face_that_ours_does_not_fit_is_said(stranger: ForeignHead, clicked: OwnHead) -> None:
    """Points on a head stretched to twice its height: taken, and said to look at the chart."""
    tall = np.diag([1.0, 1.0, 2.0])  # the stranger's z is up
    mesh = replace(as_mesh(stranger), vertices=stranger.vertices @ tall)

    found = own_head(mesh, "tall", {n: stranger.points[n] @ tall for n in CLICKS})

    assert any("fits it badly" in note and "chart" in note for note in found.notes)
    assert not any("fits it badly" in note for note in clicked.notes)


def test_points_without_surface_near_them_are_left_out(average_head: Head) -> None:
    skin = average_head.mesh.triangles[average_head.mesh.groups["skin"]]
    surface = Surface(average_head.mesh.vertices, skin)
    tip = average_head.points["9.3"]

    found = near_surface(surface, {"on it": tip, "off it": tip + (0, 0, 30)})

    assert set(found) == {"on it"}


@needs_networks
@pytest.mark.slow
def test_a_stranger_is_found_without_any_click(people: tuple[Head, ...]) -> None:
    rng = np.random.default_rng(9)
    foreign = foreign_head(people[4], rng, unit_mm=1000.0, turn="facing back")

    found = own_head(as_mesh(foreign), "stranger")

    off = errors_mm(found, foreign)
    assert found.placed == "found"
    assert found.unit_mm == 1000.0
    assert np.mean(list(off.values())) < 2.0
    assert max(off.values()) < 5.0


#: Feature points and the vertices of the published 468-point map at the same places.
INDEX_MAP = {
    "8.3": 291, "8.4": 61, "9.3": 4, "8.1": 0, "8.2": 17, "2.2": 13, "2.3": 14, "3.7": 263,
    "3.12": 33, "3.11": 362, "3.8": 133, "2.10": 199, "9.1": 358, "9.2": 129,
}  # fmt: skip


@needs_networks
def test_a_mask_without_openings(real_data: Path) -> None:
    """468 vertices in centimetres, no ears, eyes and mouth covered: taken, and said."""
    found = read_own_head(real_data / "heads" / "canonical_face_model.obj")

    vertices = found.head.mesh.vertices  # in the file's order: nothing is joined
    off = {
        n: float(np.linalg.norm(found.head.points[n] - vertices[i])) for n, i in INDEX_MAP.items()
    }
    assert max(off.values()) < 6.0, off
    assert np.mean(list(off.values())) < 3.5
    assert found.unit_mm == 10.0
    assert not found.lips_part
    assert not lips_part(found.head)
    assert any("no opening between the lips" in note for note in found.notes)
    assert not {"10.1", "11.6"} & set(found.head.feature_points.names)
    HeadDrive(found.head)  # can be driven


@pytest.fixture(scope="module")
def ict(real_data: Path) -> OwnHead:
    return read_own_head(real_data / "heads" / "ict_random_identity.glb")


@needs_networks
def test_a_head_of_another_origin_by_its_own_shapes(ict: OwnHead) -> None:
    """What its makers let a shape move is where we say the feature points are."""
    head = ict.head

    def went(shape: str, point: str) -> NDArray[np.float64]:
        moved = head.shaped({shape: 1.0})
        here = head.feature_points.select((point,))
        return np.asarray((here.at(moved) - here.at(head.mesh.vertices))[0])

    assert ict.lips_part
    assert went("jawOpen", "2.3")[1] < -8.0
    assert abs(went("jawOpen", "2.2")[1]) < 3.0
    assert went("jawOpen", "2.1")[1] < -8.0
    for side, top, bottom, other in (("L", "3.1", "3.3", "3.2"), ("R", "3.2", "3.4", "3.1")):
        gap = head.points[top][1] - head.points[bottom][1]
        closing = went(f"eyeBlink_{side}", bottom)[1] - went(f"eyeBlink_{side}", top)[1]
        assert 0.8 * gap < closing < 1.2 * gap + 0.5
        assert np.linalg.norm(went(f"eyeBlink_{side}", other)) < 0.2
    for side, corner in (("L", "8.3"), ("R", "8.4")):
        smile = head.shaped({f"mouthSmile_{side}": 1.0}) - head.mesh.vertices
        furthest = np.linalg.norm(smile[head.part_vertices("skin")], axis=1).max()
        assert np.linalg.norm(went(f"mouthSmile_{side}", corner)) > 0.75 * furthest


@needs_networks
@pytest.mark.slow
def test_a_head_of_another_origin_moves_by_faps(ict: OwnHead) -> None:
    """Jaw and lower teeth go down, upper teeth stay, each eye turns about its own centre."""
    head = ict.head
    faps = {"open_jaw": 600.0, "raise_b_midlip": -500.0, "yaw_l_eyeball": 20000.0,
            "yaw_r_eyeball": 0.0}  # fmt: skip
    clip = Clip(np.zeros(1), tuple(faps), np.array([list(faps.values())]))

    moved = HeadDrive(head).animate(clip).vertices(0)

    went = moved - head.mesh.vertices
    at = dict(zip(head.feature_points.names, head.feature_points.at(went), strict=True))
    assert at["2.3"][1] < -4.0
    assert abs(at["2.2"][1]) < 0.5
    assert at["2.1"][1] < -4.0
    assert went[head.part_vertices("teeth_lower"), 1].mean() < -2.0
    assert np.abs(went[head.part_vertices("teeth_upper")]).max() < 1e-9
    assert np.abs(went[head.part_vertices("eye_right")]).max() < 1e-9
    rows, eye = head.part_vertices("eye_left"), head.eyes["left"]
    before, after = head.mesh.vertices[rows] - eye.centre, moved[rows] - eye.centre
    np.testing.assert_allclose(
        np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1), atol=1e-9
    )
    np.testing.assert_allclose(after[:, 1], before[:, 1], atol=1e-9)
    turned = np.arctan2(after[:, 0], after[:, 2]) - np.arctan2(before[:, 0], before[:, 2])
    front = before[:, 2] > 0.5 * eye.radius
    np.testing.assert_allclose(turned[front], 20000.0 * 1e-5, atol=1e-9)


@needs_networks
def test_lids_of_another_origin_close_over_the_eyeballs_found(ict: OwnHead) -> None:
    """Their makers' blink slides over the ball that we have fitted to the eye's shells."""
    head = ict.head
    for side, shape, lid in (("left", "eyeBlink_L", "3.1"), ("right", "eyeBlink_R", "3.2")):
        eye = head.eyes[side]
        closed = head.feature_points.select((lid,)).at(head.shaped({shape: 1.0}))[0]

        assert -0.5 < np.linalg.norm(closed - eye.centre) - eye.radius < 3.0
