from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.video import read_frames
from facewright.heads import face_network
from facewright.heads.face_detector import FaceDetector
from facewright.heads.face_finder import FaceFinder, FaceTracker, FoundFace
from facewright.heads.face_landmarks import NAMED_LANDMARKS, FaceLandmarker, FaceRegion, cut_out
from facewright.heads.face_network import FaceWeights, face_networks_path, read_face_weights
from facewright.heads.face_scores import SCORE_NAMES

Picture = NDArray[np.uint8]
#: The seven places that iBUG's 68 points (0-based) share with the landmarks.
SHARED_WITH_IBUG = {
    36: "eye_right_outer",
    39: "eye_right_inner",
    42: "eye_left_inner",
    45: "eye_left_outer",
    48: "mouth_right",
    54: "mouth_left",
    30: "nose_tip",
}


@pytest.fixture(scope="module")
def weights() -> FaceWeights:
    if face_networks_path() is None:
        pytest.skip(f"the face networks are not installed: {face_network.INSTALL_NETWORKS}")
    return read_face_weights()


@pytest.fixture(scope="module")
def finder(weights: FaceWeights) -> FaceFinder:
    return FaceFinder(weights)


@pytest.fixture(scope="module")
def portrait() -> Picture:
    """A woman who looks at the camera, 512x512; her face is 109 px high."""
    data = pytest.importorskip("skimage.data", reason="scikit-image has the portrait")
    return np.array(data.astronaut())


@pytest.fixture(scope="module")
def face(finder: FaceFinder, portrait: Picture) -> FoundFace:
    (found,) = finder.find(portrait)
    return found


def eye_distance(landmarks: NDArray[np.float64]) -> float:
    right = landmarks[NAMED_LANDMARKS["eye_right_outer"], :2]
    return float(np.linalg.norm(right - landmarks[NAMED_LANDMARKS["eye_left_outer"], :2]))


def error_percent(found: FoundFace, expected: NDArray[np.float64]) -> float:
    """Mean distance of the landmarks from (478, 2) expected ones, per cent of eye distance."""
    off = np.linalg.norm(found.landmarks_px[:, :2] - expected, axis=1)
    return float(100 * off.mean() / eye_distance(expected))


def on_canvas(picture: Picture, size: tuple[int, int], at: tuple[int, int]) -> Picture:
    canvas = np.full((size[1], size[0], 3), 90, np.uint8)
    canvas[at[1] : at[1] + picture.shape[0], at[0] : at[0] + picture.shape[1]] = picture
    return canvas


def shrunk(picture: Picture, scale: float) -> Picture:
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def marked_points(path: Path) -> NDArray[np.float64]:
    """(68, 2) px of a .pts file, which counts pixels from 1."""
    lines = path.read_text(encoding="utf-8").split("{")[1].split("}")[0].split("\n")
    return np.array([[float(x) for x in line.split()] for line in lines if line.strip()]) - 1


def test_portrait_has_one_face_where_it_is(face: FoundFace) -> None:
    eyes = face.landmarks_px[[NAMED_LANDMARKS["iris_right"], NAMED_LANDMARKS["iris_left"]], :2]

    # pupils as marked by eye on the picture at twelve times its size
    assert np.abs(eyes - [[202.8, 100.2], [246.3, 102.4]]).max() < 1.5
    assert face.presence > 13 and face.score > 0.8
    nose, right, left = (
        face.landmarks_px[NAMED_LANDMARKS[name]]
        for name in ("nose_tip", "eye_right_outer", "eye_left_outer")
    )
    assert nose[2] < min(right[2], left[2]), "the nose is nearer to the camera than the eyes"


