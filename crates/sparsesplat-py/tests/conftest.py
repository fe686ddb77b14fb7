"""What the tests share."""

import json
import os
from pathlib import Path

import numpy as np
import pytest


class RustValues:
    """What the example `rust_values` wrote."""

    def __init__(self, folder):
        self.folder = Path(folder)
        with open(self.folder / "values.json") as file:
            self.facts = json.load(file)

    def __call__(self, name, *shape):
        return np.fromfile(self.folder / f"{name}.f32", dtype="<f4").reshape(shape)


@pytest.fixture(scope="session")
def rust():
    folder = os.environ.get("SPARSESPLAT_RUST_VALUES")
    if folder is None:
        pytest.fail("SPARSESPLAT_RUST_VALUES names no folder: run the tests by `cargo xtask python-test`")
    return RustValues(folder)


def scene(n=20, seed=0, sh_degree=None):
    """A small scene in front of the cameras of `cameras`."""
    random = np.random.default_rng(seed)
    means = random.uniform(-1, 1, (n, 3)) * [1.0, 0.7, 0.6] + [0, 0, 4]
    arrays = {
        "means": means,
        "quats": random.normal(size=(n, 4)),
        "scales": random.uniform(0.15, 0.5, (n, 3)),
        "opacities": random.uniform(0.2, 0.9, n),
    }
    if sh_degree is None:
        arrays["colors"] = random.uniform(0.1, 0.9, (n, 3))
    else:
        arrays["colors"] = random.normal(size=(n, (sh_degree + 1) ** 2, 3)) * 0.2 + 0.2
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def cameras(count=2, width=40, height=30, dtype=np.float32):
    """Cameras side by side that look along z."""
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    for at in range(count):
        angle = 0.1 * at
        viewmats[at, :3, :3] = [
            [np.cos(angle), 0, np.sin(angle)],
            [0, 1, 0],
            [-np.sin(angle), 0, np.cos(angle)],
        ]
        viewmats[at, 0, 3] = 0.2 * at
    Ks = np.tile(np.array([[50.0, 0, width / 2], [0, 45.0, height / 2], [0, 0, 1]]), (count, 1, 1))
    return {"viewmats": viewmats.astype(dtype), "Ks": Ks.astype(dtype), "width": width, "height": height}
