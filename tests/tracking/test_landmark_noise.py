"""The landmarks' measurement model: laws, the file, and a face that it was not learnt from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.mpeg4 import displacement_faps
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.heads.expressions import expression_weights
from facewright.heads.face_finder import FaceFinder, FaceTracker
from facewright.heads.identity import make_head, random_identity
from facewright.heads.render import HeadRenderer
from facewright.tracking.face_analysis import analyse_face
from facewright.tracking.landmark_noise import (
    landmark_model,
    read_landmark_model,
    upright,
    view_terms,
    write_landmark_model,
)
from facewright.tracking.landmark_tracks import LandmarkTracks


def test_upright_puts_the_heads_x_axis_along_the_rows() -> None:
    R = Rotation.random(20, rng=np.random.default_rng(0)).as_matrix()

    turned = np.einsum("tab,tb->ta", upright(R), R[:, :2, 0])

    assert np.allclose(turned[:, 1], 0)
    assert (turned[:, 0] > 0).all()


def test_view_terms_do_not_depend_on_the_distance() -> None:
    v = np.array([[0.3, -0.2, 0.9]])

    assert np.allclose(view_terms(v), view_terms(700 * v))


def test_nothing_is_corrected_to_nothing() -> None:
    m = landmark_model()

    nothing = np.zeros((3, m.n_components))
    assert np.array_equal(m.corrected(nothing, np.zeros((3, len(m.numbers), 2))), nothing)


def test_a_model_is_read_back(tmp_path: Path) -> None:
    m = landmark_model()
    write_landmark_model(tmp_path / "m.npz", m)

    found = read_landmark_model(tmp_path / "m.npz")

    assert found.point_names == m.point_names
    assert np.array_equal(found.numbers, m.numbers)
    assert np.allclose(found.gain, m.gain, atol=1e-3)
    assert found.pose_doubt == pytest.approx(m.pose_doubt)


@pytest.mark.slow
def test_a_person_never_learnt_from_is_measured() -> None:
    """Neutral, then a smile, surprise and a wide mouth, drawn and found by the network."""
    try:
        finder = FaceFinder()
    except InputError as error:
        pytest.skip(str(error))
    head = make_head(random_identity(np.random.default_rng(8001)), texture_px=512)
    motion, renderer, tracker = FaceMotion(head), HeadRenderer(head, quick=True), None
    K = np.array([[1400.0, 0, 255.5], [0, 1400.0, 255.5], [0, 0, 1]])
    cam = Camera((512, 512), K, Rigid(np.array([0.0, 1, 0, 0]), np.array([0.0, -30.0, 900.0])))
    acts: list[dict[str, float]] = [{}] * 4 + [
        expression_weights(n) for n in ("joy", "surprise", "sadness")
    ]
    acts += [{"jawOpen": 0.6}, {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}]
    px, scores, true = [], [], []
    tracker = FaceTracker(finder)
    for act in acts:
        w = np.array([act.get(name, 0.0) for name in head.shape_names])
        vertices = motion.vertices(w)
        face = tracker.follow(renderer.render(vertices, cam, Rigid.identity()))
        assert face is not None
        px.append(face.landmarks_px[:, :2])
        scores.append(finder.scores(face))
        true.append(head.feature_points.at(vertices) - head.feature_points.at(head.mesh.vertices))
    n = len(acts)
    tracks = LandmarkTracks(
        np.arange(n) / 10, np.stack(px), np.full((n, 478), 0.2), np.full(n, 20.0),
        np.ones(n, int), (512, 512), np.stack(scores),
    )  # fmt: skip

    found = analyse_face(tracks, camera=cam, neutral=0.1)

    names = head.feature_points.names
    by_name = {p: np.stack(true)[:, i] for i, p in enumerate(names)}
    faps = displacement_faps(by_name, head.fapu)
    turn = found.head_motion.rotation @ found.head_motion.rotation[0].T
    assert np.rad2deg(Rotation.from_matrix(turn).magnitude()).max() < 4.0
    for name in ("open_jaw", "raise_b_midlip", "close_t_l_eyelid", "raise_l_m_eyebrow"):
        r = np.corrcoef(found.faps[name], faps[name])[0, 1]
        assert r > 0.9, f"{name}: correlation {r:.2f}"
    assert found.weights["jawOpen"][7] > 0.3
    assert found.weights["eyeBlinkLeft"][8] > 0.5
