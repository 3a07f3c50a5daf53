"""Meshes and materials of a USD stage: the face, and what a character wears on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.export.clip import Clip, to_world
from workbench.export.looks import LOOKS, SKIN, STILL_MM, Look
from workbench.export.skinning import Joint, Shapes, joint_shares, part_joints
from workbench.export.suffixes import pictures_folder
from workbench.face import DressedHead, WornPart


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """A mesh on the joints of the head; head frame, millimetres."""

    name: str
    points: Float[np.ndarray, "n 3"]
    triangles: Integer[np.ndarray, "t 3"]
    shares: Float[np.ndarray, "n j"]
    """See `joint_shares`."""
    names: tuple[str, ...]
    deltas: Float[np.ndarray, "k n 3"]
    uv: Float[np.ndarray, "u 2"] | None = None
    triangles_uv: Integer[np.ndarray, "t 3"] | None = None
    colors: UInt8[np.ndarray, "n 3"] | None = None
    both_sides: bool = False


def face_mesh(clip: Clip, shapes: Shapes, joints: tuple[Joint, ...], dressed: DressedHead | None) -> SkinnedMesh:
    """The face of a clip's person; of a character without what its parts replace."""
    person = clip.person
    shown = np.ones(len(person.triangles), bool) if dressed is None else dressed.shown
    textured = len(person.uv) > 1
    return SkinnedMesh(
        name="face",
        points=person.neutral,
        triangles=person.triangles[shown],
        shares=joint_shares(joints, len(person.neutral)),
        names=shapes.names,
        deltas=shapes.deltas,
        uv=person.uv if textured else None,
        triangles_uv=person.triangles_uv[shown] if textured else None,
        colors=person.colors if dressed is None else None,
    )


def part_mesh(
    shapes: Shapes, joints: tuple[Joint, ...], worn: WornPart, points: Float[np.ndarray, "n 3"]
) -> SkinnedMesh:
    """A worn part; one that is still hangs on the head alone, and blendshapes that do not move it are left out."""
    part = worn.part
    shares, names, deltas = np.ones((len(points), 1)), (), np.zeros((0, len(points), 3))
    if not part.still:
        shares = joint_shares(part_joints(joints, part), len(points))
        carried = part.carried(shapes.deltas)
        moving = np.flatnonzero(np.abs(carried).max(axis=(1, 2)) > STILL_MM)
        names, deltas = tuple(shapes.names[k] for k in moving), carried[moving]
    return SkinnedMesh(
        part.kind, points, part.triangles, shares, names, deltas, part.uv, part.triangles_uv,
        both_sides=LOOKS[part.kind].both_sides,
    )  # fmt: skip


def define_mesh(stage, mesh: SkinnedMesh, skeleton) -> None:
    """Add a mesh that the skeleton moves: `/performance/NAME`."""
    from pxr import Sdf, Tf, UsdGeom, UsdSkel, Vt

    made = UsdGeom.Mesh.Define(stage, f"/performance/{mesh.name}")
    made.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    points = to_world(mesh.points).astype(np.float32)
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    made.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    made.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.triangles), 3, np.int32)))
    made.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.triangles.astype(np.int32).ravel()))
    if mesh.both_sides:
        made.CreateDoubleSidedAttr(True)
    primvars = UsdGeom.PrimvarsAPI(made)
    if mesh.colors is not None:
        colors = primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex)
        colors.Set(Vt.Vec3fArray.FromNumpy(((mesh.colors / 255.0) ** 2.2).astype(np.float32)))
    if mesh.uv is not None and mesh.triangles_uv is not None:
        uv = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
        uv.Set(Vt.Vec2fArray.FromNumpy(mesh.uv[mesh.triangles_uv.ravel()].astype(np.float32)))
    binding = UsdSkel.BindingAPI.Apply(made.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = mesh.shares.shape[1]
    joints = np.tile(np.arange(influences, dtype=np.int32), len(points))
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(joints))
    binding.CreateJointWeightsPrimvar(False, influences).Set(
        Vt.FloatArray.FromNumpy(mesh.shares.astype(np.float32).ravel())
    )
    if not mesh.names:
        return
    binding.CreateBlendShapesAttr(Vt.TokenArray(mesh.names))
    targets = []
    prims = distinct([Tf.MakeValidIdentifier(name) for name in mesh.names])
    for prim, delta in zip(prims, mesh.deltas, strict=True):
        moving = np.flatnonzero(np.abs(delta).max(1) > 0.0)
        shape = UsdSkel.BlendShape.Define(stage, made.GetPath().AppendChild(prim))
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(to_world(delta[moving]).astype(np.float32)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(moving.astype(np.int32)))
        targets.append(shape.GetPath())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def distinct(names: Sequence[str]) -> list[str]:
    """The names, with _1, _2, … after those that came before."""
    made: list[str] = []
    for name in names:
        numbered = (f"{name}_{k}" for k in count(1))
        made.append(name if name not in made else next(other for other in numbered if other not in {*names, *made}))
    return made


def dress_stage(
    stage, clip: Clip, shapes: Shapes, joints: tuple[Joint, ...], skeleton, dressed: DressedHead, path: Path
) -> dict[Path, bytes]:
    """Add what a character wears and its materials; returns their pictures (PNG) by their places beside the stage.

    They belong into the folder `FILE_textures`.
    """
    folder, pictures = pictures_folder(path), {}

    def named(name: str, picture: UInt8[np.ndarray, "h w _"]) -> str:
        pictures[folder / f"{name}.png"] = _png(picture)
        return f"./{folder.name}/{name}.png"

    define_material(stage, "face", SKIN, named("skin", dressed.skin))
    rest = clip.person.neutral
    for worn, points in zip(dressed.worn, dressed.parts_on(rest, rest), strict=True):
        define_mesh(stage, part_mesh(shapes, joints, worn, points), skeleton)
        kind = worn.part.kind
        picture = None if kind == "corneas" else named(kind, worn.picture)
        define_material(stage, kind, LOOKS[kind], picture)
    return pictures


def define_material(stage, name: str, look: Look, picture: str | None) -> None:
    """A preview surface for `/performance/NAME`; `picture` is a file's name beside the stage."""
    from pxr import Gf, Sdf, UsdShade

    material = UsdShade.Material.Define(stage, f"/performance/materials/{name}")
    surface = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(look.roughness)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(look.opacity)
    surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(look.cutoff)
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if picture is None:
        color.Set(Gf.Vec3f(1.0))
    else:
        reader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("coordinates"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        texture = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("picture"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(picture))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        coordinates = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
        color.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
        if look.alpha:
            surface.GetInput("opacity").ConnectToSource(texture.CreateOutput("a", Sdf.ValueTypeNames.Float))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(f"/performance/{name}")).Bind(material)


def _png(picture: UInt8[np.ndarray, "h w _"]) -> bytes:
    order = cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR
    return cv2.imencode(".png", cv2.cvtColor(picture, order))[1].tobytes()
