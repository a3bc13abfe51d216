"""Wavefront meshes: as Open3D reads them, what the format allows, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.obj import read_obj
from facewright.heads.raycast import import_open3d

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "mesh.obj"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_real_file_is_read_as_open3d_reads_it(real_data: Path) -> None:
    path = real_data / "heads" / "canonical_face_model.obj"
    theirs = import_open3d().io.read_triangle_mesh(str(path))

    ours = read_obj(path).mesh

    # Open3D sorts the vertices anew, so that corners are compared
    corners = np.asarray(theirs.vertices)[np.asarray(theirs.triangles)]
    np.testing.assert_allclose(ours.vertices[ours.triangles], corners, atol=1e-6)
    assert len(ours.vertices) == 468
    assert ours.uv is not None and ours.uv_triangles is not None
    corner_uv = ours.uv[ours.uv_triangles].reshape(-1, 2)
    np.testing.assert_allclose(corner_uv, np.asarray(theirs.triangle_uvs), atol=1e-6)


def test_polygons_become_fans_and_negative_indices_count_back(tmp_path: Path) -> None:
    counted_back = read_obj(written(tmp_path, SQUARE + "f -4 -3 -2 -1\n")).mesh
    from_one = read_obj(written(tmp_path, SQUARE + "f 1//1 2//1 3//1 4//1\n")).mesh

    assert counted_back.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert from_one.triangles.tolist() == counted_back.triangles.tolist()


def test_objects_groups_and_materials_name_the_parts(tmp_path: Path) -> None:
    (tmp_path / "looks.mtl").write_text("newmtl red\nKd 1 0 0.5\nmap_Kd skin.png\n")
    text = "mtllib looks.mtl\n" + SQUARE + "o Head\nusemtl red\nf 1 2 3\no Eye_L\nf 1 3 4\n"

    found = read_obj(written(tmp_path, text))

    assert {name: rows.tolist() for name, rows in found.mesh.groups.items()} == {
        "Head/red": [0],
        "Eye_L/red": [1],
    }
    assert found.materials["Head/red"].colour == (1.0, 0.0, 0.5)
    assert found.materials["Head/red"].picture == "skin.png"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SQUARE + "f 1 2 5\n", 'line 5: expected vertices 1 to 4, found "5"'),
        (SQUARE + "f 1 2 0\n", "line 5: expected vertices 1 to 4"),
        (SQUARE + "f 1 2\n", "line 5: expected at least 3 corners, found 2"),
        ("v 0 nan 0\n", "line 1: expected 3 finite numbers x y z"),
        ("v 0 1e99 0\n", "line 1: expected 3 finite numbers x y z"),
        ("v 0 0\n", "line 1: expected 3 finite numbers x y z"),
        (SQUARE, "no polygon"),
        ("\x00\x01junk", "no polygon"),
        ("", "empty"),
    ],
)
def test_damage_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(FileFormatError) as error:
        read_obj(written(tmp_path, text))

    assert said in str(error.value)
