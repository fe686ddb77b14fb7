"""Gradients against central differences."""

import numpy as np
import pytest
from conftest import cameras, scene

import sparsesplat as ss

MODES = ["RGB", "D", "ED", "RGB+D", "RGB+ED"]


def weights(shape, seed):
    # Large-scale weights: the sums of differences stand out from the rounding of single pixels.
    return np.random.default_rng(seed).uniform(0.2, 1.0, shape).astype(np.float32)


def check(arrays, views, settings, names, step=2e-3, tolerance=2e-2):
    """Every gradient against central differences of a weighted sum of the pictures, relative to the largest of its array."""
    settings = dict(settings, device="cpu")
    colors, alphas, _, tape = ss.record(**arrays, **views, **settings)
    v_colors, v_alphas = weights(colors.shape, 1), weights(alphas.shape, 2)
    if "ED" in settings["render_mode"]:
        # At the rim of a footprint expected depth leaps from 0 to that of the Gaussian.
        v_colors[..., -1] *= alphas[..., 0] > 0.01
    found = tape.backward(v_colors, v_alphas)

    def loss(arrays, views, settings):
        colors, alphas, _ = ss.rasterize(**arrays, **views, **settings)
        return (colors.astype(np.float64) * v_colors).sum() + (alphas.astype(np.float64) * v_alphas).sum()

    random = np.random.default_rng(3)
    for name in names:
        home = arrays if name in arrays else views if name in views else settings
        places = [index for index in np.ndindex(home[name].shape) if name != "viewmats" or index[1] < 3]
        chosen = random.choice(len(places), min(len(places), 24), replace=False)
        scale = max(np.abs(found[name]).max(), 1e-3)
        for place in (places[at] for at in chosen):
            sides = []
            for sign in (1, -1):
                moved = home[name].copy()
                # Rotations may be off by 1e-4.
                moved[place] += sign * (2e-5 if name == "viewmats" and place[2] < 3 else step)
                trial = [dict(part, **{name: moved}) if part is home else part for part in (arrays, views, settings)]
                sides.append((loss(*trial), moved[place]))
            difference = (sides[0][0] - sides[1][0]) / (sides[0][1] - sides[1][1])
            assert abs(found[name][place] - difference) < tolerance * scale, (name, place, found[name][place], difference)


# Thresholds cut tails off: steps of the picture that a difference sees and a gradient does not. They are set low here.
SMOOTH = dict(alpha_min=1e-6, transmittance_min=1e-12, alpha_max=0.9999)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sh_degree", [None, 2])
def test_by_arrays(mode, sh_degree):
    settings = dict(SMOOTH, render_mode=mode, sh_degree=sh_degree, backgrounds=np.array([0.2, 0.5, 0.1], np.float32))
    names = ["means", "quats", "scales", "opacities"]
    if "RGB" in mode:
        names += ["colors", "backgrounds"]
    check(scene(12, sh_degree=sh_degree), cameras(2), settings, names)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_by_poses_and_backgrounds_of_each_camera(mode):
    settings = dict(SMOOTH, render_mode="RGB", rasterize_mode=mode, backgrounds=np.array([[0.2, 0.5, 0.1], [0.9, 0.0, 0.3]], np.float32))
    check(scene(12, sh_degree=1), cameras(2, dtype=np.float64), dict(settings, sh_degree=1), ["viewmats", "backgrounds", "means"])


def test_a_batch_is_the_sum_of_its_cameras():
    arrays, views = scene(30), cameras(3)
    colors, alphas, _, tape = ss.record(**arrays, **views, device="cpu")
    v_colors, v_alphas = weights(colors.shape, 1), weights(alphas.shape, 2)
    together = tape.backward(v_colors, v_alphas)
    total = {name: 0 for name in arrays}
    for at in range(3):
        one = dict(views, viewmats=views["viewmats"][at : at + 1], Ks=views["Ks"][at : at + 1])
        single, _, _, tape = ss.record(**arrays, **one, device="cpu")
        assert (single[0] == colors[at]).all()
        found = tape.backward(v_colors[at : at + 1], v_alphas[at : at + 1])
        np.testing.assert_array_equal(found["viewmats"][0], together["viewmats"][at])
        for name in arrays:
            total[name] = total[name] + found[name]
    for name in arrays:
        np.testing.assert_allclose(together[name], total[name], rtol=1e-4, atol=1e-6 * np.abs(total[name]).max())


