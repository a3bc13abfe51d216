"""The one checker of array arguments."""

from __future__ import annotations

from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Shape = tuple[int | None | EllipsisType, ...]


def readonly(
    value: ArrayLike, shape: Shape, name: str, dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """A read-only copy of `value`, checked against `shape`.

    Parameters
    ----------
    value : array_like
    shape : tuple
        Expected sizes; ``None`` for any size, a leading ``...`` for any leading axes.
    name : str
        What the caller calls the array, for the message.
    dtype : dtype
        The type the copy is converted to.

    Raises
    ------
    ValueError
        ``points must have shape (..., 3), got (4, 2)``.
    """
    array = np.array(value, dtype=dtype)
    if shape and shape[0] is ...:
        wanted = shape[1:]
        fits = array.ndim >= len(wanted)
        actual = array.shape[array.ndim - len(wanted) :]
    else:
        wanted = shape
        fits = array.ndim == len(wanted)
        actual = array.shape
    if not fits or any(w is not None and w != a for w, a in zip(wanted, actual, strict=True)):
        names = ["..." if s is ... else "any" if s is None else str(s) for s in shape]
        text = ", ".join(names) + ("," if len(names) == 1 else "")
        raise ValueError(f"{name} must have shape ({text}), got {array.shape}")
    array.flags.writeable = False
    return array
