from __future__ import annotations

from dataclasses import replace
from typing import Any

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
from facewright.heads.layers import ExtraMesh, Layers, film_curve
from facewright.heads.raycast import NO_HIT
from facewright.heads.render import HeadRenderer, portrait_camera
from facewright.heads.srgb import linear_from_srgb, srgb_from_linear
from facewright.heads.stage_lights import LIGHT_NAMES, Lamp, StageLights

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


def plate(
    corners: list[tuple[float, float, float]], colour: tuple[float, float, float]
) -> ExtraMesh:
    """A flat four-sided thing in the world."""
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    return ExtraMesh(np.array(corners), triangles, np.tile(colour, (4, 1)))


def facing_plate(z: float, half: float, colour: tuple[float, float, float]) -> ExtraMesh:
    return plate([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)], colour)


def lit(picture: Layers) -> NDArray[np.float64]:
    """Mean light over the whole box and all colours, for comparison."""
    return np.asarray(picture.light.mean(axis=(0, 1)), dtype=np.float64)


@pytest.mark.parametrize("quick", [False, True])
def test_coverage_of_a_ball_is_the_area_of_its_outline(quick: bool) -> None:
    b = ball()
    renderer = HeadRenderer(b, quick=quick, supersample=4)
    layers = renderer.render_layers(b.mesh.vertices, camera_for())

    # of the polyhedron, a little less than of the sphere: 80 by 160 corners
    outline = cv2.convexHull(camera_for().project(b.mesh.vertices).astype(np.float32))
    wanted = cv2.contourArea(outline)
    assert layers.cover.sum() == pytest.approx(wanted, rel=2e-3)
    edge = (layers.cover > 0) & (layers.cover < 1)
    assert 150 < edge.sum() < 600  # about 300 pixels of outline, all of them softened


def test_quick_pictures_are_close_to_fine_ones(head: Head) -> None:
    camera = portrait_camera(head, (300, 330), yaw_rad=0.3)
    fine = HeadRenderer(head, supersample=3).render(head.mesh.vertices, camera).astype(int)
    quick = HeadRenderer(head, quick=True).render(head.mesh.vertices, camera)
    off = np.abs(fine - quick)
    assert off.mean() < 2.0 and np.quantile(off, 0.99) < 24


def test_layers_over_the_backdrop_are_the_picture(head: Head) -> None:
    camera = portrait_camera(head, (120, 135))
    renderer = HeadRenderer(head)
    layers = renderer.render_layers(head.mesh.vertices, camera)
    backdrop = renderer.backdrop(camera.image_size)
    shown = replace(layers, light=film_curve_of(layers))
    mixed = srgb_from_linear(shown.over(linear_from_srgb(backdrop)))
    picture = renderer.render(head.mesh.vertices, camera)
    assert np.abs(mixed.astype(int) - picture).max() <= 1
    assert layers.light.dtype == layers.cover.dtype == np.float32
    assert (layers.cover >= 0).all() and (layers.cover <= 1).all()


def film_curve_of(layers: Layers) -> NDArray[np.float32]:
    cover = np.maximum(layers.cover, 1e-6)[..., None]
    light = film_curve(np.asarray(layers.light / cover, dtype=np.float32))
    return np.asarray(light * layers.cover[..., None])


def test_the_film_curve_keeps_the_darks_and_never_reaches_white() -> None:
    light = np.linspace(0, 6, 2001, dtype=np.float32)
    shown = film_curve(light)
    np.testing.assert_array_equal(shown[light <= 0.5], light[light <= 0.5])
    slope = np.diff(shown) / np.diff(light)
    assert (slope[light[1:] < 4] > 0).all() and shown.max() <= 1
    assert np.abs(np.diff(slope)).max() < 0.02  # no kink


@pytest.mark.parametrize("quick", [False, True])
def test_hits_lie_on_the_rays_of_their_pixels(head: Head, quick: bool) -> None:
    camera = replace(
        portrait_camera(head, (200, 220), yaw_rad=0.5),
        distortion_model="opencv",
        distortion=np.array((-0.2, 0.05, 0.001, 0.002, 0.0)),
    )
    v = head.shaped({"jawOpen": 0.5})
    renderer = HeadRenderer(head, quick=quick, supersample=1)
    layers = renderer.render_layers(v, camera)

    rows, columns = np.nonzero(layers.triangle != NO_HIT)
    w = layers.weights[rows, columns].astype(float)
    b = np.column_stack([1 - w.sum(axis=1), w])
    corners = v[head.mesh.triangles[layers.triangle[rows, columns]]]
    at = camera.project(np.einsum("nc,ncx->nx", b, corners))
    wanted = np.column_stack([columns + layers.box[0], rows + layers.box[1]])
    assert len(rows) > 5000
    # single precision; more on slivers seen along their plane
    off = np.abs(at - wanted)
    assert np.sqrt((off**2).mean()) < 2e-4 and off.max() < 0.02


