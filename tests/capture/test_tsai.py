"""Tsai's calibration: Willson's data, exactness, Monte Carlo, and what it says of bad targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from facewright.capture.tsai import TsaiCalibration, tsai
from facewright.capture.tsai_start import tsai_start
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rigid import Rigid

Floats = NDArray[np.float64]
SIZE = (1280, 960)
K = np.array([[1200.0, 0, 652.0], [0, 1200.0, 471.0], [0, 0, 1]])
SD = 0.1
_x, _y = np.meshgrid(np.arange(10) - 4.5, np.arange(8) - 3.5)
PLANE = np.column_stack([_x.ravel(), _y.ravel(), 0 * _x.ravel()]) * 25.0
SOLID = np.random.default_rng(3).uniform(-110, 110, (40, 3))


def camera(tilt_deg: float = 38.0, kappa: float = 0.3, depth: float = 620.0) -> Camera:
    R = Rotation.from_euler("xz", [tilt_deg, 20], degrees=True).as_matrix()
    return Camera(SIZE, K, Rigid.from_rotation(R, (5.0, -8.0, depth)), "tsai", np.array([kappa]))


def seen(X: Floats, at: Camera, seed: int = 0, sd: float = SD) -> Floats:
    return at.project(X) + np.random.default_rng(seed).normal(0, sd, (len(X), 2))


def truth(at: Camera) -> Floats:
    return np.array([at.matrix[0, 0], at.distortion[0], at.matrix[0, 2], at.matrix[1, 2]])


def state_error(found: TsaiCalibration, at: Camera) -> Floats:
    """True less found, as `state_covariance` has it."""
    pose, true = found.camera.camera_from_world, at.camera_from_world
    turn = Rotation.from_matrix(true.rotation @ pose.rotation.T).as_rotvec()
    lens = truth(at) - [found[n].value for n in ("f", "k1", "cx", "cy")]
    return np.concatenate([lens, turn, true.translation - pose.translation])


def chi2_of(found: TsaiCalibration, at: Camera) -> float:
    e, C = state_error(found, at), found.state_covariance
    scale = np.sqrt(np.diag(C))
    return float(e / scale @ np.linalg.solve(C / np.outer(scale, scale), e / scale))


@pytest.fixture(scope="module")
def willson(real_data: Path) -> TsaiCalibration:
    table = np.loadtxt(real_data / "tsai" / "cc_cd.txt")
    return tsai(table[:, :3], table[:, 3:], (576, 480))


def test_willsons_points_fit_as_well_as_he_fitted_them(willson: TsaiCalibration) -> None:
    assert willson.rms_px <= 0.1102
    assert willson.is_used.all()
    assert willson.is_coplanar


def test_willsons_constants_lie_in_the_joint_region(willson: TsaiCalibration) -> None:
    f = 270 / 0.023
    R = Rotation.from_euler("xyz", [20, 5, 88], degrees=True).as_matrix()
    made_with = Camera(
        (576, 480),
        np.array([[f, 0, 262.0], [0, f, 212.0], [0, 0, 1]]),
        Rigid.from_rotation(R, (150.0, -75.0, 6600.0)),
        "tsai",
        np.array([-6e-4 * 270**2]),
    )

    z2 = chi2_of(willson, made_with)

    assert z2 < stats.chi2.ppf(0.95, 10), f"χ² = {z2:.1f}"


def test_willsons_weak_pair_is_told(willson: TsaiCalibration) -> None:
    said = " ".join(willson.warnings)
    assert "f and tz move together" in said
    assert "f is known to" in said


def test_willsons_answer_is_scipys(real_data: Path, willson: TsaiCalibration) -> None:
    table = np.loadtxt(real_data / "tsai" / "cc_cd.txt")
    start = willson.camera

    def residuals(p: Floats) -> Floats:
        f = start.matrix[0, 0] * (1 + p[0])
        R = Rotation.from_rotvec(p[4:7]).as_matrix() @ start.camera_from_world.rotation
        moved = Camera(
            (576, 480),
            np.array(
                [[f, 0, start.matrix[0, 2] + p[2]], [0, f, start.matrix[1, 2] + p[3]], [0, 0, 1]]
            ),
            Rigid.from_rotation(R, start.camera_from_world.translation + p[7:]),
            "tsai",
            start.distortion + p[1],
        )
        return (table[:, 3:] - moved.project(table[:, :3])).ravel()

    begin = np.array([0.02, 2.0, 3, -3, 1e-3, 1e-3, 0, 1, 1, 100.0])
    peer = least_squares(residuals, begin, x_scale="jac", xtol=1e-15, ftol=1e-15, max_nfev=2000)

    assert willson.rms_px <= np.sqrt(2 * peer.cost / len(table)) * (1 + 1e-6)


@pytest.mark.parametrize("X", [PLANE, SOLID], ids=["coplanar", "not coplanar"])
@pytest.mark.parametrize("kappa", [0.3, -0.15])
def test_without_noise_the_camera_is_exact(X: Floats, kappa: float) -> None:
    at = camera(kappa=kappa)

    found = tsai(X, at.project(X), SIZE)

    np.testing.assert_allclose(
        [found[n].value for n in ("f", "k1", "cx", "cy")], truth(at), rtol=1e-6
    )
    np.testing.assert_allclose(state_error(found, at)[4:], 0, atol=1e-4)
    assert found.rms_px < 1e-7


@pytest.mark.parametrize("X", [PLANE, SOLID], ids=["coplanar", "not coplanar"])
def test_the_closed_form_is_exact_without_distortion(X: Floats) -> None:
    at = camera(kappa=0.0)

    f, R, t = tsai_start(X, at.project(X), K[:2, 2])

    assert f == pytest.approx(1200, rel=1e-8)
    np.testing.assert_allclose(R, at.camera_from_world.rotation, atol=1e-8)
    np.testing.assert_allclose(t, at.camera_from_world.translation, atol=1e-5)


@pytest.mark.parametrize("X", [PLANE, SOLID], ids=["coplanar", "not coplanar"])
def test_the_stated_region_holds_the_truth_as_often_as_it_says(X: Floats) -> None:
    at, n = camera(), 200
    freedom = 2 * len(X) - 10
    z2 = np.array([chi2_of(tsai(X, seen(X, at, seed), SIZE), at) for seed in range(n)])

    covered = float(np.mean(z2 <= 10 * stats.f.ppf(0.95, 10, freedom)))

    assert abs(covered - 0.95) < 3.3 * np.sqrt(0.95 * 0.05 / n), f"{100 * covered:.1f} % covered"


def test_angles_have_the_deviations_of_repetition() -> None:
    at, n = camera(), 200
    found = [tsai(SOLID, seen(SOLID, at, seed), SIZE) for seed in range(n)]

    for name in ("rx", "ry", "rz", "tx", "ty", "tz"):
        values = np.array([c[name].value for c in found])
        stated = np.mean([c[name].sd for c in found])
        assert values.std() / stated == pytest.approx(1, abs=4 / np.sqrt(2 * n)), name
    true = Rotation.from_matrix(at.camera_from_world.rotation).as_euler("xyz", degrees=True)
    np.testing.assert_allclose(
        [np.mean([c[a].value for c in found]) for a in ("rx", "ry", "rz")], true, atol=0.05
    )


def test_a_stretched_pixel_is_found() -> None:
    at = camera()
    wide = Camera(SIZE, np.diag([1.003, 1, 1]) @ K, at.camera_from_world, "tsai", at.distortion)

    found = tsai(SOLID, seen(SOLID, wide), SIZE, fixed=())

    assert abs(found["sx"].value - 1.003) < 4 * found["sx"].sd
    assert found["sx"].sd < 1e-3
    assert abs(found["f"].value - 1200) < 4 * found["f"].sd


def test_moving_the_world_moves_the_pose_alone() -> None:
    at = camera()
    move = Rigid.from_rotation(Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix(), (5e3, -900, 70))

    still, moved = (tsai(X, seen(SOLID, at), SIZE) for X in (SOLID, move.apply(SOLID)))

    for name in ("f", "k1", "cx", "cy"):
        assert moved[name].value == pytest.approx(still[name].value, rel=1e-5), name
        assert moved[name].sd == pytest.approx(still[name].sd, rel=1e-4), name
    back = moved.camera.camera_from_world @ move
    np.testing.assert_allclose(back.matrix, still.camera.camera_from_world.matrix, atol=1e-2)
    assert moved.mm_at_target == pytest.approx(still.mm_at_target, rel=1e-4)


def test_stated_millimetres_at_the_target_are_those_of_repetition() -> None:
    at, n = camera(), 120
    found = [tsai(SOLID, seen(SOLID, at, seed), SIZE) for seed in range(n)]

    off = np.array([c.camera.project(SOLID) - at.project(SOLID) for c in found])
    depth = at.camera_from_world.apply(SOLID)[:, 2]
    mm = np.sqrt(((off**2).sum(axis=2) / 2 * (depth / 1200) ** 2).mean())

    assert np.mean([c.mm_at_target for c in found]) == pytest.approx(mm, rel=0.1)


@pytest.mark.parametrize("X", [PLANE, SOLID], ids=["coplanar", "not coplanar"])
def test_one_wrong_point_is_named(X: Floats) -> None:
    for seed in range(10):
        uv = seen(X, camera(), seed)
        wrong = 3 * seed
        uv[wrong] += (12.0, -9.0)

        found = tsai(X, uv, SIZE)

        assert np.flatnonzero(~found.is_used).tolist() == [wrong]
        assert found.rms_used_px < 0.3 < found.rms_px
        assert chi2_of(found, camera()) < stats.chi2.ppf(0.9999, 10)


def test_points_that_were_swapped_are_named() -> None:
    uv = seen(SOLID, camera())
    uv[[3, 13, 22]] = uv[[13, 22, 3]]

    found = tsai(SOLID, uv, SIZE)

    assert np.flatnonzero(~found.is_used).tolist() == [3, 13, 22]


def test_known_intrinsics_leave_the_pose_alone() -> None:
    at = camera()
    found = tsai(SOLID[:13], seen(SOLID[:13], at), SIZE, camera=at)

    assert [p.name for p in found.parameters] == ["rx", "ry", "rz", "tx", "ty", "tz"]
    np.testing.assert_array_equal(found.camera.matrix, K)
    assert abs(found["tz"].value - 620) < 4 * found["tz"].sd
    assert not found.warnings


def test_what_few_points_cost_is_told() -> None:
    found = tsai(SOLID[:6], seen(SOLID[:6], camera()), SIZE, camera=camera())

    assert any("6 points: about 41 % less sure than 12" in w for w in found.warnings)


@pytest.mark.parametrize("tilt_deg", [0.0, 4.0])
def test_a_frontal_target_is_told(tilt_deg: float) -> None:
    found = tsai(PLANE, seen(PLANE, camera(tilt_deg)), SIZE)

    said = " ".join(found.warnings)
    assert "nearly parallel to the picture" in said
    assert "f and tz move together" in said
    assert np.isfinite([(p.value, p.sd) for p in found.parameters]).all()


def test_a_plane_without_distortion_does_not_pass_for_a_centre() -> None:
    found = tsai(PLANE, seen(PLANE, camera(kappa=0.0)), SIZE)

    assert found["cx"].sd > 50
    assert any("cx" in w and "fix cx and cy" in w for w in found.warnings)


@pytest.mark.parametrize("scale", [1e3, 1e-3])
@pytest.mark.parametrize("known", [True, False])
def test_units_that_are_off_are_told(scale: float, known: bool) -> None:
    X, uv = SOLID * scale, seen(SOLID, camera())
    found = tsai(X, uv, SIZE, camera=camera() if known else None)

    assert any("are they in millimetres?" in w for w in found.warnings)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirrored_points_are_told(axis: int) -> None:
    X = SOLID * np.where(np.arange(3) == axis, -1.0, 1.0)

    with pytest.raises(InputError, match=r"look mirrored: with [xyz] negated"):
        tsai(X, seen(SOLID, camera()), SIZE)
    posed = tsai(X[:13], seen(SOLID[:13], camera()), SIZE, camera=camera())
    assert any("look mirrored" in w for w in posed.warnings)


def test_pixels_with_y_up_are_told() -> None:
    up = seen(SOLID, camera()) * (1, -1) + (0, SIZE[1] - 1)
    with pytest.raises(InputError, match="look mirrored"):
        tsai(SOLID, up, SIZE)


@pytest.mark.parametrize(
    ("X", "uv", "told"),
    [
        (PLANE[:10], np.zeros((10, 2)), "on one line"),
        (np.zeros((10, 3)), np.zeros((10, 2)), "on one line"),
        (PLANE[[0, 3, 40, 55]], np.zeros((4, 2)), "at least 5 points, got 4"),
        (PLANE[[0, 3, 40, 55, 70]], np.zeros((5, 2)), "at least 6 coplanar points, got 5"),
        (SOLID[:6], np.zeros((6, 2)), "at least 7 points that are not in one plane, got 6"),
        (np.full((20, 3), np.nan), np.zeros((20, 2)), "finite"),
        (SOLID, np.zeros((40, 2)), "no camera sees these points|mirrored"),
        (SOLID, np.random.default_rng(0).permutation(camera().project(SOLID)), "no camera sees"),
    ],
)
def test_bad_points_are_told(X: Floats, uv: Floats, told: str) -> None:
    with pytest.raises(InputError, match=told):
        tsai(X, uv, SIZE)


def test_points_behind_the_camera_are_told() -> None:
    p = SOLID + (0, 0, -700)
    with pytest.raises(InputError, match=r"mirrored|no camera"):
        tsai(SOLID, p[:, :2] / p[:, 2:] * 1200 + (640, 480), SIZE)


@pytest.mark.parametrize(("fixed", "told"), [(("z",), "cannot fix z"), (("f",), "to fix f")])
def test_what_cannot_be_fixed_is_told(fixed: tuple[str, ...], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        tsai(SOLID, seen(SOLID, camera()), SIZE, fixed=fixed)
