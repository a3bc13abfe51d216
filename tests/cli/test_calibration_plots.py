"""The picture of a rig's uncertainty: every cell that is known has its number and its colour."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from facewright.capture.rig_face import PlaneUncertainty
from facewright.cli.calibration_plots import uncertainty_plane
from facewright.core.rigid import Rigid


def plane() -> PlaneUncertainty:
    calibration = np.linspace(0.01, 0.4, 25).reshape(5, 5)
    calibration[1, 1] = np.nan
    return PlaneUncertainty(
        Rigid.identity(),
        np.arange(-80.0, 81, 40),
        np.arange(80.0, -81, -40),
        calibration,
        np.full((5, 5), 0.125),
        np.array([[1, 4, 4, 4, 4]] * 5),
    )


def test_numbers_are_those_of_the_cells() -> None:
    svg = uncertainty_plane("At the face", plane(), (75.0, 110.0)).svg()

    words = re.findall(r">([^<]+)</text>", svg)
    known = plane().calibration_mm
    for row, column in ((1, 3), (3, 1), (3, 3)):
        assert f"{known[row, column]:.2g}" in words
    assert words.count("0.12") == 4
    assert "?" in words
    assert any("0.01 to 0.4" in w for w in words)
    assert any("seen by 1 to 4 cameras" in w for w in words)


def test_the_ring_has_the_size_of_the_face() -> None:
    svg = uncertainty_plane("At the face", plane(), (100.0, 150.0)).svg()

    rings = [p for p in re.findall(r'<polyline points="([^"]+)"', svg) if p.count(" ") > 50]
    ring = np.array([[float(v) for v in at.split(",")] for at in rings[0].split()])
    cells = re.findall(r'<polygon points="([^"]+)"', svg)[:25]
    corners = np.array([[float(v) for v in at.split(",")] for c in cells for at in c.split()])
    # the grid is 200 mm wide and high
    np.testing.assert_allclose(
        np.ptp(ring, axis=0) / np.ptp(corners, axis=0), (0.5, 0.75), atol=0.01
    )
    np.testing.assert_allclose(
        (ring.max(axis=0) + ring.min(axis=0)) / 2,
        (corners.max(axis=0) + corners.min(axis=0)) / 2,
        atol=0.6,
    )


def test_a_plane_that_nobody_sees_is_told() -> None:
    blind = replace(
        plane(), calibration_mm=np.full((5, 5), np.nan), noise_mm=np.full((5, 5), np.nan)
    )

    svg = uncertainty_plane("At the face", blind, (75.0, 110.0)).svg()

    assert "fewer than two cameras see" in svg
    assert "nan" not in svg
