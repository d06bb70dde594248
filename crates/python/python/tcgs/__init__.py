"""Dynamic 3D Gaussian scenes as NumPy arrays: read, prepare, train, compress, render.

>>> import tcgs
>>> scene = tcgs.open("scene.tcgs")
>>> scene.at(0).means.shape

`tcgs.rasterize` is a differentiable rasterizer on the CPU; `tcgs.torch` makes a function of torch of it.
"""

from tcgs._open import open
from tcgs._show import Player
from tcgs._tcgs import (
    Camera,
    Capture,
    Gaussians,
    Progress,
    RasterizeGrads,
    Rasterized,
    Scene,
    __version__,
    compress,
    evaluate,
    make_demo_capture,
    prepare,
    rasterize,
    render,
    train,
)

__all__ = [
    "Camera",
    "Capture",
    "Gaussians",
    "Player",
    "Progress",
    "RasterizeGrads",
    "Rasterized",
    "Scene",
    "__version__",
    "compress",
    "evaluate",
    "make_demo_capture",
    "open",
    "prepare",
    "rasterize",
    "render",
    "train",
]
