"""Beside gsplat's CUDA renderer on one NVIDIA GPU: the same scene, forward and backward, in turns.

Our renderer runs on the same GPU through Vulkan. It takes numpy arrays and gives numpy arrays, so gsplat is timed twice: with the
copies of the same arrays to the GPU and back, and with tensors that stay there, as in training on CUDA. The copies in Python take
pageable memory on both sides.

    pip install gsplat && python gsplat_cuda.py [--counts 10000,40000,150000] [--runs 21] [--size 448x256]
"""

import argparse
import json
import time

import numpy as np
import torch
from gsplat import rasterization
from scenes import courtyard

import sparsesplat as ss

parser = argparse.ArgumentParser()
parser.add_argument("--counts", default="10000,40000,150000")
parser.add_argument("--runs", type=int, default=21)
parser.add_argument("--size", default="448x256")
parser.add_argument("--json")
options = parser.parse_args()
width, height = map(int, options.size.split("x"))
NAMES = ("means", "quats", "scales", "opacities", "colors")
rows = []


def timed(work):
    torch.cuda.synchronize()
    begin = time.perf_counter()
    result = work()
    torch.cuda.synchronize()
    return 1e3 * (time.perf_counter() - begin), result


for count in map(int, options.counts.split(",")):
    _, arrays, camera = courtyard(count, width, height)
    arrays = {name: np.ascontiguousarray(arrays[name]) for name in NAMES}
    weights = np.random.default_rng(1).normal(size=(1, height, width, 3)).astype(np.float32)
    here = {name: torch.from_numpy(array).cuda().requires_grad_() for name, array in arrays.items()}
    view = {name: torch.from_numpy(camera[name]).cuda() for name in ("viewmats", "Ks")}
    weights_here = torch.from_numpy(weights).cuda()
    settings = dict(width=width, height=height, sh_degree=2, packed=False)

    def ours():
        return ss.rasterize(**arrays, **camera, sh_degree=2, device="gpu")[0]

    def ours_with_gradients():
        _, _, _, tape = ss.record(**arrays, **camera, sh_degree=2, device="gpu")
        gradients = tape.backward(weights)
        return [gradients[name] for name in NAMES]

    def copied():
        with torch.no_grad():
            tensors = {name: torch.from_numpy(array).cuda() for name, array in arrays.items()}
            return rasterization(**tensors, **view, **settings)[0].cpu()

    def copied_with_gradients():
        tensors = {name: torch.from_numpy(array).cuda().requires_grad_() for name, array in arrays.items()}
        picture = rasterization(**tensors, **view, **settings)[0]
        picture.backward(torch.from_numpy(weights).cuda())
        return [tensors[name].grad.cpu() for name in NAMES]

    def resident():
        with torch.no_grad():
            return rasterization(**here, **view, **settings)[0]

    def resident_with_gradients():
        for tensor in here.values():
            tensor.grad = None
        rasterization(**here, **view, **settings)[0].backward(weights_here)

    cases = [ours, copied, resident, ours_with_gradients, copied_with_gradients, resident_with_gradients]
    found = {case.__name__: [] for case in cases}
    results = {}
    for turn in range(options.runs + 3):
        for case in cases:
            milliseconds, results[case.__name__] = timed(case)
            if turn >= 3:
                found[case.__name__].append(milliseconds)
    difference = np.abs(np.asarray(results["ours"]) - results["copied"].numpy())
    mse = float(np.mean(np.square(difference, dtype=np.float64)))
    gradients = {
        name: float(np.abs(np.asarray(mine).reshape(-1) - theirs.numpy().reshape(-1)).max() / np.abs(theirs.numpy()).max())
        for name, mine, theirs in zip(NAMES, results["ours_with_gradients"], results["copied_with_gradients"])
    }
    row = dict(gaussians=count, width=width, height=height, gpu=torch.cuda.get_device_name(), psnr_between=-10 * np.log10(max(mse, 1e-30)))
    row.update(largest_difference=float(difference.max()), gradients_relative_to_largest=gradients)
    row["milliseconds"] = {name: [float(np.median(times)), min(times), max(times)] for name, times in found.items()}
    rows.append(row)
    print(json.dumps(row, indent=1), flush=True)
if options.json:
    with open(options.json, "w") as file:
        json.dump(rows, file, indent=1)
