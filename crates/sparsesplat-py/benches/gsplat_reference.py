"""Beside gsplat's pure-PyTorch reference (`gsplat/cuda/_torch_impl.py`) on the CPU: the same scene, forward and backward, in turns.

Two things of the reference exist as CUDA alone, and stand here in PyTorch: the list of pairs of Gaussian and pixel
(`rasterize_to_indices_in_range`), which is made once and not counted, and two functions of nerfacc that sum along a pixel.

    git clone https://github.com/nerfstudio-project/gsplat && python gsplat_reference.py gsplat [--counts 2000,10000] [--runs 3]
"""

import argparse
import sys
import time
import types

import numpy as np
import torch
from scenes import courtyard

import sparsesplat.torch as sst

parser = argparse.ArgumentParser()
parser.add_argument("gsplat", help="a checkout of gsplat")
parser.add_argument("--counts", default="2000,10000")
parser.add_argument("--runs", type=int, default=3)
options = parser.parse_args()
sys.path.insert(0, options.gsplat)
TILE = 16


def render_weight_from_alpha(alphas, ray_indices, n_rays):
    """Shares of sorted pairs in their pixels."""
    # A sum over millions of pairs: float32 would lose the last of them.
    logs = torch.log1p(-alphas).double()
    before = logs.cumsum(0) - logs
    first = torch.searchsorted(ray_indices, torch.arange(n_rays))
    start = before[first.clamp(max=max(len(alphas) - 1, 0))]
    trans = torch.exp(before - start[ray_indices]).float()
    return alphas * trans, trans


def accumulate_along_rays(weights, values, ray_indices, n_rays):
    found = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros(n_rays, found.shape[1]).index_add(0, ray_indices, found)


sys.modules["nerfacc"] = types.ModuleType("nerfacc")
sys.modules["nerfacc"].render_weight_from_alpha = render_weight_from_alpha
sys.modules["nerfacc"].accumulate_along_rays = accumulate_along_rays
from gsplat.cuda import _torch_impl as reference  # noqa: E402


@torch.no_grad()
def pairs(means2d, conics, opacities, offsets, ids, width, height):
    """Gaussian and pixel of everything that is drawn: pixel by pixel, near to far."""
    gaussians, pixels = [], []
    rows, columns = offsets.shape
    ends = torch.cat([offsets.flatten()[1:], torch.tensor([len(ids)])])
    for tile, (begin, end) in enumerate(zip(offsets.flatten().tolist(), ends.tolist())):
        if begin == end:
            continue
        y, x = divmod(tile, columns)
        ys, xs = torch.meshgrid(
            torch.arange(TILE * y, min(TILE * (y + 1), height)), torch.arange(TILE * x, min(TILE * (x + 1), width)), indexing="ij"
        )
        mine = ids[begin:end].long()
        dx = xs.flatten()[:, None] + 0.5 - means2d[mine, 0]
        dy = ys.flatten()[:, None] + 0.5 - means2d[mine, 1]
        a, b, c = conics[mine].T
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (opacities[mine] * torch.exp(-sigma)).clamp(max=0.99)
        drawn = (alpha >= 1 / 255) & (sigma >= 0)
        left = torch.cumprod(torch.where(drawn, 1 - alpha, torch.ones_like(alpha)), dim=1)
        drawn &= left > 1e-4
        pixel, gaussian = drawn.nonzero(as_tuple=True)
        gaussians.append(mine[gaussian])
        pixels.append((ys.flatten() * width + xs.flatten())[pixel])
    gaussians, pixels = torch.cat(gaussians), torch.cat(pixels)
    order = torch.argsort(pixels, stable=True)
    return gaussians[order], pixels[order]


def draw(means, quats, scales, opacities, colors, viewmats, Ks, width, height, known=None):
    """The reference's passes in order; the picture, the list of pairs, and the seconds that it took if it was not known."""
    covars, _ = reference._quat_scale_to_covar_preci(quats, scales, True, False, False)
    radii, means2d, depths, conics, _ = reference._fully_fused_projection(means, covars, viewmats, Ks, width, height)
    centre = -viewmats[0, :3, :3].T @ viewmats[0, :3, 3]
    rgb = (reference._spherical_harmonics(2, means - centre, colors) + 0.5).clamp(min=0)
    columns, rows = -(-width // TILE), -(-height // TILE)
    _, isect_ids, ids = reference._isect_tiles(means2d, radii, depths, TILE, columns, rows)
    offsets = reference._isect_offset_encode(isect_ids, 1, columns, rows)
    begin = time.perf_counter()
    known = known or pairs(means2d[0], conics[0], opacities, offsets[0], ids, width, height)
    gaussians, pixels = known
    listing = time.perf_counter() - begin
    images = torch.zeros_like(pixels)
    picture, _ = reference.accumulate(means2d, conics, opacities[None], rgb[None], gaussians, pixels, images, width, height)
    return picture, known, listing


for count in map(int, options.counts.split(",")):
    _, arrays, camera = courtyard(count)
    tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in arrays.items()}
    views = {name: torch.from_numpy(value) if hasattr(value, "shape") else value for name, value in camera.items()}
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(1, camera["height"], camera["width"], 3)).astype(np.float32))

    def clear():
        for tensor in tensors.values():
            tensor.grad = None

    def ours():
        clear()
        begin = time.perf_counter()
        picture, _, _ = sst.rasterize(**tensors, **views, sh_degree=2, device="cpu")
        middle = time.perf_counter()
        picture.backward(weights)
        return middle - begin, time.perf_counter() - middle, picture.detach()

    def theirs():
        clear()
        begin = time.perf_counter()
        picture, _, listing = draw(**tensors, **views, known=known)
        middle = time.perf_counter()
        picture.backward(weights)
        return middle - begin - listing, time.perf_counter() - middle, picture.detach()

    for _ in range(3):
        ours()
    with torch.no_grad():
        _, known, listing = draw(**tensors, **views)
    found = []
    for _ in range(options.runs):
        a = ours()
        by_us = {name: tensor.grad.clone() for name, tensor in tensors.items()}
        b = theirs()
        found.append((a, b))
    worst = max(
        ((by_us[name] - tensors[name].grad).abs().max() / tensors[name].grad.abs().max()).item() for name in tensors
    )
    difference = (found[-1][0][2] - found[-1][1][2]).abs()
    print(f"{count} Gaussians: pictures differ by {difference.mean():.1e} on the mean and {difference.max():.1e} at most, gradients by {worst:.1e} of the largest")
    for place, name in [(0, "forward"), (1, "backward")]:
        ratio = np.median([b[place] / a[place] for a, b in found])
        mine, other = (1e3 * np.median([pair[side][place] for pair in found]) for side in (0, 1))
        print(f"  {name:<8} ours {mine:8.1f} ms, reference {other:9.1f} ms: {ratio:.0f} times as long")
    both = np.median([(b[0] + b[1]) / (a[0] + a[1]) for a, b in found])
    print(f"  both: {both:.0f} times as long (its {len(known[0])} pairs, listed once in {listing:.1f} s, are not counted)", flush=True)
