# SPDX-License-Identifier: Apache-2.0
"""Hard but legal scenes through the command line, against derived answers, and the numbers.

    LUMIVDB_PROGRAM=build/release/lumivdb python3 tests/cli/test_hard_cases.py           the tests
    … python3 tests/cli/test_hard_cases.py --table             a Markdown table of what was measured
    … python3 tests/cli/test_hard_cases.py --table --large     with 1e6 and 1e7 triangles

In a closed room whose walls all emit Le and reflect the share rho, the radiance is
L = Le + rho L = Le / (1 - rho) everywhere: the furnace. sh_0 is L sqrt(4 pi).
"""
import csv
import io
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import unittest

import scene_files as sf
from harness import PROGRAM, SAMPLES, run

Y00 = math.sqrt(4 * math.pi)
NAN, INF = float("nan"), float("inf")


class Lab:
    """Runs the program in a folder of its own; every helper checks the exit code."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)

    def write(self, name, content):
        (self.folder / name).write_bytes(content)
        return name

    def ok(self, *args, stdin=""):
        code, out, err = run(*args, stdin=stdin, cwd=self.folder)
        if code:
            raise AssertionError(f"lumivdb {' '.join(map(str, args))}: {code}\n{err}")
        self.err = err
        return out

    def rows(self, text):
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(io.StringIO(text))]

    def probe(self, scene, points, *options, rays=256):
        """Rows with 'L', the mean radiance, besides the program's columns."""
        stdin = "\n".join(",".join(map(repr, p)) for p in points)
        rows = self.rows(self.ok("probe", scene, "--points", "-", "--bands", "1", "--rays", rays,
                                 *options, stdin=stdin))
        for row in rows:
            row["L"] = row["sh_0_r"] / Y00
            row["stderr_L"] = row["stderr"] / math.pi
        return rows

    def bake(self, scene, name, *options):
        rays = () if "--rays" in options else ("--rays", "64")
        return json.loads(self.ok("bake", scene, "-o", name, "--json", "-", *rays, *options))

    def query(self, volume, points, *options):
        stdin = "\n".join(",".join(map(repr, p)) for p in points)
        return self.rows(self.ok("query", volume, "--points", "-", *options, stdin=stdin))

    def stats(self, volume):
        return json.loads(self.ok("stats", volume, "--json", "-"))


def need(condition, *what):
    if not condition:
        raise AssertionError(" ".join(map(str, what)))


def near(value, wanted, tolerance, what):
    need(abs(value - wanted) <= tolerance, f"{what}: {value} instead of {wanted} ± {tolerance}")


# ---- The cases: each returns the sentence of the table.

def furnace(lab):
    """Closed furnace, rho → 1"""
    said = []
    for rho, rays in ((0.0, 64), (0.5, 512), (0.9, 512), (0.99, 512), (0.999, 256)):
        scene = lab.write("furnace.gltf", sf.scene(albedo=rho))
        row = lab.probe(scene, [(0.1, 0.2, 0.3)], rays=rays)[0]
        wanted = 1 / (1 - rho)
        near(row["L"], wanted, 5 * row["stderr_L"] + 1e-5 * wanted, f"rho {rho}")
        need(row["stderr_L"] < 0.1 * wanted, row)
        said.append(f"{rho:g}: {row['L']:.5g} ± {row['stderr_L']:.2g}")
    scene = lab.write("white.gltf", sf.scene(albedo=1.0))
    start = time.time()
    row = lab.probe(scene, [(0.1, 0.2, 0.3)], rays=16)[0]
    need(math.isfinite(row["L"]) and row["L"] > 100, row)
    return ("L ± standard error for Le = 1 and rho = " + "; ".join(said)
            + f" (exact: 1/(1 − rho)). rho = 1 has no finite answer: it ends after "
            f"{time.time() - start:.1f} s with L = {row['L']:.4g} at 16 rays")


