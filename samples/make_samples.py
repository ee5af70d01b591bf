#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Makes LumiVDB's sample scenes: glTF 2.0 binary files and one sky image.

    python3 make_samples.py [FOLDER]      (default: the folder of this script)

Python's standard library only. The same script gives the same bytes, so the files beside it can be
checked against it. README.md says what each scene is for and where its numbers come from.

Conventions: metres, +Y up, right-handed; triangles counter-clockwise seen from their front.
"""
import json
import math
import pathlib
import struct
import sys

SKY_WIDTH, SKY_HEIGHT = 128, 64

# ---------------------------------------------------------------------------- glTF

FLOAT, UINT16, UINT32 = 5126, 5123, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def subtract(a, b):
    return tuple(p - q for p, q in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def normalize(a):
    length = math.sqrt(sum(p * p for p in a))
    return tuple(p / length for p in a)


def look_rotation(direction, up=(0, 1, 0)):
    """Quaternion (x, y, z, w) that turns a node's -Z to direction and its +Y towards up."""
    z = normalize(tuple(-p for p in direction))
    x = normalize(cross(up, z))
    y = cross(z, x)
    # Shepperd's method with the largest of the four squares, so nothing is divided by zero.
    squares = (1 + x[0] - y[1] - z[2], 1 - x[0] + y[1] - z[2], 1 - x[0] - y[1] + z[2],
               1 + x[0] + y[1] + z[2])
    k = squares.index(max(squares))
    rows = ((squares[0], y[0] + x[1], z[0] + x[2], y[2] - z[1]),
            (y[0] + x[1], squares[1], z[1] + y[2], z[0] - x[2]),
            (z[0] + x[2], z[1] + y[2], squares[2], x[1] - y[0]),
            (y[2] - z[1], z[0] - x[2], x[1] - y[0], squares[3]))
    return [round(q, 7) + 0.0 for q in normalize(rows[k])]


