//! Pairs of Gaussian and tile.

use super::{Chain, UNTOUCHED, exact, gpu, groups, of, one, words};
use crate::check::Row;
use crate::losses::noise;
use glam::{DMat3, DVec3};
use gs_raster::gpu::Gpu;
use gs_reference::Profile;
use gs_reference::bin::bin_emit;
use gs_scene::{Camera, Gaussians, Intrinsics};
use gs_shaders::BIN;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (given, expected) = (&input.lists, &truth.lists);
    let grid = groups(input.n_gaussians() as usize + 1);
    let nothing = vec![UNTOUCHED; given.pairs.tiles.len()];
    let mut run = |entry_point: &str, offsets: &[u32]| {
        let buffers = [
            one(&input.view.frame),
            of(&given.footprints.splats),
            of(&given.order),
            of(&given.counters),
            of(offsets),
            of(&nothing),
            of(&nothing),
            of(&nothing),
        ];
        gpu.run_pass(&BIN, entry_point, input.view.features, grid, &buffers).expect("the pass runs")
    };
    let counted = run("bin_count", &vec![UNTOUCHED; given.counts.len()]);
    let emitted = run("bin_emit", &given.offsets);
    [
        exact("offsets after bin_count", &expected.counts, &words(&counted[4])),
        exact("offsets after bin_emit", &expected.offsets, &words(&emitted[4])),
        exact("pair_tiles", &expected.pairs.tiles, &words(&emitted[5])),
        exact("pair_index", &expected.pairs.index, &words(&emitted[6])),
        exact("pair_splats", &expected.pairs.splats, &words(&emitted[7])),
    ]
    .into_iter()
    .flatten()
    .collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    for splat in &mut chain.lists.footprints.splats {
        splat.mean[0] += 5.0;
    }
}

/// Gaussians whose centres and whose reaches lie on the borders of tiles, or next to them.
fn on_borders() -> Chain {
    let lens = Intrinsics { fx: 64.0, fy: 64.0, cx: 40.0, cy: 24.0, width: 80, height: 48 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
    let mut scene = Gaussians::empty(0).expect("degree 0 exists");
    for i in 0..600 {
        // z is a power of two, so that centres are exact: multiples of 4 px, or half a pixel beside them.
        let z = [1.0, 2.0, 4.0][i % 3];
        let beside = [-0.5, 0.0, 0.5][i / 3 % 3];
        let [u, v] = [4.0 * (i % 21) as f32 + beside, 4.0 * (i % 13) as f32 - beside];
        let mean = [(u - 40.0) / 64.0 * z, (v - 24.0) / 64.0 * z, z];
        let quaternion = [noise(1, i), noise(2, i), noise(3, i), noise(4, i)];
        let log_scale = [5, 6, 7].map(|seed| -3.5 + 2.0 * noise(seed, i));
        scene.push(mean, quaternion, log_scale, 4.0 * noise(8, i), &[0.5; 3]);
    }
    Chain::new("borders".to_owned(), &scene, &camera, &Profile::default(), false)
}

#[test]
#[ignore = "gpu"]
fn as_many_pairs_are_emitted_as_were_counted() {
    let chain = on_borders();
    for row in rows(&mut gpu(), &chain, &chain) {
        assert!(row.holds(), "{}: {:?}", row.output, row.deviation);
    }
    let no_tile = chain.view.frame.tiles[0] * chain.view.frame.tiles[1];
    assert!(chain.lists.pairs.tiles.len() > 1000);
    assert!(chain.lists.pairs.tiles.iter().all(|&tile| tile < no_tile));
}

#[test]
#[ignore = "gpu"]
fn where_room_ends_nothing_is_written() {
    let chain = on_borders();
    let n_pairs = chain.lists.pairs.tiles.len();
    for capacity in [0, 1, n_pairs / 2, n_pairs - 1] {
        let mut cut = chain.clone();
        cut.view.frame.pair_capacity = capacity as u32;
        let pairs = &mut cut.lists.pairs;
        for buffer in [&mut pairs.tiles, &mut pairs.index, &mut pairs.splats] {
            buffer[capacity..].fill(UNTOUCHED);
        }
        for row in rows(&mut gpu(), &cut, &cut) {
            assert!(row.holds(), "{capacity}, {}: {:?}", row.output, row.deviation);
        }
    }
}

#[test]
#[ignore = "gpu"]
fn what_was_counted_too_much_is_marked_as_no_tile() {
    let mut chain = on_borders();
    // Every Gaussian announces three tiles more than it has.
    for (rank, offset) in chain.lists.offsets.iter_mut().enumerate() {
        *offset += 3 * rank as u32;
    }
    let lists = &mut chain.lists;
    lists.pairs =
        bin_emit(&chain.view.frame, &lists.footprints.splats, &lists.order, &lists.counters, &lists.offsets);
    let no_tile = chain.view.frame.tiles[0] * chain.view.frame.tiles[1];
    assert!(chain.lists.pairs.tiles.contains(&no_tile));
    for row in rows(&mut gpu(), &chain, &chain) {
        assert!(row.holds(), "{}: {:?}", row.output, row.deviation);
    }
}