def test_light_is_linear_in_the_lamps() -> None:
    b, camera = ball(), camera_for()
    one = StageLights.preset("studio")

    def doubled(lamp: Lamp) -> Lamp:
        return replace(lamp, colour=2 * lamp.colour)

    lamps = doubled(one.key), doubled(one.fill), doubled(one.rim)
    two = StageLights(*lamps, 2 * one.sky, 2 * one.ground)
    a = HeadRenderer(b, lights=one).render_layers(b.mesh.vertices, camera)
    c = HeadRenderer(b, lights=two).render_layers(b.mesh.vertices, camera)
    np.testing.assert_allclose(c.light, 2 * a.light, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(a.cover, c.cover)


def test_each_camera_gets_what_a_fresh_renderer_draws(head: Head) -> None:
    cameras = [portrait_camera(head, (96, 108), yaw_rad=yaw) for yaw in (-0.6, 0.0, 0.6)]
    first, second = head.shaped({"jawOpen": 0.4}), head.shaped({"mouthSmileLeft": 0.7})
    hat = replace(facing_plate(0, 30, (0.2, 0.5, 0.2)), frame="head")
    kept = HeadRenderer(head, quick=True)
    for vertices, extra in ((first, ()), (second, ()), (second, (hat,)), (first, ())):
        for camera in cameras:
            pose = Rigid.identity()
            here = kept.render_layers(vertices, camera, pose, extra=extra)
            fresh = HeadRenderer(head, quick=True).render_layers(
                vertices, camera, pose, extra=extra
            )
            assert np.array_equal(here.light, fresh.light)


def test_an_extra_mesh_hides_what_is_behind_it_in_its_colour() -> None:
    b, camera = ball(), camera_for()
    red = facing_plate(100.0, 15.0, (0.6, 0.02, 0.02))
    layers = HeadRenderer(b).render_layers(b.mesh.vertices, camera, extra=[red])
    x0, y0, *_ = layers.box
    corner = camera.project(np.array([-15.0, 15.0, 100.0]))
    side = camera.project(np.array([15.0, -15.0, 100.0])) - corner

    of_plate = (layers.triangle != NO_HIT) & (layers.triangle >= len(b.mesh.triangles))
    rows, columns = np.nonzero(of_plate)
    assert of_plate.sum() == pytest.approx(side.prod(), rel=0.15)
    assert abs(columns.min() + x0 - corner[0]) <= 1 and abs(rows.min() + y0 - corner[1]) <= 1
    r, g, _ = layers.light[of_plate & (layers.cover == 1)].mean(axis=0)
    assert r > 8 * g


def test_an_extra_mesh_casts_a_shadow_towards_where_the_light_goes() -> None:
    b, camera = ball(), camera_for()
    lights = StageLights.preset("hard sun")
    towards = lights.key.towards
    middle = 60.0 * np.array([0.0, 0.0, 1.0])
    # a plate out of the picture, between the light and the nearest place of the ball
    far = middle + 300 * towards
    u = np.cross(towards, (0, 1, 0))
    u /= np.linalg.norm(u)
    v = np.cross(u, towards)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    shade = plate([tuple(far + 12 * (a * u + c * v)) for a, c in signs], (0.5, 0.5, 0.5))
    free = HeadRenderer(b, lights=lights).render_layers(b.mesh.vertices, camera)
    dark = HeadRenderer(b, lights=lights).render_layers(b.mesh.vertices, camera, extra=[shade])

    def at(layers: Layers, place: NDArray[np.float64]) -> float:
        x, y = np.rint(camera.project(place)).astype(int) - layers.box[:2]
        return float(layers.light[y, x].mean())

    assert at(dark, middle) < 0.5 * at(free, middle)
    beside = 60.0 * np.array([-0.5, 0.0, 0.866])
    assert at(dark, beside) == pytest.approx(at(free, beside), rel=0.02)


def test_an_extra_mesh_in_the_heads_frame_moves_with_it(head: Head) -> None:
    camera = portrait_camera(head, (96, 108))
    pose = Rigid.from_rotation(cv2.Rodrigues(np.array([0.0, 0.3, 0.1]))[0], (5, -8, 10))
    here = facing_plate(60.0, 25.0, (0.1, 0.3, 0.6))
    there = replace(here, vertices=pose.apply(here.vertices))
    renderer = HeadRenderer(head, quick=True)
    a = renderer.render_layers(
        head.mesh.vertices, camera, pose, extra=[replace(here, frame="head")]
    )
    b = renderer.render_layers(head.mesh.vertices, camera, pose, extra=[there])
    assert np.array_equal(a.light, b.light)
    with pytest.raises(ValueError, match="needs world_from_head"):
        renderer.render(head.mesh.vertices, camera, extra=[replace(here, frame="head")])


def test_nothing_in_view_gives_empty_layers(head: Head) -> None:
    camera = portrait_camera(head, (64, 72))
    layers = HeadRenderer(head).render_layers(head.mesh.vertices + (0, 0, 5000.0), camera)
    assert layers.box == (0, 0, 0, 0) and layers.light.shape == (0, 0, 3)
    behind = np.full((72, 64, 3), 0.25, np.float32)
    np.testing.assert_array_equal(layers.over(behind), behind)


def test_presets_have_their_colours_and_shadows() -> None:
    b, camera = ball(), camera_for()

    def drawn(name: str) -> Layers:
        lights = StageLights.preset(name)
        return HeadRenderer(b, lights=lights).render_layers(b.mesh.vertices, camera)

    light = {name: lit(drawn(name)) for name in LIGHT_NAMES}
    warmth = {name: float(c[0] / c[2]) for name, c in light.items()}
    assert warmth["warm room"] > 1.35 * warmth["overcast"]
    means = np.array([c.mean() for c in light.values()])
    assert means.max() < 1.6 * means.min()  # exposed alike

    def contrast(name: str) -> float:
        seen = drawn(name)
        whole = seen.light[seen.cover == 1].mean(axis=1)
        return float(np.quantile(whole, 0.95) / np.quantile(whole, 0.05))

    assert contrast("hard sun") > 1.5 * contrast("overcast")
    with pytest.raises(ValueError, match="lights must be one of studio"):
        StageLights.preset("candle")


def test_random_lights_follow_the_generator_and_come_from_in_front() -> None:
    drawn = [StageLights.random(np.random.default_rng(k)) for k in range(60)]
    again = StageLights.random(np.random.default_rng(7))
    assert np.array_equal(again.key.towards, drawn[7].key.towards)
    towards = np.array([lights.key.towards for lights in drawn])
    assert (towards[:, 2] > 0.15).all()
    assert (towards[:, 0] > 0.2).sum() > 10 and (towards[:, 0] < -0.2).sum() > 10


def tilted_plate(lean: tuple[float, float], *, mirrored: bool = False) -> Head:
    """A flat square head that faces the camera, whose normal map leans everywhere alike."""
    v = np.array([(-40, -40, 0), (40, -40, 0), (40, 40, 0), (-40, 40, 0)], dtype=np.float64)
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float64)
    if mirrored:
        uv[:, 0] = 1 - uv[:, 0]
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    n = np.array([*lean, np.sqrt(1 - lean[0] ** 2 - lean[1] ** 2)])
    normal = np.tile(np.rint(n * 127.5 + 127.5).astype(np.uint8), (16, 16, 1))
    looks = Appearance(np.full((16, 16, 3), 150, np.uint8), normal=normal)
    none = SurfacePoints((), np.zeros((0, 3), np.int32), np.zeros((0, 3)))
    mesh = Mesh(v, triangles, uv, triangles)
    return Head("plate", mesh, none, {}, np.zeros(3), np.zeros(3), looks)