def thin_wall(lab):
    """Wall of no thickness"""
    scene = SAMPLES / "two_rooms.glb"
    lit, dark = lab.probe(scene, [(-1e-4, 1.5, 0.1), (1e-4, 1.5, 0.1)])
    need(lit["L"] > 0.05 and dark["L"] == 0, lit, dark)
    # The samples on the wall (x = 0, the lit room before it) see one side of it, so that without
    # masks the last cell on the other side is wrong by up to all of its light.
    said, places = [], (-0.75, -0.25, -0.01, 0.01, 0.25, 0.75)
    box = ("--bounds", "-1,0.5,-1,1,2.5,1")
    for name, options in (("masks", box), ("masks and coarser cells", ("--levels", "2")),
                          ("--visibility off", (*box, "--visibility", "off"))):
        lab.bake(scene, "rooms.vdb", "--spacing", "0.5", *options)
        light = [row["Er"] for row in
                 lab.query("rooms.vdb", [(x, 1.25, 0.25, -1, 0, 0) for x in places])]
        if "off" not in name:
            need(light[3:] == [0, 0, 0] and min(light[:3]) > 0.9 * max(light[:3]), name, light)
        need(light[5] == 0 and light[0] > 0.3, name, light)
        said.append(f"{name}: " + ", ".join(f"{e:.3g}" for e in light))
    return (f"0.1 mm in front of the wall L = {lit['L']:.3g}, 0.1 mm behind it exactly 0. Volumes of "
            f"spacing 0.5, E towards the lit room at x = {', '.join(f'{x:g}' for x in places)} (the "
            f"wall is at 0): " + "; ".join(said))


def bad_triangles(lab):
    """Coplanar, degenerate and duplicated triangles; duplicated vertices"""
    points = [(0.1, 0.2, 0.3), (-0.9, 0.9, 0.9)]
    room = {"emission": 0.0, "lights": [{"type": "point", "intensity": 1.0}]}

    def lit(name, **options):
        return lab.probe(lab.write(name, sf.scene(**{**room, **options})), points, rays=1024)
    plain = lit("plain.gltf")
    need(plain[0]["L"] > 0, plain)
    odd = lit("odd.gltf", triangles=sf.CUBE_TRIANGLES + [(0, 0, 1), (2, 2, 2), (0, 1, 1)])
    need("3 degenerate triangles" in lab.err, lab.err)
    # A third corner on the edge between the two others: area 0 although the corners differ.
    line = lit("line.gltf", positions=sf.CUBE_POSITIONS + [(-1, -1, 0)],
               triangles=sf.CUBE_TRIANGLES + [(0, 8, 1)])
    need("1 degenerate triangle" in lab.err, lab.err)
    need(plain == odd == line, plain, odd, line)
    corners = [sf.CUBE_POSITIONS[i] for t in sf.CUBE_TRIANGLES for i in t]
    apart = lit("apart.gltf", positions=corners,
                triangles=[(i, i + 1, i + 2) for i in range(0, 36, 3)])
    need(apart == plain, apart, plain)
    # One quad of the wall lies twice in the same plane, once along its other diagonal.
    twice = lit("twice.gltf", triangles=sf.CUBE_TRIANGLES * 2)
    other = lit("other.gltf", triangles=sf.CUBE_TRIANGLES + [(0, 3, 1), (0, 2, 3)])
    for rows in (twice, other):
        for a, b in zip(plain, rows):
            need(abs(a["L"] - b["L"]) < 4 * math.hypot(a["stderr_L"], b["stderr_L"]), a, b)
    return (f"Triangles without area are dropped with a warning that counts them, and the light is "
            f"the same to the bit, as it is with 36 vertices in place of 8; walls that lie twice or "
            f"crosswise in one plane: L = {twice[0]['L']:.4g} and {other[0]['L']:.4g}, "
            f"{plain[0]['L']:.4g} ± {plain[0]['stderr_L']:.2g} without")