def test_unused_coefficients_have_no_gradient():
    arrays, views = scene(10, sh_degree=3), cameras(1)
    colors, _, _, tape = ss.record(**arrays, **views, sh_degree=1, device="cpu")
    found = tape.backward(np.ones_like(colors))
    assert found["colors"].shape == (10, 16, 3)
    assert (found["colors"][:, 4:] == 0).all() and (found["colors"][:, :4] != 0).any()
    arrays["colors"][:, 4:] = 99
    again, _, _ = ss.rasterize(**arrays, **views, sh_degree=1, device="cpu")
    assert (again == colors).all()


def test_opacities_of_0_and_1():
    arrays, views = scene(6), cameras(1)
    arrays["opacities"][:] = [0, 1, 0, 1, 0.5, 0.5]
    colors, _, _, tape = ss.record(**arrays, **views, device="cpu", alpha_max=0.9999)
    found = tape.backward(np.ones_like(colors))
    # What is not drawn has no gradient; what is opaque has a finite one, which continues that of just below.
    assert (found["opacities"][[0, 2]] == 0).all()
    near_one = dict(arrays, opacities=np.where(arrays["opacities"] == 1, np.float32(1 - 1e-4), arrays["opacities"]))
    _, _, _, tape = ss.record(**near_one, **views, device="cpu", alpha_max=0.9999)
    below = tape.backward(np.ones_like(colors))
    np.testing.assert_allclose(found["opacities"][[1, 3]], below["opacities"][[1, 3]], rtol=0.05, atol=1e-2)
    without = {name: array[[1, 3, 4, 5]] for name, array in arrays.items()}
    alone, _, _ = ss.rasterize(**without, **views, device="cpu", alpha_max=0.9999)
    assert (alone == colors).all()


def test_a_tape_may_be_used_again():
    arrays, views = scene(10), cameras(1)
    colors, _, _, tape = ss.record(**arrays, **views, device="cpu")
    first = tape.backward(np.ones_like(colors))
    again = tape.backward(np.ones_like(colors))
    for name in ("means", "quats", "scales", "opacities", "colors", "viewmats"):
        np.testing.assert_array_equal(first[name], again[name])


def test_memory_is_used_again_only_after_its_array_is_gone():
    arrays, views = scene(1000, sh_degree=2), cameras(1)
    colors, _, _, tape = ss.record(**arrays, **views, sh_degree=2, device="cpu")
    names = ("means", "quats", "scales", "opacities", "colors")
    kept = tape.backward(np.ones_like(colors))
    expected = {name: kept[name].copy() for name in names}
    place = kept["colors"].ctypes.data
    view = kept["colors"][5:, 1:]
    for number in range(3):
        other = tape.backward(np.full_like(colors, number))
        assert other["colors"].ctypes.data != place
    for name in names:
        np.testing.assert_array_equal(kept[name], expected[name])
        kept[name] += 1
    # A view keeps it, too.
    del kept
    other = tape.backward(np.zeros_like(colors))
    np.testing.assert_array_equal(view, expected["colors"][5:, 1:] + 1)
    assert not other["colors"].any()
    del view
    again = tape.backward(np.ones_like(colors))
    assert again["colors"].ctypes.data == place
    for name in names:
        np.testing.assert_array_equal(again[name], expected[name])


def test_a_tape_reads_the_arrays_again_and_notices_changes():
    arrays, views = scene(10, sh_degree=2), cameras(2)
    settings = dict(sh_degree=2, device="cpu")
    colors, alphas, _, tape = ss.record(**{name: array.copy() for name, array in arrays.items()}, **views, **settings)
    v_colors = weights(colors.shape, 4)
    # The tape keeps arrays alive that nobody else has.
    expected = tape.backward(v_colors)
    again, _, _, tape = ss.record(**arrays, **views, **settings)
    assert (again == colors).all()
    found = tape.backward(v_colors)
    for name in ("means", "quats", "scales", "opacities", "colors", "viewmats"):
        np.testing.assert_array_equal(found[name], expected[name])
    # Arrays of another shape are named.
    means = arrays["means"]
    means.shape = (5, 6)
    with pytest.raises(ValueError, match=r"means: expected shape \[N, 3\], found \[5, 6\]"):
        tape.backward(v_colors)
    means.shape = (10, 3)
    for name, array in arrays.items():
        before = array.copy()
        array.reshape(-1)[-1] += 0.01
        with pytest.raises(RuntimeError, match="changed after record"):
            tape.backward(v_colors)
        array[:] = before
    np.testing.assert_array_equal(tape.backward(v_colors)["means"], expected["means"])


