from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.ply import PlyMesh, read_ply, write_ply
from facewright.core.mesh import Mesh
from facewright.heads.raycast import import_open3d

CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * 10
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])  # fmt: skip  # noqa: E501


def bumpy_mesh(seed: int = 5) -> PlyMesh:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(0, 80, (400, 3))
    triangles = np.stack([rng.permutation(400)[:3] for _ in range(700)])
    uv = rng.uniform(0, 1, (350, 2)).astype(np.float32).astype(np.float64)
    uv_triangles = rng.integers(0, 350, (700, 3))
    colour = rng.integers(0, 256, (400, 3))
    mesh = Mesh(vertices, triangles.astype(np.int32), uv, uv_triangles.astype(np.int32))
    return PlyMesh(mesh, colour.astype(np.uint8), "skin of ruth.png")


def text_ply(path: Path, *, faces: list[str] | None = None, vertices: str = "3") -> Path:
    body = ["0 0 0", "1 0 0", "0 1 0"]
    rows = ["3 0 1 2"] if faces is None else faces
    lines = ["ply", "format ascii 1.0", f"element vertex {vertices}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header"]
    path.write_text("\n".join([*lines, *body, *rows, ""]))
    return path


@pytest.mark.parametrize(("double", "allowed_mm"), [(True, 0.0), (False, 2e-5)])
def test_reads_back_what_was_written(tmp_path: Path, double: bool, allowed_mm: float) -> None:
    written = bumpy_mesh()

    write_ply(tmp_path / "a.ply", written, double=double)
    read = read_ply(tmp_path / "a.ply")

    assert np.abs(read.mesh.vertices - written.mesh.vertices).max() <= allowed_mm
    assert (read.mesh.triangles == written.mesh.triangles).all()
    assert read.colour is not None and written.colour is not None
    assert (read.colour == written.colour).all()
    assert read.mesh.uv is not None and written.mesh.uv is not None
    assert read.mesh.uv_triangles is not None and written.mesh.uv_triangles is not None
    there = written.mesh.uv[written.mesh.uv_triangles]
    assert (read.mesh.uv[read.mesh.uv_triangles] == there).all()
    assert read.texture == "skin of ruth.png"


def test_open3d_reads_ours_and_we_read_open3d_s(tmp_path: Path) -> None:
    o3d = import_open3d()
    ours = bumpy_mesh()
    write_ply(tmp_path / "ours.ply", ours, double=True)

    theirs = o3d.io.read_triangle_mesh(str(tmp_path / "ours.ply"))

    assert np.abs(np.asarray(theirs.vertices) - ours.mesh.vertices).max() == 0
    assert (np.asarray(theirs.triangles) == ours.mesh.triangles).all()
    assert ours.colour is not None
    assert np.abs(np.asarray(theirs.vertex_colors) * 255 - ours.colour).max() < 0.51
    theirs.compute_vertex_normals()
    for ascii_ in (False, True):
        path = tmp_path / f"theirs_{ascii_}.ply"
        o3d.io.write_triangle_mesh(str(path), theirs, write_ascii=ascii_)
        read = read_ply(path)
        assert np.abs(read.mesh.vertices - ours.mesh.vertices).max() < 1e-3
        assert (read.mesh.triangles == ours.mesh.triangles).all()
        assert read.colour is not None and np.abs(read.colour - ours.colour.astype(int)).max() <= 1


