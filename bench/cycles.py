#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Irradiance probes by LumiVDB and by Blender's Cycles: same scene, same points, same machine.

    bench/cycles.py PROGRAM ASSETS OUT [SCENE ...] [--probes N] [--integrator path|cached ...] ...

Needs `blender` (tried with 3.4.1 of Debian 12) in the PATH. Prints two Markdown tables; each
scene's results are left in OUT/SCENE.cycles.json.

Cycles renders equirectangular panoramas at the probes; their pixels are projected to three SH bands
with the integrals of the basis over each pixel. One process renders all points of a scene.
`lumivdb probe` gives the same bands. E(n) for 32 normals follows from both in the same way. Errors:
  rel_rmse   RMS over probes and normals of E - E_ref, over mean E_ref; worst channel
  own        the same for each probe, over its own mean E_ref; the median over probes
E_ref is LumiVDB's path tracer with many rays, two seeds; its noise is taken off. That Cycles
converges to the same is tested first, at a few probes, with independent seeds on both sides.

Seconds to 1%: sample counts grow by 4 until rel_rmse is below 1% or the budget is spent. Of all
probes together (rel_rmse), and of each probe from its own curve, of which the median and the mean
are given. Between two counts log-log, from the first count's on where that already suffices, beyond
the last with the slope -1/2 of independent samples: a guess, marked ~ for all together and told as
a share of the probes; true is more where an error that does not shrink is left, as that of coarse
pixels or of a cache. The size of the panorama is the one that reaches 1% soonest at trial probes.

Seconds are wall clock of tracing alone: for Cycles of all renders, less as many of 8 x 4 pixels and
one sample; for LumiVDB from the beginning of its stage "trace points" to the end of the program,
less that of one point of two rays. So loading, hierarchies and process start do not count. Where
Cycles takes long it renders fewer probes (--compared); errors of all tracers are those of these.
Solving a cache has a column of its own, and its share for the given number of probes is part of
the times to 1%.

How the model is mapped to Cycles:
  surfaces     Diffuse BSDF of roughness 0, colour = what the importer links to Base Color (for OBJ
               Kd x map_Kd); flat normals; metal, gloss and normal maps dropped
  single-sided the front as above, no closure behind: black, opaque. Double-sided: both sides
  emission     colour x strength on the sides that LumiVDB lets shine
  alpha        MASK and BLEND: transparent where alpha < cut-off (BLEND 0.5), filtered linearly
  textures     nearest texel: Cycles filters 8-bit images before it decodes sRGB, LumiVDB after; the
               nearest texel has the mean of the latter
  environment  the same lat-long convention, nearest texel, raw values
  suns         W/m2 of Blender = E on a surface that faces it (KHR lux as they are), no angle. A
               camera does not see them, so their direct part is taken off LumiVDB's probes too
  paths        1024 bounces, no clamping, caustics on, no denoising, fixed samples, box filter of
               one pixel, camera clipping from 1e-6, output raw 32-bit float
