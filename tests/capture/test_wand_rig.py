"""Rigs from a wand: exactness, Monte Carlo, gauges, detection among other lights, bad sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.rigs import RigCalibration
from facewright.capture.spheres import sphere_centres
from facewright.capture.wand_detection import find_wand, is_symmetric
from facewright.capture.wand_rig import calibrate_wand
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.rigs import face_rig
from facewright.datasets_synthetic.wand import BALLS_MM, Wand

Floats = NDArray[np.float64]
SD = 0.1
RIG = face_rig(np.random.default_rng(3), n_cameras=4)
BALLS = np.stack([Wand.random(np.random.default_rng(8)).balls(t) for t in np.arange(150) / 12])


def seen_by(
    rig: Rig = RIG, balls: Floats = BALLS, sd: float = SD, seed: int = 0
) -> dict[str, Floats]:
    """Pixels of the balls; NaN outside the pictures."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, camera in rig.cameras.items():
        uv = camera.project(balls) + rng.normal(0, sd, (*balls.shape[:2], 2))
        uv[~((uv > 5) & (uv < np.array(camera.image_size) - 6)).all(axis=-1)] = np.nan
        found[name] = uv
    return found


def errors(found: RigCalibration, truth: Rig = RIG) -> dict[str, Floats]:
    """δrotation and centre, true less found, in the first camera's frame."""
    result = {}
    first = truth[found.rig.names[0]].camera_from_world
    for name, camera in found.rig.cameras.items():
        true = truth[name].camera_from_world @ first.inverse()
        got = camera.camera_from_world
        turn = Rotation.from_matrix(true.rotation @ got.rotation.T).as_rotvec()
        result[name] = np.concatenate(
            [turn, true.inverse().translation - got.inverse().translation]
        )
    return result


@pytest.mark.parametrize("picked", [(0, 1, 2), (0, 2)])
def test_without_noise_the_cameras_are_exact(picked: tuple[int, ...]) -> None:
    places = tuple(BALLS_MM[i] for i in picked)

    found = calibrate_wand(seen_by(balls=BALLS[:, list(picked)], sd=0.0), RIG.cameras, places)

    assert found.rig.names == RIG.names
    for error in errors(found).values():
        np.testing.assert_allclose(error[:3], 0, atol=1e-8)
        np.testing.assert_allclose(error[3:], 0, atol=1e-5)
    assert found.rms_px < 1e-6
    first = RIG["cam0"].camera_from_world
    for i, pose in list(enumerate(found.view_poses.values()))[::30]:
        wand = pose.apply(np.column_stack([np.array(places), np.zeros((len(places), 2))]))
        moment = int(list(found.view_poses)[i].split()[1])
        np.testing.assert_allclose(wand, first.apply(BALLS[moment, list(picked)]), atol=1e-4)


def test_the_stated_covariance_is_that_of_repetition() -> None:
    n = 24
    found = [calibrate_wand(seen_by(seed=s), RIG.cameras, BALLS_MM) for s in range(n)]
    for name in RIG.names[1:]:
        off = np.array([errors(f)[name] for f in found])
        chi2 = [e @ np.linalg.solve(f.covariance[name], e) for e, f in zip(off, found, strict=True)]
        # mean of n χ² of 6 degrees of freedom: sd sqrt(12 / n)
        assert np.mean(chi2) == pytest.approx(6, abs=4 * np.sqrt(12 / n)), name
    assert np.mean([f.sd_px for f in found]) == pytest.approx(SD, rel=0.02)
    np.testing.assert_array_equal(found[0].covariance["cam0"], 0)


def test_wands_that_lie_either_way_round_give_the_same_rig() -> None:
    rng = np.random.default_rng(1)
    ends = {n: uv[:, [0, 2]] for n, uv in seen_by().items()}
    mixed = {}
    for name, uv in ends.items():
        turned = rng.random(len(uv)) < 0.5
        mixed[name] = np.where(turned[:, None, None], uv[:, ::-1], uv)

    same, either = (calibrate_wand(s, RIG.cameras, (0.0, 120.0)) for s in (ends, mixed))

    assert len(either.view_poses) >= 0.9 * len(same.view_poses)
    for name, error in errors(either).items():
        assert np.abs(error[3:]).max() < 0.3, name
        sd = np.sqrt(np.diag(same.covariance[name]))[3:] + 1e-9
        assert (np.abs(error[3:] - errors(same)[name][3:]) < 2 * sd).all()


