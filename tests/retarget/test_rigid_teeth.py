from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from facewright.core.rigid import rotation_from_quaternion
from facewright.heads.head import Head
from facewright.retarget.rigid_teeth import RigidTeeth


def test_they_go_where_scipys_best_rotation_takes_them(average_head: Head) -> None:
    names = ("jawOpen", "jawLeft", "jawForward")
    rows = average_head.part_vertices("teeth_lower")
    weights = np.random.default_rng(5).uniform(0, 1, (6, 3))

    motion = RigidTeeth(average_head, names).motion(weights)

    rest = average_head.mesh.vertices[rows]
    for frame, w in enumerate(weights):
        shaped = average_head.shaped(dict(zip(names, w, strict=True)))[rows]
        best, _ = Rotation.align_vectors(shaped - shaped.mean(axis=0), rest - rest.mean(axis=0))
        wanted = best.apply(rest - rest.mean(axis=0)) + shaped.mean(axis=0)
        np.testing.assert_allclose(motion.moved(rest, frame), wanted, atol=1e-3)
        assert np.linalg.norm(wanted - rest, axis=1).max() > 0.5


def test_a_shape_that_is_rigid_is_kept_and_one_that_mirrors_is_not_followed(
    average_head: Head,
) -> None:
    turn = Rotation.from_euler("xyz", [25, -8, 5], degrees=True)
    rows = average_head.part_vertices("teeth_lower")
    v = average_head.mesh.vertices
    offsets = np.zeros((2, *v.shape), np.float32)
    offsets[0, rows] = turn.apply(v[rows]) + (1.0, -9.0, 2.0) - v[rows]
    offsets[1, rows, 0] = -2.2 * v[rows, 0]
    head = replace(average_head, shape_names=("turned", "mirrored"), shapes=offsets)

    teeth = RigidTeeth(head, ("turned", "mirrored"))
    motion = teeth.motion(np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]))

    np.testing.assert_allclose(motion.moved(v[rows], 0), v[rows] + offsets[0, rows], atol=1e-4)
    np.testing.assert_allclose(np.linalg.det(rotation_from_quaternion(motion.rotation)), 1.0)
    np.testing.assert_allclose(motion.moved(v[rows], 2), v[rows], atol=1e-9)


def test_a_frame_costs_microseconds(average_head: Head) -> None:
    """It once copied all shapes of the head for each call: 24 ms on a large head."""
    names = average_head.shape_names
    teeth = RigidTeeth(average_head, names)
    weights = np.random.default_rng(1).uniform(0, 1, (1, len(names)))
    teeth.motion(weights)

    taken = []
    for _ in range(20):
        start = time.process_time()
        teeth.motion(weights)
        taken.append(time.process_time() - start)

    assert min(taken) < 2e-3