def test_normal_maps_lean_as_gltf_says() -> None:
    def light(lean: tuple[float, float], *, mirrored: bool = False) -> float:
        head = tilted_plate(lean, mirrored=mirrored)
        layers = HeadRenderer(head).render_layers(head.mesh.vertices, camera_for())
        return float(layers.light[layers.cover == 1].mean())

    # the key light comes from −x and from above; u runs along x, v along y
    flat = light((0, 0))
    assert light((-0.3, 0)) > 1.04 * flat > 1.08 * light((0.3, 0))
    assert light((0, 0.3)) > 1.04 * flat > 1.08 * light((0, -0.3))
    assert light((0.3, 0), mirrored=True) == pytest.approx(light((-0.3, 0)), rel=0.01)
    assert light((0, 0.3), mirrored=True) == pytest.approx(light((0, 0.3)), rel=0.01)


def test_light_comes_through_the_ears() -> None:
    head = make_head(Identity("someone"))
    camera = portrait_camera(head, (240, 270))
    behind = StageLights(
        key=Lamp(np.array([0.0, 0.1, 1.0]), np.full(3, 1e-6), 0.2),
        fill=Lamp(np.array([0.0, 0.1, 1.0]), np.zeros(3), 0.2),
        rim=Lamp(np.array([0.25, 0.2, -1.0]), np.full(3, 3.0), 0.2),
        sky=np.zeros(3),
        ground=np.zeros(3),
    )
    layers = HeadRenderer(head, lights=behind).render_layers(head.mesh.vertices, camera)
    x, y = np.rint(camera.project(head.points["10.1"])).astype(int) - layers.box[:2]
    ear = layers.light[y : y + 50, x - 12 : x + 12].reshape(-1, 3)
    glowing = ear[ear[:, 0] > 0.02]
    assert len(glowing) > 40
    assert (glowing[:, 0] > 2 * glowing[:, 2]).mean() > 0.5  # through blood: red


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"triangles": np.array([(0, 1, 9)])}, "must index its 4 vertices"),
        ({"colour": np.full((3, 3), 0.5)}, "colour must have shape"),
        ({"colour": np.full((4, 3), 1.5)}, r"must lie in 0\.\.1"),
        ({"vertices": np.full((4, 3), np.nan)}, "must be finite"),
        ({"frame": "camera"}, "frame must be"),
        ({"roughness": 0.0}, "roughness must lie"),
    ],
)
def test_wrong_extra_meshes_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(facing_plate(0, 10, (0.5, 0.5, 0.5)), **change)
