"""Values equal those of the Rust API, to the bit."""

import numpy as np

import sparsesplat as ss


def bits(array):
    return np.ascontiguousarray(array).view(np.uint32)


def same(found, expected):
    assert found.dtype == np.float32 and found.shape == expected.shape
    assert (bits(found) == bits(expected)).all(), np.abs(found - expected).max()


def test_pictures_and_gradients(rust):
    width, height = rust.facts["size"]
    _, held_out = ss.simulated_views(width, height)
    viewmats = np.stack([view.viewmat for view in held_out[:2]])
    Ks = np.stack([view.K for view in held_out[:2]])
    arrays = [rust("means", -1, 3), rust("quats", -1, 4), rust("scales", -1, 3), rust("opacities", -1), rust("sh", -1, 9, 3)]
    background = np.array([0.1, 0.2, 0.3], np.float32)
    settings = dict(sh_degree=2, backgrounds=background, render_mode="RGB+ED", device="cpu")

    colors, alphas, meta, tape = ss.record(*arrays, viewmats, Ks, width, height, **settings)
    plain, plain_alphas, _ = ss.rasterize(*arrays, viewmats, Ks, width, height, **settings)
    same(plain, colors)
    same(plain_alphas, alphas)
    same(colors[..., :3], rust("image", 2, height, width, 3))
    same(colors[..., 3], rust("depth", 2, height, width))
    same(alphas[..., 0], rust("alpha", 2, height, width))
    assert meta["n_cameras"] == 2 and meta["rejected"] == [0, 0] and min(meta["visible"]) > 100

    pixels = width * height
    def weights(channels):
        numbers = [((np.arange(pixels * channels) + view) * 7 % 11 - 5) / 5 for view in range(2)]
        return np.stack(numbers).reshape(2, height, width, channels).astype(np.float32)

    v_colors = np.concatenate([weights(3), weights(1)], axis=-1)
    found = tape.backward(np.ascontiguousarray(v_colors), weights(1))
    for name, key, shape in [
        ("means", "by_means", (-1, 3)),
        ("quats", "by_quats", (-1, 4)),
        ("scales", "by_scales", (-1, 3)),
        ("opacities", "by_opacities", (-1,)),
        ("colors", "by_sh", (-1, 9, 3)),
        ("backgrounds", "by_background", (3,)),
    ]:
        same(found[name], rust(key, *shape))
        assert np.abs(found[name]).max() > 0
    # Matrices of float64 have gradients of float64.
    expected = np.array(rust.facts["poses"]).reshape(2, 3, 4)
    assert found["viewmats"].dtype == np.float64
    assert (found["viewmats"][:, :3] == expected).all() and (found["viewmats"][:, 3] == 0).all()


def test_the_pass_and_its_scene(rust, tmp_path):
    width, height = rust.facts["size"]
    context, held_out = ss.simulated_views(width, height)
    seen = []
    scene = ss.reconstruct(context, 2_000, progress=lambda stage, share: seen.append(stage))
    expected = ss.load_ply(rust.folder / "predicted.ply")
    same(scene.geometry, expected.geometry)
    same(scene.sh, expected.sh)
    assert len(scene) == 2_000 == scene.report["gaussians"]
    assert scene.report["per_view"] == rust.facts["counts"]["per_view"]
    assert scene.report["views"] == rust.facts["names"]
    assert seen[0] == "backbone" and seen[-1] == "correction"
    assert scene.seconds["total"] >= scene.seconds["backbone"] > 0
    assert expected.report is None and expected.seconds is None

    # Written files hold every bit.
    path = tmp_path / "scene.ply"
    scene.save(path)
    assert path.read_bytes() == (rust.folder / "predicted.ply").read_bytes()

    view = held_out[0]
    colors, _, _ = scene.render(view.viewmat[None], view.K[None], width, height, device="cpu")
    same(colors[0], rust("predicted_image", height, width, 3))

    # Colours instead of SH.
    means, quats, scales, opacities = (rust(name, *shape) for name, shape in [
        ("means", (-1, 3)), ("quats", (-1, 4)), ("scales", (-1, 3)), ("opacities", (-1,)),
    ])
    colors, _, _ = ss.rasterize(
        means, quats, scales, opacities, rust("rgb", -1, 3), view.viewmat[None], view.K[None], width, height, device="cpu"
    )
    same(colors[0], rust("rgb_image", height, width, 3))


def test_metrics(rust):
    width, height = rust.facts["size"]
    context, _ = ss.simulated_views(width, height)
    indices, sq_distances = ss.knn(rust("means", -1, 3), 8)
    assert (indices.ravel() == np.array(rust.facts["neighbours"], np.uint32)).all() and indices.shape[1] == 8
    same(sq_distances.ravel(), rust("sq_distances", -1))
    a, b = context[0].image, context[1].image
    same(ss.entropy(a), rust("entropy", height, width))
    assert ss.psnr(a, b) == rust.facts["psnr"] and ss.ssim(a, b) == rust.facts["ssim"]