class Scene:
    """Materials, objects (triangles by material), one camera, lights; writes a .glb file."""

    def __init__(self, name):
        self.name = name
        self.materials, self.material_index = [], {}
        self.objects = {}
        self.nodes, self.lights, self.camera = [], [], None

    def material(self, name, albedo, emission=None, double_sided=False):
        """Lambertian reflectance, linear RGB; emission is radiance."""
        entry = {"name": name, "pbrMetallicRoughness": {
            "baseColorFactor": [*albedo, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}}
        if emission:
            strength = max(emission)  # emissiveFactor must not exceed 1
            entry["emissiveFactor"] = [round(e / strength, 9) for e in emission]
            entry["extensions"] = {"KHR_materials_emissive_strength": {
                "emissiveStrength": strength}}
        if double_sided:
            entry["doubleSided"] = True
        self.material_index[name] = len(self.materials)
        self.materials.append(entry)

    def polygon(self, obj, material, points):
        """A convex polygon, counter-clockwise seen from its front."""
        triangles = self.objects.setdefault(obj, {}).setdefault(material, [])
        for i in range(1, len(points) - 1):
            triangles.append((points[0], points[i], points[i + 1]))

    def set_camera(self, eye, target, yfov_degrees, aspect=16 / 9):
        self.camera = {"name": "camera", "type": "perspective", "perspective": {
            "yfov": round(math.radians(yfov_degrees), 9), "aspectRatio": round(aspect, 9),
            "znear": 0.01}}
        self.nodes.append({"name": "camera", "camera": 0, "translation": list(eye),
                           "rotation": look_rotation(subtract(target, eye))})

    def add_sun(self, name, direction, color, lux):
        """Directional light; direction is the way the light travels."""
        self.nodes.append({"name": name, "rotation": look_rotation(direction), "extensions": {
            "KHR_lights_punctual": {"light": len(self.lights)}}})
        self.lights.append({"name": name, "type": "directional", "color": list(color),
                            "intensity": lux})

    def _primitive(self, triangles, material, gltf, blob):
        ids, positions, indices = {}, [], []
        for point in (p for triangle in triangles for p in triangle):
            key = tuple(round(c, 6) + 0.0 for c in point)
            if key not in ids:
                ids[key] = len(positions)
                positions.append(key)
            indices.append(ids[key])
        wide = len(positions) > 65535
        position_bytes = b"".join(struct.pack("<3f", *p) for p in positions)
        # min and max must be those of the stored 32-bit values.
        stored = [struct.unpack_from("<3f", position_bytes, 12 * i) for i in range(len(positions))]
        index_bytes = struct.pack(f"<{len(indices)}{'I' if wide else 'H'}", *indices)
        accessors = []
        for data, target, extra in (
                (position_bytes, ARRAY_BUFFER,
                 {"componentType": FLOAT, "count": len(positions), "type": "VEC3",
                  "min": [min(axis) for axis in zip(*stored)],
                  "max": [max(axis) for axis in zip(*stored)]}),
                (index_bytes, ELEMENT_ARRAY_BUFFER,
                 {"componentType": UINT32 if wide else UINT16, "count": len(indices),
                  "type": "SCALAR"})):
            gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(blob),
                                        "byteLength": len(data), "target": target})
            blob += data + b"\0" * (-len(data) % 4)
            accessors.append(len(gltf["accessors"]))
            gltf["accessors"].append({"bufferView": len(gltf["bufferViews"]) - 1, **extra})
        return {"attributes": {"POSITION": accessors[0]}, "indices": accessors[1],
                "material": self.material_index[material]}

    def _document(self):
        gltf = {"asset": {"version": "2.0", "generator": "LumiVDB samples/make_samples.py",
                          "copyright": "The LumiVDB authors, Apache-2.0"},
                "scene": 0, "scenes": [{"name": self.name}], "nodes": [], "meshes": [],
                "materials": self.materials, "accessors": [], "bufferViews": [], "buffers": []}
        blob = bytearray()
        for name, parts in self.objects.items():
            primitives = [self._primitive(t, m, gltf, blob) for m, t in parts.items()]
            gltf["nodes"].append({"name": name, "mesh": len(gltf["meshes"])})
            gltf["meshes"].append({"name": name, "primitives": primitives})
        gltf["nodes"] += self.nodes
        gltf["scenes"][0]["nodes"] = list(range(len(gltf["nodes"])))
        gltf["buffers"].append({"byteLength": len(blob)})
        if self.camera:
            gltf["cameras"] = [self.camera]
        used = set()
        if self.lights:
            gltf["extensions"] = {"KHR_lights_punctual": {"lights": self.lights}}
            used.add("KHR_lights_punctual")
        for material in self.materials:
            used.update(material.get("extensions", {}))
        if used:
            gltf["extensionsUsed"] = sorted(used)
        return gltf, bytes(blob)

    def write(self, folder):
        gltf, blob = self._document()
        text = json.dumps(gltf, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = (struct.pack("<II", len(text), 0x4E4F534A) + text
                  + struct.pack("<II", len(blob), 0x004E4942) + blob)
        data = struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
        (folder / f"{self.name}.glb").write_bytes(data)


# ---------------------------------------------------------------------------- shapes


def box(scene, obj, material, lower, upper, inward=False):
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    faces = (((x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x0, y1, z0)),
             ((x1, y0, z1), (x1, y0, z0), (x1, y1, z0), (x1, y1, z1)),
             ((x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)),
             ((x0, y1, z1), (x1, y1, z1), (x1, y1, z0), (x0, y1, z0)),
             ((x1, y0, z0), (x0, y0, z0), (x0, y1, z0), (x1, y1, z0)),
             ((x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)))
    for face in faces:
        scene.polygon(obj, material, face[::-1] if inward else face)


def ring(scene, obj, material, outer, inner):
    """The area between two quads with the same winding: four trapezoids, no T-junction."""
    for i in range(4):
        j = (i + 1) % 4
        scene.polygon(obj, material, (outer[i], outer[j], inner[j], inner[i]))


def prism(scene, obj, material, centre, radius, y0, y1, sides, caps=True):
    """Upright prism over a regular polygon, closed at both ends when caps."""
    rim = [(centre[0] + radius * math.sin(2 * math.pi * i / sides),
            centre[1] + radius * math.cos(2 * math.pi * i / sides)) for i in range(sides)]
    for (ax, az), (bx, bz) in zip(rim, rim[1:] + rim[:1]):
        scene.polygon(obj, material, ((ax, y0, az), (bx, y0, bz), (bx, y1, bz), (ax, y1, az)))
    if caps:
        scene.polygon(obj, material, [(x, y1, z) for x, z in rim])
        scene.polygon(obj, material, [(x, y0, z) for x, z in rim[::-1]])


def cells(scene, obj, planes, solid, material):
    """Solid masonry on a grid of planes: a watertight surface without inner faces or T-junctions.

    solid(x, y, z) tells whether the cell around a point is filled; material(p, axis, sign) names
    the surface at face centre p whose outward normal is sign along axis.
    """
    counts = [len(axis) - 1 for axis in planes]
    middle = [[(a + b) / 2 for a, b in zip(axis, axis[1:])] for axis in planes]
    filled = {(i, j, k) for i in range(counts[0]) for j in range(counts[1])
              for k in range(counts[2]) if solid(middle[0][i], middle[1][j], middle[2][k])}
    for cell in sorted(filled):
        for axis in range(3):
            for sign in (-1, 1):
                other = tuple(c + (sign if a == axis else 0) for a, c in enumerate(cell))
                if other in filled:
                    continue
                u, v = (axis + 1) % 3, (axis + 2) % 3
                corners = []
                for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    p = [0.0, 0.0, 0.0]
                    p[axis] = planes[axis][cell[axis] + (sign > 0)]
                    p[u], p[v] = planes[u][cell[u] + du], planes[v][cell[v] + dv]
                    corners.append(tuple(p))
                centre = tuple(sum(c) / 4 for c in zip(*corners))
                scene.polygon(obj, material(centre, axis, sign),
                              corners if sign > 0 else corners[::-1])


def inside(lower, upper, *values):
    return all(lo < v < hi for lo, v, hi in zip(lower, values, upper))


# ---------------------------------------------------------------------------- scenes


def cornell_box():
    """Measured geometry of https://www.graphics.cornell.edu/online/box/data.html, in metres.

    RGB of the walls (.63 .065 .05 / .14 .45 .091 / .725 .71 .68) and of the light (17 12 4,
    reflectance .78): the Cornell box of McGuire's Computer Graphics Archive. Two changes keep
    surfaces from lying in one another: the ceiling has a hole where the lamp is, and the blocks
    have a bottom half a millimetre above the floor, so that the space inside them is closed.
    """
    scene = Scene("cornell_box")
    scene.material("white", (0.725, 0.71, 0.68))
    scene.material("red", (0.63, 0.065, 0.05))
    scene.material("green", (0.14, 0.45, 0.091))
    scene.material("ceiling_lamp", (0.78, 0.78, 0.78), emission=(17, 12, 4))

    def millimetres(*points):
        return [tuple(c / 1000 for c in p) for p in points]

    def quad(obj, material, *points):
        scene.polygon(obj, material, millimetres(*points))

    quad("floor", "white", (552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2))
    quad("back_wall", "white",
         (549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2))
    quad("right_wall", "green", (0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2))
    quad("left_wall", "red",
         (552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0))
    lamp = ((343, 548.8, 227), (343, 548.8, 332), (213, 548.8, 332), (213, 548.8, 227))
    ceiling = ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0))
    ring(scene, "ceiling", "white", millimetres(*ceiling), millimetres(*lamp))
    quad("lamp", "ceiling_lamp", *lamp)
    for name, height, top in (
            ("short_block", 165, ((130, 65), (82, 225), (240, 272), (290, 114))),
            ("tall_block", 330, ((423, 247), (265, 296), (314, 456), (472, 406)))):
        quad(name, "white", *((x, height, z) for x, z in top))
        quad(name, "white", *((x, 0.5, z) for x, z in top[::-1]))
        for (ax, az), (bx, bz) in zip(top, top[1:] + top[:1]):
            quad(name, "white", (ax, 0.5, az), (bx, 0.5, bz), (bx, height, bz), (ax, height, az))
    # The page's camera: focal length 35 mm over a 25 mm square.
    scene.set_camera((0.278, 0.273, -0.8), (0.278, 0.273, 0),
                     2 * math.degrees(math.atan(0.0125 / 0.035)), aspect=1)
    return scene