def on_surface(lab):
    """Probe exactly on a surface, an edge, a vertex"""
    scene = lab.write("room.gltf", sf.scene())
    points = [(1, 0.1, 0.2), (1, 1, 0.3), (1, 1, 1), (1, 0, 0), (0, 0, 0)]
    rows = lab.probe(scene, points, rays=512)
    for row in rows:
        near(row["L"], 2, 5 * row["stderr_L"], row)
    lab.bake(scene, "room.vdb", "--spacing", "0.5", "--bounds", "-1,-1,-1,1,1,1", "--rays", "1024")
    lit = lab.query("room.vdb", [p + (-1, 0, 0) for p in points])
    for row in lit:
        near(row["Er"], 2 * math.pi, 0.08 * 2 * math.pi, row)
    return ("probe: L = " + ", ".join(f"{row['L']:.3g}" for row in rows[:3])
            + " on a face, an edge, a corner of the furnace (exact: 2): a point on a surface is moved "
            "off it by four times the surface's rounding (4e-6 of its largest coordinate), to its inner "
            "side. bake: by a thousandth of the spacing; E = "
            + ", ".join(f"{row['Er']:.4g}" for row in lit[:3]) + " there (exact: 6.283)")


def far(lab):
    """Scene 1e6 from the origin"""
    scene = lab.write("far.gltf", sf.scene(node={"translation": [1e6, -1e6, 1e6]}))
    row = lab.probe(scene, [(1e6 + 0.1, -1e6 + 0.2, 1e6 + 0.3)])[0]
    near(row["L"], 2, 5 * row["stderr_L"], "L")
    report = lab.bake(scene, "far.vdb", "--spacing", "0.5",
                      "--bounds", "999999.5,-1000000.5,999999.5,1000000.5,-999999.5,1000000.5",
                      "--rays", "1024")
    lit = lab.query("far.vdb", [(1e6, -1e6, 1e6, 0, 1, 0)])[0]
    near(lit["Er"], 2 * math.pi, 0.1 * 2 * math.pi, "E")
    return (f"L = {row['L']:.4g} ± {row['stderr_L']:.2g} in the furnace (exact: 2); a volume of "
            f"{report['samples']} samples there: E = {lit['Er']:.4g} (exact: 6.283)")


# With so many rays all points have the same directions: what differs is positions alone.
SAME_DIRECTIONS = 65536


def sizes(lab):
    """Scenes of 1e-4 and 1e5 metres"""
    said = []
    unit = lab.probe(lab.write("unit.gltf", sf.scene()), [(0.1, 0.2, 0.3)],
                     rays=SAME_DIRECTIONS)[0]
    for scale in (5e-5, 5e4):
        scene = lab.write("sized.gltf", sf.scene(node={"scale": [scale] * 3}))
        row = lab.probe(scene, [(0.1 * scale, 0.2 * scale, 0.3 * scale)],
                        rays=SAME_DIRECTIONS)[0]
        near(row["L"], 2, 5 * row["stderr_L"], "L")
        near(row["distance"] / scale, unit["distance"], 1e-4, "distance")
        report = lab.bake(scene, "sized.vdb")
        lit = lab.query("sized.vdb", [(0, 0, 0, 0, 1, 0)])[0]
        near(lit["Er"], 2 * math.pi, 0.1 * 2 * math.pi, "E")
        said.append(f"{2 * scale:g} m: L = {row['L']:.5g} by probe (exact: 2), E = {lit['Er']:.4g} "
                    f"in a volume (exact: 6.283) with a spacing of {report['spacing']:g} of its own")
    return "; ".join(said)


def wide(lab):
    """A room of 2 m in a scene of 1e5 m"""
    unit = lab.probe(lab.write("unit.gltf", sf.scene()), [(0.5, 0.2, -0.3)],
                     rays=SAME_DIRECTIONS)[0]
    document = sf.gltf(node={"translation": [3e4, 0, 2e4]})
    document["nodes"].append({"mesh": 0, "scale": [5e4] * 3})
    document["scenes"] = [{"nodes": [0, 1]}]
    scene = lab.write("wide.gltf", sf.text(document))
    row = lab.probe(scene, [(3e4 + 0.5, 0.2, 2e4 - 0.3)], rays=SAME_DIRECTIONS)[0]
    near(row["L"], 2, 5 * row["stderr_L"], "L")
    near(row["distance"], unit["distance"], 1e-4, "distance")
    return (f"36 km from the middle: L = {row['L']:.4g} ± {row['stderr_L']:.2g} in the furnace "
            f"(exact: 2), mean distance {row['distance']:.5g} m, {unit['distance']:.5g} in the room alone")


