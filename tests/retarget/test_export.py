from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.formats.gltf import GltfPart, read_glb, write_glb
from facewright.core.formats.usd import write_usd
from facewright.core.mpeg4 import fap_by_name
from facewright.core.rigid import rotation_from_quaternion
from facewright.heads.head import Head
from facewright.retarget.animation import HeadAnimation
from facewright.retarget.drive import HeadDrive
from facewright.retarget.export import animation_glb, frame_curves, joint_of, motion_curves
from facewright.retarget.morph_curves import MAX_FRAME_SHAPES
from facewright.retarget.shape_solver import ShapeDrive


@pytest.fixture(scope="module")
def animation(drive: HeadDrive) -> HeadAnimation:
    """Half a second of all kinds of motion."""
    t = np.arange(16) / 30
    mm = {
        "open_jaw": 8 * np.sin(6 * t) ** 2,
        "raise_b_midlip": -7 * np.sin(6 * t) ** 2,
        "stretch_l_cornerlip": 4 * np.sin(9 * t),
        "close_t_l_eyelid": 9 * np.sin(12 * t) ** 2,
        "raise_l_i_eyebrow": 4 * np.sin(5 * t),
        "thrust_tongue_tip": 5 * np.sin(6 * t),
    }
    faps = {n: v / drive.head.fapu.unit(fap_by_name()[n]) for n, v in mm.items()}
    faps["yaw_l_eyeball"] = 30000 * np.sin(8 * t)
    faps["head_yaw"] = 20000 * np.sin(4 * t)
    return drive.animate(Clip(t, tuple(faps), np.stack(list(faps.values()), axis=1)))


def shown(part: GltfPart, frame: int) -> NDArray[np.float64]:
    """A part's vertices in one frame, by the format's rules."""
    v = np.array(part.vertices)
    for k, target in enumerate(part.targets):
        assert part.weights is not None
        v[target.rows] += part.weights[frame, k] * target.offsets
    if part.rotation is not None and part.translation is not None:
        turn = rotation_from_quaternion(part.rotation[frame])
        v = (v - part.pivot) @ turn.T + part.pivot + part.translation[frame]
    return v


def test_the_file_shows_the_animation(tmp_path: Path, head: Head, animation: HeadAnimation) -> None:
    path = tmp_path / "head.glb"
    write_glb(path, animation_glb(head, animation, name="test", texture_px=64))

    scene = read_glb(path)

    assert {part.name for part in scene.parts} == set(head.mesh.groups)
    np.testing.assert_allclose(scene.time_s, animation.time_s, atol=1e-6)
    assert scene.root_rotation is not None
    for part in scene.parts:
        triangles = head.mesh.triangles[head.mesh.groups[part.name]]
        for frame in (0, 3, 7, 15):
            wanted = animation.vertices(frame)[triangles]
            found = shown(part, frame)[part.triangles]
            error = np.abs(found - wanted).max()
            assert error < 1e-4, f"{part.name}, frame {frame}: {error:.2g} mm off"
            alike = scene.root_rotation[frame] @ animation.motion.quaternion[frame]
            assert abs(alike) == pytest.approx(1, abs=1e-6)


def test_no_motion_is_made_twice(head: Head, animation: HeadAnimation) -> None:
    scene = animation_glb(head, animation, name="test", texture_px=64)
    joints = {part.name: part.joint for part in scene.parts}

    assert joints == {
        "skin": "head", "lashes": "head", "teeth_upper": "head", "teeth_lower": "jaw",
        "tongue": "jaw", "eye_left": "eye_left", "eye_right": "eye_right",
    }  # fmt: skip
    for part in scene.parts:
        if part.joint == "head":
            assert part.rotation is None and part.translation is None
        elif part.name != "tongue":  # which bends besides
            assert not part.targets, part.name
    assert (
        animation_glb(head, animation, name="t", texture_px=64, skeleton=False).parts[0].joint
        is None
    )


