#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Time to 5, 2 and 1% of whole uniform volumes, by both integrators; tables and a picture.

    bench/volume_curves.py BENCH_VOLUMES ASSETS OUT [SCENE ...] [--seeds N] [--scale X] [--finer N]
    bench/volume_curves.py --plot PICTURE.png OUT [SCENE ...]

BENCH_VOLUMES is the program lumivdb_bench_volumes, which defines errors; its JSON is left in
OUT/SCENE.volume.json. The second form draws what is there, and prints the tables again.

Seconds are of the processor, all threads, one bake: the structure for rays, solving the cache,
tracing, masks of visibility; not loading the scene, and not measuring the cache's bias, which
has a column. To an error: rays between two counts by logarithms, seconds between them linearly.
Beyond the last count (marked ~, a guess) along the line of the last counts, the measured bias of
the cache kept apart as what more rays do not lower; "never" where that alone is more, or where the
error no longer falls. For other numbers of samples, those parts that belong to samples grow with
them, and solving with the patches that a cache begins with (RadianceCacheOptions::patchesFor).
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys

SAMPLES = pathlib.Path(__file__).resolve().parent.parent / "samples"
TARGETS = (0.05, 0.02, 0.01)
COUNTS = (512, 4096, 32768)
NAMES = ("path", "cached")


def scenes(assets):
    """name: (scene, options of the program). Bounds lie inside the rooms: beside a wall or lamp a
    sample's light is that of a few directions, and it alone would be the RMS of all."""
    sky = assets / "hdri-polyhaven/venice_sunset_1k.hdr"
    room = ["most=8192", "reference=65536"]
    rooms = ["spacing=0.55", "bounds=-3.85,0.55,-1.65,3.85,2.75,1.65", *room]
    day = [f"env={SAMPLES / 'sky.hdr'}", "most=4096", "reference=16384"]
    court = ["spacing=1.4", "bounds=-9.8,1.4,-2.8,9.8,9.8,2.8"]
    under = {"sun": ["sun=1", "most=8192", "reference=32768"],
             "sky": [f"env={sky}", "most=16384", "reference=131072"]}
    found = {
        "cornell_box": (SAMPLES / "cornell_box.glb",
                        ["spacing=0.065", "bounds=0.065,0.065,0.065,0.52,0.52,0.52", *room]),
        "cornell-bitterli": (assets / "cornell-bitterli/cornell-bitterli.glb",
                             ["spacing=0.24", "bounds=-0.96,0.24,-0.96,0.96,1.92,0.96", "front=1",
                              *room]),
        "two_rooms": (SAMPLES / "two_rooms.glb", rooms),
        "two_rooms_door": (SAMPLES / "two_rooms_door.glb", rooms),
        "house": (SAMPLES / "house.glb",
                  ["spacing=1.2", "bounds=-9.6,1.2,-9.6,9.6,4.8,9.6", *day]),
        "courtyard": (SAMPLES / "courtyard.glb",
                      ["spacing=3", "bounds=-18,3,-18,18,18,18", *day]),
    }
    for sponza, file in (("crytek", "sponza.glb"), ("dabrovic", "sponza.obj")):
        for light, options in under.items():
            found[f"sponza-{sponza}-{light}"] = (assets / f"sponza-{sponza}" / file,
                                                  court + options)
    return {k: v for k, v in found.items() if v[0].exists()}


def path_of(out, name):
    return out / f"{name}.volume.json"


