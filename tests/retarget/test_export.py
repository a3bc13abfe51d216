from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.clip import Clip
from facewright.core.formats.gltf import GltfPart, read_glb, write_glb
from facewright.core.mpeg4 import fap_by_name
from facewright.core.rigid import rotation_from_quaternion
from facewright.heads.head import Head
from facewright.retarget.animation import HeadAnimation
from facewright.retarget.drive import HeadDrive
from facewright.retarget.export import animation_glb, motion_curves


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


def test_weights_stay_within_one_and_alike_curves_are_joined(animation: HeadAnimation) -> None:
    curves = motion_curves(animation)
    assert np.abs(curves.weights).max() == pytest.approx(1)
    n_moving = int((np.abs(animation.displacements).max(axis=0) > 1e-6).sum())
    assert len(curves.names) < n_moving / 2
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