def test_resampled_parts_still_share_their_joint(head: Head, animation: HeadAnimation) -> None:
    later = animation.resampled(animation.time_s[2:9] + 0.001)

    assert joint_of(later, "tongue") == joint_of(later, "teeth_lower") == "jaw"


def test_frames_as_shapes_show_the_same(
    tmp_path: Path, head: Head, animation: HeadAnimation
) -> None:
    twice = animation.resampled(np.arange(30) / 60)
    curves = frame_curves(twice)
    assert (np.count_nonzero(curves.weights, axis=1) <= 1).all()
    write_glb(
        tmp_path / "a.glb", animation_glb(head, twice, name="t", texture_px=64, curves=curves)
    )

    skin = next(p for p in read_glb(tmp_path / "a.glb").parts if p.name == "skin")

    triangles = head.mesh.triangles[head.mesh.groups["skin"]]
    for frame in (0, 9, 29):
        error = np.abs(shown(skin, frame)[skin.triangles] - twice.vertices(frame)[triangles]).max()
        assert error < 1e-4, f"frame {frame}: {error:.2g} mm off"


def test_poses_that_repeat_are_one_shape(drive: HeadDrive) -> None:
    t = np.arange(9) / 25
    swinging = np.array([0.0, 100.0, 200.0] * 3)
    clip = Clip(t, ("raise_l_i_eyebrow",), swinging[:, None])

    curves = frame_curves(drive.animate(clip))

    assert curves.names == ("frame_1", "frame_2")
    assert curves.weights[:, 0].tolist() == [0, 1, 0] * 3


def test_too_many_frames_for_shapes_are_refused(drive: HeadDrive) -> None:
    n = MAX_FRAME_SHAPES + 2
    clip = Clip(np.arange(n) / 25, ("raise_l_i_eyebrow",), np.linspace(0.0, 99.0, n)[:, None])

    with pytest.raises(InputError, match=f"{n - 1} of them, more than {MAX_FRAME_SHAPES}"):
        frame_curves(drive.animate(clip))


@pytest.fixture(scope="module")
def by_shapes(head: Head) -> HeadAnimation:
    t = np.arange(6) / 30
    values = np.stack([0.1 * np.arange(6), 0.2 + 0.05 * np.arange(6)], axis=1)
    return ShapeDrive(head).animate(Clip(t, ("jawOpen", "mouthSmileLeft"), values))


def test_shapes_keep_names_offsets_and_weights(head: Head, by_shapes: HeadAnimation) -> None:
    scene = animation_glb(head, by_shapes, name="t", texture_px=64)
    skin = next(p for p in scene.parts if p.name == "skin")
    rows = np.unique(head.mesh.triangles[head.mesh.groups["skin"]])

    assert {t.name for t in skin.targets} == {"jawOpen", "mouthSmileLeft"}
    assert skin.weights is not None and head.shapes is not None
    for k, target in enumerate(skin.targets):
        truth = 0.1 * np.arange(6) if target.name == "jawOpen" else 0.2 + 0.05 * np.arange(6)
        np.testing.assert_allclose(skin.weights[:, k], truth, atol=1e-12)
        largest = np.abs(head.shapes[head.shape_names.index(target.name)][rows]).max()
        assert np.abs(target.offsets).max() == pytest.approx(largest, rel=1e-6)


@pytest.mark.parametrize("which", ["points", "shapes", "frames"])
def test_the_khronos_validator_finds_nothing(
    tmp_path: Path, head: Head, animation: HeadAnimation, by_shapes: HeadAnimation, which: str,
    khronos_issues: Callable[[Path], dict[str, Any]],
) -> None:  # fmt: skip
    moving = by_shapes if which == "shapes" else animation
    curves = frame_curves(moving) if which == "frames" else None
    scene = animation_glb(head, moving, name="test", texture_px=64, curves=curves)
    write_glb(tmp_path / "head.glb", scene)

    issues = khronos_issues(tmp_path / "head.glb")

    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


