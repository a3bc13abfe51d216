"""Meshes of USD files, the joints they are bound to, and their blend shapes (UsdSkel)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf_scene import ROOT_NAME, GltfPart, GltfScene, MorphTarget

_METRES_PER_MM = 1e-3
_ROOT = "/Head"
Floats = NDArray[np.float64]


def add_skeleton(stage: Any, scene: GltfScene, codes: Floats) -> dict[str, Any]:
    """The meshes of a scene under ``/Head``, with what moves them.

    Parameters
    ----------
    stage : Usd.Stage
    scene : GltfScene
    codes : (T,) float64
        Time codes of the scene's times.

    Returns
    -------
    mapping from part's name to UsdGeom.Mesh
    """
    from pxr import UsdSkel

    joints = _Joints(scene)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{_ROOT}/Skeleton")
    joints.describe(skeleton)
    animation = UsdSkel.Animation.Define(stage, f"{_ROOT}/Animation")
    joints.animate(animation, codes)
    shapes = _Shapes(scene)
    shapes.animate(animation, codes)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    meshes: dict[str, Any] = {}
    taken = {"Skeleton", "Animation", "Materials", "Sound"}
    for part in scene.parts:
        mesh = _mesh(stage, part, _identifier(part.name, taken))
        bound = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        bound.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        n = len(part.vertices)
        bound.CreateJointIndicesPrimvar(False, 1).Set([joints.index(part)] * n)
        bound.CreateJointWeightsPrimvar(False, 1).Set([1.0] * n)
        shapes.add_to(stage, mesh, bound, part)
        meshes[part.name] = mesh
    _set_extent(stage, scene)
    return meshes


class _Joints:
    """The head's joint, and one below it for each other that moves parts."""

    def __init__(self, scene: GltfScene) -> None:
        self._scene = scene
        self._parts: dict[str, GltfPart] = {}
        for part in scene.parts:
            name = self._name_of(part)
            if name is not None:
                self._parts.setdefault(name, part)
        root = scene.root_pivot
        self._world = [p * _METRES_PER_MM for p in (root, *(q.pivot for q in self._parts.values()))]
        # places of the others are relative to the head's joint
        self._places = [self._world[0], *(p - self._world[0] for p in self._world[1:])]

    @staticmethod
    def _name_of(part: GltfPart) -> str | None:
        """The joint below the head's that moves a part; None: the head's own."""
        if part.joint is not None:
            return None if part.joint == ROOT_NAME else part.joint
        moves = part.rotation is not None or part.translation is not None
        return f"part {part.name}" if moves else None

    def index(self, part: GltfPart) -> int:
        name = self._name_of(part)
        return 0 if name is None else 1 + list(self._parts).index(name)

    def describe(self, skeleton: Any) -> None:
        from pxr import Gf, Vt

        taken: set[str] = set()
        names = [_identifier(name, taken) for name in (ROOT_NAME, *self._parts)]
        self.tokens = [names[0], *(f"{names[0]}/{name}" for name in names[1:])]

        def shifts(places: list[Floats]) -> Any:
            vectors = [Gf.Vec3d(*(float(x) for x in p)) for p in places]
            return Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(v) for v in vectors])

        skeleton.CreateJointsAttr(self.tokens)
        skeleton.CreateJointNamesAttr(names)
        skeleton.CreateBindTransformsAttr(shifts(self._world))
        skeleton.CreateRestTransformsAttr(shifts(self._places))

    def animate(self, animation: Any, codes: Floats) -> None:
        from pxr import Gf, Vt

        scene = self._scene
        animation.CreateJointsAttr(self.tokens)
        places = scene.root_places()
        head_shift = None if places is None else places - scene.root_pivot
        moving = [(scene.root_rotation, head_shift)]
        moving += [(part.rotation, part.translation) for part in self._parts.values()]
        n = max(len(codes), 1)
        turns = np.zeros((n, len(moving), 4))
        turns[..., 0] = 1.0
        shifts = np.tile(np.stack(self._places), (n, 1, 1))
        for j, (rotation, translation) in enumerate(moving):
            if rotation is not None:
                turns[:, j] = rotation
            if translation is not None:
                shifts[:, j] += translation * _METRES_PER_MM
        scales = Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(moving))
        animation.CreateScalesAttr(scales)
        quaternions = [_quaternions(frame) for frame in turns]
        _set_over_time(animation.CreateRotationsAttr(), quaternions, turns, codes)
        at = [Vt.Vec3fArray.FromNumpy(np.float32(frame)) for frame in shifts]
        _set_over_time(animation.CreateTranslationsAttr(), at, shifts, codes)


def _quaternions(wxyz: Floats) -> Any:
    from pxr import Gf, Vt

    return Vt.QuatfArray([Gf.Quatf(*(float(x) for x in q)) for q in wxyz])


