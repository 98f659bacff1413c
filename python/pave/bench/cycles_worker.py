"""Renders in Cycles for `cycles.py`: run by a Python that has `bpy`, and knows nothing of PAVE.

SPDX-License-Identifier: BSD-3-Clause

The command line names a folder and a file descriptor. For each JSON object, a line each on stdin,
one goes to the descriptor when it is done: {"scene": ...} takes arrays.npz, {"seed": ...} renders,
{"save": name} writes the image, linear, (3, H, W), {} tells the version. stdout is Blender's own.
"""

import json
import os
import sys
from pathlib import Path

import bpy
import numpy as np


def material(name, reflectance, radiance):
    """Diffuse, or a black light, whose front alone emits.

    In the benches' scenes no light reaches the backs of other shapes, so that they may be anything.
    """
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    if radiance is None:
        diffuse = nodes.new("ShaderNodeBsdfDiffuse")
        diffuse.inputs["Color"].default_value = (*reflectance, 1)
        links.new(diffuse.outputs[0], output.inputs["Surface"])
        return made
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (*radiance, 1)
    front = nodes.new("ShaderNodeMixShader")  # second input open: nothing
    links.new(nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], front.inputs[0])
    links.new(emission.outputs[0], front.inputs[1])
    links.new(front.outputs[0], output.inputs["Surface"])
    made.cycles.emission_sampling = "FRONT"
    return made


def add_shape(number, shape, arrays):
    mesh = bpy.data.meshes.new(f"shape{number}")
    mesh.from_pydata(arrays[f"points{number}"].tolist(), [], arrays[f"triangles{number}"].tolist())
    if f"normals{number}" in arrays:
        mesh.shade_smooth()
        mesh.normals_split_custom_set_from_vertices(arrays[f"normals{number}"].tolist())
    mesh.materials.append(material(mesh.name, shape["reflectance"], shape["radiance"]))
    made = bpy.data.objects.new(mesh.name, mesh)
    made.cycles.shadow_terminator_offset = made.cycles.shadow_terminator_geometry_offset = 0
    bpy.context.scene.collection.objects.link(made)


def add_camera(record):
    """`world_from_camera` looks along +z with x to the left, Blender's along -z with x to the right."""
    from mathutils import Matrix

    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.angle = "HORIZONTAL", np.radians(record["fov"])
    camera.clip_start = 1e-4
    made = bpy.data.objects.new("camera", camera)
    turned = np.array(record["world_from_camera"]) @ np.diag([-1.0, 1, -1, 1])
    made.matrix_world = Matrix(turned.tolist())
    bpy.context.scene.collection.objects.link(made)
    bpy.context.scene.camera = made


def set_up(record):
    """The others' estimator: no clamps, no thresholds, all samples, no denoiser."""
    scene = bpy.context.scene
    scene.world = None
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x = render.resolution_y = record["size"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", record["threads"]
    render.use_persistent_data = True  # the tree is built by the first render alone
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "32"
    # Set once: with kept data a change of samples is heeded one render late.
    cycles.samples = record["spp"]
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    cycles.pixel_filter_type = "BOX"
    # One scattering event is an edge more than none, so two edges are no bounce in its count.
    cycles.max_bounces = cycles.diffuse_bounces = record["max_depth"] - 2
    cycles.min_light_bounces = record["rr_depth"] - 2
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.light_sampling_threshold = 0
    cycles.use_light_tree = False  # with one light half again as fast without


def load(folder, record):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
        for number, shape in enumerate(record["shapes"]):
            add_shape(number, shape, arrays)
    add_camera(record)
    set_up(record)


def render(seed):
    """Another seed than the last one's: Cycles keeps data, and renders but once what stays the same."""
    bpy.context.scene.cycles.seed = seed
    bpy.ops.render.render()


def save(folder, name):
    exr = folder / "image.exr"
    bpy.data.images["Render Result"].save_render(str(exr))
    image = bpy.data.images.load(str(exr))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * image.channels, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    planes = np.moveaxis(pixels.reshape(height, width, -1)[::-1, :, :3], 2, 0)
    bpy.data.images.remove(image)
    np.save(folder / name, planes)


def main(folder, answers):
    for line in sys.stdin:
        job, answer = json.loads(line), {}
        if "scene" in job:
            load(folder, job["scene"])
        elif "save" in job:
            save(folder, job["save"])
        elif "seed" in job:
            render(job["seed"])
        else:
            answer["version"] = bpy.app.version_string
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), os.fdopen(int(sys.argv[2]), "w"))
