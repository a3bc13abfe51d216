"""How `data/auxiliary_points.npz` came about: ``python -m facewright.retarget.learn_auxiliary``.

Learnt from the sculpted ARKit shapes of the built-in heads alone: each by itself, MPEG-4's
expressions, and the visemes. Where the points go is found in rounds: those at which the smoothest
surface through the points at hand misses the shapes most, left and right alike.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import atomic_path
from ..core.mesh import SurfacePoints, vertex_normals
from ..core.mpeg4 import fap_table
from ..heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from ..heads.head import Head
from ..heads.identity import Identity, make_head
from .auxiliary_points import DATA, LOWER_LIP, PREFIX, UPPER_LIP, Component
from .biharmonic_weights import biharmonic_weights
from .boundary_points import points_at_vertices
from .controls import LEAST_LID_SHARE, SKIN_CONTROLS, joined_points, place_controls
from .jaw import CHIN
from .surface_weights import interpolating, surface_distances

Floats = NDArray[np.float64]
#: Contours of the lips by their feature points, from the left corner to the right one.
_CONTOURS = {
    "upper_inner": ("2.4", "2.6", "2.2", "2.7", "2.5"),
    "lower_inner": ("2.4", "2.8", "2.3", "2.9", "2.5"),
    "upper_outer": ("8.3", "8.5", "8.1", "8.6", "8.4"),
    "lower_outer": ("8.3", "8.7", "8.2", "8.8", "8.4"),
}
#: Regions of the skin that get points: lids have their own. The mouth's lining has some, so that it
#: does not come through the cheeks.
_WITH_POINTS = (
    "forehead", "nose", "upper_lip", "lower_lip", "chin", "neck", "inner_mouth",
    *(f"{name}_{side}" for name in ("brow", "orbit", "temple", "cheek", "jaw") for side in "lr"),
)  # fmt: skip
_ROUNDS, _PAIRS_A_ROUND = 7, 7
_LEAST_APART_MM = 6.0
_MIDDLE_MM = 1.5  # nearer to the mid-line than this a point stands alone
_SHAPE_WEIGHT = 0.6
_INTENSITIES = (0.4, 0.7, 1.0)
#: Local motion that expressions do not explain: its standard deviation, and how far it reaches.
_LOCAL_SD_MM, _LOCAL_REACH_MM = 0.8, 25.0
#: What a FAP may be off, mm; it also keeps the regression calm.
_NOISE_MM = 0.1


@dataclass(frozen=True, eq=False)
class _Samples:
    """How the average head's vertices move, (n, V, 3) float64 mm."""

    head: Head
    moves: Floats


def expression_samples(head: Head) -> Floats:
    """Displacements under shapes, expressions and visemes, (n, V, 3) float64 mm."""
    assert head.shapes is not None
    said = [expression_weights(name, i) for name in EXPRESSIONS for i in _INTENSITIES]
    said += [viseme_weights(name) for name in VISEMES[1:]]
    weights = [[row.get(name, 0.0) for name in head.shape_names] for row in said]
    each = _SHAPE_WEIGHT * np.eye(len(head.shape_names))
    return np.asarray(np.tensordot(np.concatenate([weights, each]), head.shapes, axes=1))


def learn(head: Head) -> dict[str, Any]:
    """The arrays of the file."""
    samples = _Samples(head, expression_samples(head))
    points = _chosen_points(samples)
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    features = head.feature_points.select(tuple(n for n in SKIN_CONTROLS if n in head.points))
    everything = joined_points(features, (points,))
    between = surface_distances(head.mesh.vertices, skin, everything).between
    inputs = _inputs()
    outputs = [(n, a) for n in points.names for a in range(3)]
    outputs += [c for c in _all_components() if c not in inputs and not _is_lid(c[0])]
    at = {name: i for i, name in enumerate(everything.names)}
    moved = everything.at(samples.moves)

    def columns(components: list[Component]) -> Floats:
        return np.stack([moved[:, at[n], a] for n, a in components], axis=1)

    def covariance(a: list[Component], b: list[Component]) -> Floats:
        shaped = columns(a).T @ columns(b) / len(moved)
        d = between[np.ix_([at[n] for n, _ in a], [at[n] for n, _ in b])]
        same_axis = np.array([[i == j for _, j in b] for _, i in a])
        return shaped + same_axis * _LOCAL_SD_MM**2 * np.exp(-d / _LOCAL_REACH_MM)

    v = head.mesh.vertices
    normals = vertex_normals(v, skin)
    ahead = np.einsum("nc,ncx->nx", points.barycentric, normals[points.corners])
    anchors = [n for n in head.feature_points.names if n in SKIN_CONTROLS]
    return {
        "names": np.array(points.names),
        "corners": points.corners,
        "barycentric": points.barycentric,
        "places": points.at(v).astype(np.float32),
        "normals": (ahead / np.linalg.norm(ahead, axis=1, keepdims=True)).astype(np.float32),
        "lip": _lips_of(head, points),
        "anchor_names": np.array(anchors),
        "anchors": np.array([head.points[n] for n in anchors]),
        "input_points": np.array([n for n, _ in inputs]),
        "input_axes": np.array([a for _, a in inputs], np.int8),
        "output_points": np.array([n for n, _ in outputs]),
        "output_axes": np.array([a for _, a in outputs], np.int8),
        "inner": covariance(inputs, inputs).astype(np.float32),
        "cross": covariance(outputs, inputs).astype(np.float32),
        "noise_mm": np.array(_NOISE_MM),
        "eye_separation_mm": np.array(head.fapu.es),
    }


