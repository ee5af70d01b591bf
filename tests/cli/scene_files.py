# SPDX-License-Identifier: Apache-2.0
"""Small scenes and environment images as bytes, whole or broken on purpose."""
import base64
import json
import struct

ARRAY_BUFFER, FLOAT, UINT32 = 34962, 5126, 5125

# A cube seen from inside, side 2, about the origin: corners (-1 or 1)³, normals inwards.
CUBE_POSITIONS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
CUBE_TRIANGLES = [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
                  (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)]


def gltf(positions=None, triangles=None, *, emission=1.0, albedo=0.5, double_sided=True,
         strength=None, node=None, indices=None, uri=None, extra=None, change=None, lights=None,
         texture=None):
    """A glTF 2.0 document (a dictionary) of one mesh, its buffer inside as base64.

    @p indices: numbers instead of triangles. @p uri: of the buffer. @p extra: added to the top.
    @p change(document): whatever else is to be broken. @p texture: URI of a base colour image."""
    positions = CUBE_POSITIONS if positions is None else positions
    flat = indices if indices is not None else [
        i for t in (CUBE_TRIANGLES if triangles is None else triangles) for i in t]
    vertices = b"".join(struct.pack("<3f", *p) for p in positions)
    data = vertices + struct.pack(f"<{len(flat)}I", *flat)
    material = {"name": "wall", "doubleSided": double_sided,
                "pbrMetallicRoughness": {"baseColorFactor": [albedo, albedo, albedo, 1],
                                         "metallicFactor": 0},
                "emissiveFactor": [emission] * 3}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "box", "mesh": 0, **(node or {})}],
        "meshes": [{"name": "cube", "primitives": [
            {"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [material],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": len(positions), "type": "VEC3",
             "min": [-1, -1, -1], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": UINT32, "count": len(flat), "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(vertices)},
                        {"buffer": 0, "byteOffset": len(vertices),
                         "byteLength": len(data) - len(vertices)}],
        "buffers": [{"byteLength": len(data), "uri": uri or
                     "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
    }
    if strength is not None:
        material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        document["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    if texture is not None:
        document["images"] = [{"uri": texture}]
        document["textures"] = [{"source": 0}]
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    if lights is not None:
        document["extensionsUsed"] = ["KHR_lights_punctual"]
        document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
        document["nodes"] += [{"extensions": {"KHR_lights_punctual": {"light": i}}}
                              for i in range(len(lights))]
        document["scenes"][0]["nodes"] = list(range(len(document["nodes"])))
    document.update(extra or {})
    if change:
        change(document)
    return document


def text(document):
    """The document as a .gltf file. NaN and Infinity are no JSON, so they are not written."""
    return json.dumps(document).encode()


def scene(*args, **options):
    return text(gltf(*args, **options))


def glb(document, data=b""):
    """The document and its buffer as a .glb file."""
    body = json.dumps(document).encode()
    body += b" " * (-len(body) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(body), b"JSON") + body
    if data:
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def grid_glb(path, quads, emission=1.0):
    """A square of quads × quads × 2 triangles, gently wavy, written straight to @p path."""
    import array
    import math
    side = quads + 1
    wave = [0.02 * math.sin(i * 0.7) for i in range(side)]
    positions, indices = array.array("f"), array.array("I")
    for j in range(side):
        v = j / quads - 0.5
        for i in range(side):
            positions.extend((i / quads - 0.5, wave[i] * wave[j], v))
    for j in range(quads):
        for i in range(quads):
            a = j * side + i
            indices.extend((a, a + side, a + 1, a + 1, a + side, a + side + 1))
    document = gltf([], [], emission=emission)
    sizes = positions.itemsize * len(positions), indices.itemsize * len(indices)
    document["accessors"][0]["count"] = side * side
    document["accessors"][1]["count"] = len(indices)
    document["bufferViews"] = [{"buffer": 0, "byteOffset": 0, "byteLength": sizes[0]},
                               {"buffer": 0, "byteOffset": sizes[0], "byteLength": sizes[1]}]
    document["buffers"] = [{"byteLength": sum(sizes)}]
    body = json.dumps(document).encode()
    body += b" " * (-len(body) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(body) + sum(sizes)))
        file.write(struct.pack("<I4s", len(body), b"JSON") + body)
        file.write(struct.pack("<I4s", sum(sizes), b"BIN\0"))
        positions.tofile(file)
        indices.tofile(file)


OBJ_CUBE = ("mtllib {mtl}\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in CUBE_POSITIONS)
            + "usemtl wall\n" + "".join(f"f {a + 1} {b + 1} {c + 1}\n"
                                        for a, b, c in CUBE_TRIANGLES))


def tiff(width, height, pixel=(1.0, 1.0, 1.0), odd=None):
    """An uncompressed TIFF of 32-bit float RGB; @p odd: {pixel index: (r, g, b)}."""
    odd = odd or {}
    data = b"".join(struct.pack("<3f", *odd.get(i, pixel)) for i in range(width * height))
    tags = [(256, 3, 1, width), (257, 3, 1, height), (258, 3, 3, None), (259, 3, 1, 1),
            (262, 3, 1, 2), (273, 4, 1, None), (277, 3, 1, 3), (278, 3, 1, height),
            (279, 4, 1, len(data)), (339, 3, 3, None)]
    first = 8 + 2 + 12 * len(tags) + 4
    where = {258: first, 339: first + 6, 273: first + 12}
    out = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", len(tags))
    for tag, kind, count, value in tags:
        out += struct.pack("<HHII", tag, kind, count, where.get(tag, value))
    out += struct.pack("<I", 0) + struct.pack("<3H", 32, 32, 32) + struct.pack("<3H", 3, 3, 3)
    return out + data


def radiance(width, height, rgbe=(128, 128, 128, 129)):
    """A Radiance HDR file without run lengths; (128, 128, 128, 129) is (1, 1, 1)."""
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    return head + bytes(rgbe) * (width * height)


def exr(width, height, value=1.0):
    """An uncompressed OpenEXR file of 32-bit float B, G, R."""
    def attribute(name, kind, data):
        return (name + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data)
    channels = b"".join(c + b"\0" + struct.pack("<I4B2I", 2, 0, 0, 0, 0, 1, 1)
                        for c in (b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<2I", 20000630, 2) + attribute(b"channels", b"chlist", channels)
    head += attribute(b"compression", b"compression", b"\0")
    head += attribute(b"dataWindow", b"box2i", window) + attribute(b"displayWindow", b"box2i", window)
    head += attribute(b"lineOrder", b"lineOrder", b"\0")
    head += attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
    head += attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0))
    head += attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)) + b"\0"
    row = struct.pack(f"<{3 * width}f", *[value] * (3 * width))
    first = len(head) + 8 * height
    table = b"".join(struct.pack("<Q", first + y * (8 + len(row))) for y in range(height))
    return head + table + b"".join(struct.pack("<iI", y, len(row)) + row for y in range(height))


def png(width=2, height=2, value=255):
    """A grey 8-bit PNG."""
    import zlib

    def chunk(kind, data):
        return (struct.pack(">I", len(data)) + kind + data
                + struct.pack(">I", zlib.crc32(kind + data)))
    rows = (b"\0" + bytes([value]) * width) * height
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
