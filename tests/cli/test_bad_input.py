# SPDX-License-Identifier: Apache-2.0
"""What a hostile or unlucky user sees: a table of bad inputs, each run through the program.

Every case also checks that the program did not crash, that it said exactly one sentence, that an
old output file is untouched and that nothing else was left in the folder.

    LUMIVDB_PROGRAM=build/release/lumivdb python3 tests/cli/test_bad_input.py            the tests
    LUMIVDB_PROGRAM=build/release/lumivdb python3 tests/cli/test_bad_input.py --table    the document
    LUMIVDB_CASE=texture … only the cases that have the word in their name
"""
import concurrent.futures
import contextlib
import json
import math
import os
import pathlib
import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import zlib
from dataclasses import dataclass, field
from typing import Callable, Optional

import scene_files as sf
import vdb_bytes as vb
from harness import PROGRAM, SAMPLES

TIMEOUT = 120
OLD = b"an old file\n"
NAN, INF = float("nan"), float("inf")


@dataclass
class Case:
    """@p command runs in a folder with @p files, and those of box.gltf and Volumes that it names."""
    name: str
    command: str
    code: int
    says: tuple = ()
    files: dict = field(default_factory=dict)
    stdin: str = ""
    shell: bool = False  # the command is for bash; 'lumivdb' in it is the program
    around: Optional[Callable] = None  # a context manager of the folder
    act: Optional[Callable] = None  # act(case, folder) -> (code, stdout, stderr) instead of a run
    after: Optional[Callable] = None  # after(test, folder): more to check
    loops: str = ""  # the file that act() writes again and again
    old: Optional[bool] = None  # whether an old output is there; None: by the name, half of them


# ---- Things that cases need.

class Volumes:
    """Small volumes that many cases read, baked once."""

    OPTIONS = {
        "v.vdb": "--bounds 0.25,0,0,0.75,0.5,0.5",
        "w.vdb": "--bounds 0,0.25,0,0.5,0.75,0.5",  # as large, elsewhere
        "g.vdb": "--bounds 0.25,0,0,0.75,0.5,0.5 --gradients central",
        "two_bands.vdb": "--bounds 0.25,0,0,0.75,0.5,0.5 --bands 2",
        "noisy.vdb": "--bounds -1,-1,-1,1,1,1 --rays 2",
    }

    def __init__(self, folder):
        self.lock = threading.Lock()
        self.folder = folder
        (folder / "box.gltf").write_bytes(sf.scene())

    def get(self, name):
        with self.lock:
            return self.made(name)

    def made(self, name):
        path = self.folder / name
        if not path.exists():
            words = {"--bands": "1", "--rays": "16"}
            given = self.OPTIONS[name].split()
            words.update(zip(given[::2], given[1::2]))
            arguments = ["bake", "box.gltf", "-o", name, "--spacing", "0.25", "--codec", "none",
                         "--preview-voxel", "-1", "--quiet", *[w for o in words.items() for w in o]]
            code, _, err = run_in(self.folder, arguments)
            if code:
                raise AssertionError(f"lumivdb {' '.join(arguments)}: {code}\n{err}")
        return path

    def bytes(self, name="v.vdb"):
        return self.get(name).read_bytes()


VOLUMES = None  # of the run; made by prepare()


def volume(change):
    """A file for Case.files: @p change applied to the bytes of v.vdb."""
    return lambda path: path.write_bytes(change(VOLUMES.bytes()))


def folder_at(path):
    path.mkdir()


def pipe_at(path):
    os.mkfifo(path)


def with_pyopenvdb(code):
    """A file made by @p code with OpenVDB's Python module; the case is skipped without it."""
    def make(path):
        for python in (sys.executable, "/usr/bin/python3"):
            done = subprocess.run(
                [python, "-c", "import sys, pyopenvdb as vdb\npath = sys.argv[1]\n"
                 "source = sys.argv[2]\n" + code, path, VOLUMES.get("v.vdb")],
                capture_output=True, text=True, check=False, timeout=TIMEOUT)
            if done.returncode == 0:
                return
            if "ModuleNotFoundError" not in done.stderr and "No such file" not in done.stderr:
                raise AssertionError(done.stderr)
        raise unittest.SkipTest("needs OpenVDB's Python module (Debian: python3-openvdb)")
    return make


def mounted(*steps):
    """A folder 'disk' in the case's folder on a file system of its own; needs the right to mount."""
    @contextlib.contextmanager
    def around(folder):
        disk = folder / "disk"
        disk.mkdir()
        made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk],
                              capture_output=True, check=False) if os.geteuid() == 0 else None
        if made is None or made.returncode:
            raise unittest.SkipTest("needs the right to mount a file system")
        try:
            (disk / "out.vdb").write_bytes(OLD)
            for step in steps:
                subprocess.run(["mount", "-o", step, disk], check=True)
            yield
        finally:
            subprocess.run(["umount", disk], check=True)
    return around


@contextlib.contextmanager
def without_write_permission(folder):
    """A folder 'locked' that this user may not write to."""
    locked = folder / "locked"
    locked.mkdir()
    (locked / "out.vdb").write_bytes(OLD)
    if os.geteuid() != 0:
        locked.chmod(0o555)
        try:
            yield
        finally:
            locked.chmod(0o755)
        return
    done = subprocess.run(["chattr", "+i", locked], capture_output=True, check=False)
    if done.returncode:
        raise unittest.SkipTest("needs a user other than root, or chattr +i")
    try:
        yield
    finally:
        subprocess.run(["chattr", "-i", locked], check=True)


