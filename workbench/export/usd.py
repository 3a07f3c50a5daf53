"""USD (UsdSkel): head and jaw joints, blendshapes by name, camera, animation in time samples."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.export.clip import Clip, quaternions, to_world
from workbench.export.skinning import Shapes, clip_shapes
from workbench.export.usd_parts import define_mesh, dress_stage, face_mesh
from workbench.extras import needs
from workbench.face import DressedHead
from workbench.files import atomic_path

JOINTS = ("head", "head/jaw")
APERTURE_MM = 36.0
"""Film width that represents the picture; USD gives lenses in tenths of its unit of length."""


def write_usd(clip: Clip, path: str | Path, dressed: DressedHead | None = None) -> None:
    """Write a .usd, .usda, .usdc stage: `/performance/face` (mesh), `skeleton`, `animation`, and `/performance/camera`.

    With `dressed` the character plays: its skin as a material, a mesh for each part beside the face, and their pictures
    in the folder `STEM_textures`; `clip.person` should have its identity. One unit of length is a metre, +y is up. Time
    codes are the input's frame numbers. Raises `MissingDependencyError` without usd-core.
    """
    with needs("usd"):
        from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel
    with atomic_path(path) as temporary:
        stage = Usd.Stage.CreateInMemory(".usda")
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(clip.rate)
        stage.SetFramesPerSecond(clip.rate)
        stage.SetStartTimeCode(float(clip.track.index[0]))
        stage.SetEndTimeCode(float(clip.track.index[-1]))
        root = UsdSkel.Root.Define(stage, "/performance")
        stage.SetDefaultPrim(root.GetPrim())
        skeleton = _skeleton(stage, clip)
        shapes = clip_shapes(clip)
        animation = _animation(stage, clip, shapes)
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        define_mesh(stage, face_mesh(clip, shapes, dressed), skeleton)
        if dressed is not None:
            dress_stage(stage, clip, shapes, skeleton, dressed, Path(path))
        _camera(stage, clip)
        # The layer is made under a name that USD has not seen: it keeps layers by name for as long as a program runs.
        layer = Sdf.Layer.CreateAnonymous(path.suffix if isinstance(path, Path) else Path(path).suffix)
        layer.TransferContent(stage.GetRootLayer())
        try:
            layer.Export(str(temporary))
        except Tf.ErrorException as error:  # USD's own way to say that the disk is full
            raise OSError(f"USD could not write it: {error}") from error


def _skeleton(stage, clip: Clip):
    from pxr import Gf, UsdSkel, Vt

    jaw = Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*to_world(np.asarray(clip.joint.joint, float)).tolist()))
    skeleton = UsdSkel.Skeleton.Define(stage, "/performance/skeleton")
    skeleton.CreateJointsAttr(Vt.TokenArray(JOINTS))
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(1.0), jaw]))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(1.0), jaw]))
    return skeleton


def _animation(stage, clip: Clip, shapes: Shapes):
    from pxr import Gf, UsdSkel, Vt

    track = clip.track
    animation = UsdSkel.Animation.Define(stage, "/performance/animation")
    animation.CreateJointsAttr(Vt.TokenArray(JOINTS))
    animation.CreateBlendShapesAttr(Vt.TokenArray(shapes.names))
    places, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    sizes, weights = animation.CreateScalesAttr(), animation.CreateBlendShapeWeightsAttr()
    sizes.Set(Vt.Vec3hArray([Gf.Vec3h(1.0)] * len(JOINTS)))
    found = np.flatnonzero(track.found)
    pivot = np.asarray(clip.joint.joint)
    turned = zip(found, _quaternions(track.rotation[found]), _quaternions(track.jaw[found, :3]), strict=True)
    for position, head, jaw in turned:
        time = float(track.index[position])
        both = (to_world(track.translation[position]), to_world(pivot + track.jaw[position, 3:]))
        places.Set(Vt.Vec3fArray([Gf.Vec3f(*place.tolist()) for place in both]), time)
        turns.Set(Vt.QuatfArray([head, jaw]), time)
        weights.Set(Vt.FloatArray.FromNumpy(shapes.weights[position].astype(np.float32)), time)
        if clip.moves_scale:
            sizes.Set(Vt.Vec3hArray([Gf.Vec3h(float(track.scale[position])), Gf.Vec3h(1.0)]), time)
    return animation


def _quaternions(rotations: Float[np.ndarray, "n 3"]) -> list:
    from pxr import Gf

    return [Gf.Quatf(w, x, y, z) for x, y, z, w in quaternions(rotations).tolist()]


def _camera(stage, clip: Clip) -> None:
    """Lens and film: the same field of view and the same point where the optical axis meets the picture."""
    from pxr import Gf, UsdGeom

    width, height = clip.image_size
    fx, fy = (float(length) for length in clip.camera.focal_px)
    cx, cy = (float(place) for place in clip.camera.principal_point_px)
    camera = UsdGeom.Camera.Define(stage, "/performance/camera")
    # Focal length and film count in tenths of the stage's unit; only their ratios matter.
    film = APERTURE_MM / 100.0
    camera.CreateHorizontalApertureAttr(film)
    camera.CreateVerticalApertureAttr(film * (height / fy) / (width / fx))
    camera.CreateFocalLengthAttr(film * fx / width)
    camera.CreateHorizontalApertureOffsetAttr(film * ((width - 1) / 2 - cx) / width)
    camera.CreateVerticalApertureOffsetAttr(film * (cy - (height - 1) / 2) / fy / (width / fx))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 100.0))
