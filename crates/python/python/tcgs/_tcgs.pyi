"""Types of the compiled part. The docstrings are there: help(tcgs.open)."""

import datetime
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
import numpy.typing as npt

from tcgs._show import Player

__version__: str

__all__ = [
    "__version__",
    "Camera",
    "Capture",
    "Gaussians",
    "Progress",
    "RasterizeGrads",
    "Rasterized",
    "Scene",
    "compress",
    "evaluate",
    "make_demo_capture",
    "open",
    "prepare",
    "rasterize",
    "render",
    "serve",
    "train",
]

_Path = str | PathLike[str]
_Arrays = dict[str, Any]
_Float32 = npt.NDArray[np.float32]
_Float64 = npt.NDArray[np.float64]
_Backend = Literal["auto", "gpu", "cpu"]
_Cameras = Literal["train", "test", "all"]

@final
class Camera:
    def __new__(cls, viewmat: npt.ArrayLike, K: npt.ArrayLike, width: int, height: int) -> Camera: ...
    @staticmethod
    def look_at(
        center: npt.ArrayLike,
        target: npt.ArrayLike,
        *,
        up: npt.ArrayLike | None = None,
        focal: float,
        width: int,
        height: int,
    ) -> Camera: ...
    def resized(self, width: int, height: int) -> Camera: ...
    @property
    def viewmat(self) -> _Float64: ...
    @property
    def K(self) -> _Float64: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def center(self) -> _Float64: ...
    def __eq__(self, other: object, /) -> bool: ...

@final
class Capture:
    def __new__(cls, path: _Path) -> Capture: ...
    def __len__(self) -> int: ...
    @property
    def fps(self) -> float: ...
    @property
    def kind(self) -> str: ...
    @property
    def path(self) -> Path: ...
    def cameras(self, which: _Cameras = "test", *, frame: int = 0, downscale: int = 1) -> dict[int, Camera]: ...
    def images(self, which: _Cameras = "test", *, frame: int = 0, downscale: int = 1) -> dict[int, _Float32]: ...

@final
class Gaussians:
    def __len__(self) -> int: ...
    @property
    def means(self) -> _Float32: ...
    @property
    def quats(self) -> _Float32: ...
    @property
    def log_scales(self) -> _Float32: ...
    @property
    def logit_opacities(self) -> _Float32: ...
    @property
    def colors(self) -> _Float32: ...
    @property
    def unit_quats(self) -> _Float32: ...
    @property
    def scales(self) -> _Float32: ...
    @property
    def opacities(self) -> _Float32: ...
    @property
    def harmonics(self) -> _Float32: ...
    @property
    def columns(self) -> list[str]: ...
    @property
    def extra(self) -> dict[str, _Float32]: ...

@final
class Progress:
    @property
    def work(self) -> str: ...
    @property
    def done(self) -> int: ...
    @property
    def total(self) -> int: ...
    @property
    def timestep(self) -> int | None: ...
    @property
    def frame(self) -> int | None: ...
    @property
    def loss(self) -> float | None: ...
    @property
    def psnr(self) -> float | None: ...
    @property
    def num_gaussians(self) -> int | None: ...
    @property
    def bytes(self) -> int | None: ...
    @property
    def message(self) -> str | None: ...

@final
class Rasterized:
    @property
    def image(self) -> _Float32: ...
    @property
    def alpha(self) -> _Float32: ...
    def __iter__(self) -> Iterator[_Float32]: ...
    def vjp(self, v_image: npt.ArrayLike, v_alpha: npt.ArrayLike | None = None) -> RasterizeGrads: ...

@final
class RasterizeGrads:
    @property
    def v_means(self) -> _Float32: ...
    @property
    def v_quats(self) -> _Float32: ...
    @property
    def v_scales(self) -> _Float32: ...
    @property
    def v_opacities(self) -> _Float32: ...
    @property
    def v_colors(self) -> _Float32: ...
    @property
    def v_background(self) -> _Float32: ...

