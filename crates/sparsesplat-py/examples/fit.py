# %% [markdown]
# Fit 2,000 Gaussians to pictures of a simulated courtyard, with PyTorch on the CPU.
#
# The cells run in order, as a notebook or as a script: `python fit.py [--steps N] [--picture FILE.png]`.

# %%
import argparse
import time

import numpy as np
import torch

import sparsesplat as ss
import sparsesplat.torch as sst

arguments = argparse.ArgumentParser()
arguments.add_argument("--steps", type=int, default=300)
arguments.add_argument("--picture", help="write a PNG: two held-out views, each as photograph, before and after")
arguments = arguments.parse_args()
torch.manual_seed(0)

# %% [markdown]
# Photographs: six to fit to, five held out. Each has an image [h, w, 3], a world-to-camera matrix and intrinsics.

# %%
context, held_out = ss.simulated_views(192, 128)
height, width, _ = context[0].image.shape


def stack(views):
    return {
        "viewmats": torch.from_numpy(np.stack([view.viewmat for view in views])),
        "Ks": torch.from_numpy(np.stack([view.K for view in views])),
        "width": width,
        "height": height,
    }


photographs = torch.from_numpy(np.stack([view.image for view in context]))
cameras = stack(context)

# %% [markdown]
# Start: 2,000 points of the measured depth, grey, each as wide as its three neighbours are far.

# %%
points = []
for view in context:
    rows, columns = np.nonzero(view.depth)
    z = view.depth[rows, columns]
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], axis=1) @ np.linalg.inv(view.K).T
    rotation, translation = view.viewmat[:3, :3], view.viewmat[:3, 3]
    points.append((rays * z[:, None] - translation) @ rotation)
points = np.concatenate(points)
chosen = np.random.default_rng(0).choice(len(points), 2_000, replace=False)
points = np.ascontiguousarray(points[chosen], np.float32)
_, sq_distances = ss.knn(points, 3)
spacing = torch.from_numpy(np.sqrt(sq_distances.mean(axis=1, keepdims=True))).clamp(min=1e-3)

means = torch.from_numpy(points).requires_grad_()
log_scales = spacing.log().repeat(1, 3).requires_grad_()
quats = torch.tensor([1.0, 0, 0, 0]).repeat(2_000, 1).requires_grad_()
logits = torch.full((2_000,), 1.0).requires_grad_()
colors = torch.zeros(2_000, 3).requires_grad_()


# %%
def arrays():
    """What is optimised, activated: scales above 0, opacities and colours from 0 to 1."""
    return means, quats, log_scales.exp(), logits.sigmoid(), colors.sigmoid()


def psnr(views):
    with torch.no_grad():
        pictures, _, _ = sst.rasterize(*arrays(), **stack(views))
    pictures = pictures.clamp(0, 1).numpy()
    return np.mean([ss.psnr(view.image, picture) for view, picture in zip(views, pictures)]), pictures


# %% [markdown]
# Adam, two photographs a step.

# %%
scale = float(spacing.median())
optimizer = torch.optim.Adam(
    [
        {"params": [means], "lr": 0.05 * scale},
        {"params": [log_scales], "lr": 0.02},
        {"params": [quats], "lr": 0.01},
        {"params": [logits], "lr": 0.05},
        {"params": [colors], "lr": 0.05},
    ]
)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, arguments.steps, eta_min=0)
before, pictures_before = psnr(held_out)
begin = time.perf_counter()
for step in range(arguments.steps):
    chosen = torch.randperm(len(context))[:2]
    batch = dict(cameras, viewmats=cameras["viewmats"][chosen], Ks=cameras["Ks"][chosen])
    pictures, _, _ = sst.rasterize(*arrays(), **batch)
    loss = (pictures - photographs[chosen]).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()
    if step % 50 == 0 or step == arguments.steps - 1:
        print(f"step {step:4}: loss {loss.item():.4f}")
took = time.perf_counter() - begin

# %%
fitted, _ = psnr(context)
after, pictures_after = psnr(held_out)
print(f"{arguments.steps} steps in {took:.1f} s, {1e3 * took / arguments.steps:.1f} ms each")
print(f"context views {fitted:.2f} dB, held-out views {before:.2f} -> {after:.2f} dB")
assert after > before + 5 or arguments.steps < 100, "the fit did not get better"

# %% [markdown]
# The scene for any viewer, and a picture.

# %%
scene = ss.Scene(*(array.detach().numpy() for array in arrays()))
print(scene)


def write_png(path, image):
    """An 8-bit RGB PNG, without a library."""
    import struct
    import zlib

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows, columns, _ = image.shape
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), image.reshape(rows, -1)], axis=1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header))
        file.write(chunk(b"IDAT", zlib.compress(lines.tobytes(), 9)) + chunk(b"IEND", b""))


if arguments.picture:
    rows = [np.concatenate([held_out[at].image, pictures_before[at], pictures_after[at]], axis=1) for at in (1, 3)]
    write_png(arguments.picture, (np.concatenate(rows).clip(0, 1) * 255 + 0.5).astype(np.uint8))
