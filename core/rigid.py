"""Rigid motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import readonly


def rotation_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices of unit quaternions.

    Parameters
    ----------
    quaternion : (..., 4) float, w x y z
        Normalised before use. NaN gives NaN.

    Returns
    -------
    (..., 3, 3) float64
    """
    q = np.asarray(quaternion, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternions of rotation matrices, with w >= 0.

    Parameters
    ----------
    rotation : (..., 3, 3) float
        Proper rotations. A matrix that holds NaN gives NaN.

    Returns
    -------
    (..., 4) float64, w x y z
    """
    from scipy.spatial.transform import Rotation

    matrices = np.asarray(rotation, dtype=np.float64)
    flat = matrices.reshape(-1, 3, 3)
    found = np.full((len(flat), 4), np.nan)
    known = np.isfinite(flat).all(axis=(1, 2))
    if known.any():
        q = Rotation.from_matrix(flat[known]).as_quat(scalar_first=True)
        found[known] = np.where(q[:, :1] < 0, -q, q)
    return found.reshape((*matrices.shape[:-2], 4))


@dataclass(frozen=True, eq=False)
class Rigid:
    """A rotation followed by a translation: ``p_target = R p_source + t``.

    Attributes
    ----------
    quaternion : (4,) float64, w x y z
    translation : (3,) float64, mm, target frame
    """

    quaternion: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        q = readonly(self.quaternion, (4,), "quaternion")
        norm = float(np.linalg.norm(q))
        if not norm > 0:
            raise ValueError("quaternion must have a length above 0")
        object.__setattr__(self, "quaternion", readonly(q / norm, (4,), "quaternion"))
        object.__setattr__(self, "translation", readonly(self.translation, (3,), "translation"))

    @classmethod
    def identity(cls) -> Rigid:
        """The motion that leaves everything where it is."""
        return cls(np.array([1.0, 0, 0, 0]), np.zeros(3))

    @classmethod
    def from_rotation(cls, rotation: ArrayLike, translation: ArrayLike = (0, 0, 0)) -> Rigid:
        """From a (3, 3) proper rotation matrix and a (3,) translation, mm."""
        R = readonly(rotation, (3, 3), "rotation")
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
            raise ValueError("rotation must be a proper rotation matrix (orthonormal, det +1)")
        return cls(quaternion_from_rotation(R), np.asarray(translation, dtype=np.float64))

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3) float64 rotation matrix."""
        return rotation_from_quaternion(self.quaternion)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64 homogeneous matrix, translation in mm."""
        found = np.eye(4)
        found[:3, :3] = self.rotation
        found[:3, 3] = self.translation
        return found

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Move points of the source frame, (..., 3) mm, to the target frame."""
        p = np.asarray(points, dtype=np.float64)
        if p.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), got {p.shape}")
        return p @ self.rotation.T + self.translation

    def inverse(self) -> Rigid:
        """The motion back."""
        q = self.quaternion * np.array([1.0, -1, -1, -1])
        return Rigid(q, -(rotation_from_quaternion(q) @ self.translation))

    def __matmul__(self, other: Rigid) -> Rigid:
        """``(a_from_b @ b_from_c)`` is ``a_from_c``."""
        if not isinstance(other, Rigid):
            return NotImplemented
        return Rigid.from_rotation(self.rotation @ other.rotation, self.apply(other.translation))

    def __eq__(self, other: Any) -> bool:
        if not isinstance(other, Rigid):
            return NotImplemented
        same_turn = bool(np.array_equal(self.quaternion, other.quaternion))
        return same_turn and bool(np.array_equal(self.translation, other.translation))

    __hash__ = None  # type: ignore[assignment]
