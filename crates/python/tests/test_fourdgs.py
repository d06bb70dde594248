"""Written .4dgs files, in the reader and the converter of the package `fourdgs`."""

from __future__ import annotations

from pathlib import Path

import fourdgs
import numpy as np
import pytest
import tcgs


def moving(fps: float, frames: int = 48) -> tcgs.Scene:
    """Five Gaussians above one another; the frame's number is how far they are to the right."""
    means = np.zeros((frames, 5, 3))
    means[..., 0] = np.arange(frames)[:, None]
    means[..., 1] = np.arange(5)
    quats, colors = np.tile([1.0, 0, 0, 0], (frames, 5, 1)), np.full((frames, 5, 3), 0.5)
    return tcgs.Scene.from_arrays(
        means, quats, colors, scales=np.full((5, 3), 0.1), opacities=np.full((frames, 5), 0.5), fps=fps
    )


@pytest.mark.parametrize("fps", [10.0, 24.0, 25.0, 29.97, 30.0, 60.0])
def test_at_its_time_a_reader_sees_the_frame(fps: float, tmp_path: Path) -> None:
    scene = moving(fps)
    scene.save(tmp_path / "scene.4dgs")
    gaussians = fourdgs.read(str(tmp_path / "scene.4dgs")).gaussians
    for k in range(len(scene)):
        centers = gaussians.state_at(k / fps)["centers"]
        # The axes are those of glTF: x to the left, y up.
        assert len(centers) == 5
        np.testing.assert_allclose(centers[:, 0], -k, atol=0.01)
        np.testing.assert_allclose(np.sort(centers[:, 1]), np.arange(-4, 1), atol=0.01)


def test_its_gltf_stands_upright(tmp_path: Path) -> None:
    scene = moving(30.0)
    scene.save(tmp_path / "scene.4dgs")
    read = fourdgs.read(str(tmp_path / "scene.4dgs"))
    fourdgs.to_gltf(
        str(tmp_path / "frame.glb"),
        read.gaussians,
        7 / 30.0,
        cutoff=read.header.cutoff,
        coordinate_system=read.header.attributes["coordinate_system"],
    )
    found, expected = tcgs.open(tmp_path / "frame.glb").at(0).means, scene.at(7).means
    np.testing.assert_allclose(found[np.argsort(found[:, 1])], expected, atol=0.01)
