"""Meshes from files: seams are stitched, lips are not, what is odd is said."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import FacewrightError
from facewright.core.formats.gltf import GltfPart, GltfScene, MorphTarget, glb_bytes
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.mesh import Mesh, vertex_normals
from facewright.heads.own_files import read_own_mesh
from facewright.heads.own_mesh import OwnMesh, shells
from facewright.heads.subdivision import icosphere


def soup() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A ball each of whose triangles has vertices of its own."""
    v, t = icosphere(2)
    return v[t.ravel()], np.arange(t.size, dtype=np.int32).reshape(-1, 3)


def read_ply_of(folder: Path, v: NDArray[np.float64], t: NDArray[np.int32]) -> OwnMesh:
    write_ply(folder / "m.ply", PlyMesh(Mesh(v, t)), double=True)
    return read_own_mesh(folder / "m.ply")


def test_a_ball_cut_along_every_edge_is_whole_again(tmp_path: Path) -> None:
    v, t = soup()

    found = read_ply_of(tmp_path, v, t)

    edges = np.unique(np.sort(found.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    assert len(found.vertices) - len(edges) + len(found.triangles) == 2  # Euler: a ball
    assert len(shells(found.triangles, len(found.vertices))) == 1
    assert any("joined" in note for note in found.notes)
    np.testing.assert_allclose(found.vertices[found.triangles], v[t])


def test_surfaces_that_only_touch_stay_apart(tmp_path: Path) -> None:
    v, t = icosphere(2)
    # the second ball's vertices lie on the first one's, its triangles face the other way
    found = read_ply_of(tmp_path, np.concatenate([v, v]), np.concatenate([t, t[:, ::-1] + len(v)]))

    assert len(found.vertices) == 2 * len(v)
    assert len(shells(found.triangles, len(found.vertices))) == 2


@pytest.mark.parametrize(("lift", "n_shells"), [(0.0, 1), (2.0, 2)])
def test_sides_that_a_shape_parts_are_lips_and_stay_apart(
    tmp_path: Path, lift: float, n_shells: int
) -> None:
    grid = np.array([[x, y, 0.0] for y in (0, 1, 1, 2) for x in range(4)], dtype=np.float64)
    quads = [(4 * r + c, 4 * r + c + 1, 4 * r + c + 5, 4 * r + c + 4)
             for r in (0, 2) for c in range(3)]  # fmt: skip
    t = np.array(
        [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads], np.int32
    )
    rows = np.arange(8, 12, dtype=np.int32)
    opened = MorphTarget("open", rows, np.full((4, 3), lift) * (0, 1, 0))
    part = GltfPart("m", grid, t, vertex_normals(grid, t), targets=(opened,))
    (tmp_path / "m.glb").write_bytes(glb_bytes(GltfScene("m", (part,), np.zeros(0))))

    found = read_own_mesh(tmp_path / "m.glb")

    assert len(shells(found.triangles, len(found.vertices))) == n_shells
    assert found.shape_names == ("open",)


def test_odd_meshes_are_taken_and_it_is_said(tmp_path: Path) -> None:
    v, t = icosphere(1)
    third = np.array([[t[0, 0], t[0, 1], len(v)], [t[1, 0], t[1, 0], t[1, 2]]], dtype=np.int32)

    found = read_ply_of(tmp_path, np.concatenate([v, [[3.0, 0, 0]]]), np.concatenate([t, third]))

    assert any("non-manifold" in note for note in found.notes)
    assert any("without an area" in note for note in found.notes)
    assert len(found.triangles) == len(t) + 1


def changed_glb(extensions: dict[str, list[str]]) -> bytes:
    v, t = icosphere(1)
    data = glb_bytes(GltfScene("b", (GltfPart("b", v, t, v),), np.zeros(0)))
    size = struct.unpack_from("<I", data, 12)[0]
    document = {**json.loads(data[20 : 20 + size]), **extensions}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return header + struct.pack("<I4s", len(text), b"JSON") + text + rest


def test_unknown_extensions_are_said_and_needed_ones_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.vrm"
    path.write_bytes(changed_glb({"extensionsUsed": ["ACME_fur", "VRMC_vrm"]}))
    said = read_own_mesh(path).notes
    path.write_bytes(changed_glb({"extensionsRequired": ["KHR_draco_mesh_compression"]}))

    assert any("ACME_fur" in note and "VRMC" not in note for note in said)
    with pytest.raises(FacewrightError, match="Draco"):
        read_own_mesh(path)


def test_shape_names_are_kept_as_they_are_written(tmp_path: Path) -> None:
    """In another case, another language, with dots and spaces."""
    v, t = icosphere(2)
    names = ("JAWOPEN", "Fcl_EYE_Close_L", "まばたき", "mouth smile.left", "jawOpen")
    rows = np.arange(4, dtype=np.int32)
    targets = tuple(
        MorphTarget(name, rows, np.full((4, 3), float(i + 1))) for i, name in enumerate(names)
    )
    part = GltfPart("m", v, t, v, targets=targets)
    (tmp_path / "m.glb").write_bytes(glb_bytes(GltfScene("m", (part,), np.zeros(0))))

    found = read_own_mesh(tmp_path / "m.glb")

    assert found.shape_names == names
    assert found.shapes is not None
    for i, shape in enumerate(found.shapes):
        np.testing.assert_allclose(shape.max(), i + 1, rtol=1e-6)


def test_numbers_that_are_none_are_refused_in_every_format(tmp_path: Path) -> None:
    v, t = icosphere(1)
    data = bytearray(glb_bytes(GltfScene("b", (GltfPart("b", v, t, v),), np.zeros(0))))
    first = np.float32(v[0, 0] / 1000.0).tobytes()  # metres
    at = data.find(first, data.find(b"BIN"))
    data[at : at + 4] = np.float32(np.nan).tobytes()
    (tmp_path / "nan.glb").write_bytes(data)
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "nan.ply").write_text(header + "0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n")

    for name in ("nan.glb", "nan.ply"):
        with pytest.raises(FacewrightError, match="finite"):
            read_own_mesh(tmp_path / name)


def test_not_finite_not_a_mesh_not_a_head_file(tmp_path: Path) -> None:
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    (tmp_path / "head.fbx").write_text("x")

    for name, said in (
        ("nan.obj", "finite"),
        ("flat.obj", "no extent"),
        ("head.fbx", "expected a head in a file"),
    ):
        with pytest.raises(FacewrightError, match=said):
            read_own_mesh(tmp_path / name)
