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

from .face_finder import FaceFinder
from .head import Eye, Head
from .head_facts import HeadFacts
from .own_assembly import assembled
from .own_eyes import with_eyes
from .own_files import read_own_mesh
from .own_frame import facing_out, in_head_axes, straightened, turned_mesh
from .own_kept import kept_head
from .own_mesh import OwnMesh, with_own_vertices
from .own_points import PlacedPoints, place_points
from .own_shells import expected_on, expected_on_template, skin_triangles, sort_shells
from .own_start import HeadStart, head_start, in_the_files_unit
from .similarity import Similarity
from .skin_surface import Surface
from .template import template_feature_points
from .template_warp import LaidTemplate, lay_template

Floats = NDArray[np.float64]

#: Beyond these our face is no likely one, or does not lie on it. Measured: people 0.15 mm, 0.98 and
#: 2 (standard deviations), a scanned head 0.5, 0.96 and 3, a mask 0.35, 0.84 and 2, a ball 1.05,
#: 0.66 and 4.8, a person twice as tall 0.5, 0.92 and 5.4.
_POOR_RMS_MM, _POOR_COVER, _ODD = 0.8, 0.75, 4.5
_LIPS_TOGETHER = "it has no opening between the lips: they move together"
_CHANGED = "it was changed since facewright wrote it: it is recognised anew"


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
        How the feature points came about: ``"given"``, ``"found"``, or ``"kept"`` of a file that
        facewright wrote.
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
        Without any the face is looked for on pictures of the mesh. A file of ours knows its
        points; those given here correct them.
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
    if mesh.facts is not None:
        kept = _kept(mesh, mesh.facts, name, points)
        if kept is not None:
            return kept
        mesh = replace(mesh, facts=None, notes=(*mesh.notes, _CHANGED))
    start = head_start(mesh, name, points, finder)
    framed = _in_template_frame(mesh, start.template_from_file)
    framed, laid, groups = _laid_and_sorted(framed, start)
    framed, laid, groups, eyes = _with_origin_between_eyes(framed, laid, groups)
    given = {n: framed.head_from_file.apply(p) for n, p in start.given.items()}
    mesh = framed.mesh
    skin = Surface(mesh.vertices, mesh.triangles[groups["skin"]])
    placed = place_points(skin, mesh.vertices, mesh.triangles, groups, eyes, laid, given)
    size = laid.placed.scale / framed.template_from_head.scale
    head = assembled(mesh, name, groups, eyes, laid, placed.points, size)
    if "7.1" in given:
        head = replace(head, neck_pivot=given["7.1"])
    unit_mm = framed.head_from_file.scale
    in_mm = Similarity(unit_mm, np.eye(3), np.zeros(3))
    return OwnHead(
        head,
        in_mm.after(framed.head_from_file.inverse()),
        unit_mm,
        start.how,
        placed.lips_part,
        (*mesh.notes, *framed.notes, *_said_of_parts(head, placed)),
    )


def _kept(
    mesh: OwnMesh, facts: HeadFacts, name: str, points: Mapping[str, Floats] | None
) -> OwnHead | None:
    """The head of a file that we wrote; None if it must be recognised as any other."""
    given: dict[str, Floats] = {}
    if points is not None:
        if not set(points) <= {*facts.points, *facts.landmarks, *template_feature_points().names,
                               "7.1", "11.5"}:  # fmt: skip
            return None
        given = in_the_files_unit(mesh, name, points)
    head = kept_head(mesh, given)
    if head is None:
        return None
    note = "facewright wrote this head: its parts and points are known"
    unmoved = Similarity(1.0, np.eye(3), np.zeros(3))
    said = () if facts.lips_part else (_LIPS_TOGETHER,)
    return OwnHead(
        head, unmoved, 1.0, "kept", facts.lips_part, (note, *said, *_said_of_shapes(head))
    )


@dataclass(frozen=True, eq=False)
class _Framed:
    """A mesh in the head's axes and mm, and where it and the template are."""

    mesh: OwnMesh
    head_from_file: Similarity
    template_from_head: Similarity
    notes: tuple[str, ...]


