"""Centres of dots, against discs whose centres are known and against other programs."""

from __future__ import annotations

import numpy as np
import pytest
import trackpy
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from facewright.core.errors import InputError
from facewright.tracking.blobs import (
    DARK,
    BlobSettings,
    background_level,
    find_blobs,
    find_level,
    shining,
)

SKIN, CONTRAST = 45.0, 160.0
LEVEL = BlobSettings(110.0)
BLUR_PX = 0.4  # of a good lens
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
    """n × n dots 24 px apart at random sub-pixel places, through a lens's blur; their centres."""
    size = 24 * (n + 1)
    at = 24.0 * np.stack(np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1)), axis=-1)
    centres = at.reshape(-1, 2) + rng.uniform(-0.5, 0.5, size=(n * n, 2))
    level = np.full((size, size), SKIN)
    for centre in centres:
        level += CONTRAST * coverage(level.shape, centre, a, b, float(rng.uniform(0, np.pi)))
    level = ndimage.gaussian_filter(level, BLUR_PX, mode="nearest")
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
    assert rms < 1.05 * peer_rms


def gaussian_field(
    rng: np.random.Generator, sigma: float, snr: float, n: int
) -> tuple[Image, Floats]:
    """n × n Gaussian spots, sampled at pixel centres, of peak 120 and with white noise; centres."""
    step = int(np.ceil(12 * sigma))
    at = float(step) * np.stack(np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1)), axis=-1)
    centres = at.reshape(-1, 2) + rng.uniform(-0.5, 0.5, size=(n * n, 2))
    y, x = np.mgrid[: step * (n + 1), : step * (n + 1)].astype(np.float64)
    level = np.full(x.shape, 60.0)
    for cx, cy in centres:
        level += 120 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return grey(level + rng.normal(0, 120 / snr, level.shape)), centres


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("snr", [10.0, 100.0])
def test_gaussian_spots_reach_the_bound_of_any_unbiased_centre(sigma: float, snr: float) -> None:
    """The bound is √(2/π) / SNR; rounding to grey levels adds 1/12 to the noise's variance."""
    image, true = gaussian_field(np.random.default_rng(17), sigma, snr, n=16)

    blobs = find_blobs(image, BlobSettings(60 + 0.38 * 120))

    found = blobs.centres[np.linalg.norm(blobs.centres - true[:, None], axis=2).argmin(axis=1)]
    error = found - true
    noise = np.hypot(120 / snr, np.sqrt(1 / 12))
    bound = np.sqrt(2 / np.pi) * noise / 120
    rms = np.sqrt((error**2).mean())
    error = error[(np.abs(error) < 1).all(axis=1)]
    assert len(error) >= 0.98 * len(true)  # of few bright pixels, noise takes one
    assert rms < 1.15 * bound  # 512 numbers: 3 % of one standard error
    assert rms > 0.9 * bound  # else the bound is wrong
    assert np.abs(error.mean(axis=0)).max() < 4 * bound / 16
    assert np.median(blobs.sd_px) == pytest.approx(rms, rel=0.15)
    share = (np.abs(error) < 1.96 * np.median(blobs.sd_px)).mean()
    assert 0.92 < share < 0.98


