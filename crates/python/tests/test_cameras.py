"""Arguments of gsplat that `rasterize` takes beside one camera and colours: several cameras, harmonics, a near plane."""

from __future__ import annotations

from math import factorial, pi, sqrt
from typing import Any

import numpy as np
import pytest
import tcgs
from test_rasterize import BACKGROUND, HEIGHT, WIDTH, assert_gradient, assert_near, camera, drawn, gaussians, oracle


def cameras() -> list[tcgs.Camera]:
    looks = [([0.9, 0.4, -2.8], [0.1, 0, 0]), ([-2.0, 0.3, 2.0], [0, 0.1, 0])]
    return [camera(), *[tcgs.Camera.look_at(*look, focal=33.0, width=WIDTH, height=HEIGHT) for look in looks]]


def matrices(all: list[tcgs.Camera]) -> tuple[Any, Any]:
    return np.stack([at.viewmat for at in all]), np.stack([at.K for at in all])


def harmonics(direction: Any, degree: int) -> Any:
    """The real spherical harmonics in a direction from their definition by Legendre's polynomials, with the signs of gsplat:
    the phase of Condon and Shortley, sin(|m| phi) for m < 0."""
    x, y, z = direction / np.linalg.norm(direction)
    values = []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            order = abs(m)
            before, legendre = 0.0, float(np.prod([-(2 * i - 1) * sqrt(1 - z * z) for i in range(1, order + 1)]))
            for i in range(order + 1, l + 1):
                before, legendre = legendre, ((2 * i - 1) * z * legendre - (i + order - 1) * before) / (i - order)
            scale = sqrt((2 * l + 1) / (4 * pi) * factorial(l - order) / factorial(l + order)) * (1 if m == 0 else sqrt(2))
            phi = order * np.arctan2(y, x)
            values.append(scale * legendre * (np.sin(phi) if m < 0 else np.cos(phi)))
    return np.array(values)


def seen(means: Any, coefficients: Any, degree: int, at: tcgs.Camera) -> Any:
    """The colours that a camera sees."""
    count = (degree + 1) ** 2
    sums = [harmonics(mean - at.center, degree) @ sh[:count] for mean, sh in zip(means, coefficients)]
    return np.maximum(np.array(sums) + 0.5, 0)


