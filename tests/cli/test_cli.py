# SPDX-License-Identifier: Apache-2.0
"""What the command line promises to scripts: names, flags, exit codes, JSON keys, CSV columns."""
import json
import math
import os
import signal
import subprocess
import unittest

from harness import PROGRAM, SAMPLES, CliCase, run

FURNACE = SAMPLES / "furnace.glb"
SKY = SAMPLES / "sky.hdr"

# Flags that each sub-command must name in its help.
FLAGS = {
    "bake": "-o --env --env-scale --env-rotate --bounds --spacing --levels --bands --gradients "
            "--visibility --target-error --confidence --max-samples --refine --refine-threshold "
            "--part --rays --max-bounces --contribution --integrator --up --half --codec "
            "--light-group --json --threads --seed --quiet",
    "probe": "--points --rays --bands --env --contribution --json --threads --seed",
    "query": "--points --mode --normal-bias --sh --json",
    "stats": "--json",
    "evaluate": "--scene --env --points --rays --mode --max-error --points-file --json --threads "
                "--seed",
    "project": "--bands --irradiance --shader",
    "resample": "-o --spacing --uniform --levels --tolerance --bands --gradients --crop --up "
                "--transform --half --scale --add",
    "lpv": "-o --spacing --cascades --cells --center --bounds --iterations --tolerance --scheme "
           "--no-occlusion --bounces --rsm --surfels --contribution --rays --visibility --env "
           "--env-scale --env-rotate --light-group --up --half --codec --seed --threads --json "
           "--quiet",
    "render": "--volume -o",
}


class Help(unittest.TestCase):
    def test_every_command_names_every_flag(self):
        for command, flags in FLAGS.items():
            code, out, err = run(command, "--help")
            self.assertEqual((code, err), (0, ""), command)
            words = out.replace(",", " ").replace("[", " ").replace("=", " ").split()
            for flag in flags.split():
                self.assertIn(flag, words, f"lumivdb {command} --help")

    def test_top_level_help_lists_the_commands(self):
        code, out, _ = run("--help")
        self.assertEqual(code, 0)
        for command in FLAGS:
            self.assertIn(command, out.split())

    def test_version(self):
        code, out, _ = run("--version")
        self.assertEqual(code, 0)
        self.assertRegex(out, r"\d+\.\d+\.\d+")


