"""FAPs that say where a point is in the head, though the jaw carries it besides.

Tables are added up. A FAP of the tongue is where its point goes, whatever the jaw does
(`riders.bend_tongue`), and so are the jaw's own thrust (`jaw.jaw_motion`) and the chin's FAP: were
their tables added to those of the jaw, the jaw would count twice. So the way on which the jaw's
tables carry the point along the FAP's axis is taken from the FAP's value first.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..core.fat import FacialTables, FapTable
from ..core.mesh import SurfacePoints
from ..core.mpeg4 import fap_by_name
from ..heads.head import Head
from .jaw import CHIN, CHIN_BOTTOM
from .limits import HeadLimits, bend

Floats = NDArray[np.float64]

_JAW = ("open_jaw", "thrust_jaw", "shift_jaw")
#: FAP → the point that it moves, and the FAPs whose tables carry that point. The thrust comes
#: first: what is left of it is what carries the others.
CARRIED: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "thrust_jaw": (CHIN_BOTTOM, ("open_jaw",)),
    "depress_chin": (CHIN, _JAW),
    "shift_tongue_tip": ("6.1", _JAW),
    "raise_tongue_tip": ("6.1", _JAW),
    "thrust_tongue_tip": ("6.1", _JAW),
    "raise_tongue": ("6.2", _JAW),
}


class CarriedFaps:
    """What such FAPs say beyond what the jaw's tables do.

    As in the drive, one that is 0 throughout says nothing. Ranges of these FAPs bend their values
    here, and not in their tables, which go on beyond them.

    Parameters
    ----------
    head : Head
    tables : FacialTables
    """

    def __init__(self, head: Head, tables: FacialTables) -> None:
        self._ranges = HeadLimits(head, says=False).ranges
        self._ways: dict[str, list[tuple[str, Floats, Floats]]] = {}
        for name, (point, carriers) in CARRIED.items():
            fap = fap_by_name()[name]
            if fap.direction is None or point not in head.feature_points.names:
                continue
            axis = int(np.abs(fap.direction).argmax())
            mm = head.fapu.unit(fap) * fap.direction[axis]
            at = head.feature_points.select((point,))
            found = [t for t in (tables.of(carrier) for carrier in carriers) if t is not None]
            self._ways[name] = [(t.fap, t.knots, _moved(t, at)[:, axis] / mm) for t in found]

    def relative(self, faps: Mapping[str, Floats]) -> dict[str, Floats]:
        """FAPs, (T,) each in table units, as tables that are added up take them."""
        found = dict(faps)
        for name, ways in self._ways.items():
            if name not in faps or not faps[name].any():
                continue
            found[name] = bend(faps[name], self._ranges[name])
            for carrier, knots, values in ways:
                if carrier in faps:
                    found[name] = found[name] - np.interp(found[carrier], knots, values)
        return found


def _moved(table: FapTable, point: SurfacePoints) -> Floats:
    """How far a point moves at each knot, (K, 3) mm."""
    found = np.zeros((len(table.knots), 3))
    for corner, share in zip(point.corners[0], point.barycentric[0], strict=True):
        at = int(np.searchsorted(table.vertices, corner))
        if at < len(table.vertices) and table.vertices[at] == corner:
            found += share * table.offsets[:, at]
    return found
