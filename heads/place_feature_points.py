"""Finds the MPEG-4 feature points on the template by geometry; writes `data/feature_points.csv`.

Run by the project when the template changes: ``python -m facewright.heads.place_feature_points``.
All built-in heads share the template's topology, so a point placed here is on all of them. Points
are placed on the subject's left and mirrored. Of the 84 two are no points of the skin, and
`Head.points` adds them: 7.1, the centre of the head's rotation, and 11.5, the top of the hair. The
table is then checked by eye on the chart that ``facewright synth head --out DIR`` draws.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.mpeg4 import feature_point_table
from .raycast import RayScene
from .template import Template, load_template

Point = NDArray[np.float64]
_SCAN_MM = 0.1
CHIN_SLOPE = 0.7  # of depth over height: still seen from the front when the jaw drops
_EAR_CONTACTS = (-42.5, -60.5), (-1.0, -64.5)  # y, z of the lower and the upper one
_LIP_BORDER = 0.9  # of the mask: where the crease between vermilion and skin lies


class TemplateFace:
    """The template's skin with the measurements that the rules speak of."""

    def __init__(self, template: Template) -> None:
        self.template = template
        groups = template.groups()
        self.skin = template.triangles[groups["skin"]]
        self.scene = RayScene(template.vertices, self.skin)
        eyes = np.concatenate([groups["eye_right"], groups["eye_left"]])
        self.eye_scene = RayScene(template.vertices, template.triangles[eyes])
        self.v = template.vertices
        self.lips, self.ears = self._on_vertices("lips"), self._on_vertices("ears")

    def _on_vertices(self, mask: str) -> NDArray[np.float64]:
        found = np.zeros(len(self.v))
        uv_rows = self.template.uv_triangles.ravel()
        found[self.template.triangles.ravel()] = self.template.masks[mask][uv_rows]
        return found

    def front(self, x: float, y: float) -> Point:
        """The skin in front of (x, y), seen along −z."""
        t, *_ = self.scene.cast(np.array([[x, y, 500.0]]), np.array([[0.0, 0.0, -1.0]]))
        return np.array([x, y, 500.0 - float(t[0])])

    def side(self, y: float, z: float) -> Point:
        """The skin on the left at (y, z), seen along −x."""
        t, *_ = self.scene.cast(np.array([[500.0, y, z]]), np.array([[-1.0, 0.0, 0.0]]))
        return np.array([500.0 - float(t[0]), y, z])

    def profile(self, y0: float, y1: float) -> NDArray[np.float64]:
        """(n, 3) points of the mid-line between two heights, from the top down."""
        heights = np.arange(max(y0, y1), min(y0, y1), -0.1)
        origins = np.stack([np.zeros_like(heights), heights, np.full_like(heights, 500.0)], axis=1)
        t, *_ = self.scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(heights), 1)))
        return np.stack([np.zeros_like(heights), heights, 500.0 - t], axis=1)

    def lid_gap(self, x: float) -> tuple[float, float]:
        """Heights between which the eyeball shows at x (upper, lower); equal if it does not."""
        y = np.arange(18.0, -18.0, -_SCAN_MM)
        origins = np.stack([np.full_like(y, x), y, np.full_like(y, 500.0)], axis=1)
        down = np.tile([0.0, 0.0, -1.0], (len(y), 1))
        skin_t, *_ = self.scene.cast(origins, down)
        eye_t, *_ = self.eye_scene.cast(origins, down)
        shows = y[eye_t < skin_t]
        return (float(shows[0]), float(shows[-1])) if len(shows) else (0.0, 0.0)

    def lip_contour(self, x: float, upper: bool) -> Point:
        """Where the lips mask ends on the vertical through x."""
        inner = self.front(x, self.seam_y(x) + (1.0 if upper else -1.0))
        step = 0.1 if upper else -0.1
        for i in range(1, 400):
            p = self.front(x, inner[1] + step * i)
            if self.lip_value(p) < _LIP_BORDER:
                return p
        raise AssertionError("the lips mask has no border")

    def lip_value(self, p: Point) -> float:
        """The lips mask at a surface point."""
        _, triangle, b = self.scene.closest(p[None])
        return float(b[0] @ self.lips[self.skin[triangle[0]]])

    def nose_wing(self, base: Point) -> Point:
        """The outer flank of the left nostril: where the skin falls away fastest."""
        x = np.arange(8.0, 26.0, _SCAN_MM)
        y = np.full_like(x, base[1] + 12.0)
        origins = np.stack([x, y, np.full_like(x, 500.0)], axis=1)
        t, *_ = self.scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(x), 1)))
        at = int(np.argmax(np.diff(t)))
        return self.front(float(x[at]), float(y[at]))

    def seam_y(self, x: float) -> float:
        """The height at which the closed lips meet: the deepest point between the lips."""
        y = np.arange(-74.0, -60.0, 0.1)
        origins = np.stack([np.full_like(y, x), y, np.full_like(y, 500.0)], axis=1)
        t, *_ = self.scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(y), 1)))
        return float(y[np.argmax(t)])


