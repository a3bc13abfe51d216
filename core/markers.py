"""Marker sets: what is glued to the face, and where."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InputError
from .mpeg4 import Fapu, feature_point_table

#: What a marker on the skull carries instead of a feature point.
HEAD = "head"
MIN_HEAD_MARKERS = 3


@dataclass(frozen=True)
class Marker:
    """One dot.

    Attributes
    ----------
    label : str
        Its name in trajectories.
    feature_point : str
        An MPEG-4 feature point (``"8.1"``), or ``"head"`` for one that moves with the skull only.
    template_mm : (3,) floats or None
        For head markers: roughly where on an average head, head frame (x to the subject's left,
        y up, z forward, origin between the pupils), so that it can be told from its neighbours.
    """

    label: str
    feature_point: str
    template_mm: tuple[float, float, float] | None = None

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

    Raises
    ------
    InputError
        Duplicate labels, two markers on one feature point, an unknown feature point, a head
        marker without a place, or fewer than 3 head markers.
    """

    name: str
    markers: tuple[Marker, ...]
    fapu: Fapu | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        for what in ("label", "feature_point"):
            seen: set[str] = set()
            for marker in self.markers:
                value = getattr(marker, what)
                if value in seen and value != HEAD:
                    raise InputError(
                        f"marker set {self.name}: {what.replace('_', ' ')} {value} is given twice"
                    )
                seen.add(value)
        for marker in self.markers:
            if marker.is_rigid:
                if marker.template_mm is None:
                    raise InputError(
                        f"marker set {self.name}: head marker {marker.label} needs template_mm = "
                        "[x, y, z], its rough place on the head"
                    )
            elif marker.feature_point not in feature_point_table():
                raise InputError(
                    f"marker set {self.name}: marker {marker.label} names unknown feature point "
                    f'{marker.feature_point} (expected one like "8.1", or "head")'
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
        """Labels by feature-point id (head markers apart)."""
        return {m.feature_point: m.label for m in self.markers if not m.is_rigid}
