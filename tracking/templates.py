"""A face's patches in one frame, found again in all others: what does not drift.

The landmark network is steady in the mean but leans with pose and expression by a per cent of the
face; flow from frame to frame is exact but adds its errors up. A patch of a reference frame
that is found in a later one says where that bit of skin is now, whatever lies between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .flow_tracks import FoundPoints, follow_points

Floats = NDArray[np.float64]

#: What patches may differ by to be the same, in px there and back and in grey levels. Measured on
#: plain renders: up to 3 levels the error is 0.3 px of the rectified face (RMS), at 7 2.5 px.
_MOST_BACK_PX, _MOST_UNLIKE = 0.5, 10.0


@dataclass(frozen=True, eq=False)
class FaceTemplate:
    """A reference frame.

    Attributes
    ----------
    picture : (h, w) uint8
        The evened, rectified face (`face_rectify.even_picture`).
    places : (n, 2) float64, px of that picture
        Of the points to be found.
    """

    picture: NDArray[np.uint8]
    places: Floats

    def register(self, picture: NDArray[np.uint8], guess: Floats) -> FoundPoints:
        """Find the reference frame's points in another frame's evened picture.

        Parameters
        ----------
        picture : (h, w) uint8
        guess : (n, 2) float64, px of that picture

        Returns
        -------
        FoundPoints
            A place is NaN where the patch is not there: covered, turned away, changed too much.
        """
        found = follow_points(self.picture, picture, self.places, guess)
        is_it = (found.there_and_back_px < _MOST_BACK_PX) & (found.unlike < _MOST_UNLIKE)
        return replace(found, places=np.where(is_it[:, None], found.places, np.nan))


def template_sd(found: FoundPoints) -> Floats:
    """Standard deviation of registered places, (n,), px; NaN where there are none.

    Fitted to the errors on plain renders, by how far there and back differ and how unlike the
    patches are.
    """
    sd = np.maximum(0.28 + 3.0 * found.there_and_back_px, 0.33 + 0.02 * found.unlike**2)
    return np.where(np.isnan(found.places[:, 0]), np.nan, sd)
