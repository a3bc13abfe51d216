"""The fixed table of what ARKit's shapes are in FAPs; `arkit` says how it is used."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from .. import heads
from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..core.mpeg4 import fap_table


@dataclass(frozen=True)
class DirectRow:
    """One shape's effect on one FAP.

    Attributes
    ----------
    fap : str
    amount : float, table units
        At weight 1.
    is_key : bool
        Whether the shape is told by this FAP.
    """

    fap: str
    amount: float
    is_key: bool


@cache
def direct_table() -> Mapping[str, tuple[DirectRow, ...]]:
    """ARKit name → FAPs: all 52, each with a key FAP at least."""
    text = files(heads).joinpath("data", "arkit_faps.csv").read_text(encoding="utf-8")
    found: dict[str, list[DirectRow]] = {name: [] for name in ARKIT_SHAPES}
    for row in csv.DictReader(text.splitlines()):
        fap = fap_table()[int(row["fap"]) - 1].name
        found[row["shape"]].append(DirectRow(fap, float(row["amount"]), row["is_key"] == "1"))
    return MappingProxyType({name: tuple(rows) for name, rows in found.items()})
