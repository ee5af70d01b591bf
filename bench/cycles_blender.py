# SPDX-License-Identifier: Apache-2.0
"""The half of bench/cycles.py that runs inside Blender; how the model is mapped stands there.

Started with a job as JSON: scene, env, fronts (only fronts of emitters shine), threads, adaptive
(threshold, or 0 for fixed samples), picture (a file to write to). Then for each line of standard
input, a request with points, width, samples and seed, it prints the SH of each point and seconds.
"""

import json
import math
import sys
import time

REPLY = "@reply "


def sh_basis(x, y, z):
    """Three bands as in docs/CONVENTIONS.md; floats or arrays."""
    k0, k1, k20, k21, k22 = (math.sqrt(n / d / math.pi)
                             for n, d in ((1, 4), (3, 4), (5, 16), (15, 4), (15, 16)))
    return [k0 + 0 * x, -k1 * y, k1 * z, -k1 * x, 2 * k22 * x * y, -k21 * y * z,
            k20 * (3 * z * z - 1), -k21 * x * z, k22 * (x * x - y * y)]


def make_surface(material, is_obj, front_only_emission):
    """Replaces what the importer made by the Lambertian model; see the top of this file."""
    tree = material.node_tree
    nodes, link = tree.nodes, tree.links.new
    principled = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")

    def copy(name, to):
        source = principled.inputs[name]
        value = source.default_value
        to.default_value = value if isinstance(value, float) else tuple(value)
        if source.is_linked:
            link(source.links[0].from_socket, to)
        return source.is_linked

    def mix(factor, first, second=None):
        node = nodes.new("ShaderNodeMixShader")
        link(factor, node.inputs[0])
        for shader, slot in ((first, 1), (second, 2)):
            if shader:
                link(shader, node.inputs[slot])
        return node.outputs[0]

    diffuse, emission = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeEmission")
    behind = nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"]
    if copy("Base Color", diffuse.inputs["Color"]) and is_obj:
        tint = nodes.new("ShaderNodeMixRGB")
        tint.blend_type, tint.inputs[0].default_value = "MULTIPLY", 1
        link(principled.inputs["Base Color"].links[0].from_socket, tint.inputs[1])
        tint.inputs[2].default_value = principled.inputs["Base Color"].default_value
        link(tint.outputs[0], diffuse.inputs["Color"])
    shader = diffuse.outputs[0]
    glows = copy("Emission", emission.inputs["Color"])
    glows = glows or any(c > 0 for c in emission.inputs["Color"].default_value[:3])
    copy("Emission Strength", emission.inputs["Strength"])
    single = is_obj or material.use_backface_culling
    if glows and emission.inputs["Strength"].default_value > 0:
        add = nodes.new("ShaderNodeAddShader")
        light = emission.outputs[0]
        link(mix(behind, light) if front_only_emission and not single else light, add.inputs[0])
        link(shader, add.inputs[1])
        shader = add.outputs[0]
    if single:
        shader = mix(behind, shader)
    images = [n for n in nodes if n.type == "TEX_IMAGE"]
    for node in images:
        node.interpolation = "Closest"
        node.image.alpha_mode = "CHANNEL_PACKED"
    if principled.inputs["Alpha"].is_linked and material.blend_method != "OPAQUE":
        shader = cut_out(material, principled.inputs["Alpha"].links[0].from_socket, shader, mix)
    link(shader, next(n for n in nodes if n.type == "OUTPUT_MATERIAL").inputs["Surface"])


def cut_out(material, alpha, shader, mix):
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    if alpha.node.type == "TEX_IMAGE":
        smooth = nodes.new("ShaderNodeTexImage")
        smooth.image, smooth.extension = alpha.node.image, alpha.node.extension
        if alpha.node.inputs[0].is_linked:
            link(alpha.node.inputs[0].links[0].from_socket, smooth.inputs[0])
        alpha = smooth.outputs["Alpha"]
    below = nodes.new("ShaderNodeMath")
    below.operation = "LESS_THAN"
    link(alpha, below.inputs[0])
    below.inputs[1].default_value = \
        material.alpha_threshold if material.blend_method == "CLIP" else 0.5
    return mix(below.outputs[0], shader, nodes.new("ShaderNodeBsdfTransparent").outputs[0])


