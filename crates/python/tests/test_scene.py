"""Scenes as arrays, against the decoder that was written from the specification alone."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tcgs
from conftest import TESTDATA

VECTORS = sorted(TESTDATA.glob("bitstream/v[12]/*.tcgs"))
DECODER = TESTDATA / "bitstream" / "decode.py"


def stored(gaussians: tcgs.Gaussians) -> bytes:
    """All columns as the conformance program writes them (docs/FORMAT.md, "Conformance")."""
    bands = {f"sh{l}": gaussians.harmonics[:, l * l - 1 : (l + 1) ** 2 - 1] for l in (1, 2, 3)}
    further = bands | gaussians.extra
    base = ["means", "quats", "log_scales", "logit_opacities", "colors"]
    columns = [getattr(gaussians, name) if name in base else further[name] for name in gaussians.columns]
    return b"".join(np.ascontiguousarray(column).tobytes() for column in columns)


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_bit_is_that_of_the_other_decoder(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "floats.f32"
    subprocess.run([sys.executable, "-B", DECODER, path, out], check=True)
    scene = tcgs.open(path)
    assert b"".join(stored(scene.at(t)) for t in range(len(scene))) == out.read_bytes()


def test_all_vectors_are_there() -> None:
    assert len(VECTORS) == 33


def test_activated_values_follow_from_stored_ones() -> None:
    gaussians = tcgs.open(TESTDATA / "bitstream/v1/room_default.tcgs").at(3)
    n = len(gaussians)
    assert gaussians.means.shape == (n, 3) and gaussians.quats.shape == (n, 4) and gaussians.harmonics.shape == (n, 0, 3)
    np.testing.assert_allclose(gaussians.scales, np.exp(gaussians.log_scales.astype(float)), rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 1 / (1 + np.exp(-gaussians.logit_opacities.astype(float))), rtol=1e-6)
    lengths = np.linalg.norm(gaussians.quats.astype(float), axis=1, keepdims=True)
    np.testing.assert_allclose(gaussians.unit_quats, gaussians.quats / lengths, atol=1e-6)


def test_a_scene_is_a_sequence_of_timesteps() -> None:
    scene = tcgs.open(TESTDATA / "bitstream/v1/room_default.tcgs")
    assert len(scene) == len(list(scene)) == 9
    assert np.array_equal(scene[-1].means, scene.at(8).means)
    assert (scene.fps, scene.name, scene.kind, scene.up) == (30.0, "room", "compressed file", "")
    assert scene.bytes == (TESTDATA / "bitstream/v1/room_default.tcgs").stat().st_size
    for timestep in (9, -10):
        with pytest.raises(IndexError, match="no timestep"):
            scene.at(timestep)


def test_arrays_cannot_be_written_to() -> None:
    gaussians = tcgs.open(TESTDATA / "bitstream/v1/room_default.tcgs").at(0)
    with pytest.raises(ValueError, match="read-only"):
        gaussians.means[0] = 0
    assert gaussians.means is gaussians.means


def test_every_kind_of_file_is_opened(run: Path, tmp_path: Path) -> None:
    scene = tcgs.open(run)
    assert scene.kind == "run folder" and len(scene) == 3
    for name in ["params.npz", "scene.4dgs", "plys", "scene.tcgs"]:
        scene.save(tmp_path / name)
        again = tcgs.open(tmp_path / name)
        assert len(again) == 3 and 0 < again.num_gaussians_at(0) <= scene.num_gaussians_at(0), name
    exact = [tcgs.open(tmp_path / name).at(2) for name in ["params.npz", "plys"]]
    assert np.array_equal(exact[0].means, exact[1].means) and np.array_equal(exact[0].quats, exact[1].quats)
    compressed = tcgs.open(tmp_path / "scene.tcgs")
    assert compressed.background == tcgs.open(tmp_path / "plys").background == scene.background != (0, 0, 0)
    camera = next(iter(compressed.cameras.values()))
    picture = tcgs.render(compressed, camera, backend="cpu")
    assert np.array_equal(tcgs.render(compressed, camera, background=scene.background, backend="cpu"), picture)
    assert not np.array_equal(tcgs.render(compressed, camera, background=[0, 0, 0], backend="cpu"), picture)
    assert len(compressed.cameras) == 8 and compressed.declared_errors["means"] > 0
    assert tcgs.open(TESTDATA / "interchange/original.ply").sh_degree == 3
    assert tcgs.open(TESTDATA / "interchange/original.ply", drop_sh=True, fps=12).fps == 12


def test_axes_of_other_programs_files_are_noted_and_given() -> None:
    original = tcgs.open(TESTDATA / "interchange/original.ply").at(0)
    assumed = tcgs.open(TESTDATA / "interchange/gsply_v3.spz")
    assert assumed.notes == ["axes assumed rdf, as PLY files have"]
    given = tcgs.open(TESTDATA / "interchange/splat_transform_v3.spz", axes="rub")
    assert given.notes == []
    for scene in [assumed, given]:
        np.testing.assert_allclose(scene.at(0).means, original.means, atol=2e-4)
    with pytest.raises(ValueError, match='axes: "up" is no set of axes, expected three letters'):
        tcgs.open(TESTDATA / "interchange/original.ply", axes="up")


def test_arrays_become_a_scene_and_come_back() -> None:
    rng = np.random.default_rng(0)
    t, n = 4, 7
    means, quats = rng.normal(size=(t, n, 3)), rng.normal(size=(t, n, 4))
    colors, scales = rng.uniform(size=(t, n, 3)), rng.uniform(0.1, 1, size=(n, 3))
    opacities, harmonics = rng.uniform(0.1, 0.9, size=(t, n)), rng.normal(size=(t, n, 8, 3))
    scene = tcgs.Scene.from_arrays(means, quats, colors, scales=scales, opacities=opacities, harmonics=harmonics, fps=24)
    assert (len(scene), scene.num_identities, scene.fps, scene.sh_degree) == (t, n, 24, 2)
    for timestep, gaussians in enumerate(scene):
        assert np.array_equal(gaussians.means, means[timestep].astype(np.float32))
        assert np.array_equal(gaussians.quats, quats[timestep].astype(np.float32))
        assert np.array_equal(gaussians.harmonics, harmonics[timestep].astype(np.float32))
        np.testing.assert_allclose(gaussians.scales, scales, rtol=1e-5)
        np.testing.assert_allclose(gaussians.opacities, opacities[timestep], rtol=1e-5)


def test_limits_are_lifted_for_files_of_a_known_source(tmp_path: Path) -> None:
    # One window of 2300 seconds becomes thirty timesteps a second.
    long = tmp_path / "long.4dgs"
    ones = np.ones((1, 2, 3))
    scene = tcgs.Scene.from_arrays(
        ones, np.ones((1, 2, 4)), ones, scales=ones[0], opacities=np.full((1, 2), 0.5), fps=1 / 2300
    )
    scene.save(long)
    with pytest.raises(ValueError, match="needs 69000 timesteps, limit is 65536; no_limits=True lifts it"):
        tcgs.open(long)
    assert len(tcgs.open(long, no_limits=True)) == 69000


def test_wrong_input_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no_such.tcgs: .*expected a .tcgs file"):
        tcgs.open(tmp_path / "no_such.tcgs")
    with pytest.raises(ValueError, match="is an address, expected .* tcgs.open opens an address"):
        tcgs.compress("https://example.org/scene.tcgs", tmp_path / "scene.tcgs")
    cut = tmp_path / "cut.tcgs"
    cut.write_bytes((TESTDATA / "bitstream/v1/room_default.tcgs").read_bytes()[:-100])
    with pytest.raises(ValueError, match="cut.tcgs: .*expected a whole .tcgs file"):
        tcgs.open(cut)
    assert len(tcgs.open(cut, recover=True)) < 9
    # A name that would colour a terminal.
    (tmp_path / "\x1b[31mred.ply").write_text("ply\n")
    with pytest.raises(ValueError, match=r"\\u\{1b\}\[31mred.ply: ") as refused:
        tcgs.open(tmp_path / "\x1b[31mred.ply")
    assert "\x1b" not in str(refused.value)
    ones = np.ones
    with pytest.raises(ValueError, match=r"quats: has shape \[2, 5, 3\], expected \[2, 5, 4\]"):
        tcgs.Scene.from_arrays(ones((2, 5, 3)), ones((2, 5, 3)), ones((2, 5, 3)), scales=ones((5, 3)), opacities=ones(5) / 2)
    with pytest.raises(ValueError, match="scales and log_scales: neither given"):
        tcgs.Scene.from_arrays(ones((2, 5, 3)), ones((2, 5, 4)), ones((2, 5, 3)), opacities=ones(5) / 2)
    with pytest.raises(ValueError, match=r"opacities: holds 1\.0 at \[0\], expected numbers between 0 and 1"):
        tcgs.Scene.from_arrays(ones((2, 5, 3)), ones((2, 5, 4)), ones((2, 5, 3)), scales=ones((5, 3)), opacities=ones(5))


def refused() -> list[Path]:
    """Files that the timesteps alone show to be wrong: where segments meet, and what cohorts have in common, is seen by
    those alone who read the whole file (`tcgs verify`), as are sections that a decoder skips."""
    paths = []
    for folder in (TESTDATA / "bitstream/refused", TESTDATA / "bitstream/refused_v2"):
        for row in json.loads((folder / "refused.json").read_text())["files"]:
            unread = row["field"] in ("keypoints", "attributes") or row["section"] in ("file", "unknown section")
            paths += [] if unread else [folder / row["file"]]
    return paths


@pytest.mark.parametrize("path", refused(), ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_what_must_be_refused_is_a_value_error(path: Path) -> None:
    with pytest.raises(ValueError, match=path.name):
        list(tcgs.open(path))
