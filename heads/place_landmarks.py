"""Finds the 42 landmarks of Farkas on the template; writes `data/farkas_landmarks.csv`.

Run by the project when the template changes: ``python -m facewright.heads.place_landmarks``.
Landmarks of the sides are placed on the subject's left, named ``en_l``, and mirrored to ``en_r``.
Bony landmarks lie on the skin over the bone. Where a place cannot be told from the form alone (a
notch of the ear, the insertion of a nostril), it is given as coordinates on the template, read off
a shaded picture of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .place_feature_points import TemplateFace, write_table
from .template import Template, load_template, template_feature_points

Point = NDArray[np.float64]
_GNATHION_SLOPE = 1.0  # of depth over height: half-way round the lower border of the chin
_TEMPORAL_LINE_RAD = 0.92  # how far the forehead has turned aside where its side begins


def place(template: Template) -> list[tuple[str, Point, str, str]]:
    """All landmarks: (name, position mm, part, rule), the middle's first, then left and right."""
    face = TemplateFace(template)
    points = template_feature_points()
    at = dict(zip(points.names, points.at(template.vertices), strict=True))
    found = [(n, p * (0, 1, 1), "skin", how) for n, p, how in _middle(face, at)]
    for name, p, how in _sides(face, at):
        part = "eye" if name == "p" else "skin"
        for side, word, sign in (("l", "left", 1), ("r", "right", -1)):
            where = f"{part}_{word}" if part == "eye" else part
            found.append((f"{name}_{side}", p * (sign, 1, 1), where, how))
    return found


def _middle(face: TemplateFace, at: dict[str, Point]) -> list[tuple[str, Point, str]]:
    brow = face.profile(40.0, 12.0)
    g = brow[np.argmax(brow[:, 2])]
    root = face.profile(14.0, -6.0)
    se = root[np.argmin(root[:, 2])]
    under = face.profile(at["9.3"][1], at["8.1"][1])
    chord = (at["8.1"] - at["9.3"])[1:] / np.linalg.norm(at["8.1"] - at["9.3"])
    depth = (under[:, 1:] - under[0, 1:]) @ (chord[1], -chord[0])
    sn = under[np.argmax(np.abs(depth))]
    fold = face.profile(at["8.2"][1] - 3.0, at["2.10"][1])
    chin = face.profile(at["2.10"][1], -112.0)
    turn = np.gradient(chin[:, 2], chin[:, 1])
    gn = chin[np.argmax(turn > _GNATHION_SLOPE)]
    skin = face.v[face.template.vertices_of("skin")]
    middle = skin[(np.abs(skin[:, 0]) < 1.0) & (np.abs(skin[:, 1]) < 60)]
    op = middle[np.argmax(np.linalg.norm(middle - g, axis=1))]
    return [
        ("v", at["11.4"], "feature point 11.4: highest point"),
        ("g", g, "foremost point between the brows"),
        ("op", op, "farthest from g"),
        ("tr", at["11.1"], "feature point 11.1: hair line"),
        ("sl", fold[np.argmin(fold[:, 2])], "deepest point between lower lip and chin"),
        ("pg", at["2.10"], "feature point 2.10: foremost point of the chin"),
        ("gn", gn, "chin: half-way round its lower border"),
        ("n", face.front(0.0, se[1] + 3.5), "3.5 mm above se"),
        ("se", se, "deepest point of the root of the nose"),
        ("prn", at["9.3"], "feature point 9.3: foremost point of the nose"),
        ("sn", sn, "under the nose: deepest behind the line from prn to ls"),
        ("c", face.front(0.0, -44.1), "at the fore end of the nostrils, by coordinates"),
        ("ls", at["8.1"], "feature point 8.1"),
        ("li", at["8.2"], "feature point 8.2"),
        ("sto", at["2.2"], "feature point 2.2: the upper lip at the seam"),
    ]


def _sides(face: TemplateFace, at: dict[str, Point]) -> list[tuple[str, Point, str]]:
    wide = [face.side(float(y), z) for y in range(24, 60, 2) for z in np.arange(-110.0, -40.0, 2.0)]
    eu = max(wide, key=lambda p: float(p[0]))
    x = np.arange(35.0, 68.0, 0.5)
    depth = np.array([face.front(float(c), 28.0)[2] for c in x])
    turned = np.arctan(-np.gradient(depth, x))
    ft = face.front(float(x[np.argmax(turned > _TEMPORAL_LINE_RAD)]), 28.0)
    return [
        ("eu", eu, "skull above the ear: farthest out"),
        ("ft", ft, "forehead above the brow's tail: where its side begins"),
        ("zy", face.side(-25.0, -42.0), "cheek bone's arch, by coordinates"),
        ("go", face.side(-79.0, -41.0), "lower border of the jaw's angle, by coordinates"),
        ("cdl", face.side(-17.0, -55.0), "over the jaw joint, before the ear, by coordinates"),
        ("en", face.front(16.6, -1.9), "where the lids meet inside, by coordinates"),
        ("ex", face.front(44.3, -0.2), "where the lids meet outside, by coordinates"),
        ("p", at["3.5"], "feature point 3.5: foremost point of the eyeball"),
        ("or", face.front(31.0, -15.5), "lower rim of the orbit, by coordinates"),
        ("ps", at["3.1"], "feature point 3.1: edge of the upper lid"),
        ("pi", at["3.3"], "feature point 3.3: edge of the lower lid"),
        ("os", face.front(33.0, 15.0), "upper rim of the orbit, by coordinates"),
        ("sci", at["4.3"], "feature point 4.3: top of the brow"),
        ("mf", face.front(9.0, -0.5), "flank of the root of the nose, by coordinates"),
        ("al", face.front(17.4, -39.0), "nose wing: farthest out, by coordinates"),
        ("sbal", face.front(8.4, at["9.15"][1] + 1.2), "under the nostril, by coordinates"),
        ("ac", face.front(18.0, -43.0), "where the nose wing meets the cheek, by coordinates"),
        ("cph", face.front(6.6, at["8.10"][1]), "crest of the philtrum at the lip's border"),
        ("ch", at["8.3"], "feature point 8.3: corner of the lips"),
        ("sa", at["10.1"], "feature point 10.1: highest point of the ear"),
        ("sba", at["10.5"], "feature point 10.5: lowest point of the ear"),
        ("pra", face.side(-13.0, -62.0), "before the ear, by coordinates"),
        ("pa", at["10.3"], "feature point 10.3: hindmost point of the ear"),
        ("obs", at["10.9"], "feature point 10.9: upper attachment of the ear"),
        ("obi", at["10.7"], "feature point 10.7: lower attachment of the ear"),
        ("t", face.side(-17.5, -64.5), "notch above the tragus, by coordinates"),
        ("po", face.side(-18.5, -67.0), "ear canal: upper margin, by coordinates"),
    ]


if __name__ == "__main__":
    head = load_template()
    write_table(Path(__file__).parent / "data" / "farkas_landmarks.csv", "name", place(head), head)
