from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.points_csv import read_points

ROWS = np.array([[1.0, 2.0, 3.0, 10.5, 20.5], [-4.0, 5.5, 0.0, 0.0, 700.25]])


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("X,Y,Z,u,v\n1,2,3,10.5,20.5\n-4,5.5,0,0,700.25\n", [2, 3]),
        ("v,u,Z,Y,X\n20.5,10.5,3,2,1\n700.25,0,0,5.5,-4\n", [2, 3]),
        ("name; x; y; z; U; V\nchin; 1; 2; 3; 10.5; 20.5\nbrow; -4; 5.5; 0; 0; 700.25\n", [2, 3]),
        (" 1.0e+00  2 3   10.5 20.5\n\n# a remark\n-4 5.5 0 0 700.25", [1, 4]),
        ("\ufeffX\tY\tZ\tu\tv\r\n1\t2\t3\t10.5\t20.5\r\n-4\t5.5\t0\t0\t700.25\r\n", [2, 3]),
    ],
)
def test_columns_are_found_by_name_or_by_place(tmp_path: Path, text: str, lines: list[int]) -> None:
    found = read_points(written(tmp_path / "points.csv", text))

    np.testing.assert_array_equal(np.hstack([found.points, found.pixels]), ROWS)
    assert found.lines.tolist() == lines


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("X,Y,Z,u,v\n1,2,3,4,5\n1,2,chin,4,5\n", ("line 3", '"chin"')),
        ("1 2 3 4 5\n1 2 nan 4 5\n", ("line 2", "nan")),
        ("1 2 3 4 5\n1 2 3 4 inf\n", ("line 2", "inf")),
        ("1,2,3,4,5\n1,2,3,4\n", ("line 2", "4 values")),
        ("1,2,3,4\n", ("line 1", "5 columns X,Y,Z,u,v")),
        ("X,Y,u,v\n1,2,3,4\n", ("line 1", "X,Y,u,v")),
        ("X,Y,Z,u,u\n1,2,3,4,5\n", ("line 1", "each once")),
        ("X,Y,Z,u,v\n", ("no point",)),
        ("\x00\x01\x02\x03", ("line 1",)),
        ("", ("empty file",)),
    ],
)
def test_bad_file_is_refused_with_its_line(
    tmp_path: Path, text: str, told: tuple[str, ...]
) -> None:
    path = written(tmp_path / "points.csv", text)

    with pytest.raises(FileFormatError) as caught:
        read_points(path)

    assert str(path) in str(caught.value)
    assert not [word for word in told if word not in str(caught.value)], str(caught.value)