@pytest.mark.parametrize("which", ["points", "shapes"])
def test_usds_own_skinning_equals_our_vertices(
    tmp_path: Path, head: Head, animation: HeadAnimation, by_shapes: HeadAnimation, which: str
) -> None:
    pytest.importorskip("pxr.UsdSkel", reason="needs the package usd-core")
    from pxr import Usd, UsdGeom, UsdSkel

    moving = by_shapes if which == "shapes" else animation
    write_usd(
        tmp_path / "a.usdc", animation_glb(head, moving, name="t", texture_px=64), rate=Fraction(30)
    )

    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert UsdSkel.BakeSkinning(stage.Traverse())
    for frame in (0, 2, 5):
        motion = moving.motion
        turn = rotation_from_quaternion(motion.quaternion[frame])
        truth = (moving.vertices(frame) @ turn.T + motion.translation[frame]) / 1000
        for name, rows in head.mesh.groups.items():
            mesh = UsdGeom.Mesh.Get(stage, f"/Head/{name}")
            points = np.array(mesh.GetPointsAttr().Get(frame), dtype=np.float64)
            matrix = np.array(mesh.ComputeLocalToWorldTransform(frame))
            found = points @ matrix[:3, :3] + matrix[3, :3]
            corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
            error_m = np.abs(found[corners] - truth[head.mesh.triangles[rows]]).max()
            assert error_m < 1e-6, f"{name}, frame {frame}: {error_m:.2g} m off"


def test_weights_stay_within_one_and_alike_curves_are_joined(animation: HeadAnimation) -> None:
    curves = motion_curves(animation)
    assert curves.weights.max() == pytest.approx(1)
    assert curves.weights.min() == 0  # Blender and others cut off what is below
    d = animation.displacements
    n_one_way = int((d.max(axis=0) > 1e-6).sum() + (d.min(axis=0) < -1e-6).sum())
    assert len(curves.names) < 0.9 * n_one_way
    assert any("+" in name for name in curves.names)
    assert len(set(curves.names)) == len(curves.names)
    rebuilt = (curves.amounts @ curves.weights.T).T.reshape(animation.displacements.shape)
    np.testing.assert_allclose(rebuilt, animation.displacements, atol=3e-5)


def test_normals_of_blendshapes_are_those_of_the_moved_surface(
    head: Head, animation: HeadAnimation
) -> None:
    from facewright.core.mesh import vertex_normals

    skin = next(
        p for p in animation_glb(head, animation, name="t", texture_px=64).parts if p.name == "skin"
    )
    target = max(skin.targets, key=lambda t: len(t.rows))
    moved = np.array(skin.vertices)
    moved[target.rows] += target.offsets
    assert target.normal_offsets is not None
    inner = vertex_normals(moved, skin.triangles)[target.rows]
    found = skin.normals[target.rows] + target.normal_offsets
    agree = (inner * found).sum(axis=1)
    assert np.median(agree) > 0.999  # seams apart, where `inner` sees one side only


def test_resampling_keeps_the_keys_and_is_between_them(animation: HeadAnimation) -> None:
    half = animation.resampled(animation.time_s[:-1] + np.diff(animation.time_s) / 2)
    wanted = (animation.displacements[1:] + animation.displacements[:-1]) / 2
    np.testing.assert_allclose(half.displacements, wanted, atol=1e-9)
    same = animation.resampled(animation.time_s)
    np.testing.assert_allclose(same.vertices(5), animation.vertices(5), atol=1e-9)
    with pytest.raises(ValueError, match="times must lie in"):
        animation.resampled([5.0])


def test_another_heads_animation_is_refused(animation: HeadAnimation) -> None:
    from facewright.heads.identity import Identity, make_head

    with pytest.raises(ValueError, match="another head"):
        animation_glb(make_head(Identity("other")), animation, name="x")
