# SPDX-License-Identifier: Apache-2.0
"""The sample scenes: made anew they are the same bytes, and each is valid glTF that says what its
README says. A small reader of its own, so that the library's importer is not its own judge."""
import collections
import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest

SAMPLES = pathlib.Path(__file__).resolve().parents[2] / "samples"
SCENES = ("cornell_box", "house", "two_rooms", "two_rooms_door", "furnace", "courtyard")
SIZES = {5123: 2, 5125: 4, 5126: 4}


def read_glb(path):
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<III", data)
    assert (magic, version, length) == (0x46546C67, 2, len(data)), path
    json_length, kind = struct.unpack_from("<II", data, 12)
    assert kind == 0x4E4F534A and json_length % 4 == 0
    bin_length, kind = struct.unpack_from("<II", data, 20 + json_length)
    assert kind == 0x004E4942 and 28 + json_length + bin_length == len(data)
    gltf = json.loads(data[20:20 + json_length])
    assert gltf["buffers"] == [{"byteLength": bin_length}]
    return gltf, data[28 + json_length:]


def values(gltf, blob, index):
    accessor = gltf["accessors"][index]
    view = gltf["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    size = SIZES[accessor["componentType"]]
    assert accessor["count"] * width * size == view["byteLength"]
    assert view["byteOffset"] % size == 0 and view["byteOffset"] + view["byteLength"] <= len(blob)
    form = {5123: "H", 5125: "I", 5126: "f"}[accessor["componentType"]]
    flat = struct.unpack_from(f"<{accessor['count'] * width}{form}", blob, view["byteOffset"])
    return [flat[i:i + width] for i in range(0, len(flat), width)] if width > 1 else list(flat)


def triangles(gltf, blob, mesh_name=None):
    """(material name, three points) of all triangles; the samples' mesh nodes do not move."""
    for mesh in gltf["meshes"]:
        if mesh_name not in (None, mesh["name"]):
            continue
        for primitive in mesh["primitives"]:
            points = values(gltf, blob, primitive["attributes"]["POSITION"])
            ids = values(gltf, blob, primitive["indices"])
            name = gltf["materials"][primitive["material"]]["name"]
            for i in range(0, len(ids), 3):
                yield name, [points[k] for k in ids[i:i + 3]]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def area_vector(p):
    u, v = ([b - a for a, b in zip(p[0], p[k])] for k in (1, 2))
    return [c / 2 for c in cross(u, v)]


def signed_volume(tris):
    """Positive when all triangles face outwards (divergence theorem)."""
    return sum(sum(a * b for a, b in zip(p[0], cross(p[1], p[2]))) for _, p in tris) / 6


def open_edges(tris):
    """Directed edges without their opposite: none on a closed, consistently oriented surface."""
    count = collections.Counter()
    for _, p in tris:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            count[p[a], p[b]] += 1
            count[p[b], p[a]] -= 1
    return [edge for edge, n in count.items() if n > 0]


def rotate(q, v):
    x, y, z, w = q
    t = [2 * c for c in cross((x, y, z), v)]
    return [vi + w * ti + ci for vi, ti, ci in zip(v, t, cross((x, y, z), t))]


class Samples(unittest.TestCase):
    def setUp(self):
        self.scenes = {name: read_glb(SAMPLES / f"{name}.glb") for name in SCENES}

    def test_generator_gives_the_same_bytes(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, SAMPLES / "make_samples.py", folder], check=True)
            made = {p.name: p.read_bytes() for p in pathlib.Path(folder).iterdir()}
        self.assertEqual(sorted(made), sorted([f"{name}.glb" for name in SCENES] + ["sky.hdr"]))
        for name, data in made.items():
            self.assertEqual(data, (SAMPLES / name).read_bytes(), f"{name} differs; run "
                             "samples/make_samples.py")
            self.assertLess(len(data), 300_000, name)

    def test_structure(self):
        for name, (gltf, blob) in self.scenes.items():
            with self.subTest(name):
                nodes = gltf["scenes"][gltf["scene"]]["nodes"]
                self.assertEqual(nodes, list(range(len(gltf["nodes"]))))
                self.assertEqual([n["camera"] for n in gltf["nodes"] if "camera" in n], [0])
                self.assertEqual(sorted(n["mesh"] for n in gltf["nodes"] if "mesh" in n),
                                 list(range(len(gltf["meshes"]))))
                used = {e for m in gltf["materials"] for e in m.get("extensions", {})}
                used |= set(gltf.get("extensions", {}))
                self.assertEqual(sorted(used), gltf.get("extensionsUsed", []))
                names = [m["name"] for m in gltf["materials"]]
                self.assertEqual(len(set(names)), len(names))
                self.assertEqual({m for m, _ in triangles(gltf, blob)}, set(names))
                for accessor in gltf["accessors"]:
                    if accessor["type"] == "VEC3":
                        points = values(gltf, blob, gltf["accessors"].index(accessor))
                        self.assertEqual(accessor["min"], [min(c) for c in zip(*points)])
                        self.assertEqual(accessor["max"], [max(c) for c in zip(*points)])
                for material in gltf["materials"]:
                    self.assertLessEqual(max(material["pbrMetallicRoughness"]["baseColorFactor"]), 1)
                    self.assertLessEqual(max(material.get("emissiveFactor", [0])), 1)

    def test_no_degenerate_or_double_triangle(self):
        for name, (gltf, blob) in self.scenes.items():
            with self.subTest(name):
                seen = set()
                for _, p in triangles(gltf, blob):
                    self.assertGreater(math.hypot(*area_vector(p)), 1e-7)
                    self.assertNotIn(frozenset(p), seen)
                    seen.add(frozenset(p))
                self.assertGreater(len(seen), 0)

    def test_cornell_box_faces_inwards_and_has_the_published_light(self):
        gltf, blob = self.scenes["cornell_box"]
        centre = (0.278, 0.2744, 0.2796)
        for mesh in ("floor", "ceiling", "lamp", "back_wall", "left_wall", "right_wall"):
            for _, p in triangles(gltf, blob, mesh):
                n = area_vector(p)
                self.assertGreater(sum(a * (c - b) for a, b, c in zip(n, p[0], centre)), 0, mesh)
        # 343-213 by 332-227 mm; the ceiling and the lamp together cover 556 by 559.2 mm.
        lamp = sum(math.hypot(*area_vector(p)) for _, p in triangles(gltf, blob, "lamp"))
        ceiling = sum(math.hypot(*area_vector(p)) for _, p in triangles(gltf, blob, "ceiling"))
        self.assertAlmostEqual(lamp, 0.130 * 0.105, 7)
        self.assertAlmostEqual(lamp + ceiling, 0.556 * 0.5592, 6)
        material = next(m for m in gltf["materials"] if m["name"] == "ceiling_lamp")
        strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
        radiance = [f * strength for f in material["emissiveFactor"]]
        for got, want in zip(radiance, (17, 12, 4)):
            self.assertAlmostEqual(got, want, 6)
        # Areas of the published footprints by the shoelace formula; the blocks begin at 0.5 mm.
        for block, height, area in (("short_block", 0.165, 0.0276330), ("tall_block", 0.330, 0.0276265)):
            tris = list(triangles(gltf, blob, block))
            self.assertEqual(open_edges(tris), [])
            self.assertAlmostEqual(max(p[1] for _, t in tris for p in t), height, 6)
            self.assertAlmostEqual(signed_volume(tris), area * (height - 0.0005), 6)

    def test_house_is_watertight(self):
        gltf, blob = self.scenes["house"]
        tris = list(triangles(gltf, blob))
        self.assertEqual(open_edges(tris), [])
        # Ground 20 x 20 x 0.5; walls 8 x 6 - 7.4 x 5.4 over 2.8 m less door 1 x 2.1 x 0.3 and
        # window 2 x 1.1 x 0.3; roof 8.6 x 6.6 x 0.25; cabinet 1.5 x 0.6 x 1.
        walls = (8 * 6 - 7.4 * 5.4) * 2.8 - 1 * 2.1 * 0.3 - 2 * 1.1 * 0.3
        expected = 20 * 20 * 0.5 + walls + 8.6 * 6.6 * 0.25 + 1.5 * 0.6 * 1.0
        self.assertAlmostEqual(signed_volume(tris), expected, 4)

    def test_rooms_are_closed_and_the_partition_has_no_thickness(self):
        for name, door in (("two_rooms", 0.0), ("two_rooms_door", 0.9 * 2.1)):
            gltf, blob = self.scenes[name]
            shell = [t for t in triangles(gltf, blob) if t[0] != "partition"]
            self.assertEqual(open_edges(shell), [])
            self.assertAlmostEqual(signed_volume(shell), -8 * 4 * 3, 5)  # seen from inside
            partition = [p for m, p in triangles(gltf, blob) if m == "partition"]
            self.assertTrue(all(v[0] == 0 for p in partition for v in p))
            self.assertAlmostEqual(sum(math.hypot(*area_vector(p)) for p in partition),
                                   4 * 3 - door, 5)
            self.assertTrue(next(m for m in gltf["materials"] if m["name"] == "partition")
                            ["doubleSided"])

    def test_furnace(self):
        gltf, blob = self.scenes["furnace"]
        tris = list(triangles(gltf, blob))
        self.assertEqual(open_edges(tris), [])
        self.assertAlmostEqual(signed_volume(tris), -8)
        self.assertNotIn("doubleSided", gltf["materials"][0])

    def test_courtyard_size_and_closed_parts(self):
        gltf, blob = self.scenes["courtyard"]
        tris = list(triangles(gltf, blob))
        self.assertTrue(2000 < len(tris) < 12000, len(tris))
        for axis, (low, high) in enumerate(((-30, 30), (-0.5, 20), (-30, 30))):
            coordinates = [p[axis] for _, t in tris for p in t]
            self.assertAlmostEqual(min(coordinates), low, 5)
            self.assertAlmostEqual(max(coordinates), high, 5)
        for part in ("masonry", "columns"):
            self.assertEqual(open_edges(triangles(gltf, blob, part)), [], part)
            self.assertGreater(signed_volume(list(triangles(gltf, blob, part))), 0, part)

    def test_the_arcades_are_open_only_where_they_stand_and_end(self):
        gltf, blob = self.scenes["courtyard"]
        tris = list(triangles(gltf, blob, "arcades"))
        for a, b in open_edges(tris):  # feet on the ground, heads under the gallery floor
            self.assertTrue(a[1] == b[1] and (a[1] == 0 or abs(a[1] - 6) < 1e-6), (a, b))

    def test_sun_and_sky(self):
        direction = [c / math.hypot(0.35, 0.8, 0.5) for c in (-0.35, -0.8, -0.5)]
        for name in ("house", "courtyard"):
            gltf, _ = self.scenes[name]
            node = next(n for n in gltf["nodes"] if n["name"] == "sun")
            for got, want in zip(rotate(node["rotation"], (0, 0, -1)), direction):
                self.assertAlmostEqual(got, want, 6)
        data = (SAMPLES / "sky.hdr").read_bytes()
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 128\n"
        self.assertTrue(data.startswith(header))
        pixels = data[len(header):]
        self.assertEqual(len(pixels), 128 * 64 * 4)
        brightest = max(range(128 * 64), key=lambda i: math.ldexp(
            sum(pixels[4 * i:4 * i + 3]), pixels[4 * i + 3]))
        j, i = divmod(brightest, 128)  # the pixel towards the sun, or paler at the horizon there
        azimuth = 2 * math.pi * ((i + 0.5) / 128 - 0.5)
        self.assertAlmostEqual(azimuth, math.atan2(0.5, 0.35), delta=0.06)
        for k in range(0, len(pixels), 4):
            self.assertTrue(max(pixels[k:k + 3]) >= 128, "not normalised")


if __name__ == "__main__":
    unittest.main()
