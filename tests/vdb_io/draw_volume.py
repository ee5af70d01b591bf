# SPDX-License-Identifier: Apache-2.0
"""Draws a baked volume in its scene with Blender, without a window:

    blender --background --python tests/vdb_io/draw_volume.py -- SCENE.glb VOLUME.vdb OUT.png

The volume must be Z-up (lumivdb bake --up z). Its preview grids glow like lit haze, `color` times
`density`, so the brightness of a place counts twice and shafts of light stand out. The scene itself
is lit by that glow and by a dim, even world, not by the sun of the bake. The camera stands inside at
one end and looks along x.
"""

import sys

import bpy
import numpy
from mathutils import Vector

GLOW, WORLD = 0.0012, 1.0


def import_scene(path):
    """The glTF scene, alone; returns the corners of its box."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    # The glTF importer of Blender 3.4 asks for a name that NumPy 1.24 has dropped.
    if not hasattr(numpy, "bool"):
        numpy.bool = bool
    bpy.ops.import_scene.gltf(filepath=path)
    corners = [item.matrix_world @ Vector(corner) for item in bpy.data.objects
               if item.type == "MESH" for corner in item.bound_box]
    return [Vector(f(c[axis] for c in corners) for axis in range(3)) for f in (min, max)]


def attribute(tree, name):
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node


def glow(tree):
    """Emission of `color` times `density`."""
    strength = tree.nodes.new("ShaderNodeMath")
    strength.operation = "MULTIPLY"
    strength.inputs[1].default_value = GLOW
    tree.links.new(attribute(tree, "density").outputs["Fac"], strength.inputs[0])
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(attribute(tree, "color").outputs["Color"], emission.inputs["Color"])
    tree.links.new(strength.outputs["Value"], emission.inputs["Strength"])
    return emission


def import_volume(path):
    bpy.ops.object.volume_import(filepath=path)
    volume = bpy.context.object
    assert volume.data.grids.load(), volume.data.grids.error_message
    # Cycles draws the value of a voxel from its index on: half a voxel too far.
    voxel = volume.data.grids["color"].matrix_object[0][0]
    volume.location = [-voxel / 2] * 3
    material = bpy.data.materials.new("light")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(glow(tree).outputs["Emission"], output.inputs["Volume"])
    volume.data.materials.append(material)


def add_camera(low, high):
    size, middle = high - low, (low + high) / 2
    eye = Vector((low.x + 0.27 * size.x, middle.y, low.z + 0.31 * size.z))
    target = Vector((high.x, middle.y, low.z + 0.30 * size.z))
    camera = bpy.data.cameras.new("camera")
    camera.angle = 1.3
    item = bpy.data.objects.new("camera", camera)
    item.location = eye
    item.rotation_euler = (target - eye).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(item)
    bpy.context.scene.camera = item


def render(path):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 40
    scene.cycles.seed = 1
    scene.cycles.max_bounces = 2
    scene.cycles.use_denoising = False
    scene.cycles.volume_step_rate = 4
    scene.world = bpy.data.worlds.new("dim")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = WORLD
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = 560, 315
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 100
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


def main():
    scene, volume, picture = sys.argv[sys.argv.index("--") + 1:]
    low, high = import_scene(scene)
    import_volume(volume)
    add_camera(low, high)
    render(picture)


main()
