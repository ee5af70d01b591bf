# SPDX-License-Identifier: Apache-2.0
"""Bakes that are killed and go on. By hand, with more kills than ctest has time for:
    LUMIVDB_KILLS=50 LUMIVDB_PROGRAM=build/release/lumivdb python3 tests/cli/test_resume.py -v Killed
"""
import fcntl
import json
import os
import random
import re
import signal
import subprocess
import time
import unittest

from harness import PROGRAM, SAMPLES, CliCase, run

KILLS = int(os.environ.get("LUMIVDB_KILLS", "6"))
SCENE = SAMPLES / "two_rooms.glb"
# Each takes a second or two, and writes several blocks of journal before the volume.
UNIFORM = ("bake", SCENE, "--spacing", "0.2", "--rays", "256")
ADAPTIVE = ("bake", SCENE, "--spacing", "0.1", "--levels", "3", "--rays", "128", "--bands", "4",
            "--gradients", "analytic")
# Out of reach, so it ends with exit code 1: its pilot, rounds and choices have to be the same too.
TARGET = ("bake", SAMPLES / "house.glb", "--target-error", "0.05", "--max-samples", "10000")
SMALL = ("bake", SCENE, "--spacing", "0.5", "--rays", "64")
ENDLESS = ("bake", SCENE, "--spacing", "0.5", "--rays", "131072")


def start(*args):
    return subprocess.Popen([str(PROGRAM), *map(str, args)], stdout=subprocess.DEVNULL,
                            stderr=subprocess.PIPE, text=True)


class Case(CliCase):
    def journal_of(self, out):
        return out.with_name(out.name + ".journal")

    def await_journal(self, out, size):
        """Until the journal of the bake that runs has that many bytes."""
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            journal = self.journal_of(out)
            if journal.exists() and journal.stat().st_size >= size:
                return
            time.sleep(0.01)
        self.fail(f"no journal of {size} bytes after two minutes")


