"""3D Gaussian splatting without CUDA: a renderer with gradients, and posed photographs to a compact scene in one pass.

`sparsesplat.torch` has the renderer as an operation of PyTorch; it is imported by name, and only it needs torch.
"""

from ._gaussians import Gaussians
from ._native import (
    Scene,
    Tape,
    View,
    device,
    entropy,
    knn,
    load_ply,
    psnr,
    rasterize,
    reconstruct,
    record,
    simulated_views,
    ssim,
)

__all__ = [
    "Gaussians",
    "Scene",
    "Tape",
    "View",
    "device",
    "entropy",
    "knn",
    "load_ply",
    "psnr",
    "rasterize",
    "reconstruct",
    "record",
    "simulated_views",
    "ssim",
]
