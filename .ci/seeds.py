#!/usr/bin/env python3
"""Seeds for the fuzz targets of other programs' files: FOLDER/TARGET/NAME, in the form that each target takes.

usage: .ci/seeds.py FOLDER
"""

import gzip
import struct
import sys
from pathlib import Path

FILES = Path(__file__).parent.parent / "testdata" / "interchange"


def spz():
    for name in ["spz_v2", "splat_transform_v3"]:
        plain = gzip.decompress((FILES / f"{name}.spz").read_bytes())
        yield name, b"\0\1" + plain
    # The arrays of version 3 are those of version 4.
    header = plain[:4] + struct.pack("<I", 4) + plain[8:15] + struct.pack("<BI12x", 6, 32)
    yield "version_4", b"\0\2" + header + plain[16:]
    yield "bomb", b"\xff\1" + plain[:8] + struct.pack("<I", 10_000) + plain[12:16]
    yield "as_it_is", b"\0\0" + (FILES / "splat_transform_v4.spz").read_bytes()


def gltf():
    glb = (FILES / "splat_transform.glb").read_bytes()
    length = struct.unpack_from("<I", glb, 12)[0]
    json, buffer = glb[20 : 20 + length], glb[28 + length :]
    yield "parts", json + b"\0" + buffer
    yield "as_it_is", glb
    yield "itself", b'{"buffers":[{"uri":"a.gltf","byteLength":1},{"uri":"a.bin","byteLength":9}]}'


def fourdgs():
    for name in ["fourdgs_births", "fourdgs_states"]:
        file = (FILES / f"{name}.4dgs").read_bytes()
        yield name, bytes(4) + file
        yield f"{name}_many", struct.pack("<I", 100_000) + file


def npz():
    def array(packing, zeros, shape, descr="<f4", values=b""):
        header = f"{{'descr': '{descr}', 'fortran_order': {packing > 1}, 'shape': {shape}, }}\n".encode()
        npy = b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + values
        return struct.pack("<HBB", len(npy), packing, zeros) + npy

    small = [(2, 1, 3), (2, 1, 3), (2, 1, 4), (1, 1), (1, 3)]
    values = [bytes(4 * 6), bytes(4 * 6), bytes(4 * 8), bytes(4), bytes(12)]
    yield "params", b"".join(array(i % 4, 0, shape, values=v) for i, (shape, v) in enumerate(zip(small, values)))
    # 4 MiB of zeros: 2 ** (137 % 23).
    yield "zeros", array(1, 137, (1 << 20,)) + array(3, 137, (1 << 10, 1 << 9), "<f8")


def ply_points():
    place = "property float x\nproperty double y\nproperty short z\n"
    color = "property uchar red\nproperty float green\nproperty uint blue\nproperty list uchar int extra\n"
    for name, properties, text in [("place", place, "1 2 3\n"), ("color", place + color, "1 2 3 4 5 6 2 7 8\n")]:
        for form in ["ascii", "binary_little_endian", "binary_big_endian"]:
            header = f"ply\nformat {form} 1.0\ncomment made\nelement vertex 2\n{properties}end_header\n".encode()
            yield f"{name}_{form}", header + (2 * text.encode() if form == "ascii" else bytes(60))


for target in [spz, gltf, fourdgs, npz, ply_points]:
    folder = Path(sys.argv[1]) / target.__name__
    folder.mkdir(parents=True, exist_ok=True)
    for name, seed in target():
        (folder / name).write_bytes(seed)
