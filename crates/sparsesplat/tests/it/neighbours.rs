use crate::{COURTYARD, given_depth};
use depth_backbone::Wanted;
use gs_scene::View;
use sparsesplat::{Anchored, Config, Predictor, Stages, anchor};

/// The anchors of a configuration, and their neighbours as the head gets them.
fn gathered(config: &Config, covisible: usize) -> (Anchored, Vec<Vec<u32>>) {
    gathered_from(&COURTYARD.0, config, covisible)
}

fn gathered_from(views: &[View], config: &Config, covisible: usize) -> (Anchored, Vec<Vec<u32>>) {
    let geometry =
        Predictor::new(config.clone()).unwrap().geometry_with(views, Wanted::DepthAndFeatures).unwrap();
    let anchored = anchor(views, &geometry, config, covisible, &mut Stages::new(&mut |_| {})).unwrap();
    let inputs = anchored.inputs(attn_head::Kind::Attention, &geometry.views, &[]);
    let rows = inputs.neighbours.chunks_exact(inputs.k.max(1)).map(<[u32]>::to_vec).collect();
    (anchored, rows)
}

#[test]
fn of_the_neighbours_so_many_are_what_other_views_see() {
    let config = Config { neighbours: 12, ..given_depth(1_500) };
    let (nearest, by_distance) = gathered(&config, 0);
    let [mixed, all] = [5, 12].map(|covisible| gathered(&config, covisible));
    for (anchored, rows) in [&mixed, &all] {
        // The closed form goes by distance, whatever the head looks at.
        assert!(anchored.base == nearest.base && rows.len() == by_distance.len());
        for (i, row) in rows.iter().enumerate() {
            let mut once = row.clone();
            once.sort_unstable();
            once.dedup();
            assert!(once.len() == 12 && !once.contains(&(i as u32)), "{i}: {row:?}");
        }
    }
    let shared = |rows: &[Vec<u32>]| -> f64 {
        let pairs = rows.iter().zip(&by_distance);
        pairs.map(|(a, b)| a.iter().filter(|j| b.contains(j)).count()).sum::<usize>() as f64
            / rows.len() as f64
    };
    let (of_mixed, of_all) = (shared(&mixed.1), shared(&all.1));
    // On the same surface some of them are the nearest too; most of what other views see is not.
    assert!((7.0..12.0).contains(&of_mixed) && of_all < of_mixed, "{of_mixed} {of_all} of 12");
}

#[test]
fn where_no_other_view_sees_anything_they_are_the_nearest() {
    let one = &COURTYARD.0[..1];
    let config = Config { neighbours: 6, far_shell: false, ..given_depth(200) };
    let [by_distance, covisible] = [0, 100].map(|n| gathered_from(one, &config, n).1);
    assert!(by_distance == covisible && by_distance.len() == 200);
    // A single anchor has no neighbours, and K = 0 asks for none.
    assert!(gathered_from(one, &Config { far_shell: false, ..given_depth(1) }, 20).1.is_empty());
    assert!(gathered(&Config { neighbours: 0, ..config }, 20).1.is_empty());
}
