"""The examples run as a reader would run them, and give what they promise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.core.formats.c3d import read_c3d
from facewright.core.formats.fap import read_fap
from facewright.core.formats.gltf import read_glb
from facewright.core.mpeg4 import fap_by_name
from facewright.core.rig import Rig
from facewright.datasets_synthetic.film import film_take
from facewright.datasets_synthetic.performances import NEUTRAL_S
from facewright.datasets_synthetic.rigs import look_at
from facewright.datasets_synthetic.take_settings import CameraSettings, TakeSettings
from facewright.datasets_synthetic.takes import make_take
from facewright.heads.catalogue import built_in_head


def run_example(repository: Path, name: str, *arguments: object) -> str:
    """What an example prints; the test fails with its words if it fails."""
    script = repository / "examples" / name
    done = subprocess.run(
        [sys.executable, str(script), *map(str, arguments)],
        capture_output=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONPATH": str(repository), "PYTHONIOENCODING": "utf-8"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here(repository: Path) -> None:
    there = {path.name for path in (repository / "examples").glob("*.py")}

    assert there == {"track_take.py", "drive_head.py", "read_fap.py"}


def frontal_rig() -> Rig:
    """Four cameras of which each sees all of a face that looks along the world's +z."""
    cameras = {}
    for name, yaw, pitch in (("a", -24, 7), ("b", -9, -6), ("c", 9, 8), ("d", 24, -7)):
        across, up = np.deg2rad((yaw, pitch))
        away = (np.sin(across) * np.cos(up), np.sin(up), np.cos(across) * np.cos(up))
        pose = look_at(750 * np.array(away), (0.0, -12.0, 0.0))
        K = [[1950.0, 0, 639.5], [0, 1950.0, 359.5], [0, 0, 1]]
        cameras[name] = Camera((1280, 720), np.array(K), pose)
    return Rig(cameras)


def test_tracking_a_take_finds_the_markers_where_they_are(repository: Path, tmp_path: Path) -> None:
    settings = TakeSettings(seconds=0.5, cameras=CameraSettings(rate_hz=12.0))
    take = film_take(make_take(1, settings, rig=frontal_rig()), tmp_path)

    printed = run_example(repository, "track_take.py", tmp_path)

    with np.load(take.truth) as truth:
        names = tuple(str(name) for name in truth["marker_names"])
        true = truth["marker_positions"]
    found = read_c3d(tmp_path / "markers.c3d")
    distance = np.linalg.norm(found.select(names).positions - true, axis=2)
    assert found.names == names
    assert np.isnan(distance).mean() < 0.05
    assert np.sqrt(np.nanmean(distance**2)) < 0.10, "the demo's limit, mm"
    assert all(name in printed for name in names)
    # the actor is still at first: no FAP says more than the markers' error, 1 mm at the very most
    faps = read_fap(tmp_path / "performance.fap")
    still = faps.time_s <= NEUTRAL_S
    assert still.sum() >= 3
    fapu = built_in_head("average").fapu
    for name in faps.channels:
        fap = fap_by_name().get(name)
        if fap is not None and fap.direction is not None and not np.isnan(faps[name]).all():
            assert np.nanmax(np.abs(faps[name][still])) * fapu.unit(fap) < 1.0, name


def test_driving_a_head_moves_the_lids_and_the_head_as_written(
    repository: Path, tmp_path: Path
) -> None:
    run_example(repository, "drive_head.py", "--head", "kofi", "--out", tmp_path)

    fapu = built_in_head("kofi").fapu
    clip = read_fap(tmp_path / "gesture.fap")
    lid = clip["close_t_l_eyelid"].max() * fapu.unit(fap_by_name()["close_t_l_eyelid"])
    scene = read_glb(tmp_path / "gesture.glb")
    assert scene.root_rotation is not None
    yaw = 2 * np.rad2deg(np.arcsin(scene.root_rotation[:, 2]))
    assert lid == pytest.approx(9.0, abs=0.01)
    assert yaw.max() == pytest.approx(15.0, abs=0.1)
    assert yaw.min() == pytest.approx(-15.0, abs=0.1)
    assert len(scene.time_s) == len(clip.time_s) == 60
    skin = next(part for part in scene.parts if part.name == "skin")
    assert skin.weights is not None
    moved = np.zeros((len(scene.time_s), len(skin.vertices), 3))
    for weight, target in zip(skin.weights.T, skin.targets, strict=True):
        moved[:, target.rows] += weight[:, None, None] * target.offsets
    corner = np.linalg.norm(skin.vertices - built_in_head("kofi").points["8.3"], axis=1).argmin()
    assert np.abs(moved[0]).max() < 0.01, "at rest"
    assert moved[30, corner, :2] == pytest.approx([6.0, 5.0], rel=0.15), "the smile's top"


def test_reading_a_fap_file_lists_what_is_set_in_millimetres(
    repository: Path, tmp_path: Path
) -> None:
    mask = " ".join("1" if n in (3, 49) else "0" for n in range(1, 69))
    path = tmp_path / "by_hand.fap"
    path.write_text(f"2.1 by_hand 25 2\n{mask}\n0 0 -1000\n{mask}\n1 512 5000\n")

    lines = run_example(repository, "read_fap.py", path).splitlines()

    half_mns = built_in_head("average").fapu.mns / 2  # 512 of 1024
    assert lines[0].startswith("2 frames, 0.04 s")
    assert [line.split() for line in lines[1:]] == [
        ["3", "open_jaw", "0.00", "to", f"{half_mns:.2f}", "mm"],
        ["49", "head_yaw", "-0.57", "to", "2.86", "°"],  # 0.01 and 0.05 rad
    ]
