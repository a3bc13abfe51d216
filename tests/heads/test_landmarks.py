"""Farkas's landmarks on the template: all there, mirrored, and where their definitions say."""

from __future__ import annotations

import csv
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import facewright.heads
from facewright.heads.head import Head
from facewright.heads.landmarks import side_names, template_landmarks
from facewright.heads.place_landmarks import place
from facewright.heads.template import load_template

MIDDLE = [
    "v", "g", "op", "tr", "sl", "pg", "gn", "n", "se", "prn", "sn", "c", "ls", "li", "sto",
]  # fmt: skip
SIDES = [
    "eu", "ft", "zy", "go", "cdl", "en", "ex", "p", "or", "ps", "pi", "os", "sci", "mf", "al",
    "sbal", "ac", "cph", "ch", "sa", "sba", "pra", "pa", "obs", "obi", "t", "po",
]  # fmt: skip


def landmarks_of(head: Head) -> dict[str, NDArray[np.float64]]:
    assert head.mesh.landmarks is not None
    at = head.mesh.landmarks.at(head.mesh.vertices)
    return dict(zip(head.mesh.landmarks.names, at, strict=True))


def test_all_42_landmarks_are_there_on_their_parts() -> None:
    template, marks = load_template(), template_landmarks()
    on = {part: set(template.vertices_of(part).tolist()) for part in template.groups()}

    assert len(MIDDLE) + len(SIDES) == 42
    assert set(marks.names) == {*MIDDLE, *(f"{n}_{s}" for n in SIDES for s in "lr")}
    for name, corners in zip(marks.names, marks.corners.tolist(), strict=True):
        part = {"p_l": "eye_left", "p_r": "eye_right"}.get(name, "skin")
        assert set(corners) <= on[part], name


def test_the_names_are_those_of_the_definitions(repository: Path) -> None:
    table = repository.parent / "shared" / "data" / "anthropometry" / "farkas_landmarks.csv"
    if not table.is_file():
        pytest.skip(f"the table of definitions is not on this machine (expected at {table})")
    with open(table, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))

    expected = {
        name
        for r in rows
        for name in (
            [r["abbr"]] if r["symmetry"] == "midline" else [f"{r['abbr']}_l", f"{r['abbr']}_r"]
        )
    }
    assert set(template_landmarks().names) == expected


def test_left_and_right_are_mirror_images_on_the_template() -> None:
    marks = template_landmarks()
    at = dict(zip(marks.names, marks.at(load_template().vertices), strict=True))
    for name in MIDDLE:
        assert abs(at[name][0]) < 0.05, name
    for name in SIDES:
        left, right = at[f"{name}_l"], at[f"{name}_r"]
        assert left[0] > 1, name
        np.testing.assert_allclose(left * (-1, 1, 1), right, atol=0.3, err_msg=name)


def test_the_table_is_what_the_rules_give() -> None:
    """heads/data/farkas_landmarks.csv is not edited by hand."""
    text = files(facewright.heads).joinpath("data", "farkas_landmarks.csv").read_text("utf-8")
    rows = {r["name"]: r for r in csv.DictReader(text.splitlines())}
    placed = {name: p for name, p, *_ in place(load_template())}
    marks = template_landmarks()
    at = dict(zip(marks.names, marks.at(load_template().vertices), strict=True))

    assert set(rows) == set(placed) == set(at)
    for name, p in placed.items():
        written = np.array([float(rows[name][f"{a}_mm"]) for a in "xyz"])
        np.testing.assert_allclose(written, at[name], atol=0.006, err_msg=name)
        assert np.linalg.norm(at[name] - p) < 0.5, name  # drawn to the surface


def test_extreme_landmarks_are_the_extremes_of_the_template() -> None:
    """Definitions that speak of a most prominent place, checked against all vertices."""
    template = load_template()
    marks = template_landmarks()
    at = dict(zip(marks.names, marks.at(template.vertices), strict=True))
    skin = template.vertices[template.vertices_of("skin")]
    above_ears = skin[(skin[:, 1] > 15) & (skin[:, 2] < -40)]
    middle = skin[np.abs(skin[:, 0]) < 0.5]

    assert at["v"][1] == pytest.approx(skin[:, 1].max(), abs=0.2)
    assert at["prn"][2] == pytest.approx(middle[:, 2].max(), abs=0.2)
    assert at["eu_l"][0] == pytest.approx(above_ears[:, 0].max(), abs=0.3)
    head = middle[np.abs(middle[:, 1]) < 60]
    farthest = np.linalg.norm(head - at["g"], axis=1).max()
    assert np.linalg.norm(at["op"] - at["g"]) == pytest.approx(farthest, abs=0.3)


#: (higher, lower), (farther to the left, nearer the middle), (before, behind)
ABOVE = [
    "v tr", "tr g", "g n", "n se", "se prn", "prn c", "c sn", "sn ls", "ls sto", "sto li",
    "li sl", "sl pg", "pg gn",
]  # fmt: skip
ABOVE += [
    "sci_l os_l", "os_l ps_l", "ps_l p_l", "p_l pi_l", "pi_l or_l", "sa_l obs_l", "obs_l t_l",
    "t_l obi_l",
]  # fmt: skip
ABOVE += [
    "obi_l go_l", "t_l zy_l", "al_l sbal_l", "cph_l ch_l",
]  # fmt: skip
LEFT = [
    "eu_l ft_l", "ex_l p_l", "p_l en_l", "en_l mf_l", "al_l sbal_l", "ch_l cph_l", "zy_l ex_l",
    "go_l ch_l",
]  # fmt: skip
LEFT += [
    "pa_l zy_l", "eu_l zy_l",
]  # fmt: skip
BEFORE = [
    "prn c", "c sn", "sn t_l", "g op", "ft_l eu_l", "zy_l cdl_l", "cdl_l t_l", "pra_l pa_l",
    "pg go_l",
]  # fmt: skip


def test_landmarks_are_where_their_definitions_say_on_everybody(people: tuple[Head, ...]) -> None:
    for head in people:
        p = landmarks_of(head)
        for axis, pairs in ((1, ABOVE), (0, LEFT), (2, BEFORE)):
            for pair in pairs:
                more, less = pair.split()
                assert p[more][axis] > p[less][axis], f"{head.name}: {more} and {less}"


def test_names_of_sides() -> None:
    assert side_names("n") == ("n",)
    assert side_names("en") == ("en_r", "en_l")
    with pytest.raises(ValueError, match="no landmark nose; there are ac, al"):
        side_names("nose")