SUN_COLOR, SUN_KILOLUX = (1.0, 0.95, 0.88), 80.0
HOUSE_SUN = (-0.35, -0.8, -0.5)  # the way the light travels; also where the sky is brightest


def house():
    """A house on a sunny day: dark inside, a lit patch behind door and window, bright outside.

    Light in kilolux and thousands of cd/m^2: sun 80, sky.hdr about 2 to 8.
    """
    scene = Scene("house")
    for name, albedo in (("grass", (0.12, 0.25, 0.06)), ("brick", (0.45, 0.22, 0.16)),
                         ("white_plaster", (0.80, 0.78, 0.74)), ("wooden_floor", (0.42, 0.27, 0.15)),
                         ("roof_tiles", (0.38, 0.15, 0.10)), ("blue_cabinet", (0.12, 0.20, 0.55))):
        scene.material(name, albedo)
    room = ((-3.7, 0.0, -2.7), (3.7, 2.8, 2.7))
    cabinet = ((-3.7, 0.0, -2.7), (-2.2, 1.0, -2.1))

    def solid(x, y, z):
        if y < 0 or inside(*cabinet, x, y, z):
            return True
        if inside((-0.5, 0.0, 2.7), (0.5, 2.1, 3.0), x, y, z):  # doorway, to the south
            return False
        if inside((3.7, 1.0, -1.0), (4.0, 2.1, 1.0), x, y, z):  # window, to the east
            return False
        if y > 2.8:  # flat roof with eaves of 0.3 m
            return inside((-4.3, -3.3), (4.3, 3.3), x, z) and y < 3.05
        return inside((-4.0, -3.0), (4.0, 3.0), x, z) and not inside(*room, x, y, z)

    def material(p, axis, sign):
        x, y, z = p
        if y > 2.8 or (axis == 1 and sign < 0 and y == 2.8 and not inside(*room, x, 1, z)):
            return "roof_tiles"
        indoors = abs(x) <= 3.7 and abs(z) <= 2.7
        if inside((-3.71, -1, -2.71), (-2.19, 1.01, -2.09), *p) and not (
                (axis == 0 and x < -3.6) or (axis == 2 and z < -2.6)):
            return "blue_cabinet"
        if axis == 1 and y == 0:
            return "wooden_floor" if indoors or inside((-4, -3), (4, 3), x, z) else "grass"
        if y < 0:
            return "grass"
        return "white_plaster" if indoors or inside((-4, -3), (4, 3), x, z) else "brick"

    planes = ((-10, -4.3, -4, -3.7, -2.2, -0.5, 0.5, 3.7, 4, 4.3, 10),
              (-0.5, 0, 1, 2.1, 2.8, 3.05),
              (-10, -3.3, -3, -2.7, -2.1, -1, 1, 2.7, 3, 3.3, 10))
    cells(scene, "house", planes, solid, material)
    scene.add_sun("sun", HOUSE_SUN, SUN_COLOR, SUN_KILOLUX)
    scene.set_camera((5.5, 2.2, 8.5), (0.0, 1.2, 0.5), 45)
    return scene


