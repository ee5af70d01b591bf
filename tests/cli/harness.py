# SPDX-License-Identifier: Apache-2.0
"""Runs the built program for the tests of the command line.

The program's path is in the environment variable LUMIVDB_PROGRAM (ctest sets it); by hand:
    LUMIVDB_PROGRAM=build/release/lumivdb python3 -m unittest discover -s tests/cli
"""
import csv
import io
import json
import os
import pathlib
import shutil
import subprocess
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "samples"
PROGRAM = pathlib.Path(os.environ.get("LUMIVDB_PROGRAM", ROOT / "build" / "release" / "lumivdb"))

# As [heavy] of the other tests: long bakes, of code that other tests run too.
heavy = unittest.skipIf("LUMIVDB_SANITIZED" in os.environ, "heavy, and sanitizers slow it tenfold")


def run(*args, stdin="", timeout=300, cwd=None):
    """Runs `lumivdb args…` -> (exit code, stdout, stderr). A crash shows as a negative code."""
    done = subprocess.run([str(PROGRAM), *map(str, args)], input=stdin, timeout=timeout, cwd=cwd,
                          capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


class CliCase(unittest.TestCase):
    """A temporary folder for each class, and shorthands."""

    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp(prefix="lumivdb_cli_"))
        cls.addClassCleanup(shutil.rmtree, cls.folder, ignore_errors=True)

    def ok(self, *args, **options):
        """Runs, expects exit code 0, returns stdout."""
        code, out, err = run(*args, **options)
        self.assertEqual(code, 0, f"lumivdb {' '.join(map(str, args))}\n{err}")
        return out

    def fails(self, code, *args, says=(), **options):
        """Runs, expects the exit code and the words in what stderr says last; returns stderr."""
        got, out, err = run(*args, **options)
        self.assertEqual(got, code, f"lumivdb {' '.join(map(str, args))}\n{out}\n{err}")
        message = err.strip().splitlines()[-1] if err.strip() else ""
        self.assertNotEqual(message, "", "no message on stderr")
        for word in says:
            self.assertIn(str(word), message)
        return err

    def json(self, *args, **options):
        """Runs with `--json -` and returns what it says."""
        return json.loads(self.ok(*args, "--json", "-", **options))

    def csv(self, *args, **options):
        """Runs and returns the rows of the CSV on stdout as dictionaries."""
        return list(csv.DictReader(io.StringIO(self.ok(*args, **options))))

    @classmethod
    def bake_furnace(cls, name, *options):
        """A volume of the furnace sample (L = 2 everywhere) in the class's folder, -> its path.

        Its noise: a path that survives a reflection with probability 1/2 has a variance of
        (1/2) / (1/2)^2 = 2, so over 4096 directions the standard error of L is 1.1%, of E 1.8%.
        """
        path = cls.folder / name
        code, _, err = run("bake", SAMPLES / "furnace.glb", "-o", path, "--spacing", "0.25",
                           "--bounds", "-0.5,-0.5,-0.5,0.5,0.5,0.5", "--rays", "4096", "--quiet",
                           *options)
        if code != 0:
            raise AssertionError(f"bake of the furnace gave {code}: {err}")
        return path
