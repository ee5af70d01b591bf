# SPDX-License-Identifier: Apache-2.0
"""How the program behaves towards shells and scripts: streams, signals, points files, messages."""
import json
import os
import pathlib
import pty
import signal
import subprocess
import time
import unittest

import vdb_bytes as vb
from harness import PROGRAM, SAMPLES, CliCase, heavy, run

FURNACE = SAMPLES / "furnace.glb"
ROOMS = SAMPLES / "two_rooms_door.glb"
COMMANDS = ("bake", "probe", "query", "stats", "evaluate", "project", "resample", "lpv", "render",
            "bench")


def shell(script, **options):
    """Runs a bash line; $P is the program."""
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=300,
                          check=False, env={**os.environ, "P": str(PROGRAM)}, **options)
    return done.returncode, done.stdout, done.stderr


class Help(unittest.TestCase):
    def test_lines_fit_a_terminal_and_end_with_examples(self):
        for command in COMMANDS:
            code, out, _ = run(command, "--help")
            self.assertEqual(code, 0)
            options, examples = out.split("\nExamples:\n")
            self.assertLessEqual(max(map(len, options.splitlines())), 80, command)
            self.assertIn(f"lumivdb {command}", examples)
            self.assertIn(f"Usage: lumivdb {command}", options)

    def test_help_comes_before_missing_or_bad_options(self):
        code, out, err = run("bake", "--rays", "16k", "--help")
        self.assertEqual((code, err), (0, ""))
        self.assertEqual(out, run("help", "bake")[1])

    def test_no_command_prints_help_to_stderr(self):
        code, out, err = run()
        self.assertEqual((code, out), (2, ""))
        self.assertIn("Commands:", err)


class Usage(CliCase):
    def test_message_names_option_value_and_range(self):
        self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--rays", "16k",
                   says=["--rays 16k", "2 to 67108864"])
        self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--rays", "1e3", says=["--rays 1e3"])
        self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--rays", "64 ", says=["--rays"])
        self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--rays", "+64", says=["--rays"])
        self.fails(2, "bake", FURNACE, "-o", "x.vdb", "--spacing", "0.5m", says=["--spacing 0.5m"])

    def test_values_may_begin_with_a_minus(self):
        err = self.fails(3, "bake", "absent.glb", "-o", "x.vdb", "--bounds", "-1,-1,-1,1,1,1")
        self.assertIn("absent.glb", err)

    def test_an_option_twice_or_without_value(self):
        self.fails(2, "bake", FURNACE, "-o", "a.vdb", "-o", "b.vdb", says=["--output", "2 times"])
        self.fails(2, "bake", FURNACE, "-o", "a.vdb", "--rays", says=["--rays"])
        self.fails(2, "bake", FURNACE, "-o", "a.vdb", "--half=3", says=["--half"])
        self.fails(2, "bake", FURNACE, "extra", "-o", "a.vdb", says=["'extra'"])

    def test_suggestions(self):
        for args, wanted in ((("bkae",), "bake"), (("rendr",), "render"),
                             (("bake", "--spac", "1"), "--spacing"),
                             (("bake", "--ray=3"), "--rays"), (("query", "--sj"), "--sh")):
            self.fails(2, *args, says=[f"did you mean {wanted}?"])
        self.assertNotIn("did you mean", self.fails(2, "bake", "--qwertyuiop"))

    def test_a_cached_bake_reports_its_bias(self):
        files = []
        for threads in (1, 2):
            volume = self.folder / f"cached{threads}.vdb"
            report = self.json("bake", FURNACE, "-o", volume, "--spacing", "0.5", "--rays", "64",
                               "--integrator", "cached", "--threads", threads)
            files.append(volume.read_bytes())
        self.assertEqual(files[0], files[1])
        made = report["integrator"]
        self.assertEqual(made["name"], "cached")
        self.assertGreater(made["cache"]["patches"], 0)
        self.assertLess(made["bias"]["rms"], 0.02)
        stats = self.json("stats", self.folder / "cached2.vdb")
        self.assertEqual(stats["integrator"], "cached")
        self.assertEqual(stats["cache_bias"]["rms"], made["bias"]["rms"])

    def test_bad_values_of_refinement(self):
        integers, parts = "not an integer from 0 to 12, nor auto", "not I/N with 1 <= I <= N"
        name_value, numbers = "not NAME=V with a number V", "not a finite number"
        for option, value, word in (
                ("--levels", "-1", integers), ("--levels", "13", integers),
                ("--levels", "1.5", integers), ("--levels", "automatic", integers),
                ("--bands", "automatic", "not an integer from 1 to 6, nor auto"),
                ("--visibility", "maybe", "on|off"), ("--gradients", "exact", "analytic"),
                ("--target-error", "0", "1e-04 to 1"), ("--target-error", "1.5", "1e-04 to 1"),
                ("--target-error", "2%", numbers), ("--target-error", "nan", numbers),
                ("--confidence", "0.5", "0.51 to 0.9999"), ("--confidence", "1", "0.51 to 0.9999"),
                ("--max-samples", "999", "1000 to"), ("--max-samples", "1e4", "not an integer"),
                ("--refine", "errors", "'errors'"),
                ("--refine", "error,,brute", "''"),
                ("--refine-threshold", "error", name_value),
                ("--refine-threshold", "error=-1", name_value),
                ("--refine-threshold", "error=nan", name_value),
                ("--refine-threshold", "errors=1", "error|gradient|harmonic|brute|cull"),
                ("--refine-threshold", "geometry=0.5", "geometry=LEVEL"),
                ("--refine-threshold", "geometry=13", "geometry=LEVEL"),
                ("--part", "1", parts), ("--part", "0/2", parts), ("--part", "3/2", parts),
                ("--part", "1/2/3", parts), ("--part", "1/1000001", parts)):
            with self.subTest(option=option, value=value):
                self.fails(2, "bake", FURNACE, "-o", "x.vdb", f"{option}={value}",
                           says=[option, value, word])

    def test_options_that_need_each_other(self):
        bake = ("bake", FURNACE, "-o", "x.vdb")
        self.fails(2, *bake, "--env-rotate", "30", says=["--env"])
        self.fails(2, *bake, "--sun-lux", "3", says=["--sun-direction"])
        self.fails(2, *bake, "--sun-direction", "0,0,0", "--sun-lux", "1", says=["0,0,0"])
        self.fails(2, *bake, "--contribution", "indirect", "--max-bounces", "0", says=["no light"])
        self.fails(2, "probe", FURNACE, "--points", "-", "--gradients", "central", says=["--json"])
        self.fails(2, "project", "x.hdr", "--shader", "--json", "-", says=["--json FILE"])
        self.fails(2, "resample", "-o", "x.vdb", says=["IN.vdb"])
        self.fails(2, "resample", "y.vdb", "-o", "x.vdb", "--tolerance", "0.1", says=["--levels"])
        self.fails(2, *bake, "--part", "1/2", says=["adaptive"])
        self.fails(2, *bake, "--part", "1/2", "--target-error", "0.1", says=["whole volume"])


