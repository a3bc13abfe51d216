"""Heads of other makers: from a mesh in a file to a `Head` that can be driven.

::

    own = read_own_head(Path("hero.glb"))
    for line in own.notes:
        print(line)
    drive = HeadDrive(own.head)

The mesh may be in any usual unit, any axis up, the face looking anywhere. What is found and done
is said in `OwnHead.notes`. Feature points are carried over by a warp of the template
(`template_warp`), which a few known points begin: given ones, or the landmarks that a network sees
on pictures of the mesh (`own_views`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import Mesh
from .face_finder import FaceFinder
from .head import Eye, Head
from .identity import joints
from .landmarks import template_landmarks
from .own_eyes import with_eyes
from .own_frame import facing_out, in_head_axes, straightened, turned_mesh
from .own_looks import own_appearance
from .own_mesh import OwnMesh, read_own_mesh
from .own_points import PlacedPoints, near_surface, place_points
from .own_shells import expected_on, expected_on_template, skin_triangles, sort_shells
from .own_start import head_start
from .raycast import RayScene
from .regions import REGIONS, template_regions
from .template import load_template
from .template_warp import LaidTemplate, Similarity, Surface, lay_template

Floats = NDArray[np.float64]

_REGION_NEAR_MM = 12.0
_POOR_RMS_MM, _POOR_COVER = 2.5, 0.6


@dataclass(frozen=True, eq=False)
class OwnHead:
    """A head from a file.

    Attributes
    ----------
    head : Head
    file_from_head : Similarity
        From the head frame to the file's axes, mm.
    unit_mm : float
        Of the file's numbers (of a .glb: of its metres × 1000).
    placed : str
        How the feature points came about: ``"given"`` or ``"found"``.
    lips_part : bool
        Whether the mesh has a slit between the lips.
    notes : tuple of str
        What was found and done, for the user.
    """

    head: Head
    file_from_head: Similarity
    unit_mm: float
    placed: str
    lips_part: bool
    notes: tuple[str, ...]

    def points_in_file(self) -> dict[str, dict[str, Floats]]:
        """Feature points and landmarks by kind and name, (3,) each: the file's axes, mm."""
        to_file = self.file_from_head
        found = {"feature point": {n: to_file.apply(p) for n, p in self.head.points.items()}}
        marks = self.head.mesh.landmarks
        if marks is not None:
            at = to_file.apply(marks.at(self.head.mesh.vertices))
            found["landmark"] = dict(zip(marks.names, at, strict=True))
        return found


def read_own_head(
    path: Path,
    points: Mapping[str, Floats] | None = None,
    *,
    finder: FaceFinder | None = None,
) -> OwnHead:
    """Read a head and prepare it for driving.

    Parameters
    ----------
    path : Path
        ``.obj``, ``.ply``, ``.glb`` or ``.vrm``.
    points : mapping from name to (3,) float64, optional
        At least three known points, in the file's axes and in its unit or millimetres: feature
        points (``"8.3"``), Farkas's landmarks (``"ch_l"``) or the plain names of
        `NAMED_LANDMARKS` (``"mouth_left"``). Feature points among them are taken as they are.
        Without any the face is looked for on pictures of the mesh.
    finder : FaceFinder, optional
        Else a new one, if it is needed.

    Raises
    ------
    FileFormatError
        If the file is damaged.
    InputError
        If no face is found and no points are given, or the points do not fit the mesh.
    OSError
        If the file cannot be read.
    """
    mesh = read_own_mesh(path)
    return own_head(mesh, path.stem, points, finder=finder)


