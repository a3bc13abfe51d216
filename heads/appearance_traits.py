"""What a person looks like in a few numbers, and how to draw them by chance.

Colours are sRGB, 0 to 255.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]

CUTS = ("bald", "shaved", "fade", "buzz", "slick", "rows")
LONG_CUTS = CUTS[4:]
_HAIR = {
    "black": (26, 22, 21),
    "dark brown": (48, 34, 26),
    "brown": (80, 56, 38),
    "blond": (150, 116, 74),
    "red": (126, 66, 36),
    "grey": (148, 140, 131),
}
_IRIS = {
    "dark": (62, 36, 20),
    "brown": (98, 60, 30),
    "hazel": (116, 92, 50),
    "green": (98, 112, 76),
    "blue": (94, 126, 152),
    "grey": (116, 128, 134),
}


#: How often each of `CUTS` is worn, by women and by men.
_CUT_WEIGHTS = ((0.02, 0.06, 0.08, 0.30, 0.44, 0.25), (0.12, 0.2, 0.27, 0.3, 0.11, 0.1))
_SHARES = (
    "melanin", "ruddiness", "lip_redness", "stubble", "freckles", "weathering", "age", "tan",
    "blemishes",
)  # fmt: skip


@dataclass(frozen=True)
class AppearanceTraits:
    """What a person looks like; the defaults make a pleasant average one.

    Attributes
    ----------
    seed : int
        Where moles, single hairs, veins and mottling lie.
    melanin : float
        0 very light to 1 very dark skin.
    ruddiness : float
        0 pale to 1 flushed cheeks, nose and ears.
    lip_redness : float
        0 as the skin to 1 strongly coloured.
    hair, brow, iris : sRGB, 0 to 255
    cut : str
        One of `CUTS`: shaved smooth, shaved, a fade, a buzz cut, combed back, braided in rows.
    recession_mm : float
        How far the hairline has gone back, most at the temples.
    brow_thickness, brow_density : float
        1 is average.
    brow_arch_mm : float
        Added to the height of the arch.
    stubble : float
        0 none to 1 a three-day beard.
    freckles : float
        0 none to 1 many.
    n_moles : int
    weathering : float
        0 even to 1 blotchy skin.
    age : float
        As of `Identity`: 0 child, 0.5 young adult, 1 old. Pores grow with it, then furrows.
    tan : float
        0 none to 1 strongly tanned where the sun falls.
    blemishes : float
        0 none to 1 many.
    """

    seed: int = 0
    melanin: float = 0.3
    ruddiness: float = 0.45
    lip_redness: float = 0.5
    hair: Rgb = _HAIR["dark brown"]
    brow: Rgb = (52, 38, 30)
    iris: Rgb = _IRIS["brown"]
    cut: str = "buzz"
    recession_mm: float = 0.0
    brow_thickness: float = 1.0
    brow_density: float = 1.0
    brow_arch_mm: float = 0.0
    stubble: float = 0.0
    freckles: float = 0.0
    n_moles: int = 3
    weathering: float = 0.3
    age: float = 0.5
    tan: float = 0.15
    blemishes: float = 0.0

    def __post_init__(self) -> None:
        if self.cut not in CUTS:
            raise ValueError(f"cut must be one of {', '.join(CUTS)}, not {self.cut}")
        for name in _SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in 0..1, got {getattr(self, name)}")

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        *,
        ancestry: Mapping[str, float],
        age: float,
        female: float,
    ) -> AppearanceTraits:
        """Draw traits that go with a phenotype (as of `Identity`).

        Children are smooth, fair of hair and without whiskers; old people grey, furrowed, blotchy.
        """
        rng = np.random.default_rng(rng.integers(2**63))  # one draw of the caller's, always
        names = ("african", "asian", "caucasian")
        shares = np.array([max(ancestry.get(n, 0.0), 0.0) for n in names])
        shares = shares / shares.sum() if shares.sum() > 0 else np.full(3, 1 / 3)
        origin = names[rng.choice(3, p=shares)]
        melanin = float(shares @ (0.82, 0.34, 0.20) + rng.normal(0, 0.06))
        if melanin > 0.38 and origin == "caucasian":  # light eyes and hair go with light skin
            origin = "african"
        young = float(np.clip((0.45 - age) / 0.3, 0, 1))  # 1 up to about twelve years
        old = float(np.clip((age - 0.5) / 0.5, 0, 1))
        male = female < 0.5
        hair, brow = _drawn_colours(rng, origin, age, young)
        iris = np.array(_IRIS[_drawn_iris(rng, origin)]) * rng.uniform(0.9, 1.1)
        recession = max(0.0, rng.normal(3 + 22 * (age - 0.5), 4)) if male else 0.0
        freckles = rng.random() ** 2 * (0.9 if origin == "caucasian" and melanin < 0.3 else 0.15)
        stubble = float(rng.choice([0.08, 0.3, 0.65], p=[0.4, 0.35, 0.25]) * rng.uniform(0.8, 1.2))
        thickness = rng.normal(1.12 if male else 0.85, 0.14) * (1 - 0.18 * young)
        return cls(
            seed=int(rng.integers(2**31)),
            melanin=float(np.clip(melanin, 0.03, 0.97)),
            ruddiness=float(np.clip(rng.uniform(0.25, 0.65) + 0.12 * young, 0, 1)),
            lip_redness=float(
                np.clip(
                    rng.normal(0.45 + 0.12 * (not male) + 0.05 * young - 0.2 * old, 0.12), 0.1, 0.85
                )
            ),
            hair=_rgb(hair),
            brow=_rgb(brow),
            iris=_rgb(iris),
            cut=_drawn_cut(rng, origin, male=male, old=old, young=young),
            recession_mm=float(recession) * (1 - young),
            brow_thickness=float(np.clip(thickness, 0.6, 1.5)),
            brow_density=float(np.clip(rng.normal(1.0, 0.12) - 0.15 * young, 0.6, 1.3)),
            brow_arch_mm=float(rng.normal(-0.2 if male else 0.5, 0.6)),
            stubble=float(np.clip(stubble, 0, 1)) if male and age > 0.38 else 0.0,
            freckles=float(freckles),
            n_moles=int(rng.poisson(4 * (1 - 0.7 * young))),
            weathering=float(np.clip(0.15 + 0.6 * (age - 0.4) + rng.normal(0, 0.08), 0, 1)),
            age=float(np.clip(age, 0, 1)),
            tan=float(rng.random() ** 2 * 0.8 * (1 - 0.5 * young)),
            blemishes=float(rng.random() ** 3 * (0.9 if 0.28 < age < 0.6 else 0.2)),
        )


def _drawn_colours(
    rng: np.random.Generator, origin: str, age: float, young: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Colours of hair and brows: children's are lighter, old people's grey or white."""
    name = _drawn_hair(rng, origin)
    hair = np.array(_HAIR[name]) * rng.uniform(0.85, 1.15)
    if origin == "caucasian":
        hair = hair + 0.22 * young * (np.array(_HAIR["blond"]) - hair)
    brow = hair * 0.8 + np.array((6.0, 4, 3)) if name != "blond" else hair * 0.68
    grey = float(np.clip((age - 0.62) * 3.5 + rng.normal(0, 0.15), 0, 0.97))
    white = np.array(_HAIR["grey"]) + rng.uniform(-0.15, 1.0) * np.array((50.0, 51, 52))
    hair = hair * (1 - grey) + white * grey
    return hair, brow * (1 - 0.45 * grey) + np.array(_HAIR["grey"]) * 0.45 * grey


