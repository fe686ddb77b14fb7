"""Wrong and hard input: exceptions that name the argument, and defined results."""

import gc
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from conftest import cameras, scene

import sparsesplat as ss


def rasterize(**changes):
    arguments = {**scene(5), **cameras(2), "device": "cpu", **changes}
    return ss.rasterize(**arguments)


def spoiled(name, place, value):
    array = scene(5)[name]
    array[place] = value
    return {name: array}


@pytest.mark.parametrize(
    "changes, kind, message",
    [
        ({"means": [[0, 0, 1]]}, TypeError, "means: expected a numpy array of float32, found list"),
        ({"means": np.zeros((5, 3))}, TypeError, "means: expected dtype float32, found float64"),
        ({"means": np.zeros((5, 3), ">f4")}, TypeError, "means: expected dtype float32, found >f4"),
        ({"colors": np.zeros((5, 3), np.uint8)}, TypeError, "colors: expected dtype float32, found uint8"),
        ({"means": np.zeros((5, 4), np.float32)}, ValueError, r"means: expected shape \[N, 3\], found \[5, 4\]"),
        ({"means": np.zeros(3, np.float32)}, ValueError, r"means: expected shape \[N, 3\], found \[3\]"),
        ({"quats": np.zeros((4, 4), np.float32)}, ValueError, r"quats: expected shape \[5, 4\], found \[4, 4\]"),
        ({"opacities": np.zeros((5, 1), np.float32)}, ValueError, r"opacities: expected shape \[5\], found \[5, 1\]"),
        ({"colors": np.zeros((5, 4), np.float32)}, ValueError, r"colors: expected shape \[5, 3\], found \[5, 4\]"),
        ({"means": np.zeros((3, 5), np.float32).T}, ValueError, "means: not C-contiguous"),
        ({"means": np.zeros((10, 3), np.float32)[::2]}, ValueError, "means: not C-contiguous"),
        (spoiled("means", (2, 1), np.nan), ValueError, "means: Gaussian 2 holds NaN"),
        (spoiled("quats", (3, 0), np.inf), ValueError, "quats: Gaussian 3 holds inf"),
        (spoiled("quats", 1, 0), ValueError, "quats: Gaussian 1 has a quaternion of norm 0"),
        (spoiled("scales", (4, 2), 0), ValueError, "scales: Gaussian 4 has 0, .*not their logarithms"),
        (spoiled("scales", (4, 2), -2), ValueError, "scales: Gaussian 4 has -2"),
        (spoiled("opacities", 0, 2), ValueError, "opacities: Gaussian 0 has 2, expected 0 to 1: opacities are no logits"),
        (spoiled("colors", (0, 1), -np.inf), ValueError, "colors: Gaussian 0 holds -inf"),
        ({"viewmats": np.eye(4, dtype=np.float32)}, ValueError, r"viewmats: expected shape \[C, 4, 4\], found \[4, 4\]"),
        ({"viewmats": np.zeros((2, 4, 4), np.float32)}, ValueError, "camera 0: the last row of the world-to-camera"),
        ({"viewmats": np.tile(np.diag(np.float32([2, 2, 2, 1])), (2, 1, 1))}, ValueError, "camera 0: rotation is not orth"),
        ({"viewmats": np.tile(np.diag(np.float32([1, 1, -1, 1])), (2, 1, 1))}, ValueError, "camera 0: rotation mirrors"),
        ({"viewmats": np.full((2, 4, 4), np.nan)}, ValueError, "camera 0: "),
        ({"Ks": np.tile(np.eye(3, dtype=np.float32), (3, 1, 1))}, ValueError, r"Ks: expected shape \[2, 3, 3\]"),
        ({"Ks": np.tile(np.float32([[9, 1, 9], [0, 9, 9], [0, 0, 1]]), (2, 1, 1))}, ValueError, "without skew"),
        ({"Ks": np.tile(np.diag(np.float32([-9, 9, 1])), (2, 1, 1))}, ValueError, "camera 0: focal length fx is -9"),
        ({"width": 0}, ValueError, "camera 0: size is 0x30, expected at least one pixel"),
        ({"width": -1}, OverflowError, "negative"),
        ({"width": 2**40, "height": 2**40}, ValueError, "camera 0: size is"),
        ({"near_plane": np.nan}, ValueError, "render setting near is NaN"),
        ({"near_plane": "far"}, TypeError, "near_plane is 'far', expected a number"),
        ({"far_plane": 0.0}, ValueError, "render setting far is 0"),
        ({"eps2d": 0.0}, ValueError, "render setting eps2d is 0"),
        ({"alpha_max": 1.0}, ValueError, "render setting alpha_max is 1"),
        ({"render_mode": "rgb"}, ValueError, "render_mode is \"rgb\", expected \"RGB\""),
        ({"render_mode": 3}, TypeError, "render_mode is 3, expected a string"),
        ({"rasterize_mode": "fast"}, ValueError, "rasterize_mode is \"fast\""),
        ({"device": "cuda"}, ValueError, "device is \"cuda\", expected \"auto\", \"gpu\" or \"cpu\""),
        ({"backgrounds": np.zeros((3, 3), np.float32)}, ValueError, r"backgrounds: expected shape \[2, 3\], found \[3, 3\]"),
        ({"backgrounds": np.full(3, np.nan, np.float32)}, ValueError, "render setting background is NaN"),
        ({"sh_degree": 0}, ValueError, r"colors: expected shape \[5, K, 3\], found \[5, 3\]"),
        ({"sh_degree": 1, "colors": np.zeros((5, 1, 3), np.float32)}, ValueError, "sh_degree 1 needs 4"),
        ({"sh_degree": 4, "colors": np.zeros((5, 25, 3), np.float32)}, ValueError, "SH degree is 4, expected 0 to 3"),
        ({"sh_degree": -1, "colors": np.zeros((5, 25, 3), np.float32)}, ValueError, "sh_degree is -1"),
        ({"packed": True}, TypeError, r"rasterize\(\) got an unexpected keyword argument 'packed'"),
    ],
)
def test_wrong_arguments_are_named(changes, kind, message):
    with pytest.raises(kind, match=message):
        rasterize(**changes)


