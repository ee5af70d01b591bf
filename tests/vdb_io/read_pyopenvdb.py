#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Reads a LumiVDB file with OpenVDB's Python module, an independent reader.

usage: read_pyopenvdb.py TEST_VDB_IO    (the test program, which writes the file)
Exit code 77: skipped, the module is not installed.
"""

import math
import os
import subprocess
import sys
import tempfile

try:
    import pyopenvdb
except ImportError:
    print("skipped: the Python module pyopenvdb (Debian: python3-openvdb) is not installed")
    sys.exit(77)


def irradiance(coefficients, n):
    """E(n) of three bands of radiance coefficients: Σ A_l L_lm Y_lm(n)."""
    x, y, z = n
    basis = [
        0.28209479177387814,
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * z * z - 1),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)]
    lobe = [math.pi] + [2 * math.pi / 3] * 3 + [math.pi / 4] * 5
    return [sum(a * b * c[k] for a, b, c in zip(lobe, basis, coefficients)) for k in range(3)]


def main(program):
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "sample.vdb")
        subprocess.run([program, "[.write-sample]"], check=True, stdout=subprocess.DEVNULL,
                       env=dict(os.environ, LUMIVDB_TEST_FILE=path))

        assert "lumivdb_footer" in pyopenvdb.readMetadata(path)
        # The module knows Float, Bool and Vec3S grids alone, so readAll() fails on `level` (Int32);
        # grids are read by name.
        names = ["color", "density", "validity", "distance"] + [f"sh_{i}" for i in range(9)]
        names += ["offset", "wall_0", "wall_1", "wall_2", "wall_offset"]
        by_name = {name: pyopenvdb.read(path, name) for name in names}

        for name, grid in by_name.items():
            assert grid["lumivdb_version"] == 1, name
            assert grid["lumivdb_bands"] == 3, name
            assert grid["lumivdb_quantity"] == "radiance", name
            assert grid["lumivdb_rays"] == 4096, name
            assert grid.evalActiveVoxelBoundingBox()[0] == (0, 0, 0), name

        def value(name, point):
            return by_name[name].getConstAccessor().getValue(point)

        point = (7, 2, 5)
        assert value("sh_0", point) == (8.0, 4.0, 8.0)
        assert value("sh_5", point) == (5.0, 0.0, 0.0)
        assert value("sh_0", (12, 10, 9)) == (13.0, 12.0, 12.0), "the upper corner sample"
        assert value("validity", (2, 3, 4)) == 0.0 and value("validity", point) == 1.0
        assert value("distance", (0, 0, 0)) == math.inf and value("distance", point) == 2.5
        assert value("offset", (1, 2, 3)) == (0.0, 0.125, -0.5)
        assert value("offset", point) == (0.0, 0.0, 0.0)
        wall = value("wall_0", point)
        assert max(abs(a - b) for a, b in zip(wall, (0, 0.6, 0.8))) < 1e-7, wall
        assert value("wall_1", point) == (0.0, 1.0, 0.0)
        assert value("wall_offset", point) == (0.0, 0.0, -0.25)
        assert value("wall_0", (0, 0, 0)) == (0.0, 0.0, 0.0), "a cell without walls"
        assert by_name["sh_0"].metadata["lumivdb_cut_cells"] == 1
        assert by_name["sh_0"].transform.indexToWorld(point) == (3.5, 1.0, 2.5)
        assert by_name["sh_0"].activeVoxelCount() == 13 * 11 * 10

        # Looking along +z at this point: only m = 0 terms and the constant remain.
        coefficients = [value(f"sh_{i}", point) for i in range(9)]
        red = irradiance(coefficients, (0, 0, 1))[0]
        by_hand = (math.pi * 8 * 0.28209479177387814
                   + 2 * math.pi / 3 * 2 * 0.4886025119029199
                   + math.pi / 4 * 6 * 0.31539156525252005 * 2)
        assert abs(red - by_hand) < 1e-12, (red, by_hand)
        print(f"read {len(names)} grids; E at {point} along +z is {red:.6f}")


if __name__ == "__main__":
    main(sys.argv[1])