def measure(args, name, setup):
    scene, options = setup
    if args.scale != 1:  # fewer rays everywhere, to try
        shorter = {"most", "reference"}
        parts = [o.split("=", 1) for o in options]
        options = [f"{k}={max(64, int(int(v) * args.scale)) if k in shorter else v}"
                   for k, v in parts] + [f"bias={max(64, int(8192 * args.scale))}"]
    if args.finer > 1:
        options = [f"spacing={float(o[8:]) / args.finer:g}" if o.startswith("spacing=") else o
                   for o in options]
    command = [args.program, scene, *options, f"seeds={args.seeds}"]
    print(f"  {' '.join(map(str, command))}", file=sys.stderr, flush=True)
    done = subprocess.run(list(map(str, command)), stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(done.returncode)
    path_of(args.out, name).write_text(done.stdout)


# ---- what the counts say

def fixed(result, row):
    """Seconds of a bake that do not grow with its samples."""
    return result["build"] + row["seconds"].get("solve", 0)


def patches(samples, rays):
    return min(max(rays * math.sqrt(samples) / 12, 512), 65536)


def solving(result, rows, samples, rays):
    """Seconds for so many: between the counts measured, beyond them in proportion to patches."""
    known = [(patches(result["samples"], r["rays"]), r["seconds"].get("solve", 0)) for r in rows]
    wanted = patches(samples, rays)
    if wanted <= known[0][0] or wanted >= known[-1][0]:
        at, seconds = known[0] if wanted <= known[0][0] else known[-1]
        return seconds * wanted / at
    for (p0, s0), (p1, s1) in zip(known, known[1:]):
        if p0 <= wanted < p1:
            return s0 + (s1 - s0) * (wanted - p0) / (p1 - p0)
    return known[-1][1]


def growing(row):
    return sum(row["seconds"].get(k, 0) for k in ("trace", "visibility", "rest"))


def line(a, b, error):
    """Rays at an error, between or beyond two (rays, error)."""
    t = math.log(error / a[1]) / math.log(b[1] / a[1])
    return a[0] * (b[0] / a[0]) ** t


def seconds_between(a, b, rays):
    """Of what grows, linear in rays."""
    t = (rays - a["rays"]) / (b["rays"] - a["rays"])
    return growing(a) + t * (growing(b) - growing(a))


def to_error(rows, target, bias):
    """Rays, seconds of what grows with samples, "" or "~" or "≤"; None where it is never reached."""
    if rows[0]["rel_rmse"] <= target:
        return rows[0]["rays"], growing(rows[0]), "≤"
    for a, b in zip(rows, rows[1:]):
        if b["rel_rmse"] <= target < a["rel_rmse"]:
            found = line((a["rays"], a["rel_rmse"]), (b["rays"], b["rel_rmse"]), target)
            return found, seconds_between(a, b, found), ""
    first, last = rows[max(0, len(rows) - 3)], rows[-1]
    noise = [math.sqrt(max(0, r["rel_rmse"] ** 2 - bias ** 2)) for r in (first, last)]
    if target <= bias or not 0 < noise[1] < 0.9 * noise[0]:
        return None, None, ""
    left = math.sqrt(target ** 2 - bias ** 2)
    found = line((first["rays"], noise[0]), (last["rays"], noise[1]), left)
    # The first count is the furthest away: the slope of near ones may be noise, even below 0.
    return found, max(growing(last), seconds_between(rows[0], last, found)), "~"


def biases(result):
    """0 where it does not reach half of the noise it was measured with."""
    bias = result["bias"]
    noise = bias and math.hypot(bias["noise"], result["reference"]["noise"])
    return {"path": 0, "cached": bias["rms"] if bias and bias["rms"] > noise / 2 else 0}


def times(result, target, samples=None):
    """{integrator: (seconds of a bake, mark)}; for another number of samples if one is given."""
    found = {}
    samples = samples or result["samples"]
    for name in NAMES:
        rows = result[name]
        rays, seconds, mark = to_error(rows, target, biases(result)[name])
        found[name] = None, mark
        if seconds is not None:
            still = result["build"] + solving(result, rows, samples, rays)
            found[name] = still + samples / result["samples"] * seconds, mark
    return found


def shown(seconds, mark):
    return "never" if seconds is None else f"{mark}{seconds:.3g}"


def ratio(found):
    (path, a), (cached, b) = found["path"], found["cached"]
    if cached is None:
        return "–"
    return "∞" if path is None else f"{'~' if '~' in a + b else ''}{path / cached:.3g}"


def print_tables(results):
    print("| scene | samples | noise of the reference | s to 5%, path / cached | to 2% | to 1% | "
          "path / cached at 5, 2, 1% | at 1% for 512, 4,096, 32,768 samples | bias of the cache, "
          "mean | memory of the cache, MB | peak, path / with it, MB |\n" + "|---" * 11 + "|")
    for name, r in results.items():
        cells = [name, f"{r['samples']:,}", f"{r['reference']['noise']:.2%}"]
        at = [times(r, target) for target in TARGETS]
        cells += [" / ".join(shown(*found[n]) for n in NAMES) for found in at]
        cells.append(", ".join(ratio(found) for found in at))
        cells.append(", ".join(ratio(times(r, 0.01, n)) for n in COUNTS))
        bias = r["bias"]
        cells.append(f"{bias['rms']:.2%}, {bias['mean']:+.2%} (noise {bias['noise']:.2%})"
                     if bias else "–")
        cells.append(f"{r['cached'][-1]['cache']['bytes'] / 2 ** 20:.0f}")
        cells.append(" / ".join(f"{r['peak_mb'][n]:.0f}" for n in NAMES))
        print("|", " | ".join(cells), "|")
    print("\nStages at the count of rays nearest to 1%, processor seconds:\n\n"
          "| scene | integrator | rays a sample | rel_rmse | rays, M | build | solve | trace | "
          "visibility | rest | measuring the bias |\n" + "|---" * 11 + "|")
    for name, r in results.items():
        for integrator in NAMES:
            row = min(r[integrator],
                      key=lambda x: abs(math.log(max(x["rel_rmse"], 1e-9) / 0.01)))
            stages = [row["seconds"].get(k, 0)
                      for k in ("solve", "trace", "visibility", "rest", "verify")]
            print(f"| {name} | {integrator} | {row['rays']} | {row['rel_rmse']:.2%} | "
                  f"{row['traced'] / 1e6:.1f} | {r['build']:.2f} | "
                  + " | ".join(f"{s:.2f}" for s in stages) + " |")


# ---- the picture

def panel(name, result, first):
    """gnuplot's commands for one scene."""
    series = {name: [(fixed(result, r) + growing(r), r["rel_rmse"]) for r in result[name]]
              for name in NAMES}
    series["cached, already solved"] = [(result["build"] + growing(r), r["rel_rmse"])
                                        for r in result["cached"]]
    styles = ["pt 5 lc rgb '#1f77b4'", "pt 7 lc rgb '#ff7f0e'", "dt 3 pt 6 lc rgb '#ff7f0e'"]
    data, plots = "", []
    for number, (title, points) in enumerate(series.items()):
        data += f"$data{number} << END\n" + "".join(
            f"{x:g} {100 * max(y, 1e-6):g}\n" for x, y in points) + "END\n"
        plots.append(f"$data{number} using 1:2 with linespoints ps 0.7 {styles[number]} "
                     f"title '{title}'")
    bias = biases(result)["cached"]
    seconds = [x for points in series.values() for x, _ in points]
    if bias > 0:
        plots.append(f"{100 * bias:g} with lines dt 2 lc rgb '#ff7f0e' title 'bias of the cache'")
    title = f"{name}: {result['samples']:,} samples".replace("'", "''")
    key = "set key bottom left samplen 1" if first else "unset key"
    span = f"[{min(seconds) / 1.3:g}:{max(seconds) * 1.3:g}]"
    return (f"{data}set title '{title}'\nset xrange {span}\n"
            f"set xlabel 'processor seconds of a bake'\n{key}\nplot {', '.join(plots)}\n")


def draw(picture, results):
    rows = (len(results) + 1) // 2
    script = ("set encoding utf8\n"
              f"set terminal pngcairo noenhanced font 'sans,10' size 960,{340 * rows}\n"
              f"set output '{picture}'\nset logscale xy\nset grid lc rgb '#dddddd'\n"
              "set ylabel 'rel. RMS error, %'\nset yrange [0.05:100]\n"
              f"set multiplot layout {rows},2\n")
    for number, (name, result) in enumerate(results.items()):
        script += panel(name, result, number == 0)
    subprocess.run(["gnuplot"], input=script + "unset multiplot\n", text=True, check=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=pathlib.Path, help="draw what is in OUT, measure nothing")
    parser.add_argument("--seeds", type=int, default=3, help="bakes of each number of rays")
    parser.add_argument("--scale", type=float, default=1, help="of all numbers of rays, to try")
    parser.add_argument("--finer", type=int, default=1, help="divides the spacing")
    parser.add_argument("words", nargs="+", metavar="BENCH_VOLUMES ASSETS OUT [SCENE ...]")
    args = parser.parse_args()
    words = args.words
    if args.plot:
        args.out, names = pathlib.Path(words[0]), words[1:]
        known = [p.name.split(".")[0] for p in sorted(args.out.glob("*.volume.json"))]
    else:
        if len(words) < 3:
            parser.error("give BENCH_VOLUMES, ASSETS and OUT")
        args.program, args.out, names = pathlib.Path(words[0]).resolve(), pathlib.Path(words[2]), \
            words[3:]
        known = scenes(pathlib.Path(words[1]).resolve())
    args.out.mkdir(parents=True, exist_ok=True)
    unknown = [n for n in names if n not in known]
    if unknown:
        parser.error(f"no scene {unknown[0]}; there are: {'; '.join(known)}")
    results = {}
    for name in names or known:
        if not args.plot:
            measure(args, name, known[name])
        if path_of(args.out, name).exists():
            results[name] = json.loads(path_of(args.out, name).read_text())
    print_tables(results)
    if args.plot:
        draw(args.plot, results)


if __name__ == "__main__":
    main()