def test_wrong_gradients_are_named():
    colors, alphas, _, tape = ss.record(**scene(5), **cameras(1), device="cpu")
    with pytest.raises(ValueError, match=r"v_colors: expected shape \[1, 30, 40, 3\], found \[30, 40, 3\]"):
        tape.backward(colors[0])
    with pytest.raises(TypeError, match="v_alphas: expected dtype float32"):
        tape.backward(colors, alphas.astype(np.float64))
    with pytest.raises(ValueError, match="the pixel gradient by image number 7 is not finite"):
        bad = np.zeros_like(colors)
        bad.ravel()[7] = np.nan
        tape.backward(bad)
    with pytest.raises(TypeError):
        ss.Tape()


def test_nothing_is_a_defined_result():
    empty = scene(0)
    colors, alphas, meta, tape = ss.record(**empty, **cameras(2), device="cpu", backgrounds=np.float32([0.1, 0.2, 0.3]))
    assert (colors == np.float32([0.1, 0.2, 0.3])).all() and (alphas == 0).all() and meta["visible"] == [0, 0]
    found = tape.backward(np.ones_like(colors))
    assert found["means"].shape == (0, 3) and found["colors"].shape == (0, 3)
    np.testing.assert_allclose(found["backgrounds"], 2 * 30 * 40)

    none = dict(cameras(1), viewmats=np.zeros((0, 4, 4), np.float32), Ks=np.zeros((0, 3, 3), np.float32))
    colors, alphas, meta, tape = ss.record(**scene(5), **none, device="cpu")
    assert colors.shape == (0, 30, 40, 3) and alphas.shape == (0, 30, 40, 1) and meta["n_cameras"] == 0
    assert (tape.backward(colors)["means"] == 0).all()

    one = {name: array[:1] for name, array in scene(5).items()}
    assert ss.rasterize(**one, **cameras(1), device="cpu")[0].max() > 0