def two_rooms(door):
    """Two closed rooms and a wall of no thickness between them; a lamp in one of them only."""
    scene = Scene("two_rooms_door" if door else "two_rooms")
    scene.material("walls", (0.7, 0.7, 0.7))
    scene.material("partition", (0.6, 0.5, 0.3), double_sided=True)
    scene.material("ceiling_panel", (0.5, 0.5, 0.5), emission=(10, 9, 8))
    z0, z1, height = -2.0, 2.0, 3.0
    for name, x0, x1 in (("lit_room", -4.0, 0.0), ("dark_room", 0.0, 4.0)):
        scene.polygon(name, "walls", ((x0, 0, z0), (x0, 0, z1), (x1, 0, z1), (x1, 0, z0)))
        scene.polygon(name, "walls", ((x0, 0, z0), (x1, 0, z0), (x1, height, z0), (x0, height, z0)))
        scene.polygon(name, "walls", ((x1, 0, z1), (x0, 0, z1), (x0, height, z1), (x1, height, z1)))
        ceiling = ((x0, height, z0), (x1, height, z0), (x1, height, z1), (x0, height, z1))
        if name == "lit_room":
            scene.polygon(name, "walls",
                          ((x0, 0, z1), (x0, 0, z0), (x0, height, z0), (x0, height, z1)))
            panel = ((-2.5, height, -0.5), (-1.5, height, -0.5),
                     (-1.5, height, 0.5), (-2.5, height, 0.5))
            ring(scene, name, "walls", ceiling, panel)
            scene.polygon("ceiling_panel", "ceiling_panel", panel)
        else:
            scene.polygon(name, "walls",
                          ((x1, 0, z0), (x1, 0, z1), (x1, height, z1), (x1, height, z0)))
            scene.polygon(name, "walls", ceiling)

    def wall(y_low, y_high, z_low, z_high):
        scene.polygon("partition", "partition", ((0, y_low, z_low), (0, y_high, z_low),
                                                 (0, y_high, z_high), (0, y_low, z_high)))
    if door:  # 0.9 m by 2.1 m, off the middle
        for y_low, y_high in ((0, 2.1), (2.1, height)):
            wall(y_low, y_high, z0, 0.3)
            wall(y_low, y_high, 1.2, z1)
        wall(2.1, height, 0.3, 1.2)
    else:
        wall(0, height, z0, z1)
    scene.set_camera((3.7, 1.6, -1.6), (-1.0, 1.3, 0.7), 60)
    return scene


