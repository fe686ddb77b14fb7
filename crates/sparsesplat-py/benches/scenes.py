"""The scene of the benchmarks: the simulated courtyard, reconstructed in closed form with a count, SH degree 2."""

import numpy as np

import sparsesplat as ss


def courtyard(count, width=448, height=256):
    """Arrays of `count` Gaussians, and a held-out view, as keyword arguments; the scene as it is stored."""
    context, held_out = ss.simulated_views(width, height)
    scene = ss.reconstruct(context, count, head="closed-form", looks=1)
    # The head gives degree 0: the coefficients above it are filled with small numbers, so that every one is evaluated.
    sh = np.random.default_rng(0).uniform(-0.025, 0.025, (len(scene), 9, 3)).astype(np.float32)
    sh[:, :1] = scene.sh[:, :1]
    scene = ss.Scene.from_stored(scene.geometry, sh)
    means, quats, scales, opacities, colors = scene.gaussians
    view = held_out[len(held_out) // 2]
    camera = dict(viewmats=view.viewmat[None].astype(np.float32), Ks=view.K[None].astype(np.float32), width=width, height=height)
    arrays = dict(means=means, quats=quats, scales=scales, opacities=opacities, colors=colors)
    return scene, arrays, camera
