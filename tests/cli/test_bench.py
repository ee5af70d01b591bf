# SPDX-License-Identifier: Apache-2.0
"""lumivdb bench: rows, their meaning, the plot, and how it ends."""
import json
import os
import pathlib
import shutil
import signal
import struct
import subprocess
import time
import unittest

from harness import PROGRAM, SAMPLES, CliCase, run

FURNACE = SAMPLES / "furnace.glb"
KEYS = {"scene", "representation", "levels", "spacing", "bands", "gradients", "interpolation",
        "integrator", "bake_seconds", "seconds", "rays", "samples", "bytes", "query_ns", "rel_rmse", "p50",
        "p95", "p99", "reference_stderr", "pareto"}
SMALL = ("--quick", "--scene", FURNACE, "--spacing", "0.25", "--rays", "64", "--points", "30",
         "--reference-rays", "256")


class Help(unittest.TestCase):
    def test_every_flag_is_explained(self):
        code, out, err = run("bench", "--help")
        self.assertEqual((code, err), (0, ""))
        words = out.replace(",", " ").split()
        for flag in ("--scene --env --samples --quick --spacing --rays --points --reference-rays "
                     "--seed --contribution --plot --threads --json --quiet").split():
            self.assertIn(flag, words)
        options, examples = out.split("\nExamples:\n")
        self.assertLessEqual(max(map(len, options.splitlines())), 80)
        self.assertIn("lumivdb bench", examples)
        self.assertIn("bench", run("--help")[1].split())


