"""The MPEG-4 facial tables and units.

Facts of ISO/IEC 14496-2 annex C, from the CSV files in `data/` (collected and checked against
several public implementations; the columns marked there as from memory only are not used here).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

#: Fields that the two high-level FAPs take in a .fap file, as channel names.
VISEME_FIELDS = ("viseme.select1", "viseme.select2", "viseme.blend", "viseme.def")
EXPRESSION_FIELDS = (
    "expression.select1",
    "expression.intensity1",
    "expression.select2",
    "expression.intensity2",
    "expression.init_face",
    "expression.def",
)
ANGLE_UNIT_RAD = 1e-5
N_FAPS = 68

_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Fap:
    """One facial animation parameter.

    Attributes
    ----------
    number : int
        1 to 68.
    name : str
    fapu : str
        ``"MNS"``, ``"MW"``, ``"ENS"``, ``"ES"``, ``"IRISD"`` (1/1024 of that distance), ``"AU"``
        (1e-5 rad), or ``"na"``.
    feature_points : tuple of str
        What it moves; empty for FAPs 1 and 2.
    axis : str
        ``"-y"``: displacement along the head's axis; ``"rot+x"``: right-handed rotation;
        ``"scale"``; ``""``.
    """

    number: int
    name: str
    fapu: str
    feature_points: tuple[str, ...]
    axis: str

    @property
    def direction(self) -> NDArray[np.float64] | None:
        """(3,) unit vector, head frame, of positive motion; None unless a displacement."""
        if len(self.axis) != 2:
            return None
        found = np.zeros(3)
        found[_AXES[self.axis[1]]] = 1.0 if self.axis[0] == "+" else -1.0
        return found

    @property
    def is_rotation(self) -> bool:
        """Whether the unit is an angle about one of the head's axes."""
        return self.axis.startswith("rot+") or self.axis.startswith("rot-")


@dataclass(frozen=True)
class FeaturePoint:
    """One of the 84 feature points: its id (``"8.1"``), wording, and its mirror image's id.

    `mirror_id` is empty for points of the middle.
    """

    id: str
    description: str
    mirror_id: str


