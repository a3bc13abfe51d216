"""Connected groups of bright pixels, against SciPy's labels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from facewright.tracking.spot_scan import AREA, CX, CY, PEAK, SUM, X0, XX, XY, Y1, YY, scan

WITH_CORNERS = np.ones((3, 3))


@pytest.mark.parametrize("shape", [(40, 64), (37, 51), (1, 30), (30, 1), (64, 64)])
@pytest.mark.parametrize("level", [-1.0, 0.0, 99.5, 127.0, 128.0, 200.0, 254.0, 255.0, 400.0])
def test_components_are_scipys(shape: tuple[int, int], level: float) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)

    found, n = scan(image, level, 10_000)

    labels, expected = ndimage.label(image > level, WITH_CORNERS)
    assert n == len(found) == expected
    for i in range(n):
        y, x = np.nonzero(labels == i + 1)
        grey = image[y, x].astype(float)
        row = found[i]
        assert (row[AREA], row[X0], row[Y1]) == (len(x), x.min(), y.max())
        assert (row[SUM], row[PEAK]) == (grey.sum(), grey.max())
        np.testing.assert_allclose(row[[CX, CY]], (x.mean(), y.mean()), atol=1e-9)
        covariance = ((x - x.mean()) * (y - y.mean())).mean()
        np.testing.assert_allclose(row[[XX, XY, YY]], (x.var(), covariance, y.var()), atol=1e-9)


def test_any_layout_of_the_picture_gives_the_same() -> None:
    wide = np.random.default_rng(2).integers(0, 256, (48, 80)).astype(np.uint8)
    view = wide[:, 3:67]
    expected, n = scan(np.ascontiguousarray(view), 180.0, 5000)

    for layout in (view, np.asfortranarray(view), np.ascontiguousarray(view[:, ::-1])[:, ::-1]):
        found, count = scan(layout, 180.0, 5000)
        assert count == n
        np.testing.assert_array_equal(found, expected)


def test_too_many_are_counted_but_not_returned() -> None:
    image = np.zeros((100, 100), np.uint8)
    image[::3, ::3] = 200

    found, n = scan(image, 100.0, 50)

    assert n == 34 * 34
    assert len(found) == 0
