#!/usr/bin/env python3
"""Writes a long run: T timesteps of N Gaussians, a twentieth of which moves while the rest stands still to the bit.

    scripts/make_long_run.py SOME_RUN OUT [T] [N]        3000 timesteps of 50000 Gaussians: 10 GB of checkpoints

The settings are those of SOME_RUN (any run folder). `/usr/bin/time -v tcgs compress OUT` then shows the memory that
compression takes. Needs NumPy.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

source, out = Path(sys.argv[1]), Path(sys.argv[2])
num_timesteps, num_gaussians = (int(word) for word in (sys.argv[3:5] + ["3000", "50000"][len(sys.argv) - 3 :]))
(out / "checkpoints").mkdir(parents=True)
shutil.copy(source / "config.toml", out)

random = np.random.default_rng(1)
uniform = lambda low, high, *shape: random.uniform(low, high, shape).astype(np.float32)
means = uniform(-2, 2, num_gaussians, 3)
quats = random.normal(size=(num_gaussians, 4))
quats = (quats / np.linalg.norm(quats, axis=1, keepdims=True) * np.sign(quats[:, :1])).astype(np.float32)
log_scales, logit_opacities = uniform(-5, -3, num_gaussians, 3), uniform(-1, 4, num_gaussians)
colors = uniform(0, 1, num_gaussians, 3)
num_moving = num_gaussians // 20
phases = uniform(0, 6.28, num_moving, 3)

# Eight bits for everything but positions, in steps that cover the values.
quantized = [quats, log_scales, logit_opacities[:, None], colors]
steps = np.concatenate([np.ptp(values, axis=0) / 255 for values in quantized]).astype(np.float32)
offsets = np.concatenate([(values.max(0) + values.min(0)) / 2 for values in quantized]).astype(np.float32)
bit_widths = np.full((5, num_gaussians), 8, np.uint8)
bit_widths[0] = 16
zeros = lambda *shape: np.zeros(shape, np.float32)

for timestep in range(num_timesteps):
    moved = means.copy()
    moved[:num_moving] += (0.3 * np.sin(phases + timestep * 0.05)).astype(np.float32)
    arrays = {
        "means": moved,
        "quats": quats,
        "colors": colors,
        "mask_logits": np.full(num_gaussians, 2, np.float32),
        "quantizer_steps": steps,
        "quantizer_offsets": offsets,
        "color_moments": zeros(2, 3 * num_gaussians),
        "quantizer_step_moments": zeros(2, len(steps)),
        "quantizer_offset_moments": zeros(2, len(steps)),
        "steps": np.full(6, 5, np.uint64),
    }
    if timestep == 0:
        arrays |= {
            "log_scales": log_scales,
            "logit_opacities": logit_opacities,
            "camera_gains": zeros(3, 3),
            "camera_offsets": zeros(3, 3),
            "foreground": (np.arange(num_gaussians) < num_moving).astype(np.uint8),
            "scene_radius": np.array([3], np.float32),
            "quantizer_groups": np.array([[attribute, 8] for attribute in (1, 2, 3, 4)], np.uint8),
            "quantizer_initial_steps": steps,
            "bit_widths": bit_widths,
        }
    np.savez(out / f"checkpoints/{timestep:06}.npz", **arrays)
