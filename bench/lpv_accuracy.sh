#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Light propagation volumes against the independent trace, beside path-traced bakes of the same
# spacing: one Markdown row a configuration, indirect light only. Then leaks through the wall
# between two rooms. Volumes and reports go to OUT.
#   bench/lpv_accuracy.sh PROGRAM ASSETS OUT [quick] [points] [rays per point]
set -euo pipefail
program=$(realpath "$1") assets=$(realpath "$2") out=$3 quick=${4:-} points=${5:-500} reference=${6:-2048}
samples=$(realpath "$(dirname "$0")/../samples")
mkdir -p "$out"

echo "| scene | method | spacing | iterations | occlusion | bounces | samples | s | rel_rmse | p50 | p99 | bias |"
echo "|---|---|---|---|---|---|---|---|---|---|---|---|"
measure() { # NAME SCENE "light options" FILE, after the volume was made with its report in FILE.json
    local name=$1 scene=$2 light=$3 file=$4
    # $light is split into its words on purpose.
    # shellcheck disable=SC2086
    "$program" evaluate "$file.vdb" --scene "$scene" $light --points "$points" --rays "$reference" \
        --max-bounces=-1 --json "$file.error.json" --quiet >/dev/null
    python3 - "$name" "$file" <<'PYTHON'
import json, sys
b, e = (json.load(open(sys.argv[2] + s)) for s in ('.json', '.error.json'))
percent = lambda v: f'{100 * v:.1f}%'
lpv = 'iterations' in b
print('|', ' | '.join([sys.argv[1], 'LPV' if lpv else 'path-traced', f"{b['spacing']:g}",
    str(b['iterations']) if lpv else '–', ('on' if b['occlusion'] else 'off') if lpv else '–',
    str(b['bounces']) if lpv else 'all', f"{b['samples']:,}",
    f"{sum(v for k, v in b['seconds'].items() if k not in ('load', 'write')):.2f}",
    percent(e['rel_rmse']), percent(e['p50']), percent(e['p99']), percent(e['bias'])]), '|')
PYTHON
}

lpv() { # NAME SCENE "light options" "volume options" lpv options...
    local name=$1 scene=$2 light=$3 volume=$4
    shift 4
    local file="$out/$name.lpv"
    # shellcheck disable=SC2086
    "$program" lpv "$scene" $light $volume "$@" --contribution indirect -o "$file.vdb" \
        --json "$file.json" --quiet
    measure "$name" "$scene" "$light" "$file"
}

bake() { # NAME SCENE "light options" "volume options" bake options...
    local name=$1 scene=$2 light=$3 volume=$4
    shift 4
    local file="$out/$name.bake"
    # shellcheck disable=SC2086
    "$program" bake "$scene" $light $volume "$@" --contribution indirect --bands 2 --rays 256 \
        -o "$file.vdb" --json "$file.json" --quiet
    measure "$name" "$scene" "$light" "$file"
}

study() { # NAME SCENE "light options" "other volume options" spacings...
    local name=$1 scene=$2 light=$3 volume=$4
    shift 4
    local h
    for h in "$@"; do
        bake "$name" "$scene" "$light" "$volume --spacing $h"
        lpv "$name" "$scene" "$light" "$volume --spacing $h"
        lpv "$name" "$scene" "$light" "$volume --spacing $h" --no-occlusion
        lpv "$name" "$scene" "$light" "$volume --spacing $h" --bounces many
        [ -n "$quick" ] && continue
        lpv "$name" "$scene" "$light" "$volume --spacing $h" --scheme conservative
        for n in 4 8 16 32; do
            lpv "$name" "$scene" "$light" "$volume --spacing $h" --iterations "$n"
        done
    done
}

cornell="$assets/cornell-bitterli/cornell-bitterli.glb"
sponza="$assets/sponza-crytek/sponza.glb"
study cornell-bitterli "$cornell" "--emission-sides front" "--bounds=-1,0,-1,1,2,1" 0.2 0.1
study two_rooms "$samples/two_rooms.glb" "" "" 0.5 0.25
study sponza-crytek "$sponza" "--env $assets/hdri-polyhaven/rooitou_park_1k.hdr" "" 1.5 0.75

# Mean E over six normals at 2 × 10³ points of either room, half a metre off its walls and more.
echo
echo "| two_rooms | spacing | occlusion | visibility | E in the lit room | E in the dark room | share |"
echo "|---|---|---|---|---|---|---|"
leak() { # SPACING lpv options...
    local h=$1
    shift
    "$program" lpv "$samples/two_rooms.glb" --spacing "$h" "$@" -o "$out/leak.vdb" --json "$out/leak.json" --quiet
    python3 - "$program" "$out" "$h" "$*" <<'PYTHON'
import csv, io, subprocess, sys
program, out, spacing, options = sys.argv[1:]
n = 10
axis = lambda low, high, i: low + (high - low) * (i + 0.5) / n
lines = [f'{axis(x0, x0 + 3, i)},{axis(0.5, 2.5, j)},{axis(-1.5, 1.5, k)},{nx},{ny},{nz}'
         for x0 in (-3.5, 0.5) for i in range(n) for j in range(n) for k in range(n)
         for nx, ny, nz in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
text = subprocess.run([program, 'query', f'{out}/leak.vdb', '--points', '-'], check=True,
                      input='\n'.join(lines), capture_output=True, text=True).stdout
E = [float(row['Eg']) for row in csv.DictReader(io.StringIO(text))]
lit, dark = (sum(part) / len(part) for part in (E[:len(E) // 2], E[len(E) // 2:]))
print(f"| | {spacing} | {'off' if '--no-occlusion' in options else 'on'} | "
      f"{'off' if '--visibility off' in options else 'on'} | {lit:.3g} | {dark:.3g} | "
      f"{100 * dark / lit:.2f}% |")
PYTHON
}
for h in 0.5 0.25 0.125; do
    leak "$h"
    leak "$h" --no-occlusion
    leak "$h" --visibility off
done