class Outputs(CliCase):
    def test_unusable_outputs_are_found_before_the_work(self):
        for target, code in ((self.folder, 4), (self.folder / "no" / "x.vdb", 4), ("/dev/null", 4),
                             ("-", 2)):
            with self.subTest(target=target):
                self.fails(code, "bake", "absent.glb", "-o", target, says=["-o"])
        self.fails(4, "bake", FURNACE, "-o", self.folder / "x.vdb", "--spacing", "1", "--rays", "4",
                   "--json", self.folder / "no" / "x.json", says=["--json"])
        self.assertFalse((self.folder / "x.vdb").exists())

    @unittest.skipUnless(pathlib.Path("/dev/full").exists(), "needs /dev/full")
    def test_full_standard_output(self):
        for args in ("--help", "stats --help", f"project '{SAMPLES}/sky.hdr'"):
            code, _, err = shell(f"$P {args} > /dev/full")
            self.assertEqual(code, 4, args)
            self.assertIn("standard output", err)

    def test_closed_standard_streams(self):
        code, _, err = shell("$P --help >&-")
        self.assertEqual(code, 4, err)
        code, _, err = shell(f"$P probe '{FURNACE}' --points - <&-")
        self.assertEqual(code, 3, err)
        # No file of ours may land on a closed stream's number and swallow what is meant for it.
        with subprocess.Popen([PROGRAM, "probe", FURNACE, "--points", "-"], stdin=subprocess.PIPE,
                              preexec_fn=lambda: (os.close(1), os.close(2))) as process:
            time.sleep(1.5)
            for number in (1, 2):
                self.assertEqual(os.readlink(f"/proc/{process.pid}/fd/{number}"), "/dev/null")
            process.stdin.close()
            self.assertEqual(process.wait(timeout=30), 4)

    def test_reader_that_leaves_early(self):
        volume = self.bake_furnace("pipe.vdb")
        points = self.folder / "many.csv"
        points.write_text("0.1,0.2,0.3,0,1,0\n" * 200000)
        code, out, err = shell(f"set -o pipefail; $P query '{volume}' --points '{points}' | head -1")
        self.assertEqual((code, err), (0, ""))
        self.assertEqual(out, "x,y,z,nx,ny,nz,Er,Eg,Eb,level,validity\n")

    def test_file_size_limit_is_an_error_and_keeps_the_old_file(self):
        target = self.bake_furnace("limited.vdb")
        before = target.read_bytes()
        code, _, err = shell(f"ulimit -f 8; $P bake '{FURNACE}' -o '{target}' --rays 4 --quiet "
                             "--spacing 0.1")
        self.assertEqual(code, 4, err)
        self.assertEqual(target.read_bytes(), before)
        report = self.folder / "limited.json"
        report.write_text("old")
        points = "0.1,0.2,0.3,0,1,0\n" * 1000
        code, _, err = shell(f"ulimit -f 8; $P query '{target}' --points - --json '{report}' "
                             "> /dev/null", input=points)
        self.assertEqual(code, 4, err)
        self.assertEqual(report.read_text(), "old")
        left = [p.name for p in self.folder.iterdir() if p.name.startswith("limited")]
        self.assertEqual(sorted(left), ["limited.json", "limited.vdb"])

    def test_json_file_and_csv_together(self):
        volume = self.bake_furnace("both.vdb")
        report = self.folder / "both.json"
        out = self.ok("query", volume, "--points", "-", "--json", report, stdin="0,0,0,0,1,0\n")
        row = dict(zip(*[line.split(",") for line in out.splitlines()]))
        self.assertEqual({k: float(v) for k, v in row.items()}, json.loads(report.read_text())[0])


