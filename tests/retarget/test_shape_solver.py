from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.formats.gltf import glb_bytes, scene_from_glb
from facewright.core.formats.live_link_csv import ARKIT_SHAPES
from facewright.core.mpeg4 import displacement_faps, fap_by_name
from facewright.core.rigid import rotation_from_quaternion
from facewright.datasets_synthetic.performances import random_performance
from facewright.heads.head import Head
from facewright.heads.own_head import read_own_head
from facewright.retarget.export import animation_glb
from facewright.retarget.shape_jacobian import (
    ShapeJacobian,
    look_angles,
    rounding_mm,
    shape_jacobian,
)
from facewright.retarget.shape_solver import (
    ShapeDrive,
    solve_weights,
    unobservable_shapes,
    weights_to_faps,
)

Floats = NDArray[np.float64]
#: FAPs that come from our own floats: next to no noise, but above the solver's rounding.
EXACT_MM = 0.01
#: A wide eye differs from a blink by its sign alone: of eyes that blink while wide, FAPs tell the
#: sum. All other channels are found again to 0.03.
NOT_TOLD = {"eyeWideLeft", "eyeWideRight"}
TOLD_APART = tuple(name for name in ARKIT_SHAPES if name not in NOT_TOLD)


@pytest.fixture(scope="module")
def jacobian(average_head: Head) -> ShapeJacobian:
    return shape_jacobian(average_head)


@pytest.fixture(scope="module")
def drive(average_head: Head) -> ShapeDrive:
    return ShapeDrive(average_head)


@pytest.fixture(scope="module")
def acted(average_head: Head) -> Clip:
    """Five seconds of gestures and of talk."""
    rng = np.random.default_rng(11)
    parts = [
        random_performance(rng, average_head, seconds=2.5, rate_hz=60, style=style).weights
        for style in ("range", "mixed")
    ]
    values = np.concatenate([part.values for part in parts])
    return Clip(np.arange(len(values)) / 60, parts[0].channels, values)


def one_frame(**weights: float) -> Clip:
    return Clip(np.zeros(1), tuple(weights), np.array([list(weights.values())]))


def solved(jacobian: ShapeJacobian, faps: Clip, **options: float) -> Floats:
    return solve_weights(jacobian, faps, **options).clip.values


def as_channels(jacobian: ShapeJacobian, weights: Clip) -> Floats:
    return np.stack([weights[str(jacobian.arkit(s))] for s in jacobian.shapes], axis=1)


def test_the_jacobian_is_how_feature_points_move(average_head: Head) -> None:
    jacobian = shape_jacobian(average_head)
    moved = average_head.shaped({"mouthSmileLeft": 0.7, "browInnerUp": 0.3})
    points = average_head.feature_points
    shift = points.at(moved) - points.at(average_head.mesh.vertices)
    wanted = displacement_faps(
        {n: shift[None, i] for i, n in enumerate(points.names)}, average_head.fapu
    )

    faps = weights_to_faps(jacobian, one_frame(mouthSmileLeft=0.7, browInnerUp=0.3))

    assert len(set(faps.channels) & set(wanted)) > 40
    for name in set(faps.channels) & set(wanted):
        assert faps[name][0] == pytest.approx(wanted[name][0], abs=1e-3), name


def test_the_jaw_takes_the_tongue_along(average_head: Head, jacobian: ShapeJacobian) -> None:
    """FAPs of the tongue are displacements from the neutral face, the jaw's part included."""
    faps = weights_to_faps(jacobian, one_frame(jawOpen=1.0))
    points = average_head.feature_points.select(("6.1", "6.2"))
    moved = points.at(average_head.shaped({"jawOpen": 1.0})) - points.at(average_head.mesh.vertices)
    wanted = displacement_faps({"6.1": moved[:1], "6.2": moved[1:]}, average_head.fapu)
    for name in ("raise_tongue_tip", "thrust_tongue_tip", "raise_tongue"):
        assert faps[name][0] == pytest.approx(wanted[name][0], abs=0.5)
    assert faps["raise_tongue_tip"][0] < -1000
    out = weights_to_faps(jacobian, one_frame(tongueOut=1.0))
    assert out["thrust_tongue_tip"][0] > 300