def test_huge_and_tiny_numbers_end_well():
    for name, value in [("means", 3e38), ("scales", 3e38), ("scales", 1e-45), ("quats", 1e-30), ("colors", 1e30), ("opacities", 1e-45)]:
        arrays = scene(5)
        arrays[name][:] = value
        colors, alphas, _, tape = ss.record(**arrays, **cameras(1), device="cpu")
        assert not np.isnan(colors).any() and not np.isnan(alphas).any(), name
        found = tape.backward(np.ones_like(colors))
        assert not np.isnan(found["means"]).any(), name


def test_views_and_scenes():
    good = {"image": np.zeros((20, 30, 3), np.uint8), "viewmat": np.eye(4), "K": np.float32([[9, 0, 15], [0, 9, 10], [0, 0, 1]])}
    view = ss.View(**good, name="a", depth=np.float32(np.full((20, 30), np.nan)))
    assert (view.width, view.height, view.name) == (30, 20, "a") and view.depth.max() == 0
    for change, kind, message in [
        ({"image": np.zeros((20, 30), np.uint8)}, ValueError, r"image: expected shape \[height, width, 3\]"),
        ({"image": np.full((20, 30, 3), 7, np.float32)}, ValueError, "image: holds 7, expected float32 from 0 to 1, or uint8"),
        ({"image": np.full((20, 30, 3), np.nan, np.float32)}, ValueError, "image: holds NaN"),
        ({"image": np.zeros((0, 30, 3), np.uint8)}, ValueError, "size is 30x0"),
        ({"image": np.zeros((20, 30, 3), np.int32)}, TypeError, "image: expected dtype float32, found int32"),
        ({"depth": np.zeros((2, 2), np.float32)}, ValueError, r"depth: expected shape \[20, 30\]"),
        ({"K": np.eye(4)}, ValueError, r"K: expected shape \[3, 3\]"),
    ]:
        with pytest.raises(kind, match=message):
            ss.View(**{**good, **change})
    for source, kind, message in [
        ([], ValueError, "at least"),
        ([view], ValueError, "view"),
        (3, TypeError, "source: expected the path of a data set, or a sequence of sparsesplat.View"),
        (["x"], TypeError, "source: expected"),
        ("no/such/folder", FileNotFoundError, "no/such/folder"),
    ]:
        with pytest.raises(kind, match=message):
            ss.reconstruct(source)
    for change, message in [
        ({"gaussians": 0}, "budget is 0 Gaussians"),
        ({"allocation": "most"}, "allocation: unknown variant `most`, expected one of `entropy`"),
        ({"head": "mlp"}, "head: unknown variant `mlp`"),
        ({"backbone": "depthsplat"}, "DepthSplat's network is not part of this package"),
        ({"depth_range": "far"}, "depth_range is 'far'"),
        ({"depth_range": (2, 1)}, "range"),
        ({"size": (10, 10)}, "for data sets on disk"),
        ({"format": "zip"}, "format \"zip\" is not known"),
        ({"tau": -1.0}, "tau"),
    ]:
        with pytest.raises(ValueError, match=message):
            ss.reconstruct(ss.simulated_views(24, 16)[0], **change)


def test_files(tmp_path):
    with pytest.raises(FileNotFoundError, match="gone.ply: cannot read"):
        ss.load_ply(tmp_path / "gone.ply")
    (tmp_path / "bad.ply").write_bytes(b"plx\n")
    with pytest.raises(ValueError, match="bad.ply: not a PLY file"):
        ss.load_ply(str(tmp_path / "bad.ply"))
    scene_ = ss.Scene(**scene(5))
    with pytest.raises(ValueError, match="scene.obj"):
        scene_.save(tmp_path / "scene.obj")
    with pytest.raises(OSError, match="bad.ply"):
        scene_.save(tmp_path / "bad.ply" / "scene.ply")
    assert scene_.save(tmp_path / "scene.ply") == []
    for name in ("scene.spz", "scene.splat", "scene.glb", "scene.compressed.ply"):
        lost = scene_.save(tmp_path / name)
        found = ss.load_ply(tmp_path / name)
        assert lost and len(found) == 5, (name, lost)
    (tmp_path / "cut.spz").write_bytes((tmp_path / "scene.spz").read_bytes()[:-20])
    with pytest.raises((ValueError, OSError), match="cut.spz"):
        ss.load_ply(tmp_path / "cut.spz")
    again = ss.load_ply(tmp_path / "scene.ply")
    assert (again.geometry == scene_.geometry).all() and (again.sh == scene_.sh).all()
    stored = ss.Scene.from_stored(again.geometry, again.sh)
    assert (stored.geometry == again.geometry).all() and repr(stored) == "Scene(5 Gaussians, SH degree 0)"
    with pytest.raises(ValueError, match="expected 1, 4, 9 or 16"):
        ss.Scene.from_stored(again.geometry, np.zeros((5, 2, 3), np.float32))
    for found, given in zip(again.gaussians[:4], scene(5).values()):
        np.testing.assert_allclose(found, given, rtol=1e-6)