def _rows(name: str) -> list[dict[str, str]]:
    text = files(__package__).joinpath("data", name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def fap_table() -> tuple[Fap, ...]:
    """The 68 FAPs in order."""
    return tuple(
        Fap(
            int(row["number"]),
            row["name"],
            row["fapu"],
            tuple(row["fdp_point"].split()),
            row["axis"].replace(" (bend)", ""),
        )
        for row in _rows("faps.csv")
    )


@cache
def fap_by_name() -> Mapping[str, Fap]:
    """The FAPs by name."""
    return {fap.name: fap for fap in fap_table()}


@cache
def feature_point_table() -> Mapping[str, FeaturePoint]:
    """The 84 feature points by id."""
    return {
        row["id"]: FeaturePoint(row["id"], row["description"], row["mirror_id"])
        for row in _rows("feature_points.csv")
    }


def fap_channels() -> tuple[str, ...]:
    """Names of all channels that FAPs make: 4 + 6 fields of FAPs 1 and 2, then FAPs 3 to 68."""
    return (*VISEME_FIELDS, *EXPRESSION_FIELDS, *(fap.name for fap in fap_table()[2:]))


@dataclass(frozen=True)
class Fapu:
    """Facial animation parameter units: distances on the neutral face, mm.

    Attributes
    ----------
    irisd : float
        Iris diameter, by definition between upper and lower eyelid: 3.1.y − 3.3.y.
    es : float
        Eye separation, 3.5.x − 3.6.x.
    ens : float
        Eye-nose separation, 3.5.y − 9.15.y.
    mns : float
        Mouth-nose separation, 9.15.y − 2.2.y.
    mw : float
        Mouth width, 8.3.x − 8.4.x.
    """

    irisd: float
    es: float
    ens: float
    mns: float
    mw: float

    def __post_init__(self) -> None:
        for name, value in self.as_dict().items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(
                    f"the facial animation unit {name} must be a length above 0 mm, got {value:g}: "
                    "are the feature points of the neutral face right?"
                )

    def as_dict(self) -> dict[str, float]:
        """The five distances by the names the FAP table uses, mm."""
        return {
            "IRISD": self.irisd,
            "ES": self.es,
            "ENS": self.ens,
            "MNS": self.mns,
            "MW": self.mw,
        }

    def unit(self, fap: Fap) -> float:
        """What a value of 1 means: mm for displacements, rad for angles.

        Raises ValueError for FAPs 1 and 2, which have no unit.
        """
        if fap.fapu == "AU":
            return ANGLE_UNIT_RAD
        if fap.fapu == "na":
            raise ValueError(f"FAP {fap.number} ({fap.name}) has no unit")
        return self.as_dict()[fap.fapu] / 1024

    @classmethod
    def from_points(cls, points: Mapping[str, ArrayLike]) -> Fapu:
        """Measure a neutral face.

        Parameters
        ----------
        points : mapping from feature-point id to (3,) float, mm, head frame
            Needs 2.2, 3.1 to 3.6, 8.3, 8.4 and 9.15.

        Raises
        ------
        InputError
            If a point is missing or a distance is not positive.
        """
        needed = ("2.2", "3.1", "3.2", "3.3", "3.4", "3.5", "3.6", "8.3", "8.4", "9.15")
        missing = [n for n in needed if n not in points]
        if missing:
            raise InputError(f"units need feature points {', '.join(missing)}, which are missing")
        p = {n: np.asarray(points[n], dtype=np.float64) for n in needed}
        lids = (p["3.1"] - p["3.3"] + p["3.2"] - p["3.4"]) / 2  # mean of both eyes
        pupils = (p["3.5"] + p["3.6"]) / 2
        return cls(
            irisd=float(lids[1]),
            es=float(p["3.5"][0] - p["3.6"][0]),
            ens=float(pupils[1] - p["9.15"][1]),
            mns=float(p["9.15"][1] - p["2.2"][1]),
            mw=float(p["8.3"][0] - p["8.4"][0]),
        )


def displacement_faps(
    displacements: Mapping[str, NDArray[np.float64]], fapu: Fapu
) -> dict[str, NDArray[np.float64]]:
    """FAP values, by name, of feature points' displacements from the neutral face.

    Parameters
    ----------
    displacements : mapping from feature-point id to (T, 3) float64, mm, head frame
        NaN where unknown; unknown stays NaN.
    fapu : Fapu
        Of the face that moved.

    Returns
    -------
    mapping from FAP name to (T,) float64, table units
        Every FAP that is a displacement of one of the points (rotations, scalings and the
        high-level FAPs are not among them).
    """
    found = {}
    for fap in fap_table():
        direction = fap.direction
        if direction is None or not fap.feature_points:
            continue
        point = fap.feature_points[0]
        if point in displacements:
            found[fap.name] = displacements[point] @ direction / fapu.unit(fap)
    return found


def rotation_faps(rotation: ArrayLike) -> NDArray[np.float64]:
    """Pitch, yaw and roll of rotations, (..., 3), as in FAPs 48 to 50.

    The order of the three turns is ours, since the tables give none: ``R = Ry(yaw) Rx(pitch)
    Rz(roll)``, the nod being about the head's own, already turned, left-right axis.

    Parameters
    ----------
    rotation : (..., 3, 3) float64

    Returns
    -------
    (..., 3) float64, units of 1e-5 rad
    """
    R = np.asarray(rotation, dtype=np.float64)
    pitch = np.arcsin(np.clip(-R[..., 1, 2], -1, 1))
    yaw = np.arctan2(R[..., 0, 2], R[..., 2, 2])
    roll = np.arctan2(R[..., 1, 0], R[..., 1, 1])
    return np.stack([pitch, yaw, roll], axis=-1) / ANGLE_UNIT_RAD


def rotation_of_faps(pitch_yaw_roll: ArrayLike) -> NDArray[np.float64]:
    """The inverse of `rotation_faps`: (..., 3) in 1e-5 rad to (..., 3, 3)."""
    angles = np.asarray(pitch_yaw_roll, dtype=np.float64) * ANGLE_UNIT_RAD
    (sp, sy, sr), (cp, cy, cr) = (np.moveaxis(f(angles), -1, 0) for f in (np.sin, np.cos))
    rows = [
        [cy * cr + sy * sp * sr, -cy * sr + sy * sp * cr, sy * cp],
        [cp * sr, cp * cr, -sp],
        [-sy * cr + cy * sp * sr, sy * sr + cy * sp * cr, cy * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
