#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Makes scenes that are hard to bake, as glTF 2.0 binary files.

    python3 hard_scenes.py FOLDER [NAME ...]      (default: all; names are those of the functions)

Python's standard library only; the same script gives the same bytes. Metres, +Y up. What is hard,
and the box that is worth baking, stands with each scene.
"""
import json
import math
import pathlib
import random
import struct
import sys
from array import array

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "samples"))
from make_samples import FLOAT, UINT32, Scene, box, cells, inside, ring  # noqa: E402

PLASTER, FLOOR, WOOD = (0.8, 0.78, 0.75), (0.45, 0.38, 0.3), (0.55, 0.4, 0.25)


def quad(scene, obj, material, corner, u, v):
    """Its front is the side u x v points to."""
    a = corner
    b = tuple(p + q for p, q in zip(a, u))
    d = tuple(p + q for p, q in zip(a, v))
    c = tuple(p + q for p, q in zip(b, v))
    scene.polygon(obj, material, (a, b, c, d))


def ceiling_lamp(scene, material, lower, upper, y, centre, half):
    """A ceiling with a square lamp set into it, facing down."""
    def square(x0, z0, x1, z1):
        return ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))
    lamp = square(centre[0] - half, centre[1] - half, centre[0] + half, centre[1] + half)
    ring(scene, "ceiling", material, square(*lower, *upper), lamp)
    scene.polygon("lamp", "lamp", lamp)


def room(scene, material, lower, upper, lamp_half=0, without=""):
    """Faces that look inward, but the one without ("-x" or "+x"); a lamp in the ceiling."""
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    w, h, d = x1 - x0, y1 - y0, z1 - z0
    quad(scene, "floor", material, lower, (0, 0, d), (w, 0, 0))
    quad(scene, "walls", material, lower, (w, 0, 0), (0, h, 0))
    quad(scene, "walls", material, (x1, y0, z1), (-w, 0, 0), (0, h, 0))
    if without != "-x":
        quad(scene, "walls", material, lower, (0, h, 0), (0, 0, d))
    if without != "+x":
        quad(scene, "walls", material, (x1, y0, z1), (0, h, 0), (0, 0, -d))
    if lamp_half:
        ceiling_lamp(scene, material, (x0, z0), (x1, z1), y1, ((x0 + x1) / 2, (z0 + z1) / 2),
                     lamp_half)
    else:
        quad(scene, "ceiling", material, (x0, y1, z0), (w, 0, 0), (0, 0, d))


def white_room(folder):
    """A closed room of albedo 0.99 with a lamp of 10 cm: light is reflected a hundred times.

    Bake --bounds -2,0,-2.5,2,3,2.5.
    """
    scene = Scene("white_room")
    scene.material("white", (0.99, 0.99, 0.99))
    scene.material("lamp", (0.99, 0.99, 0.99), emission=(100, 100, 100))
    room(scene, "white", (-2, 0, -2.5), (2, 3, 2.5), 0.05)
    scene.write(folder)


def keyhole(folder):
    """Two rooms; all light of the second comes through a hole of 2 cm x 4 cm in a wall of 10 cm.

    Bake --bounds -4.05,0,-2,4.05,3,2.
    """
    scene = Scene("keyhole")
    scene.material("plaster", PLASTER)
    scene.material("floor", FLOOR)
    scene.material("lamp", (0.5, 0.5, 0.5), emission=(60, 55, 50))
    rooms = [((-4.05, 0, -2), (-0.05, 3, 2)), ((0.05, 0, -2), (4.05, 3, 2))]
    hole = ((-0.05, 1.0, -0.01), (0.05, 1.04, 0.01))
    planes = ([-4.25, -4.05, -0.05, 0.05, 4.05, 4.25], [-0.2, 0, 1.0, 1.04, 3, 3.2],
              [-2.2, -2, -0.01, 0.01, 2, 2.2])
    cells(scene, "rooms", planes,
          lambda *p: not any(inside(*part, *p) for part in (*rooms, hole)),
          lambda p, axis, sign: "floor" if axis == 1 and sign > 0 and p[1] == 0 else "plaster")
    box(scene, "lamp", "lamp", (-2.5, 2.5, -0.3), (-1.9, 2.55, 0.3))
    scene.write(folder)


def blinds(folder):
    """Sun through 60 slats of zero thickness, 2.5 cm apart: stripes finer than any sample.

    Bake --bounds -2,0,-2,2,3,2.
    """
    scene = Scene("blinds")
    scene.material("plaster", PLASTER)
    scene.material("floor", FLOOR)
    scene.material("slat", (0.75, 0.75, 0.72), double_sided=True)
    planes = ([-2.2, -2, 2, 2.2], [-0.2, 0, 1, 2.5, 3, 3.2], [-2.2, -2, -1.2, 1.2, 2, 2.2])
    hollow, window = ((-2, 0, -2), (2, 3, 2)), ((2, 1, -1.2), (2.2, 2.5, 1.2))
    cells(scene, "room", planes,
          lambda *p: not (inside(*hollow, *p) or inside(*window, *p)),
          lambda p, axis, sign: "floor" if axis == 1 and sign > 0 and p[1] == 0 else "plaster")
    for i in range(60):
        quad(scene, "blinds", "slat", (2.09, 1.0 + i * 0.025, -1.2), (0.02, 0.012, 0), (0, 0, 2.4))
    scene.add_sun("sun", (-0.8, -0.55, -0.25), (1, 0.95, 0.85), 100)
    scene.write(folder)


def double_walls(folder):
    """A lit room between two dark ones: a wall of two sheets 0.1 mm apart, and one of one sheet.

    Light of the dark rooms is 0. Bake --bounds -6,0,-2,6,3,2.
    """
    scene = Scene("double_walls")
    scene.material("plaster", PLASTER)
    scene.material("sheet", PLASTER, double_sided=True)
    scene.material("lamp", (0.5, 0.5, 0.5), emission=(20, 20, 20))
    gap = 1e-4
    room(scene, "plaster", (-2, 0, -2), (2, 3, 2), 0.3, without="+x")
    room(scene, "plaster", (-6, 0, -2), (-2 - gap, 3, 2))
    room(scene, "plaster", (2, 0, -2), (6, 3, 2), without="-x")
    quad(scene, "sheet", "sheet", (2, 0, -2), (0, 3, 0), (0, 0, 4))
    scene.write(folder)


def wide(folder):
    """Ground 100 km wide and a room of 4 m, 36 km from the middle, lit by the sun through a window.

    Bake --bounds 29998,0,19998,30002,3,20002.
    """
    scene = Scene("wide")
    scene.material("plaster", PLASTER)
    scene.material("floor", FLOOR)
    scene.material("ground", (0.3, 0.33, 0.2))
    half, x, z = 5e4, 3e4, 2e4
    quad(scene, "ground", "ground", (-half, -0.25, -half), (0, 0, 2 * half), (2 * half, 0, 0))
    planes = ([x - 2.25, x - 2, x + 2, x + 2.25], [-0.25, 0, 1, 2.5, 3, 3.25],
              [z - 2.25, z - 2, z - 1, z + 1, z + 2, z + 2.25])
    hollow = ((x - 2, 0, z - 2), (x + 2, 3, z + 2))
    window = ((x + 2, 1, z - 1), (x + 2.25, 2.5, z + 1))
    cells(scene, "room", planes,
          lambda *p: not (inside(*hollow, *p) or inside(*window, *p)),
          lambda p, axis, sign: "floor" if axis == 1 and sign > 0 and p[1] == 0 else "plaster")
    scene.add_sun("sun", (-0.7, -0.6, -0.3), (1, 0.95, 0.85), 100)
    scene.write(folder)


# ---------------------------------------------------------------------------- 10^7 triangles


def bumpy_sphere(rows, columns):
    """Positions (flat list) and indices of a sphere of radius 1 with bumps; closed, no poles."""
    positions, indices = array("f"), array("I")
    for i in range(rows + 1):
        theta = math.pi * i / rows
        for j in range(columns):
            phi = 2 * math.pi * j / columns
            r = 1 + 0.08 * math.sin(9 * phi) * math.sin(7 * theta) * math.sin(theta)
            r += 0.02 * math.sin(61 * phi) * math.sin(53 * theta) * math.sin(theta)
            positions.extend((r * math.sin(theta) * math.sin(phi), r * math.cos(theta),
                              r * math.sin(theta) * math.cos(phi)))
    for i in range(rows):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            if i > 0:
                indices.extend((a, b + columns, b))
            if i < rows - 1:
                indices.extend((a, a + columns, b + columns))
    return positions, indices


def crowns():
    """Where the 100 spheres of the forest are: translation, quaternion about a slanted axis, scale."""
    rng = random.Random(1)
    for i in range(100):
        angle, tilt = rng.uniform(0, math.pi), rng.uniform(-0.3, 0.3)
        s, n = math.sin(angle), math.sqrt(1 + tilt * tilt)
        rotation = (tilt * s / n, s / n, 0, math.cos(angle))
        place = (2 * (i % 10) - 9 + rng.uniform(-0.3, 0.3), rng.uniform(1, 3),
                 2 * (i // 10) - 9 + rng.uniform(-0.3, 0.3))
        yield place, rotation, (rng.uniform(0.5, 0.9), rng.uniform(0.5, 1.2), rng.uniform(0.5, 0.9))


def moved(positions, place, rotation, scale):
    """All positions by glTF's translation x rotation x scale."""
    x, y, z, w = rotation
    rows = ((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))
    result = array("f", bytes(4 * len(positions)))
    for axis in range(3):
        a, b, c = (rows[axis][k] * scale[k] for k in range(3))
        t = place[axis]
        result[axis::3] = array("f", [a * px + b * py + c * pz + t for px, py, pz in zip(
            positions[0::3], positions[1::3], positions[2::3])])
    return result


