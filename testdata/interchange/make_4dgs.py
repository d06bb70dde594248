#!/usr/bin/env python3
"""Makes the .4dgs files of this folder from original.ply, by the package of the format: pip install fourdgs==0.6.0.

Three timesteps, ten a second, of rows of original.ply that move by 0.1 along x from one to the next: rows 0 to 39, 0 to 49,
10 to 44. One file is of the model gaussian-birth, as the package's converter makes it of PLY files; the other of
keyframe-delta, in which a row is an identity, without harmonics.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from fourdgs.keyframe_delta_file import write_sequence
from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample
from fourdgs.model import GaussianSet

HERE = Path(__file__).parent
ROWS = [(0, 40), (0, 50), (10, 45)]
SECONDS = 0.1

data = (HERE / "original.ply").read_bytes()
start = data.index(b"end_header\n") + len(b"end_header\n")
names = [line.split()[2] for line in data[:start].decode().splitlines() if line.startswith("property")]
table = np.frombuffer(data[start:], "<f4").reshape(-1, len(names))

samples = []
with tempfile.TemporaryDirectory() as folder:
    for timestep, (first, end) in enumerate(ROWS):
        rows = table[first:end].copy()
        rows[:, 0] += np.float32(0.1) * timestep
        header = data[:start].replace(b"vertex 260", b"vertex %d" % len(rows))
        (Path(folder) / f"{timestep}.ply").write_bytes(header + rows.tobytes())
        of = {name: rows[:, i].astype(float) for i, name in enumerate(names)}
        stack = lambda *columns: np.stack([of[name] for name in columns], axis=1)
        rotations = stack("rot_1", "rot_2", "rot_3", "rot_0")
        colors = np.concatenate([0.5 + 0.28209479177387814 * stack("f_dc_0", "f_dc_1", "f_dc_2"),
                                 1 / (1 + np.exp(-stack("opacity")))], axis=1)
        count = len(rows)
        constant = lambda value: np.full(count, value, np.float32)
        gaussians = GaussianSet(
            positions=stack("x", "y", "z").astype(np.float32),
            scales=np.exp(stack("scale_0", "scale_1", "scale_2")).astype(np.float32),
            rotations=(rotations / np.linalg.norm(rotations, axis=1, keepdims=True)).astype(np.float32),
            colors=colors.astype(np.float32), motions=np.zeros((count, 3), np.float32),
            mu_t=constant(timestep * SECONDS), sigma_t=constant(1000), win_lo=constant(0),
            win_hi=constant(len(ROWS) * SECONDS))
        samples.append(Sample(timestep * SECONDS, np.arange(first, end), gaussians))
    subprocess.run([sys.executable, "-m", "fourdgs.cli", "convert", folder, "-o", str(HERE / "fourdgs_births.4dgs"),
                    "--fps", str(1 / SECONDS), "--profile", "fine"], check=True)
(HERE / "fourdgs_states.4dgs").write_bytes(write_sequence(
    samples, len(ROWS) * SECONDS, kd=KeyframeDeltaOptions(keyframe_every=8), profile="fine"))