def pinhole(lab):
    """Sun of 1e8 through a pinhole"""
    h = 0.01  # half the hole's side
    lid = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    hole = [(-h, -h), (h, -h), (h, h), (-h, h)]
    positions = sf.CUBE_POSITIONS + [(x, 1, z) for x, z in lid + hole]
    walls = [t for t in sf.CUBE_TRIANGLES if any(sf.CUBE_POSITIONS[i][1] < 0 for i in t)]
    ring = []
    for i in range(4):
        a, b, c, d = 8 + i, 8 + (i + 1) % 4, 12 + (i + 1) % 4, 12 + i
        ring += [(a, b, c), (a, c, d)]
    scene = lab.write("pinhole.gltf", sf.scene(positions, walls + ring, emission=0.0))
    sun = ("--sun-direction", "0,1,0", "--sun-lux", "1e8")
    # Direct light alone: nothing beside the beam, in it a delta of E = 1e8: sh_0 = E Y_0.
    beam, beside = lab.probe(scene, [(0, -0.5, 0), (0.5, -0.5, 0)], *sun, "--contribution", "direct")
    near(beam["sh_0_r"] / 1e8, 0.28209479, 1e-6, "beam")
    need(beside["sh_0_r"] == 0, beside)
    # One bounce off the spot of 4h² on the floor, as seen from d above it: the mean radiance is
    # (rho E / pi) × 4h² / d² / (4 pi); d = 0.5 straight above but h beside the beam.
    x, d = 0.1, 0.5
    wanted = 0.5 * 1e8 / math.pi * 4 * h * h * d / (d * d + x * x) ** 1.5 / (4 * math.pi)
    row = lab.probe(scene, [(x, -1 + d, 0)], *sun, "--contribution", "indirect", "--max-bounces",
                    "1", rays=65536)[0]
    near(row["L"], wanted, 5 * row["stderr_L"], "one bounce")
    need(row["stderr_L"] < 0.5 * wanted, row)
    return (f"In the beam sh_0 = {beam['sh_0_r']:.6g} (exact: 2.82095e7), beside it exactly 0 by "
            f"direct light; the lit spot of {2 * h:g} m seen from {d:g} m, one bounce, 65536 rays: "
            f"L = {row['L']:.4g} ± {row['stderr_L']:.2g} (exact: {wanted:.4g}); nothing is clamped")


def broken_sky(lab):
    """Environment with NaN, infinite and negative pixels"""
    lab.write("whole.tif", sf.tiff(16, 8))
    lab.write("odd.tif", sf.tiff(16, 8, odd={0: (NAN, 1, 1), 7: (1, INF, 1), 70: (1, 1, -5),
                                              71: (1, 1, 1e30)}))
    whole = json.loads(lab.ok("project", "whole.tif", "--bands", "1"))["coefficients"][0]
    odd = json.loads(lab.ok("project", "odd.tif", "--bands", "1"))
    near(whole[0], Y00, 1e-6 * Y00, "whole")
    need(all(math.isfinite(v) for v in odd["coefficients"][0]), odd)
    need("3 pixels" in odd["warnings"][0], odd)
    need(odd["coefficients"][0][0] < whole[0] and odd["coefficients"][0][2] > 1e25, odd)
    return (f"Each bad channel counts as 0 and the pixels are counted in a warning; sh_0 of red "
            f"falls from {whole[0]:.5f} to {odd['coefficients'][0][0]:.5f}. A finite 1e30 is kept")


