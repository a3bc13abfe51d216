"""What `facewright info` says of a file, the same for people and for JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Description:
    """What is in a file; the same for people and for JSON, so every name carries its unit.

    Attributes
    ----------
    contents : str
        In words: ``"camera rig"``.
    facts : mapping from name to value
    items_name : str
        What `items` are: ``"cameras"``.
    items : tuple of mappings
        One for each camera, marker, channel; all with the same keys.
    """

    contents: str
    facts: dict[str, Any]
    items_name: str = ""
    items: tuple[dict[str, Any], ...] = field(default=())
