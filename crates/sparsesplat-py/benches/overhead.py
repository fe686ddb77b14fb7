"""What a call from Python takes beside the same work in Rust.

The Rust API is timed within `Scene.render` and within `Scene.record` + `backward`, which give it stored Gaussians, as in the Rust
bench: `meta["seconds"]` and the gradients' `seconds` are its wall time alone. A call is compared with the one of them that draws the same
picture, with gradients or without, in the same turn. The overhead is everything else: activated arrays, the chain rule, pictures to
arrays, the thread, Python.

With `--bench` the Rust bench itself is run before each round, in its own process, on the same scene and view. What it counts includes
waking the threads of the renderer, as in any program that calls it.

CPU is the processor time of a call beside that of its reference, all threads and Python together; it varies less than wall time on a
busy machine.

    python overhead.py [--counts 40000,150000] [--runs 41] [--torch] [--bench target/release/sparsesplat --rounds 5]
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from scenes import courtyard

import sparsesplat as ss

parser = argparse.ArgumentParser()
parser.add_argument("--counts", default="40000,150000")
parser.add_argument("--runs", type=int, default=41)
parser.add_argument("--torch", action="store_true", help="the operation of PyTorch as well")
parser.add_argument("--bench", help="the program sparsesplat, whose `bench raster` is run before each round")
parser.add_argument("--rounds", type=int, default=1, help="how often everything is measured")
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


def rust_bench(count):
    """Seconds of the Rust bench on all cores, by what Python's calls are compared with."""
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder, "raster.json")
        command = [options.bench, "bench", "raster", "--device", "cpu", "--counts", str(count), "--runs", str(options.runs)]
        subprocess.run([*command, "--json", written], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rows = json.loads(written.read_text())["rows"]
    seconds = {(row["case"], row["threads"]): row["seconds"] for row in rows}
    threads = max(threads for _, threads in seconds)
    return {"Scene.render": seconds["forward", threads], "Scene.record + backward": seconds["forward+backward", threads]}


def measure(count):
    """Times of every call in turns: by name, and what it is compared with, an array of rows (total, within Rust, processor time)."""
    calls = list(cases(*courtyard(count)))
    found = {name: [] for name, _, _ in calls}
    for run in range(options.runs + 3):
        # In turns, so that what else the machine does falls on all alike.
        for name, call, _ in calls:
            took = timed(call)
            if run >= 3:
                found[name].append(took)
    # None becomes NaN.
    return {(name, reference): np.array(found[name], float) for name, _, reference in calls}


for count in map(int, options.counts.split(",")):
    over_bench = {}
    for _ in range(options.rounds):
        bench = rust_bench(count) if options.bench else {}
        found = measure(count)
        references = {name: times for (name, _), times in found.items()}
        for (name, reference), times in found.items():
            total, _, cpu = times.T
            _, inside, cpu_of_reference = references[reference].T
            over = np.percentile(total / inside, [25, 50, 75]) - 1
            print(
                f"{count:>7} {name:<26} {1e3 * np.median(total):7.2f} ms, in Rust {1e3 * np.median(inside):7.2f} ms, "
                f"overhead {100 * over[1]:5.1f} % (quartiles {100 * over[0]:.1f}, {100 * over[2]:.1f}), "
                f"CPU {np.median(cpu / cpu_of_reference):.3f} times {reference}'s",
                flush=True,
            )
            if bench:
                over_bench.setdefault(name, []).append(np.median(total) / bench[reference] - 1)
    for name, over in over_bench.items():
        print(f"{count:>7} {name:<26} over the Rust bench {100 * np.median(over):5.1f} % ({100 * min(over):.1f} to {100 * max(over):.1f})", flush=True)
