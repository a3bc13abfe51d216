"""FAPs 1 and 2 of faces that show one thing, or a mix."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.formats.fap import read_fap, write_fap
from facewright.core.mpeg4 import displacement_faps
from facewright.heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from facewright.heads.head import Head
from facewright.tracking.high_level_faps import FULL, high_level_faps
from facewright.tracking.performance import _joined


def faps_of(head: Head, poses: list[Mapping[str, float]]) -> Clip:
    """Each pose held for half a second: what its feature points do."""
    rest = head.feature_points.at(head.mesh.vertices)
    rows = []
    for pose in poses:
        moved = head.feature_points.at(head.shaped(pose)) - rest
        rows += [moved] * 30
    d = np.stack(rows)
    points = {fp: d[:, i] for i, fp in enumerate(head.feature_points.names)}
    values = displacement_faps(points, head.fapu)
    return Clip(np.arange(len(d)) / 60.0, tuple(values), np.stack(list(values.values()), axis=1))


def middles(clip: Clip, channel: str) -> list[int]:
    return [int(v) for v in clip[channel][15::30]]


@pytest.fixture(scope="module")
def someone(people: tuple[Head, ...]) -> Head:
    return people[4]  # not the average head, whose faces are the dictionary


def test_each_expression_is_told_by_its_name(someone: Head) -> None:
    faps = faps_of(someone, [expression_weights(name) for name in EXPRESSIONS])

    found = high_level_faps(faps, someone.fapu)

    assert middles(found, "expression.select1") == [1, 2, 3, 4, 5, 6]
    assert all(v > 0.6 * FULL for v in middles(found, "expression.intensity1"))
    assert all(v < 0.35 * FULL for v in middles(found, "expression.intensity2"))


def test_visemes_are_told_by_their_number(someone: Head) -> None:
    faps = faps_of(someone, [viseme_weights(name) for name in VISEMES[1:]])

    found = high_level_faps(faps, someone.fapu)

    first, blend = middles(found, "viseme.select1"), middles(found, "viseme.blend")
    right = [n == a for n, a in zip(range(1, 15), first, strict=True)]
    assert sum(right) >= 11, first  # some look alike: DD and nn, kk and E
    assert min(blend) >= FULL // 2  # the first is the stronger one


def test_a_faint_expression_has_a_faint_intensity(someone: Head) -> None:
    faps = faps_of(someone, [expression_weights("joy", i) for i in (0.3, 0.6, 1.0)])

    found = middles(high_level_faps(faps, someone.fapu), "expression.intensity1")

    assert found[0] < 0.75 * found[1] < 0.75 * found[2]


def test_a_face_at_rest_shows_nothing(someone: Head) -> None:
    found = high_level_faps(faps_of(someone, [{}]), someone.fapu)

    assert not found.values.any()


def test_frames_without_faps_have_none_of_these(someone: Head) -> None:
    faps = faps_of(someone, [expression_weights("joy")])
    values = np.array(faps.values)
    values[10:14] = np.nan

    found = high_level_faps(Clip(faps.time_s, faps.channels, values), someone.fapu)

    np.testing.assert_array_equal(np.isnan(found.values[:, 0]), np.isnan(values[:, 0]))


def test_they_can_be_written_to_a_fap_file(someone: Head, tmp_path: Path) -> None:
    faps = faps_of(someone, [expression_weights("anger"), viseme_weights("aa")])
    both = _joined(high_level_faps(faps, someone.fapu), faps)
    path = tmp_path / "both.fap"

    write_fap(path, both)

    back = read_fap(path)
    np.testing.assert_array_equal(back["expression.select1"], both["expression.select1"])
    np.testing.assert_array_equal(back["viseme.blend"], both["viseme.blend"])