class Usage(CliCase):
    def test_no_command(self):
        code, _, err = run()
        self.assertEqual(code, 2)
        self.assertNotEqual(err, "")

    def test_unknown_command_suggests_the_nearest(self):
        self.assertIn("bake", self.fails(2, "bkae"))
        self.assertIn("evaluate", self.fails(2, "evalute"))

    def test_unknown_option_suggests_the_nearest(self):
        self.assertIn("--spacing",
                      self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--spaicng", "1"))
        self.assertIn("--points", self.fails(2, "query", "x.vdb", "--point", "p.csv"))

    def test_numbers_are_parsed_strictly(self):
        out = self.folder / "never.vdb"
        for option, value in (("--rays", "16k"), ("--rays", "1.5"), ("--rays", ""), ("--rays", "0"),
                              ("--rays", "-4"), ("--spacing", "1m"), ("--spacing", "nan"),
                              ("--spacing", "inf"), ("--spacing", "-1"), ("--bands", "7"),
                              ("--bands", "0"), ("--bounds", "0,0,0,1,1"),
                              ("--bounds", "1,1,1,0,0,0"), ("--seed", "one"),
                              ("--threads", "0x2"), ("--contribution", "most"), ("--up", "x"),
                              ("--codec", "rar"), ("--gradients", "exact")):
            with self.subTest(option=option, value=value):
                self.assertIn(option, self.fails(2, "bake", FURNACE, "-o", out, f"{option}={value}"))
                self.assertFalse(out.exists())

    def test_required_options(self):
        self.fails(2, "bake", FURNACE)
        self.fails(2, "bake", "-o", self.folder / "x.vdb")
        self.fails(2, "query", "x.vdb")
        self.fails(2, "evaluate", "x.vdb")


class Errors(CliCase):
    def test_missing_input_is_named(self):
        missing = self.folder / "absent.glb"
        for args in (("bake", missing, "-o", self.folder / "x.vdb"), ("stats", missing),
                     ("query", missing, "--points", "-"), ("project", missing, "--bands", "3"),
                     ("probe", missing, "--points", "-"),
                     ("bake", FURNACE, "--env", missing, "-o", self.folder / "x.vdb")):
            with self.subTest(command=args[0]):
                self.fails(3, *args, says=[missing], stdin="0,0,0\n")

    def test_broken_scene(self):
        broken = self.folder / "broken.glb"
        data = FURNACE.read_bytes()
        for size in (0, 4, 12, 20, 100, len(data) - 1):
            broken.write_bytes(data[:size])
            with self.subTest(size=size):
                self.fails(3, "bake", broken, "-o", self.folder / "x.vdb", says=[broken])

    def test_output_that_cannot_be_written(self):
        target = self.folder / "no_such_folder" / "x.vdb"
        self.fails(4, "bake", FURNACE, "-o", target, "--spacing", "0.5", "--rays", "4",
                   says=[target])

    def test_not_a_volume(self):
        other = self.folder / "text.vdb"
        other.write_text("not a volume\n")
        self.fails(3, "stats", other, says=[other])
        self.fails(3, "query", other, "--points", "-", says=[other], stdin="0,0,0\n")

    def test_interrupt_leaves_no_volume(self):
        target = self.folder / "interrupted.vdb"
        with subprocess.Popen([PROGRAM, "bake", SAMPLES / "courtyard.glb", "-o", target, "--env",
                               SKY, "--spacing", "1", "--rays", "65536"],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            self.assertTrue(process.stderr.readline(), "ended before it could be interrupted")
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)
        self.assertEqual(process.returncode, 130)
        left = {p.name for p in self.folder.iterdir() if "interrupted" in p.name}
        self.assertEqual(left - {"interrupted.vdb.journal"}, set())


class Furnace(CliCase):
    """Numbers with a known answer: closed box, Le = 1, rho = 0.5, so L = 2 and E = 2 pi."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.volume = cls.bake_furnace("furnace.vdb")

    def test_bake_report(self):
        report = self.json("bake", FURNACE, "-o", self.folder / "report.vdb", "--spacing", "0.5",
                           "--bounds", "-0.5,-0.5,-0.5,0.5,0.5,0.5", "--rays", "16", "--quiet")
        for key in ("samples", "cells_by_level", "rays", "rays_per_second", "seconds",
                    "target_error", "achieved", "decisions", "warnings"):
            self.assertIn(key, report)
        for key in ("load", "build", "trace", "refine", "verify", "write"):
            self.assertIn(key, report["seconds"])
        # Nothing was asked, so nothing was measured.
        self.assertIsNone(report["target_error"])
        for key in ("rel_rmse", "confidence", "points"):
            self.assertIsNone(report["achieved"][key])
        self.assertEqual(report["samples"], 27)  # 1 m in steps of 0.5 m: 3 x 3 x 3 corners
        self.assertEqual(report["cells_by_level"], [8])
        self.assertGreaterEqual(report["rays"], 27 * 16)

    def test_talk_goes_to_stderr_and_quiet_is_quiet(self):
        args = ("bake", FURNACE, "-o", self.folder / "talk.vdb", "--spacing", "0.5", "--bounds",
                "-0.5,-0.5,-0.5,0.5,0.5,0.5", "--rays", "16")
        code, out, err = run(*args)
        self.assertEqual((code, out), (0, ""))
        self.assertNotEqual(err, "")
        self.assertEqual(run(*args, "--quiet"), (0, "", ""))

    def test_stats_keys(self):
        stats = self.json("stats", self.volume)
        for key in ("format_version", "bands", "gradients", "samples", "cells_by_level",
                    "leaf_nodes", "tiles_by_size", "spacing", "bounds", "file_bytes",
                    "runtime_bytes", "bytes_per_sample", "uniform_equivalent_samples", "channels",
                    "band_energy", "invalid_fraction", "negative_irradiance_fraction", "gradient",
                    "error", "options", "scene_hash", "cut_cells", "moved_samples"):
            self.assertIn(key, stats)
        for key in ("name", "type", "min", "max", "mean", "nan", "active_voxels", "tiles"):
            self.assertIn(key, stats["channels"][0])
        self.assertLessEqual({"p50", "p95", "max"}, set(stats["gradient"]))
        self.assertLessEqual({"asked", "reached", "confidence"}, set(stats["error"]))
        self.assertEqual((stats["samples"], stats["bands"]), (125, 3))
        self.assertAlmostEqual(stats["spacing"], 0.25)
        self.assertEqual(stats["file_bytes"], os.path.getsize(self.volume))
        self.assertEqual(stats["invalid_fraction"], 0)
        names = [c["name"] for c in stats["channels"]]
        for name in [f"sh_{i}" for i in range(9)] + ["level", "validity", "distance"]:
            self.assertIn(name, names)

    def test_stats_table_is_readable(self):
        out = self.ok("stats", self.volume)
        self.assertIn("125", out)
        self.assertNotIn("{", out)

    def test_query_columns_and_value(self):
        out = self.ok("query", self.volume, "--points", "-", stdin="0.1,0.2,0.3,0,1,0\n")
        self.assertEqual(out.splitlines()[0], "x,y,z,nx,ny,nz,Er,Eg,Eb,level,validity")
        row = self.csv("query", self.volume, "--points", "-", stdin="0.1,0.2,0.3,0,1,0\n")[0]
        for channel in ("Er", "Eg", "Eb"):
            self.assertAlmostEqual(float(row[channel]) / (2 * math.pi), 1.0, delta=0.07)
        self.assertEqual((row["level"], float(row["validity"])), ("0", 1.0))

    def test_query_looks_ahead_along_the_normal(self):
        def row(point, *options):
            return self.ok("query", self.volume, "--points", "-", *options,
                           stdin=point + ",0,1,0\n").splitlines()[1].split(",")[6:]
        self.assertEqual(row("0.1,0.2,0.3", "--normal-bias", "0.25"), row("0.1,0.45,0.3"))
        self.assertNotEqual(row("0.1,0.2,0.3"), row("0.1,0.45,0.3"))
        self.fails(2, "query", self.volume, "--points", "-", "--normal-bias", "-1")

    def test_query_without_normals_and_with_coefficients(self):
        points = "x,y,z\n0,0,0\n0.25,0.25,0.25\n"
        out = self.ok("query", self.volume, "--points", "-", stdin=points).splitlines()
        self.assertEqual(out[0], "x,y,z,level,validity")
        self.assertEqual(len(out), 3)
        out = self.ok("query", self.volume, "--points", "-", "--sh", stdin=points).splitlines()
        channels = ",".join(f"sh_{i}_{c}" for i in range(9) for c in "rgb")
        self.assertEqual(out[0], "x,y,z,level,validity," + channels)
        # L = 2 everywhere: L_00 = 2 sqrt(4 pi), all others vanish.
        row = [float(v) for v in out[1].split(",")[5:]]
        self.assertAlmostEqual(row[0] / (2 * math.sqrt(4 * math.pi)), 1.0, delta=0.045)
        self.assertLess(max(map(abs, row[3:])), 0.5)  # standard error sqrt(4 pi 2 / 4096) = 0.08

    def test_query_outside_invents_nothing(self):
        code, out, err = run("query", self.volume, "--points", "-",
                             stdin="9,9,9,0,1,0\n0,0,0,0,1,0\n")
        self.assertEqual(code, 0)
        row = out.splitlines()[1].split(",")
        self.assertEqual([v.lower() for v in row[6:10]], ["nan", "nan", "nan", "-1"])
        self.assertNotIn("nan", out.splitlines()[2].lower())
        self.assertRegex(err, r"\b1\b")

    def test_query_points_are_checked(self):
        for line in ("1,2", "a,b,c\nd,e,f", "1,2,3,4", "1;2;3", "0,0,0x1"):
            with self.subTest(line=line):
                code, _, err = run("query", self.volume, "--points", "-", stdin=line + "\n")
                self.assertIn(code, (2, 3))
                self.assertNotEqual(err, "")

    def test_query_json_is_the_same(self):
        points = "0.1,0.2,0.3,0,1,0\n9,9,9,0,1,0\n"
        objects = self.json("query", self.volume, "--points", "-", stdin=points)
        rows = self.csv("query", self.volume, "--points", "-", stdin=points)
        self.assertEqual(len(objects), 2)
        self.assertAlmostEqual(objects[0]["Er"], float(rows[0]["Er"]), delta=1e-5)
        self.assertEqual(objects[1]["level"], -1)

    def test_query_modes(self):
        values = {}
        for mode in ("nearest", "trilinear", "idw"):
            row = self.csv("query", self.volume, "--points", "-", "--mode", mode,
                           stdin="0.1,0.2,0.3,0,1,0\n")[0]
            values[mode] = float(row["Eg"])
            self.assertAlmostEqual(values[mode] / (2 * math.pi), 1.0, delta=0.07)
        self.fails(2, "query", self.volume, "--points", "-", "--mode", "gradient",
                   stdin="0,0,0\n")

    def test_evaluate(self):
        report = self.json("evaluate", self.volume, "--scene", FURNACE, "--points", "20", "--rays",
                           "4096", "--quiet")
        for key in ("rel_rmse", "rel_rmse_debiased", "upper95", "p50", "p95", "p99", "max", "bias",
                    "reference_stderr", "points", "normals", "mode", "query_ns", "worst"):
            self.assertIn(key, report)
        self.assertEqual(report["points"], 20)
        self.assertLess(report["rel_rmse"], 0.06)
        self.assertLessEqual({"position", "error"}, set(report["worst"][0]))

    def test_evaluate_bound(self):
        args = ("evaluate", self.volume, "--scene", FURNACE, "--points", "20", "--rays", "64",
                "--quiet", "--max-error")
        self.ok(*args, "0.5")
        self.fails(1, *args, "1e-9")

    def test_threads_do_not_change_the_light(self):
        points = "\n".join(f"{x},{y},0.1" for x in (-0.4, 0, 0.3) for y in (-0.2, 0.45))
        answers = set()
        for threads in ("1", "2"):
            path = self.bake_furnace(f"threads{threads}.vdb", "--threads", threads)
            answers.add(self.ok("query", path, "--points", "-", "--sh", stdin=points))
        self.assertEqual(len(answers), 1)

    def test_resample(self):
        coarse = self.folder / "coarse.vdb"
        self.ok("resample", self.volume, "-o", coarse, "--uniform", "--spacing", "0.5", "--quiet")
        self.assertEqual(self.json("stats", coarse)["samples"], 27)
        half = self.folder / "two_bands.vdb"
        self.ok("resample", self.volume, "-o", half, "--bands", "2", "--half", "--quiet")
        self.assertEqual(self.json("stats", half)["bands"], 2)

    def test_probe(self):
        rows = self.csv("probe", FURNACE, "--points", "-", "--rays", "4096", "--bands", "2",
                        "--quiet", stdin="0,0,0\n")
        expected = ["x", "y", "z", "validity", "distance", "stderr"] + [
            f"sh_{i}_{c}" for i in range(4) for c in "rgb"]
        self.assertEqual(list(rows[0]), expected)
        self.assertAlmostEqual(float(rows[0]["sh_0_r"]) / (2 * math.sqrt(4 * math.pi)), 1.0,
                               delta=0.05)
        self.assertEqual(float(rows[0]["validity"]), 1.0)


class Project(CliCase):
    def test_coefficients(self):
        answer = json.loads(self.ok("project", SKY, "--bands", "3"))
        self.assertEqual(answer["bands"], 3)
        self.assertEqual([len(c) for c in answer["coefficients"]], [3] * 9)
        # The sky is brighter above than below: Y1 = -0.4886 y is negative.
        self.assertLess(answer["coefficients"][1][1], 0)

    def test_irradiance_is_the_convolved_radiance(self):
        radiance = json.loads(self.ok("project", SKY, "--bands", "3"))["coefficients"]
        irradiance = json.loads(
            self.ok("project", SKY, "--bands", "3", "--irradiance"))["coefficients"]
        lobe = [math.pi] + [2 * math.pi / 3] * 3 + [math.pi / 4] * 5
        for a, L, E in zip(lobe, radiance, irradiance):
            for channel in range(3):
                self.assertAlmostEqual(a * L[channel], E[channel], delta=1e-4)

    def test_shader_constants(self):
        out = self.ok("project", SKY, "--bands", "3", "--shader")
        for name in ("cAr", "cAg", "cAb", "cBr", "cBg", "cBb", "cC"):
            self.assertIn(name, out)


if __name__ == "__main__":
    unittest.main()
