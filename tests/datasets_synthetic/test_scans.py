from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.formats.ply import read_ply
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.scan_files import write_cylinder_scan, write_mesh_scan
from facewright.datasets_synthetic.scan_meshes import MeshScan, scan_mesh
from facewright.datasets_synthetic.scan_target import ScanTarget
from facewright.datasets_synthetic.scans import CylinderScan, scan_cylinder
from facewright.heads.catalogue import built_in_head
from facewright.heads.raycast import import_open3d

SEED = 6
Points = NDArray[np.float64]


@pytest.fixture(scope="module")
def target() -> ScanTarget:
    return ScanTarget(built_in_head("ruth"), SEED)


@pytest.fixture(scope="module")
def cylinder(target: ScanTarget) -> CylinderScan:
    return scan_cylinder(target, SEED)


@pytest.fixture(scope="module")
def fused(target: ScanTarget) -> MeshScan:
    return scan_mesh(target, SEED, triangles=40_000)


def distance_to_truth(target: ScanTarget, head_points: Points) -> Points:
    """By Open3D's own closest points on the true mesh."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(target.mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(target.mesh.triangles.astype(np.uint32)),
    )
    query = o3d.core.Tensor(head_points.astype(np.float32))
    return np.asarray(scene.compute_distance(query).numpy(), dtype=np.float64)


def points_of(scan: CylinderScan, range_mm: Points) -> Points:
    """(512, 512, 3), head frame, by the formula that scan.toml states."""
    x = range_mm * np.sin(scan.angle_rad)
    z = range_mm * np.cos(scan.angle_rad)
    y = np.broadcast_to(scan.height_mm[:, None], x.shape)
    return scan.scan_from_head.inverse().apply(np.stack([x, y, z], axis=-1))


def at_landmark(target: ScanTarget, scan: CylinderScan, name: str) -> tuple[int, int]:
    """Row and column at which a Farkas landmark lies."""
    marks = target.head.mesh.landmarks
    assert marks is not None
    place = marks.select((name,)).at(np.asarray(target.head.mesh.vertices))[0]
    x, y, z = scan.scan_from_head.apply(place)
    row = int(np.argmin(np.abs(scan.height_mm - y)))
    return row, int(np.argmin(np.abs(scan.angle_rad - np.arctan2(x, z))))


def void_share(scan: CylinderScan, row: int, column: int, half: int) -> float:
    part = scan.range_mm[row - half : row + half + 1, column - half : column + half + 1]
    return float(np.isnan(part).mean())


def test_exact_ranges_lie_on_the_true_surface(target: ScanTarget, cylinder: CylinderScan) -> None:
    known = np.isfinite(cylinder.exact_mm)

    off_mm = distance_to_truth(target, points_of(cylinder, cylinder.exact_mm)[known])

    assert known.mean() > 0.85
    assert off_mm.max() < 1e-3


def test_ranges_are_as_noisy_and_as_coarse_as_said(
    target: ScanTarget, cylinder: CylinderScan
) -> None:
    known = np.isfinite(cylinder.range_mm)
    cheek = np.zeros_like(known)
    for name in ("zy_l", "zy_r", "sl"):
        row, column = at_landmark(target, cylinder, name)
        cheek[row - 8 : row + 9, column - 8 : column + 9] = True
    off = (cylinder.range_mm - cylinder.exact_mm)[cheek & known]
    steps = cylinder.range_mm[known] / 0.1

    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    assert np.abs(off).max() < 1.0 and abs(off.mean()) < 0.03
    assert 0.10 < off.std() < 0.25
    eyes = np.zeros_like(known)
    for name in ("p_l", "p_r"):
        row, column = at_landmark(target, cylinder, name)
        eyes[row - 3 : row + 4, column - 3 : column + 4] = True
    wet = (cylinder.range_mm - cylinder.exact_mm)[eyes & known]
    assert np.nanstd(wet) > 3 * off.std()


def test_voids_are_where_scanners_have_them(target: ScanTarget, cylinder: CylinderScan) -> None:
    crown, column = at_landmark(target, cylinder, "v")
    chin, middle = at_landmark(target, cylinder, "gn")
    nose, below_nose = at_landmark(target, cylinder, "sn")
    face = [at_landmark(target, cylinder, name) for name in ("zy_l", "zy_r", "g", "sl", "prn")]

    assert void_share(cylinder, crown + 14, 256 + 200, 14) > 0.6  # dark hair behind
    under_chin = cylinder.range_mm[chin - 4 : chin + 22, middle - 20 : middle + 21]
    assert np.isnan(under_chin).sum() > 20
    nostrils = cylinder.range_mm[nose - 14 : nose + 4, below_nose - 16 : below_nose + 17]
    assert np.isnan(nostrils).sum() > 5
    assert column >= 0
    for row, column in face:
        assert void_share(cylinder, row, column, 4) == 0, (row, column)


def test_the_laser_is_occluded_where_an_own_ray_is(
    target: ScanTarget, cylinder: CylinderScan
) -> None:
    """No range where both cameras' lines of sight are blocked, by Open3D's occlusion test."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(target.mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(target.mesh.triangles.astype(np.uint32)),
    )
    places = points_of(cylinder, cylinder.exact_mm)
    blocked = np.ones(cylinder.exact_mm.shape, bool)
    for side in (-1, 1):
        theta = cylinder.angle_rad + side * np.radians(30)
        eye = np.stack(np.broadcast_arrays(
            900 * np.sin(theta)[None], cylinder.height_mm[:, None], 900 * np.cos(theta)[None]
        ), axis=-1)  # fmt: skip
        way = cylinder.scan_from_head.inverse().apply(eye) - places
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        for start_mm in (1.0, 3.0):  # blocked by far more than the facet they lie on
            rays = np.concatenate([places + start_mm * way, way], axis=-1)
            rays = np.nan_to_num(rays).astype(np.float32)
            blocked &= scene.test_occlusions(o3d.core.Tensor(rays)).numpy()
    blocked &= np.isfinite(cylinder.exact_mm)

    assert blocked.sum() > 20
    assert np.isnan(cylinder.range_mm[blocked]).mean() > 0.95


