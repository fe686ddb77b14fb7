"""What a call from Python takes beside the same work in Rust.

The Rust API is timed within `Scene.render` and within `Scene.record` + `backward`, which give it stored Gaussians, as in the Rust
bench: `meta["seconds"]` and the gradients' `seconds` are its wall time alone. A call is compared with the one of them that draws the same
picture, with gradients or without, in the same turn. The overhead is everything else: activated arrays, the chain rule, pictures to
arrays, the thread, Python.

CPU is the processor time of a call beside that of its reference, all threads and Python together; it varies less than wall time on a
busy machine.

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
    begin, cpu = time.perf_counter(), time.process_time()
    inside = call()
    return time.perf_counter() - begin, inside, time.process_time() - cpu


def cases(scene, arrays, camera):
    v_colors = ((np.arange(camera["height"] * camera["width"] * 3) % 7 - 3) / 3).astype(np.float32)
    v_colors = v_colors.reshape(1, camera["height"], camera["width"], 3)

    def render():
        return scene.render(**camera, near_plane=0.01, device="cpu")[2]["seconds"]

    def forward():
        ss.rasterize(**arrays, **camera, sh_degree=2, device="cpu")

    def stored():
        _, _, meta, tape = scene.record(**camera, near_plane=0.01, device="cpu")
        return meta["seconds"] + tape.backward(v_colors)["seconds"]

    def both():
        _, _, _, tape = ss.record(**arrays, **camera, sh_degree=2, device="cpu")
        tape.backward(v_colors)

    # Name, call, and the call within which the Rust API is timed.
    yield "Scene.render", render, "Scene.render"
    yield "rasterize", forward, "Scene.render"
    yield "Scene.record + backward", stored, "Scene.record + backward"
    yield "record + backward", both, "Scene.record + backward"
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

        yield "torch, forward + backward", operation, "Scene.record + backward"


for count in map(int, options.counts.split(",")):
    given = courtyard(count)
    calls = list(cases(*given))
    found = {name: [] for name, _, _ in calls}
    for run in range(options.runs + 3):
        # In turns, so that what else the machine does falls on all alike.
        for name, call, _ in calls:
            took = timed(call)
            if run >= 3:
                found[name].append(took)
    # None becomes NaN.
    found = {name: np.array(times, float) for name, times in found.items()}
    for name, _, reference in calls:
        total, _, cpu = found[name].T
        _, inside, cpu_of_reference = found[reference].T
        over = np.percentile(total / inside, [25, 50, 75]) - 1
        print(
            f"{count:>7} {name:<26} {1e3 * np.median(total):7.2f} ms, in Rust {1e3 * np.median(inside):7.2f} ms, "
            f"overhead {100 * over[1]:5.1f} % (quartiles {100 * over[0]:.1f}, {100 * over[2]:.1f}), "
            f"CPU {np.median(cpu / cpu_of_reference):.3f} times {reference}'s",
            flush=True,
        )