def test_looks_turn_eyes_as_their_names_say(average_head: Head) -> None:
    yaw, pitch = look_angles(average_head, "eyeLookOutLeft", "left")
    assert yaw > 0.2 > abs(pitch)
    yaw, pitch = look_angles(average_head, "eyeLookDownRight", "right")
    assert pitch > 0.15 > abs(yaw)
    assert look_angles(average_head, "jawOpen", "left") == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize("is_rounded", [False, True])
def test_weights_to_faps_and_back(jacobian: ShapeJacobian, acted: Clip, is_rounded: bool) -> None:
    faps = weights_to_faps(jacobian, acted)
    if is_rounded:
        faps = replace(faps, values=np.rint(faps.values))

    found = solve_weights(jacobian, faps, noise_mm=EXACT_MM)

    assert found.converged
    off = found.clip.values - as_channels(jacobian, acted)
    rms = dict(zip(jacobian.shapes, np.sqrt((off**2).mean(axis=0)), strict=True))
    if is_rounded:
        assert np.median(list(rms.values())) < 0.05
    else:
        apart = [n for n in TOLD_APART if rms[n] > 0.03]
        assert not apart, f"{apart}: {[round(float(rms[n]), 3) for n in apart]}"
        assert len(TOLD_APART) >= 40


def test_rest_is_exactly_rest(jacobian: ShapeJacobian, acted: Clip) -> None:
    faps = weights_to_faps(jacobian, acted)
    values = faps.values.copy()
    values[:20] = 0
    values[200:203] = 0

    found = solved(jacobian, replace(faps, values=values))

    assert (found[:20] == 0).all()
    assert (found[200:203] == 0).all()
    assert found[203:].any()


def test_shapes_that_nothing_asks_for_stay_exactly_at_rest(jacobian: ShapeJacobian) -> None:
    faps = weights_to_faps(jacobian, one_frame(browOuterUpLeft=0.8))
    found = dict(zip(jacobian.shapes, solved(jacobian, faps)[0], strict=True))
    assert found.pop("browOuterUpLeft") == pytest.approx(0.8, abs=0.05)
    assert [n for n, w in found.items() if w and not n.startswith(("brow", "nose"))] == []


def test_an_open_jaw_with_closed_lips_is_told(jacobian: ShapeJacobian) -> None:
    faps = weights_to_faps(jacobian, one_frame(jawOpen=0.5, mouthClose=0.4))
    found = dict(zip(jacobian.shapes, solved(jacobian, faps, noise_mm=0.02)[0], strict=True))
    assert found["jawOpen"] == pytest.approx(0.5, abs=0.02)
    assert found["mouthClose"] == pytest.approx(0.4, abs=0.02)


def test_the_mouth_closes_no_further_than_the_jaw_opens(jacobian: ShapeJacobian) -> None:
    rng = np.random.default_rng(1)
    faps = weights_to_faps(jacobian, one_frame(jawOpen=1.0, mouthClose=1.0))
    values = faps.values * rng.uniform(-1, 2, size=(50, 1)) + rng.normal(
        0, 100, (50, len(faps.channels))
    )
    wild = Clip(np.arange(50) / 60, faps.channels, values)

    found = dict(zip(jacobian.shapes, solved(jacobian, wild).T, strict=True))

    assert (found["mouthClose"] <= found["jawOpen"]).all()
    assert found["mouthClose"].max() > 0.3
    assert all((w >= 0).all() and (w <= 1).all() for w in found.values())


def test_lids_close_no_further_than_a_blink(jacobian: ShapeJacobian) -> None:
    blink = weights_to_faps(jacobian, one_frame(eyeBlinkLeft=1.0, eyeBlinkRight=1.0))
    further = replace(blink, values=1.5 * blink.values)

    found = dict(zip(jacobian.shapes, solved(jacobian, further)[0], strict=True))

    assert found["eyeBlinkLeft"] > 0.95
    assert [n for n, w in found.items() if w and n.startswith("eyeLook")] == []