class Signals(CliCase):
    def start(self, *args):
        return subprocess.Popen([PROGRAM, *map(str, args)], stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def bake(self, name):
        return self.start("bake", SAMPLES / "courtyard.glb", "-o", self.folder / name, "--env",
                          SAMPLES / "sky.hdr", "--rays", "1000000")

    def test_each_signal_ends_cleanly(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            with self.subTest(signal=number), self.bake("signal.vdb") as process:
                self.assertTrue(process.stderr.readline(), "ended before it was interrupted")
                process.send_signal(number)
                err = process.communicate(timeout=20)[1].decode()
                self.assertEqual(process.returncode, 130)
                self.assertIn("nterrupted", err.splitlines()[-1])
        left = {p.name for p in self.folder.iterdir() if "signal" in p.name}
        self.assertEqual(left - {"signal.vdb.journal"}, set())

    def test_waiting_for_points_can_be_interrupted(self):
        with self.start("probe", FURNACE, "--points", "-") as process:
            time.sleep(1.5)
            process.send_signal(signal.SIGINT)
            self.assertEqual(process.wait(timeout=10), 130)

    @heavy
    def test_bar_on_a_terminal(self):
        output = []

        def read(descriptor):
            output.append(os.read(descriptor, 4096))
            return b"."  # nothing of it on the test's own output

        quiet = os.dup(1)
        null = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, 1)
            pty.spawn([str(PROGRAM), "bake", str(SAMPLES / "cornell_box.glb"), "-o",
                       str(self.folder / "tty.vdb"), "--rays", "64"], read)
        finally:
            os.dup2(quiet, 1)
            os.close(quiet)
            os.close(null)
        text = b"".join(output).decode()
        self.assertIn("\r\033[Ktrace samples", text)
        self.assertRegex(text, r"trace samples +\d+% \[#+ *\] [0-9.]+ s, about")


class Points(CliCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.volume = cls.bake_furnace("points.vdb")

    def query(self, text, *options):
        return self.ok("query", self.volume, "--points", "-", *options, stdin=text).splitlines()

    def test_forms_of_the_same_points(self):
        wanted = self.query("0.1,0.2,0.3,0,1,0\n")
        for text in ("\ufeff0.1,0.2,0.3,0,1,0", "x,y,z,nx,ny,nz\r\n0.1,0.2,0.3,0,1,0\r\n",
                     "# a comment\n\n 0.1, 0.2 ,0.3,0,1,0 \n\n", "0.1,0.2,0.3,0,5,0\n",
                     "name,Z,y,x,nz,ny,nx\na,0.3,0.2,0.1,0,1,0\n", "\n".join(wanted)):
            with self.subTest(text=text):
                self.assertEqual(self.query(text), wanted)

    def test_bad_lines_are_named(self):
        for text, line, word in (("0,0,0\n1,2\n", 2, "2 values"), ("0,0,0\n\n#\n0,0,abc", 4, "abc"),
                                 ("nan,0,0", 1, "nan"), ("0,0,0,0,0,0", 1, "normal"),
                                 ("x,y\n1,2", 1, "column"), ("1,2,3,4", 1, "4 values"),
                                 ("0,0,0\n0,0,0,0,1,0", 2, "6 values"), ("0,0,", 1, "''")):
            with self.subTest(text=text):
                self.fails(3, "query", self.volume, "--points", "-", stdin=text,
                           says=["standard input", f"line {line}", word])

    def test_no_points_is_not_an_error(self):
        self.assertEqual(self.query("# nothing\n"), ["x,y,z,level,validity"])
        answer = self.ok("query", self.volume, "--points", "-", "--json", "-", stdin="")
        self.assertEqual(json.loads(answer), [])

    def test_json_has_null_for_nan(self):
        row = self.json("query", self.volume, "--points", "-", "--sh", stdin="9,9,9,0,1,0\n")[0]
        self.assertEqual((row["level"], row["Er"], row["sh_8_b"]), (-1, None, None))

    def test_many_points_keep_their_order(self):
        points = [f"{i * 1e-5 - 0.4},0.1,0.2" for i in range(20000)]
        rows = self.query("\n".join(points))[1:]
        self.assertEqual([float(row.split(",")[0]) for row in rows],
                         [float(point.split(",")[0]) for point in points])


class Probe(CliCase):
    def probe(self, text, *options):
        return self.ok("probe", FURNACE, "--points", "-", "--rays", "64", *options, stdin=text)

    def test_a_point_is_the_same_wherever_it_stands(self):
        points = ["0.1,0.2,0.3", "-0,0.5,0", "0.7,-0.2,0.1"]
        forward = self.probe("\n".join(points), "--threads", "1").splitlines()[1:]
        backward = self.probe("\n".join(points[::-1]), "--threads", "2").splitlines()[1:]
        self.assertEqual(forward, backward[::-1])
        self.assertNotEqual(forward[0].split(",")[6:], forward[1].split(",")[6:])

    def test_json_adds_errors_and_gradients(self):
        for method in ("central", "analytic"):
            row = json.loads(self.probe("0.1,0.2,0.3", "--bands", "2", "--gradients", method,
                                        "--json", "-"))[0]
            self.assertEqual([len(c) for c in row["sh_stderr"]], [3] * 4)
            for axis in "xyz":
                self.assertEqual([len(c) for c in row[f"sh_d{axis}"]], [3] * 4)
        # stderr is that of pi Y00 L00, the worst channel.
        self.assertAlmostEqual(row["stderr"], 0.886226925 * max(row["sh_stderr"][0]), places=6)

    def test_a_sun_gives_its_irradiance(self):
        # Nothing between the point and the sun: L_lm = E Y_lm(direction), so L_00 = E Y_00.
        above = "0,50,0\n"
        plain = self.probe(above, "--contribution", "direct").splitlines()[1].split(",")
        lit = self.probe(above, "--contribution", "direct", "--sun-direction", "0,2,0",
                         "--sun-lux", "4,2,1").splitlines()[1].split(",")
        for channel, lux in enumerate((4, 2, 1)):
            self.assertAlmostEqual(float(lit[6 + channel]) - float(plain[6 + channel]),
                                   lux * 0.28209479, places=4)
            # Y_1 = -0.4886 y
            self.assertAlmostEqual(float(lit[9 + channel]) - float(plain[9 + channel]),
                                   -lux * 0.48860251, places=4)


class Volumes(CliCase):
    """Bake, resample and evaluate together."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.volume = cls.bake_furnace("volume.vdb")

    def test_options_reproduce_the_bake(self):
        options = self.json("stats", self.volume)["options"]
        self.assertIn("--spacing 0.25", options)
        self.assertIn("--rays 4096", options)
        for absent in ("--quiet", "--output", "--threads", "--json"):
            self.assertNotIn(absent, options)
        plain = self.folder / "plain.vdb"
        self.ok("bake", FURNACE, "-o", plain, "--rays", "4", "--quiet")
        stats = self.json("stats", plain)
        self.assertIn("--spacing " + format(stats["spacing"], "g"), stats["options"])

    def test_up_axis_turns_positions_and_light(self):
        turned = self.folder / "z.vdb"
        self.bake_furnace("z.vdb", "--up", "z")
        again = self.folder / "z2.vdb"
        self.ok("resample", self.volume, "-o", again, "--up", "z", "--quiet")
        y = self.csv("query", self.volume, "--points", "-", stdin="0.1,0.2,0.3,0.6,0.8,0\n")[0]
        for path in (turned, again):
            # (x, y, z) of Y-up is (x, -z, y) of Z-up.
            z = self.csv("query", path, "--points", "-", stdin="0.1,-0.3,0.2,0.6,0,0.8\n")[0]
            self.assertAlmostEqual(float(z["Er"]) / float(y["Er"]), 1, places=4)
            self.assertEqual(self.json("stats", path)["up_axis"], "z")

    def test_evaluate_turns_a_z_up_volume_back(self):
        scene = SAMPLES / "cornell_box.glb"
        reports = []
        for up in ("y", "z"):
            volume = self.folder / f"cornell_{up}.vdb"
            self.ok("bake", scene, "-o", volume, "--spacing", "0.1", "--rays", "64", "--up", up,
                    "--quiet")
            reports.append(self.json("evaluate", volume, "--scene", scene, "--points", "30",
                                     "--rays", "64", "--quiet"))
        self.assertAlmostEqual(reports[0]["rel_rmse"], reports[1]["rel_rmse"], places=3)

    def test_sums_and_scales(self):
        def light(path):
            return float(self.csv("query", path, "--points", "-", stdin="0,0,0,0,1,0\n")[0]["Er"])
        total = self.folder / "sum.vdb"
        one = light(self.volume)
        self.ok("resample", "--add", f"{self.volume}=1.0", "--add", f"{self.volume}=0.25", "-o",
                total, "--quiet")
        self.assertAlmostEqual(light(total) / one, 1.25, places=5)
        self.ok("resample", self.volume, "--add", f"{self.volume}=2", "--scale", "0.5", "-o", total,
                "--quiet")
        self.assertAlmostEqual(light(total) / one, 1.5, places=5)

    def test_resample_reports_its_error(self):
        target = self.folder / "resampled.vdb"
        same = self.json("resample", self.volume, "-o", target)
        self.assertEqual(same["error"]["rel_rmse"], 0)
        fewer = self.json("resample", self.volume, "-o", target, "--bands", "1")
        self.assertGreater(fewer["error"]["rel_rmse"], 0)
        half = self.json("resample", self.volume, "-o", target, "--half")
        self.assertTrue(0 < half["error"]["rel_rmse"] < 1e-3)

    def test_two_halves_join_to_the_whole(self):
        for name, bounds in (("low.vdb", "-0.5,-0.5,-0.5,0,0.5,0.5"),
                             ("high.vdb", "0,-0.5,-0.5,0.5,0.5,0.5")):
            self.ok("bake", FURNACE, "-o", self.folder / name, "--bounds", bounds, "--spacing",
                    "0.25", "--rays", "4096", "--quiet")
        joined = self.folder / "joined.vdb"
        self.ok("resample", self.folder / "low.vdb", self.folder / "high.vdb", "-o", joined,
                "--quiet")
        points = "\n".join(f"{x / 10},0.1,{x / 20}" for x in range(-5, 6))
        self.assertEqual(self.ok("query", joined, "--points", "-", "--sh", stdin=points),
                         self.ok("query", self.volume, "--points", "-", "--sh", stdin=points))

    def test_evaluate_warns_of_another_scene(self):
        code, _, err = run("evaluate", self.volume, "--scene", SAMPLES / "two_rooms.glb", "--points",
                           "2", "--rays", "4")
        self.assertEqual(code, 0)
        self.assertIn("another scene", err)

    def test_render_writes_images(self):
        for arguments in ((), ("--slice", "y=0.1")):
            image = self.folder / "image.png"
            self.ok("render", FURNACE, "--volume", self.volume, "-o", image, "--size", "32x24",
                    "--samples", "1", "--quiet", *arguments)
            self.assertEqual(image.read_bytes()[:4], b"\x89PNG")
        self.fails(2, "render", FURNACE, "--volume", self.volume, "-o", "x.jpg", says=[".png"])
        self.fails(2, "render", FURNACE, "--volume", self.volume, "-o", "x.png", "--slice", "y=9",
                   says=["spans"])

    def test_render_shows_levels_probes_and_error(self):
        def render(*arguments):
            image = self.folder / "shown.png"
            report = json.loads(self.ok("render", FURNACE, "--volume", self.volume, "-o", image,
                                        "--size", "64x48", "--quiet", "--json", "-", *arguments))
            self.assertEqual(image.read_bytes()[:4], b"\x89PNG")
            return report

        self.assertEqual(len(render("--show", "levels", "--slice", "y=0.1")["cells_by_level"]), 1)
        self.assertEqual(render("--show", "probes", "--samples", "1")["height"], 48)
        error = render("--show", "error", "--slice", "y=0.1", "--rays", "1024", "--blocks", "8")
        # In a furnace the volume is right but for its noise.
        self.assertLess(error["mean_error"], 0.05)
        self.assertGreater(error["mean_error"], 0)
        self.assertEqual(error["points"], 64)

    def test_render_refuses_what_a_picture_would_ignore(self):
        for says, *arguments in (
                ("--slice", "--show", "levels"), ("--slice", "--show", "error"),
                ("--slice", "--show", "probes", "--slice", "y=0.1"),
                ("--spheres", "--show", "probes", "--spheres", "3"),
                ("--rays", "--rays", "16"), ("--blocks", "--slice", "y=0.1", "--blocks", "9"),
                ("--fov", "--show", "error", "--slice", "y=0.1", "--fov", "30"),
                ("--mode", "--show", "levels", "--slice", "y=0.1", "--mode", "nearest"),
                ("--show", "--show", "everything")):
            with self.subTest(arguments=arguments):
                self.fails(2, "render", FURNACE, "--volume", self.volume, "-o", "x.png", *arguments,
                           says=[says])


class Adaptive(CliCase):
    """Cells of several sizes: two rooms, one with a lamp, and the open space around them."""

    BAKE = ("bake", ROOMS, "--spacing", "0.5", "--rays", "16", "--quiet")
    LEVELS = ("--levels", "2")

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.volume = cls.folder / "adaptive.vdb"
        code, out, err = run(*cls.BAKE, *cls.LEVELS, "-o", cls.volume, "--threads", "2", "--json",
                             "-")
        if code != 0:
            raise AssertionError(f"adaptive bake gave {code}: {err}")
        cls.report = json.loads(out)
        cls.uniform = cls.folder / "uniform.vdb"
        run(*cls.BAKE, "--levels", "0", "-o", cls.uniform)

    def bake(self, *options, rays="4"):
        return self.json(*self.BAKE[:4], "--quiet", "--rays", rays, *options, "-o",
                         self.folder / "x.vdb")

    def assert_same_but_options(self, path, other):
        """Every grid's tree, values and metadata, byte for byte, but for the command line."""
        contents = []
        for file in (path, other):
            grids = vb.parts_of_grids(file.read_bytes())
            for metadata, _ in grids.values():
                self.assertTrue(metadata.pop("lumivdb_options"))
            contents.append(grids)
        self.assertEqual(list(contents[0]), list(contents[1]))
        for name, grid in contents[0].items():
            self.assertTrue(grid == contents[1][name], name)

    def test_levels(self):
        cells = self.report["cells_by_level"]
        self.assertEqual(len(cells), 3)
        self.assertTrue(all(cells), cells)
        stats = self.json("stats", self.volume)
        self.assertEqual((stats["cells_by_level"], stats["samples"]),
                         (cells, self.report["samples"]))
        uniform = self.json("stats", self.uniform)
        # The two volumes fill the same space, but for what coarse cells reach beyond the bounds.
        self.assertGreaterEqual(sum(n * 8 ** k for k, n in enumerate(cells)),
                                uniform["cells_by_level"][0])
        self.assertLess(stats["samples"], uniform["samples"] / 2)
        self.assertGreater(stats["uniform_equivalent_samples"], uniform["samples"] - 1)
        self.assertGreater(stats["cut_cells"], 0)
        self.assertGreater(stats["moved_samples"], 0)
        grid = "\n".join(f"{x / 2},1.25,{z / 2}" for x in range(-8, 9) for z in range(-6, 7))
        levels = {row["level"] for row in self.csv("query", self.volume, "--points", "-",
                                                   stdin=grid)}
        self.assertTrue({"0", "1"} <= levels <= {"-1", "0", "1", "2"}, levels)

    def test_no_levels_are_uniform(self):
        plain = self.folder / "plain.vdb"
        self.ok(*self.BAKE, "-o", plain)
        self.assertEqual(len(self.json("stats", self.uniform)["cells_by_level"]), 1)
        self.assert_same_but_options(self.uniform, plain)

    def test_threads_do_not_change_a_byte(self):
        one = self.folder / "one.vdb"
        self.ok(*self.BAKE, *self.LEVELS, "-o", one, "--threads", "1")
        self.assertTrue(one.read_bytes() == self.volume.read_bytes())

    @heavy
    def test_parts_joined_are_the_whole(self):
        parts = [self.folder / f"part{i}.vdb" for i in (1, 2, 3)]
        for i, part in enumerate(parts, 1):
            self.ok(*self.BAKE, *self.LEVELS, "--part", f"{i}/3", "-o", part)
            self.assertLess(self.json("stats", part)["samples"], self.report["samples"])
        for order in (parts, [parts[1], parts[2], parts[0]]):
            joined = self.folder / "joined.vdb"
            self.ok("resample", *order, "-o", joined, "--quiet")
            self.assert_same_but_options(joined, self.volume)

    def test_what_is_chosen_is_said(self):
        report = self.bake("--levels", "auto", "--bands", "auto")
        said = " ".join(report["decisions"])
        self.assertIn(f"bands {report['bands']}:", said)
        self.assertRegex(said, r"levels \d+:")
        self.assertTrue(1 <= report["bands"] <= 6)
        self.assertIn("spacing 0.1:", self.json(
            "bake", FURNACE, "-o", self.folder / "x.vdb", "--rays", "2", "--quiet")["decisions"][0])

    @heavy
    def test_heuristics_and_thresholds(self):
        def samples(*options):
            return self.bake(*self.LEVELS, *options)["samples"]
        error = samples()
        self.assertEqual(samples("--refine", "error"), error)
        self.assertLess(samples("--refine-threshold", "error=10"), error)
        self.assertGreater(samples("--refine-threshold", "error=0.01"), error)
        gradient = samples("--refine", "gradient")
        self.assertLess(samples("--refine", "gradient", "--refine-threshold", "gradient=10"),
                        gradient)
        geometry = self.bake(*self.LEVELS, "--refine", "geometry")["cells_by_level"]
        self.assertGreater(geometry[0], 0)
        self.assertEqual(self.bake(*self.LEVELS, "--refine", "geometry", "--refine-threshold",
                                   "geometry=1")["cells_by_level"][0], 0)
        harmonic = samples("--refine", "harmonic")
        self.assertLess(samples("--refine", "harmonic", "--refine-threshold", "harmonic=1e-6"),
                        harmonic)
        self.assertLess(samples("--refine", "brute", "--refine-threshold", "brute=10"),
                        samples("--refine", "brute"))
        self.assertGreater(samples("--refine", "error,geometry"), error)
        # Heuristics without --levels make an adaptive volume.
        self.assertRegex(" ".join(self.bake("--refine", "error")["decisions"]), r"levels [1-9]")

    @heavy
    def test_analytic_gradients_serve_every_mode(self):
        volume = self.folder / "gradients.vdb"
        self.ok(*self.BAKE, *self.LEVELS, "--gradients", "analytic", "-o", volume)
        self.assertTrue(self.json("stats", volume)["gradients"])
        point = "-2.1,1.3,0.4,0,1,0\n"
        answers = {mode: self.csv("query", volume, "--points", "-", "--mode", mode,
                                  stdin=point)[0]["Er"]
                   for mode in ("nearest", "taylor", "trilinear", "gradient", "tricubic", "idw")}
        self.assertTrue(all(float(e) > 0 for e in answers.values()), answers)
        self.assertEqual(len(set(answers.values())), 6, answers)
        best = self.csv("query", volume, "--points", "-", stdin=point)[0]["Er"]
        self.assertEqual(best, answers["gradient"])
        for mode in ("taylor", "gradient", "tricubic"):
            self.fails(2, "query", self.volume, "--points", "-", "--mode", mode, stdin=point,
                       says=["no gradients", mode])

    def test_visibility_masks(self):
        # A wall of no thickness at x = 0, light before it: 0 behind it, all of it just before.
        points = "-0.4,1.25,0.25,-1,0,0\n-0.02,1.25,0.25,-1,0,0\n0.02,1.25,0.25,-1,0,0\n"
        light = {}
        for visibility in ("on", "off"):
            volume = self.folder / "masks.vdb"
            self.ok("bake", SAMPLES / "two_rooms.glb", "--bounds", "-1,0.5,-1,1,2.5,1", "--spacing",
                    "0.5", "--rays", "64", "--visibility", visibility, "-o", volume, "--quiet")
            light[visibility] = [float(row["Er"]) for row in self.csv(
                "query", volume, "--points", "-", stdin=points)]
            cut = self.json("stats", volume)["cut_cells"]
            self.assertEqual(cut > 0, visibility == "on", cut)
        self.assertAlmostEqual(light["on"][1] / light["on"][0], 1, delta=0.1)
        self.assertEqual(light["on"][2], 0)
        # Without masks the samples on the wall mix into the cells on both sides.
        self.assertTrue(light["off"][1] < 0.5 * light["off"][0] or light["off"][2] > 0, light)

    @heavy
    def test_resample_levels(self):
        target = self.folder / "levels.vdb"
        flat = self.folder / "flat.vdb"
        report = self.json("resample", self.volume, "-o", flat, "--uniform")
        self.assertEqual(len(report["cells_by_level"]), 1)
        merged = self.json("resample", flat, "-o", target, "--levels", "2", "--tolerance", "0.05")
        loose = self.json("resample", flat, "-o", target, "--levels", "2", "--tolerance", "10")
        self.assertLess(merged["samples"], report["samples"])
        self.assertLess(loose["samples"], merged["samples"])
        self.assertTrue(merged["error"]["rel_rmse"] < 0.05 and loose["error"]["rel_rmse"] < 10)
        self.assertGreater(loose["cells_by_level"][1], merged["cells_by_level"][1])
        for value in ("13", "-1", "auto"):
            self.fails(2, "resample", flat, "-o", target, "--levels", value,
                       says=[f"--levels {value}", "0 to 12"])
        self.fails(2, "resample", flat, "-o", target, "--levels", "1", "--tolerance", "-1",
                   says=["--tolerance -1"])

    def test_evaluate_takes_the_reference_noise_off(self):
        report = self.json("evaluate", self.volume, "--scene", ROOMS, "--points", "16", "--rays",
                           "16", "--quiet")
        self.assertLessEqual(report["rel_rmse_debiased"], report["rel_rmse"])
        self.assertLessEqual(report["rel_rmse_debiased"], report["upper95"])


class TargetError(CliCase):
    """--target-error: what was reached, on points that the bake did not use."""

    def check(self, report, asked):
        achieved = report["achieved"]
        self.assertEqual(report["target_error"], asked)
        self.assertEqual(achieved["met"], achieved["rel_rmse"] <= asked)
        self.assertLessEqual(achieved["estimate"], achieved["rel_rmse"])
        self.assertGreaterEqual(achieved["points"], 100)
        errors = [place["error"] for place in achieved["worst"]]
        self.assertEqual((len(errors), errors), (10, sorted(errors, reverse=True)))
        self.assertEqual([len(place["position"]) for place in achieved["worst"]], [3] * 10)
        stats = self.json("stats", self.folder / "x.vdb")
        self.assertEqual(stats["error"]["asked"], asked)
        self.assertAlmostEqual(stats["error"]["reached"], achieved["rel_rmse"], places=6)
        self.assertEqual(stats["error"]["confidence"], achieved["confidence"])
        return achieved

    def test_met(self):
        report = self.json("bake", FURNACE, "--target-error", "0.3", "-o", self.folder / "x.vdb",
                           "--quiet")
        achieved = self.check(report, 0.3)
        self.assertEqual((achieved["met"], achieved["confidence"]), (True, 0.95))
        said = " ".join(report["decisions"])
        for chosen in ("spacing", "levels", "bands", "rays", "gradients", "error threshold"):
            self.assertIn(chosen, said)
        for key in ("refine", "verify"):
            self.assertIn(key, report["seconds"])
        # An independent judge, with random numbers of its own.
        self.ok("evaluate", self.folder / "x.vdb", "--scene", FURNACE, "--points", "50", "--rays",
                "1024", "--max-error", "0.3", "--quiet")

    def test_not_met_is_said_and_the_volume_written(self):
        target = self.folder / "x.vdb"
        args = ("bake", ROOMS, "--target-error", "0.3", "--confidence", "0.9", "--max-samples",
                "1000", "--spacing", "0.5", "--bands", "2", "--gradients", "none", "-o", target)
        err = self.fails(1, *args, "--json", self.folder / "x.json",
                         says=[target, "0.3 was not met", "worst at", "--max-samples"])
        self.assertIn("warning: ", err)
        report = json.loads((self.folder / "x.json").read_text())
        achieved = self.check(report, 0.3)
        self.assertEqual((achieved["met"], achieved["confidence"]), (False, 0.9))
        self.assertIn("not met", " ".join(report["warnings"]))
        self.assertEqual(report["bands"], 2)
        # What was given is not chosen.
        for given in ("bands ", "spacing ", "gradients "):
            self.assertEqual([d for d in report["decisions"] if d.startswith(given)], [])


if __name__ == "__main__":
    unittest.main()
