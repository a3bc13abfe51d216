"""Blender shows our vertices. Needs a Python with the package bpy, no dependency of ours."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.core.clip import Clip
from facewright.core.formats.gltf import write_glb
from facewright.core.formats.usd import write_usd
from facewright.core.rigid import rotation_from_quaternion
from facewright.heads.head import Head
from facewright.retarget.animation import HeadAnimation
from facewright.retarget.drive import HeadDrive
from facewright.retarget.export import animation_glb
from facewright.retarget.shape_solver import ShapeDrive

FRAMES = (0, 3, 7)
#: Prints every mesh's vertices in some frames, in the file's axes (Blender's z is up).
SCRIPT = """
import bpy, numpy, sys
path, out = sys.argv[1:3]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 25
if path.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=path)
else:
    bpy.ops.wm.usd_import(filepath=path)
found = {}
for frame in map(int, sys.argv[3:]):
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for thing in bpy.context.scene.objects:
        if thing.type != "MESH" or not thing.data.materials:
            continue
        shown = thing.evaluated_get(graph)
        mesh = shown.to_mesh()
        v = numpy.empty(3 * len(mesh.vertices))
        mesh.vertices.foreach_get("co", v)
        world = numpy.array(shown.matrix_world)
        v = v.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
        found[f"{thing.data.name} {frame}"] = v[:, [0, 2, 1]] * (1, 1, -1)
numpy.savez(out, **found)
"""


@pytest.fixture(scope="module")
def blender_shows() -> Callable[[Path], dict[str, NDArray[np.float64]]]:
    python = os.environ.get("BLENDER_PYTHON")
    if python is None:
        pytest.skip("needs BLENDER_PYTHON=a Python interpreter that has the package bpy")

    def shown(path: Path) -> dict[str, NDArray[np.float64]]:
        out = path.with_suffix(".npz")
        command = [python, "-c", SCRIPT, str(path), str(out), *map(str, FRAMES)]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        with np.load(out) as found:
            return dict(found)

    return shown


def moving(head: Head, drive: HeadDrive, way: str) -> HeadAnimation:
    t = np.arange(8) / 25
    curves = {
        "open_jaw": 300 * np.sin(9 * t) ** 2,
        "raise_l_i_eyebrow": 150 * np.sin(20 * t),  # both ways
        "yaw_l_eyeball": 20000 * np.sin(9 * t),
        "head_yaw": 20000 * np.sin(7 * t),
    }
    clip = Clip(t, tuple(curves), np.stack(list(curves.values()), axis=1))
    return (ShapeDrive(head) if way == "shapes" else drive).animate(clip)


@pytest.mark.parametrize("way", ["points", "shapes"])
@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
def test_blender_puts_vertices_where_ours_are(
    tmp_path: Path, head: Head, drive: HeadDrive, suffix: str, way: str,
    blender_shows: Callable[[Path], dict[str, NDArray[np.float64]]],
) -> None:  # fmt: skip
    animation = moving(head, drive, way)
    scene = animation_glb(head, animation, name="test", texture_px=64)
    path = tmp_path / f"head{suffix}"
    if suffix == ".glb":
        write_glb(path, scene)
    else:
        pytest.importorskip("pxr.UsdSkel", reason="needs the package usd-core")
        write_usd(path, scene, rate=Fraction(25))

    found = blender_shows(path)

    assert len(found) == len(FRAMES) * len(scene.parts)
    for frame in FRAMES:
        turn = rotation_from_quaternion(animation.motion.quaternion[frame])
        truth = (animation.vertices(frame) @ turn.T + animation.motion.translation[frame]) / 1000
        for part in scene.parts:
            rows = np.unique(head.mesh.triangles[head.mesh.groups[part.name]])
            # vertices are doubled at texture seams: every one must be at a place of ours
            off_m = cKDTree(truth[rows]).query(found[f"{part.name} {frame}"])[0].max()
            assert off_m < 1e-6, f"{part.name}, frame {frame}: {off_m:.2g} m off"
