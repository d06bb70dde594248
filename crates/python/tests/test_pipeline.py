"""From a capture to a compressed scene and its quality, and how a training is stopped."""

from __future__ import annotations

import datetime
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tcgs

TRAIN: dict[str, Any] = {"preset": "fast", "iterations": (200, 50), "backend": "cpu", "progress": False}


def files(folder: Path) -> dict[str, bytes]:
    """Content of all files of a run but its times."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "metrics.jsonl")
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def command(*arguments: object) -> None:
    program = os.environ.get("TCGS")
    if program is None:
        pytest.skip("TCGS names no program, expected that of the command line to compare with")
    subprocess.run([program, *map(str, arguments)], check=True, capture_output=True)


def test_training_and_compressing_give_the_bytes_of_the_command_line(capture: Path, tmp_path: Path) -> None:
    by_command = tmp_path / "command"
    options = ["--preset", "fast", "--iterations", "200,50", "--backend", "cpu"]
    command("train", capture, "--out", by_command, *options)
    command("compress", by_command, "--refine", "30", "--quality", "-1", "--backend", "cpu")
    scene = tcgs.train(capture, tmp_path / "python", **TRAIN)
    out = tmp_path / "python" / "scene.tcgs"
    tcgs.compress(scene, out, refine=30, quality=-1, backend="cpu", progress=False)
    assert files(tmp_path / "python") == files(by_command)


def test_preparing_gives_the_bytes_of_the_command_line(capture: Path, tmp_path: Path) -> None:
    by_command, out = tmp_path / "command", tmp_path / "python"
    command("prepare", capture, "--out", by_command, "--points", "2000", "--width", "64")
    told: list[tcgs.Progress] = []
    prepared = tcgs.prepare(capture, out, points=2000, width=64, callback=told.append)
    assert len(prepared) == 3 and prepared.path == out
    assert (out / "init_pt_cld.npz").read_bytes() == (by_command / "init_pt_cld.npz").read_bytes()
    assert [p.work for p in told if p.done == 0] == ["preparing", "checking"]


def test_what_cannot_be_prepared_is_named(capture: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="no videos here"):
        tcgs.prepare(tmp_path / "empty", tmp_path / "out", progress=False)
    with pytest.raises(ValueError, match="start: is -1, expected seconds, 0 or more"):
        tcgs.prepare(capture, tmp_path / "out", start=-1, progress=False)
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diary.txt").write_text("x")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        tcgs.prepare(capture, tmp_path / "out", progress=False)
    with pytest.raises(ValueError, match="was not made by prepare"):
        tcgs.prepare(capture, tmp_path / "out", overwrite=True, progress=False)


def test_progress_is_told_in_order(capture: Path, tmp_path: Path) -> None:
    told: list[tcgs.Progress] = []
    scene = tcgs.train(capture, tmp_path / "run", **TRAIN, callback=told.append)
    assert [p.timestep for p in told if p.psnr is not None] == [0, 1, 2]
    assert [p.done for p in told] == sorted(p.done for p in told)
    assert {p.work for p in told} == {"training"} and told[-1].done == told[-1].total == 300
    assert len(scene) == 3


def test_a_callback_ends_a_training_that_can_be_resumed(capture: Path, run: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = {**TRAIN, "settings": {"births.enabled": False, "render.background": True}}

    def stop(progress: tcgs.Progress) -> None:
        if progress.psnr is not None:
            raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        tcgs.train(capture, out, **options, callback=stop)
    assert len(tcgs.open(out)) == 1
    with pytest.raises(FileExistsError, match="resume=True"):
        tcgs.train(capture, out, **options)
    with pytest.raises(ValueError, match="seed differs from the run's"):
        tcgs.train(capture, out, resume=True, seed=5, progress=False)
    assert len(tcgs.train(capture, out, resume=True, backend="cpu", progress=False)) == 3
    assert files(out) == files(run)


def test_chapters_start_from_a_scene_and_are_joined(capture: Path, run: Path, tmp_path: Path) -> None:
    chapters = [tmp_path / "late", tmp_path / "early"]
    options: dict[str, Any] = {**TRAIN, "config": run / "config.toml"}
    late = tcgs.train(capture, chapters[0], frames=(1, 3), start_from=(tcgs.open(run), 0), **options)
    tcgs.train(capture, chapters[1], frames=(0, 2), start_from=(run, 0), **options)
    assert late.num_identities == tcgs.open(run).num_gaussians_at(0)
    joined = tcgs.open(chapters, segment_length=2)
    assert (len(joined), joined.first_frame) == (3, 0)
    np.testing.assert_array_equal(joined.at(-1).means, late.at(-1).means)
    tcgs.compress(joined, tmp_path / "python.tcgs", progress=False)

    by_command = [tmp_path / "late_by_command", tmp_path / "early_by_command"]
    for out, frames in zip(by_command, ["1..3", "0..2"]):
        settings = ["--preset", "fast", "--iterations", "200,50", "--backend", "cpu", "--config", run / "config.toml"]
        command("train", capture, "--out", out, "--frames", frames, "--start-from", f"{run}@0", *settings)
    command("compress", *by_command, "--out", tmp_path / "command.tcgs", "--segment-length", 2)
    assert [files(out) for out in chapters] == [files(out) for out in by_command]
    assert (tmp_path / "python.tcgs").read_bytes() == (tmp_path / "command.tcgs").read_bytes()


def test_what_is_no_chapter_is_refused(capture: Path, run: Path, tmp_path: Path) -> None:
    scene = tcgs.open(run)
    arrays = tcgs.Scene.from_arrays(scene.at(0).means[None], scene.at(0).quats[None], scene.at(0).colors[None],
                                    log_scales=scene.at(0).log_scales, logit_opacities=scene.at(0).logit_opacities)
    refused: list[tuple[Any, type[Exception], str]] = [
        ((run, 7), IndexError, "no timestep 7"),
        (tmp_path / "nowhere", OSError, "nowhere"),
        (arrays, OSError, "arrays"),
    ]
    for start_from, exception, message in refused:
        with pytest.raises(exception, match=message):
            tcgs.train(capture, tmp_path / "run", start_from=start_from, **TRAIN)
    with pytest.raises(ValueError, match="points: given with start_from"):
        tcgs.train(capture, tmp_path / "run", start_from=run, points=capture / "init_pt_cld.npz", **TRAIN)
    assert not (tmp_path / "run").exists()
    for paths, message in [([], "no path"), ([run, run], "expected")]:
        with pytest.raises(ValueError, match=message):
            tcgs.open(paths)
    with pytest.raises(ValueError, match="segment_length: is 0"):
        tcgs.open([run], segment_length=0)


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX does")
def test_ctrl_c_leaves_a_run_that_can_be_resumed(capture: Path, tmp_path: Path) -> None:
    program = textwrap.dedent("""
        import sys, tcgs
        tell = lambda p: print(p.timestep, flush=True) if p.psnr is not None else None
        try:
            tcgs.train(sys.argv[1], sys.argv[2], preset="fast", iterations=(200, 100000), backend="cpu", callback=tell,
                       settings={"gate.enabled": False})
        except KeyboardInterrupt:
            sys.exit(77)
    """)
    out = tmp_path / "run"
    with subprocess.Popen([sys.executable, "-c", program, capture, out], stdout=subprocess.PIPE) as training:
        assert training.stdout is not None and training.stdout.readline() == b"0\n"
        training.send_signal(signal.SIGINT)
        sent = time.monotonic()
        assert training.wait(timeout=60) == 77
        assert time.monotonic() - sent < 20
    assert len(tcgs.open(out)) == 1


def test_other_threads_run_meanwhile(capture: Path, tmp_path: Path) -> None:
    ticks, ended = 0, threading.Event()

    def train() -> None:
        tcgs.train(capture, tmp_path / "run", **TRAIN)
        ended.set()

    worker = threading.Thread(target=train)
    worker.start()
    while not ended.is_set():
        time.sleep(0.001)
        ticks += 1
    worker.join()
    assert ticks > 50


def test_targets_are_met(run: Path, capture: Path, tmp_path: Path) -> None:
    quiet: dict[str, Any] = {"backend": "cpu", "progress": False}
    plain = tcgs.compress(run, tmp_path / "plain.tcgs", refine="off", **quiet)
    small = tcgs.compress(run, tmp_path / "small.tcgs", target_bytes=plain.bytes * 2 // 3, **quiet)
    assert plain.bytes // 2 < small.bytes <= plain.bytes * 2 // 3
    fine = tcgs.compress(run, tmp_path / "fine.tcgs", max_error={"means": 2e-4}, **quiet)
    assert fine.declared_errors["means"] <= 2e-4 < plain.declared_errors["means"] / 2
    refined = tcgs.compress(run, tmp_path / "refined.tcgs", refine=100, **quiet)
    psnr = [tcgs.evaluate(scene, capture, cameras="train", **quiet)["psnr"] for scene in (plain, refined)]
    assert psnr[1] > psnr[0] + 0.5


def test_a_budget_may_be_a_time(run: Path, tmp_path: Path) -> None:
    told: list[tcgs.Progress] = []
    budget = datetime.timedelta(seconds=1)
    tcgs.compress(run, tmp_path / "scene.tcgs", refine=budget, backend="cpu", callback=told.append)
    assert list(dict.fromkeys(p.work for p in told)) == ["measuring", "refining"]
    assert told[-1].done == told[-1].total >= 1


def test_arrays_are_compressed(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    start = rng.uniform(-1, 1, (50, 3))
    means = start + np.linspace(0, 1, 10)[:, None, None] * [1, 0, 0]
    quats, colors = np.tile([1.0, 0, 0, 0], (10, 50, 1)), np.tile(rng.uniform(size=(50, 3)), (10, 1, 1))
    arrays: dict[str, Any] = {"means": means, "quats": quats, "colors": colors}
    arrays |= {"scales": np.full((50, 3), 0.05), "opacities": np.full(50, 0.8)}
    scene = tcgs.Scene.from_arrays(**arrays, fps=24)
    with pytest.raises(FileNotFoundError):
        tcgs.compress(scene, tmp_path / "nowhere" / "scene.tcgs", progress=False)
    out = tcgs.compress(scene, tmp_path / "scene.tcgs", progress=False)
    assert (len(out), out.num_identities, out.fps) == (10, 50, 24)
    tcgs.compress({**arrays, "fps": 24}, tmp_path / "of_arrays.tcgs", progress=False)
    assert (tmp_path / "of_arrays.tcgs").read_bytes() == (tmp_path / "scene.tcgs").read_bytes()
    (tmp_path / "of_arrays.tcgs").unlink()
    with pytest.raises(TypeError, match="weights"):
        tcgs.compress({**arrays, "weights": colors}, tmp_path / "weights.tcgs", progress=False)
    bound = out.declared_errors["means"]
    # Compression reorders the Gaussians.
    for timestep in (0, 4, 9):
        distances = np.linalg.norm(out.at(timestep).means[:, None] - means[timestep][None], axis=-1).min(axis=1)
        assert distances.max() <= bound * np.sqrt(3) < 0.05
    with pytest.raises(FileExistsError, match="overwrite=True"):
        tcgs.compress(scene, tmp_path / "scene.tcgs")
    with pytest.raises(ValueError, match="is compressed already"):
        tcgs.compress(out, tmp_path / "again.tcgs", progress=False)
    with pytest.raises(ValueError, match="-6 to 8"):
        tcgs.compress(scene, tmp_path / "again.tcgs", quality=9)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.tcgs"]


def test_quality_is_measured(run: Path, capture: Path) -> None:
    result = tcgs.evaluate(run, capture, backend="cpu", progress=False)
    scene, images = tcgs.open(run), tcgs.Capture(capture)
    assert len(result["images"]) == 3 * 2 and result["lpips_vgg"] is None
    for score in result["images"]:
        at = images.cameras("test", frame=score["timestep"])[score["camera"]]
        expected = images.images("test", frame=score["timestep"])[score["camera"]]
        found = tcgs.render(scene, at, score["timestep"], backend="cpu").clip(0, 1)
        assert score["psnr"] == pytest.approx(-10 * np.log10(np.mean((found - expected).astype(float) ** 2)), abs=1e-4)
    frozen = tcgs.evaluate(run, capture, backend="cpu", frozen=True, progress=False)
    assert frozen["psnr"] < result["psnr"]


def test_a_capture_is_made_whole_and_over_nothing(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(FileExistsError, match="there"):
        tcgs.make_demo_capture(tmp_path / "there")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        tcgs.make_demo_capture(tmp_path / "nowhere" / "capture")
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_wrong_settings_are_named(capture: Path, tmp_path: Path) -> None:
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"settings": {"weights.rigit": 2}}, "unknown setting weights.rigit"),
        ({"iterations": (0, 10)}, "schedule.first_iterations is 0"),
        ({"frames": (0, 9)}, r"has the frames 0\.\.3, found 0\.\.9"),
        ({"preset": "slow"}, "preset: is slow"),
        ({"backend": "tpu"}, "backend: is tpu"),
    ]
    for options, words in wrong:
        with pytest.raises(ValueError, match=words):
            tcgs.train(capture, tmp_path / "run", progress=False, **options)
    wrong_cameras: Any = "left"
    with pytest.raises(ValueError, match="expected test, train or all"):
        tcgs.evaluate(tmp_path, capture, cameras=wrong_cameras, progress=False)
    with pytest.raises((OSError, ValueError), match="no_such"):
        tcgs.train(tmp_path / "no_such", tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
