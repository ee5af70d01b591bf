#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Opens a LumiVDB file in Blender without a window and reads voxels back.

usage: read_blender.py TEST_VDB_IO    (the test program, which writes the file)
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
        path = os.path.join(folder, "sample.vdb")
        subprocess.run([program, "[.write-sample]"], check=True, stdout=subprocess.DEVNULL,
                       env=dict(os.environ, LUMIVDB_TEST_FILE=path))
        return subprocess.run([blender, "-b", "--factory-startup", "-noaudio",
                               "--python-exit-code", "1", "-P", __file__, "--", path]).returncode


def inside(path):
    sys.path.insert(0, HERE)
    import blender_tools

    volume = blender_tools.import_volume(path)
    grids = volume.data.grids
    names = [grid.name for grid in grids]
    expected = ["color", "density", "distance", "level", "mask_0", "mask_1", "offset"]
    expected += [f"sh_{i}" for i in range(9)] + ["validity"]
    expected += ["wall_0", "wall_1", "wall_2", "wall_offset"]
    assert names == expected, names  # Blender sorts by name
    assert grids[grids.active_index].name == "color", "the default grid is the preview"
    types = {grid.name: grid.data_type for grid in grids}
    assert types["sh_0"] == "VECTOR_FLOAT" and types["level"] == "INT", types
    assert types["validity"] == types["density"] == "FLOAT", types
    # The matrix as in the file: spacing 0.5, no rotation (Blender leaves the up axis alone).
    matrix = {grid.name: grid.matrix_object for grid in grids}["sh_0"]
    assert [matrix[i][i] for i in range(3)] == [0.5] * 3 and matrix.translation.length == 0
    assert tuple(volume.rotation_euler) == (0, 0, 0)

    # sh_0 is (1 + x, 2 + y, 3 + z) at lattice point (x, y, z), sh_5 is (5, 0, 0): their quotient
    # is free of the length of the ray. Cycles draws voxel i around (i + 1/2) * spacing.
    linear = blender_tools.render(volume, "sh_0", (3.2, 2.7), 8.0)
    constant = blender_tools.render(volume, "sh_5", (3.2, 2.7), 8.0)
    assert constant.total() > 0
    for x, y in ((1, 1), (4, 2), (7, 8), (11, 5)):
        at = ((x + 0.5) * 0.5, (y + 0.5) * 0.5)
        length = constant.value(*at)[0] / 5
        red, green, blue = (v / length for v in linear.value(*at))
        print(f"voxel ({x}, {y}, z): ({red:.3f}, {green:.3f}, mean {blue:.3f})")
        # Pixel centres lie on voxel centres; what is left is the step along the ray.
        assert abs(red - (1 + x)) < 0.03 and abs(green - (2 + y)) < 0.03
        assert abs(blue - (3 + 4.5)) < 0.03
    print("read by Blender")


if __name__ == "__main__":
    if "--" in sys.argv:
        inside(sys.argv[sys.argv.index("--") + 1])
    else:
        sys.exit(outside(sys.argv[1]))
