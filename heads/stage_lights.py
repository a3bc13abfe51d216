"""Lights about a head: what they are, ready-made ones, and ones drawn by chance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly


@dataclass(frozen=True, eq=False)
class Lamp:
    """A far, round source of light.

    Attributes
    ----------
    towards : (3,) float64, stage frame
        Where it stands: x left of the subject, y up, z out of the face. Made a unit vector.
    colour : (3,) float64, linear RGB
        π times the light that a white matt surface facing it sends back.
    spread_rad : float
        Half its angle: 0.3 is a large soft box, 0.005 the sun.
    """

    towards: NDArray[np.float64]
    colour: NDArray[np.float64]
    spread_rad: float = 0.25

    def __post_init__(self) -> None:
        towards = np.asarray(readonly(self.towards, (3,), "towards"))
        length = float(np.linalg.norm(towards))
        if not length > 0:
            raise ValueError("towards must have a length above 0")
        object.__setattr__(self, "towards", readonly(towards / length, (3,), "towards"))
        object.__setattr__(self, "colour", _colour(self.colour, "colour"))
        if not 0 < self.spread_rad < 1.4:
            raise ValueError(f"spread_rad must lie in 0..1.4, got {self.spread_rad}")


@dataclass(frozen=True, eq=False)
class StageLights:
    """Three lamps and the light from all around.

    Attributes
    ----------
    key : Lamp
        Casts shadows, glints in the eyes.
    fill : Lamp
        Casts no shadow of its own; hollows get less of it.
    rim : Lamp
        Usually from behind; casts shadows.
    sky, ground : (3,) float64, linear RGB
        Light from above and from below: what a white surface facing up or down sends back.
    """

    key: Lamp
    fill: Lamp
    rim: Lamp
    sky: NDArray[np.float64]
    ground: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sky", _colour(self.sky, "sky"))
        object.__setattr__(self, "ground", _colour(self.ground, "ground"))

    @classmethod
    def preset(cls, name: str) -> StageLights:
        """Ready-made lights.

        Parameters
        ----------
        name : str
            One of `LIGHT_NAMES`.

        Raises
        ------
        ValueError
            If there are none of that name.
        """
        if name not in _PRESETS:
            raise ValueError(f"lights must be one of {', '.join(LIGHT_NAMES)}, not {name}")
        return _PRESETS[name]

    @classmethod
    def random(cls, rng: np.random.Generator) -> StageLights:
        """Draw uncontrolled light, as where people take photographs.

        One of the presets with its lamps moved, dimmed, spread and tinted; now and then mirrored.
        The face stays readable: the key light never comes from behind it.
        """
        base = _PRESETS[str(rng.choice(LIGHT_NAMES))]
        side = float(rng.choice((-1.0, 1.0)))
        tint = np.exp(rng.normal(0, 0.06) * np.array([1.0, 0.1, -1.0]))

        def moved(lamp: Lamp) -> Lamp:
            towards = lamp.towards * (side, 1, 1) + rng.normal(0, 0.16, 3)
            strength = np.exp(rng.normal(0, 0.16)) * tint
            spread = float(np.clip(lamp.spread_rad * np.exp(rng.normal(0, 0.3)), 0.005, 0.9))
            return Lamp(towards, lamp.colour * strength, spread)

        key = moved(base.key)
        if key.towards[2] < 0.25:
            key = replace(key, towards=key.towards * (1, 1, 0) + (0, 0, 0.35))
        around = np.exp(rng.normal(0, 0.2, 2))
        return cls(
            key,
            moved(base.fill),
            moved(base.rim),
            base.sky * around[0] * tint,
            base.ground * around[1] * tint,
        )


def _colour(value: ArrayLike, name: str) -> NDArray[np.float64]:
    found = readonly(value, (3,), name)
    if not (found >= 0).all():
        raise ValueError(f"{name} must be at least 0, got {found}")
    return found


def _lamp(
    towards: tuple[float, float, float],
    colour: tuple[float, float, float],
    strength: float,
    spread_rad: float,
) -> Lamp:
    return Lamp(np.array(towards), np.array(colour) * strength, spread_rad)


def _around(colour: tuple[float, float, float], strength: float) -> NDArray[np.float64]:
    return np.array(colour) * strength


# chosen by eye so that a face of medium skin is exposed alike under all of them
_PRESETS: Mapping[str, StageLights] = MappingProxyType(
    {
        "studio": StageLights(
            key=_lamp((-0.52, 0.55, 0.80), (1.00, 0.92, 0.83), 3.16, 0.30),
            fill=_lamp((0.85, 0.10, 0.75), (0.93, 0.95, 1.00), 0.414, 0.45),
            rim=_lamp((0.80, 0.45, -0.75), (0.85, 0.93, 1.00), 1.725, 0.25),
            sky=_around((0.98, 0.98, 1.00), 0.37),
            ground=_around((1.00, 0.86, 0.78), 0.20),
        ),
        "window": StageLights(
            key=_lamp((-0.85, 0.28, 0.55), (0.96, 0.98, 1.00), 3.1, 0.50),
            fill=_lamp((0.80, 0.00, 0.70), (1.00, 0.90, 0.78), 0.45, 0.60),
            rim=_lamp((0.60, 0.50, -0.80), (1.00, 0.90, 0.80), 0.35, 0.40),
            sky=_around((1.00, 0.97, 0.94), 0.30),
            ground=_around((1.00, 0.88, 0.76), 0.20),
        ),
        "overcast": StageLights(
            key=_lamp((-0.10, 0.90, 0.60), (0.96, 0.98, 1.00), 1.45, 0.80),
            fill=_lamp((0.20, 0.10, 1.00), (0.95, 0.98, 1.00), 0.45, 0.80),
            rim=_lamp((0.20, 0.70, -0.70), (0.95, 0.98, 1.03), 0.70, 0.70),
            sky=_around((0.94, 0.98, 1.05), 0.66),
            ground=_around((0.96, 0.97, 0.92), 0.25),
        ),
        "warm room": StageLights(
            key=_lamp((0.35, 0.75, 0.75), (1.00, 0.83, 0.63), 2.3, 0.22),
            fill=_lamp((-0.80, 0.25, 0.60), (1.00, 0.86, 0.70), 0.90, 0.35),
            rim=_lamp((-0.55, 0.70, -0.60), (1.00, 0.82, 0.62), 0.90, 0.25),
            sky=_around((1.00, 0.90, 0.78), 0.34),
            ground=_around((1.00, 0.82, 0.64), 0.20),
        ),
        "hard sun": StageLights(
            key=_lamp((-0.55, 0.80, 0.62), (1.00, 0.95, 0.86), 3.9, 0.012),
            fill=_lamp((0.60, 0.10, 0.80), (0.85, 0.93, 1.00), 0.30, 0.60),
            rim=_lamp((0.50, 0.60, -0.60), (0.80, 0.90, 1.00), 0.35, 0.60),
            sky=_around((0.78, 0.90, 1.12), 0.34),
            ground=_around((1.00, 0.90, 0.74), 0.24),
        ),
    }
)
LIGHT_NAMES = tuple(_PRESETS)
