"""From landmarks to a face: landmarks made from a known face, by the camera's own projection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.mpeg4 import Fapu, displacement_faps
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.heads.identity import make_head, random_identity
from facewright.heads.place_face_landmarks import template_face_landmarks
from facewright.tracking.face_analysis import DEAD, FacePerformance, analyse_face
from facewright.tracking.face_fit import FittedFace
from facewright.tracking.face_pose import FaceSolver, with_own_offsets
from facewright.tracking.face_views import start_state, views_of
from facewright.tracking.landmark_noise import LandmarkModel, landmark_model
from facewright.tracking.landmark_tracks import LandmarkSource, LandmarkTracks

Floats = NDArray[np.float64]
SIZE = (1280, 720)


def camera(yaw_deg: float = 0.0, distance: float = 800.0) -> Camera:
    """A camera that looks at the head's origin."""
    K = np.array([[1500.0, 0, 639.5], [0, 1500.0, 359.5], [0, 0, 1]])
    turn = Rotation.from_euler("Y", yaw_deg, degrees=True).as_matrix().T
    R = np.diag([1.0, -1.0, -1.0]) @ turn
    return Camera(SIZE, K, Rigid.from_rotation(R, (0, 0, distance)))


@dataclass(frozen=True, eq=False)
class Acted:
    """A face that acts: the truth, in FAPs too."""

    time_s: Floats
    world_from_head: list[Rigid]
    rest: Floats
    moved: Floats
    faps: dict[str, Floats]


def without_bias(model: LandmarkModel) -> LandmarkModel:
    """A network that sees every landmark where the model's linear part puts it."""
    plain = np.zeros_like(model.correction)
    return replace(model, bias=np.zeros_like(model.bias), correction=plain)


def act(model: LandmarkModel, seed: int = 0, n_frames: int = 45) -> Acted:
    """A person outside those learnt from, neutral for a third of a second, then acting smoothly."""
    rng = np.random.default_rng(seed)
    head = make_head(random_identity(rng), texture_px=256)
    rest = template_face_landmarks().at(head.mesh.vertices)
    t = np.arange(n_frames) / 30
    begin = np.clip((t - 0.35) / 0.3, 0, 1)[:, None]
    waves = np.sin(2 * np.pi * (t[:, None] * rng.uniform(0.5, 1.5, model.n_components)))
    c = 0.8 * begin * waves * rng.uniform(0.3, 1.0, model.n_components)
    turns = begin * np.deg2rad([10.0, 12.0, 5.0]) * np.sin(2 * np.pi * t[:, None] * [0.6, 0.8, 0.5])
    poses = [Rigid.from_rotation(Rotation.from_rotvec(w).as_matrix(), (5, -3, 10)) for w in turns]
    points = np.einsum("tk,kpx->tpx", c, model.points)
    by_name = {p: points[:, i] for i, p in enumerate(model.point_names)}
    moved = np.einsum("tk,knx->tnx", c, model.gain)
    return Acted(t, poses, rest, moved, displacement_faps(by_name, head.fapu))


def seen_by(
    acted: Acted, model: LandmarkModel, cam: Camera, noise_px: float = 0.0
) -> LandmarkTracks:
    """The landmarks in a camera; unused ones are put where the nose is."""
    T = len(acted.time_s)
    px = np.zeros((T, 478, 2))
    for t, pose in enumerate(acted.world_from_head):
        at = cam.project(pose.apply(acted.rest + acted.moved[t]))
        px[t] = at.mean(axis=0)
        px[t, model.numbers] = at
    px += np.random.default_rng(1).normal(0, noise_px, px.shape)
    source = np.full(T, int(LandmarkSource.NETWORK))
    sd = np.full((T, 478), max(noise_px, 0.05))
    return LandmarkTracks(acted.time_s, px, sd, np.full(T, 20.0), source, SIZE)