def signalled(number, line, delay=0.03, repeat=1):
    """Case.act: sends signal @p number when stderr says @p line."""
    def act(case, folder):
        with subprocess.Popen([PROGRAM, *shlex.split(case.command)], cwd=folder, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            said = ""
            while line not in said:
                more = process.stderr.readline()
                if not more:
                    raise AssertionError(f"ended before '{line}': {said}")
                said += more
            time.sleep(delay)
            if process.poll() is not None:
                raise AssertionError(f"ended before the signal: {said}{process.stderr.read()}")
            for _ in range(repeat):
                process.send_signal(number)
            out, err = process.communicate(timeout=TIMEOUT)
        return process.returncode, out, said + err
    return act


def next_run_works(test, folder):
    done = subprocess.run(
        [PROGRAM, *"bake box.gltf -o out.vdb --spacing 1 --rays 16 --quiet".split()], cwd=folder,
        capture_output=True, text=True, timeout=TIMEOUT, check=False)
    test.assertEqual((done.returncode, done.stderr), (0, ""))
    done = subprocess.run([PROGRAM, "stats", "out.vdb"], cwd=folder, capture_output=True,
                          timeout=TIMEOUT, check=False)
    test.assertEqual(done.returncode, 0)


def every_prefix(case, folder):
    """Reads prefixes of v.vdb, closer together at its ends. (Every single prefix of a volume, and
    every byte wrong, is tried in process: tests/vdb_io/test_damage.cpp.)"""
    data = VOLUMES.bytes()
    sizes = sorted({*range(0, 64, 13), *range(64, len(data), len(data) // 12),
                    *range(len(data) - 40, len(data), 9), len(data) - 1})
    for size in sizes:
        (folder / "cut.vdb").write_bytes(data[:size])
        code, out, err = run_in(folder, ["stats", "cut.vdb"])
        if code != 3 or "cut.vdb" not in err or err.count("\n") != 1:
            raise AssertionError(f"first {size} bytes: {code} {out} {err}")
    assert len(sizes) > 20, sizes
    return code, out, err


def flipped_bits(case, folder):
    """Reads copies of v.vdb with one bit wrong, one copy for each place."""
    data = VOLUMES.bytes()
    places = [0, 3, 8, 21, 60, *range(64, len(data), len(data) // 10)]
    for at in places:
        (folder / "flip.vdb").write_bytes(
            data[:at] + bytes([data[at] ^ (1 << (at % 8))]) + data[at + 1:])
        code, out, err = run_in(folder, ["query", "flip.vdb", "--points", "-"], stdin="0.5,0.2,0.2")
        if code != 3 or "flip.vdb" not in err or err.count("\n") != 1:
            raise AssertionError(f"byte {at}: {code} {out} {err}")
    assert len(places) > 14
    return code, out, err


def every_cut_glb(case, folder):
    """Bakes prefixes of a .glb file."""
    document = sf.gltf()
    data = sf.glb(document)
    sizes = [0, 1, 4, 11, 12, 16, 19, 20, 21, len(data) // 2, len(data) - 1]
    for size in sizes:
        (folder / "cut.glb").write_bytes(data[:size])
        code, out, err = run_in(folder, shlex.split(case.command))
        if code != 3 or "cut.glb" not in err or err.count("\n") != 1:
            raise AssertionError(f"first {size} bytes: {code} {out} {err}")
    return code, out, err


def run_in(folder, words, stdin=""):
    done = subprocess.run([PROGRAM, *words], cwd=folder, input=stdin, capture_output=True,
                          text=True, timeout=TIMEOUT, check=False, errors="replace")
    return done.returncode, done.stdout, done.stderr


# ---- The table.

def broken(**options):
    return {"bad.gltf": sf.scene(**options)}


def changed(change):
    return {"bad.gltf": sf.scene(change=change)}


def put(*keys, value):
    """For sf.gltf(change=…): document[k0][k1]… = value."""
    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value
    return change


def cube_with(index, vertex):
    return [vertex if i == index else p for i, p in enumerate(sf.CUBE_POSITIONS)]


BAD = "bake bad.gltf -o out.vdb --spacing 1 --rays 16"
BOX = "bake box.gltf -o out.vdb --spacing 1 --rays 16"
LARGE = ("bake box.gltf -o out.vdb --spacing 0.05 --rays 2 --max-bounces 0 --codec zip "
         "--preview-voxel -1")  # takes long to write

SCENES = [
    Case("missing file", "bake absent.glb -o out.vdb", 3, ("absent.glb", "no such file")),
    Case("empty file", BAD, 3, ("bad.gltf", "empty"), {"bad.gltf": b""}),
    Case("a folder", BAD, 3, ("bad.gltf", "not a file"), {"bad.gltf": folder_at}),
    Case("a pipe that nobody writes to", BAD, 3, ("bad.gltf", "not a file"), {"bad.gltf": pipe_at}),
    Case("broken JSON", BAD, 3, ("bad.gltf",), {"bad.gltf": sf.scene()[:200]}),
    Case("JSON of something else", BAD, 3, ("bad.gltf",), {"bad.gltf": b'{"name": "package"}'}),
    Case("JSON that is no object", BAD, 3, ("bad.gltf",), {"bad.gltf": b"[1, 2, 3]"}),
    Case("JSON nested 100,000 deep", BAD, 3, ("bad.gltf", "nested"),
         {"bad.gltf": b'{"extras":' + b"[" * 100000 + b"]" * 100000 + b"}"}),
    Case("text that is not UTF-8", BAD, 3, ("bad.gltf",), {"bad.gltf": b"\xff\xfe\x00{\xc3\x28}"}),
    Case("glTF 1.0", BAD, 3, ("bad.gltf", "2.0"), changed(put("asset", "version", value="1.0"))),
    Case("missing .bin buffer", BAD, 3, ("bad.gltf", "absent.bin"), broken(uri="absent.bin")),
    Case("buffer shorter than it says", BAD, 3, ("bad.gltf",),
         {**broken(uri="cut.bin"), "cut.bin": b"\0" * 100}),
    Case("buffer that claims 4 GB", BAD, 3, ("bad.gltf",),
         changed(put("buffers", 0, "byteLength", value=4 << 30))),
    Case("bufferView beyond its buffer", BAD, 3, ("bad.gltf", "bufferView"),
         changed(put("bufferViews", 0, "byteLength", value=100000))),
    Case("accessor beyond its bufferView", BAD, 3, ("bad.gltf", "bufferView"),
         changed(put("accessors", 0, "count", value=9))),
    Case("accessor of 10^15 elements", BAD, 3, ("bad.gltf",),
         changed(put("accessors", 1, "count", value=10 ** 15))),
    Case("accessor that is not there", BAD, 3, ("bad.gltf", "accessor"),
         changed(put("meshes", 0, "primitives", 0, "attributes", "POSITION", value=17))),
    Case("negative byte offset (read as 0)", BAD, 0, (),
         changed(put("accessors", 0, "byteOffset", value=-12))),
    Case("index beyond the vertices", BAD, 3, ("bad.gltf", "index", "vertex 8"),
         broken(indices=[0, 1, 8])),
    Case("indices that are floats", BAD, 3, ("bad.gltf", "indices"),
         changed(put("accessors", 1, "componentType", value=sf.FLOAT))),
    Case("material that is not there", BAD, 3, ("bad.gltf", "material"),
         changed(put("meshes", 0, "primitives", 0, "material", value=3))),
    Case("NaN vertex", BAD, 3, ("bad.gltf", "cube", "vertex 2", "not finite"),
         broken(positions=cube_with(2, (NAN, 0, 0)))),
    Case("infinite vertex", BAD, 3, ("bad.gltf", "cube", "vertex 7", "not finite"),
         broken(positions=cube_with(7, (0, -INF, 0)))),
    Case("transform that overflows", BAD, 3, ("bad.gltf",),
         broken(node={"scale": [1e300, 1e300, 1e300], "translation": [1e308, 1e308, 1e308]})),
    Case("transform of 15 numbers", BAD, 3, ("bad.gltf", "matrix"),
         broken(node={"matrix": [1.0] * 15})),
    Case("rotation of length 0", BAD, 3, ("bad.gltf", "rotation"),
         broken(node={"rotation": [0, 0, 0, 0]})),
    Case("node that is its own ancestor", BAD, 3, ("bad.gltf", "ancestor"),
         changed(lambda d: d["nodes"][0].update(children=[0]))),
    Case("two nodes in a circle", BAD, 3, ("bad.gltf", "ancestor"), changed(lambda d: d.update(
        nodes=[{"children": [1], "mesh": 0}, {"children": [0]}]))),
    Case("unknown required extension", BAD, 3, ("bad.gltf", "KHR_draco_mesh_compression"),
         broken(extra={"extensionsRequired": ["KHR_draco_mesh_compression"]})),
    Case("light of negative intensity", BAD, 3, ("bad.gltf", "intensity"),
         broken(lights=[{"type": "point", "intensity": -5}])),
    Case("light of an unknown type", BAD, 3, ("bad.gltf", "laser"),
         broken(lights=[{"type": "laser"}])),
    Case("zero triangles (warning)", BAD, 0, ("The scene has no triangles",), broken(triangles=[])),
    Case("missing texture (warning)", BAD, 0, ("taken as white", "absent.png"),
         broken(texture="absent.png")),
    Case("corrupt texture (warning)", BAD, 0, ("taken as white", "cut.png"),
         {**broken(texture="cut.png"), "cut.png": sf.png()[:40]}),
    Case("texture that claims 2^31 pixels (warning)", BAD, 0, ("taken as white", "bomb.png"),
         {**broken(texture="bomb.png"),
          "bomb.png": sf.png()[:16] + struct.pack(">2I", 65535, 65535) + sf.png()[24:]}),
    Case("truncated .glb, 11 lengths", "bake cut.glb -o out.vdb --spacing 1 --rays 16", 3,
         ("cut.glb",), act=every_cut_glb, loops="cut.glb"),
    Case(".glb of version 1", "bake bad.glb -o out.vdb", 3, ("bad.glb", "version 1"),
         {"bad.glb": b"glTF" + struct.pack("<4I", 1, 24, 0, 0) + b"    "}),
    Case("OBJ of letters", "bake bad.obj -o out.vdb --spacing 1 --rays 16", 3, ("bad.obj",),
         {"bad.obj": "v one two three\nf a b c\n"}),
    Case("OBJ whose face names vertex 99", "bake bad.obj -o out.vdb --spacing 1 --rays 16", 3,
         ("bad.obj",), {"bad.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"}),
    Case("OBJ of binary garbage", "bake bad.obj -o out.vdb --spacing 1 --rays 16", 3,
         ("bad.obj", "no triangles"),
         {"bad.obj": bytes((i * 7919 + i // 251) % 256 for i in range(4096))}),
    Case("OBJ without its MTL (warning)", "bake bad.obj -o out.vdb --spacing 1 --rays 16 "
         "--max-bounces 2", 0, ("missing", "absent.mtl"),
         {"bad.obj": sf.OBJ_CUBE.format(mtl="absent.mtl")}),
    Case("a .txt file as scene", "bake notes.txt -o out.vdb", 3, ("notes.txt",),
         {"notes.txt": "a scene of beauty\n"}),
    Case("a volume as scene", "bake v.vdb -o out.vdb", 3, ("v.vdb",)),
]

SKY = "bake box.gltf -o out.vdb --spacing 1 --rays 16 --env "
ENVIRONMENTS = [
    Case("environment missing", SKY + "absent.hdr", 3, ("absent.hdr", "could not open")),
    Case("environment empty", SKY + "sky.hdr", 3, ("sky.hdr",), {"sky.hdr": b""}),
    Case("environment is a folder", SKY + "sky.exr", 3, ("sky.exr", "not a file"),
         {"sky.exr": folder_at}),
    Case("environment is a pipe", "project sky.hdr", 3, ("sky.hdr", "not a file"),
         {"sky.hdr": pipe_at}),
    Case("environment without end", SKY + "/dev/zero", 3, ("/dev/zero", "not a file")),
    Case("environment of garbage", SKY + "sky.exr", 3, ("sky.exr",), {"sky.exr": b"sky" * 500}),
    Case("truncated HDR", SKY + "sky.hdr", 3, ("sky.hdr", "cut short"),
         {"sky.hdr": sf.radiance(16, 8)[:-64]}),
    Case("truncated EXR", SKY + "sky.exr", 3, ("sky.exr",), {"sky.exr": sf.exr(16, 8)[:-300]}),
    Case("EXR cut inside its header", SKY + "sky.exr", 3, ("sky.exr",),
         {"sky.exr": sf.exr(16, 8)[:150]}),
    Case("HDR that claims 10^12 pixels", SKY + "sky.hdr", 3, ("sky.hdr",),
         {"sky.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1000000 +X 1000000\n\x02\x02"}),
    Case("wrong aspect", SKY + "sky.hdr", 3, ("sky.hdr", "7 x 5", "2:1"),
         {"sky.hdr": sf.radiance(7, 5)}),
    Case("cross asked of a 2:1 picture", SKY + "sky.hdr --env-projection cross", 3,
         ("sky.hdr", "cross"), {"sky.hdr": sf.radiance(8, 4)}),
    Case("one pixel (an angular map of one colour)", "project sky.hdr --bands 1", 0, ("3.5449",),
         {"sky.hdr": sf.radiance(1, 1)}),
    Case("NaN, infinite and negative pixels (warning)", SKY + "sky.tif", 0,
         ("sky.tif", "3 pixels", "count as 0"),
         {"sky.tif": sf.tiff(8, 4, odd={3: (NAN, 1, 1), 9: (1, INF, 1), 20: (1, 1, -4)})}),
    Case("nothing but NaN (warning)", SKY + "sky.tif", 0, ("sky.tif", "32 pixels"),
         {"sky.tif": sf.tiff(8, 4, (NAN, NAN, NAN))}),
    Case("a text file as environment", "project notes.txt", 3, ("notes.txt",),
         {"notes.txt": "blue\n"}),
]


def option(words, says, command=None, code=2):
    """The option @p words behind @p command, in place of what the command gives for it."""
    base = command or BOX
    for name in ("--spacing", "--rays"):
        if command is None and words.startswith(name):
            base = re.sub(rf" {name} \S+", "", base)
    return Case(f"`{words}`", f"{base} {words}", code, says)


OPTIONS = [
    option("--rays 16k", ("--rays", "16k", "not an integer")),
    option("--rays 0", ("--rays 0", "out of range")),
    option("--rays -4", ("--rays",)),
    option("--rays 99999999999999999999", ("--rays", "99999999999999999999")),
    option("--rays=", ("--rays",)),
    option("--bands 7", ("--bands 7", "1 to 6")),
    option("--bands automatic", ("--bands automatic", "1 to 6", "auto")),
    option("--spacing -1", ("--spacing -1", "out of range")),
    option("--spacing nan", ("--spacing nan", "finite")),
    option("--spacing 1e400", ("--spacing 1e400",)),
    option("--spacing 1e-9", ("spacing", "samples")),
    option("--spacing 1e-300", ("spacing",)),
    option("--bounds 1,1,1,0,0,0", ("--bounds",)),
    option("--bounds 0,0,0,1,1", ("--bounds", "6 finite numbers")),
    option("--bounds 0,0,0,0,1,1", ("--bounds",)),
    option("--bounds 1e300,0,0,2e300,1,1", ("bounds", "lattice")),
    option("--levels -1", ("--levels -1", "0 to 12", "auto")),
    option("--levels 13", ("--levels 13", "0 to 12")),
    option("--gradients exact", ("--gradients exact", "analytic")),
    option("--visibility maybe", ("--visibility maybe", "on|off")),
    option("--target-error 0", ("--target-error 0", "1e-04 to 1")),
    option("--target-error 2%", ("--target-error 2%", "finite number")),
    Case("a target error that cannot be met (warning; the volume is written)",
         "bake lamp.gltf -o out.vdb --spacing 0.5 --target-error 0.05 --max-samples 1000 --rays 16 "
         "--bands 1 --gradients none", 1, ("out.vdb", "target error", "not met", "worst at"),
         {"lamp.gltf": sf.scene(emission=0.0, lights=[{"type": "point", "intensity": 1.0}])}),
    option("--confidence 1", ("--confidence 1", "0.9999")),
    option("--max-samples 10", ("--max-samples 10", "1000")),
    option("--refine errors", ("--refine errors", "error|gradient|geometry|harmonic|brute")),
    option("--refine ''", ("--refine", "no heuristic")),
    option("--refine-threshold error", ("--refine-threshold error", "NAME=V")),
    option("--refine-threshold error=-1", ("--refine-threshold error=-1", "above 0")),
    option("--refine-threshold colour=1", ("--refine-threshold colour=1", "gradient")),
    option("--refine-threshold geometry=0.5", ("geometry=0.5", "geometry=LEVEL")),
    option("--part 3/2", ("--part 3/2", "I/N")),
    option("--part 1/2", ("arts", "adaptive")),
    option("--part 1/2 --target-error 0.1", ("target error", "whole volume")),
    option("--integrator photon", ("--integrator photon", "path")),
    option("--contribution most", ("--contribution most",)),
    option("--max-bounces -2", ("--max-bounces",)),
    option("--up x", ("--up x",)),
    option("--codec rar", ("--codec rar",)),
    option("--seed 1.5", ("--seed 1.5",)),
    option("--threads 2000", ("--threads 2000",)),
    option("--preview-voxel nan", ("--preview-voxel nan",)),
    option("--preview-voxel 1e-9", ("review",)),
    option("--env-rotate 30", ("--env-rotate", "--env")),
    option("--sun-lux 3", ("--sun-direction",)),
    option("--sun-direction 0,0,0 --sun-lux 1", ("--sun-direction 0,0,0",)),
    option("--light-group moon", ("moon", "wall")),
    option("--spaicng 1", ("--spaicng", "--spacing")),
    option("--spacing 1 --spacing 2", ("--spacing",)),
    option("more.gltf", ("more.gltf",)),
    Case("no output option", "bake box.gltf", 2, ("-o",)),
    Case("option without its value", "bake box.gltf -o", 2, ("-o",)),
    Case("unknown command", "bkae box.gltf", 2, ("bkae", "did you mean bake")),
    Case("option before the command", "--rays 16 bake", 2, ("--rays",)),
    option("--size 0x0", ("--size",), "render box.gltf --volume v.vdb -o out.png"),
    option("--eye 1,1,1 --target 1,1,1", ("--eye", "same point"),
           "render box.gltf --volume v.vdb -o out.png"),
    option("--slice w=1", ("--slice",), "render box.gltf --volume v.vdb -o out.png"),
    option("--slice y=99", ("--slice", "outside", "v.vdb"),
           "render box.gltf --volume v.vdb -o out.png"),
    Case("picture of an unknown kind", "render box.gltf --volume v.vdb -o out.gif", 2,
         ("out.gif", ".png")),
    option("--normals 0", ("--normals 0",), "evaluate v.vdb --scene box.gltf"),
    option("--max-error -1", ("--max-error",), "evaluate v.vdb --scene box.gltf"),
    option("--contribution direct", ("--contribution direct", "v.vdb"),
           "evaluate v.vdb --scene box.gltf"),
    Case("a bound that is not met", "evaluate v.vdb --scene box.gltf --points 4 --rays 64 "
         "--max-error 0", 1, ("--max-error",)),
    option("--transform 1,2", ("--transform",), "resample v.vdb -o out.vdb"),
    option("--transform 2,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1", ("rotation",),
           "resample v.vdb -o out.vdb"),
    option("--scale inf", ("--scale",), "resample v.vdb -o out.vdb"),
    option("--crop 5,5,5,6,6,6", ("crop box",), "resample v.vdb -o out.vdb"),
    option("--levels auto", ("--levels auto", "0 to 12"), "resample v.vdb -o out.vdb"),
    option("--tolerance 0.1", ("--tolerance", "--levels"), "resample v.vdb -o out.vdb"),
    option("--mode tricubic", ("--mode tricubic", "v.vdb", "gradients"),
           "query v.vdb --points -"),
    option("--add v.vdb", ("--add", "FILE=W"), "resample -o out.vdb"),
    option("--add v.vdb=1 --add absent.vdb=1", ("absent.vdb",), "resample -o out.vdb", 3),
]


def metadata(name, kind, old, new):
    return volume(lambda data: vb.replaced(data, vb.metadata_value(name, kind, old),
                                           vb.metadata_value(name, kind, new)))


def other_topology(data):
    """sh_0 of w.vdb, which has other voxels, in v.vdb."""
    other = VOLUMES.bytes("w.vdb")
    options = [re.search(rb"--bounds \S+", file).group() for file in (data, other)]
    begin, end = vb.grids(other)["sh_0"]
    grid = other[begin:end].replace(options[1], options[0])
    return vb.edited(data, "sh_0", lambda old: grid)


def last_value(bits):
    """sh_0 with its last value (three floats before the end of the grid) changed."""
    return lambda data: vb.edited(data, "sh_0", lambda grid: grid[:-12] + struct.pack("<3f", *bits))


def said_to_be_packed(grid):
    """The grid, which has no codec, with Blosc's flag: its values are taken for sizes."""
    return struct.pack("<I", 6) + grid[4:]


STATS = "stats bad.vdb"
VOLUME_FILES = [
    Case("volume missing", "stats absent.vdb", 3, ("absent.vdb", "does not exist")),
    Case("volume empty", STATS, 3, ("bad.vdb",), {"bad.vdb": b""}),
    Case("volume is a folder", STATS, 3, ("bad.vdb", "not a file"), {"bad.vdb": folder_at}),
    Case("volume is a text file", STATS, 3, ("bad.vdb", "not an OpenVDB file"),
         {"bad.vdb": "not a volume\n" * 100}),
    Case("truncated at 23 places", "stats cut.vdb", 3, ("cut.vdb", "truncated"),
         act=every_prefix, loops="cut.vdb"),
    Case("one bit wrong, at 16 places", "query flip.vdb --points -", 3, ("flip.vdb",),
         act=flipped_bits, loops="flip.vdb"),
    Case("more bytes behind the end", STATS, 3, ("bad.vdb",),
         {"bad.vdb": volume(lambda data: data + b"\n")}),
    Case("OpenVDB file of another program", "query bad.vdb --points -", 3,
         ("bad.vdb", "not an irradiance volume"),
         {"bad.vdb": with_pyopenvdb("g = vdb.createLevelSetSphere(radius=5)\n"
                                    "vdb.write(path, grids=[g])\n")}),
    Case("rewritten by another program that dropped 'level'", STATS, 3,
         ("bad.vdb", "'level'", "missing"),
         {"bad.vdb": with_pyopenvdb(
             "g = [vdb.read(source, n) for n in ('sh_0', 'validity', 'distance')]\n"
             "vdb.write(path, grids=g)\n")}),
    Case("format version 2", STATS, 3, ("bad.vdb", "version 2"),
         {"bad.vdb": metadata(b"lumivdb_version", b"int32", b"\1\0\0\0", b"\2\0\0\0")}),
    Case("bands 7", STATS, 3, ("bad.vdb", "7 bands"),
         {"bad.vdb": metadata(b"lumivdb_bands", b"int32", b"\1\0\0\0", b"\7\0\0\0")}),
    Case("bands 2 but one coefficient", STATS, 3, ("bad.vdb", "sh_1", "missing"),
         {"bad.vdb": metadata(b"lumivdb_bands", b"int32", b"\1\0\0\0", b"\2\0\0\0")}),
    Case("another quantity", STATS, 3, ("bad.vdb", "radiance"),
         {"bad.vdb": metadata(b"lumivdb_quantity", b"string", b"radiance", b"darkness")}),
    Case("missing channel", STATS, 3, ("bad.vdb", "'sh_0'", "missing"),
         {"bad.vdb": volume(lambda d: vb.replaced(d, b"\4\0\0\0sh_0", b"\4\0\0\0xh_0"))}),
    Case("missing validity", STATS, 3, ("bad.vdb", "'validity'", "missing"),
         {"bad.vdb": volume(lambda d: vb.replaced(d, b"validity", b"valldity"))}),
    Case("mixed topology", STATS, 3, ("bad.vdb", "'sh_0'", "different active voxels"),
         {"bad.vdb": volume(other_topology)}),
    Case("channel of another bake", STATS, 3, ("bad.vdb", "'sh_0'", "different volumes"),
         {"bad.vdb": volume(lambda d: vb.edited(d, "sh_0", lambda g: g.replace(
             b"--rays 16", b"--rays 64")))}),
    Case("NaN in a channel", STATS, 3, ("bad.vdb", "'sh_0'", "NaN"),
         {"bad.vdb": volume(last_value((NAN, 1, 1)))}),
    Case("infinity in a channel", "query bad.vdb --points -", 3, ("bad.vdb", "'sh_0'", "infinite"),
         {"bad.vdb": volume(last_value((1, 1, -INF)))}),
    Case("values where sizes should be", STATS, 3,
         ("bad.vdb", "'sh_0'", "values have the size"),
         {"bad.vdb": volume(lambda d: vb.edited(d, "sh_0", said_to_be_packed))}),
    Case("another map in one channel", STATS, 3, ("bad.vdb", "'sh_0'", "transforms"),
         {"bad.vdb": volume(lambda d: vb.edited(d, "sh_0", lambda g: g.replace(
             struct.pack("<d", 0.25), struct.pack("<d", 0.5))))}),
    Case("sum of volumes over other boxes", "resample --add v.vdb=1 --add w.vdb=1 -o out.vdb", 2,
         ("v.vdb", "w.vdb")),
    Case("sum of volumes with other bands", "resample --add v.vdb=1 --add two_bands.vdb=1 -o out.vdb", 2,
         ("two_bands.vdb", "bands")),
    Case("half precision that overflows", "resample v.vdb --scale 1e6 --half -o out.vdb", 4,
         ("out.vdb", "65504")),
    Case("scale that overflows", "resample v.vdb --scale 1e30 --add v.vdb=1e30 -o out.vdb", 4,
         ("out.vdb", "infinite")),
    Case("join of one volume with itself", "resample v.vdb v.vdb -o out.vdb", 0, ("out.vdb",)),
]

QUERY = "query v.vdb --points p.csv"
POINTS = [
    Case("letters", QUERY, 3, ("p.csv", "line 2", "abc"), {"p.csv": "0,0,0\n1,abc,2\n"}),
    Case("4 columns", QUERY, 3, ("p.csv", "line 1", "4 values"), {"p.csv": "1,2,3,4\n"}),
    Case("rows of different lengths", QUERY, 3, ("p.csv", "line 2", "6 values"),
         {"p.csv": "0,0,0\n0,0,0,0,1,0\n"}),
    Case("NaN", QUERY, 3, ("p.csv", "line 1", "nan"), {"p.csv": "nan,0,0\n"}),
    Case("number that overflows", QUERY, 3, ("p.csv", "line 1", "1e999"), {"p.csv": "1e999,0,0\n"}),
    Case("zero normal", QUERY, 3, ("p.csv", "line 1", "normal"), {"p.csv": "0,0,0,0,0,0\n"}),
    Case("header without z", QUERY, 3, ("p.csv", "line 1", "column"), {"p.csv": "x,y\n1,2\n"}),
    Case("binary garbage", QUERY, 3, ("p.csv", "line 1"), {"p.csv": bytes(range(1, 256)) * 4}),
    Case("missing points file", QUERY, 3, ("p.csv", "No such file")),
    Case("points file is a folder", QUERY, 3, ("p.csv", "directory"), {"p.csv": folder_at}),
    Case("empty points file (a header comes out)", QUERY, 0, ("x,y,z",), {"p.csv": b""}),
    Case("point outside (level -1, no invented light)", QUERY, 0, ("9,9,9,0,1,0,nan,nan,nan,-1",),
         {"p.csv": "9,9,9,0,1,0\n"}),
    Case("point at 1e300", QUERY, 0, (",-1,",), {"p.csv": "1e300,-1e300,0\n"}),
    Case("probe at NaN", "probe box.gltf --points - --rays 16", 3, ("standard input", "line 1"),
         stdin="0,nan,0\n"),
    Case("mode taylor without gradients", "query v.vdb --points - --mode taylor", 2,
         ("v.vdb", "no gradients"), stdin="0,0,0\n"),
    Case("mode gradient without gradients", "query v.vdb --points - --mode gradient", 2,
         ("v.vdb", "no gradients"), stdin="0,0,0\n"),
    Case("unknown mode", "query g.vdb --points - --mode cubic", 2, ("--mode cubic",),
         stdin="0,0,0\n"),
    Case("evaluate: no free-space point", "evaluate solid.vdb --scene solid.gltf --points 4 "
         "--rays 16", 3, ("free",),
         {"solid.gltf": sf.scene(double_sided=False, triangles=[
             (a, c, b) for a, b, c in sf.CUBE_TRIANGLES]),
          "solid.vdb": lambda path: run_in(path.parent, shlex.split(
              "bake solid.gltf -o solid.vdb --bounds -0.5,-0.5,-0.5,0.5,0.5,0.5 --spacing 0.5 "
              "--rays 16 --quiet"))}),
    Case("evaluate: given points outside", "evaluate v.vdb --scene box.gltf --points-file p.csv "
         "--rays 16", 3, ("",), {"p.csv": "9,9,9\n"}),
    Case("evaluate: another scene (warning)", "evaluate v.vdb --scene other.gltf --points 4 "
         "--rays 16", 0, ("another scene", "v.vdb"), {"other.gltf": sf.scene(emission=2.0)}),
]


OUTPUTS = [
    Case("folder missing", BOX.replace("out.vdb", "no/out.vdb"), 4, ("no/out.vdb", "does not exist")),
    Case("output is a folder", BOX, 4, ("out.vdb", "folder"), {"out.vdb": folder_at}, old=False),
    Case("output below a regular file", BOX.replace("out.vdb", "file/out.vdb"), 4, ("file/out.vdb",),
         {"file": b"x"}),
    Case("output under /proc", BOX.replace("out.vdb", "/proc/out.vdb"), 4, ("/proc/out.vdb",)),
    Case("output is a device", BOX.replace("out.vdb", "/dev/full"), 4, ("/dev/full",)),
    Case("output with an empty name", BOX.replace("out.vdb", "''"), 2, ("--output", "empty")),
    Case("name of 300 letters", BOX.replace("out.vdb", "n" * 300), 4, ("-o", "name too long")),
    Case("folder that may not be written to", BOX.replace("out.vdb", "locked/out.vdb"), 4,
         ("locked",), around=without_write_permission),
    Case("read-only file system", BOX.replace("out.vdb", "disk/out.vdb"), 4, ("disk",),
         around=mounted("remount,ro")),
    Case("full disk (64 kB), volume", BOX.replace("out.vdb", "disk/out.vdb"), 4,
         ("disk/out.vdb", "No space left"), around=mounted()),
    Case("full disk (64 kB), resample", "resample big.vdb -o disk/out.vdb", 4,
         ("disk/out.vdb", "No space left"), {"big.vdb": lambda path: run_in(
             path.parent, shlex.split("bake box.gltf -o big.vdb --spacing 0.5 --rays 2 --quiet"))},
         around=mounted()),
    Case("full disk (64 kB), picture", "render box.gltf --volume noisy.vdb -o disk/out.exr --size "
         "300x300 --samples 1", 4, ("disk/out.exr", "No space left"), around=mounted()),
    Case("full disk (64 kB), report", "query v.vdb --points p.csv --json disk/out.json", 4,
         ("disk/out.json", "No space left"), {"p.csv": "0.5,0.2,0.2\n" * 2000}, around=mounted()),
    Case("file size limit (ulimit -f), volume", f"ulimit -f 16; lumivdb {BOX}", 4,
         ("out.vdb", "File too large"), shell=True),
    Case("file size limit (ulimit -f), picture", "ulimit -f 16; lumivdb render box.gltf --volume "
         "noisy.vdb -o out.exr --size 300x300 --samples 1", 4, ("out.exr", "File too large"), shell=True),
    Case("standard output full", "lumivdb stats v.vdb >/dev/full", 4,
         ("standard output", "No space left"), shell=True),
    Case("standard output closed", "lumivdb stats v.vdb >&-", 4, ("standard output",), shell=True),
    Case("reader of a pipe leaves early", "set -o pipefail; lumivdb query v.vdb --points p.csv | "
         "head -1", 0, ("x,y,z",), {"p.csv": "0.5,0.2,0.2\n" * 20000}, shell=True),
    Case("standard input closed", "lumivdb query v.vdb --points - <&-", 3, ("standard input",),
         shell=True),
    Case("report in a missing folder", BOX + " --json no/r.json", 4, ("no/r.json", "--json")),
    Case("Ctrl-C while tracing", BOX.replace("--rays 16", "--rays 4000000"), 130, ("nterrupted",),
         act=signalled(signal.SIGINT, "trace samples")),
    Case("Ctrl-C while refining", BOX.replace("--rays 16", "--rays 400000 --levels 2"), 130,
         ("nterrupted",), act=signalled(signal.SIGINT, "trace samples: done"), old=True),
    Case("Ctrl-C while the error is measured", BOX + " --target-error 1e-4 --max-samples 1000 "
         "--bands 1 --gradients none", 130, ("nterrupted",),
         act=signalled(signal.SIGINT, "trace the reference"), old=True),
    Case("Ctrl-C while writing", LARGE, 130, ("nterrupted",),
         act=signalled(signal.SIGINT, "write volume"), after=next_run_works, old=True),
    Case("Ctrl-C twice while tracing", BOX.replace("--rays 16", "--rays 4000000"), 130, (),
         act=signalled(signal.SIGINT, "trace samples", repeat=2)),
    Case("SIGTERM while writing", LARGE, 130, ("nterrupted",),
         act=signalled(signal.SIGTERM, "write volume"), old=False),
    Case("kill -9 while writing", LARGE, -9, (), act=signalled(signal.SIGKILL, "write volume"),
         after=next_run_works, old=True),
    Case("kill -9 while tracing", BOX.replace("--rays 16", "--rays 4000000"), -9, (),
         act=signalled(signal.SIGKILL, "trace samples"), after=next_run_works, old=False),
]

NAMES = [
    Case("scene, buffer and texture with names in other scripts",
         "bake 'сцена é.gltf' -o '体積 ü.vdb' --spacing 1 --rays 16", 0, ("体積 ü.vdb",),
         {"сцена é.gltf": sf.scene(uri="データ.bin", texture="bild%20ß.png"),
          "データ.bin": b"".join(struct.pack("<3f", *p) for p in sf.CUBE_POSITIONS)
          + struct.pack("<36I", *[i for t in sf.CUBE_TRIANGLES for i in t]),
          "bild ß.png": sf.png()}),
    Case("OBJ and MTL with names in other scripts", "bake 'комната.obj' -o out.vdb --spacing 1 "
         "--rays 16 --max-bounces 2", 0, ("out.vdb",),
         {"комната.obj": sf.OBJ_CUBE.format(mtl="краски.mtl"),
          "краски.mtl": "newmtl wall\nKd 0.5 0.5 0.5\nKe 1 1 1\n"}),
    Case("environment with such a name", "project '空.hdr' --bands 1", 0, ("3.5449",),
         {"空.hdr": sf.radiance(8, 4)}),
    Case("missing file with such a name", "bake 'нет.glb' -o out.vdb", 3, ("нет.glb",)),
    Case("name with a line break", "bake 'a\\nb.glb' -o out.vdb", 3, ("a b.glb",)),
    Case("name that is not UTF-8", "lumivdb bake $'\\xff\\xfe.glb' -o out.vdb", 3, (".glb",),
         shell=True),
    Case("output over its own input", "resample v.vdb -o v.vdb --scale 2", 0, ("v.vdb",),
         old=False),
    Case("output that is the scene", "bake box.gltf -o box.gltf --spacing 1 --rays 16", 2,
         ("box.gltf",), old=False),
    Case("report that is the volume", BOX + " --json out.vdb", 2, ("out.vdb", "overwritten")),
    Case("report over the volume it describes", "stats v.vdb --json ./v.vdb", 2,
         ("v.vdb", "overwritten")),
]

GROUPS = [("Scenes", SCENES), ("Environments", ENVIRONMENTS), ("Options", OPTIONS),
          ("Volume files", VOLUME_FILES), ("Points", POINTS), ("Outputs and interrupts", OUTPUTS),
          ("Names", NAMES)]


# ---- Running a case.

def words_of(case):
    return [word.replace("\\n", "\n") for word in shlex.split(case.command)]


def output_of(case):
    """The path after -o, when it lies in the case's folder."""
    words = shlex.split(case.command.replace("$'", "'"))
    if "-o" not in words or words.index("-o") + 1 == len(words):
        return None
    path = words[words.index("-o") + 1].rstrip(";")
    return None if not path or path.startswith("/") or len(path) > 255 else path


def arrange(case, folder):
    shutil.copy(VOLUMES.folder / "box.gltf", folder / "box.gltf")
    for name in VOLUMES.OPTIONS:
        if re.search(rf"(^|[ =]){re.escape(name)}", case.command):
            shutil.copy(VOLUMES.get(name), folder / name)
    for name, content in case.files.items():
        if callable(content):
            content(folder / name)
        else:
            (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    output = output_of(case)
    old = case.old if case.old is not None else zlib.crc32(case.name.encode()) % 2 == 1
    if output and old and "/" not in output and not (folder / output).exists():
        (folder / output).write_bytes(OLD)


def content_of(folder):
    """{path: bytes; None for what is no file}"""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None
            for p in folder.rglob("*")}


def execute(case, folder):
    """-> (code, stdout, stderr)"""
    if case.act:
        return case.act(case, folder)
    if case.shell:
        script = f'lumivdb() {{ {shlex.quote(str(PROGRAM))} "$@"; }}; {case.command}'
        done = subprocess.run(["bash", "-c", script], cwd=folder, input=case.stdin,
                              capture_output=True, text=True, timeout=TIMEOUT, check=False,
                              errors="replace")
        return done.returncode, done.stdout, done.stderr
    return run_in(folder, words_of(case), case.stdin)


class BadInput(unittest.TestCase):
    """A test for each group of cases. They run two at a time: most of a case is starting up."""

    maxDiff = None

    def run_group(self, cases):
        for case, result in outcomes(cases):
            with self.subTest(case.name):
                if isinstance(result, BaseException):
                    raise result

    def check(self, case):
        """-> (exit code, stdout, stderr)"""
        with tempfile.TemporaryDirectory(prefix="lumivdb_bad_") as name, \
                contextlib.ExitStack() as stack:
            folder = pathlib.Path(name)
            if case.around:
                stack.enter_context(case.around(folder))
            arrange(case, folder)
            before = content_of(folder)
            code, out, err = execute(case, folder)
            said = f"lumivdb {case.command}\n{out[-2000:]}\n{err[-3000:]}"
            self.assertEqual(code, case.code, said)
            self.check_words(case, out, err, said)
            self.check_folder(case, before, content_of(folder), said)
            if case.after:
                case.after(self, folder)
            return code, out, err

    def check_words(self, case, out, err, said):
        for sign in ("Traceback", "terminate called", "Sanitizer", "runtime error", "Assertion"):
            self.assertNotIn(sign, err, said)
        lines = err.splitlines()
        errors = [line for line in lines if line.startswith("lumivdb: ")]
        if case.code in (0, 1) or case.code < 0 or not case.says:
            self.assertLessEqual(len(errors), 1 if case.code else 0, said)
            text = out + err
        else:
            self.assertEqual(len(errors), 1, said)
            text = lines[-1]
            self.assertEqual(text, errors[0], said)
            self.assertRegex(text, r"[.?]$", said)
            self.assertLess(len(text), 700, said)
        for word in case.says:
            self.assertIn(word.lower(), text.lower(), said)

    def check_folder(self, case, before, after, said):
        output = output_of(case)
        done = case.code in (0, 1)
        for path, content in before.items():
            if not (done and path == output):
                self.assertEqual(after.get(path, "gone"), content, f"{path} changed\n{said}")
        new = set(after) - set(before) - {case.loops}
        if case.code < 0:  # where the file system knows no unnamed files, a killed run leaves its own
            new = {name for name in new if not re.fullmatch(r"\.lumivdb-[0-9a-f]+\.tmp", name)}
        if "bake " in case.command and case.code in (2, 4, 130, -9):  # what --resume goes on from
            new.discard(f"{output}.journal")
        self.assertEqual(new, {output} - {None} - set(before) if done else set(), said)


def outcomes(cases):
    """(case, (code, stdout, stderr) or what the check raised), in order."""
    wanted = os.environ.get("LUMIVDB_CASE", "").lower()
    cases = [case for case in cases if wanted in case.name.lower()]

    def outcome(case):
        try:
            return BadInput().check(case)
        except BaseException as error:  # pylint: disable=broad-exception-caught
            return error
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        yield from zip(cases, pool.map(outcome, cases))


for _group, _cases in GROUPS:
    assert len({case.name for case in _cases}) == len(_cases), _group
    setattr(BadInput, "test_" + _group.lower().replace(" ", "_"),
            lambda self, cases=_cases: self.run_group(cases))


class Files(unittest.TestCase):
    """The editors of files that the cases rest on."""

    def test_checksum_of_a_real_file(self):
        data = VOLUMES.bytes()
        self.assertTrue(vb.checksum_is_right(data))
        self.assertEqual(vb.sealed(data), data)
        self.assertEqual(set(vb.grids(data)), {"level", "validity", "distance", "sh_0"})

    def test_an_edit_that_is_allowed_is_read(self):
        with tempfile.TemporaryDirectory() as name:
            path = pathlib.Path(name) / "edited.vdb"
            path.write_bytes(last_value((75.0, 1, 1))(VOLUMES.bytes()))
            code, out, err = run_in(name, ["stats", "edited.vdb", "--json", "-"])
            self.assertEqual(code, 0, err)
            sh_0 = [c for c in json.loads(out)["channels"] if c["name"] == "sh_0"][0]
            self.assertEqual(sh_0["max"], 75.0)

    def test_there_are_enough_cases(self):
        self.assertGreater(sum(len(cases) for _, cases in GROUPS), 150)
        self.assertFalse(math.isfinite(NAN))


def prepare():
    global VOLUMES
    folder = pathlib.Path(tempfile.mkdtemp(prefix="lumivdb_bad_"))
    VOLUMES = Volumes(folder)
    return folder


def setUpModule():
    unittest.addModuleCleanup(shutil.rmtree, prepare(), ignore_errors=True)


# ---- The document.

INTRODUCTION = """# Bad input and hard cases

What the program does with input that is wrong, missing or hostile, and with outputs that cannot be
written. Made by `python3 tests/cli/test_bad_input.py --table` and, for the last section,
`python3 tests/cli/test_hard_cases.py --table --large`; the same two scripts are tests that fail when a code,
a message or a left-over file differs. No case crashes, none leaves a broken or an unnamed file: an
output is written under another name (or none) in its folder and takes the place of the old file at
the end. Only `kill -9` on a file system without unnamed files (O_TMPFILE) can leave a
`.lumivdb-*.tmp`, which may be deleted. A bake that was stopped, or whose volume could not be written,
leaves `OUT.vdb.journal` with what it traced, for --resume. Exit codes: 0 done, 1 a bound was not met, 2 usage,
3 unusable input, 4 output cannot be written, 130 interrupted."""


def cell(text):
    return re.sub(r"n{50,}", "nnn…", text.replace("|", "\\|").replace("\n", " "))


def message_of(case, result):
    """The sentence that a user reads: the error, the warnings, or what is printed."""
    code, out, err = result
    lines = err.splitlines()
    errors = [line[len("lumivdb: "):] for line in lines if line.startswith("lumivdb: ")]
    warnings = [line for line in lines if line.startswith("warning: ")]
    if errors or warnings:
        return " ".join(errors or warnings)
    if code < 0:
        return "(killed: the old file is whole, only the journal is left, the next run works)"
    return " ".join(f"({word})" for word in case.says if word in out)


def print_table():
    print(INTRODUCTION)
    for group, cases in GROUPS:
        print(f"\n## {group}\n\n| case | command | exit code | message |\n|---|---|---|---|")
        for case, result in outcomes(cases):
            command = case.command if case.shell else "lumivdb " + case.command
            if isinstance(result, unittest.SkipTest):
                code, message = "not run", str(result)
            elif isinstance(result, BaseException):
                raise result
            else:
                code, message = str(result[0]), message_of(case, result)
            print(f"| {cell(case.name)} | `{cell(command)}` | {code} | {cell(message)} |", flush=True)


if __name__ == "__main__":
    if "--table" in sys.argv:
        made = prepare()
        try:
            print_table()
        finally:
            shutil.rmtree(made, ignore_errors=True)
    else:
        unittest.main()
