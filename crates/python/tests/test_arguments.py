"""Wrong arguments: every public function raises an exception that Python users expect, with the argument's name."""

from __future__ import annotations

import random
import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tcgs
from conftest import TESTDATA
from test_rasterize import HEIGHT, WIDTH, camera, gaussians

FILE = TESTDATA / "bitstream/v1/room_default.tcgs"

HUGE = 2**40
SCALARS: list[Any] = [
    None, -1, 0, 1, 3, 2**31, 2**63, 2**64, HUGE, 2**200, -(2**200), -0.5, 1.5, 1e300, -1e300, float("nan"), float("inf"),
    1j, True, "x", "", "\0", "\udc80", b"x", [], [1, "x"], (), (-1, 2), (2**200, 1), (0, 1, 2), {}, {"x": 1}, {"means": -1.0},
    object(), np.float32("nan"), np.int64(-5), np.datetime64("2026-01-01"), int,
]  # fmt: skip
ARRAYS: list[Any] = [
    np.zeros(0), np.zeros((0, 3)), np.zeros((HUGE, 0, 3)), np.zeros((1, HUGE, 0)), np.zeros((0, 4, 4)), [[1, 2], [3]],
    np.broadcast_to(np.float32(1), (HUGE, 3)), np.broadcast_to(1.0, (HUGE, 4)), np.broadcast_to(1, (1, HUGE, 3)),
    np.broadcast_to(np.eye(4), (HUGE, 4, 4)), np.array(["a", "b"]), np.array(["1", "2"]), np.array([None, 1]),
    np.zeros(2, dtype="f4,i4"), np.zeros((2, 2), dtype="M8[s]"), [10**400], np.zeros((1,) * 32), np.array(5),
]  # fmt: skip


def changed(base: Any, rng: random.Random) -> Any:
    """An array that differs from a right one in its numbers, type or shape; some are right, too."""
    array, place = np.array(base, dtype=float), rng.random()
    if place < 0.5 and array.size:
        array.flat[rng.randrange(array.size)] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e30, 1e30, -1, 0, 2, 1e-40])
    elif place < 0.6:
        return array + 1j
    elif place < 0.7:
        return array.astype(rng.choice(["O", "U9", ">f4", "f2", "i2", "?", "c8"]))
    elif place < 0.8:
        return array[..., None]
    elif place < 0.9 and array.ndim:
        return array[: rng.randrange(array.shape[0] + 1)]
    else:
        return np.concatenate([array, array], axis=-1) if array.ndim else array
    return array


class Case:
    """A function and right arguments for it.

    - skipped: arguments whose odd values are right and take long
    """

    def __init__(self, function: Callable[..., Any], trials: int, arguments: dict[str, Any], skipped: str = "") -> None:
        self.function, self.trials, self.arguments, self.skipped = function, trials, arguments, skipped.split()


def make_and_remove(path: Any, **arguments: Any) -> None:
    tcgs.make_demo_capture(path, **arguments)
    shutil.rmtree(path)


