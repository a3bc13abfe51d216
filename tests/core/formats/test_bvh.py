"""Joints as .bvh, judged by the format's own rules, spelt out here."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.bvh import BvhJoint, BvhMotion, write_bvh
from facewright.core.formats.bvh_read import read_bvh

N_FRAMES = 7


def quaternions(seed: int) -> NDArray[np.float64]:
    vectors = np.random.default_rng(seed).normal(scale=0.5, size=(N_FRAMES, 3))
    return np.asarray(Rotation.from_rotvec(vectors).as_quat(scalar_first=True))


def some_motion(rate: Fraction = Fraction(30000, 1001)) -> BvhMotion:
    shift = np.random.default_rng(5).normal(scale=10, size=(N_FRAMES, 3))
    still = np.zeros((N_FRAMES, 3))
    return BvhMotion(
        (
            BvhJoint("Head", -1, np.array([1.0, -120.0, 30.0]), quaternions(1), shift),
            BvhJoint("Jaw", 0, np.array([0.0, 90.0, 10.0]), quaternions(2), shift[::-1]),
            BvhJoint("LeftEye", 0, np.array([31.0, 120.0, 60.0]), quaternions(3), still),
        ),
        rate,
    )


def places(text: str, frame: int) -> dict[str, NDArray[np.float64]]:
    """World matrices, cm, of the three joints by the channels' order in the file."""
    rows = text.split("Frame Time:")[1].splitlines()[1:]
    values = [float(x) for x in rows[frame].split()]
    found: dict[str, NDArray[np.float64]] = {}
    words = text.split("MOTION")[0].split()
    stack: list[str] = []
    offset = np.zeros(3)
    i = 0
    while i < len(words):
        if words[i] in ("ROOT", "JOINT", "End"):
            stack.append(words[i + 1])
        elif words[i] == "OFFSET":
            offset = np.array([float(x) for x in words[i + 1 : i + 4]])
        elif words[i] == "CHANNELS":
            local = np.eye(4)
            local[:3, 3] = offset
            for channel in words[i + 2 : i + 2 + int(words[i + 1])]:
                value, axis = values.pop(0), "XYZ".index(channel[0])
                if channel.endswith("position"):
                    local[axis, 3] = value
                else:
                    vector = np.deg2rad(value) * np.eye(3)[axis]
                    local[:3, :3] = local[:3, :3] @ Rotation.from_rotvec(vector).as_matrix()
            parent = found[stack[-2]] if len(stack) > 1 else np.eye(4)
            found[stack[-1]] = parent @ local
        elif words[i] == "}":
            stack.pop()
        i += 1
    assert not values
    return found


def test_joints_stand_where_the_channels_put_them(tmp_path: Path) -> None:
    motion = some_motion()
    write_bvh(tmp_path / "a.bvh", motion)
    text = (tmp_path / "a.bvh").read_text()

    for frame in range(N_FRAMES):
        found = places(text, frame)
        world: list[NDArray[np.float64]] = []
        for joint in motion.joints:
            local = np.eye(4)
            local[:3, :3] = Rotation.from_quat(joint.rotation[frame], scalar_first=True).as_matrix()
            local[:3, 3] = (joint.offset + joint.translation[frame]) / 10
            world.append(local if joint.parent < 0 else world[joint.parent] @ local)
        for joint, expected in zip(motion.joints, world, strict=True):
            np.testing.assert_allclose(found[joint.name], expected, atol=3e-6)


@pytest.mark.parametrize(
    "rate", [Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(60000, 1001), Fraction(60)]
)
def test_what_is_written_reads_back(tmp_path: Path, rate: Fraction) -> None:
    motion = some_motion(rate)
    write_bvh(tmp_path / "a.bvh", motion)

    found = read_bvh(tmp_path / "a.bvh")

    assert found.rate == rate
    for a, b in zip(found.joints, motion.joints, strict=True):
        assert (a.name, a.parent) == (b.name, b.parent)
        np.testing.assert_allclose(a.offset, b.offset, atol=1e-5)
        np.testing.assert_allclose(a.translation, b.translation, atol=2e-5)
        assert np.abs(np.abs((a.rotation * b.rotation).sum(axis=1)) - 1).max() < 1e-12