"""

import argparse
import csv
import json
import math
import os
import pathlib
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

from cycles_blender import REPLY, sh_basis

BLENDER_HALF = str(pathlib.Path(__file__).resolve().with_name("cycles_blender.py"))
SAMPLES = pathlib.Path(__file__).resolve().parent.parent / "samples"
BANDS, NORMALS, TARGET = 3, 32, 0.01


def scenes(assets):
    """name: (scene, environment, only fronts shine, bounds of the probes, unseen light group)"""
    sky = assets / "hdri-polyhaven/venice_sunset_1k.hdr"
    court = (-10, 0, -4, 10, 10, 4)
    all_scenes = {
        "cornell": (assets / "cornell-bitterli/cornell-bitterli.glb", None, True,
                    (-1, 0, -1, 1, 2, 1), None),
        "sponza-dabrovic": (assets / "sponza-dabrovic/sponza.obj", sky, False, court, None),
        "sponza-crytek": (assets / "sponza-crytek/sponza.glb", sky, False, court, None),
        "house": (SAMPLES / "house.glb", SAMPLES / "sky.hdr", False, (-10, 0, -10, 10, 5, 10),
                  "sun"),
    }
    return {k: v for k, v in all_scenes.items() if v[0].exists()}


# ---- the two contenders: an instance traces points and returns their SH and the seconds it took

class Cycles:
    def __init__(self, args, scene, env, fronts):
        self.width = args.width
        job = {"scene": str(scene), "env": env and str(env), "fronts": fronts,
               "threads": args.threads, "adaptive": args.adaptive,
               "picture": str((args.out / "panorama.exr").resolve())}
        blender = shutil.which("blender") or sys.exit("No blender in the PATH.")
        command = [blender, "--background", "--factory-startup", "--python-exit-code", "1",
                   "--python", BLENDER_HALF, "--", json.dumps(job)]
        # Debian's Blender would take the libraries of another Python that comes first in the PATH.
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                        text=True, env={**os.environ, "PATH": os.defpath})
        self.trace([(0, 1, 0)], 1, 0, width=8)  # builds the hierarchy
        self.floor = min(self.trace([(0, 1, 0)], 1, 0, width=8)[1] for _ in range(10))

    def trace(self, points, samples, seed, width=None):
        request = {"points": points, "samples": samples, "seed": seed, "width": width or self.width}
        print(json.dumps(request), file=self.process.stdin, flush=True)
        said = []
        for line in self.process.stdout:
            said.append(line)
            if line.startswith(REPLY):
                reply = json.loads(line[len(REPLY):])
                floor = getattr(self, "floor", 0) * len(points)
                return reply["sh"], reply["seconds"] - floor
        sys.exit("Blender ended without an answer: " + "".join(said[-15:]))

    def rays(self, samples):
        return samples * self.width * self.width // 2

    def close(self):
        self.process.stdin.close()
        self.process.wait()


class Lumivdb:
    def __init__(self, args, scene, env, fronts, unseen=None):
        self.unseen = unseen
        self.command = [args.program, "probe", scene, "--bands", BANDS, "--threads", args.threads,
                        "--points", "-"]
        self.command += ["--env", env] if env else []
        self.command += ["--emission-sides", "front"] if fronts else []
        self.integrator, self.floor, self.solving = "path", 0, 0
        self.floor = min(self.trace([(0, 1, 0)], 2, 0)[1] for _ in range(5))

    def run(self, points, rays, seed, more=()):
        """Rows of the CSV, seconds of tracing and of solving a cache."""
        command = [*self.command, "--rays", rays, "--seed", seed, *more]
        command += [] if more else ["--integrator", self.integrator]
        begun = {}  # a stage of the program: when it first said so
        with tempfile.TemporaryFile("w+") as asked, tempfile.TemporaryFile("w+") as found:
            asked.writelines(f"{x!r},{y!r},{z!r}\n" for x, y, z in points)
            asked.seek(0)
            with subprocess.Popen(list(map(str, command)), stdin=asked, stdout=found,
                                  stderr=subprocess.PIPE, text=True) as process:
                said = []
                for line in process.stderr:
                    said.append(line)
                    begun.setdefault(line.split(":")[0], time.perf_counter())
            end = time.perf_counter()
            if process.returncode:
                sys.exit("".join(said))
            found.seek(0)
            rows = list(csv.DictReader(found))
        traced = begun["trace points"]
        return rows, end - traced - self.floor, traced - begun.get("light of the surfaces", traced)

    def trace(self, points, rays, seed):
        rows, seconds, solving = self.run(points, rays, seed)
        for _ in range(2):  # what is short is told less well from the floor
            if self.floor and seconds < 2:
                _, again, solved = self.run(points, rays, seed)
                seconds, solving = min(seconds, again), min(solving, solved)
        self.solving = solving
        found = self.sh(rows)
        if self.unseen:  # a point has no noise in it, two rays are enough
            only = ["--light-group", self.unseen, "--contribution", "direct"]
            direct = self.sh(self.run(points, 2, 1, only)[0])
            found = [[[a - b for a, b in zip(*rgb)] for rgb in zip(*probe)]
                     for probe in zip(found, direct)]
        return found, seconds

    @staticmethod
    def sh(rows):
        return [[[float(row[f"sh_{i}_{c}"]) for c in "rgb"] for i in range(BANDS ** 2)]
                for row in rows]

    def rays(self, samples):
        return samples


# ---- what is measured

def irradiance_matrix():
    """E(n) = sum of the rows times SH, for normals on a spherical Fibonacci set."""
    cosine = [math.pi] + [2 * math.pi / 3] * 3 + [math.pi / 4] * 5
    rows = []
    for k in range(NORMALS):
        y, phi = 1 - (2 * k + 1) / NORMALS, k * math.pi * (3 - math.sqrt(5))
        r = math.sqrt(1 - y * y)
        rows.append([a * b for a, b in zip(cosine, sh_basis(r * math.cos(phi), y,
                                                            r * math.sin(phi)))])
    return rows


MATRIX = irradiance_matrix()


def irradiance(sh):
    """[probe][channel][normal]"""
    return [[[sum(m * s[c] for m, s in zip(row, probe)) for row in MATRIX] for c in range(3)]
            for probe in sh]


def flat(e, channel):
    return [value for probe in e for value in probe[channel]]


def mean_square(a, b):
    return statistics.fmean((x - y) ** 2 for x, y in zip(a, b))


def errors(e, reference, noise):
    """rel_rmse, and each probe's own. noise: a second reference; a quarter
    of their squared difference is the variance of their mean."""
    def relative(first, last, channel):
        a, b, other = (flat(x[first:last], channel) for x in (e, reference, noise))
        mean = [(x + y) / 2 for x, y in zip(b, other)]
        square = mean_square(a, mean) - mean_square(b, other) / 4
        level = statistics.fmean(mean)  # 0 where no light comes
        return math.sqrt(max(0, square)) / level if level > 0 else 0.0

    own = [max(relative(i, i + 1, c) for c in range(3)) for i in range(len(e))]
    return max(relative(0, len(e), c) for c in range(3)), own


def seconds_to_target(curve):
    """Of (seconds, error) by seconds: seconds at TARGET, and "~" where they are extrapolated."""
    curve = [c for c in curve if c[1] > 0] or [(curve[0][0], TARGET)]
    for (before, a), (after, b) in zip(curve, curve[1:]):
        if a > TARGET >= b:
            return before * (after / before) ** (math.log(a / TARGET) / math.log(a / b)), ""
    if curve[0][1] <= TARGET:
        return curve[0][0], ""
    return curve[-1][0] * (curve[-1][1] / TARGET) ** 2, "~"


def of_all(rows):
    """Seconds a probe at TARGET for all of them together, and its mark."""
    return seconds_to_target([(r["seconds"], r["rel_rmse"]) for r in rows])


def of_each(rows):
    """Median and mean over probes of the seconds at TARGET, share of extrapolated ones."""
    found = [seconds_to_target([(r["seconds"], own) for r, own in zip(rows, probe)])
             for probe in zip(*(r["own"] for r in rows))]
    seconds = [f[0] for f in found]
    return {"median": statistics.median(seconds), "mean": statistics.fmean(seconds),
            "extrapolated": statistics.fmean(f[1] == "~" for f in found)}


def series(contender, points, reference, first, budget):
    """A row for each sample count, until the target is reached or the budget would be. Errors are
    of as many points as the reference has, seconds of all."""
    rows, samples = [], first
    while not rows or (rows[-1]["rel_rmse"] > TARGET
                       and 4 * rows[-1]["seconds"] * len(points) < budget):
        sh, seconds = contender.trace(points, samples, 77 + len(rows))
        rel_rmse, own = errors(irradiance(sh[:len(reference[0])]), *reference)
        rows.append({"samples": samples, "rays": contender.rays(samples), "rel_rmse": rel_rmse,
                     "own": own, "seconds": max(seconds, 1e-6) / len(points)})
        told = rows[-1] | {"own": statistics.median(own)}
        print(f"  {type(contender).__name__} {told}", file=sys.stderr, flush=True)
        samples *= 4
    return rows


def affordable(contender, points, seconds, first):
    """Samples, 4^k times the first, for which all points take about that long."""
    samples, taken = first, 0
    while True:
        taken = max(1e-6, contender.trace(points, samples, 1)[1])
        if taken > min(1.0, 0.3 * seconds):
            return max(2, int(samples * seconds / taken))
        samples *= 4


def agreement(cycles, lumivdb, points, args):
    """Converged values from independent seeds of both, and how far they differ."""
    seeds = range(1000, 1000 + args.repeats)
    found = []
    cycles.width = args.fine
    for contender, first in ((cycles, 1), (lumivdb, 64)):
        samples = affordable(contender, points, args.converge / args.repeats, first)
        runs = [irradiance(contender.trace(points, samples, seed)[0]) for seed in seeds]
        found.append([[flat(e, c) for e in runs] for c in range(3)])
    rows = []
    for a, b in zip(*found):
        values = [[statistics.fmean(v) for v in zip(*x)] for x in (a, b)]
        variance = sum(statistics.fmean(statistics.variance(v) for v in zip(*x)) for x in (a, b))
        means = [[statistics.fmean(run) for run in x] for x in (a, b)]
        mean = statistics.fmean(means[1])
        square, noise = mean_square(*values), variance / args.repeats
        stderr = math.sqrt(sum(statistics.variance(m) for m in means) / args.repeats)
        difference = statistics.fmean(means[0]) - mean
        rows.append({"difference": math.sqrt(square) / mean, "expected": math.sqrt(noise) / mean,
                     "in_errors": math.sqrt(square / noise), "bias": difference / mean,
                     "bias_stderr": stderr / mean})
    return rows


def choose_points(lumivdb, bounds, count):
    """Random places of the box, without those inside solids."""
    rng, points = random.Random(5), []
    while len(points) < count:
        tried = [tuple(round(rng.uniform(bounds[a], bounds[a + 3]), 4) for a in range(3))
                 for _ in range(count)]
        rows = lumivdb.run(tried, 64, 1)[0]
        points += [p for p, row in zip(tried, rows) if float(row["validity"]) >= 0.5]
    return points[:count]


def choose_width(cycles, points, reference, args):
    found = {}
    for width in (32, 64, 128):
        cycles.width = width
        rows = series(cycles, points, reference, max(1, 4096 // width ** 2), args.budget / 4)
        found[width] = of_all(rows)[0]
    print(f"  width: seconds to 1% {found}", file=sys.stderr)
    return min(found, key=found.get)


def references(lumivdb, points, seconds):
    rays = affordable(lumivdb, points, seconds / 2, 64)
    return [irradiance(lumivdb.trace(points, rays, seed)[0]) for seed in (501, 502)]


def measure(name, setup, args):
    scene, env, fronts, bounds, unseen = setup
    lumivdb = Lumivdb(args, scene, env, fronts, unseen)
    points = choose_points(lumivdb, bounds, args.probes)
    trial = points[:args.trial]
    cycles = Cycles(args, scene, env, fronts)
    result = {"scene": name, "probes": args.probes, "threads": args.threads}
    result["agreement"] = agreement(cycles, lumivdb, trial, args)
    print(f"  {name}: {result['agreement']}", file=sys.stderr)
    cycles.width = args.width or choose_width(
        cycles, trial, references(lumivdb, trial, args.budget / 4), args)
    compared = points[:args.compared or len(points)]
    reference = references(lumivdb, compared, args.reference)
    result["compared"] = len(compared)
    result["reference_stderr"] = max(
        math.sqrt(mean_square(*(flat(e, c) for e in reference))) / 2
        / statistics.fmean(flat(reference[0], c)) for c in range(3))
    result["width"] = cycles.width
    result["cycles"] = series(cycles, compared, reference, args.first, args.budget)
    cycles.close()
    for integrator in args.integrator:
        lumivdb.integrator = integrator
        result[integrator] = series(lumivdb, points, reference, 64, args.budget)
        result[f"{integrator}_solving"] = lumivdb.solving
    for tracer in ["cycles", *args.integrator]:
        rows = result[tracer]
        result[tracer] = {"solving": result.pop(f"{tracer}_solving", 0), "all": of_all(rows),
                          "each": of_each(rows), "counts": rows}
    (args.out / f"{name}.cycles.json").write_text(json.dumps(result, indent=1))
    return result


# ---- tables

def print_tables(results, args):
    print("| scene, converged | channel | rms difference | expected from noise | "
          "in standard errors | mean difference | its standard error |\n"
          "|---|---|---|---|---|---|---|")
    for result in results:
        for channel, row in zip("RGB", result["agreement"]):
            print(f"| {result['scene']} | {channel} | {row['difference']:.3%} | "
                  f"{row['expected']:.3%} | {row['in_errors']:.2f} | {row['bias']:+.3%} | "
                  f"{row['bias_stderr']:.3%} |")
    print("\n| scene | probes, compared | reference's error | tracer | rays a probe at the end | "
          "rel_rmse there | solving, s | s a probe to 1%, all together | Cycles / it | "
          "each to its own 1%: median | Cycles / it | mean | Cycles / it | extrapolated |\n"
          + "|---" * 14 + "|")
    for result in results:
        for tracer in ["cycles", *args.integrator]:
            last, found = result[tracer]["counts"][-1], result[tracer]
            share = found["solving"] / result["probes"]
            row = [result["scene"], f"{result['probes']}, {result['compared']}",
                   f"{result['reference_stderr']:.2%}", tracer,
                   f"{last['rays']:,}", f"{last['rel_rmse']:.2%}", f"{found['solving']:.2f}"]
            slow, (together, mark) = result["cycles"], found["all"]
            row += [f"{mark}{together + share:.3g}", f"{slow['all'][0] / (together + share):.1f}"]
            for key in ("median", "mean"):
                seconds = found["each"][key] + share
                row += [f"{seconds:.3g}", f"{slow['each'][key] / seconds:.1f}"]
            print("|", " | ".join(map(str, row)), f"| {found['each']['extrapolated']:.0%} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=lambda p: pathlib.Path(p).resolve())
    parser.add_argument("assets", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("scene", nargs="*")
    parser.add_argument("--integrator", action="append", choices=["path", "cached"])
    parser.add_argument("--probes", type=int, default=512)
    parser.add_argument("--compared", type=int,
                        help="so many of them are rendered by Cycles and have a reference; all")
    parser.add_argument("--first", type=int, default=1, help="samples Cycles begins with")
    parser.add_argument("--trial", type=int, default=16, help="probes of agreement and width")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--width", type=int, help="of the panoramas; without, the best is found")
    parser.add_argument("--fine", type=int, default=512, help="width for converged panoramas")
    parser.add_argument("--adaptive", type=float, default=0, help="Cycles' noise threshold")
    parser.add_argument("--repeats", type=int, default=8, help="seeds of the agreement")
    parser.add_argument("--converge", type=float, default=60, help="seconds a tracer, agreement")
    parser.add_argument("--reference", type=float, default=120, help="seconds, reference")
    parser.add_argument("--budget", type=float, default=120, help="most seconds of a sample count")
    args = parser.parse_args()
    args.integrator = args.integrator or ["path", "cached"]
    args.out.mkdir(parents=True, exist_ok=True)
    known = scenes(args.assets.resolve())
    print_tables([measure(name, known[name], args) for name in args.scene or known], args)


if __name__ == "__main__":
    main()