def with_coefficients(n: int, count: int, seed: int) -> Any:
    """As `gaussians`, with coefficients for colours. Some sums are far below 0, none is near 0."""
    arrays, rng = gaussians(n, seed), np.random.default_rng(seed)
    arrays[4] = rng.normal(size=(n, count, 3)) * 0.1
    arrays[4][: n // 3, 0, 0] = -5
    return arrays


def test_several_cameras_give_the_bits_of_each_and_the_sum_of_gradients() -> None:
    arrays, all, rng = gaussians(12, 1), cameras(), np.random.default_rng(4)
    backgrounds = rng.uniform(size=(3, 3))
    together = tcgs.rasterize(*[*arrays, *matrices(all), WIDTH, HEIGHT], backgrounds=backgrounds)
    assert together.image.shape == (3, HEIGHT, WIDTH, 3) and together.alpha.shape == (3, HEIGHT, WIDTH, 1)
    v_image, v_alpha = rng.normal(size=together.image.shape), rng.normal(size=together.alpha.shape)
    v = together.vjp(v_image, v_alpha)
    sums: dict[str, Any] = {}
    for i, at in enumerate(all):
        alone = tcgs.rasterize(*[*arrays, at.viewmat, at.K, WIDTH, HEIGHT], background=backgrounds[i])
        assert np.array_equal(together.image[i], alone.image) and np.array_equal(together.alpha[i], alone.alpha)
        grads = alone.vjp(v_image[i], v_alpha[i])
        assert np.array_equal(v.v_background[i], grads.v_background)
        for name in ("v_means", "v_quats", "v_scales", "v_opacities", "v_colors"):
            sums[name] = sums.get(name, 0) + getattr(grads, name).astype(float)
    for name, expected in sums.items():
        np.testing.assert_allclose(getattr(v, name), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    one = tcgs.rasterize(*[*arrays, *matrices(all[:1]), WIDTH, HEIGHT])
    assert np.array_equal(one.image[0], drawn(arrays).image)


def test_the_names_of_gsplat_are_taken() -> None:
    arrays, all = gaussians(5, 2), cameras()
    viewmats, ks = matrices(all)
    backgrounds = np.tile(BACKGROUND, (3, 1))
    expected = tcgs.rasterize(*[*arrays, viewmats, ks, WIDTH, HEIGHT], background=backgrounds).image
    names = ["means", "quats", "scales", "opacities", "colors"]
    named: dict[str, Any] = dict(zip(names, arrays)) | {"viewmats": viewmats, "Ks": ks, "width": WIDTH, "height": HEIGHT}
    assert np.array_equal(tcgs.rasterize(**named, backgrounds=backgrounds).image, expected)
    wrong: list[tuple[dict[str, Any], type[Exception], str]] = [
        ({"Ks": ks[:2]}, ValueError, r"Ks: has shape \[2, 3, 3\], expected \[3, 3, 3\]"),
        ({"Ks": ks[0]}, ValueError, r"Ks: has shape \[3, 3\], expected \[3, 3, 3\]"),
        ({"viewmats": viewmats[:0]}, ValueError, r"viewmats: has shape \[0, 4, 4\], expected \[4, 4\], or \[C, 4, 4\]"),
        ({"viewmats": viewmats * [[[1]], [[2]], [[1]]]}, ValueError, "camera 1: .* of viewmats is not a rotation"),
        ({"backgrounds": BACKGROUND}, ValueError, r"backgrounds: has shape \[3\], expected \[3, 3\]"),
        ({"viewmat": viewmats}, TypeError, "viewmat and viewmats: both given"),
        ({"viewmats": None}, TypeError, "viewmat: missing, expected viewmat or viewmats"),
        ({"width": None}, TypeError, "width: missing"),
        ({"near_plane": 0}, ValueError, "near_plane: is 0, expected a number of 0.000001 or more"),
        ({"sh_degree": 4}, ValueError, "sh_degree: is 4, expected 0 to 3"),
        ({"sh_degree": 1}, ValueError, r"colors: has shape \[5, 3\], expected \[N, K, 3\] with K of 4 or more"),
    ]
    for change, exception, message in wrong:
        with pytest.raises(exception, match=message):
            tcgs.rasterize(**(named | change))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_are_those_of_the_definition_in_the_direction_of_each_camera(degree: int) -> None:
    arrays, all = with_coefficients(12, 16, 3), cameras()
    images = tcgs.rasterize(*[*arrays, *matrices(all), WIDTH, HEIGHT], sh_degree=degree).image
    for image, at in zip(images, all):
        colors = seen(arrays[0], arrays[4], degree, at)
        assert np.any(colors == 0) and np.any(colors > 0.4)
        expected = tcgs.rasterize(*[*arrays[:4], colors, at.viewmat, at.K, WIDTH, HEIGHT]).image
        np.testing.assert_allclose(image, expected, atol=2e-6)


@pytest.mark.parametrize(("degree", "count"), [(1, 4), (2, 16), (3, 16)])
def test_gradients_of_harmonics_agree_with_central_differences(degree: int, count: int) -> None:
    """A mean moves the splat and turns the direction in which it is seen: the gradient has both parts."""
    arrays, all, rng = with_coefficients(4, count, 5), cameras()[:2], np.random.default_rng(6)
    arrays[4] *= 3
    v_image = rng.normal(size=(2, HEIGHT, WIDTH, 3))

    def image(i: int, reached: list[Any] | None = None) -> Any:
        colors = seen(arrays[0], arrays[4], degree, all[i])
        return oracle([*arrays[:4], colors], np.zeros(3), "classic", reached, all[i])

    reached = [image(i)[2] for i in range(2)]

    def loss() -> float:
        return float(sum(np.sum(image(i, reached[i])[0] * v_image[i]) for i in range(2)))

    v = tcgs.rasterize(*[*arrays, *matrices(all), WIDTH, HEIGHT], sh_degree=degree).vjp(v_image)
    assert_gradient(v.v_means, arrays[0], loss)
    assert_gradient(v.v_colors, arrays[4], loss)
    assert not np.any(v.v_colors[:, (degree + 1) ** 2 :]) and np.any(v.v_colors[:, (degree + 1) ** 2 - 1])


def test_a_near_plane_leaves_out_what_is_nearer() -> None:
    arrays, at = gaussians(40, 8), camera()
    depths = arrays[0] @ at.viewmat[2, :3] + at.viewmat[2, 3]
    near = float(np.median(depths))
    cut = drawn(arrays, near_plane=near)
    assert np.array_equal(cut.image, drawn([array[depths > near] for array in arrays]).image)
    grads = cut.vjp(np.ones((HEIGHT, WIDTH, 3)))
    for grad in (grads.v_means, grads.v_quats, grads.v_scales, grads.v_opacities, grads.v_colors):
        assert not np.any(grad[depths <= near]) and np.any(grad[depths > near])


def test_a_near_plane_reveals_what_the_renderer_would_leave_out() -> None:
    arrays, at = gaussians(6, 9), camera()
    # One at a depth of 0.1, small enough to show some of the rest.
    arrays[0][0] = at.center + 0.1 * (at.viewmat[2, :3])
    arrays[2][0] = 0.005
    colors = [array[1:] for array in arrays]
    assert np.array_equal(drawn(arrays).image, drawn(colors).image)
    for near in (0.0999, 0.01, 1e-6):
        image, alpha = drawn(arrays, near_plane=near)
        expected, expected_alpha, _ = oracle(arrays, np.zeros(3), "classic")
        assert_near(image, expected)
        assert_near(alpha, expected_alpha)
    assert np.array_equal(drawn(arrays, near_plane=0.1001).image, drawn(colors).image)


@pytest.mark.parametrize("options", [{}, {"sh_degree": 3}, {"rasterize_mode": "antialiased"}])
def test_a_nearer_plane_changes_no_bit_of_what_is_beyond(options: dict[str, Any]) -> None:
    arrays = with_coefficients(12, 16, 1) if "sh_degree" in options else gaussians(12, 1)
    v_image, v_alpha = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH, 3)), np.ones((HEIGHT, WIDTH, 1))
    plain, near = drawn(arrays, **options), drawn(arrays, near_plane=0.003, **options)
    assert np.array_equal(plain.image, near.image) and np.array_equal(plain.alpha, near.alpha)
    v, v_near = plain.vjp(v_image, v_alpha), near.vjp(v_image, v_alpha)
    for name in ("v_means", "v_quats", "v_scales", "v_opacities", "v_colors", "v_background"):
        assert np.array_equal(getattr(v, name), getattr(v_near, name)), name