def test_the_fit_is_scipys_least_squares_fit_of_the_same_model() -> None:
    """A slanted Gaussian on a slope, 9 unknowns, fitted by SciPy to the same pixels."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:41, :41].astype(np.float64)
    for _ in range(5):
        cx, cy = 20 + rng.uniform(-0.5, 0.5, size=2)

        def model(p: Floats) -> Floats:
            dx, dy = x - p[0], y - p[1]
            q = p[2] * dx**2 + 2 * p[3] * dx * dy + p[4] * dy**2
            return np.asarray(p[5] * np.exp(-q / 2) + p[6] + p[7] * dx + p[8] * dy)

        truth = np.array([cx, cy, 0.2, 0.05, 0.12, 150.0, 45.0, 0.3, -0.2])
        image = grey(model(truth) + rng.normal(0, 1, x.shape))

        (found,) = find_blobs(image, BlobSettings(105.0)).centres

        fitted = least_squares(lambda p, g=image: (model(p) - g).ravel(), truth).x
        # the sharpness is one unknown more here, and the window smaller: both even, but for noise
        np.testing.assert_allclose(found, fitted[:2], atol=0.004)


def test_small_dots_are_known_to_be_less_certain() -> None:
    error, sd = [], []
    for radius in (2.0, 5.0):
        image, true = field_of_dots(np.random.default_rng(8), radius, radius, noise=1.0)
        blobs = find_blobs(image, LEVEL)
        error.append(np.sqrt((nearest(blobs.centres, true) ** 2).mean()))
        sd.append(np.median(blobs.sd_px))

    assert error[0] > 1.2 * error[1]
    assert sd[0] > 1.2 * sd[1]


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

    # arithmetic of 32 bits
    np.testing.assert_allclose(moved[np.lexsort(moved.T)] - (11, 7), base[order], atol=1e-5)
    back = mirrored * (-1, 1) + (image.shape[1] - 1, 0)
    np.testing.assert_allclose(back[np.lexsort(back.T)], base[order], atol=1e-5)
    back = turned[:, ::-1]
    np.testing.assert_allclose(back[np.lexsort(back.T)], base[order], atol=1e-5)


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
    assert np.quantile(sd, 0.1) > 1.4 * np.max(whole_sd)
    assert np.median(sd) > 2 * np.median(whole_sd)


def test_a_whole_dot_among_others_is_taken_for_whole_at_any_slant() -> None:
    """What makes a dot unsure is odd about its centre; a slant is not."""
    for slant in (1.0, 0.7, 0.4):
        image, true = field_of_dots(np.random.default_rng(1), 4.0, 4.0 * slant, noise=1.0, n=5)
        blobs = find_blobs(image, LEVEL)
        rms = np.sqrt((nearest(blobs.centres, true) ** 2).mean())

        assert np.median(blobs.sd_px) < 2 * rms
        assert np.max(blobs.sd_px) < 0.03


def test_how_sure_hidden_dots_are_is_true_within_a_factor_of_two_and_a_half() -> None:
    """Among whole dots, of which the noise is known; behind edges brighter and darker than skin."""
    rng = np.random.default_rng(11)
    for over in (20.0, 45.0, 70.0):
        for hidden in (0.1, 0.2, 0.35):
            off, sd = [], []
            for _ in range(4):
                whole, _ = field_of_dots(rng, 3.5, 3.5, noise=1.5, n=3)
                for _ in range(6):
                    part, centre = hidden_dot(rng, 3.5, hidden, over, noise=1.5)
                    image = np.hstack([np.pad(part, ((0, 55), (0, 0)), mode="edge"), whole])
                    blobs = find_blobs(image, LEVEL)
                    d = np.linalg.norm(blobs.centres - centre, axis=1)
                    off.append(blobs.centres[d.argmin()] - centre)
                    sd.append(blobs.sd_px[d.argmin()])
            ratio = np.sqrt((np.array(off) ** 2).mean()) / np.sqrt(np.square(sd).mean())
            assert 0.4 < ratio < 2.5, f"{hidden:.0%} hidden behind {over}: {ratio:.2f}"


def hidden_dot(
    rng: np.random.Generator, radius: float, hidden: float, over: float, *, noise: float
) -> tuple[Image, Floats]:
    """A dot of which a straight edge of level `over` hides a share, (41, 41), and its centre."""
    n = 8
    centre = 20 + rng.uniform(-0.5, 0.5, size=2)
    s = (np.arange(41 * n) + 0.5) / n - 0.5
    x, y = np.meshgrid(s - centre[0], s - centre[1])
    offsets = np.linspace(-1, 1, 4001)
    cut_share = (np.arccos(offsets) - offsets * np.sqrt(1 - offsets**2)) / np.pi
    chord = radius * float(np.interp(-hidden, -cut_share, offsets))
    way = float(rng.uniform(0, 2 * np.pi))
    level = np.where(x**2 + y**2 < radius**2, SKIN + CONTRAST, SKIN)
    level = np.where(x * np.cos(way) + y * np.sin(way) > chord, over, level)
    level = ndimage.gaussian_filter(level, 0.45 * n).reshape(41, n, 41, n).mean(axis=(1, 3))
    return grey(level + rng.normal(0, noise, level.shape)), centre


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("radius", [2.5, 4.0])
@pytest.mark.parametrize("gap_px", [0.0, 0.4])
def test_dots_that_touch_are_parted(count: int, radius: float, gap_px: float) -> None:
    rng = np.random.default_rng(5)
    apart = 2 * radius + gap_px
    for _ in range(8):
        way = float(rng.uniform(0, 2 * np.pi)) + np.array([0, np.pi / 3])
        true = 30 + rng.uniform(-0.5, 0.5, size=(1, 2)) + np.zeros((count, 2))
        true[1:] += apart * np.stack([np.cos(way), np.sin(way)], axis=1)[: count - 1]
        level = np.full((61, 61), SKIN)
        for centre in true:
            level += CONTRAST * coverage(level.shape, centre, radius, radius, 0.0)
        image = grey(ndimage.gaussian_filter(level, BLUR_PX) + rng.normal(0, 1.5, level.shape))
        assert ndimage.label(image > 85, np.ones((3, 3)))[1] == 1  # one component indeed

        blobs = find_blobs(image, BlobSettings(85.0))

        assert len(blobs) == count
        assert np.abs(nearest(blobs.centres, true)).max() < 0.15
        assert blobs.areas_px.sum() == (image > 85).sum()


def test_one_long_spot_is_not_parted() -> None:
    """Motion in a long exposure smears a dot; its middle is the middle of its way."""
    rng = np.random.default_rng(3)
    for way_px in (2.0, 5.0, 9.0):
        errors = []
        for _ in range(10):
            centre, way = 30 + rng.uniform(-0.5, 0.5, size=2), float(rng.uniform(0, np.pi))
            steps = np.linspace(-0.5, 0.5, 31)[:, None] * way_px * [np.cos(way), np.sin(way)]
            share = np.mean([coverage((61, 61), centre + s, 3.0, 3.0, 0.0) for s in steps], axis=0)
            image = grey(SKIN + CONTRAST * share + rng.normal(0, 1, share.shape))
            blobs = find_blobs(image, BlobSettings(85.0))
            assert len(blobs) == 1
            errors.append(blobs.centres[0] - centre)
        assert np.sqrt(np.square(errors).mean()) < 0.02


@pytest.mark.parametrize("over", [1.5, 3.0, 8.0])
def test_overexposure_does_not_bias(over: float) -> None:
    """A Gaussian spot so bright that its middle is cut off."""
    rng = np.random.default_rng(9)
    y, x = np.mgrid[:61, :61].astype(np.float64)
    errors, clipped = [], []
    for _ in range(40):
        cx, cy = 30 + rng.uniform(-0.5, 0.5, size=2)
        level = 40 + over * 215 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 2.5**2))
        blobs = find_blobs(grey(level + rng.normal(0, 2, level.shape)), BlobSettings(120.0))
        errors.append(blobs.centres[0] - (cx, cy))
        clipped.append(blobs.is_clipped[0])

    assert all(clipped)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.01
    assert np.sqrt(np.square(errors).mean()) < 0.03


def test_dark_dots_are_bright_dots_of_the_inverted_picture() -> None:
    image, true = field_of_dots(np.random.default_rng(3), 3.0, 3.0, noise=1.0, n=4)
    settings = BlobSettings(LEVEL.level, weights=DARK[0], offset=DARK[1])

    dark = find_blobs(np.invert(image), settings)

    np.testing.assert_array_equal(dark.centres, find_blobs(image, LEVEL).centres)
    assert len(dark) == len(true)


def test_a_level_that_follows_the_light_finds_the_same_dots() -> None:
    rng = np.random.default_rng(4)
    image, true = field_of_dots(rng, 3.5, 3.5, noise=0.0, n=5)
    settings = BlobSettings(LEVEL.level, background=background_level(image))
    fixed = BlobSettings(LEVEL.level)

    for light in (0.4, 0.7, 1.2):
        flickered = grey(np.asarray(image * light + rng.normal(0, 1, image.shape), np.float64))
        assert len(find_blobs(flickered, settings)) == len(true)
    assert (
        len(find_blobs(grey(np.asarray(image * 0.4, np.float64)), fixed)) == 0
    )  # it is the following that does it


def test_colours_are_weighed_channel_by_channel() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, size=(20, 30, 3)).astype(np.uint8)
    settings = BlobSettings(100.0, weights=(0.5, -1.0, 0.7), offset=30.0)

    found = shining(image, settings)

    expected = np.clip(np.rint(30 + image @ np.array([0.5, -1.0, 0.7])), 0, 255)
    assert np.abs(found - expected).max() <= 1  # halves are rounded up
    assert (found == expected).mean() > 0.9
    with pytest.raises(ValueError, match="3 weights, the picture 1 channels"):
        shining(image[..., 0], settings)


def test_half_axes_are_the_discs() -> None:
    image, _ = field_of_dots(np.random.default_rng(2), 5.0, 3.0, noise=0.5, n=5)

    half_axes = find_blobs(image, LEVEL).half_axes_px

    np.testing.assert_allclose(np.median(half_axes, axis=0), (3.0, 5.0), atol=0.15)


def test_areas_and_contrast_are_the_dots() -> None:
    image, true = field_of_dots(np.random.default_rng(2), 4.0, 4.0, noise=0.0, n=5)

    blobs = find_blobs(image, BlobSettings(SKIN + CONTRAST / 2))

    np.testing.assert_allclose(blobs.areas_px, np.pi * 16, atol=5)
    assert len(blobs) == len(true)
    for least, most in ((60, 100), (1, 40)):
        settings = BlobSettings(SKIN + CONTRAST / 2, min_area_px=least, max_area_px=most)
        assert len(find_blobs(image, settings)) == 0


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
