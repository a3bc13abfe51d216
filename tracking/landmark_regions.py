"""Which of the network's landmarks lie where: contours in order, and regions that move alike."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..heads.face_landmarks import N_LANDMARKS

#: Contours in the order of the points along them; right and left are the subject's. Lips and lids
#: are closed and begin at the right or the outer corner; brows are open, upper then lower edge.
CONTOURS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "lips_outer": (
            61, 185, 40, 39, 37, 0, 267, 269, 270, 409,
            291, 375, 321, 405, 314, 17, 84, 181, 91, 146,
        ),
        "lips_inner": (
            78, 191, 80, 81, 82, 13, 312, 311, 310, 415,
            308, 324, 318, 402, 317, 14, 87, 178, 88, 95,
        ),
        "lids_right": (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
        "lids_left": (
            263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249,
        ),
        "brow_right_upper": (70, 63, 105, 66, 107),
        "brow_right_lower": (46, 53, 52, 65, 55),
        "brow_left_upper": (300, 293, 334, 296, 336),
        "brow_left_lower": (276, 283, 282, 295, 285),
    }
)  # fmt: skip
CLOSED_CONTOURS = frozenset(["lips_outer", "lips_inner", "lids_right", "lids_left"])
#: What moves against the skin around it, or changes its looks: flow may fail there at a blow, and
#: a patch of the reference picture is not found again.
QUICK_REGIONS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "lid_right_upper": (246, 161, 160, 159, 158, 157, 173),
        "lid_right_lower": (155, 154, 153, 145, 144, 163, 7),
        "lid_left_upper": (466, 388, 387, 386, 385, 384, 398),
        "lid_left_lower": (382, 381, 380, 374, 373, 390, 249),
        "iris_right": (468, 469, 470, 471, 472),
        "iris_left": (473, 474, 475, 476, 477),
        "lip_upper_inner": (191, 80, 81, 82, 13, 312, 311, 310, 415),
        "lip_lower_inner": (324, 318, 402, 317, 14, 87, 178, 88, 95),
        "lip_corner_right": (61, 78, 76, 62),
        "lip_corner_left": (291, 308, 306, 292),
        "lip_upper_outer": (185, 40, 39, 37, 0, 267, 269, 270, 409, 74, 73, 72, 11, 302, 303, 304),
        "lip_lower_outer": (375, 321, 405, 314, 17, 84, 181, 91, 146, 90, 180, 85, 16, 315, 404),
    }
)
#: Points over bone that keep their distances: they tell how the face lies in the picture.
STEADY = (
    1, 2, 4, 5, 6, 8, 9, 10, 21, 33, 54, 67, 98, 133, 151, 168,
    195, 197, 251, 263, 284, 297, 327, 362,
)  # fmt: skip


def _marked(*numbers: tuple[int, ...]) -> NDArray[np.bool_]:
    mask = np.zeros(N_LANDMARKS, bool)
    for some in numbers:
        mask[list(some)] = True
    mask.flags.writeable = False
    return mask


#: (478,): lids and irises; inner lips; both lips.
IS_EYE = _marked(
    *(CONTOURS[name] for name in ("lids_right", "lids_left")),
    *(QUICK_REGIONS[name] for name in ("iris_right", "iris_left")),
)
IS_INNER_LIP = _marked(CONTOURS["lips_inner"])
IS_QUICK = _marked(*QUICK_REGIONS.values())