def _drawn_cut(
    rng: np.random.Generator, origin: str, *, male: bool, old: float, young: float
) -> str:
    weights = np.array(_CUT_WEIGHTS[male], dtype=np.float64)
    weights[CUTS.index("bald")] *= (1 + 2.5 * old if male else 1) * (1 - young)
    weights[CUTS.index("shaved")] *= 1 - 0.7 * young
    if origin != "african":
        weights[CUTS.index("rows")] = 0
    return str(rng.choice(CUTS, p=weights / weights.sum()))


def _rgb(colour: NDArray[Any]) -> Rgb:
    r, g, b = np.clip(colour, 0, 255)
    return float(r), float(g), float(b)


def _drawn_hair(rng: np.random.Generator, origin: str) -> str:
    if origin != "caucasian":
        return str(rng.choice(["black", "dark brown"], p=[0.75, 0.25]))
    return str(
        rng.choice(["black", "dark brown", "brown", "blond", "red"], p=[0.1, 0.3, 0.3, 0.22, 0.08])
    )


def _drawn_iris(rng: np.random.Generator, origin: str) -> str:
    if origin != "caucasian":
        return str(rng.choice(["dark", "brown"], p=[0.7, 0.3]))
    return str(
        rng.choice(
            ["dark", "brown", "hazel", "green", "blue", "grey"],
            p=[0.1, 0.28, 0.14, 0.12, 0.26, 0.1],
        )
    )