def _in_template_frame(mesh: OwnMesh, template_from_file: Similarity) -> _Framed:
    """Unit, axes and outside put right; the origin is still the file's."""
    mesh, unit_mm, axes, notes = in_head_axes(mesh, template_from_file)
    head_from_file = Similarity(unit_mm, axes, np.zeros(3))
    template_from_head = template_from_file.after(head_from_file.inverse())
    mesh, note = facing_out(mesh, template_from_head.apply(mesh.vertices))
    return _Framed(mesh, head_from_file, template_from_head, (*notes, *note))


def _laid_and_sorted(
    framed: _Framed, start: HeadStart
) -> tuple[_Framed, LaidTemplate, dict[str, NDArray[np.int32]]]:
    """The template laid onto the skin, the shells told apart, the head set straight."""
    mesh, template_from_head = framed.mesh, framed.template_from_head
    near = template_from_head.apply(mesh.vertices)
    skin = skin_triangles(near, mesh.triangles, expected_on_template().face)
    laid = lay_template(
        Surface(near, mesh.triangles[skin]), landmarks=start.landmarks, anchors=start.anchors
    )
    groups = sort_shells(
        near, mesh.triangles, mesh.labels, mesh.label_of_triangle, expected_on(laid.vertices)
    )
    mesh, n_doubled = with_own_vertices(mesh, groups)
    straight, note = straightened(template_from_head, laid)
    if n_doubled:
        note = (*note, "gums of both jaws are one shell: it is cut, so that the lower ones move")
    in_head = straight.after(template_from_head.inverse())
    laid = replace(laid, vertices=in_head.apply(laid.vertices))
    framed = replace(
        framed,
        mesh=turned_mesh(mesh, straight),
        head_from_file=straight.after(framed.head_from_file),
        notes=(*framed.notes, *_said_of_fit(laid), *note),
    )
    return framed, laid, groups


def _with_origin_between_eyes(
    framed: _Framed, laid: LaidTemplate, groups: dict[str, NDArray[np.int32]]
) -> tuple[_Framed, LaidTemplate, dict[str, NDArray[np.int32]], dict[str, Eye]]:
    """Eyes measured or put in, and everything shifted so that the origin is between them."""
    mesh, groups, eyes, note = with_eyes(framed.mesh, groups, laid)
    centre = (eyes["right"].centre + eyes["left"].centre) / 2
    shift = Similarity(1.0, np.eye(3), -centre)
    framed = replace(
        framed,
        mesh=replace(mesh, vertices=mesh.vertices - centre),
        head_from_file=shift.after(framed.head_from_file),
        notes=(*framed.notes, *note),
    )
    laid = replace(laid, vertices=laid.vertices - centre)
    eyes = {side: Eye(eye.centre - centre, eye.radius) for side, eye in eyes.items()}
    return framed, laid, groups, eyes


def _said_of_fit(laid: LaidTemplate) -> tuple[str, ...]:
    odd = []
    if laid.rms_mm > _POOR_RMS_MM:
        odd.append(f"{laid.rms_mm:.1f} mm off")
    if laid.covered < _POOR_COVER:
        odd.append(f"only {100 * laid.covered:.0f} % of it beside a surface")
    if laid.unusual > _ODD:
        odd.append(f"{laid.unusual:.0f} standard deviations from people's proportions")
    if not odd:
        return ()
    return (
        f"our face fits it badly ({', '.join(odd)}): look at the chart and correct the feature "
        "points",
    )


def _said_of_parts(head: Head, placed: PlacedPoints) -> tuple[str, ...]:
    notes = []
    sizes = ", ".join(f"{part} {len(rows)}" for part, rows in head.mesh.groups.items())
    notes.append(f"its shells are taken for (triangles): {sizes}")
    if not placed.lips_part:
        notes.append(_LIPS_TOGETHER)
    for side in ("right", "left"):
        if side not in placed.lids_open:
            notes.append(
                f"nothing shows between its {side} lids: they move, but there is no eye to close"
            )
    return (*notes, *_said_of_shapes(head))


def _said_of_shapes(head: Head) -> tuple[str, ...]:
    if not head.shape_names:
        return ()
    return (f"it has {len(head.shape_names)} shapes of its own",)
