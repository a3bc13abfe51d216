"""A head's meshes in a viser server, and what moves them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.formats.gltf import unweld
from ..core.mesh import Mesh
from ..core.rigid import quaternion_from_rotation
from ..heads.regions import REGIONS
from ..tracking.rigid_fit import fit_rigid
from .live_pose import PosedHead

if TYPE_CHECKING:
    import viser

    from ..heads.head import Head

_METRES_PER_MM = 1e-3
#: The camera looks at the face from here, metres in the head's frame: x left, y up, z forward.
_CAMERA, _LOOK_AT, _FIELD_OF_VIEW = (0.0, -0.02, 0.85), (0.0, -0.045, 0.0), 0.45
#: Strength of the light from all around; viser's own bleaches skin.
_DAYLIGHT = 0.4
_ROOT = "/head"
#: Parts with textures that turn but do not bend are sent once, and then only turned.
_EYES = ("eye_left", "eye_right")
_COLOURS = {
    "lashes": (22, 18, 16),
    "teeth_upper": (226, 218, 200),
    "teeth_lower": (226, 218, 200),
    "tongue": (176, 98, 95),
}
_EYE_WHITE, _GREY = (236, 234, 230), (200, 200, 200)
#: Skin below this share of its median lightness is hair; lips are redder by this much (CIE a*).
_DARK_SHARE, _REDDER = 0.5, 7.0
#: Regions without hair, and without red lips: what is dark or red there is shade.
_HAIRY = (
    "scalp",
    "forehead",
    "temple_l",
    "temple_r",
    "brow_l",
    "brow_r",
    "neck",
    "orbit_l",
    "orbit_r",
)
_BARE = tuple(name for name in REGIONS if name not in _HAIRY)
_NOT_LIPS = tuple(name for name in REGIONS if name not in ("upper_lip", "lower_lip"))
_STILL_MM = 1e-4


class HeadView:
    """The head's meshes in the browser."""

    def __init__(self, server: viser.ViserServer, head: Head) -> None:
        self._head = head
        self._server = server
        scene = server.scene
        server.gui.configure_theme(dark_mode=True, show_share_button=False)
        scene.set_up_direction("+y")
        scene.configure_environment_map(environment_intensity=_DAYLIGHT)
        server.initial_camera.position = _CAMERA
        server.initial_camera.look_at = _LOOK_AT
        server.initial_camera.fov = _FIELD_OF_VIEW
        self._root = scene.add_frame(_ROOT, show_axes=False)
        self._bending: list[tuple[Any, NDArray[np.int32]]] = []
        self._turning: list[tuple[Any, NDArray[np.int32]]] = []
        for part in head.mesh.groups:
            if not len(head.mesh.groups[part]):
                continue
            if part in _EYES and head.appearance.eye is not None and head.mesh.uv is not None:
                self._add_eye(part)
            else:
                self._add_bending(part)
        self._shown = np.array(head.mesh.vertices)

    def show(self, posed: PosedHead) -> None:
        """Send what has moved, all at once."""
        with self._server.atomic():
            self._root.wxyz = tuple(posed.quaternion)
            self._root.position = tuple(posed.translation * _METRES_PER_MM)
            moved = np.abs(posed.vertices - self._shown).max(axis=1) > _STILL_MM
            for handle, rows in self._bending:
                if moved[rows].any():
                    handle.vertices = (posed.vertices[rows] * _METRES_PER_MM).astype(np.float32)
            for handle, rows in self._turning:
                if moved[rows].any():
                    self._turn(handle, rows, posed.vertices[rows])
        self._shown = posed.vertices

    def _turn(self, handle: Any, rows: NDArray[np.int32], at: NDArray[np.float64]) -> None:
        R, t = fit_rigid(self._head.mesh.vertices[rows], at)
        handle.wxyz = tuple(quaternion_from_rotation(R))
        handle.position = tuple(t * _METRES_PER_MM)

    def _add_bending(self, part: str) -> None:
        mesh = self._head.mesh
        triangles = mesh.triangles[mesh.groups[part]]
        for patch, colour, chosen in _patches(self._head, part):
            used, local = np.unique(triangles[chosen], return_inverse=True)
            handle = self._server.scene.add_mesh_simple(
                f"{_ROOT}/{patch}",
                (mesh.vertices[used] * _METRES_PER_MM).astype(np.float32),
                local.reshape(-1, 3).astype(np.uint32),
                color=colour,
                side="double" if part == "lashes" else "front",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._bending.append((handle, used))

    def _add_eye(self, part: str) -> None:
        """An eyeball with its iris, as a textured mesh that is only turned afterwards."""
        import trimesh
        from PIL import Image

        mesh, looks = self._head.mesh, self._head.appearance
        rows = mesh.groups[part]
        assert mesh.uv_triangles is not None and looks.eye is not None
        uv = mesh.uv if looks.uv is None else looks.uv
        used, inverse = np.unique(mesh.triangles[rows], return_inverse=True)
        local = inverse.reshape(-1, 3).astype(np.int32)
        _, plain = unweld(Mesh(mesh.vertices[used], local, uv, mesh.uv_triangles[rows]))
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(looks.eye), roughnessFactor=0.3, metallicFactor=0.0
        )
        visual = trimesh.visual.TextureVisuals(uv=plain.uv, material=material)
        ball = trimesh.Trimesh(
            plain.vertices * _METRES_PER_MM, plain.triangles, visual=visual, process=False
        )
        handle = self._server.scene.add_mesh_trimesh(
            f"{_ROOT}/{part}", ball, cast_shadow=False, receive_shadow=False
        )
        self._turning.append((handle, used))