@pytest.mark.parametrize("name", ["breakingbad", "einstein"])
def test_landmarks_lie_at_hand_marked_points(
    finder: FaceFinder, real_data: Path, name: str
) -> None:
    picture = cv2.cvtColor(cv2.imread(str(real_data / "faces" / f"{name}.jpg")), cv2.COLOR_BGR2RGB)
    truth = marked_points(real_data / "faces" / f"{name}.pts")
    middle = truth.mean(axis=0)

    found = [
        f for f in finder.find(picture) if (f.box[:2] < middle).all() and (middle < f.box[2:]).all()
    ]

    assert len(found) == 1
    at = found[0].landmarks_px[[NAMED_LANDMARKS[n] for n in SHARED_WITH_IBUG.values()], :2]
    marked = truth[list(SHARED_WITH_IBUG)]
    off = np.linalg.norm(at - marked, axis=1) / np.linalg.norm(truth[36] - truth[45])
    # the tip of the nose is not the same place in both (9 %); two people differ by about 3 %
    assert off.mean() < 0.06, np.round(off, 3)
    assert off[:4].mean() < 0.035, np.round(off, 3)


def test_face_fills_most_frames_of_a_webcam_clip(weights: FaceWeights, real_data: Path) -> None:
    tracker = FaceTracker(FaceFinder(weights))
    steps, found, scores, last = [], 0, [], None
    for frame in islice(read_frames(real_data / "faces" / "webcam_clip.mp4"), 100):
        face = tracker.follow(frame.image)
        if face is None:
            last = None
            continue
        found += 1
        scores.append(face.score)
        if last is not None:
            off = np.linalg.norm(face.landmarks_px[:, :2] - last, axis=1)
            steps.append(off.mean() / eye_distance(last))
        last = face.landmarks_px[:, :2]

    assert found == 100
    assert np.isfinite(scores[0]) and np.isnan(scores[1:]).all(), "detected once, then followed"
    assert np.median(steps) < 0.03, "a person in a chair moves by little from frame to frame"