def dark(lab):
    """Black scene, no lights, no geometry"""
    black = lab.write("black.gltf", sf.scene(emission=0.0))
    lab.bake(black, "black.vdb", "--spacing", "0.5", "--bounds", "-0.5,-0.5,-0.5,0.5,0.5,0.5")
    need("Nothing emits light" in lab.err, lab.err)
    need(lab.query("black.vdb", [(0, 0, 0, 0, 1, 0)])[0]["Er"] == 0, "black")
    report = json.loads(lab.ok("evaluate", "black.vdb", "--scene", black, "--points", "4",
                               "--rays", "16", "--json", "-"))
    empty = lab.write("empty.gltf", sf.scene(triangles=[]))
    lab.write("sky.hdr", sf.radiance(8, 4))
    lab.bake(empty, "empty.vdb", "--env", "sky.hdr", "--spacing", "0.5")
    need("no triangles" in lab.err, lab.err)
    lit = lab.query("empty.vdb", [(0, 0, 0, 0, 1, 0)])[0]
    near(lit["Er"], math.pi, 0.02 * math.pi, "E under a sky of 1")
    return (f"A warning; every value exactly 0, validity 1; evaluate gives rel_rmse "
            f"{report['rel_rmse']} where there is no light. Without triangles the box is −1 to 1; "
            f"E = {lit['Er']:.5f} under a sky of 1 (exact: π)")


def one_voxel(lab):
    """One cell, one sample apart"""
    scene = lab.write("room.gltf", sf.scene())
    report = lab.bake(scene, "one.vdb", "--spacing", "0.1", "--bounds", "0,0,0,0.1,0.1,0.1")
    need(report["samples"] == 8, report)
    rows = lab.query("one.vdb", [(0.05, 0.05, 0.05, 0, 1, 0), (0, 0, 0, 0, 1, 0),
                                 (0.1, 0.1, 0.1, 0, 1, 0), (0.11, 0, 0, 0, 1, 0)])
    need([row["level"] for row in rows] == [0, 0, 0, -1], rows)
    stats = lab.stats("one.vdb")
    return (f"8 samples around 1 cell, {stats['file_bytes'] / 1000:.0f} kB; the corners of the box "
            f"belong to it, 0.01 outside gives level −1")


def half(lab):
    """Half precision: overflow and underflow"""
    scene = lab.write("room.gltf", sf.scene())
    lab.bake(scene, "room.vdb", "--spacing", "0.25", "--bounds", "0,0,0,0.5,0.5,0.5", "--bands", "1")
    code, _, err = run("resample", "room.vdb", "--scale", "1e5", "--half", "-o", "big.vdb",
                       cwd=lab.folder)
    need(code == 4 and "65504" in err and not (lab.folder / "big.vdb").exists(), code, err)
    said, errors = [], []
    for scale in ("1", "1e-4", "1e-6", "1e-7", "1e-9"):
        report = json.loads(lab.ok("resample", "room.vdb", "--scale", scale, "--half", "-o",
                                   "half.vdb", "--json", "-"))
        error = report["error"]["rel_rmse"]
        said.append(f"{scale}: {error:.2g}")
        errors.append(error)
    need(errors[0] < 1e-3 and errors[1] < 1e-2 and errors[-1] > 0.99, errors)
    return ("A value above 65504 is refused (exit code 4, the grid and the place are named). Small "
            "values lose digits and at last vanish (below 3e-8), and resample prints that error. "
            "Coefficients of about 7 times " + "; ".join(said) + " (relative error)")


def ringing(lab):
    """SH ringing: negative irradiance"""
    empty = lab.write("empty.gltf", sf.scene(triangles=[]))
    said = []
    for bands in (2, 3, 5, 6):
        lab.bake(empty, "sun.vdb", "--bands", bands, "--spacing", "1", "--sun-direction", "0,1,0",
                 "--sun-lux", "1")
        share = lab.stats("sun.vdb")["negative_irradiance_fraction"]
        rows = lab.query("sun.vdb", [(0, 0, 0, math.sin(a / 50), math.cos(a / 50), 0)
                                     for a in range(158)])
        lowest, up = min(row["Er"] for row in rows), rows[0]["Er"]
        said.append(f"{bands}: {up:.3f}, {lowest:.3f}, {100 * share:.0f}%")
        need(share > 0 if bands > 2 else share >= 0, bands, share)
    return ("One distant light of E = 1, the worst there is; by bands: E towards it (exact: 1), "
            "lowest E (exact: 0), share of negative irradiance in `stats`: " + "; ".join(said)
            + ". Coefficients are stored as they are; clamping E at 0 when evaluating has a smaller "
            "error than any window (tests/core/test_sh_window.cpp)")


