"""Run by Blender's own Python (`bpy`), not by pytest: opens a .glb and writes what Blender sees into an .npz file."""

import sys

import bpy
import numpy as np


def main(glb: str, out: str, rate: float, frames: list[int]) -> None:
    """Names of the shape keys, the range of the animation, and the mesh in the world at some frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(rate)
    bpy.ops.import_scene.gltf(filepath=glb)
    face = next(item for item in bpy.data.objects if item.type == "MESH" and item.data.shape_keys)
    camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
    actions = [action.frame_range for action in bpy.data.actions]
    shapes = []
    for frame in frames:
        scene.frame_set(frame)
        evaluated = face.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        vertices = np.empty(3 * len(mesh.vertices))
        mesh.vertices.foreach_get("co", vertices)
        matrix = np.array(evaluated.matrix_world)
        shapes.append(vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
    np.savez(
        out,
        names=np.array([block.name for block in face.data.shape_keys.key_blocks]),
        first=min(span[0] for span in actions),
        last=max(span[1] for span in actions),
        vertices=np.array(shapes),
        camera=np.array(camera.matrix_world),
        fov=[camera.data.angle_x, camera.data.angle_y],
        sensor=np.array([camera.data.sensor_fit]),
        bones=np.array([bone.name for item in bpy.data.armatures for bone in item.bones] or [""]),
    )


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    main(arguments[0], arguments[1], float(arguments[2]), [int(frame) for frame in arguments[3:]])
