#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Tries the known traps of volume grids in Blender on our own files and prints what a user sees.

usage: blender_traps.py TEST_VDB_IO    (the test program, which writes the files)
The results are in docs/BLENDER.md. Fails where Blender behaves otherwise than written there.
Exit code 77: skipped, Blender is not installed.
"""

import os
import shutil
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))


def outside(program):
    blender = shutil.which("blender")
    if not blender:
        print("skipped: Blender is not installed")
        return 77
    with tempfile.TemporaryDirectory() as folder:
        for test in ("sample", "coarse", "up-y", "up-z"):
            subprocess.run([program, f"[.write-{test}]"], check=True, stdout=subprocess.DEVNULL,
                           env=dict(os.environ, LUMIVDB_TEST_FILE=f"{folder}/{test}.vdb"))
        return subprocess.run([blender, "-b", "--factory-startup", "-noaudio",
                               "--python-exit-code", "1", "-P", __file__, "--",
                               folder]).returncode


def tiles(tools, folder):
    """One cell of 16³ steps of spacing 1: every channel has tiles, the preview has voxels."""
    volume = tools.import_volume(f"{folder}/coarse.vdb")
    channel = tools.render(volume, "sh_0", (8, 8), 20)
    preview = tools.render(volume, "color", (8, 8), 20)
    # No leaf of sh_0 lies on the ray through (12, 12), only tiles.
    print(f"RESULT tiles: inside a coarse cell sh_0 draws {channel.value(12, 12)[0]:.3f}, color "
          f"draws {preview.value(12, 12)[0]:.3f}")
    # The value is 1 in both, times Y0 in the preview, along 16 steps (and interpolation's rim).
    assert abs(channel.value(12, 12)[0] - 16) < 1.1
    assert abs(preview.value(12, 12)[0] / 0.28209479 - 16) < 1.1


def leafless(tools, folder):
    try:
        import pyopenvdb
    except ImportError:
        print("RESULT leafless: not tried, Blender's Python has no pyopenvdb")
        return
    grid = pyopenvdb.FloatGrid()
    grid.name = "density"
    grid.fill((0, 0, 0), (127, 127, 127), 1.0)  # one tile
    assert grid.leafCount() == 0
    pyopenvdb.write(f"{folder}/leafless.vdb", grids=[grid])
    volume = tools.import_volume(f"{folder}/leafless.vdb")
    total = tools.render(volume, "density", (64, 64), 256, 32).total()
    print(f"RESULT leafless: a grid of one tile and no leaf draws {total:.3f}")
    assert total == 0


def shared_tree(tools, folder):
    try:
        import pyopenvdb
    except ImportError:
        print("RESULT shared tree: not tried, Blender's Python has no pyopenvdb")
        return
    first = pyopenvdb.read(f"{folder}/sample.vdb", "sh_0")
    second = first.copy()  # shares the tree
    second.name = "sh_1"
    third = first.deepCopy()
    third.name = "sh_2"
    pyopenvdb.write(f"{folder}/shared.vdb", grids=[first, second, third])
    volume = tools.import_volume(f"{folder}/shared.vdb")
    drawn = {name: tools.render(volume, name, (3.2, 2.7), 8).total() > 0
             for name in ("sh_0", "sh_1", "sh_2")}
    print(f"RESULT shared tree: drawn are {drawn} where sh_1 shares the tree of sh_0")
    assert all(drawn.values())
    volume = tools.import_volume(f"{folder}/sample.vdb")
    ours = [tools.render(volume, f"sh_{i}", (3.2, 2.7), 8).total() > 0 for i in range(9)]
    print(f"RESULT our channels, each with its own tree: all drawn: {all(ours)}")
    assert all(ours)


def half_voxel(tools, folder):
    """sh_0 is (1 + x, ...) at index x, spacing 0.5: at world x it should be 1 + x / 0.5."""
    volume = tools.import_volume(f"{folder}/sample.vdb")
    at = (3.05, 2.55)
    linear = tools.render(volume, "sh_0", (3.2, 2.7), 8).value(*at)[0]
    length = tools.render(volume, "sh_5", (3.2, 2.7), 8).value(*at)[0] / 5
    index = linear / length - 1
    shift = (at[0] / 0.5 - index) * 0.5
    volume.location = (-0.25, -0.25, -0.25)
    moved = tools.render(volume, "sh_0", (3.2, 2.7), 8).value(*at)[0]
    again = tools.render(volume, "sh_5", (3.2, 2.7), 8).value(*at)[0] / 5
    after = (at[0] / 0.5 - (moved / again - 1)) * 0.5
    print(f"RESULT half voxel: drawn {shift:.3f} too far along x with a spacing of 0.5; "
          f"{after:.3f} after moving the object by half a voxel back")
    assert abs(shift - 0.25) < 0.02 and abs(after) < 0.02


def up_axis(tools, folder):
    """Light fills x in [0, 2], y (up) in [0, 6], z in [0, 2] of a Y-up scene."""
    for name in ("up-y", "up-z"):
        volume = tools.import_volume(f"{folder}/{name}.vdb")
        above = tools.render(volume, "color", (0, 0), 16, along="y")  # image: x right, z up
        high, back = above.value(1, 5)[0], above.value(1, -1)[0]
        low = above.value(1, 1)[0]
        print(f"RESULT up axis, {name}: drawn at height 1: {low:.3f}, at height 5: {high:.3f}, "
              f"below the floor: {back:.3f}")
        assert low > 0 and back == 0
        assert (high > 0) == (name == "up-z")


def inside(folder):
    sys.path.insert(0, HERE)
    import blender_tools
    for trap in (tiles, leafless, shared_tree, half_voxel, up_axis):
        trap(blender_tools, folder)
    print("all traps as documented")


if __name__ == "__main__":
    if "--" in sys.argv:
        inside(sys.argv[sys.argv.index("--") + 1])
    else:
        sys.exit(outside(sys.argv[1]))
