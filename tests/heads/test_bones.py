"""Skull and mandible inside built-in heads."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.mesh import Mesh
from facewright.heads.bones import Bones, make_bones
from facewright.heads.decimation import decimate
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity
from facewright.heads.raycast import RayScene, import_open3d

Floats = NDArray[np.float64]

N_FAST = 3
PEOPLE = [pytest.param(i, marks=() if i < N_FAST else pytest.mark.slow) for i in range(20)]


@lru_cache(maxsize=2)
def person(seed: int) -> tuple[Head, Bones]:
    head = make_head(random_identity(np.random.default_rng(seed), f"person-{seed}"))
    return head, make_bones(head)


def bone_of(mesh: Mesh) -> tuple[Floats, NDArray[np.int32]]:
    used, rows = np.unique(mesh.triangles[mesh.groups["bone"]], return_inverse=True)
    return mesh.vertices[used], rows.reshape(-1, 3).astype(np.int32)


def volume(v: Floats, t: NDArray[np.int32]) -> float:
    a, b, c = v[t[:, 0]], v[t[:, 1]], v[t[:, 2]]
    return float((np.cross(a, b) * c).sum() / 6)


@pytest.mark.parametrize("seed", PEOPLE)
def test_bones_are_closed_and_face_outwards(seed: int) -> None:
    _, bones = person(seed)

    for mesh, litres in ((bones.skull, (1.0, 5.0)), (bones.mandible, (0.02, 0.2))):
        v, t = bone_of(mesh)
        edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        assert len(np.unique(edges, axis=0)) == len(edges)  # no edge twice the same way round
        forth = {(int(a), int(b)) for a, b in edges}
        assert all((b, a) in forth for a, b in forth)  # and each once the other way
        assert litres[0] < volume(v, t) / 1e6 < litres[1]  # positive: normals point outwards


def closed_skin(head: Head) -> tuple[Floats, NDArray[np.int32]]:
    """The outer skin, its openings (lips, lids, neck, ears) closed by fans."""
    inside = [head.regions[n] for n in ("inner_mouth", "socket_l", "socket_r")]
    outer = np.setdiff1d(head.mesh.groups["skin"], np.concatenate(inside))
    triangles = head.mesh.triangles[outer]
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in edges}
    onward = {b: a for a, b in there if (b, a) not in there}  # along the border, skin on the right
    vertices, caps = list(head.mesh.vertices), []
    while onward:
        loop = [next(iter(onward))]
        while loop[-1] in onward:
            loop.append(onward.pop(loop[-1]))
        middle = len(vertices)
        vertices.append(head.mesh.vertices[loop].mean(axis=0))
        caps += [(a, b, middle) for a, b in pairwise(loop)]
    return np.array(vertices), np.concatenate([triangles, np.array(caps)]).astype(np.int32)


@pytest.mark.parametrize("seed", PEOPLE)
def test_no_bone_comes_through_the_skin(seed: int) -> None:
    head, bones = person(seed)
    o3d = import_open3d()
    v, t = closed_skin(head)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(v.astype(np.float32)), o3d.core.Tensor(t.astype(np.uint32)))

    for mesh in (bones.skull, bones.mandible):
        p, _ = bone_of(mesh)
        inside = scene.compute_occupancy(o3d.core.Tensor(p.astype(np.float32)), nsamples=5).numpy()
        assert inside.all(), f"{(inside == 0).sum()} vertices are outside, at {p[inside == 0][:3]}"
    beyond = np.array([[0.0, 0.0, 80.0], [0.0, 200.0, 0.0]], dtype=np.float32)
    assert not scene.compute_occupancy(o3d.core.Tensor(beyond), nsamples=5).numpy().any()


@pytest.mark.parametrize("seed", PEOPLE)
def test_tissue_is_as_thick_as_the_table_says(seed: int) -> None:
    head, bones = person(seed)
    assert head.mesh.landmarks is not None
    at = dict(
        zip(head.mesh.landmarks.names, head.mesh.landmarks.at(head.mesh.vertices), strict=True)
    )
    skull = RayScene(*bone_of(bones.skull))
    mandible = RayScene(*bone_of(bones.mandible))

    # landmark, its table value in mm, the bone below
    for name, mm, bone in (
        ("g", 5.5, skull),
        ("v", 5.0, skull),
        ("op", 6.5, skull),
        ("zy_l", 6.0, skull),
        ("pg", 11.0, mandible),
    ):
        found, *_ = bone.closest(at[name][None])
        tissue = float(np.linalg.norm(found[0] - at[name]))
        assert 0.5 * mm < tissue < 1.8 * mm, f"{name}: {tissue:.1f} mm, table {mm} mm"


@pytest.mark.parametrize("seed", PEOPLE)
def test_eyes_lie_in_orbits_and_teeth_on_their_bones(seed: int) -> None:
    head, bones = person(seed)
    skull = RayScene(*bone_of(bones.skull))

    for side in ("right", "left"):
        eye = head.part_vertices(f"eye_{side}")
        front = head.mesh.vertices[eye][head.mesh.vertices[eye, 2] > 7]
        t, *_ = skull.cast(front, np.tile([0.0, 0.0, 1.0], (len(front), 1)))
        # the rim may stand before a corner of the ball
        assert np.isfinite(t).mean() < 0.02, f"bone before the {side} eye"
    for mesh, part in ((bones.skull, "teeth_upper"), (bones.mandible, "teeth_lower")):
        teeth = np.unique(mesh.triangles[mesh.groups["teeth"]])
        original = head.mesh.vertices[head.part_vertices(part)]
        assert (mesh.vertices[teeth] == original).all()


@pytest.mark.parametrize("seed", PEOPLE)
def test_hinge_runs_through_the_condyles_about_the_jaw_pivot(seed: int) -> None:
    head, bones = person(seed)

    assert bones.hinge.mean(axis=0) == pytest.approx(head.jaw_pivot, abs=1e-9)
    assert bones.hinge[0, 0] < -35 < 35 < bones.hinge[1, 0]
    closest, *_ = RayScene(*bone_of(bones.mandible)).closest(bones.hinge)
    assert np.linalg.norm(closest - bones.hinge, axis=1).max() < 10


def test_both_halves_of_an_average_skull_are_alike() -> None:
    bones = make_bones(make_head(Identity("average")))

    v, t = bone_of(bones.mandible)

    off, *_ = RayScene(v, t).closest(v * (-1, 1, 1))
    assert np.linalg.norm(off - v * (-1, 1, 1), axis=1).max() < 1.0


def test_heads_without_regions_are_refused() -> None:
    head = make_head(Identity("average"))

    with pytest.raises(InputError, match="bones are made for heads"):
        make_bones(decimate(head, 3000))
