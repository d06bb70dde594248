"""The rasterizer against one without tiles and tricks, and its gradients against central differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import tcgs

WIDTH, HEIGHT = 40, 30
BACKGROUND = np.array([0.2, 0.5, 0.1])


def camera() -> tcgs.Camera:
    return tcgs.Camera.look_at([0.2, -0.3, -3.0], [0, 0, 0], focal=36.0, width=WIDTH, height=HEIGHT)


def gaussians(n: int, seed: int) -> Any:
    """Means, quats that are not unit, scales, opacities, colours: in and around the view of `camera`."""
    rng = np.random.default_rng(seed)
    quats = rng.uniform(-1, 1, (n, 4)) + [0.8, 0, 0, 0]
    scales, opacities, colors = rng.uniform(0.05, 0.3, (n, 3)), rng.uniform(0.1, 0.8, n), rng.uniform(0, 1, (n, 3))
    return [rng.uniform(-0.8, 0.8, (n, 3)), quats, scales, opacities, colors]


def drawn(arrays: Any, **options: Any) -> tcgs.Rasterized:
    at = camera()
    return tcgs.rasterize(*[*arrays, at.viewmat, at.K, at.width, at.height], **options)


def oracle(
    arrays: Any, background: Any, mode: str, reached: list[Any] | None = None, at: tcgs.Camera | None = None
) -> tuple[Any, Any, list[Any]]:
    """Image and alpha in float64 from the equations (Kerbl et al. 2023), every Gaussian at every pixel.

    - mode: with "antialiased" opacities shrink as splats are widened (Yu et al. 2024, Eq. 10)
    - reached: of each Gaussian from front to back the pixels that it reaches, as an earlier call returned them; alpha has
      a cutoff, and what a gradient means is the change where nothing crosses it
    - at: another camera than `camera`, with an image of the same size
    """
    at = at or camera()
    view, k = at.viewmat, at.K
    splats = []
    for mean, quat, scale, opacity, color in zip(*arrays):
        w, x, y, z = quat / np.linalg.norm(quat)
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])
        x, y, z = view[:3, :3] @ mean + view[:3, 3]
        focal = k[0, 0]
        jacobian = focal / z * np.array([[1, 0, -x / z], [0, 1, -y / z]])
        root = jacobian @ view[:3, :3] @ rotation @ np.diag(scale)
        narrow, wide = root @ root.T, root @ root.T + 0.3 * np.eye(2)
        conic = np.linalg.inv(wide)
        if mode == "antialiased":
            opacity = opacity * np.sqrt(np.linalg.det(narrow) / np.linalg.det(wide))
        splats.append((z, focal * np.array([x, y]) / z + k[:2, 2], conic, opacity, color))
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    image, transmittance = np.zeros((HEIGHT, WIDTH, len(background))), np.ones((HEIGHT, WIDTH, 1))
    reaching: list[Any] = []
    for _, center, conic, opacity, color in sorted(splats, key=lambda splat: splat[0]):
        d = np.stack([columns, rows], axis=-1) - center
        alpha = opacity * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, conic, d))[..., None]
        reaching.append(alpha >= 1 / 255 if reached is None else reached[len(reaching)])
        alpha = alpha * reaching[-1]
        image += transmittance * alpha * color
        transmittance = transmittance * (1 - alpha)
    return image + transmittance * background, 1 - transmittance, reaching


def assert_near(found: Any, expected: Any) -> None:
    """Images agree, but for pixels at the cutoff of alpha: they may fall on either side, by 1/255 of a colour."""
    error = np.abs(found - expected)
    assert np.mean(error > 1e-5) < 2e-3 and error.max() < 1 / 255


def assert_gradient(grad: Any, array: Any, loss: Callable[[], float]) -> None:
    """The gradient of a loss to an array, in float32, agrees with central differences in float64.

    - loss: of the array's content, which is changed and restored
    """
    assert grad.shape == array.shape and grad.dtype == np.float32
    differences = np.zeros_like(array)
    for place in np.ndindex(array.shape):
        value, h = array[place], 1e-6
        array[place] = value + h
        above = loss()
        array[place] = value - h
        differences[place] = (above - loss()) / (2 * h)
        array[place] = value
    np.testing.assert_allclose(grad, differences, rtol=1e-3, atol=2e-5 * np.abs(differences).max())


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_the_image_is_that_of_the_equations(mode: str) -> None:
    arrays = gaussians(12, 1)
    image, alpha = drawn(arrays, background=BACKGROUND, rasterize_mode=mode)
    expected_image, expected_alpha, _ = oracle(arrays, BACKGROUND, mode)
    assert image.shape == (HEIGHT, WIDTH, 3) and alpha.shape == (HEIGHT, WIDTH, 1)
    assert 0.05 < alpha.mean() < 0.95
    assert_near(image, expected_image)
    assert_near(alpha, expected_alpha)


@pytest.mark.parametrize(("channels", "mode"), [(1, "classic"), (3, "classic"), (3, "antialiased"), (8, "classic")])
def test_gradients_agree_with_central_differences(channels: int, mode: str) -> None:
    rng = np.random.default_rng(3)
    arrays = gaussians(8, 2)
    arrays[4] = rng.uniform(0, 1, (8, channels))
    everything = [*arrays, rng.uniform(0, 1, channels)]
    v_image, v_alpha = rng.normal(size=(HEIGHT, WIDTH, channels)), rng.normal(size=(HEIGHT, WIDTH, 1))
    reached = oracle(arrays, everything[5], mode)[2]

    def loss() -> float:
        image, alpha, _ = oracle(everything[:5], everything[5], mode, reached)
        return float(np.sum(image * v_image) + np.sum(alpha * v_alpha))

    v = drawn(arrays, background=everything[5], rasterize_mode=mode).vjp(v_image, v_alpha)
    grads = [v.v_means, v.v_quats, v.v_scales, v.v_opacities, v.v_colors, v.v_background]
    for array, grad in zip(everything, grads):
        assert_gradient(grad, array, loss)


def test_no_gaussians_give_the_background() -> None:
    empty = [np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))]
    image, alpha = drawn(empty, background=BACKGROUND)
    assert np.all(image == BACKGROUND.astype(np.float32)) and not alpha.any()


def test_anything_that_is_an_array_is_taken() -> None:
    arrays = gaussians(3, 4)
    reference = drawn(arrays)
    for other in ([a.tolist() for a in arrays], [a.astype(np.float32) for a in arrays], [np.asfortranarray(a) for a in arrays]):
        assert np.array_equal(drawn(other).image, reference.image)


def test_wrong_shapes_are_named() -> None:
    arrays, at = gaussians(3, 4), camera()
    with pytest.raises(ValueError, match=r"quats: has shape \[3, 3\], expected \[3, 4\]"):
        drawn([arrays[0], arrays[2], *arrays[2:]])
    with pytest.raises(ValueError, match=r"colors: has shape \[3, 9\], expected \[N, C\] with C of 1 to 8"):
        drawn([*arrays[:4], np.ones((3, 9))])
    with pytest.raises(ValueError, match=r"v_image: has shape"):
        drawn(arrays).vjp(np.ones((3, 3)))
    with pytest.raises(ValueError, match='rasterize_mode: "RGB", expected "classic" or "antialiased"'):
        drawn(arrays, rasterize_mode="RGB")
    with pytest.raises(ValueError, match="viewmat is not a rotation"):
        tcgs.rasterize(*[*arrays, 2 * at.viewmat, at.K, WIDTH, HEIGHT])


def test_a_scene_is_drawn_as_its_arrays() -> None:
    arrays = gaussians(20, 5)
    means, quats, scales, opacities, colors = arrays
    scene = tcgs.Scene.from_arrays(means[None], quats[None], colors[None], scales=scales, opacities=opacities)
    g = scene.at(0)
    image = tcgs.render(scene, camera(), 0, backend="cpu", background=list(BACKGROUND))
    stored = drawn([g.means, g.quats, g.scales, g.opacities, g.colors], background=BACKGROUND)
    assert np.array_equal(image, stored.image)