def furnace():
    """Closed box, 2 m wide, seen from inside: every surface emits Le = 1 and reflects rho = 0.5.

    The radiance is the same everywhere and in all directions, L = Le + rho L = Le/(1-rho) = 2.
    """
    scene = Scene("furnace")
    scene.material("furnace_wall", (0.5, 0.5, 0.5), emission=(1, 1, 1))
    box(scene, "furnace", "furnace_wall", (-1, -1, -1), (1, 1, 1), inward=True)
    scene.set_camera((0, 0, 0.9), (0, 0, 0), 60)
    return scene


# ---- courtyard: masonry on a grid of planes, and four arcades around an open square

INNER, ARCADE, PARAPET, WALL, OUTER = 22.5, 23.3, 22.7, 29.0, 30.0
SPRING, FLOOR2, FLOOR2_TOP, EAVES, ROOF = 2.6, 6.0, 6.4, 11.0, 11.4
BAYS, BAY, PIER = 9, 5.0, 0.4  # along one side; width; half a pier


def courtyard_solid(x, y, z):
    r = max(abs(x), abs(z))
    if y < 0:
        return True
    if y < 0.3 and 4 < min(abs(x), abs(z)) and r < 18:  # four raised lawns
        return True
    if z > WALL and abs(x) < 2 and y < 5:  # gate
        return False
    if y < ROOF and r > WALL:
        return True
    if FLOOR2 < y < FLOOR2_TOP or EAVES < y < ROOF:
        return r > INNER
    if FLOOR2_TOP < y < 7.3:
        return INNER < r < PARAPET
    if y > ROOF and x > ARCADE and z < -ARCADE:  # bell tower over the north-east corner
        rim_x, rim_z = not 24.1 < x < 29.2, not -29.2 < z < -24.1
        return y > 18.5 or (rim_x and rim_z if y > 14 else rim_x or rim_z)
    return False