def place(template: Template) -> list[tuple[str, Point, str, str]]:
    """All points that the built-in heads carry: (id, position mm, part, rule)."""
    face = TemplateFace(template)
    rules: dict[str, tuple[Callable[[], Point], str, str]] = {}

    def rule(fp: str, how: str, find: Callable[[], Point], part: str = "skin") -> None:
        rules[fp] = (find, part, how)

    _mouth_rules(face, rule)
    _eye_rules(face, rule)
    _face_rules(face, rule)
    _inner_rules(face, rule)
    found: list[tuple[str, Point, str, str]] = []
    table = feature_point_table()
    for fp, (find, part, how) in rules.items():
        p = find()
        mirror = table[fp].mirror_id
        found.append((fp, p, part, how))
        if mirror:
            mirrored_part = part.replace("left", "right")
            found.append((mirror, p * (-1, 1, 1), mirrored_part, f"mirror of {fp}"))
    order = list(table)
    return sorted(found, key=lambda row: order.index(row[0]))


def _mouth_rules(face: TemplateFace, rule: Callable[..., None]) -> None:
    lip_rows = np.flatnonzero(face.lips > 0.5)
    outer_rows = np.intersect1d(lip_rows, face.skin)
    corner = face.v[outer_rows[np.argmax(face.v[outer_rows, 0])]]
    seam = {x: face.seam_y(x) for x in (0.0, corner[0] / 2)}
    top = face.lip_contour(0.0, True)
    xs = np.arange(2.0, 14.0, 0.25)
    bow = max((face.lip_contour(float(x), True) for x in xs), key=lambda p: float(p[1]))
    half = corner[0] / 2
    rule("8.3", "lips mask: point farthest to the left", lambda: corner)
    rule("8.1", "lips mask: upper border on the mid-line", lambda: top)
    rule("8.2", "lips mask: lower border on the mid-line", lambda: face.lip_contour(0.0, False))
    rule("8.5", "lips mask: upper border half-way", lambda: face.lip_contour(half, True))
    rule("8.7", "lips mask: lower border half-way", lambda: face.lip_contour(half, False))
    rule("8.10", "lips mask: highest point of the upper border", lambda: bow)
    rule("2.2", "upper lip just above the seam", lambda: face.front(0.0, seam[0.0] + 0.7))
    rule("2.3", "lower lip just below the seam", lambda: face.front(0.0, seam[0.0] - 0.7))
    rule("2.6", "upper lip above the seam, half-way", lambda: face.front(half, seam[half] + 0.7))
    rule("2.8", "lower lip below the seam, half-way", lambda: face.front(half, seam[half] - 0.7))
    rule("2.4", "2 mm inside the outer corner", lambda: corner + (-2.0, 0.0, 0.5))


