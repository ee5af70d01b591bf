#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How right the time that a bake says is left was: runs bakes, reads their progress, and prints a
Markdown row each with (elapsed + left) / truth after a tenth, a fifth and a half of the time.
    bench/progress_check.py PROGRAM [-n TIMES] -- BAKE ARGUMENTS... [-- BAKE ARGUMENTS...]
Without arguments after PROGRAM: the sample scenes. The truth ends with the last stage before the
volume is written. What is 'of this step' is no estimate of the whole and counts as none.
"""
import os
import pathlib
import pty
import re
import statistics
import subprocess
import sys
import tempfile
import time

SAMPLES = pathlib.Path(__file__).resolve().parent.parent / "samples"
SHARES = (0.1, 0.2, 0.5)
CASES = [f"{SAMPLES}/{case}" for case in (
    "two_rooms_door.glb --spacing 0.2 --rays 1024",
    "house.glb --spacing 0.25 --levels 3 --rays 512",
    "two_rooms.glb --spacing 0.05 --levels 4 --rays 512",
    "two_rooms_door.glb --levels 4 --refine-threshold error=0.05 --rays 1024",
    "courtyard.glb --refine-threshold error=0.05 --rays 512",
    "two_rooms.glb --target-error 0.1",
    "two_rooms_door.glb --target-error 0.1",
)]
UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


def seconds(text):
    """'1 min 12 s' -> 72"""
    return sum(float(n) * UNITS[unit] for n, unit in re.findall(r"([\d.]+) (ms|s|min|h)\b", text))


def watch(program, arguments):
    """-> [(elapsed, estimate of the whole)], seconds until the volume was written"""
    with tempfile.TemporaryDirectory() as folder:
        master, slave = pty.openpty()  # a terminal gets the bar, ten times a second
        command = [program, "bake", *arguments, "-o", f"{folder}/out.vdb"]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=slave) as process:
            begun, text, seen, end = time.monotonic(), "", [], None
            os.close(slave)
            while True:
                try:
                    text += os.read(master, 65536).decode(errors="replace")
                except OSError:
                    break
                now = time.monotonic() - begun
                *whole, text = re.split(r"[\r\n]", text)
                for line in (*whole, text):
                    if "write volume" in line:
                        end = end or now
                    uniform = "--levels" not in arguments and "trace samples" in line
                    left = re.search(r"about (.+) left( in all)?", line)
                    if left and "of this step" not in line and (left.group(2) or uniform):
                        seen.append((now, now + seconds(left.group(1))))
            os.close(master)
        return seen, end or time.monotonic() - begun


def ratios(seen, end):
    """The last estimate at each share of the time over the truth; None where none was yet."""
    found = []
    for share in SHARES:
        before = [whole for now, whole in seen if now <= share * end]
        found.append(before[-1] / end if before else None)
    return found


def main():
    words = sys.argv[1:]
    if not words or words[0].startswith("-"):
        sys.exit(__doc__)
    times = int(words[words.index("-n") + 1]) if "-n" in words else 1
    groups, own = [], False
    for word in words[1:]:
        if word == "--":
            groups.append([])
            own = True
        elif own:
            groups[-1].append(word)
    print("| bake | seconds | " + " | ".join(f"at {100 * s:.0f}%" for s in SHARES) + " |")
    print("|---|" + "---|" * (len(SHARES) + 1))
    for arguments in groups or [case.split() for case in CASES]:
        runs = [watch(words[0], arguments) for _ in range(times)]
        rows = [ratios(*run) for run in runs]
        name = " ".join(pathlib.Path(a).name if "/" in a else a for a in arguments)
        shown = []
        for column in zip(*rows):
            known = [f"{r:.2f}" for r in column if r is not None]
            shown.append(" ".join(known) if known else "none")
        end = statistics.median(run[1] for run in runs)
        print(f"| {name} | {end:.1f} | " + " | ".join(shown) + " |", flush=True)


if __name__ == "__main__":
    main()