def forest(folder, name, instanced):
    """100 bumpy spheres of 100,000 triangles in a room of 20 m; see the two functions below."""
    scene = Scene(name)
    scene.material("plaster", PLASTER)
    scene.material("lamp", (0.5, 0.5, 0.5), emission=(15, 15, 14))
    scene.material("leaves", (0.2, 0.45, 0.12))
    room(scene, "plaster", (-10, 0, -10), (10, 6, 10), 2)
    gltf, blob = scene._document()
    blob = bytearray(blob)

    def accessor(values, kind, component):
        size = {"SCALAR": 1, "VEC3": 3}[kind]
        entry = {"bufferView": len(gltf["bufferViews"]), "componentType": component,
                 "count": len(values) // size, "type": kind}
        if size > 1:
            entry["min"] = [min(values[k::3]) for k in range(3)]
            entry["max"] = [max(values[k::3]) for k in range(3)]
        gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(blob),
                                    "byteLength": 4 * len(values)})
        blob.extend(values.tobytes())
        gltf["accessors"].append(entry)
        return len(gltf["accessors"]) - 1

    def mesh(positions):
        gltf["meshes"].append({"name": "crown", "primitives": [{
            "attributes": {"POSITION": accessor(positions, "VEC3", FLOAT)}, "indices": triangles,
            "material": 2}]})
        return len(gltf["meshes"]) - 1

    sphere, indices = bumpy_sphere(201, 250)
    triangles = accessor(indices, "SCALAR", UINT32)
    one = mesh(sphere) if instanced else None
    for place, rotation, scale in crowns():
        gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]))
        gltf["nodes"].append(
            {"mesh": one, "translation": place, "rotation": rotation, "scale": scale} if instanced
            else {"mesh": mesh(moved(sphere, place, rotation, scale))})
    gltf["buffers"][0]["byteLength"] = len(blob)
    text = json.dumps(gltf, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with open(folder / f"{name}.glb", "wb") as file:
        file.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(blob)))
        file.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", len(blob), 0x004E4942) + blob)


def forest_instanced(folder):
    """10^7 triangles of which 10^5 are in the file. Bake --bounds -10,0,-10,10,6,10."""
    forest(folder, "forest_instanced", True)


def forest_flat(folder):
    """The same 10^7 triangles, all in the file (60 MB). Bake --bounds -10,0,-10,10,6,10."""
    forest(folder, "forest_flat", False)


SCENES = (white_room, keyhole, blinds, double_walls, wide, forest_instanced, forest_flat)


def main(folder, *names):
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    known = {make.__name__: make for make in SCENES}
    for name in names or known:
        if name not in known:
            sys.exit(f"There is no scene '{name}'; choose from {', '.join(known)}.")
        known[name](folder)


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(*sys.argv[1:])
