#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Bakes real scenes and the samples, measures each volume against an independent trace, and prints
# one Markdown row a scene. Pictures and volumes go to OUT.
#   bench/real_scenes.sh PROGRAM ASSETS OUT [rays per sample] [points] [rays per point]
set -euo pipefail
program=$(realpath "$1") assets=$(realpath "$2") out=$3 rays=${4:-1024} points=${5:-1000} reference=${6:-4096}
samples=$(realpath "$(dirname "$0")/../samples")
mkdir -p "$out"

echo "| scene | bands | spacing | samples | bake s | Mrays/s | stderr of E | file MB | rel_rmse | p50 | p95 | p99 | bias | reference stderr | query ns |"
echo "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
row() { # NAME SCENE BANDS "light options" bake options...
    local name=$1 scene=$2 bands=$3 light=$4
    shift 4
    # $light is split into its words on purpose.
    # shellcheck disable=SC2086
    "$program" bake "$scene" $light "$@" --bands "$bands" --rays "$rays" -o "$out/$name.vdb" \
        --json "$out/$name.bake.json" --quiet
    # shellcheck disable=SC2086
    "$program" evaluate "$out/$name.vdb" --scene "$scene" $light --points "$points" \
        --rays "$reference" --json "$out/$name.error.json" --quiet >/dev/null
    # shellcheck disable=SC2086
    "$program" render "$scene" $light --volume "$out/$name.vdb" -o "$out/$name.png" --quiet
    python3 - "$name" "$out/$name" <<'PYTHON'
import json, sys
b, e = (json.load(open(sys.argv[2] + s)) for s in ('.bake.json', '.error.json'))
percent = lambda v: f'{100 * v:.2f}%'
print('|', ' | '.join([sys.argv[1], str(b['bands']), f"{b['spacing']:g}", f"{b['samples']:,}",
    f"{b['seconds']['trace']:.1f}", f"{b['rays_per_second'] / 1e6:.2f}",
    percent(b['mean_relative_stderr']), f"{b['file_bytes'] / 1e6:.2f}", percent(e['rel_rmse']),
    percent(e['p50']), percent(e['p95']), percent(e['p99']), percent(e['bias']),
    percent(e['reference_stderr']), f"{e['query_ns']:.0f}"]), '|')
PYTHON
}

sun="--sun-direction 0.25,1,0.15 --sun-lux 10"
row sponza-crytek-sky "$assets/sponza-crytek/sponza.glb" 3 "--env $assets/hdri-polyhaven/rooitou_park_1k.hdr" --spacing 0.75
row sponza-crytek-sky5 "$assets/sponza-crytek/sponza.glb" 5 "--env $assets/hdri-polyhaven/rooitou_park_1k.hdr" --spacing 0.75
row sponza-crytek-sun "$assets/sponza-crytek/sponza.glb" 3 "$sun" --spacing 0.75
row sponza-dabrovic "$assets/sponza-dabrovic/sponza.obj" 3 "$sun --env $assets/hdri-polyhaven/venice_sunset_1k.hdr" --spacing 0.8
row lights-punctual-lamp "$assets/lights-punctual-lamp/LightsPunctualLamp.gltf" 3 "" --spacing 0.05
row cornell-bitterli "$assets/cornell-bitterli/cornell-bitterli.glb" 3 "--emission-sides front" --bounds=-1,0,-1,1,2,1 --spacing 0.1
row cornell-bitterli5 "$assets/cornell-bitterli/cornell-bitterli.glb" 5 "--emission-sides front" --bounds=-1,0,-1,1,2,1 --spacing 0.05
row house "$samples/house.glb" 5 "--env $samples/sky.hdr" --bounds=-10,0,-10,10,5,10 --spacing 0.5
row courtyard "$samples/courtyard.glb" 3 "--env $samples/sky.hdr" --spacing 2
row two_rooms_door "$samples/two_rooms_door.glb" 3 "" --spacing 0.25
row furnace "$samples/furnace.glb" 3 "" --bounds=-1,-1,-1,1,1,1 --spacing 0.25
