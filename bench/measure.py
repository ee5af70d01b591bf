#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures what adaptive volumes are worth, and prints Markdown tables.

    bench/measure.py PROGRAM ASSETS OUT STUDY [SCENE ...] [--seeds N] [--points N] [--rays N]

Studies:
  equal-error   samples, bytes and processor seconds at 10, 5, 2 and 1% of error: uniform lattices
                against adaptive cells, with and without gradients (interpolated between bakes)
  heuristics    samples and error for every reason to split cells, on one lattice
  targets       asked, proven, and found by an independent evaluation; with --seeds, how often
  gradients     error of interpolation at equal bake time: none, central, analytic
  growth        the courtyard 1, 2, 4 and 8 times as large: how samples, bytes, seconds grow
  leaks         Sponza lit from outside: light behind its outer walls, with and without masks

Errors are `lumivdb evaluate`'s rel_rmse at fresh random points, the reference's noise taken off;
seconds are processor time of the whole bake, so that a busy machine changes them little. Each
scene's results are also left in OUT as JSON.
"""

import argparse
import csv
import io
import json
import math
import pathlib
import resource
import struct
import subprocess
import sys

SAMPLES = pathlib.Path(__file__).resolve().parent.parent / "samples"


class Bench:
    def __init__(self, program, assets, out):
        self.program, self.assets = str(pathlib.Path(program).resolve()), pathlib.Path(assets)
        self.out = pathlib.Path(out)
        self.out.mkdir(parents=True, exist_ok=True)

    def scenes(self):
        """name: (scene, light options, bounds, finest uniform spacing worth trying)"""
        a, sky = self.assets, ["--env", str(SAMPLES / "sky.hdr")]
        all_scenes = {
            "furnace": (SAMPLES / "furnace.glb", [], "-1,-1,-1,1,1,1", 1.0),
            "two_rooms": (SAMPLES / "two_rooms.glb", [], None, 1.0),
            "two_rooms_door": (SAMPLES / "two_rooms_door.glb", [], None, 1.0),
            "cornell_box": (SAMPLES / "cornell_box.glb", [], "0,0,0,0.55,0.548,0.559", 0.14),
            "house": (SAMPLES / "house.glb", sky, "-10,0,-10,10,5,10", 2.5),
            "courtyard": (SAMPLES / "courtyard.glb", sky, "-20,0,-20,20,20,20", 5.0),
            "cornell-bitterli": (a / "cornell-bitterli/cornell-bitterli.glb",
                                 ["--emission-sides", "front"], "-1,0,-1,1,2,1", 0.5),
            "sponza-crytek": (a / "sponza-crytek/sponza.glb", sky, "-10,0,-4,10,10,4", 2.0),
            "sponza-dabrovic": (a / "sponza-dabrovic/sponza.obj", sky, "-10,0,-4,10,10,4", 2.0),
            "lamp": (a / "lights-punctual-lamp/LightsPunctualLamp.gltf", [], None, 0.25),
        }
        return {k: v for k, v in all_scenes.items() if v[0].exists()}

    def run(self, *arguments, allowed=(0,), text=None):
        """Returns standard output and the processor seconds taken."""
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([self.program, *map(str, arguments), "--quiet"], input=text,
                              capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode not in allowed:
            sys.exit(f"{' '.join(map(str, done.args))}\n{done.stderr}")
        return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def bake(self, scene, light, bounds, *options, allowed=(0,), name="volume"):
        volume = self.out / f"{name}.vdb"
        box = [f"--bounds={bounds}"] if bounds else []
        report, seconds = self.run("bake", scene, *light, *box, *options, "-o", volume,
                                   "--json", "-", allowed=allowed)
        report = json.loads(report)
        return volume, {"samples": report["samples"], "traced": report["traced_samples"],
                        "bytes": report["file_bytes"], "seconds": seconds,
                        "noise": report["mean_relative_stderr"], "report": report}

    def evaluate(self, volume, scene, light, *options):
        text, _ = self.run("evaluate", volume, "--scene", scene, *light, *options, "--json", "-",
                           "--seed", 424242)
        return json.loads(text)


def percent(v):
    return f"{100 * v:.3g}%"


def at_error(rows, error, key):
    """Value of key where the error of a series falls to `error`, log-log between two bakes."""
    better = None
    for row in sorted(rows, key=lambda r: r["samples"]):
        if row["error"] <= error:
            if better is None:
                return row[key], "≤"
            t = math.log(better["error"] / error) / math.log(better["error"] / row["error"])
            return math.exp((1 - t) * math.log(better[key]) + t * math.log(row[key])), ""
        better = row
    return None, ">"


# ---- equal-error

def series(bench, setup, variant, options, args):
    scene, light, bounds, coarsest = setup
    rows, worse = [], 0
    for step in range(24):
        if variant.startswith("uniform"):
            how = ["--spacing", coarsest / 2 ** (step / 2)]
        else:
            how = ["--levels", 8, "--refine-threshold", f"error={2 ** -step}"]
        gradients = "analytic" if "gradients" in variant else "none"
        volume, row = bench.bake(scene, light, bounds, *how, "--gradients", gradients, *options)
        if rows and row["samples"] == rows[-1]["samples"]:
            continue
        e = bench.evaluate(volume, scene, light, "--points", args.points, "--rays", args.rays)
        row.update(error=e["rel_rmse_debiased"], p99=e["p99"], file=row["bytes"])
        del row["report"]
        rows.append(row)
        print(f"  {variant}: {row['samples']:,} -> {percent(row['error'])}", file=sys.stderr)
        worse = worse + 1 if len(rows) > 1 and row["error"] > 0.93 * rows[-2]["error"] else 0
        if row["error"] < 0.01 or worse == 3 or row["samples"] > args.most / 2.8:
            break
    return rows


def equal_error(bench, scenes, args):
    variants = ["uniform", "adaptive", "adaptive, gradients"]
    print("| scene | light | error | " + " | ".join(
        f"{v}: samples, kB, s" for v in variants) + " | uniform / adaptive samples |")
    print("|---|---|---|" + "---|" * (len(variants) + 1))
    for name, setup in scenes.items():
        for contribution in args.contributions:
            options = ["--bands", 5, "--rays", args.rays, "--contribution", contribution]
            found = {v: series(bench, setup, v, options, args) for v in variants}
            (bench.out / f"equal_{name}_{contribution}.json").write_text(json.dumps(found))
            for error in (0.1, 0.05, 0.02, 0.01):
                cells = []
                for v in variants:
                    values = [at_error(found[v], error, k) for k in ("samples", "bytes", "seconds")]
                    if values[0][0] is None:
                        last = min(found[v], key=lambda r: r["error"])
                        cells.append(f"– ({last['samples']:,} → {percent(last['error'])})")
                    else:
                        n, b, s = (x[0] for x in values)
                        cells.append(f"{values[0][1]} {n:,.0f}, {b / 1e3:,.0f}, {s:.1f}".strip())
                few = [at_error(found[v], error, "samples")[0] for v in variants]
                most = max(r["samples"] for r in found["uniform"])
                best = min((n for n in few[1:] if n), default=None)
                ratio = "" if not best else (f"{few[0] / best:.1f}" if few[0] else
                                             f"> {most / best:.1f}")
                if any(few):
                    print(f"| {name} | {contribution} | {percent(error)} | " + " | ".join(cells)
                          + f" | {ratio} |", flush=True)


# ---- heuristics

def heuristics(bench, scenes, args):
    ways = {"error": ["error", (0.2, 0.1, 0.05, 0.025, 0.0125)],
            "gradient": ["gradient", (2, 1, 0.5, 0.25)],
            "geometry": ["geometry", (2, 1, 0)],
            "harmonic": ["harmonic", (0.02, 0.1, 0.5)],
            "brute": ["brute", (0.1, 0.05, 0.025)]}
    print("| scene | heuristic | samples → error (× of error-driven cells' samples at that error), "
          "samples traced for the last |")
    print("|---|---|---|")
    for name, setup in scenes.items():
        scene, light, bounds, coarsest = setup
        found = {}
        for way, (threshold, values) in ways.items():
            rows = []
            for value in values:
                volume, row = bench.bake(scene, light, bounds, "--spacing", coarsest / 8,
                                         "--levels", 4, "--bands", 5, "--rays", 256, "--refine",
                                         way, "--refine-threshold", f"{threshold}={value}")
                del row["report"]
                if rows and rows[-1]["samples"] == row["samples"]:
                    continue
                row["error"] = bench.evaluate(volume, scene, light, "--points", args.points,
                                              "--rays", 1024)["rel_rmse_debiased"]
                rows.append(row)
                print(f"  {name} {way} {value}: {row['samples']:,} -> {percent(row['error'])}",
                      file=sys.stderr)
            found[way] = rows
        (bench.out / f"heuristics_{name}.json").write_text(json.dumps(found))
        for way, rows in found.items():
            print(f"| {name} | {way} | " + ", ".join(map(against(found["error"]), rows))
                  + f" ({rows[-1]['traced']:,}) |", flush=True)


def against(error_driven):
    """Text of a bake, with its samples as a multiple of what error-driven cells take for its error."""
    def text(row):
        needed, sign = at_error(error_driven, row["error"], "samples")
        times = "" if row in error_driven else (
            " (not reached)" if needed is None else
            f" ({'≥ ' if sign else ''}{row['samples'] / needed:.1f}×)")
        return f"{row['samples']:,} → {percent(row['error'])}{times}"
    return text


# ---- targets

def targets(bench, scenes, args):
    print("| scene | asked | seed | met | bound | independent | samples | traced | s | why not |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, setup in scenes.items():
        scene, light, bounds, _ = setup
        for asked in args.errors:
            held = met = 0
            for seed in range(1, args.seeds + 1):
                volume, row = bench.bake(scene, light, bounds, "--target-error", asked, "--seed",
                                         seed, "--max-samples", args.most, "--contribution",
                                         args.contributions[0], allowed=(0, 1))
                e = bench.evaluate(volume, scene, light, "--points", args.points, "--rays", 1024)
                a = row["report"]["achieved"]
                why = "; ".join(w.split("samples. ")[-1] for w in row["report"]["warnings"]
                                if "is not met" in w and "bands leave out" in w)
                if not a["met"] and not why:
                    why = "samples" if row["traced"] > 0.5 * args.most else "rounds"
                met += a["met"]
                held += a["met"] and e["rel_rmse_debiased"] <= asked
                print(f"| {name} | {percent(asked)} | {seed} | {'yes' if a['met'] else 'no'} | "
                      f"{percent(a['rel_rmse'])} | {percent(e['rel_rmse_debiased'])} ± "
                      f"{percent((e['upper95'] - e['rel_rmse']) / 1.645)} | {row['samples']:,} | "
                      f"{row['traced']:,} | {row['seconds']:.1f} | {why} |", flush=True)
            if args.seeds > 1:
                print(f"| {name} | {percent(asked)} | all | {met} of {args.seeds} met, {held} held "
                      "| | | | | | |", flush=True)


# ---- gradients

def gradients(bench, scenes, args):
    print("| scene | spacing | gradients | rays a sample | s | mode | error | p50 |")
    print("|---|---|---|---|---|---|---|---|")
    for name, setup in scenes.items():
        scene, light, bounds, coarsest = setup
        spacing = coarsest / 4
        for way, rays in (("none", 1120), ("analytic", 1024), ("central", 160)):
            volume, row = bench.bake(scene, light, bounds, "--spacing", spacing, "--bands", 5,
                                     "--rays", rays, "--gradients", way)
            modes = ["trilinear"] if way == "none" else ["gradient", "tricubic", "taylor"]
            for mode in modes:
                e = bench.evaluate(volume, scene, light, "--points", args.points, "--rays", 2048,
                                   "--mode", mode)
                print(f"| {name} | {spacing:g} | {way} | {rays} | {row['seconds']:.1f} | {mode} | "
                      f"{percent(e['rel_rmse_debiased'])} | {percent(e['p50'])} |", flush=True)


# ---- growth

def scaled_glb(source, scale, target):
    """The scene below one more node that scales it."""
    data = source.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    gltf, rest = json.loads(data[20:20 + length]), data[20 + length:]
    for scene in gltf["scenes"]:
        gltf["nodes"].append({"children": scene["nodes"], "scale": [scale] * 3})
        scene["nodes"] = [len(gltf["nodes"]) - 1]
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + rest
    target.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body)


def growth(bench, _, args):
    sky, scales = ["--env", SAMPLES / "sky.hdr"], (1, 2, 4, 8)
    ways = {"--refine geometry (surfaces at 0.5 m)": ["--refine", "geometry"],
            "--refine-threshold error=0.05": ["--refine-threshold", "error=0.05"]}
    print("| | " + " | ".join(f"{s}×" for s in scales) + " | exponent |")
    print("|---|" + "---|" * (len(scales) + 1))
    for title, options in ways.items():
        rows = []
        for k, scale in enumerate(scales):
            scene = bench.out / f"courtyard{scale}.glb"
            scaled_glb(SAMPLES / "courtyard.glb", scale, scene)
            bounds = ",".join(str(v * scale) for v in (-20, 0, -20, 20, 20, 20))
            volume, row = bench.bake(scene, sky, bounds, "--spacing", 0.5, "--levels", 4 + k,
                                     "--rays", 128, "--bands", 5, *options)
            row["error"] = bench.evaluate(volume, scene, sky, "--points", args.points, "--rays",
                                          1024)["rel_rmse_debiased"]
            rows.append(row)
        for key, text in (("samples", lambda v: f"{v:,}"), ("bytes", lambda v: f"{v / 1e6:.1f} MB"),
                          ("seconds", lambda v: f"{v:.1f} s"), ("error", percent)):
            values = [r[key] for r in rows]
            x = [math.log(s) for s in scales]
            y = [math.log(v) for v in values]
            mx, my = sum(x) / len(x), sum(y) / len(y)
            slope = sum((a - mx) * (b - my) for a, b in zip(x, y)) / sum((a - mx) ** 2 for a in x)
            print(f"| `{title}`: {key} | " + " | ".join(map(text, values)) + f" | {slope:.2f} |",
                  flush=True)


# ---- leaks

def leaks(bench, _, args):
    """Sponza under a low sun from outside: light in the sealed room behind its outer wall."""
    scene = bench.assets / "sponza-crytek/sponza.glb"
    light = ["--sun-direction", "0.1,0.25,1", "--sun-lux", 10]
    wall = 8.19  # z of the wall's inner side; the room behind it ends at 5.6
    def place(i, z0, z1):
        u, v, w = (math.modf(0.5 + (i + 1) * g)[0] for g in (0.8191725, 0.6710436, 0.5497005))
        return -10 + 20 * u, 0.3 + 2.7 * v, z0 + (z1 - z0) * w
    def irradiance(volume, points):
        text = "".join("%.6f,%.6f,%.6f,%g,%g,%g\n" % (*p, *n) for p in points
                       for n in ((0, 0, 1), (0, 1, 0), (0, 0, -1)))
        out, _ = bench.run("query", volume, "--points", "-", text=text)
        values = [sum(float(r[c]) for c in ("Er", "Eg", "Eb")) / 3
                  for r in csv.DictReader(io.StringIO(out))]
        return [sum(values[3 * i:3 * i + 3]) / 3 for i in range(len(points))]
    inside = [place(i, 5.6, wall) for i in range(50 * args.points)]
    outside = [place(i, 8.6, 9.4) for i in range(args.points)]
    text = "".join("%.6f,%.6f,%.6f\n" % p for p in inside[:args.points])
    out, _ = bench.run("probe", scene, *light, "--points", "-", "--bands", 1, "--rays", 256,
                       text=text)
    truth = max(float(r["sh_0_r"]) for r in csv.DictReader(io.StringIO(out)))
    print(f"Largest radiance coefficient that {args.points} probes of 256 rays find inside: {truth:g}")
    print("| spacing | masks | light inside, share of outside: whole room | beyond half a cell "
          "| worst point |")
    print("|---|---|---|---|---|")
    for spacing in (1.0, 0.7, 0.5):
        for masks in ("off", "on"):
            volume, _ = bench.bake(scene, light, "-11,0,3,11,4,11", "--spacing", spacing, "--bands",
                                   5, "--rays", 256, "--visibility", masks)
            lit = sum(irradiance(volume, outside)) / args.points
            found = irradiance(volume, inside)
            far = [e for p, e in zip(inside, found) if p[2] < wall - spacing / 2]
            print(f"| {spacing:g} | {masks} | {percent(sum(found) / len(found) / lit)} | "
                  f"{percent(sum(far) / len(far) / lit)} | {percent(max(found) / lit)} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = {"equal-error": equal_error, "heuristics": heuristics, "targets": targets,
               "gradients": gradients, "growth": growth, "leaks": leaks}
    parser.add_argument("program")
    parser.add_argument("assets")
    parser.add_argument("out")
    parser.add_argument("study", choices=studies)
    parser.add_argument("scene", nargs="*")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--rays", type=int, default=1024, help="of a sample, for equal-error")
    parser.add_argument("--most", type=int, default=100000, help="samples before giving up")
    parser.add_argument("--errors", type=lambda t: [float(v) for v in t.split(",")],
                        default=[0.05, 0.02, 0.01])
    parser.add_argument("--contributions", type=lambda t: t.split(","), default=["all"])
    args = parser.parse_args()
    bench = Bench(args.program, args.assets, args.out)
    scenes = bench.scenes()
    unknown = [name for name in args.scene if name not in scenes]
    if unknown:
        parser.error(f"no scene {unknown[0]}; there are: {', '.join(scenes)}")
    studies[args.study](bench, {n: scenes[n] for n in args.scene or scenes}, args)


if __name__ == "__main__":
    main()