def _eye_rules(face: TemplateFace, rule: Callable[..., None]) -> None:
    columns = [(float(x), *face.lid_gap(float(x))) for x in np.arange(14.0, 52.0, 0.25)]
    open_columns = [c for c in columns if c[1] > c[2]]
    x_in, x_out = open_columns[0][0] - 0.5, open_columns[-1][0] + 0.5
    inner = face.front(x_in, float(np.mean(open_columns[0][1:])))
    outer = face.front(x_out, float(np.mean(open_columns[-1][1:])))
    mid_x = (inner[0] + outer[0]) / 2
    line_y = (inner[1] + outer[1]) / 2
    top_y, bottom_y = face.lid_gap(mid_x)
    up, low = face.front(mid_x, top_y + 0.3), face.front(mid_x, bottom_y - 0.3)
    rule("3.11", "innermost place where the eyeball shows", lambda: inner)
    rule("3.7", "outermost place where the eyeball shows", lambda: outer)
    rule("3.1", "edge of the upper lid half-way between the corners", lambda: up)
    rule("3.3", "edge of the lower lid half-way between the corners", lambda: low)
    rule("3.13", "upper lid fold: 5 mm above the margin", lambda: face.front(mid_x, up[1] + 5.0))
    rule("3.9", "lower lid: 6 mm below the margin", lambda: face.front(mid_x, low[1] - 6.0))
    pupil = face.template.vertices_of("eye_left")
    front = face.v[pupil][np.argmax(face.v[pupil, 2])]
    rule("3.5", "eyeball: foremost point", lambda: front, "eye_left")
    brow_in, brow_out = inner[0] - 5.0, outer[0] + 3.5
    rule("4.1", "17 mm above the inner eye corner", lambda: face.front(brow_in, inner[1] + 17.0))
    brow_mid = 0.4 * brow_in + 0.6 * brow_out
    rule("4.3", "24 mm above the eye line", lambda: face.front(brow_mid, line_y + 23.0))
    rule("4.5", "16 mm above the outer eye corner", lambda: face.front(brow_out, outer[1] + 15.5))


def _face_rules(face: TemplateFace, rule: Callable[..., None]) -> None:
    nose = face.profile(-20.0, -50.0)
    tip = nose[np.argmax(nose[:, 2])]
    under = face.profile(tip[1] - 3.0, -58.0)
    base = under[np.argmin(under[:, 2])]
    wing = face.nose_wing(base)
    chin = face.profile(-84.0, -104.0)
    boss = chin[np.argmax(chin[:, 2])]
    rule("9.3", "mid-line: foremost point of the nose", lambda: tip)
    rule("9.15", "mid-line: deepest point under the nose", lambda: base)
    rule(
        "9.2",
        "nose wing: steepest flank 12 mm above the base of the nose",
        lambda: wing * (-1, 1, 1),
    )
    rule("9.5", "lower edge of the nose", lambda: face.front(9.0, base[1] + 2.0))
    rule("9.12", "mid-line: half-way up the bridge", lambda: face.front(0.0, tip[1] / 2))
    rule("9.7", "upper edge of the nose bone", lambda: face.front(8.0, -4.0))
    rule("9.13", "lower edge of the nose bone", lambda: face.front(11.0, tip[1] * 0.62))
    rule("2.10", "mid-line: foremost point of the chin", lambda: boss)
    low = face.profile(boss[1], -112.0)
    slope = np.gradient(low[:, 2], low[:, 1])
    bottom = low[np.argmax(slope > CHIN_SLOPE)]  # where the skin turns under
    rule("2.1", "mid-line: where the chin turns under", lambda: bottom)
    rule("2.11", "chin, left", lambda: face.front(18.0, boss[1] - 3.0))
    rule("2.13", "jaw angle", lambda: face.side(-74.0, -38.0))
    rule("5.1", "cheek, at the height of the lip corners", lambda: face.front(46.0, -60.0))
    rule("5.3", "cheek bone, below the eye", lambda: face.front(40.0, -29.0))
    ear = face.v[(face.ears > 0.5) & (face.v[:, 0] > 0)]
    rule("10.1", "ear: highest point", lambda: ear[np.argmax(ear[:, 1])])
    rule("10.3", "ear: farthest back", lambda: ear[np.argmin(ear[:, 2])])
    rule("10.5", "ear: lowest point", lambda: ear[np.argmin(ear[:, 1])])
    low, high = (face.side(y, z) for y, z in _EAR_CONTACTS)
    rule("10.7", "ear: lower contact with the face, by coordinates", lambda: low)
    rule("10.9", "ear: upper contact with the face, by coordinates", lambda: high)
    rule("11.1", "mid-line: hair line", lambda: face.front(0.0, 70.0))
    rule("11.3", "hair line above the outer brow", lambda: face.front(45.0, 62.0))
    crown = face.v[np.argmax(face.v[:, 1])]
    rule("11.4", "highest point", lambda: crown * (0, 1, 1))
    back = face.v[np.argmin(face.v[:, 2] + 1e3 * (np.abs(face.v[:, 1]) > 30))]
    rule("11.6", "back of the skull at eye height", lambda: back * (0, 1, 1))


