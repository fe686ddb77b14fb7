"""What a call from Python takes beside the same work in Rust.

Every call measures itself: `meta["seconds"]` and the gradients' `seconds` are the wall time of the Rust API alone, within the same
call. The overhead is everything else: arrays to stored Gaussians, the chain rule, pictures to arrays, the thread, Python.

    python overhead.py [--counts 40000,150000] [--runs 41] [--torch]
"""

import argparse
import time

import numpy as np
from scenes import courtyard

import sparsesplat as ss

parser = argparse.ArgumentParser()
parser.add_argument("--counts", default="40000,150000")
parser.add_argument("--runs", type=int, default=41)
parser.add_argument("--torch", action="store_true", help="the operation of PyTorch as well")
options = parser.parse_args()


def timed(call):
    begin = time.perf_counter()
    inside = call()
    return time.perf_counter() - begin, inside


def cases(scene, arrays, camera):
    v_colors = ((np.arange(camera["height"] * camera["width"] * 3) % 7 - 3) / 3).astype(np.float32)
    v_colors = v_colors.reshape(1, camera["height"], camera["width"], 3)

    def render():
        return scene.render(**camera, near_plane=0.01, device="cpu")[2]["seconds"]

    def forward():
        return ss.rasterize(**arrays, **camera, sh_degree=2, device="cpu")[2]["seconds"]

    def both():
        _, _, meta, tape = ss.record(**arrays, **camera, sh_degree=2, device="cpu")
        return meta["seconds"] + tape.backward(v_colors)["seconds"]

    yield "Scene.render", render
    yield "rasterize", forward
    yield "record + backward", both
    if options.torch:
        import torch

        import sparsesplat.torch as sst

        tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in arrays.items()}
        views = {name: torch.from_numpy(value) if hasattr(value, "shape") else value for name, value in camera.items()}
        weights = torch.from_numpy(v_colors)

        def operation():
            for tensor in tensors.values():
                tensor.grad = None
            colors, _, _ = sst.rasterize(**tensors, **views, sh_degree=2, device="cpu")
            colors.backward(weights)
            # What the backward pass took in Rust autograd keeps to itself: compared with the medians of `record + backward`.
            return None

        yield "torch, forward + backward", operation


for count in map(int, options.counts.split(",")):
    given = courtyard(count)
    calls = list(cases(*given))
    found = {name: [] for name, _ in calls}
    for run in range(options.runs + 3):
        # In turns, so that what else the machine does falls on all alike.
        for name, call in calls:
            took = timed(call)
            if run >= 3:
                found[name].append(took)
    reference = np.median([inside for _, inside in found["record + backward"]])
    for name, times in found.items():
        total = np.median([time for time, _ in times])
        line = f"{count:>7} {name:<26} {1e3 * total:7.2f} ms"
        if times[0][1] is None:
            line += f", {total / reference:.3f} times Rust's record + backward"
        else:
            inside = np.median([inside for _, inside in times])
            over = np.median([time / inside for time, inside in times]) - 1
            line += f", in Rust {1e3 * inside:7.2f} ms, overhead {100 * over:5.1f} %"
        print(line, flush=True)
