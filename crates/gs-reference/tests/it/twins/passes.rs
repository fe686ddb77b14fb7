//! What each twin promises by itself.

use super::{Setup, setups};
use gs_reference::bin::{bin_count, bin_emit};
use gs_reference::chain::{backward, forward};
use gs_reference::rasterize_forward::rasterize_forward;
use gs_reference::scan::scan;
use gs_reference::sort::{sort_histogram, sort_scatter};
use gs_reference::tile_ranges::tile_ranges;
use gs_scene::Gaussians;
use gs_shaders::{
    CULLED, Frame, ITEMS, N_PAIRS, NOWHERE, PAIR_GRADS, REJECTED, SORT_DIGIT_BITS, Scan, Sort, Splat, TILE,
    VISIBLE, WORKGROUP,
};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// What one Gaussian alone changes in the picture is found in these tiles, by looking at every pixel.
fn tiles_by_force(frame: &Frame, splat: &Splat, n_tiles: u32) -> BTreeSet<u32> {
    // Every tile sees the Gaussian as its only pair.
    let ranges = vec![[0, 1]; n_tiles as usize];
    let features = gs_shaders::Features { sh_degree: 0, antialias: false, depth: false };
    let pixels = rasterize_forward(frame, &[*splat], &[0], &[0], &ranges, features);
    let drawn = (0..).zip(pixels.ends).filter(|&(_, end)| end > 0);
    let [width, _] = frame.size;
    drawn.map(|(pixel, _)| pixel / width / TILE * frame.tiles[0] + pixel % width / TILE).collect()
}

proptest! {
    #[test]
    fn no_tile_is_missed_and_few_are_in_vain(setup in setups(), enlarged in 1u32..4) {
        let mut view = setup.view();
        // The picture is a part of a larger one, so that there are more tiles, and centres beside it.
        for (size, tiles) in view.frame.size.iter_mut().zip(&mut view.frame.tiles) {
            *size *= enlarged;
            *tiles = size.div_ceil(TILE);
        }
        let rendered = forward(&view);
        let n_tiles = view.frame.tiles[0] * view.frame.tiles[1];
        let (mut found_pairs, mut needed_pairs) = (0, 0);
        let mut seen = BTreeSet::new();
        for rank in 0..rendered.lists.counters[VISIBLE as usize] as usize {
            let index = rendered.lists.order[rank];
            seen.insert(index);
            let pairs = rendered.lists.offsets[rank] as usize..rendered.lists.offsets[rank + 1] as usize;
            prop_assert_eq!(pairs.len(), rendered.lists.counts[rank] as usize);
            let found: BTreeSet<u32> = rendered.lists.pairs.tiles[pairs.clone()].iter().copied().collect();
            prop_assert_eq!(found.len(), pairs.len(), "no tile twice");
            prop_assert!(found.iter().all(|&tile| tile < n_tiles));
            prop_assert!(rendered.lists.pairs.splats[pairs].iter().all(|&splat| splat == index));
            let needed = tiles_by_force(&view.frame, &rendered.lists.footprints.splats[index as usize], n_tiles);
            prop_assert!(found.is_superset(&needed), "{found:?} lack some of {needed:?}");
            found_pairs += found.len();
            needed_pairs += needed.len();
        }
        // An ellipse may pass between pixel centres, and through the corners of a row's first and last tile: a Gaussian has
        // seldom more than one tile in vain.
        prop_assert!(found_pairs <= needed_pairs + 2 * seen.len(), "{found_pairs} pairs, {needed_pairs} needed");
        prop_assert_eq!(rendered.lists.counters[N_PAIRS as usize] as usize, found_pairs);
    }

    #[test]
    fn keys_are_sorted_and_equal_ones_keep_their_order(
        keys in prop::collection::vec(prop_oneof![0u32..4, any::<u32>()], 0..3000), shift in 0u32..29,
        spare in 0u32..3,
    ) {
        let values: Vec<u32> = (0..keys.len() as u32).collect();
        let count = keys.len() as u32;
        let n_blocks = count.div_ceil(WORKGROUP * ITEMS);
        let step = Sort { n: count + spare, n_blocks, count: N_PAIRS, shift };
        let mut counters = [0; 3];
        counters[N_PAIRS as usize] = count;
        // What lies behind the keys is not looked at.
        let padded = |numbers: &[u32]| [numbers, &[7, 7, 7][..spare as usize]].concat();
        let (sorted, order) = sort_scatter(&step, &counters, &padded(&keys), &padded(&values));
        let digit = |key: u32| (key >> shift) % (1 << SORT_DIGIT_BITS);
        prop_assert_eq!(sorted.len(), keys.len());
        prop_assert!(order.iter().zip(&sorted).all(|(&place, &key)| keys[place as usize] == key));
        let ranks: Vec<_> = sorted.iter().map(|&key| digit(key)).zip(&order).collect();
        prop_assert!(ranks.is_sorted_by(|a, b| a < b), "by digit, then as they were");
        // A key of digit d in block b goes to what precedes it in [digit, block], which the scanned histogram tells.
        let histogram = sort_histogram(&step, &counters, &padded(&keys));
        let sums = Scan { n: histogram.len() as u32, n_blocks: 0, total: NOWHERE, padding: 0 };
        let (mut places, total) = scan(&sums, &histogram);
        prop_assert_eq!(total, count);
        for (place, &key) in keys.iter().enumerate() {
            let row = digit(key) * n_blocks + place as u32 / (WORKGROUP * ITEMS);
            let target = &mut places[row as usize];
            prop_assert_eq!(order[*target as usize], place as u32);
            *target += 1;
        }
    }
}