class _Shapes:
    """Blend shapes by name: parts whose shapes of one name have the same weights share them."""

    def __init__(self, scene: GltfScene) -> None:
        self._weights: dict[str, Floats] = {}
        self._tokens: dict[tuple[str, str], str] = {}
        tokens_of: dict[str, list[str]] = {}
        taken: set[str] = set()
        n = max(len(scene.time_s), 1)
        for part in scene.parts:
            for k, target in enumerate(part.targets):
                curve = np.zeros(n) if part.weights is None else part.weights[:, k]
                known = tokens_of.setdefault(target.name, [])
                same = (t for t in known if np.array_equal(self._weights[t], curve))
                token = next(same, None)
                if token is None:
                    token = _identifier(target.name, taken)
                    known.append(token)
                    self._weights[token] = curve
                self._tokens[part.name, target.name] = token

    def animate(self, animation: Any, codes: Floats) -> None:
        from pxr import Vt

        if not self._weights:
            return
        animation.CreateBlendShapesAttr(list(self._weights))
        values = np.stack(list(self._weights.values()), axis=1)
        rows = [Vt.FloatArray.FromNumpy(np.float32(row)) for row in values]
        _set_over_time(animation.CreateBlendShapeWeightsAttr(), rows, values, codes)

    def add_to(self, stage: Any, mesh: Any, bound: Any, part: GltfPart) -> None:
        if not part.targets:
            return
        tokens, paths = [], []
        for target in part.targets:
            token = self._tokens[part.name, target.name]
            tokens.append(token)
            paths.append(_blend_shape(stage, f"{mesh.GetPath()}/{token}", target))
        bound.CreateBlendShapesAttr(tokens)
        bound.CreateBlendShapeTargetsRel().SetTargets(paths)


def _blend_shape(stage: Any, path: str, target: MorphTarget) -> Any:
    from pxr import UsdSkel, Vt

    shape = UsdSkel.BlendShape.Define(stage, path)
    offsets = np.float32(target.offsets * _METRES_PER_MM)
    shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(offsets))
    turned = np.zeros_like(offsets) if target.normal_offsets is None else target.normal_offsets
    shape.CreateNormalOffsetsAttr(Vt.Vec3fArray.FromNumpy(np.float32(turned)))
    shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(np.int32(target.rows)))
    return shape.GetPath()


def _mesh(stage: Any, part: GltfPart, name: str) -> Any:
    from pxr import Gf, Sdf, UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{_ROOT}/{name}")
    points = np.float32(part.vertices * _METRES_PER_MM)
    triangles = np.ascontiguousarray(part.triangles, dtype=np.int32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel()))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.float32(part.normals)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(bool(part.double_sided))
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    colour = Gf.Vec3f(*(float(x) for x in part.base_color[:3]))
    mesh.CreateDisplayColorAttr([colour])
    if part.uv is not None:
        coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
        )
        coordinates.Set(Vt.Vec2fArray.FromNumpy(np.float32(part.uv)))
    return mesh


def _set_over_time(attribute: Any, values: list[Any], numbers: Floats, codes: Floats) -> None:
    """Time samples; one value where nothing changes."""
    if len(values) == 1 or not (numbers != numbers[:1]).any():
        attribute.Set(values[0])
        return
    for code, value in zip(codes, values, strict=True):
        attribute.Set(value, float(code))


def _set_extent(stage: Any, scene: GltfScene) -> None:
    """The box that all of the head stays in, at every time, as far as its joints are concerned."""
    from pxr import UsdGeom, UsdSkel, Vt

    points = np.concatenate([part.vertices for part in scene.parts])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    largest = [np.abs(t.offsets).max() for p in scene.parts for t in p.targets if len(t.rows)]
    radius += max(largest, default=0.0)
    centres = middle[None]
    if scene.root_rotation is not None:
        from ..rigid import rotation_from_quaternion

        centres = rotation_from_quaternion(scene.root_rotation) @ middle
    if scene.root_translation is not None:
        centres = centres + scene.root_translation
    box = np.stack([centres.min(axis=0) - radius, centres.max(axis=0) + radius])
    root = UsdSkel.Root.Get(stage, _ROOT)
    UsdGeom.Boundable(root).CreateExtentAttr(
        Vt.Vec3fArray.FromNumpy(np.float32(box * _METRES_PER_MM))
    )


def _identifier(name: str, taken: set[str]) -> str:
    """A valid name that is not taken yet; it is then."""
    from pxr import Tf

    base = str(Tf.MakeValidIdentifier(name))
    found, n = base, 1
    while found in taken:
        n += 1
        found = f"{base}_{n}"
    taken.add(found)
    return found