def test_a_nod_is_the_second_angle_in_degrees(tmp_path: Path) -> None:
    nod = Rotation.from_euler("x", [[0.0], [20.0]], degrees=True).as_quat(scalar_first=True)
    head = BvhJoint("Head", -1, np.zeros(3), nod, np.zeros((2, 3)))
    write_bvh(tmp_path / "a.bvh", BvhMotion((head,), Fraction(25)))

    lines = (tmp_path / "a.bvh").read_text().splitlines()

    assert lines[4].split()[2:] == [
        "Xposition", "Yposition", "Zposition", "Yrotation", "Xrotation", "Zrotation",
    ]  # fmt: skip
    assert lines[-1].split() == ["0", "0", "0", "0", "20", "0"]
    assert lines[-3] == "Frame Time: 0.0400000000"


def test_angles_do_not_jump_by_whole_turns(tmp_path: Path) -> None:
    yaw = np.linspace(0, 400, N_FRAMES)[:, None]
    turn = Rotation.from_euler("y", yaw, degrees=True).as_quat(scalar_first=True)
    head = BvhJoint("Head", -1, np.zeros(3), turn, np.zeros((N_FRAMES, 3)))
    write_bvh(tmp_path / "a.bvh", BvhMotion((head,), Fraction(25)))

    rows = (tmp_path / "a.bvh").read_text().split("Frame Time:")[1].splitlines()[1:]

    np.testing.assert_allclose([float(row.split()[3]) for row in rows], yaw[:, 0], atol=1e-5)


def test_no_frame_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    head = BvhJoint("Head", -1, np.zeros(3), np.zeros((0, 4)), np.zeros((0, 3)))

    with pytest.raises(InputError, match="no frame"):
        write_bvh(tmp_path / "a.bvh", BvhMotion((head,), Fraction(25)))

    assert not list(tmp_path.iterdir())


def good_text() -> str:
    return (
        "HIERARCHY\nROOT Head\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
        "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 2\nFrame Time: 0.04\n10 0 0\n0 90 0\n"
    )


def test_channels_of_others_are_applied_in_their_order(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(good_text().replace("0 90 0\n", "90 90 0\n"))

    rotation = read_bvh(tmp_path / "a.bvh").joints[0].rotation[1]

    matrix = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    np.testing.assert_allclose(matrix @ [0, 1, 0], [0, 0, 1], atol=1e-12)  # Rz Rx


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("HIERARCHY", "MESH"), "line 1: expected HIERARCHY"),
        (("MOTION", "MOTON"), "expected MOTION"),
        (("ROOT", "JOINT"), "line 2"),
        (("OFFSET 0 0 0", "OFFSET 0 0 nan"), 'line 4: expected a number, found "nan"'),
        (("OFFSET 0 0 0", "OFFSET 0 0"), "expected a number"),
        (("CHANNELS 3", "CHANNELS 7"), "0 to 6 channels"),
        (("Zrotation", "Wrotation"), "channels such as"),
        (("Zrotation", "Xrotation"), "each once"),
        (("Frames: 2", "Frames: 3"), "expected 3 frames, found 2"),
        (("Frames: 2", "Frames: -2"), "Frames: a number"),
        (("Frame Time: 0.04", "Frame Time: 0"), "Frame Time: seconds"),
        (("10 0 0", "10 0"), "line 14: expected 3 values, found 2"),
        (("10 0 0", "10 x 0"), 'line 14: expected numbers, found "x"'),
        (("}\n}\n", "}\n"), "a whole one"),
    ],
)
def test_a_bad_file_is_refused_with_its_place(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = tmp_path / "bad.bvh"
    path.write_text(good_text().replace(*change, 1))

    with pytest.raises(FileFormatError) as caught:
        read_bvh(path)

    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}, ")


def test_a_file_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    text = good_text()
    for length in range(len(text.rstrip()) - 5):
        (tmp_path / "cut.bvh").write_text(text[:length])
        with pytest.raises(FileFormatError):
            read_bvh(tmp_path / "cut.bvh")