def axis_rays(lab):
    """Axis-aligned rays along edges and diagonals"""
    scene = lab.write("closed.gltf", sf.scene(emission=0.0))
    # Below the lid's diagonal, its edges and its corners: the sun must meet the lid every time.
    line = [i / 10 - 1 for i in range(21)]
    points = [(t, y, s * t) for t in line for s in (1, -1) for y in (0.0, 0.5)]
    points += [(1 - 1e-6, 0.0, t) for t in line]
    rows = []
    for direction in ("0,1,0", "1,0,0", "0,0,-1"):
        inside = [p for p in points if max(map(abs, p)) < 1]
        rows += lab.probe(scene, inside, "--sun-direction", direction, "--sun-lux", "1", rays=16)
    need(len(rows) > 200 and all(row["L"] == 0 for row in rows), max(row["L"] for row in rows))
    return (f"Sun along an axis onto a closed box, {len(rows)} points straight below the diagonals "
            f"and next to the edges of its sides: not one ray passes between two triangles (E = 0)")


def triangles(lab, millions):
    quads = round(math.sqrt(millions * 1e6 / 2))
    path = lab.folder / "grid.glb"
    sf.grid_glb(path, quads, emission=0.0)
    words = ["bake", "grid.glb", "-o", "grid.vdb", "--spacing", "0.25", "--rays", "64", "--json", "-",
             "--sun-direction", "0,1,0", "--sun-lux", "1", "--bounds", "-0.5,0.1,-0.5,0.5,0.6,0.5"]
    with open(lab.folder / "out.json", "w+b") as out, open(lab.folder / "err", "wb") as err:
        process = subprocess.Popen([PROGRAM, *words], cwd=lab.folder, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)  # the memory of this one process
        process.returncode = os.waitstatus_to_exitcode(status)
        need(process.returncode == 0, (lab.folder / "err").read_text())
        out.seek(0)
        report = json.load(out)
    peak = usage.ru_maxrss / 1e6
    size = path.stat().st_size / 1e6
    path.unlink()
    need(report["triangles"] == 2 * quads * quads, report["triangles"])
    seconds = report["seconds"]
    return (f"{report['triangles']:,} triangles ({size:.0f} MB): load {seconds['load']:.2g} s, build "
            f"{seconds['build']:.2g} s, {report['rays_per_second'] / 1e6:.2g} million rays/s, "
            f"{peak:.2g} GB of memory at most")


def many_triangles(lab):
    """100,000 triangles"""
    return triangles(lab, 0.1)


def million_triangles(lab):
    """1e6 triangles"""
    return triangles(lab, 1)


def ten_million_triangles(lab):
    """1e7 triangles"""
    return triangles(lab, 10)


CASES = [furnace, thin_wall, bad_triangles, on_surface, far, sizes, wide, pinhole, broken_sky, dark,
         one_voxel, half, ringing, axis_rays, many_triangles]
LARGE = [million_triangles, ten_million_triangles]


class HardCases(unittest.TestCase):
    """A test for each case; they are added below."""


def _test(case):
    def test(self):
        with tempfile.TemporaryDirectory(prefix="lumivdb_hard_") as folder:
            self.assertTrue(case(Lab(folder)))
    return test


for _case in CASES + (LARGE if os.environ.get("LUMIVDB_LARGE") else []):
    setattr(HardCases, "test_" + _case.__name__, _test(_case))


def print_table(cases):
    print("\n## Hard cases\n\nThrough the command line (64 rays a sample and 256 a probe where "
          "nothing else is said).\n\n| case | what happens |\n|---|---|")
    for case in cases:
        with tempfile.TemporaryDirectory(prefix="lumivdb_hard_") as folder:
            print(f"| {case.__doc__} | {case(Lab(folder))}. |", flush=True)
    print("| Names in other scripts, full disk, read-only folder, interrupted and killed runs | see "
          "the sections above. |")


if __name__ == "__main__":
    if "--table" in sys.argv:
        print_table(CASES + (LARGE if "--large" in sys.argv else []))
    else:
        unittest.main()
