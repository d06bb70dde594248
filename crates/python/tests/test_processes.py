"""Processes that were forked, such as the workers of a data loader, have none of the threads of their parent."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import tcgs
from conftest import TESTDATA

pytestmark = pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork")


def drawn(timestep: int) -> bytes:
    """Of many pixels and Gaussians, so that several threads take part."""
    rng = np.random.default_rng(timestep)
    n = 5000
    quats, scales = rng.normal(size=(1, n, 4)), np.full((n, 3), 0.02)
    means, colors = rng.uniform(-1, 1, (1, n, 3)), rng.uniform(size=(1, n, 3))
    scene = tcgs.Scene.from_arrays(means, quats, colors, scales=scales, opacities=np.full(n, 0.5))
    image = tcgs.render(scene, scene.orbit(1)[0], 0, backend="cpu")
    decoded = tcgs.open(TESTDATA / "bitstream/v1/crowd.tcgs").at(0)
    return image.tobytes() + decoded.scales.tobytes()


def trained(folder: Path) -> None:
    tcgs.train(folder, folder / "run", progress=False)


def test_a_forked_process_computes_the_same() -> None:
    expected = [drawn(timestep) for timestep in range(4)]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(drawn, range(4)).get(timeout=60) == expected


def test_a_training_in_a_forked_process_is_refused(capture: Path) -> None:
    with multiprocessing.get_context("fork").Pool(1) as pool:
        with pytest.raises(RuntimeError, match="a process that was forked, expected .* spawn"):
            pool.apply_async(trained, (capture,)).get(timeout=60)
