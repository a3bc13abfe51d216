"""The built-in heads, by name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from ..core.errors import InputError
from .head import Head
from .identity import Identity, make_head, random_identity

#: Name → seed of `random_identity`; None is the average of all phenotypes. Chosen by eye for
#: being unlike each other.
BUILT_IN: dict[str, int | None] = {
    "average": None,
    "ruth": 8,
    "maya": 5,
    "kofi": 10,
    "luis": 11,
    "noor": 1,
    "mei": 2,
    "arno": 4,
}
DEFAULT_HEAD = "ruth"


def built_in_identity(name: str) -> Identity:
    """Who a built-in head is; InputError naming them all if there is none of that name."""
    if name not in BUILT_IN:
        raise InputError(f"no built-in head {name}; there are {', '.join(BUILT_IN)}")
    seed = BUILT_IN[name]
    if seed is None:
        return Identity(name)
    return replace(random_identity(np.random.default_rng(seed)), name=name)


@cache
def built_in_head(name: str) -> Head:
    """A built-in head (about 1 s the first time); InputError if there is none of that name."""
    return make_head(built_in_identity(name))