class Killed(Case):
    """kill -9 at random moments, the first of them soon after the journal's first samples; on
    changing numbers of threads; some resumed runs are killed too."""

    def report(self, code, *args):
        got, out, err = run(*args, "--quiet", "--json", "-")
        self.assertEqual(got, code, err)
        return json.loads(out)

    def reference(self, name, command, code):
        out = self.folder / f"{name}.vdb"
        begun = time.monotonic()
        report = self.report(code, *command, "-o", out)
        seconds = time.monotonic() - begun
        self.assertEqual(report["journal_samples"], 0)
        self.assertFalse(self.journal_of(out).exists(), "a journal was left")
        return out.read_bytes(), report, seconds

    def kill_at(self, command, out, seconds, code, after_samples=False):
        """Kills it that many seconds after its start, or after the journal's first samples.
        -> whether it was killed before it had ended"""
        with start(*command, "-o", out, "--quiet") as process:
            if after_samples:
                self.await_journal(out, 2000)
            try:
                process.wait(seconds)
            except subprocess.TimeoutExpired:
                process.kill()
            process.communicate()
        self.assertIn(process.returncode, (code, -signal.SIGKILL))
        return process.returncode != code

    def kill_and_resume(self, name, command, code=0):
        wanted, plain, seconds = self.reference(name, command, code)
        rng = random.Random(name)
        landed = with_samples = 0
        for number in range((KILLS + 1) // 2):
            out = self.folder / f"{name}_{number}.vdb"
            threads = lambda: ("--threads", rng.choice((1, 2, 3)))
            with self.subTest(kill=number):
                moment = 0.1 if number == 0 else rng.random() * 1.1 * seconds
                landed += self.kill_at((*command, *threads()), out, moment, code,
                                       after_samples=number == 0)
                if number % 3 == 2:
                    self.kill_at((*command, "--resume", *threads()), out,
                                 rng.random() * seconds, code)
                report = self.report(code, *command, "--resume", *threads(), "-o", out)
                self.assertTrue(out.read_bytes() == wanted, "other bytes than uninterrupted")
                for key in ("samples", "traced_samples", "rays", "mean_relative_stderr"):
                    self.assertEqual(report[key], plain[key], key)
                with_samples += report["journal_samples"] > 0
                self.assertFalse(self.journal_of(out).exists(), "a journal was left")
                out.unlink()
        print(f"\n{name}: {number + 1} kills, {landed} before the end, {with_samples} resumed "
              f"with samples of the journal; {seconds:.1f} s each", flush=True)
        self.assertGreater(with_samples, 0)
        self.assertGreater(landed, number / 2)

    def test_uniform(self):
        self.kill_and_resume("uniform", UNIFORM)

    def test_adaptive_with_gradients(self):
        self.kill_and_resume("adaptive", ADAPTIVE)

    def test_target(self):
        self.kill_and_resume("target", TARGET, code=1)


class Journal(Case):
    """What stands at OUT.vdb.journal."""

    def leave_journal(self, name, *command):
        """A bake that is interrupted after its first samples. -> (path of the volume, stderr)"""
        out = self.folder / name
        with start(*command, "-o", out) as process:
            self.await_journal(out, 2000)
            process.send_signal(signal.SIGINT)
            err = process.communicate(timeout=60)[1]
        self.assertEqual(process.returncode, 130, err)
        return out, err

    def test_interrupt_says_how_to_go_on(self):
        out, err = self.leave_journal("interrupted.vdb", *ENDLESS)
        self.assertIn("--resume", err.splitlines()[-1])
        self.assertIn(str(self.journal_of(out)), err.splitlines()[-1])
        self.assertFalse(out.exists())

    def test_other_options_are_refused(self):
        out, _ = self.leave_journal("other.vdb", *ENDLESS)
        before = self.journal_of(out).read_bytes()
        other = ("bake", SCENE, "--spacing", "0.5", "--rays", "64", "--resume", "-o", out)
        self.fails(2, *other, says=["rays 131072 there, 64 now", "delete", "--resume",
                                    self.journal_of(out)])
        self.fails(2, "bake", SAMPLES / "house.glb", *other[2:], says=["scene "])
        self.assertEqual(self.journal_of(out).read_bytes(), before)
        # Without --resume it is overwritten, and gone at the end.
        code, _, err = run(*SMALL, "-o", out)
        self.assertEqual(code, 0, err)
        self.assertIn("not used", err)
        self.assertFalse(self.journal_of(out).exists())

    def test_nothing_to_resume(self):
        out = self.folder / "nothing.vdb"
        code, _, err = run(*SMALL, "--resume", "-o", out)
        self.assertEqual(code, 0, err)
        self.assertIn("starting anew", err)
        plain = self.folder / "plain.vdb"
        self.ok(*SMALL, "-o", plain, "--quiet")
        self.assertEqual(out.read_bytes(), plain.read_bytes())

    def test_two_bakes_of_one_name(self):
        out = self.folder / "twice.vdb"
        with start(*ENDLESS, "-o", out) as first:
            self.await_journal(out, 1)
            code, _, err = run(*SMALL, "-o", out)
            self.assertEqual(code, 0, err)
            self.assertIn("belongs to another bake", err)
            self.assertTrue(self.journal_of(out).exists())
            first.kill()
            first.communicate()

    def test_places_that_cannot_be_used(self):
        def folder(path):
            path.mkdir()

        def foreign(path):
            path.write_text("a diary\n")

        for number, (make, word) in enumerate(((folder, "directory"), (foreign, "another kind"),
                                               (os.mkfifo, "not a file"))):
            out = self.folder / f"place_{number}.vdb"
            make(self.journal_of(out))
            for options in ((), ("--resume",)):
                with self.subTest(make=make.__name__, options=options):
                    code, _, err = run(*SMALL, *options, "-o", out)
                    self.assertEqual(code, 0, err)
                    warnings = re.findall("^warning: .*", err, re.M)
                    self.assertEqual(len(warnings), 1, err)
                    self.assertIn(word, warnings[0].lower())
                    self.assertTrue(self.journal_of(out).exists(), "what was there is gone")
        self.assertEqual(self.journal_of(self.folder / "place_1.vdb").read_text(), "a diary\n")

    def test_full_disk(self):
        out = self.folder / "full.vdb"
        command = " ".join(f"'{word}'" for word in (PROGRAM, *ADAPTIVE, "-o", out))
        done = subprocess.run(["bash", "-c", f"ulimit -f 400; exec {command}"], timeout=120,
                              capture_output=True, text=True, check=False)
        # The volume does not fit either; what does is kept, and that is said.
        self.assertEqual(done.returncode, 4, done.stderr)
        self.assertIn("--resume", done.stderr.splitlines()[-1])
        report = self.json(*ADAPTIVE, "--resume", "-o", out, "--quiet")
        self.assertGreater(report["journal_samples"], 100)

    def test_lock_ends_with_the_process(self):
        out, _ = self.leave_journal("lock.vdb", *ENDLESS)
        with open(self.journal_of(out), "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


if __name__ == "__main__":
    unittest.main()