def load_scene(bpy, job):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    is_obj = job["scene"].endswith(".obj")
    if is_obj:
        bpy.ops.wm.obj_import(filepath=job["scene"], forward_axis="NEGATIVE_Z", up_axis="Y")
    else:
        bpy.ops.import_scene.gltf(filepath=job["scene"], convert_lighting_mode="COMPAT")
    for light in bpy.data.lights:
        if light.type == "SUN":
            light.angle = 0
    for mesh in bpy.data.meshes:
        mesh.use_auto_smooth = False
        mesh.polygons.foreach_set("use_smooth", [False] * len(mesh.polygons))
    for material in bpy.data.materials:
        if material.use_nodes and material.users:
            make_surface(material, is_obj, job["fronts"])
    world = bpy.context.scene.world = bpy.data.worlds.new("world")
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0, 0, 0, 1)
    if job["env"]:
        sky = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
        sky.image, sky.interpolation = bpy.data.images.load(job["env"]), "Closest"
        sky.image.colorspace_settings.name = "Non-Color"
        world.node_tree.links.new(sky.outputs[0], background.inputs["Color"])


def set_up_render(bpy, job):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", job["threads"]
    scene.render.use_persistent_data = True
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    cycles = scene.cycles
    for name in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, name + "_bounces", 1024)
    cycles.transparent_max_bounces = 1024
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.use_denoising = cycles.use_auto_tile = False
    cycles.use_adaptive_sampling = job["adaptive"] > 0
    cycles.adaptive_threshold = job["adaptive"]
    cycles.pixel_filter_type = "BOX"
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.cycles.panorama_type = "PANO", "EQUIRECTANGULAR"
    camera.clip_start, camera.clip_end = 1e-6, 1e9
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.rotation_euler = (math.pi / 2, 0, 0)  # its centre looks along Blender's +Y
    scene.collection.objects.link(scene.camera)
    return scene


def pixel_weights(numpy, width, fine=16):
    """Integrals of the basis over each pixel, (height * width, 9), rows from the bottom up."""
    height = width // 2
    theta = math.pi * (1 - (numpy.arange(height * fine) + 0.5) / (height * fine))
    phi = 2 * math.pi * ((numpy.arange(width * fine) + 0.5) / (width * fine) - 0.5)
    theta, phi = theta[:, None], phi[None, :]
    # Blender's (sin phi, cos phi) sin theta, cos theta; ours is (x, z, -y) of that.
    x, y, z = numpy.sin(theta) * numpy.sin(phi), numpy.cos(theta) + 0 * phi, \
        -numpy.sin(theta) * numpy.cos(phi)
    area = numpy.sin(theta) * (math.pi / (height * fine)) * (2 * math.pi / (width * fine))
    return numpy.stack([(f * area).reshape(height, fine, width, fine).sum((1, 3)).ravel()
                        for f in sh_basis(x, y, z)], 1)


def render_probes(bpy, numpy, scene, request, path):
    """SH of each point, and the seconds that rendering took."""
    width, seconds, found = request["width"], 0, []
    scene.render.resolution_x, scene.render.resolution_y = width, width // 2
    scene.cycles.samples, scene.render.filepath = request["samples"], path
    weights = pixel_weights(numpy, width)
    for number, (x, y, z) in enumerate(request["points"]):
        scene.cycles.seed = request["seed"] * 100003 + number
        scene.camera.location = (x, -z, y)
        start = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        seconds += time.perf_counter() - start
        image = bpy.data.images.load(path)
        pixels = numpy.empty(width * width * 2, numpy.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        found.append((weights.T @ pixels.reshape(-1, 4)[:, :3].astype(float)).tolist())
    return {"sh": found, "seconds": seconds}


def main(job):
    import bpy
    import numpy
    # The glTF importer of Blender 3.4 asks for a name that NumPy 1.24 has dropped.
    if not hasattr(numpy, "bool"):
        numpy.bool = bool
    load_scene(bpy, job)
    scene = set_up_render(bpy, job)
    for line in sys.stdin:
        reply = render_probes(bpy, numpy, scene, json.loads(line), job["picture"])
        print(REPLY + json.dumps(reply), flush=True)


if __name__ == "__main__":
    main(json.loads(sys.argv[sys.argv.index("--") + 1]))
