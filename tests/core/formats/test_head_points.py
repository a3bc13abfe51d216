"""Named points of a head: round trip, headers by hand, damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.head_points import read_head_points, write_head_points

HEADER = "kind,name,x_mm,y_mm,z_mm\n"


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points = {name: rng.normal(size=3) * 50 for name in ("8.3", "8.4", "en_l")}
    path = tmp_path / "head.points.csv"

    write_head_points(path, [("feature point", points)])

    found = read_head_points(path)
    assert list(found) == list(points)
    for name, p in points.items():
        np.testing.assert_allclose(found[name], p, atol=5.1e-5)


def test_columns_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "clicks.csv"
    path.write_text("# from a viewer\nz;name;x;y\n3;nose_tip;1;2\n")

    assert read_head_points(path)["nose_tip"].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,x,y\nnose_tip,1,2\n", "line 1: expected a header"),
        (HEADER + "feature point,8.3,1,2\n", "line 2: expected a name and 3 numbers"),
        (HEADER + "feature point,8.3,1,2,n/a\n", "line 2: expected 3 finite numbers"),
        (HEADER + "feature point,8.3,1,2,inf\n", "line 2: expected 3 finite numbers"),
        (HEADER + "a,8.3,1,2,3\na,8.3,1,2,3\n", "line 3: expected a point that is named once"),
        (HEADER, "no point"),
    ],
)
def test_damage_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)

    with pytest.raises(FileFormatError) as error:
        read_head_points(path)

    assert said in str(error.value)
