"""The example of chapters on a Ray cluster, of which a worker is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tcgs

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "chapters_on_ray.py"

ray = pytest.importorskip("ray")


def workers() -> list[int]:
    """Processes that train a chapter."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "cmdline").read_bytes().startswith(b"ray::train_chapter"):
                found.append(int(process.name))
        except OSError:
            pass
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_a_killed_worker_changes_no_byte(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    tcgs.make_demo_capture(capture, width=64, height=48, frames=16, points=1500)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    example = [sys.executable, str(EXAMPLE), str(capture)]
    options = ["--chapters", "2", "--iterations", "60", "30"]
    with subprocess.Popen([*example, str(killed), *options]) as running:
        checkpoint = killed / "chapter1" / "checkpoints" / "000002.npz"
        while not checkpoint.exists():
            assert running.poll() is None, "the example ended before a worker was killed"
            time.sleep(0.02)
        found = workers()
        assert found
        for worker in found:
            os.kill(worker, signal.SIGKILL)
        assert running.wait(timeout=300) == 0
    subprocess.run([*example, str(whole), *options], check=True, timeout=300)
    assert (killed / "scene.tcgs").read_bytes() == (whole / "scene.tcgs").read_bytes()
    assert len(tcgs.open(whole / "scene.tcgs")) == 16