def test_a_change_that_is_not_seen_ends_well():
    # Of large arrays a sample is compared, which begins with their first numbers.
    arrays, views = scene(5000, sh_degree=2), cameras(1)
    colors, _, _, tape = ss.record(**arrays, **views, sh_degree=2, device="cpu")
    arrays["opacities"][30], arrays["scales"][70] = np.nan, 0
    found = tape.backward(np.ones_like(colors))
    assert found["means"].shape == (5000, 3)
    arrays["opacities"] += 1e-3
    with pytest.raises(RuntimeError, match="changed after record"):
        tape.backward(np.ones_like(colors))


def test_by_what_a_scene_stores():
    arrays, views = scene(10, sh_degree=2), cameras(2)
    stored = ss.Scene(**arrays, sh_degree=2)
    settings = dict(SMOOTH, near_plane=0.01, device="cpu", render_mode="RGB+D", backgrounds=np.float32([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]))
    colors, alphas, _, tape = stored.record(**views, **settings)
    again, _, _, of_arrays = ss.record(**arrays, **views, **settings, sh_degree=2)
    assert (stored.render(**views, **settings)[0] == colors).all()

    # A scene holds logarithms, which are rounded.
    def same(found, expected):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())

    same(again, colors)
    v_colors, v_alphas = weights(colors.shape, 4), weights(alphas.shape, 5)
    found, expected = tape.backward(v_colors, v_alphas), of_arrays.backward(v_colors, v_alphas)
    assert set(found) == {"geometry", "sh", "viewmats", "backgrounds", "seconds"}
    for name, by in [("means", found["geometry"][:, :3]), ("quats", found["geometry"][:, 3:7]), ("colors", found["sh"])]:
        same(by, expected[name])
    same(found["viewmats"], expected["viewmats"])
    same(found["backgrounds"], expected["backgrounds"])
    scales, opacities = arrays["scales"], arrays["opacities"]
    same(found["geometry"][:, 7:10], expected["scales"] * scales)
    same(found["geometry"][:, 10], expected["opacities"] * opacities * (1 - opacities))
    # Without a near plane there is one run per camera.
    colors, _, _, tape = stored.record(**views, device="cpu")
    assert (tape.backward(colors)["geometry"] != 0).any()
    none = dict(views, viewmats=views["viewmats"][:0], Ks=views["Ks"][:0])
    colors, _, _, tape = stored.record(**none, device="cpu")
    found = tape.backward(colors)
    assert found["geometry"].shape == (10, 11) and (found["geometry"] == 0).all() and found["viewmats"].shape == (0, 4, 4)


def deviation(found, expected):
    """The largest difference, relative to the largest number."""
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rasterize_mode", ["classic", "antialiased"])
def test_a_gpu_has_the_gradients_of_the_cpu(mode, rasterize_mode):
    # Thresholds are low: which side of them a pixel is on differs between devices by rounding.
    settings = dict(SMOOTH, sh_degree=2, render_mode=mode, rasterize_mode=rasterize_mode)
    settings["backgrounds"] = np.array([[0.2, 0.5, 0.1], [0.9, 0.0, 0.3]], np.float32)
    arguments = dict(scene(200, sh_degree=2), **cameras(2, dtype=np.float64), **settings)
    try:
        name, _ = ss.device("gpu")
    except RuntimeError as error:
        # No adapter, not even one in software: that is said, and nothing is drawn on the CPU instead.
        assert "no GPU to render on" in str(error)
        with pytest.raises(RuntimeError, match="no GPU to render on"):
            ss.record(**arguments, device="gpu")
        return
    colors, alphas, meta, tape = ss.record(**arguments, device="cpu")
    gpu_colors, gpu_alphas, gpu_meta, gpu_tape = ss.record(**arguments, device="gpu")
    assert (meta["device"], gpu_meta["device"]) == ("cpu", name)
    # Both are within F32_WITHOUT_FLOOR (1e-5) of the f64 reference in the tests of gs-raster.
    assert deviation(gpu_colors, colors) < 2e-5 and deviation(gpu_alphas, alphas) < 2e-5
    v_colors, v_alphas = weights(colors.shape, 1) - np.float32(0.6), weights(alphas.shape, 2)
    if "ED" in mode:
        v_colors[..., -1] *= alphas[..., 0] > 0.01
    expected, found = tape.backward(v_colors, v_alphas), gpu_tape.backward(v_colors, v_alphas)
    for name in ("means", "quats", "scales", "opacities", "colors", "viewmats", "backgrounds"):
        if name in ("colors", "backgrounds") and "RGB" not in mode:
            assert (found[name] == 0).all() and (expected[name] == 0).all()
            continue
        # Both are within F32_RANDOM_GRADIENT (1e-4) of the reference there.
        assert found[name].dtype == expected[name].dtype and found[name].shape == expected[name].shape
        assert deviation(found[name], expected[name]) < 2e-4, (name, deviation(found[name], expected[name]))