@pytest.mark.parametrize("order", ["<", ">"])
def test_polygons_and_foreign_elements_of_both_byte_orders(tmp_path: Path, order: str) -> None:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = (
        f"ply\r\nformat {name} 1.0\r\nobj_info by hand\r\nelement vertex 8\r\n"
        "property double x\r\nproperty double y\r\nproperty double z\r\nproperty short weight\r\n"
        "element face 7\r\nproperty uchar flags\r\nproperty list ushort uint vertex_index\r\n"
        "element edge 1\r\nproperty int a\r\nend_header\r\n"
    )
    body = b"".join(
        np.array(row, f"{order}f8").tobytes() + np.array(9, f"{order}i2").tobytes() for row in CUBE
    )
    for face in [*QUADS.tolist(), [0, 1, 2]]:  # of two lengths
        body += b"\x07" + np.array(len(face), f"{order}u2").tobytes()
        body += np.array(face, f"{order}u4").tobytes()
    path = tmp_path / "cube.ply"
    path.write_bytes(header.encode() + body + np.array(1, f"{order}i4").tobytes())

    mesh = read_ply(path).mesh

    assert (mesh.vertices == CUBE).all()
    assert len(mesh.triangles) == 13
    corners = mesh.vertices[mesh.triangles[:12]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)  # fmt: skip  # noqa: E501
    volume = np.linalg.det(corners).sum() / 6
    assert area.sum() / 2 == pytest.approx(600)
    assert abs(volume) == pytest.approx(1000)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: b"", "empty"),
        (lambda d: b"\x89PNG" + d, "expected ply"),
        (lambda d: d[:-3], "700 rows of face, found the file's end"),
        (lambda d: d[:60], "end_header"),
        (lambda d: d.replace(b"vertex 400", b"vertex 999"), "finite|end"),
        (lambda d: d.replace(b"vertex 400", b"vertex 9999999"), "at least"),
        (lambda d: d.replace(b"vertex 400", b"vertex 99999999999"), "at most"),
        (lambda d: d.replace(b"vertex 400", b"vertex many"), "NAME COUNT"),
        (lambda d: d.replace(b"float x", b"quark x"), "property TYPE NAME"),
        (lambda d: d.replace(b"little_endian", b"mixed_endian"), "binary_big_endian"),
        (lambda d: d.replace(b"float y", b"float q"), "a number y"),
        (lambda d: d.replace(b"vertex_indices", b"vertex_indicts"), "point cloud"),
    ],
)
def test_damaged_files_are_refused_with_the_reason(tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.ply"
    write_ply(path, bumpy_mesh())
    path.write_bytes(change(path.read_bytes()))

    with pytest.raises(FileFormatError, match=words):
        read_ply(path)


@pytest.mark.parametrize(
    ("faces", "where", "found"),
    [
        (["3 0 1 2", "3 0 1 3"], "face 1", "found 3"),
        (["3 0 -1 2"], "face 0", "found -1"),
        (["2 0 1"], "face 0", "found 2"),
        (["3 0 1"], "line 13", "found 3 0 1"),
        (["3 0 1 2 9"], "line 13", "9"),
        (["3 0 one 2"], "line 13", "one"),
        (["3 0 1 99999999999999999999"], "line 13", "9999"),
        (["4000000 0 1 2"], "line 13", "4000000"),
    ],
)
def test_wrong_faces_are_named(tmp_path: Path, faces: list[str], where: str, found: str) -> None:
    path = text_ply(tmp_path / "a.ply", faces=faces)

    with pytest.raises(FileFormatError) as caught:
        read_ply(path)

    assert where in str(caught.value) and found in str(caught.value)


def test_nan_is_refused_by_reader_and_writer(tmp_path: Path) -> None:
    path = text_ply(tmp_path / "a.ply")
    path.write_text(path.read_text().replace("1 0 0", "1 nan 0"))
    with pytest.raises(FileFormatError, match="vertex 1"):
        read_ply(path)

    mesh = Mesh(np.array([[0, 0, np.nan], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(ValueError, match="finite"):
        write_ply(tmp_path / "b.ply", PlyMesh(mesh))
    assert not (tmp_path / "b.ply").exists()


def test_every_truncation_ends_in_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    small = Mesh(CUBE, np.concatenate([QUADS[:, :3], QUADS[:, [0, 2, 3]]]).astype(np.int32))
    write_ply(path, PlyMesh(small))
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(FileFormatError):
            read_ply(path)