class Rows(CliCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.plot = cls.folder / "bench.svg"
        options = ("--plot", cls.plot) if shutil.which("gnuplot") else ()
        code, out, err = run("bench", *SMALL, "--json", cls.folder / "b.json", *options)
        if code != 0:
            raise AssertionError(err)
        cls.table, cls.talk = out, err
        cls.rows = json.loads((cls.folder / "b.json").read_text())["rows"]

    def test_every_row_has_every_key(self):
        self.assertGreater(len(self.rows), 8)
        for row in self.rows:
            self.assertLessEqual(KEYS, set(row))
            self.assertEqual(row["scene"], "furnace")
            propagated = row["representation"].startswith("lpv")
            self.assertEqual(row["integrator"] == "lpv", propagated)
            for key in ("bake_seconds", "rays", "samples", "bytes", "query_ns", "spacing"):
                self.assertGreater(row[key], 0, key)
            self.assertLess(0, row["p50"])
            self.assertLess(row["p50"], row["p95"])
            self.assertLess(row["p95"], row["p99"])

    def test_what_matters_is_covered(self):
        def seen(key):
            return {row[key] for row in self.rows}
        self.assertEqual(seen("representation"), {"uniform", "adaptive", "lpv",
                                                  "lpv-many", "lpv-open"})
        self.assertEqual(seen("gradients"), {"none", "central", "analytic"})
        self.assertLessEqual({"nearest", "trilinear", "idw", "taylor", "gradient", "tricubic"},
                             seen("interpolation"))
        self.assertLessEqual({3, 5}, seen("bands"))
        for row in self.rows:
            self.assertEqual(row["levels"] > 0, row["representation"] == "adaptive")
            if row["interpolation"] in ("taylor", "gradient", "tricubic"):
                self.assertNotEqual(row["gradients"], "none")

    def test_cached_volumes_are_those_of_paths(self):
        def volumes(integrator):
            return {(r["representation"], r["spacing"], r["threshold"], r["gradients"],
                     r["interpolation"]): r for r in self.rows
                    if r["integrator"] == integrator and r["bands"] == 3}
        path, cached = volumes("path"), volumes("cached")
        self.assertGreater(len(cached), 5)
        self.assertLessEqual(set(cached), set(path))
        for key, row in cached.items():
            if row["representation"] == "uniform":
                self.assertEqual(row["samples"], path[key]["samples"])

    def test_stages_are_the_whole_bake(self):
        for row in self.rows:
            seconds, cached = row["seconds"], row["integrator"] == "cached"
            self.assertEqual(set(seconds), {"solve", "trace", "refine", "verify"})
            self.assertAlmostEqual(sum(seconds.values()), row["bake_seconds"], places=6)
            self.assertGreater(seconds["trace"], 0, row)
            for stage in ("solve", "verify"):
                self.assertEqual(seconds[stage] > 0, cached, row)
            self.assertEqual(seconds["refine"] > 0, row["representation"] == "adaptive", row)

    def test_errors_are_those_of_noise(self):
        # L = 2 everywhere: whatever the cells are, only noise is left. Over N directions the
        # standard error of E is 1.8% * sqrt(4096 / N) at most (see the harness): 14.4% for the 64
        # of the volumes (interpolation averages it, gradients may double it), 7.2% for the
        # reference's 256.
        for row in self.rows:
            if row["integrator"] == "lpv":  # errs by more than noise
                continue
            self.assertLess(row["rel_rmse"], 0.4, row)
            self.assertGreater(row["rel_rmse"], 0.01, row)
            self.assertLess(row["reference_stderr"], 0.072)
            self.assertLess(row["rel_rmse"], row["p99"])

    def test_the_front_is_what_nothing_beats(self):
        for cost in ("bake_seconds", "bytes"):
            for row in self.rows:
                beaten = any(o[cost] <= row[cost] and o["rel_rmse"] <= row["rel_rmse"]
                             and (o[cost] < row[cost] or o["rel_rmse"] < row["rel_rmse"])
                             for o in self.rows)
                self.assertEqual(cost in row["pareto"], not beaten, row)
            self.assertTrue(any(cost in row["pareto"] for row in self.rows))

    def test_table_has_a_line_a_row(self):
        lines = self.table.splitlines()
        self.assertEqual(len(lines), len(self.rows) + 1)
        self.assertIn("rel_rmse", lines[0])
        for line, row in zip(lines[1:], self.rows):
            self.assertEqual(line.split()[3:5], [row["interpolation"], row["integrator"]])

    def test_progress_is_told(self):
        self.assertIn("bench furnace", self.talk)

    @unittest.skipUnless(shutil.which("gnuplot"), "needs gnuplot")
    def test_plot_is_an_svg_with_the_scene_in_it(self):
        text = self.plot.read_text()
        self.assertIn("<svg", text)
        self.assertIn("furnace", text)
        self.assertIn("adaptive", text)


class Plot(CliCase):
    @unittest.skipUnless(shutil.which("gnuplot"), "needs gnuplot")
    def test_names_are_data_not_commands(self):
        # A scene's name goes into the script, the plot's name to the file system alone.
        scene = self.folder / "x'; system('touch owned') `touch owned`.glb"
        shutil.copy(FURNACE, scene)
        target = self.folder / "p'`touch owned`.png"
        self.ok("bench", "--quick", "--scene", scene, "--spacing", "0.5", "--rays", "4",
                "--points", "4", "--reference-rays", "16", "--plot", target, "--quiet",
                cwd=self.folder)
        self.assertFalse((self.folder / "owned").exists())
        data = target.read_bytes()
        self.assertEqual(data[:8], b"\x89PNG\r\n\x1a\n")
        width, height = struct.unpack(">II", data[16:24])
        self.assertEqual((width, height), (960, 340))

    def test_without_gnuplot_it_says_what_to_do_before_the_work(self):
        begun = time.monotonic()
        done = subprocess.run([PROGRAM, "bench", "--plot", self.folder / "p.png"], check=False,
                              capture_output=True, text=True, timeout=300,
                              env={**os.environ, "PATH": str(self.folder)})
        self.assertEqual(done.returncode, 4)
        self.assertIn("gnuplot", done.stderr)
        self.assertLess(time.monotonic() - begun, 5)
        self.assertEqual(done.stdout, "")

    def test_a_failing_gnuplot_is_reported(self):
        fake = self.folder / "bin" / "gnuplot"
        fake.parent.mkdir()
        fake.write_text("#!/bin/sh\necho it hurts >&2\nexit 3\n")
        fake.chmod(0o755)
        target = self.folder / "never.png"
        done = subprocess.run([PROGRAM, "bench", "--quick", "--scene", FURNACE, "--spacing", "0.5",
                               "--rays", "4", "--points", "4", "--reference-rays", "16", "--plot",
                               target], check=False, capture_output=True, text=True, timeout=300,
                              env={**os.environ, "PATH": f"{fake.parent}:/usr/bin:/bin"})
        self.assertEqual(done.returncode, 4)
        self.assertIn("it hurts", done.stderr)
        self.assertFalse(target.exists())

    def test_other_formats_are_refused(self):
        self.fails(2, "bench", "--plot", "x.gif", says=["--plot x.gif", ".png or .svg"])


class Ends(CliCase):
    def test_usage(self):
        self.fails(3, "bench", "--samples", self.folder, says=["--samples"])
        self.fails(2, "bench", "--env", SAMPLES / "sky.hdr", says=["--env", "--scene"])
        self.fails(2, "bench", "--samples", self.folder, "--scene", FURNACE, says=["--samples"])
        self.fails(3, "bench", "--scene", self.folder / "absent.glb", says=["absent.glb"])
        self.fails(2, "bench", "--spacing", "0", says=["--spacing 0"])

    def test_interrupt_leaves_nothing(self):
        report = self.folder / "never.json"
        with subprocess.Popen([PROGRAM, "bench", "--samples", SAMPLES, "--json", report],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            self.assertTrue(process.stderr.readline(), "ended before it could be interrupted")
            self.assertIsNone(process.poll(), "ended before it could be interrupted")
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
        self.assertEqual((process.returncode, out), (130, ""))
        self.assertIn("nterrupted", err)
        self.assertFalse(report.exists())


if __name__ == "__main__":
    unittest.main()
