"""Fixtures of several tests: a small capture, and a run that was trained on it."""

from __future__ import annotations

from pathlib import Path

import pytest
import tcgs

TESTDATA = Path(__file__).resolve().parents[3] / "testdata"


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "capture"
    tcgs.make_demo_capture(folder, width=64, height=48, frames=3, points=1500)
    return folder


@pytest.fixture(scope="session")
def run(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All Gaussians are there from the first timestep on, so that every format holds the scene."""
    folder = tmp_path_factory.mktemp("data") / "run"
    settings = {"births.enabled": False, "render.background": True}
    tcgs.train(capture, folder, preset="fast", iterations=(200, 50), settings=settings, backend="cpu", progress=False)
    return folder
