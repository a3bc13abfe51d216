"""Writing pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.files import atomic_path


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an (h, w, 3) uint8 RGB picture, atomically."""
    from PIL import Image

    with atomic_path(path) as part:
        Image.fromarray(np.ascontiguousarray(image)).save(part, format="PNG")