def _all_components() -> list[Component]:
    return [(name, axis) for name in SKIN_CONTROLS if name != CHIN for axis in range(3)]


def _is_lid(name: str) -> bool:
    return name.startswith("3.")


def _inputs() -> list[Component]:
    """What FAPs move of the skin."""
    found: list[Component] = []
    for fap in fap_table():
        for name in fap.feature_points:
            if fap.direction is not None and name in SKIN_CONTROLS:
                component = name, int(np.abs(fap.direction).argmax())
                if SKIN_CONTROLS[name][component[1]] == "F":
                    found.append(component)
    return found


def _chosen_points(samples: _Samples) -> SurfacePoints:
    """Points on the lips' contours, and where they are needed most."""
    head, v = samples.head, samples.head.mesh.vertices
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    begun = _controls_without_auxiliary(head)
    regions = np.concatenate([head.regions[region] for region in _WITH_POINTS])
    allowed = np.unique(head.mesh.triangles[regions])
    mirrored = _mirror_images(v, allowed)
    chosen = _contour_points(head)
    for round_ in range(_ROUNDS):
        points = joined_points(begun, (chosen,))
        every = np.ones(len(points), dtype=np.bool_)
        table = interpolating(biharmonic_weights(v, skin, points, every), points, every)
        wanted = points.at(samples.moves)
        missed = np.stack([m - table @ w for m, w in zip(samples.moves, wanted, strict=True)])
        score = np.sqrt((missed**2).sum(axis=2).mean(axis=0))
        taken = surface_distances(v, skin, points).to_vertices.min(axis=0)
        rows = _worst(v, allowed[v[allowed, 0] > -_MIDDLE_MM], score, taken)
        print(f"{len(chosen)} points miss {np.sqrt((score[allowed] ** 2).mean()):.3f} mm RMS")
        vertices, names = [], []
        for k, row in enumerate(rows):
            name = f"{PREFIX}{round_}.{k}"
            alone = abs(v[row, 0]) < _MIDDLE_MM
            vertices += [row] if alone else [row, mirrored[row]]
            names += [name] if alone else [f"{name}.left", f"{name}.right"]
        chosen = joined_points(
            chosen, (points_at_vertices(tuple(names), np.array(vertices), skin),)
        )
    return chosen


def _controls_without_auxiliary(head: Head) -> SurfacePoints:
    controls = place_controls(head)
    weak = {lid.name for lid in controls.lids if lid.share <= LEAST_LID_SHARE}
    return controls.points.select(tuple(n for n in controls.points.names if n not in weak))


def _worst(v: Floats, rows: NDArray[np.int32], score: Floats, taken: Floats) -> list[int]:
    """Vertices with the largest errors, away from points and from each other."""
    score, found = score.copy(), []
    score[taken < _LEAST_APART_MM] = 0.0
    for _ in range(_PAIRS_A_ROUND):
        best = int(rows[np.argmax(score[rows])])
        found.append(best)
        score[np.linalg.norm(v - v[best], axis=1) < 3 * _LEAST_APART_MM] = 0.0
    return found


def _mirror_images(v: Floats, rows: NDArray[np.int32]) -> dict[int, int]:
    across = v[rows] * (-1, 1, 1)
    found: dict[int, int] = {}
    for start in range(0, len(rows), 500):
        part = across[start : start + 500]
        nearest = ((part[:, None] - v[rows][None]) ** 2).sum(axis=2).argmin(axis=1)
        found.update(zip(rows[start : start + 500].tolist(), rows[nearest].tolist(), strict=True))
    return found


def _contour_points(head: Head) -> SurfacePoints:
    """Half-way between the feature points of the lips' contours, by arc length of a spline."""
    from scipy.interpolate import CubicSpline

    v = head.mesh.vertices
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    names, vertices = [], []
    for contour, points in _CONTOURS.items():
        p = np.array([head.points[n] for n in points])
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        places = CubicSpline(s, p)((s[1:] + s[:-1]) / 2)
        rows = _lip_vertices(head, contour.startswith("upper"))
        for k, place in enumerate(places):
            names.append(f"{PREFIX}{contour}.{k}")
            vertices.append(int(rows[np.linalg.norm(v[rows] - place, axis=1).argmin()]))
    return points_at_vertices(tuple(names), np.array(vertices), skin)


def _lip_vertices(head: Head, upper: bool) -> NDArray[np.int32]:
    region = "upper_lip" if upper else "lower_lip"
    return np.unique(head.mesh.triangles[head.regions[region]])


def _lips_of(head: Head, points: SurfacePoints) -> NDArray[np.int32]:
    """1 for points on the upper lip, -1 on the lower one: by the nearer feature points."""
    v, skin = head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]]
    near = [
        surface_distances(v, skin, joined_points(head.feature_points.select(lip), (points,)))
        for lip in (UPPER_LIP, LOWER_LIP)
    ]
    upper, lower = (
        d.between[: len(lip), len(lip) :].min(axis=0)
        for d, lip in zip(near, (UPPER_LIP, LOWER_LIP), strict=True)
    )
    lips = np.concatenate([_lip_vertices(head, upper) for upper in (True, False)])
    on_lips = np.isin(points.corners[:, 0], lips)
    return np.where(on_lips, np.where(upper < lower, 1, -1), 0).astype(np.int32)


def main() -> None:
    """Learn and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "data" / DATA)
    options = parser.parse_args()
    arrays = learn(make_head(Identity("average"), texture_px=256))
    with atomic_path(options.out) as part, part.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    print(f"{options.out}: {len(arrays['names'])} points, {options.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