def test_an_eye_looks_one_way_at_a_time(jacobian: ShapeJacobian, acted: Clip) -> None:
    faps = weights_to_faps(jacobian, acted)
    rng = np.random.default_rng(5)
    noisy = replace(faps, values=faps.values + rng.normal(0, 30, faps.values.shape))

    found = dict(zip(jacobian.shapes, solved(jacobian, noisy).T, strict=True))

    for side in ("Left", "Right"):
        for one, other in (("Up", "Down"), ("In", "Out")):
            a, b = found[f"eyeLook{one}{side}"], found[f"eyeLook{other}{side}"]
            assert a.any() and b.any()
            assert not (a * b).any()


def test_noise_is_smoothed_without_lag(jacobian: ShapeJacobian) -> None:
    t = np.arange(120) / 60
    smile = np.exp(-(((t - 1.0) / 0.25) ** 2)) * 0.8
    clean = weights_to_faps(jacobian, Clip(t, ("mouthSmileLeft",), smile[:, None]))
    rng = np.random.default_rng(2)
    noisy = replace(clean, values=clean.values + rng.normal(0, 8, clean.values.shape))
    column = jacobian.shapes.index("mouthSmileLeft")

    rough = solved(jacobian, noisy, cutoff_hz=np.inf)
    smooth = solved(jacobian, noisy)

    def jitter(w: Floats) -> float:
        return float(np.abs(np.diff(w, 2, axis=0)).mean())

    assert jitter(smooth) < 0.7 * jitter(rough)
    lags = [float(((np.roll(smooth[:, column], -k) - smile) ** 2).mean()) for k in range(-3, 4)]
    assert int(np.argmin(lags)) == 3


def test_the_reversed_clip_gives_reversed_weights(jacobian: ShapeJacobian, acted: Clip) -> None:
    faps = weights_to_faps(jacobian, acted)
    backwards = replace(faps, values=faps.values[::-1])
    np.testing.assert_allclose(solved(jacobian, backwards)[::-1], solved(jacobian, faps), atol=1e-6)


def test_faps_that_are_not_given_are_free(jacobian: ShapeJacobian, acted: Clip) -> None:
    faps = weights_to_faps(jacobian, acted)
    brows = tuple(c for c in faps.channels if "eyebrow" in c)
    alone = Clip(faps.time_s, brows, np.stack([faps[c] for c in brows], axis=1))

    found = dict(zip(jacobian.shapes, solved(jacobian, alone).T, strict=True))

    assert max(w.max() for n, w in found.items() if n.startswith("brow")) > 0.2
    assert not any(w.any() for n, w in found.items() if n.startswith(("jaw", "mouth")))


def test_the_residual_is_what_points_miss(jacobian: ShapeJacobian, acted: Clip) -> None:
    faps = weights_to_faps(jacobian, acted)
    found = solve_weights(jacobian, faps)
    again = weights_to_faps(jacobian, found.clip)
    blink = weights_to_faps(jacobian, one_frame(eyeBlinkLeft=1.0, eyeBlinkRight=1.0))
    lids = np.array([c.startswith("close_t") for c in faps.channels])
    wanted = np.where(lids, np.minimum(faps.values, blink.values), faps.values)
    missed = (again.values - wanted) * jacobian.unit_mm
    kept = [i for i, c in enumerate(faps.channels) if faps[c].any()]

    np.testing.assert_allclose(
        found.residual_mm, np.sqrt((missed[:, kept] ** 2).mean(axis=1)), atol=0.02
    )


def doubled(head: Head, name: str, new_name: str) -> Head:
    """The head with a copy of a shape."""
    assert head.shapes is not None
    row = head.shapes[[head.shape_names.index(name)]]
    return replace(
        head,
        shape_names=(*head.shape_names, new_name),
        shapes=np.concatenate([head.shapes, row]),
    )


