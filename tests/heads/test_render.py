from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.mesh import Mesh, SurfacePoints
from facewright.core.rigid import Rigid
from facewright.heads.appearance import Appearance
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.heads.render import HeadRenderer, portrait_camera

GREEN = (0, 255, 0)


@pytest.fixture(scope="module")
def head() -> Head:
    return make_head(Identity("someone"))


def plain(size: tuple[int, int]) -> NDArray[np.uint8]:
    return np.full((size[1], size[0], 3), GREEN, dtype=np.uint8)


def ball(radius_mm: float = 60.0, colour: tuple[int, int, int] = (150, 150, 150)) -> Head:
    """A sphere that claims to be a head."""
    n = 80
    lat, lon = np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    a, b = np.meshgrid(lat, lon, indexing="ij")
    v = radius_mm * np.stack([np.sin(a) * np.sin(b), np.cos(a), np.sin(a) * np.cos(b)], axis=-1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(2 * n), indexing="ij")
    k = (j + 1) % (2 * n)
    corner = [x.ravel() for x in (i * 2 * n + j, (i + 1) * 2 * n + j, (i + 1) * 2 * n + k)]
    other = [x.ravel() for x in (i * 2 * n + j, (i + 1) * 2 * n + k, i * 2 * n + k)]
    triangles = np.concatenate([np.stack(corner, 1), np.stack(other, 1)]).astype(np.int32)
    none = SurfacePoints((), np.zeros((0, 3), np.int32), np.zeros((0, 3)))
    looks = Appearance(np.full((4, 4, 3), colour, np.uint8))
    mesh = Mesh(v.reshape(-1, 3), triangles)
    return Head("ball", mesh, none, {}, np.zeros(3), np.zeros(3), looks)


def camera_for(size: tuple[int, int] = (160, 160), focal_px: float = 400.0) -> Camera:
    """500 mm in front of the origin, looking along −z, x of the picture along +x."""
    R = np.diag([1.0, -1.0, -1.0])
    K = np.array([[focal_px, 0, (size[0] - 1) / 2], [0, focal_px, (size[1] - 1) / 2], [0, 0, 1]])
    return Camera(size, K, Rigid.from_rotation(R, (0, 0, 500.0)))


def touched(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((picture != GREEN).any(axis=2))


def test_silhouette_is_the_projected_mesh(head: Head) -> None:
    size = (240, 270)
    camera = portrait_camera(head, size, yaw_rad=0.4)
    found = touched(HeadRenderer(head, background=plain(size)).render(head.mesh.vertices, camera))

    wanted = np.zeros((size[1], size[0]), np.uint8)
    skin = np.concatenate([head.mesh.groups[g] for g in head.mesh.groups if g != "lashes"])
    corners = camera.project(head.mesh.vertices)[head.mesh.triangles[skin]]
    for triangle in np.rint(corners * 16).astype(np.int32):
        cv2.fillConvexPoly(wanted, triangle.reshape(-1, 1, 2), 1, shift=4)
    sure = cv2.erode(wanted, np.ones((3, 3), np.uint8)).astype(bool)
    possible = cv2.dilate(wanted, np.ones((3, 3), np.uint8)).astype(bool)
    assert found[sure].all()
    assert not found[~possible].any()


def test_background_stays_as_it_is(head: Head) -> None:
    size = (120, 135)
    rng = np.random.default_rng(1)
    behind = rng.integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
    camera = portrait_camera(head, size)
    picture = HeadRenderer(head, background=behind).render(head.mesh.vertices, camera)

    outside = ~touched(
        HeadRenderer(head, background=plain(size)).render(head.mesh.vertices, camera)
    )
    assert outside.sum() > 1000
    assert np.array_equal(picture[outside], behind[outside])


def test_a_head_out_of_view_leaves_the_backdrop(head: Head) -> None:
    renderer = HeadRenderer(head)
    camera = portrait_camera(head, (64, 72))
    for shift in ((0, 0, 5000.0), (5000.0, 0, 0)):
        picture = renderer.render(head.mesh.vertices + shift, camera)
        assert np.array_equal(picture, renderer.backdrop((64, 72)))


def test_ball_is_a_circle_lit_from_the_key_side() -> None:
    picture = HeadRenderer(ball(), background=plain((160, 160)), supersample=3).render(
        ball().mesh.vertices, camera_for()
    )
    inside = touched(picture)
    y, x = np.nonzero(inside)
    # a sphere of radius r at distance d has the half angle asin(r / d)
    radius_px = 400 * np.tan(np.arcsin(60 / 500))
    assert abs(inside.sum() - np.pi * radius_px**2) < 2 * np.pi * radius_px
    assert abs(x.mean() - 79.5) < 0.2 and abs(y.mean() - 79.5) < 0.2

    light = picture.astype(float).mean(axis=2)
    c, off = 80, int(0.6 * radius_px)
    assert light[c, c - off] > 1.15 * light[c, c + off]  # key: the subject's right
    assert light[c - off, c] > 1.3 * light[c + off, c]  # and from above


def test_lights_stand_still_in_the_world_and_turn_with_the_stage() -> None:
    b, camera = ball(), camera_for()
    R = np.diag([-1.0, 1.0, -1.0])  # half a turn about y
    here = HeadRenderer(b).render(b.mesh.vertices, camera)
    turned_head = HeadRenderer(b).render(b.mesh.vertices, camera, Rigid.from_rotation(R))
    turned_stage = HeadRenderer(b, stage=Rigid.from_rotation(R)).render(b.mesh.vertices, camera)
    assert np.abs(here.astype(int) - turned_head).max() <= 12  # other triangles, same light
    assert here[60:100, 60:100].mean() > 1.5 * turned_stage[60:100, 60:100].mean()


def test_a_pose_of_the_head_equals_moved_vertices(head: Head) -> None:
    pose = Rigid.from_rotation(cv2.Rodrigues(np.array([0.1, 0.3, -0.05]))[0], (10, 5, -20))
    camera = portrait_camera(head, (96, 108))
    renderer = HeadRenderer(head)
    a = renderer.render(head.mesh.vertices, camera, pose)
    b = renderer.render(pose.apply(head.mesh.vertices), camera)
    assert np.array_equal(a, b)


def test_picture_shifts_with_the_principal_point(head: Head) -> None:
    size, shift = (200, 200), (7, -4)
    camera = portrait_camera(head, size)
    K = camera.matrix * np.array([[0.6, 1, 1], [1, 0.6, 1], [1, 1, 1]])
    small = replace(camera, matrix=K)
    moved = replace(small, matrix=K + [[0, 0, shift[0]], [0, 0, shift[1]], [0, 0, 0]])
    renderer = HeadRenderer(head, background=plain(size))
    a = renderer.render(head.mesh.vertices, small).astype(int)
    b = renderer.render(head.mesh.vertices, moved).astype(int)
    difference = np.abs(a[14:180, 10:180] - b[14 + shift[1] : 180 + shift[1], 17:187])
    # single-precision rays may swap a triangle at an edge: hardly any sample does
    assert np.quantile(difference, 0.999) <= 1
    assert (a[30:100] != b[30:100]).mean() > 0.1


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("opencv", (-0.35, 0.1, 0.004, -0.006, 0.0)), ("tsai", (0.4,)), ("none", ())],
)
def test_lens_distortion_is_honoured(model: str, coefficients: tuple[float, ...]) -> None:
    b = ball(radius_mm=6.0)
    camera = replace(
        camera_for((220, 200)), distortion_model=model, distortion=np.array(coefficients)
    )
    for place in ((100.0, 80.0, 0.0), (-110.0, 60.0, 30.0), (20.0, -90.0, -10.0)):
        vertices = b.mesh.vertices + place
        picture = HeadRenderer(b, background=plain((220, 200)), supersample=4).render(
            vertices, camera
        )
        y, x = np.nonzero(touched(picture))
        outline = camera.project(vertices)
        assert abs(x.min() - outline[:, 0].min()) < 1 and abs(x.max() - outline[:, 0].max()) < 1
        assert abs(y.min() - outline[:, 1].min()) < 1 and abs(y.max() - outline[:, 1].max()) < 1


