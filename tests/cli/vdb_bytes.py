# SPDX-License-Identifier: Apache-2.0
"""Edits volume files byte by byte: the checksum is made right again, so that what is refused is the
content and not the checksum. Layout: docs/FORMAT.md and OpenVDB's io/File.cc, file version 224."""
import struct

FOOTER = 24  # bytes: magic, format version, length, checksum


def xxhash64(data):
    """XXH64 with seed 0 (Y. Collet, xxHash specification)."""
    p1, p2, p3 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9
    p4, p5, mask = 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5, (1 << 64) - 1

    def rotl(v, r):
        return ((v << r) | (v >> (64 - r))) & mask

    def step(acc, lane):
        return rotl((acc + lane * p2) & mask, 31) * p1 & mask
    n, at = len(data), 0
    if n >= 32:
        acc = [(p1 + p2) & mask, p2, 0, -p1 & mask]
        for lanes in struct.iter_unpack("<4Q", data[:n - n % 32]):
            acc = [step(a, lane) for a, lane in zip(acc, lanes)]
        at = n - n % 32
        h = sum(rotl(a, r) for a, r in zip(acc, (1, 7, 12, 18))) & mask
        for a in acc:
            h = ((h ^ step(0, a)) * p1 + p4) & mask
    else:
        h = p5
    h = (h + n) & mask
    while at + 8 <= n:
        h = (rotl(h ^ step(0, struct.unpack_from("<Q", data, at)[0]), 27) * p1 + p4) & mask
        at += 8
    if at + 4 <= n:
        h = (rotl(h ^ struct.unpack_from("<I", data, at)[0] * p1 & mask, 23) * p2 + p3) & mask
        at += 4
    for byte in data[at:]:
        h = rotl(h ^ byte * p5 & mask, 11) * p1 & mask
    for shift, factor in ((33, p2), (29, p3), (32, 1)):
        h = ((h ^ (h >> shift)) * factor) & mask
    return h


def checksum_is_right(data):
    body, footer = data[:-FOOTER], data[-FOOTER:]
    length, checksum = struct.unpack_from("<2Q", footer, 8)
    return length == len(body) and checksum == xxhash64(body)


def sealed(data):
    """@p data (with its old footer) with a new checksum."""
    body = data[:-FOOTER]
    return body + data[-FOOTER:-FOOTER + 8] + struct.pack("<2Q", len(body), xxhash64(body))


def replaced(data, old, new, count=-1):
    """All of @p old by @p new of the same length; the file with a new checksum."""
    assert len(old) == len(new) and data.find(old) >= 0, (old, new)
    return sealed(data.replace(old, new, count))


def grids(data):
    """{name: (first byte of the grid, behind the last)}"""
    return {name: (begin, end) for name, (begin, _, end) in _places(data).items()}


def _places(data):
    """{name: (first byte of the grid, of its buffers, behind the last)}"""
    at = 8 + 12 + 1 + 36

    def word():
        nonlocal at
        at += 4
        return struct.unpack_from("<I", data, at - 4)[0]

    def words():
        nonlocal at
        size = word()
        at += size
        return data[at - size:at].decode()
    for _ in range(word()):
        words(), words(), words()
    found = {}
    for _ in range(word()):
        name = words()
        words(), words()
        found[name] = struct.unpack_from("<3q", data, at)
        at = found[name][2]
    return found


def parts_of_grids(data):
    """{name: (its metadata as a dictionary, all else of it: transform, tree, values)}"""
    found = {}
    for name, (begin, _, end) in _places(data).items():
        at = begin + 4  # the compression's flags

        def words():
            nonlocal at
            size = struct.unpack_from("<I", data, at)[0]
            at += 4 + size
            return data[at - size:at]
        count = struct.unpack_from("<I", data, at)[0]
        at += 4
        metadata = {}
        for _ in range(count):
            key, _, metadata[key] = words().decode(), words(), words()
        found[name] = (metadata, data[begin:begin + 4] + data[at:end])
    return found


def edited(data, grid, change):
    """The file with change(bytes of the grid), of the same length, and a new checksum."""
    begin, end = grids(data)[grid]
    new = change(data[begin:end])
    assert len(new) == end - begin
    return sealed(data[:begin] + new + data[end:])


def metadata_value(name, kind, value):
    """How a file stores an entry, to be replaced by another of the same length."""
    return (struct.pack("<I", len(name)) + name + struct.pack("<I", len(kind)) + kind
            + struct.pack("<I", len(value)) + value)
