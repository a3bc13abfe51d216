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

CUTS = ("bald", "shaved", "fade", "buzz")
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
        One of `CUTS`: shaved smooth, shaved, a fade, a buzz cut.
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

    def __post_init__(self) -> None:
        if self.cut not in CUTS:
            raise ValueError(f"cut must be one of {', '.join(CUTS)}, not {self.cut}")
        for name in ("melanin", "ruddiness", "lip_redness", "stubble", "freckles", "weathering"):
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
        """Draw traits that go with a phenotype (as of `Identity`)."""
        names = ("african", "asian", "caucasian")
        shares = np.array([max(ancestry.get(n, 0.0), 0.0) for n in names])
        shares = shares / shares.sum() if shares.sum() > 0 else np.full(3, 1 / 3)
        origin = names[rng.choice(3, p=shares)]
        melanin = float(shares @ (0.82, 0.34, 0.20) + rng.normal(0, 0.06))
        if melanin > 0.38 and origin == "caucasian":  # light eyes and hair go with light skin
            origin = "african"
        hair_name = _drawn_hair(rng, origin)
        hair = np.array(_HAIR[hair_name]) * rng.uniform(0.85, 1.15)
        brow = hair * 0.8 + np.array((6.0, 4, 3)) if hair_name != "blond" else hair * 0.68
        grey = float(np.clip((age - 0.62) * 3.5 + rng.normal(0, 0.15), 0, 0.95))
        hair = hair * (1 - grey) + np.array(_HAIR["grey"]) * grey
        brow = brow * (1 - 0.45 * grey) + np.array(_HAIR["grey"]) * 0.45 * grey
        male = female < 0.5
        iris = np.array(_IRIS[_drawn_iris(rng, origin)]) * rng.uniform(0.9, 1.1)
        cut = str(rng.choice(CUTS, p=(0.12, 0.22, 0.3, 0.36) if male else (0.04, 0.16, 0.2, 0.6)))
        recession = max(0.0, rng.normal(3 + 22 * (age - 0.5), 4)) if male else 0.0
        freckles = rng.random() ** 2 * (0.9 if origin == "caucasian" and melanin < 0.3 else 0.15)
        return cls(
            seed=int(rng.integers(2**31)),
            melanin=float(np.clip(melanin, 0.03, 0.97)),
            ruddiness=float(rng.uniform(0.25, 0.65)),
            lip_redness=float(np.clip(rng.normal(0.45 + 0.12 * (not male), 0.12), 0.2, 0.85)),
            hair=_rgb(hair),
            brow=_rgb(brow),
            iris=_rgb(iris),
            cut=cut,
            recession_mm=float(recession),
            brow_thickness=float(np.clip(rng.normal(1.12 if male else 0.85, 0.14), 0.6, 1.5)),
            brow_density=float(np.clip(rng.normal(1.0, 0.12), 0.7, 1.3)),
            brow_arch_mm=float(rng.normal(-0.2 if male else 0.5, 0.6)),
            stubble=float(rng.choice([0.08, 0.3, 0.65]) * rng.uniform(0.8, 1.2)) if male else 0.0,
            freckles=float(freckles),
            n_moles=int(rng.poisson(4)),
            weathering=float(np.clip(0.15 + 0.6 * (age - 0.4) + rng.normal(0, 0.08), 0, 1)),
        )


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