def test_what_the_null_space_hides_is_named(average_head: Head) -> None:
    assert set(unobservable_shapes(average_head)) == NOT_TOLD
    assert average_head.shapes is not None
    shapes = np.array(average_head.shapes)
    place = average_head.shape_names.index
    shapes[place("mouthDimpleLeft")] = 0.5 * shapes[place("mouthStretchLeft")]
    shapes[place("cheekPuff")] = 0.0

    found = unobservable_shapes(replace(average_head, shapes=shapes))

    assert set(found) == {"mouthDimpleLeft", "mouthStretchLeft", "cheekPuff", *NOT_TOLD}


def test_the_stated_uncertainty_is_that_of_least_squares(jacobian: ShapeJacobian) -> None:
    # without opposites, the closed form of the posterior: var = (AᵀA / σ² + I / s²)⁻¹
    rng = np.random.default_rng(3)
    column = jacobian.shapes.index("browInnerUp")
    brows = [i for i, s in enumerate(jacobian.shapes) if s.startswith(("brow", "nose"))]
    A = jacobian.mm[:, brows]
    truth = rng.normal(0, 0.3, size=(4000, len(brows)))
    seen = truth @ A.T + rng.normal(0, 1.0, size=(4000, len(A)))
    gain = np.linalg.solve(A.T @ A + np.eye(len(brows)) / 0.3**2, A.T)
    sd = (seen @ gain.T - truth).std(axis=0)

    assert jacobian.weight_sd(1.0)[column] == pytest.approx(sd[brows.index(column)], rel=0.2)


def test_correctives_come_with_what_they_correct(average_head: Head) -> None:
    head = doubled(average_head, "cheekPuff", "jawOpen_mouthSmileLeft")
    jacobian = shape_jacobian(head)
    assert jacobian.correctives == ("jawOpen_mouthSmileLeft",)
    weights = one_frame(jawOpen=0.8, mouthSmileLeft=0.5)
    faps = weights_to_faps(jacobian, weights)
    plain = weights_to_faps(shape_jacobian(average_head), weights)
    puff = weights_to_faps(jacobian, one_frame(cheekPuff=0.4))
    np.testing.assert_allclose(faps["puff_l_cheek"], plain["puff_l_cheek"] + puff["puff_l_cheek"])

    found = solve_weights(jacobian, faps, noise_mm=EXACT_MM).clip

    assert found["jawOpen"][0] == pytest.approx(0.8, abs=0.02)
    assert found["mouthSmileLeft"][0] == pytest.approx(0.5, abs=0.02)
    assert found["jawOpen_mouthSmileLeft"][0] == pytest.approx(
        found["jawOpen"][0] * found["mouthSmileLeft"][0], abs=0.01
    )
    assert found["cheekPuff"][0] < 0.03


def test_a_head_with_vowels_only_speaks(average_head: Head) -> None:
    assert average_head.shapes is not None
    place = average_head.shape_names.index
    poses = {
        "A": {"jawOpen": 0.6},
        "U": {"mouthPucker": 0.7},
        "Blink": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    }
    shapes = np.stack(
        [
            sum(w * average_head.shapes[place(n)] for n, w in amounts.items())
            for amounts in poses.values()
        ]
    )
    head = replace(average_head, shape_names=tuple(poses), shapes=shapes)
    faps = weights_to_faps(shape_jacobian(average_head), one_frame(jawOpen=0.3))

    found = ShapeDrive(head).weights(faps)

    assert found.clip["A"][0] == pytest.approx(0.5, abs=0.05)
    assert found.clip["Blink"][0] == 0
    assert found.arkit_clip()["jawOpen"][0] > 0.1


def test_the_animation_is_the_heads_own_shapes(
    average_head: Head, drive: ShapeDrive, acted: Clip
) -> None:
    animation = drive.animate(acted)
    skin = average_head.part_vertices("skin")

    for frame in (0, 70, 200):
        weights = dict(zip(acted.channels, acted.values[frame], strict=True))
        wanted = average_head.shaped(weights)
        np.testing.assert_allclose(animation.vertices(frame)[skin], wanted[skin], atol=1e-3)