@pytest.mark.parametrize(("side", "blob_px"), [(128.0, 5.0), (300.0, 8.0), (1280.0, 40.0)])
def test_square_shows_a_place_where_its_map_says(side: float, blob_px: float) -> None:
    y, x = np.mgrid[0:1500, 0:1800]
    centre = np.array([853.3, 706.8])
    spread = -((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * blob_px**2)
    blob = np.rint(255 * np.exp(spread)).astype(np.uint8)
    region = FaceRegion(centre + (0.11 * side, -0.07 * side), side, 0.4)

    square = cut_out(np.dstack([blob] * 3), region)[..., 0].astype(float)

    rows, columns = np.mgrid[0:256, 0:256] + 0.5  # centres of pixels, from the edge
    found = [(square * columns).sum() / square.sum(), (square * rows).sum() / square.sum()]
    M = region.picture_from_square
    expected = np.linalg.solve(M[:, :2], centre - M[:, 2])
    assert np.abs(found - expected).max() < 0.02


def test_large_face_is_shrunk_without_aliases() -> None:
    y, x = np.mgrid[0:1200, 0:1500]
    checkers = np.dstack([255 * ((x + y) % 2)] * 3).astype(np.uint8)

    square = cut_out(checkers, FaceRegion(np.array([750.0, 600.0]), 1000.0, -0.3))

    assert np.ptp(square) < 20, "a checkerboard of single pixels becomes grey"


def test_mirrored_picture_has_mirrored_landmarks(
    finder: FaceFinder, weights: FaceWeights, portrait: Picture, real_data: Path
) -> None:
    lines = (real_data / "heads" / "canonical_face_model.obj").read_text().splitlines()
    mask = np.array([[float(v) for v in s.split()[1:4]] for s in lines if s.startswith("v ")])
    far = np.linalg.norm(mask[:, None] - mask * (-1, 1, 1), axis=2)
    opposite = far.argmin(axis=1)
    landmarker = FaceLandmarker(weights)
    pictures = [portrait]
    frames = read_frames(real_data / "faces" / "webcam_clip.mp4")
    pictures += [np.array(frame.image) for frame in islice(frames, 0, None, 100)]

    bias = []
    for picture in pictures:
        region = finder.find(picture)[0].region
        last = picture.shape[1] - 1
        centre = np.array([last - region.centre[0], region.centre[1]])
        seen, _ = landmarker.landmarks(picture, region)
        other, _ = landmarker.landmarks(
            np.ascontiguousarray(picture[:, ::-1]),
            FaceRegion(centre, region.side, -region.angle_rad),
        )
        mirrored = np.column_stack([last - other[:468, 0], other[:468, 1]])[opposite]
        # each lies off by the bias, to opposite sides
        bias.append((seen[:468, :2] - mirrored).mean(axis=0)[0] / 2)

    assert len(bias) > 10
    assert abs(np.mean(bias)) < 0.2, f"landmarks lie {np.mean(bias):.2f} px too far right"


@pytest.mark.parametrize("angle_deg", [-165, -120, -90, -45, -20, 20, 60, 105, 135, 180])
def test_landmarks_turn_with_the_picture(
    finder: FaceFinder, portrait: Picture, face: FoundFace, angle_deg: float
) -> None:
    M = cv2.getRotationMatrix2D((225, 125), angle_deg, 1.0)
    turned = cv2.warpAffine(portrait, M, (512, 512), borderMode=cv2.BORDER_REPLICATE)

    found = finder.find(turned)

    best = max(found, key=lambda f: f.presence)
    expected = face.landmarks_px[:, :2] @ M[:, :2].T + M[:, 2]
    assert error_percent(best, expected) < 2.5


@pytest.mark.parametrize(("scale", "allowed"), [(0.5, 2.0), (0.8, 1.0), (1.7, 1.0), (4.0, 1.0)])
def test_landmarks_grow_with_the_picture(
    finder: FaceFinder, portrait: Picture, face: FoundFace, scale: float, allowed: float
) -> None:
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    scaled = cv2.resize(portrait, None, fx=scale, fy=scale, interpolation=how)

    (found,) = finder.find(scaled)

    factor = np.array(scaled.shape[1::-1]) / portrait.shape[1::-1]
    assert error_percent(found, (face.landmarks_px[:, :2] + 0.5) * factor - 0.5) < allowed


@pytest.mark.parametrize("has_full_range", [True, False])
def test_small_face_is_found(
    weights: FaceWeights, portrait: Picture, face: FoundFace, has_full_range: bool
) -> None:
    if has_full_range and weights.full_range is None:
        pytest.skip(f"not installed: {face_network.INSTALL_SMALL_FACES}")
    known = weights if has_full_range else replace(weights, full_range=None)
    finder = FaceFinder(known)
    small = shrunk(portrait, 0.06 * 1280 / face.size_px)  # a twentieth of the picture, and a bit

    for at in ((30, 20), (600, 200), (850, 330)):
        found = finder.find(on_canvas(small, (1280, 720), at))

        assert len(found) == 1
        middle = (found[0].box[:2] + found[0].box[2:]) / 2
        expected = (face.box[:2] + face.box[2:]) / 2 * (small.shape[0] / 512) + at
        assert np.linalg.norm(middle - expected) < 4


def test_smallest_bounds_the_search(
    weights: FaceWeights, portrait: Picture, face: FoundFace
) -> None:
    small = shrunk(portrait, 0.05 * 1280 / face.size_px)
    picture = on_canvas(small, (1280, 720), (600, 200))
    detector = FaceDetector(weights)

    assert detector.detect(picture, smallest=0.04)
    assert not detector.detect(picture, smallest=0.3)


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_turned_search_sees_a_turned_picture_as_it_sees_the_upright_one(
    weights: FaceWeights, portrait: Picture, quarter_turns: int
) -> None:
    upright = np.ascontiguousarray(portrait[:400])  # not square
    detector = FaceDetector(weights)
    (expected,) = detector.detect(upright, smallest=0.2)

    turned = np.ascontiguousarray(np.rot90(upright, -quarter_turns))
    (found,) = detector.detect(turned, smallest=0.2, quarter_turns=quarter_turns)

    at = found.points
    height, width = turned.shape[:2]
    for _ in range(quarter_turns):  # to the left: what was right is now on top
        at = np.column_stack([at[:, 1], width - 1 - at[:, 0]])
        height, width = width, height
    assert np.allclose(at, expected.points, atol=1e-6)
    assert (found.box[:2] < found.points.min(axis=0)).all()


def test_each_of_several_faces_is_found_once_largest_first(
    finder: FaceFinder, portrait: Picture, face: FoundFace
) -> None:
    picture = on_canvas(portrait, (1400, 600), (20, 40))
    half, third = shrunk(portrait, 0.5), shrunk(np.ascontiguousarray(portrait[:, ::-1]), 0.75)
    picture[100 : 100 + half.shape[0], 600 : 600 + half.shape[1]] = half
    picture[150 : 150 + third.shape[0], 950 : 950 + third.shape[1]] = third

    found = finder.find(picture)

    sizes = [f.size_px / face.size_px for f in found]
    assert np.allclose(sizes, [1, 0.75, 0.5], rtol=0.08)


@pytest.mark.parametrize("seed", range(12))
def test_noise_has_no_face(finder: FaceFinder, seed: int) -> None:
    rng = np.random.default_rng(seed)
    fine = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    soft = cv2.GaussianBlur(rng.normal(size=(360, 480, 3)), (0, 0), rng.uniform(1.5, 12))
    cloudy = (255 * (soft - soft.min()) / np.ptp(soft)).astype(np.uint8)

    assert finder.find(fine) == ()
    assert finder.find(cloudy) == ()


@pytest.mark.parametrize("level", [0, 128, 255])
def test_blank_picture_has_no_face(finder: FaceFinder, level: int) -> None:
    assert finder.find(np.full((240, 320, 3), level, np.uint8)) == ()


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (20, 20), (1, 500), (500, 3)])
def test_tiny_pictures_have_no_face(finder: FaceFinder, shape: tuple[int, int]) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (*shape, 3), dtype=np.uint8)

    assert finder.find(noise) == ()


