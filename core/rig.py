"""Several cameras of one world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from .camera import Camera


@dataclass(frozen=True, eq=False)
class Rig:
    """Named cameras that share one world frame (mm).

    Attributes
    ----------
    cameras : mapping from name to Camera, in order
    """

    cameras: Mapping[str, Camera]

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ValueError("a camera rig needs at least one camera")
        object.__setattr__(self, "cameras", MappingProxyType(dict(self.cameras)))

    @property
    def names(self) -> tuple[str, ...]:
        """The cameras' names, in order."""
        return tuple(self.cameras)

    def __getitem__(self, name: str) -> Camera:
        return self.cameras[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)
