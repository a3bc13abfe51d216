"""Pictures of marker takes: a whole face with its markers, and what stands before them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.mesh import vertex_normals
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.actor import Pose
from facewright.datasets_synthetic.marker_views import MarkerFilmer, MarkerView
from facewright.datasets_synthetic.markers_on_faces import (
    BACKGROUND_LIGHT,
    DOT_LIGHT,
    GluedMarkers,
    Lights,
    Room,
)
from facewright.datasets_synthetic.optics import NOISELESS, Optics, Sensor
from facewright.datasets_synthetic.rigs import face_rig
from facewright.heads.head import Head
from facewright.heads.marker_sets import glue_markers, ready_marker_set
from facewright.heads.raycast import RayScene
from facewright.tracking.blobs import BlobSettings, find_blobs

Floats = NDArray[np.float64]
SHARP = Optics(psf_px=0.5)
NOISY = Sensor(full_well_e=11333.0, read_noise_e=26.7)


class Sitter:
    """A head that turns and shifts evenly; a stand-in for an actor."""

    def __init__(self, head: Head, shift_mm_s: float = 0.0, turn_rad_s: float = 0.0) -> None:
        self.vertices = head.shaped({"jawOpen": 0.4, "mouthSmileLeft": 0.5})
        self.shift, self.turn = np.array([shift_mm_s, 0.3 * shift_mm_s, 0]), turn_rad_s

    def __call__(self, time_s: float) -> Pose:
        half = self.turn * time_s / 2
        motion = Rigid(np.array([np.cos(half), 0, np.sin(half), 0]), self.shift * time_s)
        return Pose(time_s, np.zeros(0), self.vertices, motion)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return face_rig(np.random.default_rng(3))


@pytest.fixture(scope="module")
def glued(average_head: Head) -> Callable[[str], GluedMarkers]:
    glue = glue_markers(average_head, ready_marker_set())
    return lambda kind: GluedMarkers(
        glue, kind, np.full(len(glue), 1.6), np.full(len(glue), DOT_LIGHT)
    )


def filmer(
    head: Head,
    markers: GluedMarkers | None,
    rig: Rig,
    optics: Optics = SHARP,
    sensor: Sensor = NOISELESS,
    room: Room | None = None,
) -> MarkerFilmer:
    return MarkerFilmer(
        head, markers, rig.cameras, dict.fromkeys(rig.names, optics),
        dict.fromkeys(rig.names, sensor), room=room,
    )  # fmt: skip


def seen(film: MarkerFilmer, name: str, pose_at: Sitter | None, time_s: float = 0.0) -> MarkerView:
    return film.view(name, pose_at, time_s, np.random.default_rng(0))


def true_places(head: Head, markers: GluedMarkers, pose: Pose) -> tuple[Floats, Floats]:
    v = pose.world_vertices
    return markers.places(v, vertex_normals(v, head.mesh.triangles))


@pytest.mark.parametrize("kind", ["dots", "spheres"])
def test_centres_are_the_projections_of_the_true_markers(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig, kind: str
) -> None:
    markers, sitter = glued(kind), Sitter(average_head, 30.0, 0.5)
    film = filmer(average_head, markers, rig)

    for name in rig.names:
        view = seen(film, name, sitter, 0.4)
        centres, _ = true_places(average_head, markers, sitter(0.4))
        np.testing.assert_allclose(view.centres, rig[name].project(centres), atol=1e-9, rtol=0)
        known = np.isfinite(view.outlines).all(axis=1)
        assert known.sum() > 20
        assert np.abs(view.outlines - view.centres)[known].max() < 0.05  # bias of perspective


@pytest.mark.parametrize("kind", ["dots", "spheres"])
def test_whole_markers_have_their_light_where_truth_says_on_a_face(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig, kind: str
) -> None:
    markers, sitter = glued(kind), Sitter(average_head)
    film = filmer(average_head, markers, rig, room=Room(background=0.0, skin=0.0))
    errors = []
    for name in rig.names:
        light, (_, outlines, visible) = film.light(name, sitter, 0.0)
        shown = np.flatnonzero(visible == 1)
        painted = outlines[visible > 0]
        for m in shown:
            if np.sort(np.linalg.norm(painted - outlines[m], axis=1))[1] < 20:
                continue
            x0, y0 = np.rint(outlines[m]).astype(int) - 10
            window = light[y0 : y0 + 21, x0 : x0 + 21].astype(float)
            y, x = np.mgrid[:21, :21]
            centre = np.array([(window * x).sum(), (window * y).sum()]) / window.sum() + (x0, y0)
            errors.append(centre - outlines[m])

    assert len(errors) > 40
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 0.005


def test_the_tracker_finds_the_markers_where_they_are(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    film, sitter = filmer(average_head, glued("spheres"), rig), Sitter(average_head)
    errors = []
    for name in rig.names:
        view = seen(film, name, sitter)
        found = find_blobs(view.image, BlobSettings(110.0))
        for outline in view.outlines[view.visible == 1]:
            d = np.linalg.norm(found.centres - outline, axis=1)
            if d.min() < 3:
                errors.append(found.centres[d.argmin()] - outline)

    assert len(errors) > 60
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.03


@pytest.mark.parametrize("kind", ["dots", "spheres"])
def test_the_skin_hides_what_rays_say_it_hides(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig, kind: str
) -> None:
    """Rays from the camera to the markers' centres, by Open3D's caster."""
    markers, sitter = glued(kind), Sitter(average_head, turn_rad_s=0.9)
    film = filmer(average_head, markers, rig)
    lashes = average_head.mesh.groups["lashes"]
    scene = RayScene(
        sitter(1.0).world_vertices, np.delete(average_head.mesh.triangles, lashes, axis=0)
    )
    centres, normals = true_places(average_head, markers, sitter(1.0))
    n_hidden = n_seen = 0
    for name in rig.names:
        view, eye = seen(film, name, sitter, 1.0), rig[name].position
        ray = centres - eye
        t, *_ = scene.cast(eye, ray)
        before_mm = (1 - t) * np.linalg.norm(ray, axis=1)
        facing = -(normals * ray).sum(axis=1) / np.linalg.norm(ray, axis=1)
        for m, gap in enumerate(before_mm):
            if gap > 6:
                assert view.visible[m] < 0.5
                n_hidden += 1
            elif facing[m] > 0.2 and gap < 0:
                assert view.visible[m] > 0.5
                n_seen += 1
    assert n_hidden >= 8
    assert n_seen >= 40


def plate(x: float, y: float, z: float, width: float = 60.0) -> tuple[Floats, NDArray[np.int32]]:
    """A rectangle that faces the cameras, its left edge at x."""
    corners = np.array([[0, -40, 0], [width, -40, 0], [width, 40, 0], [0, 40, 0.0]]) + (x, y, z)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def test_a_plate_hides_the_part_of_a_ball_that_lies_behind_it() -> None:
    """Share of a disc beyond a chord, in closed form."""
    camera = Camera((400, 300), np.array([[3000.0, 0, 199.5], [0, 3000, 149.5], [0, 0, 1]]))
    radius = 3.0
    for offset in (-0.8, -0.3, 0.0, 0.45, 0.9):
        room = Room(
            occluder=lambda _, x=offset * radius: plate(x * 0.9, 0, 900.0),  # type: ignore[misc]
            lights=lambda _: Lights(
                np.array([[0.0, 0, 1000]]), np.array([radius]), np.array([0.9])
            ),
        )
        film = MarkerFilmer(None, None, {"c": camera}, {"c": SHARP}, {"c": NOISELESS}, room=room)

        view = film.view("c", None, 0.0, np.random.default_rng(0))

        left = 0.5 + (np.arcsin(offset) + offset * np.sqrt(1 - offset**2)) / np.pi
        assert view.extra_visible[0] == pytest.approx(left, abs=0.015)
        x = np.arange(400)
        bright = (view.image > 115).any(axis=0)
        assert x[bright].max() == pytest.approx(199.5 + 3 * radius * offset, abs=1.2)
        np.testing.assert_allclose(view.extra_outlines[0], (199.5, 149.5), atol=1e-3)


def test_a_hair_between_the_probes_hides_its_share() -> None:
    camera = Camera((400, 300), np.array([[3000.0, 0, 199.5], [0, 3000, 149.5], [0, 0, 1]]))
    hair_mm = 0.3
    for x in np.arange(-1.2, 1.3, 0.3):
        room = Room(
            occluder=lambda _, x=x: plate(x, 0, 999.0, hair_mm),  # type: ignore[misc]
            lights=lambda _: Lights(np.array([[0.0, 0, 1000]]), np.array([3.0]), np.array([0.9])),
        )
        film = MarkerFilmer(None, None, {"c": camera}, {"c": SHARP}, {"c": NOISELESS}, room=room)

        view = film.view("c", None, 0.0, np.random.default_rng(0))

        chord = 2 * np.sqrt(9 - (x + hair_mm / 2) ** 2)
        assert 1 - view.extra_visible[0] == pytest.approx(chord * hair_mm / (9 * np.pi), rel=0.35)


def test_balls_stand_on_the_skin_and_dots_lie_on_it(
    average_head: Head, glued: Callable[[str], GluedMarkers]
) -> None:
    mesh = average_head.mesh
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    scene = RayScene(mesh.vertices, mesh.triangles[mesh.groups["skin"]])
    for kind, low, high in (("spheres", 1.6, 2.6), ("dots", 0.1, 0.3)):
        centres, n = glued(kind).places(mesh.vertices, normals)
        gap = np.linalg.norm(centres - scene.closest(centres)[0], axis=1)
        assert (gap < high).all()
        assert np.median(gap) > low  # in a fold, other skin is nearer than that below
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)


def test_another_actor_at_the_same_time_is_another_picture(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    film = filmer(average_head, glued("dots"), rig)
    first = seen(film, "cam1", Sitter(average_head, 0.0, 0.0), 0.5)

    second = seen(film, "cam1", Sitter(average_head, 40.0, 0.0), 0.5)

    assert np.linalg.norm(second.centres - first.centres, axis=1).min() > 20


def test_the_nearer_of_two_balls_hides_the_other_and_touching_ones_share_their_pixels() -> None:
    camera = Camera((400, 300), np.array([[3000.0, 0, 199.5], [0, 3000, 149.5], [0, 0, 1]]))

    def view(*balls: tuple[float, float, float]) -> tuple[NDArray[np.float32], Floats]:
        lights = Lights(
            np.array(balls), np.full(len(balls), 3.0), np.linspace(0.9, 0.5, len(balls))
        )
        film = MarkerFilmer(
            None, None, {"c": camera}, {"c": Optics()}, {"c": NOISELESS},
            room=Room(background=0.0, lights=lambda _: lights),
        )  # fmt: skip
        light, (_, _, visible) = film.light("c", None, 0.0)
        return light, visible

    light, visible = view((0, 0, 1000), (2.0, 0, 1010))
    d = 2.0 * 1000 / 1010 / 3.0  # of the centres, in radii
    overlap = (2 * np.arccos(d / 2) - d / 2 * np.sqrt(4 - d * d)) / np.pi
    assert visible[0] == pytest.approx(1, abs=1e-3)
    assert visible[1] == pytest.approx(1 - overlap, abs=0.02)
    assert light[149:151, 199:201].min() == pytest.approx(0.9)
    assert light.max() <= 0.9 + 1e-6

    apart, _ = view((-3.0, 0, 1000), (3.001, 0, 1000))
    alone = [view((-3.0, 0, 1000))[0], view((3.001, 0, 1000))[0]]
    np.testing.assert_allclose(apart, alone[0] + alone[1] * 0.5 / 0.9, atol=1e-5)


def test_a_hand_moves_away_from_the_markers(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    markers, sitter = glued("dots"), Sitter(average_head)

    def hand(time_s: float) -> tuple[Floats, NDArray[np.int32]] | None:
        return None if time_s > 2 else plate(-80.0 + 400 * time_s, -50.0, 150.0, 160.0)

    film = filmer(average_head, markers, rig, room=Room(occluder=hand))
    free = filmer(average_head, markers, rig)

    before, open_ = seen(film, "cam1", sitter, 0.0), seen(free, "cam1", sitter, 0.0)
    gone = seen(film, "cam1", sitter, 3.0)

    assert (open_.visible - before.visible > 0.9).sum() >= 4
    assert (before.visible <= open_.visible + 1e-9).all()
    np.testing.assert_array_equal(gone.image, open_.image)
    np.testing.assert_allclose(before.centres, open_.centres)


def test_a_dot_at_the_edge_of_the_picture_is_seen_in_part(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    markers, sitter = glued("spheres"), Sitter(average_head)
    whole = seen(filmer(average_head, markers, rig), "cam1", sitter)
    nose = int(np.argmin(np.abs(whole.outlines - np.median(whole.outlines, axis=0)).sum(axis=1)))
    x, y = whole.outlines[nose]
    camera = rig["cam1"]
    K = camera.matrix.copy()
    K[0, 2] -= x + 0.5  # its centre comes to lie on the picture's left edge
    moved = filmer(average_head, markers, Rig({"cam1": replace(camera, matrix=K)}))

    view = seen(moved, "cam1", sitter)

    assert whole.visible[nose] == 1
    assert view.visible[nose] == pytest.approx(0.5, abs=0.03)
    np.testing.assert_allclose(view.outlines[nose], (-0.5, y), atol=1e-6)
    assert view.visible[view.outlines[:, 0] < -12].max(initial=0) == 0


def test_exposure_smears_and_keeps_the_light(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    markers, sitter = glued("spheres"), Sitter(average_head, 500.0)
    sharp = filmer(average_head, markers, rig, room=Room(background=0.0, skin=0.0))
    smeared = filmer(
        average_head, markers, rig, replace(SHARP, exposure_s=0.01),
        room=Room(background=0.0, skin=0.0),
    )  # fmt: skip

    a, (_, _, seen_a) = sharp.light("cam1", sitter, 0.0)
    b, (_, outlines, seen_b) = smeared.light("cam1", sitter, 0.0)

    np.testing.assert_allclose(seen_a, seen_b, atol=0.05)
    assert b.sum() == pytest.approx(a.sum(), rel=0.01)
    assert np.median(b[b > 0.02]) < 0.75 * np.median(a[a > 0.02])
    # half-way between where it is at the ends of the exposure
    ends = [sharp.light("cam1", sitter, t)[1][1] for t in (-0.005, 0.005)]
    known = np.isfinite(ends[0] + ends[1]).all(axis=1)
    np.testing.assert_allclose(outlines[known], (ends[0] + ends[1])[known] / 2, atol=0.02)


def test_rolling_rows_see_later_times(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    markers, sitter = glued("dots"), Sitter(average_head, 400.0)
    film = filmer(average_head, markers, rig, replace(SHARP, readout_s=0.02))
    still = filmer(average_head, markers, rig)

    view = seen(film, "cam2", sitter, 0.1)

    for m in np.flatnonzero(view.visible > 0.9)[::4]:
        late = 0.02 * (view.centres[m, 1] / 719 - 0.5)
        at = seen(still, "cam2", sitter, 0.1 + late)
        np.testing.assert_allclose(view.centres[m], at.centres[m], atol=2e-3)
    # the drawn face, too: its outline in a late row is that of the later time
    for row in (150, 560):
        late = 0.02 * (row / 719 - 0.5)
        late_image = seen(still, "cam2", sitter, 0.1 + late).image
        lit = [np.flatnonzero(i[row] > 9)[[0, -1]] for i in (view.image, late_image)]
        assert np.abs(lit[0] - lit[1]).max() <= 1


def test_a_flash_brightens_the_rows_it_meets(average_head: Head, rig: Rig) -> None:
    def flash(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(time_s > 0.1, 3.0, 1.0)

    room = Room(flash=flash)
    rolling = filmer(average_head, None, rig, replace(SHARP, readout_s=0.01), room=room)
    dark = filmer(average_head, None, rig, replace(SHARP, readout_s=0.01))
    sitter = Sitter(average_head)

    lit, _ = rolling.light("cam0", sitter, 0.1)
    plain, _ = dark.light("cam0", sitter, 0.1)

    ratio = (lit / plain).mean(axis=1)
    np.testing.assert_allclose(ratio[:359], 1.0, rtol=1e-5)
    np.testing.assert_allclose(ratio[361:], 3.0, rtol=1e-5)


def test_grey_levels_are_those_of_a_marker_take(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    view = seen(filmer(average_head, glued("dots"), rig), "cam1", Sitter(average_head))

    assert view.image[:5].max() == round(255 * BACKGROUND_LIGHT) == 7
    assert 180 <= view.image.max() <= 205
    skin = view.image[(view.image > 9) & (view.image < 100)]
    assert 15 < np.median(skin) < 60
    backdrop = np.tile(np.linspace(0.1, 0.3, 1280, dtype=np.float32), (720, 1))
    room = Room(backdrops={"cam1": backdrop})
    with_backdrop = seen(filmer(average_head, None, rig, room=room), "cam1", Sitter(average_head))
    assert np.abs(with_backdrop.image[0] - 255 * backdrop[0]).max() < 0.501


def test_threads_and_order_do_not_change_pictures(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    markers, sitter = glued("dots"), Sitter(average_head, 50.0, 0.3)
    optics = replace(SHARP, exposure_s=0.004)
    jobs = [(name, frame) for frame in range(3) for name in rig.names]

    def shoot(film: MarkerFilmer, job: tuple[str, int]) -> NDArray[np.uint8]:
        rng = np.random.default_rng([rig.names.index(job[0]), job[1]])
        return film.view(job[0], sitter, job[1] / 60, rng).image

    one = filmer(average_head, markers, rig, optics, NOISY)
    alone = [shoot(one, job) for job in jobs]
    film = filmer(average_head, markers, rig, optics, NOISY)
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda job: shoot(film, job), jobs[::-1]))[::-1]

    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_knocked_camera_takes_the_place_of_its_name(
    average_head: Head, glued: Callable[[str], GluedMarkers], rig: Rig
) -> None:
    film, sitter = filmer(average_head, glued("dots"), rig), Sitter(average_head)
    knocked = replace(rig["cam0"], camera_from_world=rig["cam3"].camera_from_world)

    view = film.view("cam0", sitter, 0.0, np.random.default_rng(0), camera=knocked)

    places, _ = true_places(average_head, glued("dots"), sitter(0.0))
    np.testing.assert_allclose(view.centres, knocked.project(places), atol=1e-9)


def test_wrong_calls_are_told(average_head: Head, rig: Rig, glued: Callable[[str], GluedMarkers]
) -> None:  # fmt: skip
    markers = glued("dots")
    with pytest.raises(ValueError, match="kind must be one of dots, spheres"):
        replace(markers, kind="cubes")
    with pytest.raises(ValueError, match="radius_mm must lie above 0"):
        replace(markers, radius_mm=np.zeros(len(markers)))
    with pytest.raises(ValueError, match="need a head"):
        MarkerFilmer(None, markers, rig.cameras, {}, {})
    with pytest.raises(ValueError, match="must hold camera cam0"):
        MarkerFilmer(average_head, markers, rig.cameras, {}, {})
    with pytest.raises(ValueError, match="backdrop of cam0 must be"):
        room = Room(backdrops={"cam0": np.zeros((3, 4), np.float32)})
        filmer(average_head, markers, rig, room=room)
    with pytest.raises(ValueError, match="pose_at must be given"):
        seen(filmer(average_head, markers, rig), "cam0", None)
