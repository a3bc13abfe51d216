from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.video import Frame
from facewright.heads.face_landmarks import N_LANDMARKS
from facewright.tracking.face_measuring import FacePiece, measure_pieces
from facewright.tracking.face_rectify import (
    SIDE_PX,
    RectifiedFrame,
    canonical_places,
    even_picture,
    rectify,
)
from facewright.tracking.face_sightings import FaceSightings
from facewright.tracking.flow_tracks import flow_sd, follow_points, shared_motion, skin_kernel
from facewright.tracking.templates import FaceTemplate, template_sd

Floats = NDArray[np.float64]


def texture(rng: np.random.Generator, size: int) -> NDArray[np.uint8]:
    """Smooth random blotches, 4 px wide."""
    noise = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), 4.0)
    return np.asarray(np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8))


def turned(angle: float, scale: float, shift: tuple[float, float]) -> Floats:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return np.array([[c, -s, shift[0]], [s, c, shift[1]]])


def face_points(rng: np.random.Generator) -> Floats:
    """478 points spread like a face's, the outer corners of the eyes level, in 200 px."""
    points = rng.uniform(60, 260, (N_LANDMARKS, 2))
    points[33], points[263] = (100, 140), (220, 140)
    return points


def test_rectifying_takes_a_similarity_away() -> None:
    rng = np.random.default_rng(1)
    points = face_points(rng)
    places = canonical_places(points)
    M = turned(0.4, 1.7, (30, -12))

    frame = rectify(points @ M[:, :2].T + M[:, 2], places)

    moved = points @ M[:, :2].T + M[:, 2]
    np.testing.assert_allclose(frame.inwards(moved), places, atol=1e-9)
    np.testing.assert_allclose(frame.outwards(places), moved, atol=1e-9)
    assert frame.unit_px == pytest.approx(1.7 * rectify(points, places).unit_px)
    assert places.min() > 0 and places.max() < SIDE_PX


@pytest.mark.parametrize("unit_px", [0.8, 1.0, 3.7])
def test_a_spot_lies_where_its_place_says(unit_px: float) -> None:
    side = int(SIDE_PX * unit_px) + 40
    y, x = np.mgrid[:side, :side]
    centre = np.array([0.55, 0.48]) * side
    spread = 2 * (2.0 * unit_px) ** 2
    spot = 60 + 150 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / spread)
    shift = -20.0 / unit_px
    frame = RectifiedFrame(np.array([[1 / unit_px, 0, shift], [0, 1 / unit_px, shift]]))

    picture = even_picture(spot.astype(np.uint8), frame).astype(float)

    place = frame.inwards(centre)
    near = picture[int(place[1]) - 4 : int(place[1]) + 6, int(place[0]) - 4 : int(place[0]) + 6]
    weight = np.maximum(near - 128, 0)
    yy, xx = np.mgrid[int(place[1]) - 4 : int(place[1]) + 6, int(place[0]) - 4 : int(place[0]) + 6]
    found = np.array([(weight * xx).sum(), (weight * yy).sum()]) / weight.sum()
    np.testing.assert_allclose(found, place, atol=0.1)


def test_even_pictures_do_not_see_light_and_contrast() -> None:
    gray = texture(np.random.default_rng(2), SIDE_PX)
    frame = RectifiedFrame(np.eye(2, 3))
    dim = (40 + 0.4 * gray).astype(np.uint8)

    apart = even_picture(gray, frame).astype(float) - even_picture(dim, frame)

    assert np.abs(apart[20:-20, 20:-20]).mean() < 4.0


def test_flow_finds_a_shift_and_says_where_it_cannot() -> None:
    rng = np.random.default_rng(3)
    before = texture(rng, 200)
    shift = np.array([1.37, -0.62])
    after = np.asarray(cv2.warpAffine(before, np.column_stack([np.eye(2), shift]), (200, 200)))
    after[120:] = rng.integers(0, 255, (80, 200))  # what was there is gone
    points = rng.uniform(30, 100, (60, 2))
    gone = np.column_stack([rng.uniform(30, 170, 20), rng.uniform(140, 180, 20)])

    found = follow_points(before, after, points, points)
    lost = follow_points(before, after, gone, gone)

    off = found.places - points - shift
    assert np.sqrt((off**2).mean()) < 0.06
    assert (flow_sd(found) < 0.3).all()
    assert np.median(flow_sd(lost)) > 2.0
    template = FaceTemplate(before, points)
    assert np.nanmax(template_sd(template.register(after, points))) < 1.0
    assert np.isnan(FaceTemplate(before, gone).register(after, gone).places).all()


def test_neighbours_tell_how_smooth_skin_moves_and_lips_go_their_own_way() -> None:
    places = np.array([[x, y] for x in range(0, 40, 5) for y in range(0, 40, 5)], float)
    is_skin = places[:, 0] < 30
    moves = np.tile([[2.0, -1.0]], (len(places), 1))
    moves[~is_skin] = -5.0
    sd = np.full(len(places), 0.1)
    sd[20] = np.inf  # no texture there
    moves[20] = np.nan

    shared, left = shared_motion(moves, sd, skin_kernel(places, is_skin))

    np.testing.assert_allclose(shared[is_skin], np.tile([[2.0, -1.0]], (is_skin.sum(), 1)))
    np.testing.assert_allclose(shared[~is_skin], -5.0)
    assert np.isfinite(left[20]) and (left <= sd).all()


def test_steps_and_patches_of_a_moving_face_are_measured() -> None:
    rng = np.random.default_rng(4)
    points, picture = face_points(rng), texture(rng, 320)
    T = 6
    ways = [turned(0.02 * t, 1 + 0.01 * t, (1.5 * t, -0.8 * t)) for t in range(T)]
    truth = np.array([points @ M[:, :2].T + M[:, 2] for M in ways])
    network = truth + rng.normal(scale=0.3, size=truth.shape)
    frames = [
        Frame(t, t / 30, np.asarray(cv2.warpAffine(picture, M, (320, 320), borderMode=2)))
        for t, M in enumerate(ways)
    ]
    seen = FaceSightings(
        np.arange(T) / 30, network.astype(np.float32), np.full(T, 20.0), (320, 320), (), 1
    )
    piece = FacePiece.of(seen, slice(0, T))

    measure_pieces(iter(frames), [piece])

    step = piece.measured.step[1:] - np.diff(truth, axis=0)
    # a point lies by jitter beside the skin it is measured on: turned by that, not moved
    assert np.sqrt((step**2).mean()) < 0.15
    off = piece.measured.template - truth
    off -= off[piece.reference]
    assert np.isfinite(off).mean() > 0.9
    assert np.nanmedian(np.abs(off)) < 0.1