def test_parts_of_bone_and_eyes_keep_their_form(average_head: Head, drive: ShapeDrive) -> None:
    animation = drive.animate(one_frame(jawOpen=0.8, eyeLookOutLeft=1.0, eyeLookDownLeft=0.5))
    moved = animation.vertices(0)
    for part in ("teeth_lower", "eye_left", "eye_right", "teeth_upper"):
        rows = average_head.part_vertices(part)
        rest = average_head.mesh.vertices[rows]
        distances = np.linalg.norm(moved[rows] - moved[rows[0]], axis=1)
        np.testing.assert_allclose(
            distances, np.linalg.norm(rest - rest[0], axis=1), atol=1e-3, err_msg=part
        )
    teeth = average_head.part_vertices("teeth_lower")
    as_sculpted = average_head.shaped({"jawOpen": 0.8})[teeth]
    assert np.linalg.norm(moved[teeth] - as_sculpted, axis=1).mean() < 2.0
    eye = rotation_from_quaternion(animation.parts["eye_left"].rotation[0])
    yaw, pitch = np.arctan2(eye[0, 2], eye[2, 2]), np.arcsin(-eye[1, 2])
    wanted = [look_angles(average_head, s, "left") for s in ("eyeLookOutLeft", "eyeLookDownLeft")]
    assert yaw == pytest.approx(wanted[0][0] + 0.5 * wanted[1][0], abs=0.03)
    assert pitch == pytest.approx(wanted[0][1] + 0.5 * wanted[1][1], abs=0.03)


def test_eyes_and_head_turn_by_their_faps(drive: ShapeDrive) -> None:
    clip = one_frame(yaw_l_eyeball=30000.0, pitch_r_eyeball=20000.0, head_yaw=40000.0, open_jaw=0.0)
    animation = drive.animate(clip)
    left = rotation_from_quaternion(animation.parts["eye_left"].rotation[0])
    right = rotation_from_quaternion(animation.parts["eye_right"].rotation[0])
    head = animation.motion.rotation[0]
    assert np.arctan2(left[0, 2], left[2, 2]) == pytest.approx(0.3)
    assert np.arcsin(-right[1, 2]) == pytest.approx(0.2)
    assert np.arctan2(head[0, 2], head[2, 2]) == pytest.approx(0.4)
    pivot = drive.head.neck_pivot
    np.testing.assert_allclose(animation.motion.world_from_head(pivot[None])[0, 0], pivot)
    arkit = drive.animate(one_frame(jawOpen=0.0, headYaw=0.4))
    np.testing.assert_allclose(arkit.motion.quaternion, animation.motion.quaternion, atol=1e-12)


def test_refined_points_go_where_faps_say(average_head: Head, jacobian: ShapeJacobian) -> None:
    mm = {"raise_l_cornerlip_o": 7.0, "stretch_l_cornerlip_o": -3.0, "raise_l_i_eyebrow": 2.0,
          "raise_l_m_eyebrow": -2.0, "puff_r_cheek": 3.0, "close_t_l_eyelid": 4.0}  # fmt: skip
    unit = {n: average_head.fapu.unit(fap_by_name()[n]) for n in mm}
    clip = one_frame(**{n: v / unit[n] for n, v in mm.items()})
    points = average_head.feature_points
    rest = points.at(average_head.mesh.vertices)
    missed = []
    for refine in (False, True):
        drive = ShapeDrive(average_head, refine=refine)
        moved = points.at(drive.animate(clip).vertices(0)) - rest
        faps = displacement_faps(
            {n: moved[None, i] for i, n in enumerate(points.names)}, average_head.fapu
        )
        missed.append(max(abs(faps[n][0] * unit[n] - v) for n, v in mm.items()))

    assert missed[0] > 0.5
    assert missed[1] < 1e-3