def cases(capture: Path, run: Path, folder: Path) -> dict[str, Case]:
    means, quats, scales, opacities, colors = gaussians(4, 1)
    at = camera()
    of_arrays: dict[str, Any] = {"means": means[None], "quats": quats[None], "colors": colors[None], "scales": scales}
    of_arrays |= {"opacities": opacities, "log_scales": None, "logit_opacities": None, "harmonics": np.ones((4, 3, 3))}
    scene = tcgs.Scene.from_arrays(means[None], quats[None], colors[None], scales=scales, opacities=opacities)
    images, file = tcgs.Capture(capture), tcgs.open(FILE)
    drawn = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    drawn |= {"viewmat": at.viewmat, "K": at.K, "width": WIDTH, "height": HEIGHT, "background": np.ones(3)}
    drawn |= {"viewmats": None, "Ks": None, "backgrounds": None, "near_plane": 0.2, "sh_degree": None}
    viewmats, ks = np.stack([at.viewmat] * 2), np.stack([at.K] * 2)
    several = drawn | {"viewmat": viewmats, "K": ks, "background": np.ones((2, 3)), "colors": np.ones((4, 4, 3))}
    several |= {"sh_degree": 1, "rasterize_mode": "classic"}
    looks = {"center": [0, 0, -3], "target": [0, 0, 0], "up": [0, -1, 0], "focal": 30.0, "width": 40, "height": 30}
    v = {"v_image": np.ones((HEIGHT, WIDTH, 3)), "v_alpha": np.ones((HEIGHT, WIDTH, 1))}
    quiet: dict[str, Any] = {"backend": "cpu", "device": None, "progress": False, "callback": None}
    one = {"which": "test", "frame": 0, "downscale": 1}
    compressed: dict[str, Any] = {"source": scene, "out": folder / "out.tcgs", "quality": None, "target_bytes": None}
    compressed |= {"target_psnr": None, "max_error": None, "refine": None, "min_share": None, "capture": None}
    compressed |= {"preset": "default", "segment_length": None, "overwrite": True, **quiet}
    trained: dict[str, Any] = {"capture": capture, "out": folder / "run", "preset": "fast", "frames": (0, 1)}
    trained |= {"downscale": 4, "iterations": (1, 1), "settings": None, "config": None, "points": None, "start_from": None}
    trained |= {"seed": 0, "resume": False, "overwrite": True, **quiet}
    evaluated: dict[str, Any] = {"scene": run, "capture": capture, "cameras": "test", "frames": (0, 1), "downscale": 4}
    evaluated |= {"frozen": False, "protocol": None, "lpips_weights": None, **quiet}
    prepared: dict[str, Any] = {"source": capture, "out": folder / "prepared", "points": 1000, "width": 32, "masks": None}
    prepared |= {"calibration": None, "scale": None, "refine_calibration": True, "balance_colors": True, "offsets": None}
    prepared |= {"start": None, "end": None, "every": 1, "fps": None, "hold_out": [], "seed": 0, "overwrite": True}
    prepared |= {"progress": False, "callback": None}
    # Right values of these are refused too, since the source has no videos.
    of_videos = "calibration scale offsets start end every fps hold_out"
    made: dict[str, Any] = {"path": folder / "made", "width": 16, "height": 16, "frames": 1, "points": 10, "seed": 0}
    opened: dict[str, Any] = {"path": FILE, "drop_sh": False, "recover": False, "fps": None, "segment_length": None}
    return {
        "Camera": Case(tcgs.Camera, 100, {"viewmat": at.viewmat, "K": at.K, "width": 40, "height": 30}),
        "Camera.look_at": Case(tcgs.Camera.look_at, 150, looks),
        "Camera.resized": Case(at.resized, 40, {"width": 40, "height": 30}),
        "Capture": Case(tcgs.Capture, 20, {"path": capture}),
        "Capture.cameras": Case(images.cameras, 60, one),
        "Capture.images": Case(images.images, 60, one),
        "Scene.from_arrays": Case(tcgs.Scene.from_arrays, 300, of_arrays | {"fps": 30.0, "name": "arrays"}),
        "Scene.at": Case(file.at, 30, {"timestep": 0}),
        "Scene.num_gaussians_at": Case(file.num_gaussians_at, 30, {"timestep": 0}),
        "Scene.orbit": Case(scene.orbit, 60, {"count": 2, "width": 40, "height": 30}),
        "Scene.save": Case(scene.save, 40, {"path": folder / "saved.ply", "overwrite": True, "progress": False}),
        "open": Case(tcgs.open, 60, opened),
        "rasterize": Case(tcgs.rasterize, 400, drawn | {"rasterize_mode": "antialiased"}),
        "rasterize, several": Case(tcgs.rasterize, 300, several),
        "Rasterized.vjp": Case(tcgs.rasterize(*[*gaussians(4, 1), at.viewmat, at.K, WIDTH, HEIGHT]).vjp, 60, v),
        "render": Case(tcgs.render, 80, {"scene": scene, "camera": at, "timestep": 0, "background": [0, 0, 0], "backend": "cpu"}),
        "compress": Case(tcgs.compress, 150, compressed),
        "evaluate": Case(tcgs.evaluate, 60, evaluated),
        "train": Case(tcgs.train, 80, trained, skipped="iterations"),
        "prepare": Case(tcgs.prepare, 60, prepared, skipped=f"points width {of_videos}"),
        "make_demo_capture": Case(make_and_remove, 60, made),
    }