#[test]
fn sums_saturate() {
    let of = |n: u32| Scan { n, n_blocks: 1, total: N_PAIRS, padding: 0 };
    assert_eq!(scan(&of(4), &[3, 0, 5, 1]), (vec![0, 3, 3, 8], 9));
    assert_eq!(scan(&of(2), &[3, 2, 99]), (vec![0, 3], 5));
    assert_eq!(scan(&of(0), &[]), (vec![], 0));
    assert_eq!(scan(&of(3), &[u32::MAX - 1, 2, 0]), (vec![0, u32::MAX - 1, u32::MAX], u32::MAX));
}

#[test]
fn pairs_beyond_the_room_are_left_out_and_missing_ones_have_no_tile() {
    let mut view = Setup::new(3, 8, 0, [39, 37], false, false).view();
    let full = forward(&view);
    let n_pairs = full.lists.counters[N_PAIRS as usize];
    let n_tiles = view.frame.tiles[0] * view.frame.tiles[1];
    assert!(n_pairs > 20);
    view.frame.pair_capacity = 11;
    let splats = &full.lists.footprints.splats;
    let pairs = bin_emit(&view.frame, splats, &full.lists.order, &full.lists.counters, &full.lists.offsets);
    assert_eq!((pairs.tiles.len(), &pairs.tiles[..]), (11, &full.lists.pairs.tiles[..11]));
    assert!(pairs.index.iter().copied().eq(0..11));
    // Only as many pairs are looked at as there is room for.
    let ranges = tile_ranges(&view.frame, &full.lists.counters, &full.lists.sorted_tiles);
    assert_eq!(ranges.iter().map(|[first, end]| end - first).sum::<u32>(), 11);
    // Had a Gaussian announced one tile more, it would have a pair with none.
    view.frame.pair_capacity = u32::MAX;
    let counts = bin_count(&view.frame, splats, &full.lists.order, &full.lists.counters);
    let mut offsets = full.lists.offsets.clone();
    offsets.iter_mut().skip(1).for_each(|offset| *offset += 1);
    let pairs = bin_emit(&view.frame, splats, &full.lists.order, &full.lists.counters, &offsets);
    assert_eq!(pairs.tiles[counts[0] as usize], n_tiles);
    let tiles: Vec<u32> = pairs.tiles.iter().copied().filter(|&tile| tile < n_tiles).collect();
    assert_eq!(tiles, full.lists.pairs.tiles);
}

