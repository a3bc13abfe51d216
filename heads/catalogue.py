"""The built-in heads, by name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from ..core.errors import InputError
from .head import Head
from .identity import Identity, make_head, random_identity

#: Name → seed of `random_identity` and ages to draw from; None is the average of all phenotypes,
#: and any adult. Chosen by eye for being unlike each other: seven adults, a child, an old man.
BUILT_IN: dict[str, tuple[int, tuple[float, float] | None] | None] = {
    "average": None,
    "ruth": (8, None),
    "maya": (5, None),
    "kofi": (10, None),
    "luis": (11, None),
    "noor": (1, None),
    "mei": (2, None),
    "arno": (4, None),
    "amara": (17, (6.0, 12.0)),
    "otto": (11, (70.0, 85.0)),
}
DEFAULT_HEAD = "ruth"


def built_in_identity(name: str) -> Identity:
    """Who a built-in head is; InputError naming them all if there is none of that name."""
    if name not in BUILT_IN:
        raise InputError(f"no built-in head {name}; there are {', '.join(BUILT_IN)}")
    drawn = BUILT_IN[name]
    if drawn is None:
        return Identity(name)
    seed, ages = drawn
    return replace(random_identity(np.random.default_rng(seed), age_years=ages), name=name)


@cache
def built_in_head(name: str) -> Head:
    """A built-in head (about 1 s the first time); InputError if there is none of that name."""
    return make_head(built_in_identity(name))
