#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# The tour in one command: installs what is missing, builds, bakes a shipped scene, and shows what
# is in the volume and how far it is from the truth. Results in demo_output/.
set -euo pipefail
cd "$(dirname "$0")"

./install_packages.sh
echo "Building (a few minutes the first time) ..."
log=$(mktemp)
trap 'rm -f "$log"' EXIT
if ! { cmake --preset release &&
    cmake --build --preset release --target lumivdb_cli; } >"$log" 2>&1; then
    cat "$log"
    exit 1
fi

lumivdb=build/release/lumivdb
mkdir -p demo_output
run() { # prints a command as it could be typed, then runs it
    printf '\n\033[1m$ %s\033[0m\n' "$*"
    "$@"
}

run $lumivdb bake samples/house.glb --env samples/sky.hdr --spacing 0.5 \
    --bounds -10,0,-10,10,5,10 --bands 5 --rays 1024 -o demo_output/house.vdb
run $lumivdb stats demo_output/house.vdb
run $lumivdb evaluate demo_output/house.vdb --scene samples/house.glb --env samples/sky.hdr \
    --points 300 --rays 2048
printf '0,1.5,-1,0,1,0\n0,1.5,2.85,0,1,0\n0,1.5,5,0,1,0\n' >demo_output/points.csv
echo
echo "Irradiance facing up at three points: in the room, in the doorway, outside"
run $lumivdb query demo_output/house.vdb --points demo_output/points.csv
run $lumivdb render samples/house.glb --env samples/sky.hdr --volume demo_output/house.vdb \
    -o demo_output/house.png
run $lumivdb render samples/house.glb --env samples/sky.hdr --volume demo_output/house.vdb \
    --slice y=1.5 -o demo_output/house_slice.png
run $lumivdb bake samples/house.glb --env samples/sky.hdr --bounds -10,0,-10,10,5,10 \
    --target-error 0.1 -o demo_output/target.vdb
run $lumivdb evaluate demo_output/target.vdb --scene samples/house.glb --env samples/sky.hdr \
    --points 1000 --rays 4096
echo
echo "Made: demo_output/house.vdb and target.vdb (open in Blender and Houdini), house.png," \
    "house_slice.png"