def _patches(head: Head, part: str) -> list[tuple[str, tuple[int, int, int], NDArray[np.bool_]]]:
    """Name, colour and triangles, (F,) bool, of the pieces of a part that have one colour each."""
    n = len(head.mesh.groups[part])
    everything = np.ones(n, dtype=np.bool_)
    if part in _EYES:
        return [(part, _EYE_WHITE, everything)]
    if part != "skin":
        return [(part, _COLOURS.get(part, _GREY), everything)]
    colours = _skin_colours(head)
    if colours is None:
        red, green, blue = (round(c) for c in head.appearance.mean_skin())
        return [(part, (red, green, blue), everything)]
    import cv2

    lab = cv2.cvtColor(colours[None].astype(np.float32) / 255, cv2.COLOR_RGB2Lab)[0]
    middle = np.median(lab, axis=0)
    hair = (lab[:, 0] < _DARK_SHARE * middle[0]) & ~_is_in(head, _BARE)
    lips = ~hair & (lab[:, 1] > middle[1] + _REDDER) & ~_is_in(head, _NOT_LIPS)
    found = []
    for name, chosen in (("skin", ~hair & ~lips), ("hair", hair), ("lips", lips)):
        if chosen.any():
            r, g, b = (round(float(c)) for c in np.median(colours[chosen], axis=0))
            found.append((name, (r, g, b), chosen))
    return found


def _is_in(head: Head, regions: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which triangles of the skin are in any of some regions, (F,)."""
    known = [head.regions[name] for name in regions if name in head.regions]
    inside = np.concatenate(known) if known else np.zeros(0, dtype=np.int32)
    return np.isin(head.mesh.groups["skin"], inside)


def _skin_colours(head: Head) -> NDArray[np.float64] | None:
    """Each skin triangle's colour in the middle, (F, 3) sRGB 0..255; None without texture."""
    looks, mesh = head.appearance, head.mesh
    uv = mesh.uv if looks.uv is None else looks.uv
    if uv is None or mesh.uv_triangles is None:
        return None
    middle = uv[mesh.uv_triangles[mesh.groups["skin"]]].mean(axis=1)
    height, width = looks.skin.shape[:2]
    columns = np.clip((middle[:, 0] * width).astype(int), 0, width - 1)
    rows = np.clip(((1 - middle[:, 1]) * height).astype(int), 0, height - 1)
    return np.asarray(looks.skin[rows, columns], dtype=np.float64)
