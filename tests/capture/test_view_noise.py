"""Covariances where the errors of one view go together: Monte Carlo, a closed form, few views."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binomtest

from facewright.capture.bundle import (
    Bundle,
    BundleCamera,
    BundleData,
    covariance_of,
    solve_bundle,
    target_parts,
)
from facewright.capture.projection import OPENCV, selection
from facewright.capture.view_noise import FALSE_ALARM, covariance_by_view
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.board_poses import camera_poses

Floats = NDArray[np.float64]
SIZE = (1280, 960)
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
ROW = np.array([1250.0, 1246, 633, 487, -0.22, 0.08, 6e-4, -4e-4, *np.zeros(8)])
LENS = Camera(
    SIZE,
    np.array([[1250.0, 0, 633.0], [0, 1246.0, 487.0], [0, 0, 1]]),
    Rigid.identity(),
    "opencv",
    np.array([-0.22, 0.08, 6e-4, -4e-4, 0.0]),
)
BOARD = parse_board("chessboard:9x6:25")
CORNERS = BOARD.object_points()
HELD = camera_poses(BOARD, LENS, 40, np.random.default_rng(8))
SD = 0.15


def fit(noise: Floats, held: tuple[Rigid, ...] = HELD) -> Bundle:
    """From the truth, with errors (V, N, 2) added."""
    camera = BundleCamera(
        ROW, OPENCV, selection({n: {n: 1.0} for n in NAMES})[1], np.eye(3), np.zeros(3), False
    )
    exact = np.stack([LENS.project(p.apply(CORNERS)) for p in held])
    target = np.repeat(np.arange(len(held)), len(CORNERS))
    data = BundleData(
        np.zeros(len(target), np.int64),
        target,
        np.tile(CORNERS, (len(held), 1)),
        (exact + noise).reshape(-1, 2),
        np.ones(len(target)),
    )
    R, t = np.stack([p.rotation for p in held]), np.stack([p.translation for p in held])
    return solve_bundle([camera], R, t, data)


def white(rng: np.random.Generator, n: int = len(HELD)) -> Floats:
    return rng.normal(0, SD, (n, len(CORNERS), 2))


def together(rng: np.random.Generator, n: int = len(HELD)) -> Floats:
    """Errors that bend smoothly over the board, besides as large independent ones."""
    x, y = ((CORNERS[:, :2] - CORNERS[:, :2].mean(axis=0)) / 100).T
    smooth = np.stack([x * x, x * y, y * y, x**3, y**3, x * x * y], axis=1)
    bends = smooth @ rng.normal(0, SD, (n, 6, 2))
    return white(rng, n) + bends


def stated(found: Bundle, *, by_view: bool) -> Floats:
    C = covariance_by_view(found) if by_view else covariance_of(found.information)
    return np.asarray(C * found.variance_factor)


@pytest.fixture(scope="module")
def bent() -> list[Bundle]:
    return [fit(together(np.random.default_rng(seed))) for seed in range(60)]


def lens_errors(found: list[Bundle]) -> Floats:
    return np.array([f.cameras[0].intrinsics[:8] - ROW[:8] for f in found])


def test_errors_that_go_together_are_stated_truly(bent: list[Bundle]) -> None:
    errors = lens_errors(bent)
    said = {}
    for by_view in (False, True):
        C = np.mean([stated(f, by_view=by_view) for f in bent], axis=0)
        said[by_view] = np.sqrt((errors**2).mean(axis=0) / np.diag(C))

    # eight deviations of 60 draws each
    np.testing.assert_allclose(said[True], 1, atol=4 / np.sqrt(2 * len(bent)))
    assert np.sqrt((said[True] ** 2).mean()) == pytest.approx(1, abs=0.12)
    assert np.sqrt((said[False] ** 2).mean()) > 1.4, "the noise of this test is too tame"


def test_what_goes_together_is_stated_of_the_parameters_that_it_moves() -> None:
    # rows of the sensor read with a jitter of their own, say: only x goes together
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        noise = white(rng)
        noise[..., 0] = 2 * together(rng)[..., 0]
        found.append(fit(noise))
    errors = np.sqrt((lens_errors(found) ** 2).mean(axis=0))

    said = np.sqrt(np.mean([np.diag(stated(f, by_view=True)) for f in found], axis=0))

    naive = np.sqrt(np.mean([np.diag(stated(f, by_view=False)) for f in found], axis=0))
    enlarged = errors / naive
    assert enlarged[7] > 1.6 * enlarged[6], "p2 should suffer more than p1"
    # enlarged all alike, p1 would be stated 1.57 times too unsure and p2 0.85 times
    assert (said / errors)[6] < 1.5
    assert (said / errors)[7] > 0.9
    assert np.sqrt(((said / errors) ** 2).mean()) == pytest.approx(1, abs=0.2)


def test_few_views_state_no_less_than_many() -> None:
    # each of nine views takes most of its own errors into the fit
    held = HELD[:9]
    found = [fit(together(np.random.default_rng(seed), 9), held) for seed in range(80)]

    C = np.mean([stated(f, by_view=True) for f in found], axis=0)

    ratio = np.sqrt((lens_errors(found) ** 2).mean(axis=0) / np.diag(C))
    assert np.sqrt((ratio**2).mean()) == pytest.approx(1, abs=0.2)


def test_independent_errors_are_mostly_taken_as_such() -> None:
    found = [fit(white(np.random.default_rng(seed))) for seed in range(60)]
    ratios = [np.trace(covariance_by_view(f) @ f.information) / 8 for f in found]

    as_before = np.isclose(ratios, 1, rtol=1e-6)
    assert binomtest(int((~as_before).sum()), len(found), FALSE_ALARM).pvalue > 1e-3
    assert np.mean(ratios) == pytest.approx(1, abs=0.05)


def test_every_view_twice_is_worth_no_more_than_once() -> None:
    noise = together(np.random.default_rng(3))
    once = fit(noise)
    # each corner measured twice, with the same error: as two frames of a board that rests
    data = once.data
    pixels = np.repeat(data.pixels, 2, axis=0)
    camera, target = np.repeat(data.camera, 2), np.repeat(data.target, 2)
    twice = BundleData(
        camera, target, np.repeat(data.points, 2, axis=0), pixels, np.ones(len(pixels))
    )
    doubled = solve_bundle(once.cameras, once.target_rotation, once.target_translation, twice)

    C, D = stated(once, by_view=True), stated(doubled, by_view=True)

    np.testing.assert_allclose(np.sqrt(np.diag(D) / np.diag(C)), 1, atol=0.02)
    naive = np.diag(stated(doubled, by_view=False)) / np.diag(stated(once, by_view=False))
    np.testing.assert_allclose(naive, 0.5, rtol=0.05)


def test_few_views_leave_the_covariance_alone() -> None:
    held = HELD[:3]
    found = fit(together(np.random.default_rng(0), 3), held)

    np.testing.assert_array_equal(covariance_by_view(found), covariance_of(found.information))


def test_without_noise_nothing_breaks() -> None:
    found = fit(np.zeros((len(HELD), len(CORNERS), 2)))

    assert np.isfinite(covariance_by_view(found)).all()


def test_a_parameter_that_nothing_determines_stays_unsure() -> None:
    # frontal boards at one distance: focal length and depth cannot be told apart
    held = tuple(
        Rigid.from_rotation(np.eye(3), (x, -60.0, 800.0)) for x in np.linspace(-300, 60, 40)
    )
    found = fit(white(np.random.default_rng(0)), held)

    sd = np.sqrt(np.diag(stated(found, by_view=True)))

    assert np.isfinite(sd).all()
    assert sd[0] > 20, f"fx is said to be known to {sd[0]:.3g} px"


def test_parts_of_targets_add_up_to_the_whole(bent: list[Bundle]) -> None:
    found = bent[0]
    parts = list(target_parts(found))

    whole = found.full_information[:8, :8]
    size = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(sum(p.H for p in parts) / np.outer(size, size),
                               whole / np.outer(size, size), atol=1e-12)  # fmt: skip
    # at the bottom all slopes vanish
    scale = size * np.sqrt(found.cost)
    np.testing.assert_allclose(sum(p.g for p in parts) / scale, 0, atol=1e-5)
    slopes = np.array([p.g_target for p in parts])
    inner = np.sqrt(np.einsum("lii->li", found.target_information) * found.cost)
    np.testing.assert_allclose(slopes / inner, 0, atol=1e-5)
