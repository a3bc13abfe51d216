"""Centres of dots, against discs whose centres are known and against other programs."""

from __future__ import annotations

import numpy as np
import pytest
import trackpy
from numpy.typing import NDArray
from scipy import ndimage

from facewright.core.errors import InputError
from facewright.tracking.blobs import BlobSettings, find_blobs, find_level

SKIN, CONTRAST = 45.0, 160.0
LEVEL = BlobSettings(110.0)
Image = NDArray[np.uint8]
Floats = NDArray[np.float64]


def coverage(shape: tuple[int, int], centre: Floats, a: float, b: float, turn: float) -> Floats:
    """Share of each pixel of an (h, w) picture that an ellipse of half-axes a, b covers."""
    n = 16
    s = (np.arange(n) + 0.5) / n - 0.5
    found = np.zeros(shape)
    reach = int(np.ceil(max(a, b))) + 2
    x0, y0 = np.rint(centre).astype(int) - reach
    y, x = np.mgrid[y0 : y0 + 2 * reach + 1, x0 : x0 + 2 * reach + 1]
    dx = x[..., None, None] + s[:, None] - centre[0]
    dy = y[..., None, None] + s - centre[1]
    u = (dx * np.cos(turn) + dy * np.sin(turn)) / a
    v = (dy * np.cos(turn) - dx * np.sin(turn)) / b
    inside = (u * u + v * v < 1).mean(axis=(2, 3))
    seen = (y >= 0) & (y < shape[0]) & (x >= 0) & (x < shape[1])
    found[y[seen], x[seen]] = inside[seen]
    return found


def grey(level: Floats) -> Image:
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def field_of_dots(
    rng: np.random.Generator, a: float, b: float, *, noise: float, n: int = 10
) -> tuple[Image, Floats]:
    """n × n dots 24 px apart at random sub-pixel places; the picture and the (n², 2) centres."""
    size = 24 * (n + 1)
    at = 24.0 * np.stack(np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1)), axis=-1)
    centres = at.reshape(-1, 2) + rng.uniform(-0.5, 0.5, size=(n * n, 2))
    level = np.full((size, size), SKIN)
    for centre in centres:
        level += CONTRAST * coverage(level.shape, centre, a, b, float(rng.uniform(0, np.pi)))
    return grey(level + rng.normal(0, noise, size=level.shape) if noise else level), centres


def nearest(found: Floats, true: Floats) -> Floats:
    """For each true centre the nearest found one less the true one."""
    d = np.linalg.norm(found[None] - true[:, None], axis=2)
    return np.asarray(found[d.argmin(axis=1)] - true)


@pytest.mark.parametrize(("a", "b"), [(2.0, 2.0), (3.5, 3.5), (5.0, 2.5)])
def test_centres_are_unbiased_and_as_good_as_trackpys(a: float, b: float) -> None:
    image, true = field_of_dots(np.random.default_rng(5), a, b, noise=1.0)

    blobs = find_blobs(image, LEVEL)

    assert len(blobs) == len(true)
    error = nearest(blobs.centres, true)
    rms = np.sqrt((error**2).mean())
    peer = trackpy.locate(image, 2 * int(np.ceil(a)) + 5, minmass=100, topn=len(true))
    peer_rms = np.sqrt((nearest(peer[["x", "y"]].to_numpy(), true) ** 2).mean())
    assert np.abs(error.mean(axis=0)).max() < 0.003  # 4 standard errors of the mean
    assert rms < 0.012  # 0.005 to 0.009 over seeds; the grey levels' rounding alone makes 0.003
    assert rms < 1.5 * peer_rms


