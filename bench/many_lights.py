#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Scenes of very many lights, and what a probe among them costs and errs.

    bench/many_lights.py make KIND N OUT.glb
    bench/many_lights.py measure OUT PROGRAM [PROGRAM ...] [--rays N] [--points N] [--repeat N]
                         [--scenes KIND:N,...] [--sky FILE]

KIND is `triangles` (N emissive triangles: small lamps on the ceiling, the walls and between the
pillars), `points` (N point lights) or `spots` (N spot lights, all directions), in one hall with
pillars. Brightness spans three decades, so that power alone says little about what arrives where.

`measure` probes each scene at the same random points by every program, interleaved, and compares
with a reference of 64 times the rays by the last program. It prints a Markdown table: processor
seconds of tracing (the fastest of --repeat, a run of one point taken off) and of that run, standard error as reported and RMS error as found, both relative to the mean
irradiance, and 1/(error² · seconds), the efficiency, over the first program's.
"""

import argparse
import json
import math
import pathlib
import random
import resource
import struct
import subprocess

WIDTH, HEIGHT, DEPTH = 40.0, 8.0, 40.0


class Mesh:
    """Triangles of one material."""

    def __init__(self):
        self.positions, self.indices = [], []

    def quad(self, a, u, v):
        base = len(self.positions)
        for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)):
            self.positions.append([a[i] + s * u[i] + t * v[i] for i in range(3)])
        self.indices += [base, base + 1, base + 2, base, base + 2, base + 3]

    def triangle(self, a, b, c):
        base = len(self.positions)
        self.positions += [a, b, c]
        self.indices += [base, base + 1, base + 2]

    def box(self, lower, upper, inward):
        size = [upper[i] - lower[i] for i in range(3)]
        x, y, z = [size[0], 0, 0], [0, size[1], 0], [0, 0, size[2]]
        back = [[-c for c in e] for e in (x, y, z)]
        for u, v in ((z, x), (x, y), (y, z)):
            self.quad(lower, *((u, v) if inward else (v, u)))
        for u, v in ((back[0], back[2]), (back[1], back[0]), (back[2], back[1])):
            self.quad(upper, *((u, v) if inward else (v, u)))


def hall():
    mesh = Mesh()
    mesh.box([0, 0, 0], [WIDTH, HEIGHT, DEPTH], inward=True)
    for i in range(4):
        for k in range(4):
            x, z = 6 + 8 * i, 6 + 8 * k
            mesh.box([x, 0, z], [x + 1.5, HEIGHT, z + 1.5], inward=False)
    return mesh


def inside_pillar(p):
    return any(6 + 8 * i - 0.2 < p[0] < 7.7 + 8 * i and 6 + 8 * k - 0.2 < p[2] < 7.7 + 8 * k
               for i in range(4) for k in range(4))


def free_point(rng, margin=0.3):
    while True:
        p = [rng.uniform(margin, s - margin) for s in (WIDTH, HEIGHT, DEPTH)]
        if not inside_pillar(p):
            return p


def unit(rng):
    z, phi = rng.uniform(-1, 1), rng.uniform(0, 2 * math.pi)
    r = math.sqrt(1 - z * z)
    return [r * math.cos(phi), r * math.sin(phi), z]


def brightness(rng):
    return 10 ** rng.uniform(-3, 0)


def emissive(rng, count):
    """Triangles of a few centimetres in clusters, in eight materials over three decades."""
    meshes = [Mesh() for _ in range(8)]
    size = 2 / math.sqrt(count)
    for i in range(count):
        if i % 50 == 0:
            middle, level = free_point(rng), rng.randrange(8)
        p = [middle[a] + rng.gauss(0, 0.15) for a in range(3)]
        u, v = unit(rng), unit(rng)
        meshes[level].triangle(p, [p[a] + size * u[a] for a in range(3)],
                               [p[a] + size * v[a] for a in range(3)])
    # Radiance such that all together give about the same irradiance for any number.
    area = count * size * size / 2 * 0.64
    levels = [10 ** (-3 + 3 * (i + 0.5) / 8) * 800 / area for i in range(8)]
    return [(m, e) for m, e in zip(meshes, levels) if m.positions]


def punctual(rng, count, kind):
    lights, nodes = [], []
    for i in range(count):
        light = {"type": kind, "color": [rng.uniform(0.5, 1) for _ in range(3)],
                 "intensity": brightness(rng) * 2000 / count}
        if kind == "spot":
            light["spot"] = {"innerConeAngle": 0.3, "outerConeAngle": 0.6}
        lights.append(light)
        half, axis = rng.uniform(0, math.pi / 2), unit(rng)
        nodes.append({"translation": free_point(rng),
                      "rotation": [a * math.sin(half) for a in axis] + [math.cos(half)],
                      "extensions": {"KHR_lights_punctual": {"light": i}}})
    return lights, nodes


def write_glb(path, meshes, lights, nodes):
    """meshes: (Mesh, emitted radiance) each."""
    doc = {"asset": {"version": "2.0"}, "scene": 0, "buffers": [], "bufferViews": [],
           "accessors": [], "materials": [], "meshes": [], "nodes": list(nodes)}
    blob = bytearray()

    def accessor(data, component, kind, count, **more):
        doc["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob.extend(data)
        doc["accessors"].append({"bufferView": len(doc["bufferViews"]) - 1, "type": kind,
                                 "componentType": component, "count": count, **more})
        return len(doc["accessors"]) - 1

    for mesh, radiance in meshes:
        flat = [c for p in mesh.positions for c in p]
        material = {"pbrMetallicRoughness": {"baseColorFactor": [0.6, 0.6, 0.6, 1],
                                             "metallicFactor": 0}}
        if radiance > 0:
            material["pbrMetallicRoughness"]["baseColorFactor"] = [0, 0, 0, 1]
            material["emissiveFactor"] = [1, 0.9, 0.8]
            material["extensions"] = {
                "KHR_materials_emissive_strength": {"emissiveStrength": radiance}}
        doc["materials"].append(material)
        positions = accessor(struct.pack("<%df" % len(flat), *flat), 5126, "VEC3",
                             len(mesh.positions),
                             min=[min(flat[a::3]) for a in range(3)],
                             max=[max(flat[a::3]) for a in range(3)])
        indices = accessor(struct.pack("<%dI" % len(mesh.indices), *mesh.indices), 5125, "SCALAR",
                           len(mesh.indices))
        doc["meshes"].append({"primitives": [{"attributes": {"POSITION": positions},
                                              "indices": indices,
                                              "material": len(doc["materials"]) - 1}]})
        doc["nodes"].append({"mesh": len(doc["meshes"]) - 1})
    doc["scenes"] = [{"nodes": list(range(len(doc["nodes"])))}]
    doc["buffers"] = [{"byteLength": len(blob)}]
    doc["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    if lights:
        doc["extensionsUsed"].append("KHR_lights_punctual")
        doc["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    text = json.dumps(doc, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    with open(path, "wb") as f:
        f.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(blob)))
        f.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
        f.write(struct.pack("<II", len(blob), 0x004E4942) + blob)


def make(kind, count, path):
    rng = random.Random(7)
    meshes, lights, nodes = [(hall(), 0)], [], []
    if kind == "triangles":
        meshes += emissive(rng, count)
    else:
        lights, nodes = punctual(rng, count, kind.rstrip("s"))
    write_glb(path, meshes, lights, nodes)


def probe(program, scene, points, rays, seed, more):
    """Processor seconds, reported standard error, coefficients."""
    text = "".join("%.9g,%.9g,%.9g\n" % tuple(p) for p in points)
    start = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = subprocess.run([program, "probe", str(scene), "--points", "-", "--rays", str(rays),
                          "--seed", str(seed), "--quiet", *more],
                         input=text, capture_output=True, text=True, check=True).stdout
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime
    rows = [[float(c) for c in line.split(",")] for line in out.splitlines()[1:]]
    return seconds, [r[5] for r in rows], [r[6:] for r in rows]


def rms(values):
    values = list(values)
    return math.sqrt(sum(v * v for v in values) / len(values))


# Per band, A_l² of the clamped cosine: RMS over normals of a difference in irradiance.
COSINE2 = [math.pi ** 2, (2 * math.pi / 3) ** 2, (math.pi / 4) ** 2]


def distance2(a, b):
    return sum(COSINE2[math.isqrt(k // 3)] * (x - y) ** 2
               for k, (x, y) in enumerate(zip(a, b))) / (3 * 4 * math.pi)


def measure(args):
    out = pathlib.Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    more = ["--env", args.sky] if args.sky else []
    rng = random.Random(99)
    points = [free_point(rng) for _ in range(args.points)]
    print("| scene | program | seconds | load | stderr | error | efficiency |\n"
          "|---|---|---|---|---|---|---|")
    for name in args.scenes.split(","):
        scene = pathlib.Path(name)
        if not scene.exists():
            kind, count = name.split(":")
            scene = out / f"{kind}_{count}.glb"
            make(kind, int(count), scene)
        _, _, reference = probe(args.program[-1], scene, points, 64 * args.rays, 1000, more)
        mean = sum(math.pi * r[0] * 0.28209479 for r in reference) / len(reference)
        runs = {p: [] for p in args.program}
        load = {p: min(probe(p, scene, points[:1], 2, 1, more)[0] for _ in range(args.repeat))
                for p in args.program}
        for seed in range(1, args.repeat + 1):
            for p in args.program:
                runs[p].append(probe(p, scene, points, args.rays, seed, more))
        base = None
        for p, results in runs.items():
            seconds = min(r[0] for r in results) - load[p]
            stderr = rms(s for r in results for s in r[1]) / mean
            error = math.sqrt(sum(distance2(v, reference[i]) for r in results
                                  for i, v in enumerate(r[2])) / len(points) / len(results)) / mean
            efficiency = 1 / (error * error * seconds)
            base = base or efficiency
            print(f"| {name} | {p} | {seconds:.2f} | {load[p]:.2f} | {stderr:.4f} | {error:.4f} "
                  f"| {efficiency / base:.2f} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    m = commands.add_parser("make")
    m.add_argument("kind", choices=["triangles", "points", "spots"])
    m.add_argument("count", type=int)
    m.add_argument("out")
    m = commands.add_parser("measure")
    m.add_argument("out")
    m.add_argument("program", nargs="+")
    m.add_argument("--rays", type=int, default=1024)
    m.add_argument("--points", type=int, default=32)
    m.add_argument("--repeat", type=int, default=3)
    m.add_argument("--scenes", default="triangles:100000,points:1000")
    m.add_argument("--sky")
    args = parser.parse_args()
    if args.command == "make":
        make(args.kind, args.count, args.out)
    else:
        measure(args)


if __name__ == "__main__":
    main()
