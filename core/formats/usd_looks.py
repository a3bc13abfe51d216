"""Materials of USD files: ``UsdPreviewSurface`` with textures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .gltf_scene import GltfPart, GltfScene

_KINDS = ("texture_png", "normal_png", "roughness_png")
_MATERIALS = "/Head/Materials"


def pictures_of(scene: GltfScene) -> dict[bytes, str]:
    """Every picture of a scene once, and a file's name for it."""
    found: dict[bytes, str] = {}
    for part in scene.parts:
        for kind in _KINDS:
            data = getattr(part, kind)
            if data is not None and data not in found:
                number = len(found)
                found[data] = f"{number}_{_plain(part.name)}_{kind.removesuffix('_png')}.png"
    return found


def _plain(name: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name)


def add_materials(
    stage: Any, scene: GltfScene, meshes: Mapping[str, Any], files: Mapping[bytes, str]
) -> None:
    """One material for each part, bound to its mesh.

    Parameters
    ----------
    stage : Usd.Stage
    scene : GltfScene
    meshes : mapping from part's name to UsdGeom.Mesh
    files : mapping from picture to the path by which the layer finds it
    """
    from pxr import UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, _MATERIALS)
    for part in scene.parts:
        mesh = meshes[part.name]
        material = _Material(stage, f"{_MATERIALS}/{mesh.GetPrim().GetName()}", part, files)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material.made())


class _Material:
    """The network of one part."""

    def __init__(self, stage: Any, path: str, part: GltfPart, files: Mapping[bytes, str]) -> None:
        from pxr import UsdShade

        self._stage, self._path, self._part, self._files = stage, path, part, files
        self._material = UsdShade.Material.Define(stage, path)
        self._surface = self._shader("Surface", "UsdPreviewSurface")

    def made(self) -> Any:
        from pxr import Gf, Sdf

        part, surface = self._part, self._surface
        self._material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
        colour = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        opacity = surface.CreateInput("opacity", Sdf.ValueTypeNames.Float)
        rough = surface.CreateInput("roughness", Sdf.ValueTypeNames.Float)
        r, g, b, a = (float(x) for x in part.base_color)
        opacity.Set(a)
        if part.texture_png is None:
            colour.Set(Gf.Vec3f(r, g, b))
        else:
            texture = self._texture("Color", part.texture_png, "sRGB", (r, g, b, a))
            colour.ConnectToSource(texture.ConnectableAPI(), "rgb")
            texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
            if a < 1:  # as in .glb: the texture's own transparency counts
                texture.CreateOutput("a", Sdf.ValueTypeNames.Float)
                opacity.ConnectToSource(texture.ConnectableAPI(), "a")
        rough.Set(float(part.roughness))
        if part.roughness_png is not None:
            scale = (float(part.roughness),) * 4
            texture = self._texture("Roughness", part.roughness_png, "raw", scale)
            texture.CreateOutput("g", Sdf.ValueTypeNames.Float)
            rough.ConnectToSource(texture.ConnectableAPI(), "g")
        if part.normal_png is not None:
            self._add_normals(part.normal_png)
        return self._material

    def _add_normals(self, picture: bytes) -> None:
        from pxr import Gf, Sdf

        texture = self._texture("Normal", picture, "raw", (2.0, 2.0, 2.0, 1.0))
        texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        normal = self._surface.CreateInput("normal", Sdf.ValueTypeNames.Normal3f)
        normal.ConnectToSource(texture.ConnectableAPI(), "rgb")

    def _shader(self, name: str, kind: str) -> Any:
        from pxr import UsdShade

        shader = UsdShade.Shader.Define(self._stage, f"{self._path}/{name}")
        shader.CreateIdAttr(kind)
        return shader

    def _texture(
        self, name: str, picture: bytes, space: str, scale: tuple[float, float, float, float]
    ) -> Any:
        from pxr import Gf, Sdf

        texture = self._shader(name, "UsdUVTexture")
        file = Sdf.AssetPath(self._files[picture])
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(space)
        for wrap in ("wrapS", "wrapT"):
            texture.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("repeat")
        if scale != (1.0, 1.0, 1.0, 1.0):
            texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*scale))
        place = texture.CreateInput("st", Sdf.ValueTypeNames.Float2)
        place.ConnectToSource(self._coordinates().ConnectableAPI(), "result")
        return texture

    def _coordinates(self) -> Any:
        """The reader of texture coordinates, made once."""
        from pxr import Sdf, UsdShade

        path = f"{self._path}/Coordinates"
        if self._stage.GetPrimAtPath(path):
            return UsdShade.Shader.Get(self._stage, path)
        reader = self._shader("Coordinates", "UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        return reader
