"""Marker sets: what is glued to the face, and where."""

from __future__ import annotations

import re
from dataclasses import dataclass

from .errors import InputError
from .mpeg4 import Fapu, feature_point_table

#: What a marker on the skull carries instead of a feature point.
HEAD = "head"
#: What a marker carries that moves with the skin but shows no feature point.
FACE = "face"
MIN_HEAD_MARKERS = 3
MAX_STANDOFF_MM = 50.0
_COLOUR = re.compile("#[0-9a-fA-F]{6}")


@dataclass(frozen=True)
class Marker:
    """One dot or ball.

    Attributes
    ----------
    label : str
        Its name in trajectories.
    feature_point : str
        An MPEG-4 feature point (``"8.1"``), ``"head"`` for one that moves with the skull only, or
        ``"face"`` for one that moves with the skin between feature points.
    template_mm : (3,) floats or None
        For head and face markers: roughly where on an average head, head frame (x to the
        subject's left, y up, z forward, origin between the pupils), so that it can be told from
        its neighbours.
    colour : str or None
        ``"#rrggbb"`` (sRGB) of a painted marker; None for one that shines or that is only known
        to differ from the skin.
    """

    label: str
    feature_point: str
    template_mm: tuple[float, float, float] | None = None
    colour: str | None = None

    @property
    def is_rigid(self) -> bool:
        """Whether the marker moves with the skull."""
        return self.feature_point == HEAD


@dataclass(frozen=True)
class MarkerSet:
    """A set of markers; labels and feature points are unique.

    Attributes
    ----------
    name : str
    markers : tuple of Marker
    fapu : Fapu or None
        The performer's units, where they were measured.
    diameter_mm : float or None
        Of the markers; None if not known.
    standoff_mm : float
        How far the centre of a ball stands off the skin; 0 for flat dots.

    Raises
    ------
    InputError
        Duplicate labels, two markers on one feature point, an unknown feature point, a head or
        face marker without a place, a colour or length that is none, or fewer than 3 head markers.
    """

    name: str
    markers: tuple[Marker, ...]
    fapu: Fapu | None = None
    diameter_mm: float | None = None
    standoff_mm: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        for what in ("label", "feature_point"):
            seen: set[str] = set()
            for marker in self.markers:
                value = getattr(marker, what)
                if value in seen and value not in (HEAD, FACE):
                    raise InputError(
                        f"marker set {self.name}: {what.replace('_', ' ')} {value} is given twice"
                    )
                seen.add(value)
        for marker in self.markers:
            if marker.colour is not None and not _COLOUR.fullmatch(marker.colour):
                raise InputError(
                    f'marker set {self.name}: marker {marker.label} has colour "{marker.colour}" '
                    '(expected one like "#20a040")'
                )
            if marker.feature_point in (HEAD, FACE):
                if marker.template_mm is None:
                    raise InputError(
                        f"marker set {self.name}: {marker.feature_point} marker {marker.label} "
                        "needs template_mm = [x, y, z], its rough place on the head"
                    )
            elif marker.feature_point not in feature_point_table():
                raise InputError(
                    f"marker set {self.name}: marker {marker.label} names unknown feature point "
                    f'{marker.feature_point} (expected one like "8.1", "head" or "face")'
                )
        if not 0 <= self.standoff_mm < MAX_STANDOFF_MM:
            raise InputError(
                f"marker set {self.name}: standoff_mm is {self.standoff_mm:g} (expected 0 to "
                f"{MAX_STANDOFF_MM:g})"
            )
        if self.diameter_mm is not None and not 0 < self.diameter_mm < MAX_STANDOFF_MM:
            raise InputError(
                f"marker set {self.name}: diameter_mm is {self.diameter_mm:g} (expected up to "
                f"{MAX_STANDOFF_MM:g})"
            )
        if len(self.head_labels) < MIN_HEAD_MARKERS:
            raise InputError(
                f"marker set {self.name}: head motion needs at least {MIN_HEAD_MARKERS} markers "
                f'with feature_point = "head", found {len(self.head_labels)}'
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """All labels, in order."""
        return tuple(m.label for m in self.markers)

    @property
    def head_labels(self) -> tuple[str, ...]:
        """Labels of the markers that move with the skull."""
        return tuple(m.label for m in self.markers if m.is_rigid)

    @property
    def label_by_feature_point(self) -> dict[str, str]:
        """Labels by feature-point id, of the markers that show one."""
        return {
            m.feature_point: m.label for m in self.markers if m.feature_point not in (HEAD, FACE)
        }