def test_scale_is_that_of_the_wand() -> None:
    true = calibrate_wand(seen_by(), RIG.cameras, BALLS_MM)
    double = calibrate_wand(seen_by(), RIG.cameras, [2 * b for b in BALLS_MM])

    for name in RIG:
        np.testing.assert_allclose(
            double.rig[name].position, 2 * true.rig[name].position, atol=2e-5
        )


def test_lenses_that_are_refined_are_found() -> None:
    balls = np.stack([Wand.random(np.random.default_rng(4)).balls(t) for t in np.arange(400) / 15])
    off = {
        n: replace(c, matrix=c.matrix * np.array([[1.005, 1, 1.004], [1, 1.005, 1], [1, 1, 1]]))
        for n, c in RIG.cameras.items()
    }

    found = calibrate_wand(
        seen_by(balls=balls), off, BALLS_MM, refine=dict.fromkeys(RIG.names, "opencv4")
    )

    for name in RIG:
        C = found.intrinsics_covariance[name]
        got = found.rig[name]
        d = np.array([*got.distortion, 0, 0, 0, 0])[:4]
        K, true = got.matrix, RIG[name]
        e = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d])
        e -= [*true.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *true.distortion[:4]]
        assert e @ np.linalg.solve(C, e) < 30, name  # χ² of 8: 1 in 5000
        assert found.parameters[name][:4] == ("fx", "fy", "cx", "cy")


def test_wrong_balls_are_named_and_do_no_harm() -> None:
    views = seen_by()
    views["cam1"][7, 1] += (9.0, -6.0)
    views["cam2"][40, 0] += (-200.0, 40.0)

    found = calibrate_wand(views, RIG.cameras, BALLS_MM)

    assert {r.name for r in found.views_rejected} == {"cam1/moment 7", "cam2/moment 40"}
    assert "ball 1 lies" in next(r.reason for r in found.views_rejected if "cam1" in r.name)
    assert found.rms_used_px < 0.2 < found.rms_px
    for name, error in errors(found).items():
        assert np.abs(error[3:]).max() < 0.3, name