NAMES = [
    "Camera", "Camera.look_at", "Camera.resized", "Capture", "Capture.cameras", "Capture.images", "Scene.from_arrays",
    "Scene.at", "Scene.num_gaussians_at", "Scene.orbit", "Scene.save", "open", "rasterize", "rasterize, several",
    "Rasterized.vjp", "render", "compress", "evaluate", "train", "prepare", "make_demo_capture",
]  # fmt: skip
# Arguments whose messages begin with what they name, such as a file or a frame.
NAMED_OTHERWISE = {
    "callback", "cameras", "capture", "config", "downscale", "frame", "frames", "lpips_weights", "max_error", "out", "path", "points",
    "scene", "settings", "source", "start_from", "target_bytes", "target_psnr", "timestep",
}  # fmt: skip


def test_every_public_function_is_tried() -> None:
    # Objects that functions return take no arguments: they are left out.
    returned = {"Gaussians", "Player", "Progress", "RasterizeGrads", "__version__"}
    assert {name.replace(",", ".").split(".")[0] for name in NAMES} | returned == set(tcgs.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_odd_arguments_raise_what_python_users_expect(
    name: str, capture: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Names that are odd may be those of new files.
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    warnings.simplefilter("error", np.exceptions.ComplexWarning)
    rng, case = random.Random(name), cases(capture, run, tmp_path)[name]
    places = [place for place in case.arguments if place not in case.skipped]
    raised = 0
    for _ in range(case.trials):
        place = rng.choice(places)
        right = case.arguments[place]
        is_array = isinstance(right, np.ndarray) or place in ("center", "target", "up", "background")
        odd = rng.choice(ARRAYS + SCALARS) if rng.random() < (0.4 if is_array else 1) else changed(right, rng)
        described = f"{name}({place}={odd if not isinstance(odd, np.ndarray) or odd.size < 99 else odd.shape})"
        try:
            case.function(**(case.arguments | {place: odd}))
        except (ValueError, TypeError, MemoryError, OSError, IndexError) as error:
            raised += 1
            told = "\n".join([str(error), *getattr(error, "__notes__", [])])
            is_named = place.rstrip("s") in told or place in NAMED_OTHERWISE or sys.version_info < (3, 11)
            # If two shapes disagree, the message may name either.
            assert is_named or (is_array and "has shape" in told), f"{described}: {told}"
        except BaseException as error:
            pytest.fail(f"{described} raised {type(error).__name__}: {error}")
    assert raised > case.trials // 4


@pytest.mark.parametrize("value", [-3e38, -1e30, -1e-40, 0.0, 1e-30, 1e30, 3e38])
def test_scenes_of_extreme_numbers_are_used_or_refused(value: float, tmp_path: Path) -> None:
    means, quats, scales, opacities, colors = gaussians(6, 1)
    names = ["means", "quats", "colors", "log_scales", "logit_opacities", "harmonics"]
    right = [means[None], quats[None], colors[None], np.log(scales), np.log(opacities / (1 - opacities)), np.ones((6, 3, 3))]
    for place, name in enumerate(names):
        for count in (1, right[place].size):
            arrays = [array.copy() for array in right]
            arrays[place].flat[:count] = value
            try:
                scene = tcgs.Scene.from_arrays(**dict(zip(names, arrays)))
                assert len(scene.at(0).scales) == 6
                tcgs.render(scene, scene.orbit(1, width=40, height=30)[0], backend="cpu")
                tcgs.compress(scene, tmp_path / "scene.tcgs", overwrite=True, progress=False)
                scene.save(tmp_path / "scene.4dgs", overwrite=True, progress=False)
            except (ValueError, MemoryError, OSError):
                pass
            except BaseException as error:
                pytest.fail(f"{name} of {value} raised {type(error).__name__}: {error}")


@pytest.mark.parametrize(("width", "height"), [(2**16, 2**16), (2**31, 1), (2**62, 2**62), (-1, 5), (5, 0)])
def test_images_too_large_or_without_pixels_are_refused_everywhere(width: int, height: int, tmp_path: Path) -> None:
    arrays, at = gaussians(4, 1), camera()
    scene = tcgs.open(FILE)
    refusing: list[Callable[[], object]] = [
        lambda: tcgs.Camera(at.viewmat, at.K, width, height),
        lambda: tcgs.Camera.look_at([0, 0, -3], [0, 0, 0], focal=30, width=width, height=height),
        lambda: at.resized(width, height),
        lambda: scene.orbit(2, width=width, height=height),
        lambda: tcgs.rasterize(*[*arrays, at.viewmat, at.K, width, height]),
        lambda: tcgs.make_demo_capture(tmp_path / "capture", width=width, height=height),
    ]
    for refuse in refusing:
        with pytest.raises(ValueError, match="width|height"):
            refuse()
    for count in (-1, 10**7, 2**62):
        with pytest.raises(ValueError, match="count: is .*, expected 0 to 1000000"):
            scene.orbit(count)


def test_what_does_not_fit_into_memory_is_a_memory_error(monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource", reason="this system has no limits of POSIX")
    at = camera().resized(16384, 8192)
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, before[1]))
    try:
        with pytest.raises(MemoryError, match="image: needs 8053063680 bytes"):
            tcgs.rasterize(*[*gaussians(2, 1), at.viewmat, at.K, at.width, at.height])
        with pytest.raises(MemoryError, match="image: needs"):
            tcgs.render(tcgs.open(FILE), at, backend="cpu")
        # A million Gaussians that cover an image of 2000 tiles.
        n, small = 10**6, camera().resized(720, 720)
        many: list[Any] = [np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.ones((n, 3)), np.full(n, 0.5), np.ones((n, 1))]
        with pytest.raises(MemoryError, match="splats: needs"):
            tcgs.rasterize(*[*many, small.viewmat, small.K, small.width, small.height])
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_numbers_out_of_range_are_named_with_their_place() -> None:
    means, quats, scales, opacities, colors = gaussians(4, 1)
    at = camera()

    def refused(message: str, **change: Any) -> None:
        arrays: dict[str, Any] = {"means": means, "quats": quats, "scales": scales, "opacities": opacities}
        arrays |= {"colors": colors, "viewmat": at.viewmat, "K": at.K, "width": WIDTH, "height": HEIGHT} | change
        with pytest.raises((ValueError, TypeError), match=message):
            tcgs.rasterize(**arrays)

    wrong = means.copy()
    wrong[2, 1] = np.nan
    refused(r"^means: holds NaN at \[2, 1\], expected finite numbers$", means=wrong)
    wrong[2, 1] = 1e39
    refused(r"^means: holds inf at \[2, 1\]", means=wrong)
    refused(r"^scales: holds -1.0 at \[0, 0\], expected numbers of 0 or more$", scales=-np.ones((4, 3)))
    refused(r"^opacities: holds 1.5 at \[0\], expected numbers from 0 to 1$", opacities=np.full(4, 1.5))
    refused(r"^colors: is an array of complex128, expected one of real numbers$", colors=colors + 1j)
    refused(r"^colors: is an array of <U1, expected one of real numbers$", colors=np.full((4, 3), "1"))
    refused(r"^quats: has shape \[3, 4\], expected \[4, 4\]$", quats=quats[:3])
    refused(r"^K: holds inf at \[0, 0\]", K=np.diag([np.inf, 1, 1]))
    refused(r"^background: holds NaN at \[1\]", background=[0, np.nan, 0])
    with pytest.raises(ValueError, match=r"^quats: holds \[0.0, 0.0, 0.0, 0.0\], expected a length"):
        tcgs.Scene.from_arrays(means[None], np.zeros((1, 4, 4)), colors[None], scales=scales, opacities=opacities)


def test_odd_names_are_no_files() -> None:
    for path in ("", "\0", "x" * 5000, Path("a\0b")):
        with pytest.raises((OSError, ValueError)):
            tcgs.open(path)