def test_metrics():
    grey = np.zeros((20, 30), np.uint8)
    assert (ss.entropy(grey) == 0).all() and ss.entropy(grey, border="clip").shape == (20, 30)
    same = np.zeros((20, 30, 3), np.float32)
    assert ss.psnr(same, same) == float("inf") and ss.ssim(same, same) == 1
    assert ss.psnr(same, np.full((20, 30, 3), 0.1, np.float32)) == pytest.approx(20, abs=1e-5)
    assert ss.psnr(same, np.full((20, 30, 3), 255, np.uint8)) == 0
    indices, squares = ss.knn(np.float32([[0, 0, 0], [1, 0, 0], [3, 0, 0]]), 5)
    assert indices.tolist() == [[1, 2], [0, 2], [1, 0]] and squares.tolist() == [[1, 9], [1, 4], [4, 9]]
    indices, _ = ss.knn(np.float32([[0, 0, 0], [1, 0, 0]]), 1, queries=np.float32([[2, 0, 0]]))
    assert indices.tolist() == [[1]]
    assert ss.knn(np.zeros((0, 3), np.float32), 3)[0].shape == (0, 0)
    for call, message in [
        (lambda: ss.entropy(grey, window=4), "window"),
        (lambda: ss.entropy(grey, border="wrap"), "border is \"wrap\""),
        (lambda: ss.entropy(np.zeros((0, 0), np.uint8)), "size|empty|pixel"),
        (lambda: ss.psnr(same, same[:10].copy()), "size"),
        (lambda: ss.psnr(same, np.full_like(same, np.nan)), "finite|NaN"),
        (lambda: ss.ssim(same[:5].copy(), same[:5].copy()), "11"),
        (lambda: ss.knn(np.full((3, 3), np.nan, np.float32), 1), "point"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()


def test_the_gpu_is_an_error_or_works():
    name, fallback = ss.device("auto")
    assert (name == "cpu") == (fallback is not None)
    assert ss.device("cpu") == ("cpu", None)
    try:
        name, _ = ss.device("gpu")
    except RuntimeError as error:
        assert "no GPU to render on" in str(error)
        with pytest.raises(RuntimeError, match="no GPU to render on"):
            rasterize(device="gpu")
    else:
        on_cpu, on_gpu = rasterize(device="cpu"), rasterize(device="gpu")
        assert on_gpu[2]["device"] == name
        np.testing.assert_allclose(on_cpu[0], on_gpu[0], atol=2e-3)


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="resident memory is read from /proc")
def test_no_leak_over_10_000_calls():
    arrays, views = scene(50, sh_degree=1), cameras(2)

    def call():
        colors, alphas, _, tape = ss.record(**arrays, **views, sh_degree=1, device="cpu", render_mode="RGB+ED")
        tape.backward(np.ones_like(colors), np.ones_like(alphas))
        with pytest.raises(ValueError):
            ss.rasterize(**{**arrays, "opacities": arrays["opacities"] + 1}, **views, sh_degree=1)

    for _ in range(1000):
        call()
    gc.collect()
    before = resident()
    for _ in range(10_000):
        call()
    gc.collect()
    grown = resident() - before
    print(f"\n10,000 calls: resident memory {before / 2**20:.1f} MiB, grown by {grown / 2**20:.2f} MiB")
    # Pictures alone are 47 KiB a call: a leak of them would be 460 MiB.
    assert grown < 4 * 2**20


def test_other_threads_run_meanwhile():
    arrays, views = scene(20_000), cameras(40, 320, 240)
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    begin = time.perf_counter()
    ss.rasterize(**arrays, **views, device="cpu")
    took = time.perf_counter() - begin
    done.set()
    thread.join()
    gaps = np.diff([begin, *[tick for tick in ticks if begin < tick < begin + took], begin + took])
    assert took > 0.1 and gaps.max() < 0.5 * took, (took, gaps.max())


def test_several_threads_render_the_same():
    arrays, views = scene(500), cameras(2)
    expected = ss.rasterize(**arrays, **views, device="cpu")[0]
    found = [None] * 8

    def work(at):
        for _ in range(20):
            colors, _, _, tape = ss.record(**arrays, **views, device="cpu")
            tape.backward(colors)
        found[at] = colors

    threads = [threading.Thread(target=work, args=(at,)) for at in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(600)
        assert not thread.is_alive()
    assert all((colors == expected).all() for colors in found)


CTRL_C = """
import signal, threading, time
import numpy as np
import sparsesplat as ss

def interrupt(after):
    threading.Timer(after, lambda: signal.raise_signal(signal.SIGINT)).start()

views = ss.simulated_views(320, 240)[0]
arrays = ss.reconstruct(views, 2_000, head="closed-form").gaussians
many = [np.repeat(np.stack([getattr(view, name) for view in views]), 500, axis=0) for name in ("viewmat", "K")]
for call in (
    lambda: ss.reconstruct(views, 2_000, refine=5000),
    lambda: ss.reconstruct(views, 2_000, depth_planes=1024),
    lambda: ss.rasterize(*arrays, *many, 320, 240, sh_degree=0),
):
    interrupt(0.4)
    begin = time.perf_counter()
    try:
        call()
    except KeyboardInterrupt:
        took = time.perf_counter() - begin
        assert 0.3 < took < 2, took
    else:
        raise AssertionError("not interrupted")
# Afterwards it works as ever.
assert len(ss.reconstruct(ss.simulated_views(48, 32)[0], 100)) == 100
"""


def test_ctrl_c():
    done = subprocess.run([sys.executable, "-c", CTRL_C], capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr


def test_a_callback_that_raises_ends_the_call():
    views = ss.simulated_views(48, 32)[0]

    def progress(stage, share):
        assert 0 <= share <= 1
        if stage == "sampling":
            raise LookupError(stage)

    with pytest.raises(LookupError, match="sampling"):
        ss.reconstruct(views, 100, progress=progress)
    stages = []
    scene = ss.reconstruct(views, 100, refine=3, progress=lambda stage, share: stages.append((stage, share)))
    assert scene.report["refine_steps"] == 3 and "refined-grid" in scene.report["corrector"]
    assert ss.reconstruct(views, 100, refine=3, corrector="off").report["corrector"] is None
    assert "refined-grid" in ss.reconstruct(views, 100).report["corrector"]
    assert ss.reconstruct(views, 100, corrector="off").report["corrector"] is None
    assert stages[0] == ("backbone", 0) and [share for stage, share in stages if stage == "refine"] == [0, 1 / 3, 2 / 3]


FORK = """
import os
import numpy as np
from conftest import cameras, scene
import sparsesplat as ss

arrays, views = scene(50), cameras(1)
expected, _, _, tape = ss.record(**arrays, **views, device="cpu")
child = os.fork()
if child == 0:
    found = ss.rasterize(**arrays, **views, device="cpu")[0]
    try:
        tape.backward(found)
    except RuntimeError as error:
        os._exit(0 if (found == expected).all() and "after the fork" in str(error) else 1)
    os._exit(2)
assert os.waitpid(child, 0)[1] == 0
tape.backward(expected)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_child_renders():
    here = os.path.dirname(__file__)
    done = subprocess.run([sys.executable, "-c", FORK], cwd=here, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