@final
class Scene:
    @staticmethod
    def from_arrays(
        means: npt.ArrayLike,
        quats: npt.ArrayLike,
        colors: npt.ArrayLike,
        *,
        scales: npt.ArrayLike | None = None,
        log_scales: npt.ArrayLike | None = None,
        opacities: npt.ArrayLike | None = None,
        logit_opacities: npt.ArrayLike | None = None,
        harmonics: npt.ArrayLike | None = None,
        fps: float = 30.0,
        name: str = "arrays",
    ) -> Scene: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Gaussians]: ...
    def __getitem__(self, timestep: int, /) -> Gaussians: ...
    def at(self, timestep: int) -> Gaussians: ...
    def num_gaussians_at(self, timestep: int) -> int: ...
    @property
    def num_identities(self) -> int | None: ...
    @property
    def fps(self) -> float: ...
    @property
    def path(self) -> Path: ...
    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def bytes(self) -> int: ...
    @property
    def first_frame(self) -> int: ...
    @property
    def downscale(self) -> int: ...
    @property
    def antialiased(self) -> bool: ...
    @property
    def background(self) -> tuple[float, float, float]: ...
    @property
    def sh_degree(self) -> int: ...
    @property
    def up(self) -> str: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def declared_errors(self) -> dict[str, float]: ...
    @property
    def cameras(self) -> dict[str, Camera]: ...
    def orbit(self, count: int, *, width: int = 640, height: int = 360) -> list[Camera]: ...
    def save(
        self,
        path: _Path,
        *,
        overwrite: bool = False,
        progress: bool = True,
        callback: Callable[[Progress], object] | None = None,
    ) -> None: ...

    def show(self, *, height: int = 480) -> Player: ...

def open(
    path: _Path | Sequence[_Path],
    *,
    drop_sh: bool = False,
    axes: str | None = None,
    recover: bool = False,
    no_limits: bool = False,
    fps: float | None = None,
    segment_length: int | None = None,
) -> Scene: ...
def rasterize(
    means: npt.ArrayLike,
    quats: npt.ArrayLike,
    scales: npt.ArrayLike,
    opacities: npt.ArrayLike,
    colors: npt.ArrayLike,
    viewmat: npt.ArrayLike | None = None,
    K: npt.ArrayLike | None = None,
    width: int | None = None,
    height: int | None = None,
    *,
    viewmats: npt.ArrayLike | None = None,
    Ks: npt.ArrayLike | None = None,
    background: npt.ArrayLike | None = None,
    backgrounds: npt.ArrayLike | None = None,
    near_plane: float = 0.2,
    sh_degree: int | None = None,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
) -> Rasterized: ...
def render(
    scene: Scene,
    camera: Camera,
    timestep: int = 0,
    *,
    background: npt.ArrayLike | None = None,
    backend: _Backend = "auto",
    device: str | None = None,
) -> _Float32: ...
def compress(
    source: Scene | _Arrays | _Path,
    out: _Path,
    *,
    quality: float | None = None,
    target_bytes: int | None = None,
    target_psnr: float | None = None,
    max_error: Mapping[str, float] | None = None,
    refine: int | datetime.timedelta | Literal["off"] | None = None,
    tune: bool = False,
    min_share: float | None = None,
    capture: Capture | _Path | None = None,
    preset: Literal["default", "paper"] = "default",
    segment_length: int | None = None,
    overwrite: bool = False,
    backend: _Backend = "auto",
    device: str | None = None,
    progress: bool = True,
    callback: Callable[[Progress], object] | None = None,
) -> Scene: ...
def evaluate(
    scene: Scene | _Arrays | _Path,
    capture: Capture | _Path,
    *,
    cameras: _Cameras = "test",
    frames: tuple[int, int] | None = None,
    downscale: int | None = None,
    frozen: bool = False,
    protocol: Literal["tc3dgs", "4dgs", "stg"] | None = None,
    lpips_weights: _Path | None = None,
    backend: _Backend = "auto",
    device: str | None = None,
    progress: bool = True,
    callback: Callable[[Progress], object] | None = None,
) -> dict[str, Any]: ...
def prepare(
    source: _Path,
    out: _Path,
    *,
    points: int = 80000,
    width: int = 400,
    masks: bool | None = None,
    calibration: _Path | None = None,
    scale: tuple[str, str, float] | None = None,
    refine_calibration: bool = True,
    balance_colors: bool = True,
    offsets: _Path | None = None,
    start: float | None = None,
    end: float | None = None,
    every: int = 1,
    fps: float | None = None,
    hold_out: Sequence[str] = (),
    seed: int = 0,
    overwrite: bool = False,
    progress: bool = True,
    callback: Callable[[Progress], object] | None = None,
) -> Capture: ...
def train(
    capture: Capture | _Path,
    out: _Path,
    *,
    preset: Literal["default", "fast", "paper", "d3dgs"] | None = None,
    frames: tuple[int, int] | None = None,
    downscale: int | None = None,
    iterations: tuple[int, int] | None = None,
    settings: Mapping[str, bool | int | float | str] | None = None,
    config: _Path | None = None,
    points: _Path | None = None,
    start_from: Scene | _Path | tuple[Scene | _Path, int] | None = None,
    seed: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    backend: _Backend = "auto",
    device: str | None = None,
    progress: bool = True,
    callback: Callable[[Progress], object] | None = None,
) -> Scene: ...
def serve(path: _Path) -> str: ...
def make_demo_capture(
    path: _Path,
    *,
    width: int = 128,
    height: int = 96,
    frames: int = 24,
    points: int = 8000,
    seed: int = 0,
) -> None: ...
