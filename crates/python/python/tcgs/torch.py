"""The rasterizer as a differentiable function of torch, which is no dependency of this package."""

from __future__ import annotations

from typing import Any, Literal

import torch
from tcgs._tcgs import rasterize as _rasterize


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, names: list[str], options: dict[str, Any], *tensors: Any) -> Any:
        ctx.drawn = _rasterize(**{name: _array(tensor) for name, tensor in zip(names, tensors)}, **options)
        ctx.set_materialize_grads(False)
        ctx.names, ctx.like = names, tensors
        return tuple(torch.tensor(array).to(tensors[0]) for array in ctx.drawn)

    @staticmethod
    def backward(ctx: Any, *v_outputs: Any) -> Any:
        v_image, v_alpha = (None if v is None else v.cpu().numpy() for v in v_outputs)
        if v_image is None:
            v_image = 0 * ctx.drawn.image
        v = ctx.drawn.vjp(v_image, v_alpha)
        arrays = [getattr(v, "v_background" if name == "backgrounds" else f"v_{name}") for name in ctx.names]
        return (None, None, *[torch.from_numpy(array).to(tensor) for array, tensor in zip(arrays, ctx.like)])


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy()


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    viewmat: torch.Tensor | None = None,
    K: torch.Tensor | None = None,
    width: int | None = None,
    height: int | None = None,
    *,
    viewmats: torch.Tensor | None = None,
    Ks: torch.Tensor | None = None,
    background: torch.Tensor | None = None,
    backgrounds: torch.Tensor | None = None,
    near_plane: float = 0.2,
    sh_degree: int | None = None,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
) -> tuple[torch.Tensor, torch.Tensor]:
    """`tcgs.rasterize` of tensors: image [height, width, D] and alpha [height, width, 1], of several cameras
    [C, height, width, …], with gradients to all tensors but those of the cameras. It computes on the CPU in float32, wherever
    the tensors are."""
    gaussians = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    behinds = {"background": background, "backgrounds": backgrounds}
    all_cameras = {"viewmat": viewmat, "viewmats": viewmats, "K": K, "Ks": Ks}
    behind, cameras = ({name: t for name, t in given.items() if t is not None} for given in (behinds, all_cameras))
    for name, tensor in (gaussians | behind | cameras).items():
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f"{name}: is {type(tensor).__name__}, expected a tensor")
        if name in cameras and tensor.requires_grad:
            raise ValueError("viewmat and K: require a gradient, expected none: cameras are constant here")
    options = {name: _array(tensor) for name, tensor in cameras.items()}
    options |= {"width": width, "height": height, "near_plane": near_plane, "sh_degree": sh_degree}
    options["rasterize_mode"] = rasterize_mode
    if len(behind) == 2:
        raise TypeError("background and backgrounds: both given, expected one of them")
    tensors = gaussians | behind
    image, alpha = _Rasterize.apply(list(tensors), options, *tensors.values())
    return image, alpha
