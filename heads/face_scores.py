"""How much of each ARKit expression a network sees in a face's landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly
from .face_landmarks import N_LANDMARKS
from .face_network import FaceWeights, Network

#: The landmarks the network looks at (``kLandmarksSubsetIdxs`` of MediaPipe's
#: face_blendshapes_graph.cc).
SCORED_LANDMARKS = (
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65,
    66, 67, 70, 78, 80, 81, 82, 84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136,
    144, 145, 146, 148, 149, 150, 152, 153, 154, 155, 157, 158, 159, 160, 161, 162, 163, 168, 172,
    173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263, 267, 269, 270, 276, 282, 283,
    284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318, 321, 323, 324,
    332, 334, 336, 338, 356, 361, 362, 365, 373, 374, 375, 377, 378, 379, 380, 381, 382, 384, 385,
    386, 387, 388, 389, 390, 397, 398, 400, 402, 405, 409, 415, 454, 466, 468, 469, 470, 471, 472,
    473, 474, 475, 476, 477,
)  # fmt: skip
#: What it tells, in its order: ARKit's names without tongueOut, after a ``_neutral`` of its own.
SCORE_NAMES = (
    "_neutral", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft",
    "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "eyeBlinkLeft",
    "eyeBlinkRight", "eyeLookDownLeft", "eyeLookDownRight", "eyeLookInLeft", "eyeLookInRight",
    "eyeLookOutLeft", "eyeLookOutRight", "eyeLookUpLeft", "eyeLookUpRight", "eyeSquintLeft",
    "eyeSquintRight", "eyeWideLeft", "eyeWideRight", "jawForward", "jawLeft", "jawOpen",
    "jawRight", "mouthClose", "mouthDimpleLeft", "mouthDimpleRight", "mouthFrownLeft",
    "mouthFrownRight", "mouthFunnel", "mouthLeft", "mouthLowerDownLeft", "mouthLowerDownRight",
    "mouthPressLeft", "mouthPressRight", "mouthPucker", "mouthRight", "mouthRollLower",
    "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthSmileLeft", "mouthSmileRight",
    "mouthStretchLeft", "mouthStretchRight", "mouthUpperUpLeft", "mouthUpperUpRight",
    "noseSneerLeft", "noseSneerRight",
)  # fmt: skip


class ExpressionScorer:
    """Runs the network of expression scores; not to be shared between threads.

    Parameters
    ----------
    weights : FaceWeights
    """

    def __init__(self, weights: FaceWeights) -> None:
        outputs = {"StatefulPartitionedCall:0": len(SCORE_NAMES)}
        shape = (1, len(SCORED_LANDMARKS), 2)
        self._network = Network(weights.scores, weights.source, shape, outputs)

    def scores(self, landmarks_px: ArrayLike) -> NDArray[np.float64]:
        """Score the expression of one face.

        Parameters
        ----------
        landmarks_px : (478, 2) or (478, 3) float, px
            As the landmark network gives them; their place and size do not matter.

        Returns
        -------
        (52,) float64, 0 to 1
            In the order of `SCORE_NAMES`.

        Raises
        ------
        ValueError
            If there are not 478 finite points.
        """
        given = np.asarray(landmarks_px, dtype=np.float64)
        xy = readonly(given[..., :2], (N_LANDMARKS, 2), "landmarks_px")
        if not np.isfinite(xy).all():
            raise ValueError("landmarks_px must be finite: score only faces that were found")
        return self._network.run(xy[list(SCORED_LANDMARKS)].astype(np.float32))[0].astype(
            np.float64
        )
