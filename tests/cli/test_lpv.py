# SPDX-License-Identifier: Apache-2.0
"""lumivdb lpv: its contract, its volumes in all other commands, walls, and what it refuses."""
import math
import signal
import subprocess
import unittest

import vdb_bytes as vb
from harness import PROGRAM, SAMPLES, CliCase, heavy

ROOMS = SAMPLES / "two_rooms.glb"
CORNELL = SAMPLES / "cornell_box.glb"
SIX_NORMALS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


class Lpv(CliCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.volume = cls.folder / "rooms.vdb"
        cls.report = cls.json(cls(), "lpv", ROOMS, "--spacing", "0.5", "-o", cls.volume, "--quiet")

    def lpv(self, name, *options, scene=ROOMS, spacing="0.5"):
        path = self.folder / name
        self.ok("lpv", scene, "--spacing", spacing, "-o", path, "--quiet", *options)
        return path

    def mean_irradiance(self, volume, x0, x1):
        """Of the green channel, over six normals and places half a metre off the rooms' walls."""
        points = [f"{x0 + (x1 - x0) * i / 4},{0.5 + j},{k - 1.5},{nx},{ny},{nz}"
                  for i in range(5) for j in range(3) for k in range(4)
                  for nx, ny, nz in SIX_NORMALS]
        rows = self.csv("query", volume, "--points", "-", stdin="\n".join(points))
        self.assertEqual(len(rows), 5 * 3 * 4 * 6)
        return sum(float(row["Eg"]) for row in rows) / len(rows)

    def leak(self, volume):
        """Light in the dark room as a share of the lit one's."""
        lit, dark = (self.mean_irradiance(volume, x, x + 3) for x in (-3.5, 0.5))
        self.assertGreater(lit, 0)
        return dark / lit

    def test_report(self):
        r = self.report
        for key in ("samples", "cells_by_level", "surfels", "blockers", "iterations", "residual",
                    "decisions", "warnings", "file_bytes"):
            self.assertIn(key, r)
        self.assertEqual(set(r["seconds"]), {"load", "build", "rsm", "inject", "propagate",
                                             "samples", "write"})
        # The rooms and a cell more all round: 9 x 4 x 5 metres, 18 x 8 x 10 cells of half a metre.
        self.assertEqual(r["samples"], 19 * 9 * 11)
        self.assertEqual(r["cells_by_level"], [18 * 8 * 10])
        # The map of area lights has 256 x 256 texels, all of which end on a wall.
        self.assertEqual(r["surfels"], 256 * 256)
        self.assertEqual(r["surfels_outside"], 0)
        self.assertGreater(r["blockers"], 1000)
        self.assertLess(r["residual"], 1e-3)
        self.assertEqual(r["warnings"], [])

    def test_stats(self):
        stats = self.json("stats", self.volume)
        self.assertEqual((stats["bands"], stats["gradients"]), (2, False))
        self.assertEqual(stats["contribution"], "indirect")
        self.assertEqual(stats["samples"], self.report["samples"])
        self.assertIn("lumivdb lpv", stats["options"])
        self.assertIn("--spacing 0.5", stats["options"])

    @heavy
    def test_options_reproduce_a_chosen_spacing(self):
        path = self.folder / "chosen.vdb"
        report = self.json("lpv", CORNELL, "-o", path, "--rsm", "16", "--quiet")
        self.assertIn("spacing", report["decisions"][0])
        self.assertIn("--spacing 0.02", self.json("stats", path)["options"])

    @heavy
    def test_other_commands_take_it(self):
        rows = self.csv("query", self.volume, "--points", "-", "--sh", stdin="-2,1,0,0,1,0\n")
        self.assertGreater(float(rows[0]["Eg"]), 0)
        self.assertIn("sh_3_b", rows[0])
        error = self.json("evaluate", self.volume, "--scene", ROOMS, "--points", "50", "--rays",
                          "256", "--quiet")
        self.assertTrue(math.isfinite(error["rel_rmse"]))
        picture = self.folder / "rooms.png"
        self.ok("render", ROOMS, "--volume", self.volume, "-o", picture, "--quiet")
        self.assertEqual(picture.read_bytes()[1:4], b"PNG")
        double = self.folder / "double.vdb"
        self.ok("resample", "--add", f"{self.volume}=2", "-o", double, "--quiet")
        single, twice = (float(self.csv("query", v, "--points", "-",
                                        stdin="-2,1,0,0,1,0\n")[0]["Eg"])
                         for v in (self.volume, double))
        self.assertAlmostEqual(twice / single, 2, places=5)

    def test_up_z_turns_the_light(self):
        turned = self.lpv("z.vdb", "--up", "z")
        one = self.csv("query", self.volume, "--points", "-", stdin="-2,1,0.5,0,1,0\n")[0]
        other = self.csv("query", turned, "--points", "-", stdin="-2,-0.5,1,0,0,1\n")[0]
        self.assertAlmostEqual(float(other["Eg"]) / float(one["Eg"]), 1, places=4)

    def test_threads_do_not_change_a_byte(self):
        def grids(name, *options):
            # The header has a UUID of its own, the metadata the command line.
            volume = self.lpv(name, "--rsm", "64", *options)
            return {name: rest for name, (_, rest)
                    in vb.parts_of_grids(volume.read_bytes()).items()}
        files = [grids(f"t{n}.vdb", "--threads", n) for n in ("1", "2", "4")]
        self.assertGreater(len(files[0]), 4)
        self.assertEqual(files[0], files[1])
        self.assertEqual(files[0], files[2])
        self.assertNotEqual(files[0], grids("s.vdb", "--seed", "2"))

    def test_the_wall_keeps_the_dark_room_dark(self):
        with_wall = self.leak(self.volume)
        without = self.leak(self.lpv("open.vdb", "--no-occlusion"))
        self.assertLess(with_wall, 0.02)
        self.assertGreater(without, 5 * with_wall)

    @heavy
    def test_all_light_is_indirect_and_direct(self):
        """Direct light in two bands is what a bake of two bands has, to both traces' noise."""
        point = "-2,0.5,0.5,0,1,0\n"
        value = {}
        for name, volume in (
                ("all", self.lpv("all.vdb", "--contribution", "all", "--rays", "4096")),
                ("indirect", self.volume)):
            value[name] = float(self.csv("query", volume, "--points", "-", stdin=point)[0]["Eg"])
        direct = self.folder / "direct.vdb"
        self.ok("bake", ROOMS, "--spacing", "0.5", "--bands", "2", "--contribution", "direct",
                "--rays", "4096", "-o", direct, "--quiet")
        expected = float(self.csv("query", direct, "--points", "-", stdin=point)[0]["Eg"])
        self.assertGreater(expected, 0.1)
        self.assertAlmostEqual((value["all"] - value["indirect"]) / expected, 1, delta=0.03)
        self.assertEqual(self.json("stats", self.folder / "all.vdb")["contribution"], "all")

    def test_more_bounces_bring_more_light(self):
        one = self.mean_irradiance(self.volume, -3.5, -0.5)
        many = self.mean_irradiance(self.lpv("many.vdb", "--bounces", "many"), -3.5, -0.5)
        self.assertGreater(many, 1.2 * one)

    @heavy
    def test_cascades(self):
        path = self.folder / "cascades.vdb"
        report = self.json("lpv", SAMPLES / "courtyard.glb", "--sun-direction", "1,2,0.5",
                           "--sun-lux", "80", "--cascades", "3", "--cells", "24", "--center",
                           "0,2,0", "--spacing", "0.5", "--rsm", "64", "--rays", "8", "-o", path,
                           "--quiet")
        self.assertEqual(len(report["cells_by_level"]), 3)
        self.assertEqual(self.json("stats", path)["samples"], report["samples"])
        # Levels change at x = 3 and 6: the same light on both sides, and in all of the volume some.
        line = "\n".join(f"{x},2.1,0.3,0,1,0" for x in (2.99999, 3.00001, 5.99999, 6.00001, 1, 11))
        rows = self.csv("query", path, "--points", "-", stdin=line)
        self.assertEqual([int(r["level"]) for r in rows], [0, 1, 1, 2, 0, 2])
        E = [float(r["Eg"]) for r in rows]
        self.assertGreater(min(E), 1)
        for a, b in ((E[0], E[1]), (E[2], E[3])):
            self.assertLess(abs(a - b), 1e-3 * max(E))

    def test_no_light_is_black_and_said(self):
        report = self.json("lpv", CORNELL, "--spacing", "0.1", "--light-group", "environment",
                           "-o", self.folder / "black.vdb", "--quiet", "--env",
                           SAMPLES / "sky.hdr", "--env-scale", "0")
        self.assertTrue(any("black" in w for w in report["warnings"]), report["warnings"])
        self.assertEqual(report["surfels"], 0)

    def test_fewer_surfels(self):
        path = self.folder / "few.vdb"
        report = self.json("lpv", ROOMS, "--spacing", "0.5", "--surfels", "2000", "-o", path,
                           "--quiet")
        self.assertLessEqual(report["surfels"], 2000)
        self.assertGreater(report["surfels"], 1900)
        few, all_of_them = (self.mean_irradiance(v, -3.5, -0.5) for v in (path, self.volume))
        self.assertAlmostEqual(few / all_of_them, 1, delta=0.03)


class Refused(CliCase):
    def test_bad_values(self):
        out = self.folder / "x.vdb"
        for options, says in (
                (("--spacing", "0"), "--spacing 0"), (("--cascades", "9"), "1 to 8"),
                (("--iterations", "-1"), "--iterations -1"), (("--rsm", "0"), "--rsm 0"),
                (("--rsm", "1e3"), "--rsm 1e3"), (("--tolerance", "1"), "--tolerance 1"),
                (("--scheme", "fast"), "clamped|conservative"),
                (("--contribution", "direct"), "indirect|all"), (("--bounces", "2"), "one|many"),
                (("--rays", "1"), "--rays 1"), (("--center", "0,0"), "--center"),
                (("--bands", "3"), "--bands"), (("--rays", "0", "--contribution", "all"), "--rays"),
                (("--no-occlusion", "--bounces", "many"), "--no-occlusion"),
                (("--center", "0,0,0"), "--cascades"), (("--cells", "32"), "--cascades"),
                (("--cascades", "2", "--cells", "25"), "multiple of 8"),
                (("--cascades", "2", "--bounds", "0,0,0,1,1,1"), "--center")):
            with self.subTest(options=options):
                self.fails(2, "lpv", ROOMS, "-o", out, *options, says=[says])
                self.assertFalse(out.exists())
        self.fails(2, "lpv", ROOMS)

    def test_missing_scene_and_folder(self):
        self.fails(3, "lpv", "absent.glb", "-o", self.folder / "x.vdb", says=["absent.glb"])
        self.fails(4, "lpv", ROOMS, "-o", self.folder / "no" / "x.vdb", says=["no"])

    def test_far_too_fine_a_spacing_is_said(self):
        self.fails(2, "lpv", ROOMS, "--spacing", "0.001", "-o", self.folder / "x.vdb",
                   says=["2^31"])

    def test_interrupt(self):
        out = self.folder / "interrupted.vdb"
        with subprocess.Popen([PROGRAM, "lpv", SAMPLES / "courtyard.glb", "--env",
                               SAMPLES / "sky.hdr", "--rays", "1000000", "-o", out],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            self.assertTrue(process.stderr.readline(), "ended before it could be interrupted")
            process.send_signal(signal.SIGINT)
            err = process.communicate(timeout=60)[1].decode()
        self.assertEqual(process.returncode, 130)
        self.assertIn("nterrupted", err.splitlines()[-1])
        self.assertFalse(out.exists())


if __name__ == "__main__":
    unittest.main()