def rotation_errors_deg(found: NDArray[np.float64], acted: Acted) -> Floats:
    """Of turns from the first frame."""
    true = np.stack([p.rotation for p in acted.world_from_head])
    off = (found @ found[0].T) @ np.swapaxes(true @ true[0].T, 1, 2)
    return np.asarray(np.rad2deg(Rotation.from_matrix(off).magnitude()))


@pytest.fixture(scope="module")
def model() -> LandmarkModel:
    return without_bias(landmark_model())


@pytest.fixture(scope="module")
def acted(model: LandmarkModel) -> Acted:
    return act(model)


@pytest.fixture(scope="module")
def seen_once(model: LandmarkModel, acted: Acted) -> FacePerformance:
    """By one known camera, without noise."""
    return analyse_face(seen_by(acted, model, camera()), camera=camera(), neutral=0.1, model=model)


def fap_error_mm(faps: dict[str, Floats], acted: Acted, name: str, unit: float) -> float:
    return float(np.sqrt(((faps[name] - acted.faps[name]) ** 2).mean()) * unit)


def test_one_camera_finds_what_the_face_did(seen_once: FacePerformance, acted: Acted) -> None:
    assert rotation_errors_deg(seen_once.head_motion.rotation, acted).max() < 1.0
    for name in ("open_jaw", "raise_b_midlip", "close_t_l_eyelid", "raise_r_m_eyebrow"):
        r = np.corrcoef(seen_once.faps[name], acted.faps[name])[0, 1]
        assert r > 0.9, f"{name}: correlation {r:.3f}"


def test_faps_are_nothing_while_the_face_is_neutral(
    seen_once: FacePerformance, acted: Acted
) -> None:
    still = seen_once.faps.values[:8]
    assert np.abs(still).max() < 0.1 * np.abs(seen_once.faps.values).max()
    assert np.nanmax(seen_once.weights.values[:8]) < 0.05


@pytest.mark.slow
def test_a_second_camera_measures_depth(model: LandmarkModel, acted: Acted) -> None:
    cameras = {"a": camera(-20.0), "b": camera(25.0)}
    tracks = [seen_by(acted, model, c, 0.2) for c in cameras.values()]

    one = analyse_face(tracks[0], camera=cameras["a"], neutral=0.1, model=model)
    two = analyse_face(tracks, rig=Rig(cameras), neutral=0.1, model=model)

    off = np.zeros(2)
    for name in ("thrust_jaw", "push_b_lip", "push_t_lip"):
        assert np.nanmedian(two.fap_sd[name]) < np.nanmedian(one.fap_sd[name])
        off += [((f.faps[name] - acted.faps[name]) ** 2).mean() for f in (one, two)]
    assert off[1] < off[0]


@pytest.mark.slow
def test_two_cameras_measure_the_size_of_the_head(model: LandmarkModel, acted: Acted) -> None:
    cameras = {"a": camera(-20.0), "b": camera(25.0)}
    tracks = [seen_by(acted, model, c) for c in cameras.values()]

    found = analyse_face(tracks, rig=Rig(cameras), neutral=0.1, model=model)

    spread = [np.linalg.norm(p - p.mean(axis=0)) for p in (found.face.landmarks, acted.rest)]
    assert spread[0] == pytest.approx(spread[1], rel=0.02)


@pytest.mark.slow
def test_a_face_that_is_moved_and_turned_as_a_whole_does_the_same(model: LandmarkModel) -> None:
    acted = act(model, seed=4, n_frames=30)
    there = Rigid.from_rotation(Rotation.from_rotvec([0, 0, 0.3]).as_matrix(), (15, 10, -40))
    moved = replace(acted, world_from_head=[there @ p for p in acted.world_from_head])

    a, b = (
        analyse_face(seen_by(x, model, camera()), camera=camera(), neutral=0.1, model=model)
        for x in (acted, moved)
    )

    scale = np.abs(a.faps.values[:, :30]).max()
    lips = [i for i, n in enumerate(a.faps.channels) if "lip" in n]
    assert np.abs(a.faps.values[:, lips] - b.faps.values[:, lips]).max() < 0.12 * scale


