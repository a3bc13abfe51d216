"""What the cleaning report shows of tracked markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.cli.marker_scene import marker_scene
from facewright.cli.overlay import write_overlay
from facewright.cli.tracking_report import (
    MARKER_COLUMNS,
    gaps_of,
    marker_rows,
    noise_mm,
    summary_of,
    write_tracking_report,
)
from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.core.trajectories import Source, Trajectories
from facewright.core.video import read_frames
from facewright.core.video_writer import VideoWriter
from facewright.heads.marker_sets import ready_marker_set
from facewright.tracking.labelling import template_positions

RATE_HZ = 30.0
T = 60


def tracks() -> Trajectories:
    """The ready set on the average head, which moves by 1 mm a frame along x and turns."""
    marker_set = ready_marker_set()
    p = np.tile(template_positions(marker_set), (T, 1, 1))
    p += np.arange(T)[:, None, None] * np.array([1.0, 0.0, 0.0])
    source = np.full(p.shape[:2], Source.MEASURED, np.uint8)
    source[10:20, 3] = Source.RECONSTRUCTED
    source[30:33, 4] = Source.INTERPOLATED
    source[40:, 5] = Source.MISSING
    p[40:, 5] = np.nan
    covariances = np.tile(np.diag([0.01, 0.01, 0.02]), (T, p.shape[1], 1, 1))
    covariances[source != Source.MEASURED] = np.nan
    return Trajectories(np.arange(T) / RATE_HZ, marker_set.labels, p, covariances, source)


def test_gaps_are_the_runs_that_were_not_measured() -> None:
    source = np.array([0, 1, 1, 2, 2, 3, 1, 0], np.uint8)
    assert gaps_of(source) == [
        (0, 1, Source.MISSING),
        (3, 5, Source.INTERPOLATED),
        (5, 6, Source.RECONSTRUCTED),
        (7, 8, Source.MISSING),
    ]
    assert gaps_of(np.ones(5, np.uint8)) == []


def test_the_table_counts_what_is_there() -> None:
    given = tracks()
    rows = {row[0]: dict(zip(MARKER_COLUMNS, row, strict=True)) for row in marker_rows(given)}
    third = rows[given.names[3]]
    assert (third["measured %"], third["reconstructed %"], third["gaps"]) == ("83.3", "16.7", "1")
    assert third["longest s"] == f"{11 / RATE_HZ:.2f}"
    assert rows[given.names[5]]["missing %"] == "33.3"
    assert rows[given.names[0]]["gaps"] == "0"
    np.testing.assert_allclose(noise_mm(given), 0.2)
    assert "reconstructed from other markers" in summary_of(given)


def test_balls_are_where_the_markers_were_and_gone_where_they_were_not() -> None:
    given = tracks()
    scene = marker_scene(given, ready_marker_set())
    parts = {part.name: part for part in scene.parts}
    assert len(parts) == len(given.names) + 1
    middle = np.nanmedian(given.positions.reshape(-1, 3), axis=0)
    for m in (0, 5):
        ball = parts[given.names[m]]
        seen = ~given.is_missing[:, m]
        assert ball.translation is not None
        np.testing.assert_allclose(
            ball.translation[seen], given.positions[seen, m] - middle, atol=1e-9
        )
        if m == 5:
            assert ball.weights is not None
            np.testing.assert_array_equal(ball.weights[:, 0], ~seen)
            np.testing.assert_allclose(ball.targets[0].offsets, -ball.vertices)
        else:
            assert ball.weights is None


def test_the_head_lies_under_its_markers_and_goes_with_them() -> None:
    given = tracks()
    head = marker_scene(given, ready_marker_set()).parts[-1]
    assert head.translation is not None and head.rotation is not None
    np.testing.assert_allclose(np.diff(head.translation, axis=0), [[1, 0, 0]] * (T - 1), atol=1e-6)
    np.testing.assert_allclose(np.abs(head.rotation[:, 0]), 1, atol=1e-9)
    middle = np.nanmedian(given.positions.reshape(-1, 3), axis=0)
    at_first = head.vertices + head.translation[0]
    for m, name in enumerate(given.names):
        gap = np.linalg.norm(at_first - (given.positions[0, m] - middle), axis=1).min()
        assert gap < 6.0, name  # a vertex of the mesh is near


def test_an_overlay_marks_the_projections(tmp_path: Path) -> None:
    size = (320, 240)
    pose = Rigid.from_rotation(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 900.0]))
    matrix = np.array([[600.0, 0, 159.5], [0, 600.0, 119.5], [0, 0, 1]])
    camera = Camera(size, matrix, camera_from_world=pose)
    given = tracks().select(("nose_tip",))
    with VideoWriter(tmp_path / "cam0.mp4", size, RATE_HZ) as writer:
        for _ in range(T):
            writer.write(np.full((size[1], size[0], 3), 40, np.uint8))
    assert write_overlay(tmp_path / "over.mp4", tmp_path / "cam0.mp4", camera, given) == T
    frames = list(read_frames(tmp_path / "over.mp4"))
    pixel = camera.project(given.positions[:, 0])
    for row in (0, T - 1):
        at = np.rint(pixel[row]).astype(int)
        shown = frames[row].image.astype(int)
        assert shown[at[1], at[0]].max() > 120
        assert shown[at[1] + 12, at[0] - 12].max() < 60


def test_the_page_holds_model_chart_and_tables(tmp_path: Path) -> None:
    picture = write_tracking_report(
        tmp_path / "cleaning.html", tracks(), ready_marker_set(), {"frames": T}, [], {}
    )
    text = (tmp_path / "cleaning.html").read_text(encoding="utf-8")
    assert "model-0" in text and "<svg" in text and "Where samples come from" in text
    assert "lip_corner_l" in text and "http-equiv" in text
    assert picture == tmp_path / "cleaning.png" and picture.stat().st_size > 5000


@pytest.mark.parametrize("labelled", [True, False])
def test_tracks_without_names_show_no_head(labelled: bool) -> None:
    given = tracks()
    scene = marker_scene(given, ready_marker_set() if labelled else None)
    assert (scene.parts[-1].name == "average head") == labelled
