# SPDX-License-Identifier: Apache-2.0
"""Looks at volume grids through Blender without a window. Runs inside Blender only.

Blender 3.4 has no Python access to voxels. What it draws is read instead: a grid is made the
emission of a volume without scattering and Cycles renders it with an orthographic camera along one
axis, so a pixel is the integral of the grid along its ray, in grid value times world units.
"""

import os
import tempfile

import bpy


def import_volume(path):
    """An empty scene with the volume file alone; returns its object."""
    for data in (bpy.data.objects, bpy.data.volumes, bpy.data.cameras, bpy.data.materials):
        for item in list(data):
            data.remove(item)
    bpy.ops.object.volume_import(filepath=path)
    volume = bpy.context.object
    assert volume.data.grids.load(), volume.data.grids.error_message
    return volume


def _emit(volume, grid):
    material = bpy.data.materials.new("emission")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = grid
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(attribute.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], output.inputs["Volume"])
    volume.data.materials.clear()
    volume.data.materials.append(material)


def _camera(centre, width, along):
    """Orthographic; image right and up are +x and +y, or +x and +z when it looks along y."""
    camera = bpy.data.cameras.new("camera")
    camera.type = "ORTHO"
    camera.ortho_scale = width
    camera.clip_end = 1e4
    item = bpy.data.objects.new("camera", camera)
    bpy.context.scene.collection.objects.link(item)
    if along == "z":
        item.location = (centre[0], centre[1], 1000)
    else:
        item.location = (centre[0], -1000, centre[1])
        item.rotation_euler = (1.5707963267948966, 0, 0)
    bpy.context.scene.camera = item


class Picture:
    """value(u, v): the integral along the ray through world (u, v) as (r, g, b)."""

    def __init__(self, pixels, centre, width, size):
        self.pixels, self.centre, self.width, self.size = pixels, centre, width, size

    def value(self, u, v):
        column = int((u - self.centre[0] + self.width / 2) / self.width * self.size)
        row = int((v - self.centre[1] + self.width / 2) / self.width * self.size)
        at = (row * self.size + column) * 4
        return tuple(self.pixels[at:at + 3])

    def total(self):
        return sum(self.pixels[0::4]) + sum(self.pixels[1::4]) + sum(self.pixels[2::4])


def render(volume, grid, centre, width, size=80, along="z"):
    """The picture of one grid, @a width world units wide, @a size pixels."""
    _emit(volume, grid)
    _camera(centre, width, along)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 8
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    scene.cycles.volume_step_rate = 0.1
    scene.cycles.volume_max_steps = 4096
    scene.world = bpy.data.worlds.new("black")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    scene.view_settings.view_transform = "Raw"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = os.path.join(folder, "picture.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = list(image.pixels)
        bpy.data.images.remove(image)
    return Picture(pixels, centre, width, size)