#[test]
fn what_is_not_finite_is_rejected_and_takes_no_part() {
    let setup = Setup::new(5, 9, 3, [33, 17], true, true);
    let clean = setup.view();
    let truth = forward(&clean);
    let n_rejected = truth.lists.counters[REJECTED as usize];
    assert_eq!(n_rejected, 0);
    let mut bad = vec![[1.0f32; 11]];
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        bad.extend((0..11).map(|column| std::array::from_fn(|i| if i == column { value } else { 1.0 })));
    }
    // In sight, but without a direction, or larger than f32.
    let place = setup.camera.unproject([16.0, 8.0].into(), 5.0).as_vec3().to_array();
    for row in &mut bad[1..] {
        for (value, place) in row[..3].iter_mut().zip(place) {
            *value = if value.is_finite() { place } else { *value };
        }
    }
    bad[0][..3].copy_from_slice(&place);
    bad[0][3..7].fill(0.0);
    bad.push(bad[0]);
    let last = bad.len() - 1;
    bad[last][3] = 1.0;
    bad[last][8] = 1e3;
    let mut view = clean.clone();
    view.geometry = [bad.concat(), clean.geometry.clone()].concat();
    let coefficients = clean.sh.len() / setup.gaussians.len();
    view.sh = [vec![0.0; bad.len() * coefficients], clean.sh.clone()].concat();
    view.frame.n_gaussians += bad.len() as u32;
    let found = forward(&view);
    assert_eq!(found.lists.counters[REJECTED as usize] as usize, bad.len());
    assert_eq!(found.lists.counters[VISIBLE as usize], truth.lists.counters[VISIBLE as usize]);
    assert!(found.lists.footprints.depth_keys[..bad.len()].iter().all(|&key| key == CULLED));
    assert_eq!(found.pixels.pixels, truth.pixels.pixels);
    let by = backward(&view, &found, &setup.weights).stored;
    let expected = backward(&clean, &truth, &setup.weights).stored;
    let (of_bad, of_clean) = by.geometry.split_at(bad.len() * Gaussians::GEOMETRY);
    assert!(of_bad.iter().all(|&by| by == 0.0));
    assert_eq!(of_clean, expected.geometry);
    // A colour that is not finite counts as well.
    view = clean.clone();
    let visible = truth.lists.order[0] as usize;
    view.sh[visible * coefficients] = f32::NAN;
    assert_eq!(forward(&view).lists.counters[REJECTED as usize], 1);
}

#[test]
fn scenes_without_anything_to_see_are_background() {
    for n in [0, 3] {
        let mut setup = Setup::new(2, n, 1, [1, 1], false, true);
        // Every Gaussian too faint to be seen.
        for row in setup.gaussians.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY) {
            row[gs_scene::OPACITY_LOGIT] = -20.0;
        }
        let view = setup.view();
        let found = forward(&view);
        let [r, g, b] = setup.background;
        assert_eq!(found.pixels.pixels, [r, g, b, 1.0, 0.0, 0.0]);
        assert_eq!((found.pixels.ends, found.lists.ranges), (vec![0], vec![[0, 0]]));
        let found = forward(&view);
        let by = backward(&view, &found, &setup.weights);
        assert_eq!(by.pair_grads.len() / PAIR_GRADS, 0);
        assert!(
            by.stored.geometry.iter().chain(&by.stored.sh).chain(&by.stored.pose_sums).all(|&by| by == 0.0)
        );
        assert_eq!(by.stored.geometry.len(), n * Gaussians::GEOMETRY);
    }
}