def test_a_camera_that_shares_no_moments_is_named() -> None:
    views = seen_by()
    views["cam3"][: len(BALLS) // 2] = np.nan
    for name in RIG.names[:3]:
        views[name][len(BALLS) // 2 :] = np.nan

    found = calibrate_wand(views, RIG.cameras, BALLS_MM)

    assert found.unconnected == ("cam3",)
    assert found.rig.names == ("cam0", "cam1", "cam2")
    assert any("cam3: shares too few moments" in w for w in found.warnings)


def test_cameras_are_chained_over_others() -> None:
    views = seen_by()
    half = len(BALLS) // 2
    views["cam0"][half:] = np.nan  # cam0 and cam3 share nothing
    views["cam3"][:half] = np.nan

    found = calibrate_wand(views, RIG.cameras, BALLS_MM)

    assert found.unconnected == ()
    assert max(np.abs(e[3:]).max() for e in errors(found).values()) < 0.5


def test_small_and_one_way_waving_is_warned_about() -> None:
    middle = BALLS.mean(axis=1, keepdims=True)
    along = np.array([1.0, 0, 0]) * (np.array(BALLS_MM) - 55)[:, None]
    one_way = middle + along
    flat = BALLS * (1, 1, 0)

    assert not calibrate_wand(seen_by(), RIG.cameras, BALLS_MM).warnings
    told = calibrate_wand(seen_by(balls=one_way), RIG.cameras, BALLS_MM).warnings
    assert any("same direction" in w for w in told)
    told = calibrate_wand(seen_by(balls=flat * (1, 0.1, 1)), RIG.cameras, BALLS_MM).warnings
    assert any("filled little of the space" in w for w in told)


def test_wrong_places_of_the_balls_are_warned_about() -> None:
    told = calibrate_wand(seen_by(), RIG.cameras, (0.0, 60.0, 119.0)).warnings

    assert any("ball 1 hardly ever lies" in w for w in told)


@pytest.mark.parametrize(
    ("views", "balls", "told"),
    [
        ({"cam0": seen_by()["cam0"]}, BALLS_MM, "at least two cameras"),
        ({n: v[:4] for n, v in seen_by().items()}, BALLS_MM, "no two cameras can be placed"),
        ({n: v * np.nan for n, v in seen_by().items()}, BALLS_MM, "seen whole by cam0 in 0"),
        (seen_by(), (0.0,), "at least two balls"),
        (seen_by(), (0.0, 50.0, 40.0), "grow from ball to ball"),
        ({"cam0": seen_by()["cam0"], "cam9": seen_by()["cam1"]}, BALLS_MM, "no lens for cam9"),
    ],
)
def test_bad_sets_are_told(views: dict[str, Floats], balls: tuple[float, ...], told: str) -> None:
    with pytest.raises(InputError, match=told):
        calibrate_wand(views, RIG.cameras, balls)


def test_unknown_lens_models_are_told() -> None:
    with pytest.raises(InputError, match="no lens model fisheye"):
        calibrate_wand(seen_by(), RIG.cameras, BALLS_MM, refine={"cam1": "fisheye"})


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="sightings of cam1"):
        calibrate_wand(
            {"cam0": np.zeros((9, 3, 2)), "cam1": np.zeros((9, 2, 2))}, RIG.cameras, BALLS_MM
        )


def test_the_wand_is_found_among_other_lights() -> None:
    rng = np.random.default_rng(2)
    found, wrong = 0, 0
    camera = RIG["cam1"]
    for balls in BALLS:
        true = camera.project(balls)
        others = rng.uniform((20, 20), (1260, 700), (5, 2))
        spots = np.concatenate([others, true])
        areas = np.concatenate([rng.uniform(20, 900, 5), np.full(3, 330.0)])
        order = rng.permutation(len(spots))
        rows = find_wand(spots[order], camera, BALLS_MM, areas_px=areas[order])
        if rows is not None:
            hit = np.abs(spots[order][rows] - true).max() < 1e-9
            found, wrong = found + hit, wrong + (not hit)

    assert found >= 0.93 * len(BALLS)
    assert wrong <= 0.01 * len(BALLS)


def test_no_wand_is_found_where_there_is_none() -> None:
    camera = RIG["cam0"]
    true = camera.project(BALLS[10])

    assert find_wand(true[:2], camera, BALLS_MM) is None
    assert find_wand(np.zeros((0, 2)), camera, BALLS_MM) is None
    bent = true + [[0, 0], [8.0, 8.0], [0, 0]]
    assert find_wand(bent, camera, BALLS_MM) is None
    unequal = find_wand(true, camera, BALLS_MM, areas_px=[330.0, 330.0, 60.0])
    assert unequal is None
    assert find_wand(true, camera, (0.0, 90.0, 120.0)) is None  # balls elsewhere


@pytest.mark.parametrize(
    ("balls", "expected"),
    [((0, 45, 120), False), ((0, 120), True), ((10, 60, 110), True), ((0, 30, 70, 100), True)],
)
def test_symmetry_of_wands(balls: tuple[float, ...], expected: bool) -> None:
    assert is_symmetric(balls) is expected


def test_centres_of_spheres_are_found_under_their_outlines() -> None:
    """Against the outline itself, by many rays that touch the sphere."""
    camera = RIG["cam1"]
    radius = 12.0
    world = camera.camera_from_world.inverse().apply(
        np.array([[150.0, 90, 700], [-220, -120, 800], [0, 0, 650]])
    )
    turn = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    middles, areas = [], []
    for centre in world:
        apart = centre - camera.position
        distance = np.linalg.norm(apart)
        sine = radius / distance
        axis = Rigid.from_rotation(
            Rotation.align_vectors([apart / distance], [[0, 0, 1.0]])[0].as_matrix()
        )
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
        touch = (1 - sine**2) * apart + axis.apply(rim) * radius * np.sqrt(1 - sine**2)
        p = camera.project(camera.position + touch)
        q = np.roll(p, -1, axis=0)
        cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
        areas.append(abs(cross.sum()) / 2)
        middles.append(((p + q) * cross[:, None]).sum(axis=0) / (3 * cross.sum()))

    found = sphere_centres(middles, areas, camera)

    off = np.abs(np.array(middles) - camera.project(world)).max(axis=1)
    assert off[:2].min() > 0.05  # without the correction
    np.testing.assert_allclose(found, camera.project(world), atol=1.5e-3)