def test_the_range_image_keeps_the_surface_s_handedness(
    target: ScanTarget, cylinder: CylinderScan
) -> None:
    _, left = at_landmark(target, cylinder, "t_l")
    _, right = at_landmark(target, cylinder, "t_r")
    nose_row, nose = at_landmark(target, cylinder, "prn")

    assert right < nose < left
    window = cylinder.range_mm[nose_row - 10 : nose_row + 11, nose - 40 : nose + 41]
    peak = np.unravel_index(np.nanargmax(window), window.shape)
    assert abs(int(peak[0]) - 10) <= 6 and abs(int(peak[1]) - 40) <= 6


def test_cylinder_files_say_the_same_as_the_scan(
    target: ScanTarget, cylinder: CylinderScan, tmp_path: Path
) -> None:
    write_cylinder_scan(tmp_path, target, cylinder, SEED)

    said = tomllib.loads((tmp_path / "scan.toml").read_text())
    levels = cv2.imread(str(tmp_path / "range.png"), cv2.IMREAD_UNCHANGED)
    assert levels is not None and levels.dtype == np.uint16 and levels.shape == (512, 512)
    from_png = np.where(levels > 0, levels * said["range_level_mm"], np.nan)
    with np.load(tmp_path / "scan.npz") as z:
        np.testing.assert_allclose(from_png, z["range_mm"], atol=1e-9)
    with np.load(tmp_path / "truth.npz") as z:
        pose = Rigid(z["scan_from_head_quaternion"], z["scan_from_head_translation"])
        np.testing.assert_allclose(pose.apply(z["landmarks_head"]), z["landmarks_scan"], atol=1e-9)
        names = list(z["landmark_names"])
        assert "prn" in names and "2.1" in names and len(set(names)) == len(names)
    colour = cv2.imread(str(tmp_path / "colour.png"))
    row, column = at_landmark(target, cylinder, "ls")
    assert colour is not None
    blue, _, red = colour[row, column].astype(int)
    assert red > blue + 20  # a lip, not its mirror in colour
    truth = read_ply(tmp_path / "truth.ply").mesh
    assert (truth.vertices == target.mesh.vertices).all()


def test_scanned_vertices_lie_on_the_true_surface_but_for_islands(
    target: ScanTarget, fused: MeshScan
) -> None:
    in_head = fused.scan_from_head.inverse().apply(fused.mesh.vertices)
    exact = fused.scan_from_head.inverse().apply(fused.exact)
    stray = np.isnan(exact).any(axis=1)

    off = distance_to_truth(target, in_head)

    assert distance_to_truth(target, exact[~stray]).max() < 1e-3
    assert 0.03 < np.median(off[~stray]) < 0.3
    assert np.percentile(off[~stray], 99.9) < 6
    assert stray.any() and np.median(off[stray]) > 3