def _inner_rules(face: TemplateFace, rule: Callable[..., None]) -> None:
    tongue = face.v[face.template.vertices_of("tongue")]
    mid = tongue[np.abs(tongue[:, 0]) < 1.0]
    tip = mid[np.argmax(mid[:, 2])]
    body = mid[np.abs(mid[:, 2] - (tip[2] - 18.0)) < 4.0]
    rule("6.1", "tongue: foremost point", lambda: tip * (0, 1, 1), "tongue")
    rule("6.2", "tongue: top, 18 mm behind the tip", lambda: body[np.argmax(body[:, 1])], "tongue")
    sides = tongue[np.abs(tongue[:, 2] - (tip[2] - 14.0)) < 4.0]
    rule("6.3", "tongue: left border", lambda: sides[np.argmax(sides[:, 0])], "tongue")
    for part, fp_top, fp_bottom in (("teeth_upper", "9.8", "9.10"), ("teeth_lower", "9.11", "9.9")):
        teeth = face.v[face.template.vertices_of(part)]
        front = teeth[(np.abs(teeth[:, 0]) < 3) & (teeth[:, 2] > teeth[:, 2].max() - 4)]
        top, bottom = front[np.argmax(front[:, 1])], front[np.argmin(front[:, 1])]
        rule(fp_top, "teeth: upper edge", lambda top=top: top * (0, 1, 1), part)
        rule(fp_bottom, "teeth: lower edge", lambda bottom=bottom: bottom * (0, 1, 1), part)


def write_table(
    path: Path, key: str, placed: list[tuple[str, Point, str, str]], template: Template
) -> None:
    """Write points of the template's surface: the nearest triangle to each place, and its rule.

    Parameters
    ----------
    path : Path
    key : str
        Heads the column of names.
    placed : list of (name, position mm, part, rule)
    template : Template
    """
    groups = template.groups()
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header = [key, *(f"corner{i}" for i in range(3)), *(f"weight{i}" for i in range(3))]
        writer.writerow([*header, "x_mm", "y_mm", "z_mm", "part", "rule"])
        for name, p, part, how in placed:
            triangles = template.triangles[groups[part]]
            at, triangle, b = RayScene(template.vertices, triangles).closest(p[None])
            corners = triangles[triangle[0]]
            weights = [f"{x:.6f}" for x in np.clip(b[0], 0, 1)]
            writer.writerow([name, *corners, *weights, *(f"{x:.2f}" for x in at[0]), part, how])


if __name__ == "__main__":
    head = load_template()
    write_table(Path(__file__).parent / "data" / "feature_points.csv", "id", place(head), head)