def test_points_under_a_hand_do_not_count(model: LandmarkModel, acted: Acted) -> None:
    clear = seen_by(acted, model, camera())
    px = np.array(clear.points_px)
    cheek = model.numbers[acted.rest[:, 0] > np.percentile(acted.rest[:, 0], 93)]
    px[20:35, cheek] += (0, 60)

    found = analyse_face(replace(clear, points_px=px), camera=camera(), neutral=0.1, model=model)

    assert rotation_errors_deg(found.head_motion.rotation, acted).max() < 3.0


def test_frames_without_a_face_are_left_unset(model: LandmarkModel, acted: Acted) -> None:
    clear = seen_by(acted, model, camera())
    px, sd = np.array(clear.points_px), np.array(clear.sd_px)
    source, presence = np.array(clear.source), np.array(clear.presence)
    gone = slice(25, 29)
    px[gone], sd[gone], source[gone], presence[gone] = np.nan, np.nan, 0, np.nan
    tracks = LandmarkTracks(clear.time_s, px, sd, presence, source, SIZE)

    found = analyse_face(tracks, camera=camera(), neutral=0.1, model=model)

    assert np.isnan(found.faps["open_jaw"][gone]).all()
    assert np.isnan(found.weights.values[gone]).all()
    assert np.isfinite(found.faps["open_jaw"][29:]).all()


def test_an_unknown_focal_length_is_estimated_within_what_is_stated(
    model: LandmarkModel, acted: Acted
) -> None:
    found = analyse_face(seen_by(acted, model, camera()), neutral=0.1, model=model)

    assert found.face.focal_sd_px > 0
    assert abs(np.log(found.focal_px / 1500)) < 3 * found.face.focal_sd_px / found.focal_px
    r = np.corrcoef(found.faps["open_jaw"], acted.faps["open_jaw"])[0, 1]
    assert r > 0.9


def test_nothing_is_carried_over_a_cut(model: LandmarkModel, acted: Acted) -> None:
    clear = seen_by(acted, model, camera())
    px = np.array(clear.points_px)
    px[25:] += (150, 40)

    found = analyse_face(
        replace(clear, points_px=px, cuts=(25,)), camera=camera(), neutral=0.1, model=model
    )

    whole = analyse_face(clear, camera=camera(), neutral=0.1, model=model)
    step = found.head_motion.translation[25, 0] - whole.head_motion.translation[25, 0]
    assert abs(step - 150 * 800 / 1500) < 15  # px times depth over focal length
    assert np.allclose(
        found.head_motion.translation[24], whole.head_motion.translation[24], atol=3.0
    )


def test_dead_channels_are_named_and_absent(seen_once: FacePerformance, acted: Acted) -> None:
    assert "tongue_roll" in seen_once.dead
    assert not set(DEAD) & set(seen_once.faps.channels)


def test_weights_keep_their_bounds(seen_once: FacePerformance, acted: Acted) -> None:
    assert seen_once.weights.values.min() >= 0
    assert seen_once.weights.values.max() <= 1


def test_tracks_and_cameras_that_do_not_fit_are_named(model: LandmarkModel, acted: Acted) -> None:
    tracks = seen_by(acted, model, camera())
    with pytest.raises(InputError, match="need a rig"):
        analyse_face([tracks, tracks], model=model)
    with pytest.raises(InputError, match="2 videos and 1 cameras"):
        analyse_face([tracks, tracks], rig=Rig({"a": camera()}), model=model)
    other = Camera((640, 480), camera().matrix)
    with pytest.raises(InputError, match="1280x720"):
        analyse_face(tracks, camera=other, model=model)