def components(triangles: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Sizes of connected pieces, largest first, of used vertices."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    i, j = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    _, label = connected_components(coo_matrix((np.ones(len(i)), (i, j)), (n, n)), directed=False)
    return np.sort(np.bincount(label))[::-1]


def test_a_mesh_scan_has_holes_islands_and_a_surface_between(
    target: ScanTarget, fused: MeshScan
) -> None:
    sizes = components(np.asarray(fused.mesh.triangles), len(fused.mesh.vertices))
    in_head = fused.scan_from_head.inverse().apply(fused.mesh.vertices)
    head = target.head
    marks = head.mesh.landmarks
    assert marks is not None
    nearest = {}
    for name in ("zy_l", "zy_r", "g", "prn", "sl"):
        place = marks.select((name,)).at(np.asarray(head.mesh.vertices))[0]
        nearest[name] = float(np.linalg.norm(in_head - place, axis=1).min())
    skin = head.mesh.vertices[head.mesh.triangles[head.regions["scalp"]]].mean(axis=1)
    behind = skin[(skin[:, 2] < -140) & (skin[:, 1] > 20)]
    apart = np.linalg.norm(in_head[None, ::7] - behind[::40, None], axis=2).min(axis=1)

    assert sizes[0] > 0.6 * sizes.sum()
    assert (sizes < 0.01 * sizes[0]).sum() >= 10
    assert max(nearest.values()) < 2.5, nearest
    assert np.median(apart) > 8  # no hair behind


def test_triangles_face_the_scanner_s_side(target: ScanTarget, fused: MeshScan) -> None:
    v = fused.scan_from_head.inverse().apply(fused.mesh.vertices)
    corners = v[fused.mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face = (corners[:, 0, 1] > -60) & (corners[:, 0, 2] > -40)

    out = (normal * (corners.mean(axis=1) - (0, -20, -90))).sum(axis=1) > 0

    assert out[face].mean() > 0.97


@pytest.mark.parametrize("patches", [False, True])
@pytest.mark.parametrize("triangles", [2_000, 30_000])
def test_the_number_of_triangles_is_about_as_asked_and_never_more(
    target: ScanTarget, triangles: int, patches: bool
) -> None:
    made = scan_mesh(target, 2, triangles=triangles, patches=patches)

    assert 0.85 * triangles <= len(made.mesh.triangles) <= triangles
    assert len(np.unique(made.mesh.triangles)) == len(made.mesh.vertices)
    assert len(np.unique(made.patch)) == (5 if patches else 1)


def test_patches_overlap_and_are_slightly_out_of_register(target: ScanTarget) -> None:
    made = scan_mesh(target, 3, triangles=40_000, patches=True)
    v = made.mesh.vertices
    off = v - made.exact
    first = {n: np.nanmean(off[made.patch == n], axis=0) for n in range(5)}

    front = v[made.patch == 0]
    side = v[made.patch == 1]
    apart = np.linalg.norm(front[::9, None] - side[None, ::3], axis=2).min(axis=1)

    assert (apart < 3).mean() > 0.2
    moved = [np.linalg.norm(first[n]) for n in range(1, 5)]
    assert np.linalg.norm(first[0]) < 0.06 and max(moved) > 0.1 and max(moved) < 1.5


def test_the_same_seed_writes_the_same_bytes(target: ScanTarget, tmp_path: Path) -> None:
    found = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        folder = tmp_path / name
        folder.mkdir()
        own = ScanTarget(target.head, seed)
        write_mesh_scan(folder, own, scan_mesh(own, seed, triangles=5_000), seed)
        write_cylinder_scan(folder, own, scan_cylinder(own, seed), seed)
        found.append({
            p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())
        })  # fmt: skip

    assert found[0] == found[1]
    assert found[0]["scan.ply"] != found[2]["scan.ply"]
    assert found[0]["range.png"] != found[2]["range.png"]


@pytest.mark.parametrize("triangles", [0, 1_999, 300_001])
def test_absurd_numbers_of_triangles_are_refused(target: ScanTarget, triangles: int) -> None:
    with pytest.raises(InputError, match="triangles"):
        scan_mesh(target, 0, triangles=triangles)


@pytest.mark.parametrize("name", ["kofi", "otto", "amara"])
def test_every_skin_returns_light_on_the_cheeks(name: str) -> None:
    target = ScanTarget(built_in_head(name), 1)
    scan = scan_cylinder(target, 1)
    for landmark in ("zy_l", "zy_r", "g"):
        row, column = at_landmark(target, scan, landmark)
        assert void_share(scan, row, column, 5) < 0.05, landmark
