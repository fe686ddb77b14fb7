"""The operation of PyTorch. Run where torch is installed; `cargo xtask python-test --torch` installs it."""

import numpy as np
import pytest
from conftest import cameras, scene

torch = pytest.importorskip("torch")

import sparsesplat as ss  # noqa: E402
import sparsesplat.torch as sst  # noqa: E402

SMOOTH = dict(alpha_min=1e-6, transmittance_min=1e-12, alpha_max=0.9999, device="cpu")


def tensors(n=6, sh_degree=None, count=1, width=24, height=18):
    arrays = {name: torch.from_numpy(array) for name, array in scene(n, sh_degree=sh_degree).items()}
    views = cameras(count, width, height)
    views["viewmats"], views["Ks"] = torch.from_numpy(views["viewmats"]), torch.from_numpy(views["Ks"])
    return arrays, views


def visible_depth(colors, alphas, mode):
    """Expected depth leaps at the rim of a footprint, from 0 to that of the Gaussian; times alpha it does not."""
    if "ED" not in mode:
        return colors
    return torch.cat([colors[..., :3], colors[..., 3:] * alphas], dim=-1)


def test_the_same_numbers_as_numpy():
    arrays, views = tensors(30, sh_degree=2, count=2)
    for name in arrays:
        arrays[name].requires_grad_()
    colors, alphas, meta = sst.rasterize(**arrays, **views, sh_degree=2, render_mode="RGB+ED", device="cpu")
    numpy_views = dict(views, viewmats=views["viewmats"].numpy(), Ks=views["Ks"].numpy())
    numpy_arrays = {name: tensor.detach().numpy() for name, tensor in arrays.items()}
    expected, expected_alphas, _, tape = ss.record(
        **numpy_arrays, **numpy_views, sh_degree=2, render_mode="RGB+ED", device="cpu"
    )
    assert (colors.detach().numpy() == expected).all() and (alphas.detach().numpy() == expected_alphas).all()
    assert meta["n_cameras"] == 2 and meta["device"] == "cpu"
    (colors.sum() + 2 * alphas.sum()).backward()
    found = tape.backward(np.ones_like(expected), np.full_like(expected_alphas, 2))
    for name in arrays:
        np.testing.assert_array_equal(arrays[name].grad.numpy(), found[name])
    with torch.no_grad():
        plain, _, _ = sst.rasterize(**arrays, **views, sh_degree=2, render_mode="RGB+ED", device="cpu")
    assert not plain.requires_grad and (plain == colors).all()


@pytest.mark.parametrize("mode", ["RGB", "RGB+D", "RGB+ED"])
@pytest.mark.parametrize("sh_degree", [None, 1])
def test_gradcheck(mode, sh_degree):
    arrays, views = tensors(4, sh_degree, count=2, width=14, height=10)
    views["Ks"][:, :2] *= 0.35
    background = torch.tensor([[0.2, 0.5, 0.1], [0.7, 0.3, 0.4]])
    names = list(arrays)

    def picture(*inputs):
        # The renderer computes in float32; gradcheck wants float64 around it.
        given = {name: tensor.float() for name, tensor in zip(names, inputs)}
        colors, alphas, _ = sst.rasterize(
            **given, **views, backgrounds=inputs[-1].float(), sh_degree=sh_degree, render_mode=mode, **SMOOTH
        )
        return visible_depth(colors, alphas, mode).double(), alphas.double()

    inputs = [tensor.double().requires_grad_() for tensor in [*arrays.values(), background]]
    # Steps of 2e-3: differences of float32 numbers are known to 1e-7 / 2e-3.
    assert torch.autograd.gradcheck(picture, inputs, eps=2e-3, atol=4e-3, rtol=2e-2)


def test_gradcheck_by_poses():
    arrays, views = tensors(5, count=2, width=14, height=10)
    views["Ks"][:, :2] *= 0.35

    def picture(twists):
        # Matrices that stay rotations: exp of a twist, times the pose.
        generators = torch.zeros(len(twists), 4, 4, dtype=torch.float64)
        generators[:, :3, 3] = twists[:, :3]
        x, y, z = twists[:, 3:].T
        for row, column, value in [(2, 1, x), (0, 2, y), (1, 0, z)]:
            generators[:, row, column] = generators[:, row, column] + value
            generators[:, column, row] = generators[:, column, row] - value
        viewmats = torch.linalg.matrix_exp(generators) @ views["viewmats"].double()
        colors, alphas, _ = sst.rasterize(**arrays, **dict(views, viewmats=viewmats), render_mode="RGB+ED", **SMOOTH)
        # A few weighted sums: one walk back for each.
        pixels = torch.cat([visible_depth(colors, alphas, "RGB+ED"), alphas], dim=-1).double()
        return (weights * pixels).sum(dim=(1, 2, 3, 4))

    weights = torch.rand(8, 2, 10, 14, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) / 20
    twists = torch.full((2, 6), 0.01, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(picture, twists, eps=2e-3, atol=4e-3, rtol=2e-2)


def test_what_needs_no_gradient_gets_none():
    arrays, views = tensors()
    arrays["colors"].requires_grad_()
    colors, _, _ = sst.rasterize(**arrays, **views, device="cpu")
    colors.mean().backward()
    assert arrays["colors"].grad.abs().sum() > 0 and arrays["means"].grad is None
    # Views and slices need not be contiguous.
    wide = torch.rand(6, 6, requires_grad=True)
    colors, _, _ = sst.rasterize(**dict(arrays, colors=wide[:, ::2]), **views, device="cpu")
    colors.mean().backward()
    assert (wide.grad[:, 1::2] == 0).all() and wide.grad.abs().sum() > 0


def test_alphas_alone_have_gradients():
    arrays, views = tensors()
    arrays["opacities"].requires_grad_()
    _, alphas, _ = sst.rasterize(**arrays, **views, device="cpu")
    alphas.sum().backward()
    assert arrays["opacities"].grad.min() > 0


def test_tensors_that_changed_before_the_backward_pass_are_an_error():
    arrays, views = tensors()
    arrays["means"].requires_grad_()
    colors, _, _ = sst.rasterize(**arrays, **views, device="cpu")
    arrays["scales"] *= 2
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        colors.sum().backward()
    # Afterwards they may change.
    colors, _, _ = sst.rasterize(**arrays, **views, device="cpu")
    colors.sum().backward()
    with torch.no_grad():
        arrays["means"] -= 0.1 * arrays["means"].grad


def test_wrong_tensors_are_named():
    arrays, views = tensors()
    with pytest.raises(TypeError, match="means: expected dtype float32, found float64"):
        sst.rasterize(**dict(arrays, means=arrays["means"].double()), **views)
    with pytest.raises(ValueError, match="Ks: the renderer has no gradients by the intrinsics"):
        sst.rasterize(**arrays, **dict(views, Ks=views["Ks"].requires_grad_()))
    views["Ks"].requires_grad_(False)
    with pytest.raises(ValueError, match="opacities: Gaussian 0 has"):
        sst.rasterize(**dict(arrays, opacities=arrays["opacities"] - 5), **views)
    arrays["means"].requires_grad_()
    colors, _, _ = sst.rasterize(**arrays, **views, device="cpu")
    (gradient,) = torch.autograd.grad(colors.sum(), arrays["means"], create_graph=True)
    with pytest.raises(RuntimeError, match="does not require grad"):
        gradient.sum().backward()


def test_importing_the_package_imports_no_torch():
    import subprocess
    import sys

    code = "import sys, sparsesplat; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
