"""USD (UsdSkel): joints of head, jaw and eyes, blendshapes by name, camera, animation in time samples."""

import errno
import os
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.export.clip import Clip, quaternions, to_world
from workbench.export.skinning import Joint, Shapes, beside_joints, clip_joints, clip_shapes
from workbench.export.usd_parts import define_mesh, dress_stage, face_mesh
from workbench.extras import needs
from workbench.face import DressedHead
from workbench.files import atomic_path

APERTURE_MM = 36.0
"""Film width that represents the picture; USD gives lenses in tenths of its unit of length."""


def write_usd(clip: Clip, path: str | Path, dressed: DressedHead | None = None) -> None:
    """Write a .usd, .usda, .usdc stage: `/performance/face` (mesh), `skeleton`, `animation`, and `/performance/camera`.

    With `dressed` the character plays: its skin as a material, a mesh for each part beside the face, and their pictures
    in the folder `FILE_textures` (`talk.usd_textures`); `clip.person` should have its identity. One unit of length is a
    metre, +y is up. Time codes are the run's frame numbers. Stage and pictures are renamed to their places once all are
    written. Raises `MissingDependencyError` without usd-core.
    """
    with needs("usd"):
        from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel
    with ExitStack() as files:
        temporary = files.enter_context(atomic_path(path))
        stage = Usd.Stage.CreateInMemory(".usda")
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(clip.rate)
        stage.SetFramesPerSecond(clip.rate)
        stage.SetStartTimeCode(float(clip.track.index[0]))
        stage.SetEndTimeCode(float(clip.track.index[-1]))
        root = UsdSkel.Root.Define(stage, "/performance")
        stage.SetDefaultPrim(root.GetPrim())
        joints = clip_joints(clip)
        shapes = beside_joints(clip_shapes(clip), joints)
        skeleton, animation = _skeleton(stage, joints), _animation(stage, clip, shapes, joints)
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        define_mesh(stage, face_mesh(clip, shapes, joints, dressed), skeleton)
        pictures: dict[Path, bytes] = {}
        if dressed is not None:
            pictures = dress_stage(stage, clip, shapes, joints, skeleton, dressed, Path(path))
        _camera(stage, clip)
        # The layer is made under a name that USD has not seen: it keeps layers by name for as long as a program runs.
        layer = Sdf.Layer.CreateAnonymous(Path(path).suffix)
        layer.TransferContent(stage.GetRootLayer())
        try:
            layer.Export(str(temporary))
        except Tf.ErrorException as error:  # USD's own way to say that the disk is full
            raise _refusal(error.args[0].commentary) from error
        for place, content in pictures.items():
            files.enter_context(atomic_path(place)).write_bytes(content)


def _refusal(told: str) -> OSError:
    """What USD tells of a file that it could not write, as the system's own answer where it ends with one."""
    number = next((number for number in errno.errorcode if told.endswith(os.strerror(number))), None)
    return OSError(f"USD: {told}") if number is None else OSError(number, os.strerror(number))


def _skeleton(stage, joints: tuple[Joint, ...]):
    from pxr import Gf, UsdSkel, Vt

    places = [to_world(joint.place).tolist() for joint in joints]
    rest = [Gf.Matrix4d(1.0), *(Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*place)) for place in places)]
    skeleton = UsdSkel.Skeleton.Define(stage, "/performance/skeleton")
    skeleton.CreateJointsAttr(Vt.TokenArray(_paths(joints)))
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(rest))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    return skeleton


def _paths(joints: tuple[Joint, ...]) -> list[str]:
    return ["head", *(f"head/{joint.name}" for joint in joints)]


def _animation(stage, clip: Clip, shapes: Shapes, joints: tuple[Joint, ...]):
    from pxr import Gf, UsdSkel, Vt

    track = clip.track
    animation = UsdSkel.Animation.Define(stage, "/performance/animation")
    animation.CreateJointsAttr(Vt.TokenArray(_paths(joints)))
    animation.CreateBlendShapesAttr(Vt.TokenArray(shapes.names))
    places, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    sizes, weights = animation.CreateScalesAttr(), animation.CreateBlendShapeWeightsAttr()
    one = Gf.Vec3h(1.0)
    sizes.Set(Vt.Vec3hArray([one] * (1 + len(joints))))
    found = np.flatnonzero(track.found)
    still = np.zeros((len(found), 3))
    moved = [joint.place + (still if joint.shifts is None else joint.shifts[found]) for joint in joints]
    at = to_world(np.stack([track.translation[found], *moved], axis=1))
    turned = [still if joint.turns is None else joint.turns[found] for joint in joints]
    facing = zip(*map(_quaternions, (track.rotation[found], *turned)), strict=True)
    for position, place, turn in zip(found, at, facing, strict=True):
        time = float(track.index[position])
        places.Set(Vt.Vec3fArray.FromNumpy(place.astype(np.float32)), time)
        turns.Set(Vt.QuatfArray(turn), time)
        weights.Set(Vt.FloatArray.FromNumpy(shapes.weights[position].astype(np.float32)), time)
        if clip.moves_scale:
            sizes.Set(Vt.Vec3hArray([Gf.Vec3h(float(track.scale[position])), *([one] * len(joints))]), time)
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
