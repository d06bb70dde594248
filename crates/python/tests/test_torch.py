"""The rasterizer as a function of torch."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
import tcgs

torch = pytest.importorskip("torch", reason="torch is not installed, expected it to test tcgs.torch")

from test_cameras import cameras, matrices, with_coefficients  # noqa: E402
from test_rasterize import BACKGROUND, HEIGHT, WIDTH, camera, drawn, gaussians  # noqa: E402

from tcgs.torch import rasterize  # noqa: E402


NAMES = ["means", "quats", "scales", "opacities", "colors"]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_gradients_flow_to_every_tensor(mode: Literal["classic", "antialiased"]) -> None:
    arrays = gaussians(8, 2)
    at = camera()
    tensors: Any = [torch.tensor(array, requires_grad=True) for array in [*arrays, BACKGROUND]]
    view, k = torch.tensor(at.viewmat), torch.tensor(at.K)
    image, alpha = rasterize(*[*tensors[:5], view, k, WIDTH, HEIGHT], background=tensors[5], rasterize_mode=mode)
    rng = np.random.default_rng(3)
    v_image, v_alpha = rng.normal(size=(HEIGHT, WIDTH, 3)), rng.normal(size=(HEIGHT, WIDTH, 1))
    (torch.sum(image * torch.tensor(v_image)) + torch.sum(alpha * torch.tensor(v_alpha))).backward()
    reference = drawn(arrays, background=BACKGROUND, rasterize_mode=mode)
    assert np.array_equal(image.detach().numpy().astype(np.float32), reference.image)
    v = reference.vjp(v_image, v_alpha)
    expected = [v.v_means, v.v_quats, v.v_scales, v.v_opacities, v.v_colors, v.v_background]
    for tensor, grad in zip(tensors, expected):
        assert tensor.grad.dtype == tensor.dtype
        np.testing.assert_array_equal(tensor.grad.numpy().astype(np.float32), grad)


def test_several_cameras_and_harmonics_are_those_of_the_arrays() -> None:
    arrays, (viewmats, ks) = with_coefficients(6, 9, 2), matrices(cameras())
    backgrounds = np.random.default_rng(1).uniform(size=(3, 3))
    tensors: Any = [torch.tensor(array, requires_grad=True) for array in [*arrays, backgrounds]]
    options: Any = {"near_plane": 0.01, "sh_degree": 2}
    image, alpha = rasterize(
        **dict(zip(NAMES, tensors)), viewmats=torch.tensor(viewmats), Ks=torch.tensor(ks), width=WIDTH, height=HEIGHT,
        backgrounds=tensors[5], **options,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    v_image, v_alpha = rng.normal(size=image.shape), rng.normal(size=alpha.shape)
    (torch.sum(image * torch.tensor(v_image)) + torch.sum(alpha * torch.tensor(v_alpha))).backward()
    reference = tcgs.rasterize(*[*arrays, viewmats, ks, WIDTH, HEIGHT], backgrounds=backgrounds, **options)
    assert np.array_equal(image.detach().numpy().astype(np.float32), reference.image)
    v = reference.vjp(v_image, v_alpha)
    expected = [v.v_means, v.v_quats, v.v_scales, v.v_opacities, v.v_colors, v.v_background]
    for tensor, grad in zip(tensors, expected):
        np.testing.assert_array_equal(tensor.grad.numpy().astype(np.float32), grad)


def test_what_is_no_tensor_is_named() -> None:
    at, arrays = camera(), gaussians(2, 1)
    tensors: Any = [torch.tensor(array) for array in [*arrays, at.viewmat, at.K]]
    with pytest.raises(TypeError, match="^K: is ndarray, expected a tensor$"):
        rasterize(*[*tensors[:6], at.K, WIDTH, HEIGHT])
    with pytest.raises(TypeError, match="background and backgrounds: both given"):
        rasterize(*[*tensors, WIDTH, HEIGHT], background=tensors[4][0], backgrounds=tensors[4][0])
    tensors[0][0, 0] = torch.nan
    with pytest.raises(ValueError, match=r"^means: holds NaN at \[0, 0\]"):
        rasterize(*[*tensors, WIDTH, HEIGHT])


def test_a_scene_is_fitted_to_an_image() -> None:
    at = camera()
    goal = torch.tensor(drawn(gaussians(6, 7)).image)
    tensors: Any = [torch.tensor(array, dtype=torch.float32) for array in gaussians(6, 7)]
    tensors[4] = torch.full((6, 3), 0.5, requires_grad=True)
    view, k = torch.tensor(at.viewmat), torch.tensor(at.K)
    optimizer = torch.optim.Adam([tensors[4]], lr=0.05)
    losses = []
    for _ in range(60):
        image, _ = rasterize(*[*tensors, view, k, WIDTH, HEIGHT])
        loss = torch.mean((image - goal) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.01 * losses[0]


def test_a_camera_that_asks_for_gradients_is_refused() -> None:
    at = camera()
    tensors: Any = [torch.tensor(array) for array in gaussians(2, 1)]
    view = torch.tensor(at.viewmat, requires_grad=True)
    with pytest.raises(ValueError, match="viewmat and K"):
        rasterize(*[*tensors, view, torch.tensor(at.K), WIDTH, HEIGHT])
