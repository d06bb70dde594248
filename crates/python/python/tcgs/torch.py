"""The rasterizer as a differentiable function of torch, which is no dependency of this package."""

from __future__ import annotations

from typing import Any, Literal

import torch
from tcgs._tcgs import rasterize as _rasterize


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> Any:
        *tensors, width, height, background, mode = arguments
        if ctx.needs_input_grad[5] or ctx.needs_input_grad[6]:
            raise ValueError("viewmat and K: require a gradient, expected none: cameras are constant here")
        arrays: Any = [None if t is None else t.detach().cpu().numpy() for t in (*tensors, background)]
        ctx.drawn = _rasterize(*[*arrays[:7], width, height], background=arrays[7], rasterize_mode=mode)
        ctx.set_materialize_grads(False)
        ctx.like = [*tensors[:5], background]
        return tuple(torch.tensor(array).to(tensors[0]) for array in ctx.drawn)

    @staticmethod
    def backward(ctx: Any, *v_outputs: Any) -> Any:
        v_image, v_alpha = (None if v is None else v.cpu().numpy() for v in v_outputs)
        if v_image is None:
            v_image = 0 * ctx.drawn.image
        v = ctx.drawn.vjp(v_image, v_alpha)
        arrays = (v.v_means, v.v_quats, v.v_scales, v.v_opacities, v.v_colors, v.v_background)
        grads = [None if t is None else torch.from_numpy(a).to(t) for a, t in zip(arrays, ctx.like)]
        return (*grads[:5], None, None, None, None, grads[5], None)


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    viewmat: torch.Tensor,
    K: torch.Tensor,
    width: int,
    height: int,
    *,
    background: torch.Tensor | None = None,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
) -> tuple[torch.Tensor, torch.Tensor]:
    """`tcgs.rasterize` of tensors: image [height, width, C] and alpha [height, width, 1], with gradients to all tensors
    but viewmat and K. It computes on the CPU in float32, wherever the tensors are."""
    gaussians = (means, quats, scales, opacities, colors)
    image, alpha = _Rasterize.apply(*gaussians, viewmat, K, width, height, background, rasterize_mode)
    return image, alpha