def test_gray_picture_is_refused(finder: FaceFinder, portrait: Picture) -> None:
    with pytest.raises(ValueError, match=r"image must be \(height, width, 3\) uint8 RGB"):
        finder.find(portrait[..., 0])


def test_followed_face_is_the_one_found_anew(
    finder: FaceFinder, portrait: Picture, face: FoundFace
) -> None:
    moved = np.roll(portrait, (4, -6), axis=(0, 1))

    followed = finder.follow(moved, face.region)

    assert followed is not None
    assert error_percent(followed, face.landmarks_px[:, :2] + (-6, 4)) < 1.0


def test_tracker_loses_what_is_gone_and_finds_it_again(
    finder: FaceFinder, portrait: Picture
) -> None:
    tracker = FaceTracker(finder)
    blank = np.full_like(portrait, 100)
    elsewhere = np.roll(portrait, 180, axis=1)

    seen = [tracker.follow(p) for p in (portrait, blank, elsewhere, elsewhere, portrait)]

    assert [f is not None for f in seen] == [True, False, True, True, True]
    assert [bool(f and np.isfinite(f.score)) for f in seen] == [True, False, True, False, True]
    assert seen[0] is not None and seen[4] is not None
    assert error_percent(seen[4], seen[0].landmarks_px[:, :2]) < 1e-6


def test_finding_twice_gives_the_same(
    finder: FaceFinder, portrait: Picture, face: FoundFace
) -> None:
    again = finder.find(portrait)[0]

    assert np.array_equal(again.landmarks_px, face.landmarks_px)


def test_picture_is_not_changed(finder: FaceFinder, portrait: Picture) -> None:
    locked = portrait.copy()
    locked.flags.writeable = False

    finder.find(locked)

    assert np.array_equal(locked, portrait)


def test_smile_of_a_portrait_is_scored(finder: FaceFinder, face: FoundFace) -> None:
    scores = dict(zip(SCORE_NAMES, finder.scores(face), strict=True))

    assert scores["mouthSmileLeft"] > 0.4 and scores["mouthSmileRight"] > 0.4
    assert scores["jawOpen"] < 0.2 and scores["mouthFrownLeft"] < 0.2