def test_no_face_is_an_error(model: LandmarkModel) -> None:
    nothing = np.full((5, 478, 2), np.nan)
    gone = np.full(5, np.nan)
    tracks = LandmarkTracks(
        np.arange(5) / 30, nothing, nothing[..., 0], gone, np.zeros(5, int), SIZE
    )
    known = FittedFace(np.zeros(5), 1.0, np.zeros((len(model.numbers), 3)), 1500.0, 0.0, 1)
    for neutral in (None, known):
        with pytest.raises(InputError, match="no frame shows a face"):
            analyse_face(tracks, neutral=neutral, model=model)


def test_a_personal_neutral_face_is_used_again(model: LandmarkModel, acted: Acted) -> None:
    tracks = seen_by(acted, model, camera())
    first = analyse_face(tracks, camera=camera(), neutral=0.1, model=model)

    again = analyse_face(tracks, camera=camera(), neutral=first.face, model=model)

    scale = np.abs(first.faps["open_jaw"]).max()
    assert np.abs(again.faps["open_jaw"] - first.faps["open_jaw"]).max() < 0.15 * scale
    assert not len(again.neutral_frames)


@pytest.mark.slow
def test_units_of_the_fitted_head_are_near_the_persons(model: LandmarkModel, acted: Acted) -> None:
    cameras = {"a": camera(-20.0), "b": camera(25.0)}
    tracks = [seen_by(acted, model, c) for c in cameras.values()]
    found = analyse_face(tracks, rig=Rig(cameras), neutral=0.1, model=model)
    head = make_head(random_identity(np.random.default_rng(0)), texture_px=256)

    true = Fapu.from_points(head.points).as_dict()
    for name in ("ES", "ENS", "MW"):
        assert found.face.fapu.as_dict()[name] == pytest.approx(true[name], rel=0.06), name


def test_what_each_camera_sees_wrong_of_a_face_at_rest_does_not_count(
    model: LandmarkModel, acted: Acted
) -> None:
    cameras = (camera(-20.0), camera(25.0))
    rng = np.random.default_rng(5)
    clear = tuple(seen_by(acted, model, c) for c in cameras)
    lean = [rng.normal(0, 4.0, (1, 478, 2)) for _ in clear]
    leaning = tuple(
        replace(t, points_px=t.points_px + off) for t, off in zip(clear, lean, strict=True)
    )
    solver = FaceSolver(model, acted.rest)
    frames, seen = views_of(model, clear, cameras), views_of(model, leaning, cameras)
    start = start_state(model, frames[0][0])
    true = solver.solve(frames[30], start)

    at_rest = {0: solver.solve(frames[0], start)}
    own = solver.solve(with_own_offsets(solver, seen, at_rest)[30], start)

    without = solver.solve(seen[30], start)
    errors = [np.linalg.norm(x.expression - true.expression) for x in (own, without)]
    assert errors[0] < 0.15 * errors[1]
    turn = Rotation.from_matrix(own.rotation @ true.rotation.T).magnitude()
    assert np.rad2deg(turn) < 0.1


def test_measured_irises_tell_the_gaze(model: LandmarkModel, acted: Acted) -> None:
    clear = seen_by(acted, model, camera())
    found = analyse_face(clear, camera=camera(), neutral=0.1, model=model)
    yaw = 0.25 * np.sin(np.linspace(0, 5, 45)) * (np.arange(45) > 9)
    irises = np.zeros((45, 2, 2))
    for t, pose in enumerate(acted.world_from_head):
        for i, eye in enumerate(found.face.eyes):
            at = eye.centre + 0.9 * eye.radius * np.array([np.sin(yaw[t]), 0.0, 1.0])
            irises[t, i] = camera().project(pose.apply(at))

    looks = analyse_face(
        replace(clear, iris_px=irises), camera=camera(), neutral=0.1, model=model
    ).faps

    for side in "lr":
        r = np.corrcoef(looks[f"yaw_{side}_eyeball"], yaw)[0, 1]
        assert r > 0.97
        assert np.ptp(looks[f"yaw_{side}_eyeball"]) * 1e-5 == pytest.approx(np.ptp(yaw), rel=0.2)