def courtyard_material(p, axis, sign):
    x, y, z = p
    r = max(abs(x), abs(z))
    if y <= 0.3 and r <= 18.1 and min(abs(x), abs(z)) >= 3.9:
        return "lawn" if axis == 1 and y > 0.2 else "sandstone"
    if axis == 1 and sign > 0:
        return "paving" if y < 11 else "roof_tiles"
    if axis == 1:
        return "white_plaster"
    return "white_plaster" if r <= WALL and y < EAVES and r > PARAPET else "sandstone"


def turned(quarter, x, y, z):
    """Quarter turns about +Y."""
    for _ in range(quarter):
        x, z = z, -x
    return (x, y, z)


def arcade(scene, quarter, segments=12):
    """One side of round arches: both faces and the soffits, between INNER and ARCADE."""
    def at(u, y, w):
        return turned(quarter, u, y, w)

    def faces(quad):  # counter-clockwise in (u, y) seen from outside the courtyard
        scene.polygon("arcades", "sandstone", [at(u, y, ARCADE) for u, y in quad])
        scene.polygon("arcades", "sandstone", [at(u, y, INNER) for u, y in quad[::-1]])

    radius = BAY / 2 - PIER
    for bay in range(BAYS):
        left = -INNER + bay * BAY
        middle, right = left + BAY / 2, left + BAY
        for u0, u1 in ((left, left + PIER), (right - PIER, right)):
            for y0, y1 in ((0, SPRING), (SPRING, FLOOR2)):
                faces(((u0, y0), (u1, y0), (u1, y1), (u0, y1)))
        arch = [(middle - radius * math.cos(math.pi * i / segments),
                 SPRING + radius * math.sin(math.pi * i / segments)) for i in range(segments + 1)]
        for a, b in zip(arch, arch[1:]):
            faces((a, b, (b[0], FLOOR2), (a[0], FLOOR2)))
        opening = [(left + PIER, 0.0)] + arch + [(right - PIER, 0.0)]
        for a, b in zip(opening, opening[1:]):
            scene.polygon("arcades", "white_plaster",
                          (at(*a, INNER), at(*b, INNER), at(*b, ARCADE), at(*a, ARCADE)))
    for y0, y1 in ((0, SPRING), (SPRING, FLOOR2)):  # the corner pier's two outer faces
        scene.polygon("arcades", "sandstone", (at(INNER, y0, ARCADE), at(ARCADE, y0, ARCADE),
                                               at(ARCADE, y1, ARCADE), at(INNER, y1, ARCADE)))
        scene.polygon("arcades", "sandstone", (at(ARCADE, y0, ARCADE), at(ARCADE, y0, INNER),
                                               at(ARCADE, y1, INNER), at(ARCADE, y1, ARCADE)))


def fountain(scene):
    sides, rim, wall, water = 16, 3.0, 2.6, 0.5
    def circle(radius, y):
        return [(radius * math.sin(2 * math.pi * i / sides), y,
                 radius * math.cos(2 * math.pi * i / sides)) for i in range(sides)]
    rings = (circle(rim, 0.0), circle(rim, 0.7), circle(wall, 0.7), circle(wall, water))
    for lower, upper in zip(rings, rings[1:]):
        for i in range(sides):
            j = (i + 1) % sides
            scene.polygon("fountain", "marble", (lower[i], lower[j], upper[j], upper[i]))
    scene.polygon("fountain", "water", circle(wall, water))
    prism(scene, "fountain", "marble", (0, 0), 0.35, water - 0.1, 2.4, sides)