@pytest.mark.parametrize(("a", "b"), [(2.0, 2.0), (3.5, 3.5), (5.0, 2.5)])
def test_on_a_flat_background_the_centre_is_scipys_centre_of_mass(a: float, b: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        centre = 20 + rng.uniform(-0.5, 0.5, size=2)
        image = grey(SKIN + CONTRAST * coverage((41, 41), centre, a, b, float(rng.uniform(0, 3))))

        (found,) = find_blobs(image, LEVEL).centres

        y, x = ndimage.center_of_mass(image.astype(np.float64) - SKIN)
        np.testing.assert_allclose(found, (x, y), atol=1e-9)


def test_small_dots_are_known_to_be_less_certain() -> None:
    error, sd = [], []
    for radius in (2.0, 5.0):
        image, true = field_of_dots(np.random.default_rng(8), radius, radius, noise=1.0)
        blobs = find_blobs(image, LEVEL)
        error.append(np.sqrt((nearest(blobs.centres, true) ** 2).mean()))
        sd.append(np.median(blobs.sd_px))

    assert error[0] > 1.5 * error[1]
    assert sd[0] > 1.5 * sd[1]


@pytest.mark.parametrize("slope", [(1.5, 0.0), (0.0, -1.5), (1.0, 1.0)])
def test_a_slope_of_the_skins_shading_does_not_pull_the_centre(slope: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:41, :41] - 20.0
    ramp = SKIN + slope[0] * x + slope[1] * y
    errors = []
    for _ in range(20):
        centre = 20 + rng.uniform(-0.5, 0.5, size=2)
        image = grey(ramp + CONTRAST * coverage(x.shape, centre, 3.5, 3.5, 0.0))
        errors.append(find_blobs(image, LEVEL).centres[0] - centre)

    assert np.abs(np.mean(errors, axis=0)).max() < 0.01


@pytest.mark.parametrize("gap_px", [1.5, 3.0, 4.0])
def test_a_neighbour_close_by_does_not_pull_the_centre(gap_px: float) -> None:
    rng = np.random.default_rng(6)
    errors = []
    for _ in range(20):
        centre = np.array([30.0, 30.0]) + rng.uniform(-0.5, 0.5, size=2)
        way = float(rng.uniform(0, 2 * np.pi))
        other = centre + (7.0 + gap_px) * np.array([np.cos(way), np.sin(way)])
        level = np.full((61, 61), SKIN)
        for p in (centre, other):
            level += CONTRAST * coverage((61, 61), p, 3.5, 3.5, 0.0)
        blobs = find_blobs(grey(level), LEVEL)
        assert len(blobs) == 2
        errors.append(nearest(blobs.centres, np.stack([centre, other])))

    assert np.abs(errors).max() < 0.03
    assert np.sqrt(np.square(errors).mean()) < 0.01


def test_moving_or_mirroring_the_picture_moves_or_mirrors_the_centres() -> None:
    image, _ = field_of_dots(np.random.default_rng(3), 3.0, 2.5, noise=2.0, n=5)
    base = find_blobs(image, LEVEL).centres
    order = np.lexsort(base.T)

    padded = np.pad(image, ((7, 0), (11, 0)), mode="edge")
    moved = find_blobs(padded, LEVEL).centres
    mirrored = find_blobs(np.ascontiguousarray(image[:, ::-1]), LEVEL).centres
    turned = find_blobs(np.ascontiguousarray(image.T), LEVEL).centres

    np.testing.assert_allclose(moved[np.lexsort(moved.T)] - (11, 7), base[order], atol=1e-9)
    back = mirrored * (-1, 1) + (image.shape[1] - 1, 0)
    np.testing.assert_allclose(back[np.lexsort(back.T)], base[order], atol=1e-9)
    back = turned[:, ::-1]
    np.testing.assert_allclose(back[np.lexsort(back.T)], base[order], atol=1e-9)


def test_a_view_into_the_decoders_memory_gives_the_same() -> None:
    image, _ = field_of_dots(np.random.default_rng(3), 3.0, 3.0, noise=1.0, n=4)
    wide = np.zeros((image.shape[0], image.shape[1] + 24), np.uint8)
    wide[:, : image.shape[1]] = image
    view = wide[:, : image.shape[1]]
    view.flags.writeable = False

    np.testing.assert_array_equal(find_blobs(view, LEVEL).centres, find_blobs(image, LEVEL).centres)


@pytest.mark.parametrize("at", [(2.0, 40.0), (40.0, 3.0), (77.5, 40.0), (40.0, 79.0)])
def test_a_dot_at_the_border_is_dropped(at: tuple[float, float]) -> None:
    level = SKIN + CONTRAST * coverage((80, 80), np.array([30.0, 30.0]), 3.5, 3.5, 0.0)
    level += CONTRAST * coverage((80, 80), np.array(at), 3.5, 3.5, 0.0)

    blobs = find_blobs(grey(level), LEVEL)

    np.testing.assert_allclose(blobs.centres, [(30.0, 30.0)], atol=0.01)


@pytest.mark.parametrize("hidden", [0.2, 0.4, 0.6])
def test_a_partly_hidden_dot_is_known_to_be_uncertain(hidden: float) -> None:
    rng = np.random.default_rng(1)
    radius = 4.0
    # the chord that cuts this share off the disc
    offsets = np.linspace(-1, 1, 4001)
    cut_share = (np.arccos(offsets) - offsets * np.sqrt(1 - offsets**2)) / np.pi
    chord = radius * float(np.interp(-hidden, -cut_share, offsets))
    off, sd, whole_sd = [], [], []
    for _ in range(20):
        centre = 20 + rng.uniform(-0.5, 0.5, size=2)
        way = float(rng.uniform(0, 2 * np.pi))
        y, x = np.mgrid[:41, :41]
        along = (x - centre[0]) * np.cos(way) + (y - centre[1]) * np.sin(way)
        cover = coverage((41, 41), centre, radius, radius, 0.0)
        seen = cover * np.clip(chord - along + 0.5, 0, 1)
        blobs = find_blobs(grey(SKIN + CONTRAST * seen), LEVEL)
        off.append(float(np.linalg.norm(blobs.centres[0] - centre)))
        sd.append(float(blobs.sd_px[0]))
        whole_sd.append(float(find_blobs(grey(SKIN + CONTRAST * cover), LEVEL).sd_px[0]))

    assert np.min(off) > 0.3  # it is off indeed
    assert np.min(sd) > 1.4 * np.max(whole_sd)
    assert np.median(sd) > 2 * np.median(whole_sd)


def test_a_whole_dot_is_not_skew_at_any_slant() -> None:
    for slant in (1.0, 0.7, 0.4):
        image, _ = field_of_dots(np.random.default_rng(1), 4.0, 4.0 * slant, noise=1.0, n=5)
        assert np.median(find_blobs(image, LEVEL).skewness) < 0.1


def test_areas_and_contrast_are_the_dots() -> None:
    image, true = field_of_dots(np.random.default_rng(2), 4.0, 4.0, noise=0.0, n=5)

    blobs = find_blobs(image, BlobSettings(SKIN + CONTRAST / 2))

    np.testing.assert_allclose(blobs.areas_px, np.pi * 16, atol=5)
    assert len(blobs) == len(true)
    area = dict(min_area_px=60, max_area_px=100)
    assert len(find_blobs(image, BlobSettings(SKIN + CONTRAST / 2, **area))) == 0
    area = dict(min_area_px=1, max_area_px=40)
    assert len(find_blobs(image, BlobSettings(SKIN + CONTRAST / 2, **area))) == 0


def test_the_level_found_parts_the_dots_from_the_skin() -> None:
    rng = np.random.default_rng(0)
    image, true = field_of_dots(rng, 3.5, 3.5, noise=2.0)
    room = np.full((720, 1280), 7, np.uint8)
    room[200 : 200 + image.shape[0], 300 : 300 + image.shape[1]] = image

    level = find_level(room)

    assert SKIN + 10 < level < SKIN + 0.7 * CONTRAST
    assert len(find_blobs(room, BlobSettings(level))) == len(true)


def test_saturated_dots_have_a_level() -> None:
    rng = np.random.default_rng(1)
    level = np.full((400, 600), SKIN)
    for x in range(60, 560, 60):
        level += 400 * coverage(level.shape, np.array([x, 200.0]), 5.0, 5.0, 0.0)
    image = grey(level + rng.normal(0, 2, size=level.shape))
    assert (image == 255).sum() > 200  # more pixels share the top level than are looked at

    found = find_level(image)

    assert SKIN + 20 < found < 255 - 40
    assert len(find_blobs(image, BlobSettings(found))) == 9


def test_the_dots_level_is_the_mean_of_the_brightest_pixels() -> None:
    image = np.full((200, 300), 40, np.uint8)
    image[10:20, 10:25] = 240  # 150 pixels
    image[50:60, 10:25] = 200  # 150 more, of which 50 belong to the brightest 200

    dots = (150 * 240 + 50 * 200) / 200

    assert np.sort(image.ravel())[-200:].mean() == dots
    assert (find_level(image) - 40) / (dots - 40) == pytest.approx(0.38)


@pytest.mark.parametrize("what", ["skin", "black", "noise"])
def test_a_picture_without_dots_has_no_level(what: str) -> None:
    rng = np.random.default_rng(0)
    image = {
        "skin": grey(rng.normal(SKIN, 3, size=(200, 300))),
        "black": np.zeros((200, 300), np.uint8),
        "noise": grey(rng.normal(100, 8, size=(200, 300))),
    }[what]

    with pytest.raises(InputError, match="no bright dots"):
        find_level(image)


def test_a_level_below_the_noise_is_refused() -> None:
    image = np.zeros((300, 300), np.uint8)
    image[::3, ::3] = 200  # 10,000 single pixels

    with pytest.raises(InputError, match=r"more than 4096 .* level 110.*bright markers"):
        find_blobs(image, LEVEL)


def test_a_black_picture_has_no_dots() -> None:
    blobs = find_blobs(np.zeros((50, 60), np.uint8), LEVEL)

    assert len(blobs) == 0
    assert blobs.centres.shape == (0, 2)
    assert blobs.sd_px.shape == (0,)
