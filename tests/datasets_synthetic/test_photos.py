from __future__ import annotations

import csv
import hashlib
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.formats.ply import read_ply
from facewright.core.formats.rig_json import read_rig
from facewright.datasets_synthetic.photo_files import outer_skin, write_photos
from facewright.datasets_synthetic.photo_pictures import Photographer
from facewright.datasets_synthetic.photo_points import mark_points, visible_points
from facewright.datasets_synthetic.photos import PhotoSession, PhotoSettings, plan_photos
from facewright.heads.catalogue import built_in_head
from facewright.heads.raycast import RayScene
from facewright.heads.srgb import linear_from_srgb

SMALL = PhotoSettings(count=5, size=(480, 320), mark_noise_px=1.5, uniform=True, turned=True)


def read_picture(path: Path) -> NDArray[np.uint8]:
    found = cv2.imread(str(path))
    assert found is not None
    return np.asarray(found, np.uint8)


def points_of(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    with open(path, newline="") as stream:
        rows = list(csv.DictReader(stream))
    on_mesh = np.array([[float(r[k]) for k in "XYZ"] for r in rows])
    return on_mesh, np.array([[float(r[k]) for k in "uv"] for r in rows])


def digests(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def session() -> PhotoSession:
    return plan_photos(built_in_head("ruth"), SMALL, 4)


@pytest.fixture(scope="module")
def folder(session: PhotoSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("photos")
    write_photos(made, session)
    return made


def opencv_project(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = camera.camera_from_world
    rotation, _ = cv2.Rodrigues(pose.rotation)
    at, _ = cv2.projectPoints(
        points, rotation, pose.translation, camera.matrix.copy(), camera.distortion.copy()
    )
    return np.asarray(at).reshape(-1, 2)


def test_the_folder_explains_itself(folder: Path) -> None:
    said = tomllib.loads((folder / "photos.toml").read_text())
    rig = read_rig(folder / "truth" / "rig.json")

    assert [p["file"] for p in said["photo"]] == [f"photo{i}.jpg" for i in range(5)]
    assert rig.names == tuple(f"photo{i}" for i in range(5))
    for photo in said["photo"]:
        on_mesh, _ = points_of(folder / photo["points"])
        assert len(on_mesh) == photo["n_points"]
    with np.load(folder / "truth.npz") as truth:
        assert truth["white_balance"].shape == (5, 3)
        assert (truth["lamp_colour"] == 0).all() and (truth["sky_ground"] == 1).all()
    assert not [p for p in folder.rglob("*.part*")]


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    settings = replace(SMALL, count=3, uniform=False, size=(300, 240))
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        (tmp_path / name).mkdir()
        write_photos(tmp_path / name, plan_photos(built_in_head("kofi"), settings, seed))

    a, b, c = (digests(tmp_path / name) for name in "abc")
    assert a == b
    assert a["photo0.jpg"] != c["photo0.jpg"]


def test_exact_points_project_to_their_pixels_as_opencv_has_it(folder: Path) -> None:
    rig = read_rig(folder / "truth" / "rig.json")
    for name in rig:
        on_mesh, on_photo = points_of(folder / "truth" / "points_exact" / f"{name}.csv")
        assert len(on_mesh) >= 12
        assert np.abs(opencv_project(rig[name], on_mesh) - on_photo).max() < 1e-5


def test_marks_are_as_noisy_as_said(session: PhotoSession) -> None:
    head = session.head
    exact = visible_points(head, session.shots[0].camera)
    settings = replace(SMALL, mark_noise_px=2.0, mark_noise_mm=0.4)
    off_px, off_mm, depth_mm = [], [], []
    skin = np.asarray(head.mesh.triangles)[head.mesh.groups["skin"]]
    scene = RayScene(head.mesh.vertices, skin)
    for seed in range(40):
        marked = mark_points(exact, head, settings, np.random.default_rng(seed))
        off_px.append(marked.on_photo - exact.on_photo)
        off_mm.append(np.linalg.norm(marked.on_mesh - exact.on_mesh, axis=1))
        on, *_ = scene.closest(marked.on_mesh)
        depth_mm.append(np.linalg.norm(on - marked.on_mesh, axis=1))

    n = np.size(off_px)
    assert np.std(off_px) == pytest.approx(2.0, abs=5 * 2.0 / np.sqrt(2 * n))
    # two directions along the surface; a little less where it is curved
    assert np.sqrt(np.mean(np.square(off_mm))) == pytest.approx(0.4 * np.sqrt(2), rel=0.08)
    assert np.max(depth_mm) < 1e-4


def test_without_noise_marks_are_exact(session: PhotoSession) -> None:
    exact = visible_points(session.head, session.shots[1].camera)
    settings = replace(SMALL, mark_noise_px=0, mark_noise_mm=0)

    marked = mark_points(exact, session.head, settings, np.random.default_rng(0))

    assert (marked.on_photo == exact.on_photo).all()
    assert np.abs(marked.on_mesh - exact.on_mesh).max() < 1e-4


def test_points_of_the_far_side_are_not_marked(session: PhotoSession) -> None:
    for shot, side in zip(session.shots[3:], (1, -1), strict=True):
        yaw = np.arctan2(shot.camera.position[0], shot.camera.position[2])
        own = "l" if yaw > 0 else "r"
        names = visible_points(session.head, shot.camera).names
        sides = {name[-1] for name in names if name[-2:] in ("_l", "_r")}
        assert f"t_{own}" in names
        assert f"t_{'r' if own == 'l' else 'l'}" not in names
        assert sides == {own} or {"ex_l", "ex_r"} - set(names), (side, names)


@pytest.mark.parametrize("name", ["photo0", "photo2", "photo4"])
def test_the_photo_is_where_the_true_camera_sees_the_mesh(folder: Path, name: str) -> None:
    """The written mesh with the written albedo, seen by OpenCV's lens, lies on the photograph."""
    ply = read_ply(folder / "truth" / "head.ply").mesh
    camera = read_rig(folder / "truth" / "rig.json")[name]
    albedo = cv2.GaussianBlur(read_albedo(folder), (0, 0), 3)
    photo = read_picture(folder / f"{name}.jpg")[..., 1].astype(float)
    width, height = camera.image_size
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(
        grid.astype(np.float64), camera.matrix.copy(), camera.distortion.copy()
    ).reshape(-1, 2)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    rays = rays @ camera.camera_from_world.rotation
    n_skin = len(built_in_head("ruth").mesh.groups["skin"])
    _, triangle, w = RayScene(ply.vertices, ply.triangles).cast(camera.position, rays)
    hit = triangle < n_skin
    assert ply.uv is not None and ply.uv_triangles is not None
    uv = ply.uv[ply.uv_triangles[triangle[hit]]]
    b = np.stack([1 - w[hit].sum(axis=1), w[hit, 0], w[hit, 1]], axis=1)
    at = np.einsum("nc,ncx->nx", b, uv)
    size = albedo.shape[:2][::-1]
    x, y = (at * (1, -1) + (0, 1)).T * np.array(size)[:, None] - 0.5
    flat = np.zeros(width * height)
    flat[hit] = albedo[np.clip(y, 0, size[1] - 1).astype(int), x.astype(int), 1]
    painted = flat.reshape(height, width)
    dy, dx = np.gradient(photo)
    inner = cv2.erode(hit.reshape(height, width).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    inner &= np.abs(painted - photo) < 60
    A = np.stack([dx[inner], dy[inner], photo[inner], np.ones(inner.sum())], axis=1)

    shift_px = np.linalg.lstsq(A, painted[inner], rcond=None)[0][:2]

    assert inner.mean() > 0.05
    assert np.abs(shift_px).max() < 0.2, shift_px


def test_even_light_shows_the_albedo(folder: Path) -> None:
    """Cheeks and forehead, open to the light, have their texture's colour in the photograph."""
    head = built_in_head("ruth")
    camera = read_rig(folder / "truth" / "rig.json")["photo0"]
    photo = cv2.cvtColor(read_picture(folder / "photo0.jpg"), cv2.COLOR_BGR2RGB)
    texture = read_albedo(folder)
    rows = np.concatenate([head.regions[r] for r in ("cheek_l", "cheek_r", "forehead")])
    corners = head.mesh.vertices[head.mesh.triangles[rows]]
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facing = normal[:, 2] > 0.9
    uv = head.appearance.uv
    assert uv is not None and head.mesh.uv_triangles is not None
    at = uv[head.mesh.uv_triangles[rows]].mean(axis=1)[facing]
    height, width = texture.shape[:2]
    smooth = cv2.blur(texture, (25, 25))  # a photo's pixel spans that many texels
    y, x = ((1 - at[:, 1]) * height - 0.5).astype(int), (at[:, 0] * width - 0.5).astype(int)
    pixel = np.round(opencv_project(camera, middle[facing])).astype(int)

    seen = linear_from_srgb(photo[pixel[:, 1], pixel[:, 0]]).mean(axis=0)
    painted = linear_from_srgb(smooth[y, x]).mean(axis=0)

    assert np.abs(np.log(seen / painted)).max() < 0.10, (seen, painted)


def read_albedo(folder: Path) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(read_picture(folder / "truth/albedo.png"), cv2.COLOR_BGR2RGB))


def test_a_turned_photo_is_stored_lying_and_shown_upright(folder: Path) -> None:
    from PIL import Image

    path = folder / "photo4.jpg"
    with Image.open(path) as stored:
        assert stored.size == (480, 320)
        assert stored.getexif()[0x0112] == 6
    shown = read_picture(path)  # OpenCV obeys the orientation
    assert shown.shape[:2] == (480, 320)
    assert read_rig(folder / "truth" / "rig.json")["photo4"].image_size == (320, 480)


def test_one_lens_serves_for_all(session: PhotoSession) -> None:
    lying = [shot.camera for shot in session.shots[:4]]
    upright = session.shots[4].camera

    for camera in lying[1:]:
        assert (camera.matrix == lying[0].matrix).all()
        assert (camera.distortion == lying[0].distortion).all()
    # the same ray of the lens, on the sensor and in the picture that is turned clockwise
    x, y = 37.0, 201.0
    on_sensor = lying[0].undistort([x, y])
    turned = upright.undistort([upright.image_size[0] - 1 - y, x])
    assert turned == pytest.approx([-on_sensor[1], on_sensor[0]], abs=1e-12)


def test_strips_leave_no_seams(session: PhotoSession, monkeypatch: pytest.MonkeyPatch) -> None:
    from facewright.datasets_synthetic import photo_pictures

    whole = Photographer(session)._light(session.shots[1])[0]
    monkeypatch.setattr(photo_pictures, "_STRIP_ROWS", 57)
    strips = Photographer(session)._light(session.shots[1])[0]

    assert np.abs(whole - strips).max() < 2e-3


def test_the_outer_skin_is_one_shell_that_faces_outwards() -> None:
    head = built_in_head("maya")
    mesh = outer_skin(head)

    assert mesh.uv is not None
    near = np.abs(mesh.vertices[:, 1]) < 30
    centre = np.array([0, 0, -75.0])
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = ((corners.mean(axis=1) - centre) * normal).sum(axis=1) > 0
    assert near.any() and out.mean() > 0.85
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    i, j = mesh.triangles.ravel(), np.roll(mesh.triangles, 1, axis=1).ravel()
    n = len(mesh.vertices)
    count, _ = connected_components(coo_matrix((np.ones(len(i)), (i, j)), (n, n)), directed=False)
    assert count == 1


@pytest.mark.parametrize(
    "change",
    [
        {"count": 2},
        {"count": 6},
        {"size": (4000, 2008)},
        {"size": (2008, 3041)},
        {"size": (100, 100)},
        {"size": (2000, 300)},
        {"points": 11},
        {"mark_noise_px": -1},
        {"mark_noise_mm": float("nan")},
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        replace(SMALL, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [3, 4, 5])
def test_every_photo_shows_the_whole_face_and_enough_points(count: int) -> None:
    settings = PhotoSettings(count=count, turned=True)
    head = built_in_head("mei")
    face = np.stack([head.points[p] for p in ("2.1", "11.1", "9.3")])
    for seed in range(6):
        for shot in plan_photos(head, settings, seed).shots:
            at = shot.camera.project(face)
            assert ((at > 0) & (at < np.array(shot.camera.image_size) - 1)).all(), (seed, shot.name)
            assert len(visible_points(head, shot.camera).names) >= 12, (seed, shot.name)


@pytest.mark.slow
def test_a_face_detector_finds_the_face_in_uncontrolled_light() -> None:
    from facewright.heads.face_network import face_networks_path

    if face_networks_path() is None:
        pytest.skip("the package with the face networks is not installed")
    from facewright.heads.face_detector import FaceDetector
    from facewright.heads.face_network import read_face_weights

    session = plan_photos(built_in_head("luis"), replace(SMALL, uniform=False, size=(640, 480)), 8)
    picture = Photographer(session).take(session.shots[0])

    found = FaceDetector(read_face_weights()).detect(picture)

    assert len(found) == 1
