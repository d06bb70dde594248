"""Written USD files, as OpenUSD reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tcgs
from pxr import Usd, UsdGeom, UsdVol
from test_fourdgs import moving


def splats(path: Path) -> tuple[Usd.Stage, UsdVol.ParticleField3DGaussianSplat]:
    stage = Usd.Stage.Open(str(path))
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Gaussians"))
    assert field, "no such prim"
    return stage, field


def test_a_moving_scene_is_read_at_and_between_its_frames(tmp_path: Path) -> None:
    scene = moving(24.0, frames=6)
    path = tmp_path / "scene.usda"
    scene.save(path)
    stage, field = splats(path)
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 5, 24)
    positions = field.GetPositionsAttr()
    # x to the right, y up, z to the back.
    for time in [0, 3, 4.5]:
        found = np.array(positions.Get(time))
        expected = np.stack([np.full(5, time), -np.arange(5), np.zeros(5)], axis=1)
        np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(field.GetScalesAttr().Get(), np.full((5, 3), 0.1), rtol=1e-6)
    np.testing.assert_allclose(field.GetOpacitiesAttr().Get(2), np.full(5, 0.5), rtol=1e-6)
    assert [q.real for q in field.GetOrientationsAttr().Get()] == [1.0] * 5
    assert field.GetScalesAttr().GetNumTimeSamples() == 0 and positions.GetNumTimeSamples() == 6
    low, high = np.array(UsdGeom.Boundable(field).GetExtentAttr().Get())
    np.testing.assert_allclose([low[0], high[0]], [-0.3, 5.3], rtol=1e-5)


def test_a_trained_scene_keeps_its_rows_and_colours(run: Path, tmp_path: Path) -> None:
    scene = tcgs.open(run)
    path = tmp_path / "run.usda"
    scene.save(path)
    _, field = splats(path)
    at = scene.at(2)
    np.testing.assert_array_equal(np.array(field.GetPositionsAttr().Get(2)), at.means * [1, -1, -1])
    assert field.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 0
    found = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(2))
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * found, at.colors, atol=1e-5)


def test_gaussians_outside_their_lives_are_transparent(tmp_path: Path) -> None:
    path = Path(__file__).resolve().parents[3] / "testdata/bitstream/v2/lives.tcgs"
    scene = tcgs.open(path)
    scene.save(tmp_path / "lives.usda")
    _, field = splats(tmp_path / "lives.usda")
    counts = [len(scene.at(t).means) for t in range(len(scene))]
    assert min(counts) < max(counts)
    for t, count in enumerate(counts):
        opacities = np.array(field.GetOpacitiesAttr().Get(t))
        positions = np.array(field.GetPositionsAttr().Get(t))
        assert len(opacities) == len(positions) and (opacities > 0).sum() == count
        np.testing.assert_array_equal(positions[opacities > 0], scene.at(t).means * np.array([1, -1, -1], np.float32))