def test_the_export_has_one_blendshape_a_shape(
    average_head: Head, drive: ShapeDrive, acted: Clip
) -> None:
    short = Clip(acted.time_s[60:70], acted.channels, acted.values[60:70])
    animation = drive.animate(short)
    scene = scene_from_glb(glb_bytes(animation_glb(average_head, animation, name="x")))
    skin = next(part for part in scene.parts if part.name == "skin")
    assert skin.weights is not None
    n_moving = sum(
        bool(np.ptp(drive.weights(short).clip[s]) or short[s].any()) for s in short.channels
    )
    assert 0 < len(skin.targets) <= n_moving
    moved = skin.vertices.copy()
    for target, weight in zip(skin.targets, skin.weights[5], strict=True):
        moved[target.rows] += weight * target.offsets
    wanted = animation.vertices(5)[average_head.part_vertices("skin")]
    assert np.abs(np.sort(moved[:, 1])[[0, -1]] - np.sort(wanted[:, 1])[[0, -1]]).max() < 1e-3


def test_bad_input_is_refused_in_words(average_head: Head, drive: ShapeDrive) -> None:
    with pytest.raises(InputError, match="has no shapes"):
        ShapeDrive(replace(average_head, shape_names=(), shapes=None))
    odd = replace(
        average_head, shape_names=tuple(f"Key {i}" for i in range(len(average_head.shape_names)))
    )
    with pytest.raises(InputError, match="no name says what they are"):
        ShapeDrive(odd)
    with pytest.raises(InputError, match="none of the clip's shapes: elbow"):
        drive.animate(one_frame(elbow=1.0))
    with pytest.raises(InputError, match="none of the clip's FAPs moves a shape"):
        drive.weights(one_frame(dilate_l_pupil=5.0))
    with pytest.raises(ValueError, match="no method"):
        ShapeDrive(average_head, method="guess")
    with pytest.raises(ValueError, match="above 0"):
        solve_weights(drive.jacobian, one_frame(open_jaw=1.0), noise_mm=0.0)


def test_unknown_shapes_are_said_and_left_at_rest(
    average_head: Head, caplog: pytest.LogCaptureFixture
) -> None:
    head = doubled(average_head, "jawOpen", "jawOpne")
    drive = ShapeDrive(head)
    assert "jawOpne (jawOpen?)" in caplog.text
    assert "jawOpne" not in drive.deformer.points.names


@pytest.fixture(scope="module")
def foreign_head(real_data: Path) -> Head:
    """ICT-FaceKit's random identity, whose feature points we place."""
    path = real_data / "heads" / "ict_random_identity.glb"
    if not path.is_file():
        pytest.skip(f"the head is not on this machine (expected at {path})")
    return read_own_head(path).head


@pytest.mark.slow
def test_a_head_of_another_origin(foreign_head: Head, acted: Clip) -> None:
    drive = ShapeDrive(foreign_head)
    jacobian = drive.jacobian
    assert set(jacobian.names.missing) == {"tongueOut"}
    assert set(jacobian.names.unknown) == {
        "PupilDilate_L", "PupilDilate_R", "cheekRaiser_L", "cheekRaiser_R",
    }  # fmt: skip
    truth = weights_to_faps(jacobian, acted)

    found = drive.weights(replace(truth, values=np.rint(truth.values)))

    assert found.converged
    skin = foreign_head.part_vertices("skin")
    assert foreign_head.shapes is not None
    columns = [foreign_head.shape_names.index(s) for s in jacobian.shapes]
    off = found.clip.values - as_channels(jacobian, acted)
    square = 0.0
    for frame in range(0, len(off), 10):
        moved = np.tensordot(off[frame], foreign_head.shapes[columns][:, skin], axes=1)
        square = square + (moved**2).sum(axis=1).mean()
    assert np.sqrt(square / len(range(0, len(off), 10))) < 1.0


def test_integer_faps_are_rounded_by_a_hundredth_of_a_millimetre(jacobian: ShapeJacobian) -> None:
    rounding = dict(zip((f.name for f in jacobian.faps), rounding_mm(jacobian), strict=True))
    unit = jacobian.head.fapu.unit(fap_by_name()["open_jaw"])
    assert rounding["open_jaw"] == pytest.approx(unit / np.sqrt(12))
    assert 0.001 < np.median(list(rounding.values())) < 0.02