def own_head(
    mesh: OwnMesh,
    name: str,
    points: Mapping[str, Floats] | None = None,
    *,
    finder: FaceFinder | None = None,
) -> OwnHead:
    """`read_own_head` of a mesh in memory."""
    start = head_start(mesh, name, points, finder)
    mesh, unit_mm, axes, notes = in_head_axes(mesh, start.template_from_file)
    head_from_file = Similarity(unit_mm, axes, np.zeros(3))
    template_from_head = start.template_from_file.after(head_from_file.inverse())
    near = template_from_head.apply(mesh.vertices)
    mesh, note = facing_out(mesh, near)
    notes += note
    skin = skin_triangles(near, mesh.triangles, expected_on_template().face)
    laid = lay_template(
        Surface(near, mesh.triangles[skin]), landmarks=start.landmarks, anchors=start.anchors
    )
    notes += _said_of_fit(laid)
    groups = sort_shells(
        near, mesh.triangles, mesh.labels, mesh.label_of_triangle, expected_on(laid.vertices)
    )
    straight, note = straightened(template_from_head, laid)
    notes += note
    laid = replace(laid, vertices=straight.after(template_from_head.inverse()).apply(laid.vertices))
    mesh = turned_mesh(mesh, straight)
    axes = straight.rotation @ axes
    mesh, groups, eyes, note = with_eyes(mesh, groups, laid)
    notes += note
    centre = (eyes["right"].centre + eyes["left"].centre) / 2
    mesh = replace(mesh, vertices=mesh.vertices - centre)
    laid = replace(laid, vertices=laid.vertices - centre)
    eyes = {side: Eye(eye.centre - centre, eye.radius) for side, eye in eyes.items()}
    head_from_file = Similarity(unit_mm, axes, -centre)
    given = {n: head_from_file.apply(p) for n, p in start.given.items()}
    placed = place_points(
        Surface(mesh.vertices, mesh.triangles[groups["skin"]]),
        mesh.vertices, mesh.triangles, groups, eyes, laid, given,
    )  # fmt: skip
    head = _assembled(
        mesh, name, groups, eyes, laid, placed, laid.placed.scale / template_from_head.scale
    )
    if "7.1" in given:
        head = replace(head, neck_pivot=given["7.1"])
    notes += _said_of_parts(head, placed)
    in_mm = Similarity(unit_mm, np.eye(3), np.zeros(3))
    return OwnHead(
        head,
        in_mm.after(head_from_file.inverse()),
        unit_mm,
        start.how,
        placed.lips_part,
        (*mesh.notes, *notes),
    )


def _assembled(
    mesh: OwnMesh,
    name: str,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
    laid: LaidTemplate,
    placed: PlacedPoints,
    size: float,
) -> Head:
    looks, uv, uv_triangles = own_appearance(mesh, mesh.vertices, groups, eyes)
    skin = Surface(mesh.vertices, mesh.triangles[groups["skin"]])
    marks = near_surface(skin, laid.at(template_landmarks()))
    jaw, neck = joints(laid.vertices, size)
    return Head(
        name=name,
        mesh=Mesh(
            mesh.vertices,
            mesh.triangles,
            uv,
            uv_triangles,
            groups,
            skin.points_at(tuple(marks), np.array(list(marks.values()))),
        ),
        feature_points=placed.points,
        eyes=eyes,
        jaw_pivot=jaw,
        neck_pivot=neck,
        appearance=looks,
        shape_names=mesh.shape_names,
        shapes=mesh.shapes,
        regions=_regions(mesh, groups["skin"], laid),
    )


def _regions(
    mesh: OwnMesh, skin: NDArray[np.int32], laid: LaidTemplate
) -> dict[str, NDArray[np.int32]]:
    """The template's regions on the skin: each triangle has that of the template beside it."""
    template = load_template()
    of_template = np.full(len(template.triangles), -1)
    regions = template_regions()
    for i, name in enumerate(REGIONS):
        of_template[regions[name]] = i
    chosen = np.flatnonzero(of_template >= 0)
    middles = mesh.vertices[mesh.triangles[skin]].mean(axis=1)
    scene = RayScene(laid.vertices, template.triangles[chosen])
    at, triangle, _ = scene.closest(middles)
    region = of_template[chosen[triangle]]
    region[np.linalg.norm(at - middles, axis=1) > _REGION_NEAR_MM] = -1
    found = {name: skin[region == i] for i, name in enumerate(REGIONS)}
    return {name: rows for name, rows in found.items() if len(rows)}


def _said_of_fit(laid: LaidTemplate) -> tuple[str, ...]:
    if laid.rms_mm > _POOR_RMS_MM or laid.covered < _POOR_COVER:
        return (
            f"our face fits it badly ({laid.rms_mm:.1f} mm off, {100 * laid.covered:.0f} % of it "
            "has a surface): look at the chart and correct the feature points",
        )
    return ()


def _said_of_parts(head: Head, placed: PlacedPoints) -> tuple[str, ...]:
    notes = []
    sizes = ", ".join(f"{part} {len(rows)}" for part, rows in head.mesh.groups.items())
    notes.append(f"its shells are taken for (triangles): {sizes}")
    if not placed.lips_part:
        notes.append("it has no opening between the lips: they move together")
    for side in ("right", "left"):
        if side not in placed.lids_open:
            notes.append(
                f"nothing shows between its {side} lids: they move, but there is no eye to close"
            )
    if head.shape_names:
        notes.append(f"it has {len(head.shape_names)} shapes of its own")
    return tuple(notes)