def test_rendering_is_deterministic(head: Head) -> None:
    camera = portrait_camera(head, (96, 108))
    vertices = head.shaped({"jawOpen": 0.6, "eyeBlinkLeft": 0.5})
    first = HeadRenderer(head).render(vertices, camera)
    renderer = HeadRenderer(head)
    renderer.render(head.mesh.vertices, camera)
    assert np.array_equal(first, renderer.render(vertices, camera))


def test_eyes_look_forward_and_show_both_irises(head: Head) -> None:
    size = (480, 540)
    camera = portrait_camera(head, size)
    picture = HeadRenderer(head).render(head.mesh.vertices, camera).astype(float)
    for eye in head.eyes.values():
        axis_end = eye.centre + (0, 0, eye.radius)
        x, y = camera.project(axis_end)
        patch = picture[round(y) - 2 : round(y) + 3, round(x) - 12 : round(x) + 13].mean(axis=2)
        dark = 255 - patch.mean(axis=0)
        weight = dark - dark.min()
        middle = (weight * np.arange(25)).sum() / weight.sum() - 12
        assert abs(middle) < 1.6  # px: the dark disc lies on the axis
        assert patch[:, 10:15].mean() < 0.6 * patch.max()


def test_supersampling_softens_edges(head: Head) -> None:
    b, camera = ball(colour=(255, 255, 255)), camera_for()
    black = np.zeros((160, 160, 3), np.uint8)
    hard = HeadRenderer(b, background=black, supersample=1).render(b.mesh.vertices, camera)
    soft = HeadRenderer(b, background=black, supersample=4).render(b.mesh.vertices, camera)
    assert (soft > 0).any(axis=2).sum() > (hard > 0).any(axis=2).sum()


def test_wrong_vertices_are_refused(head: Head) -> None:
    renderer, camera = HeadRenderer(head), portrait_camera(head, (32, 36))
    with pytest.raises(ValueError, match="vertices must have shape"):
        renderer.render(head.mesh.vertices[:-1], camera)
    with pytest.raises(ValueError, match="finite"):
        renderer.render(np.full_like(head.mesh.vertices, np.nan), camera)
    with pytest.raises(ValueError, match="supersample"):
        HeadRenderer(head, supersample=0)