def courtyard():
    """A cloister of 60 m by 60 m under sun and sky: open square, arcades, gallery, a tower."""
    scene = Scene("courtyard")
    for name, albedo in (("sandstone", (0.55, 0.44, 0.31)), ("white_plaster", (0.78, 0.75, 0.70)),
                         ("paving", (0.42, 0.38, 0.33)), ("roof_tiles", (0.45, 0.17, 0.10)),
                         ("lawn", (0.10, 0.22, 0.05)), ("marble", (0.75, 0.75, 0.73)),
                         ("water", (0.05, 0.12, 0.15))):
        scene.material(name, albedo)
    scene.material("red_banner", (0.60, 0.05, 0.04), double_sided=True)
    scene.material("blue_banner", (0.05, 0.12, 0.50), double_sided=True)
    edge = (-OUTER, -WALL, -ARCADE, -PARAPET, -INNER, -18, -4, -2)
    along = sorted(set(edge) | {-e for e in edge})
    planes = (sorted(along + [24.1, 29.2]),
              (-0.5, 0, 0.3, 5, FLOOR2, FLOOR2_TOP, 7.3, EAVES, ROOF, 14, 18.5, 20),
              sorted(along + [-24.1, -29.2]))
    cells(scene, "masonry", planes, courtyard_solid, courtyard_material)
    for quarter in range(4):
        arcade(scene, quarter)
        for i in range(19):  # columns of the upper gallery, let into floor and ceiling
            x, _, z = turned(quarter, -INNER + 2.5 * i, 0, 23.0)
            prism(scene, "columns", "marble", (x, z), 0.22, FLOOR2_TOP - 0.02, EAVES + 0.02, 12)
        for i in range(1, BAYS):
            u, name = -INNER + i * BAY, ("red_banner", "blue_banner")[i % 2]
            scene.polygon("banners", name, [turned(quarter, u + du, y, INNER - 0.1) for du, y in (
                (-0.5, 3.6), (0.5, 3.6), (0.5, 6.2), (-0.5, 6.2))])
    fountain(scene)
    scene.add_sun("sun", HOUSE_SUN, SUN_COLOR, SUN_KILOLUX)
    scene.set_camera((-19.0, 4.5, 19.0), (6.0, 3.5, -12.0), 60)
    return scene


# ---------------------------------------------------------------------------- sky


def sky_radiance(direction):
    """Thousands of cd/m^2: a blue sky, paler at the horizon and around the sun (which is not in
    it), and a dim ground below the horizon."""
    zenith, horizon, ground = (1.7, 2.9, 5.6), (5.2, 6.2, 7.2), (1.3, 1.2, 0.9)
    up = direction[1]
    towards_sun = sum(-a * b for a, b in zip(normalize(HOUSE_SUN), direction))
    glow = 4.0 * math.exp(6.0 * (towards_sun - 1.0))
    height = math.sqrt(max(up, 0.0))
    below = min(max(-up / 0.15, 0.0), 1.0)
    below = below * below * (3.0 - 2.0 * below)
    color = []
    for z, h, g in zip(zenith, horizon, ground):
        sky = h + (z - h) * height + glow
        color.append(sky + (g - sky) * below)
    return color


def rgbe(color):
    """Ward's shared-exponent pixel (Graphics Gems II, 1991), rounded to nearest."""
    mantissa, exponent = math.frexp(max(color))
    if mantissa > 255.5 / 256:  # would round up to 256
        exponent += 1
    scale = math.ldexp(1.0, 8 - exponent)
    return bytes(min(255, int(round(c * scale, 6) + 0.5)) for c in color) + bytes([exponent + 128])


def write_sky(path):
    """Lat-long map, row 0 on top: d = (sin pv cos 2p(u-1/2), cos pv, sin pv sin 2p(u-1/2))."""
    rows = [f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {SKY_HEIGHT} +X {SKY_WIDTH}\n".encode()]
    for j in range(SKY_HEIGHT):
        theta = math.pi * (j + 0.5) / SKY_HEIGHT
        for i in range(SKY_WIDTH):
            phi = 2 * math.pi * ((i + 0.5) / SKY_WIDTH - 0.5)
            rows.append(rgbe(sky_radiance((math.sin(theta) * math.cos(phi), math.cos(theta),
                                           math.sin(theta) * math.sin(phi)))))
    path.write_bytes(b"".join(rows))


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else __file__)
    folder = folder if len(sys.argv) > 1 else folder.resolve().parent
    folder.mkdir(parents=True, exist_ok=True)
    for scene in (cornell_box(), house(), two_rooms(door=False), two_rooms(door=True), furnace(),
                  courtyard()):
        scene.write(folder)
    write_sky(folder / "sky.hdr")


if __name__ == "__main__":
    main()
