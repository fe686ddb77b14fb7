//! Which pairs of frames are matched: near each other by the poses, and by the list, since the poses may be
//! wrong.

use super::epipolar::Posed;
use std::collections::BTreeSet;

/// At most `max` pairs (i < j) of positions in `posed` (`None`: not to be used), spread over the list: for
/// every frame one that comes after it in the list, then those nearest by pose, the nearest first. `depth` is
/// a typical distance of the scene.
pub(crate) fn choose_pairs(posed: &[Option<Posed>], depth: Option<f64>, max: usize) -> Vec<(usize, usize)> {
    let usable: Vec<usize> = (0..posed.len()).filter(|&i| posed[i].is_some()).collect();
    let mut pairs = BTreeSet::new();
    let add = |rank: Vec<(usize, usize)>, pairs: &mut BTreeSet<(usize, usize)>| {
        let fresh: Vec<(usize, usize)> = rank
            .into_iter()
            .map(|(i, j)| (i.min(j), i.max(j)))
            .filter(|pair| pair.0 != pair.1 && !pairs.contains(pair))
            .collect::<BTreeSet<_>>()
            .into_iter()
            .collect();
        let room = (max - pairs.len()).min(fresh.len());
        pairs.extend((0..room).map(|k| fresh[k * fresh.len() / room]));
    };
    // Neighbours in a long list are frames of a video, too close together to tell one pose from another.
    let stride = (usable.len() / FRAMES_ON_A_PATH).max(1);
    let after = usable.iter().zip(usable.iter().skip(stride)).map(|(&i, &j)| (i, j));
    // A third of the pairs at least is left for those by pose.
    let after: Vec<(usize, usize)> = spread(after.collect(), (2 * max).div_ceil(3));
    add(after, &mut pairs);
    // Nearest views cost a pass over all frames each: of many frames only some are asked.
    let asked = spread(usable.clone(), max);
    let neighbours: Vec<Vec<usize>> = asked.iter().map(|&i| nearest(posed, &usable, i, depth)).collect();
    for rank in 0..NEIGHBOURS {
        if pairs.len() >= max {
            break;
        }
        let of_rank = asked.iter().zip(&neighbours).filter_map(|(&i, near)| Some((i, *near.get(rank)?)));
        add(of_rank.collect(), &mut pairs);
    }
    pairs.into_iter().collect()
}

const NEIGHBOURS: usize = 4;
/// A path is long enough for every neighbour to differ visibly if it has fewer frames.
const FRAMES_ON_A_PATH: usize = 150;
/// Baselines under this share of the depth say little.
const SHORT_BASELINE: f64 = 0.03;
/// Turn between two views that costs as much as a baseline of one depth, radians: 25 degrees.
const TURN: f64 = 0.44;

/// At most `count` entries, evenly along the list.
fn spread<T: Copy>(list: Vec<T>, count: usize) -> Vec<T> {
    if list.len() <= count {
        return list;
    }
    (0..count).map(|k| list[k * list.len() / count]).collect()
}

fn nearest(posed: &[Option<Posed>], usable: &[usize], i: usize, depth: Option<f64>) -> Vec<usize> {
    let Some(here) = posed[i] else { return Vec::new() };
    let depth = depth.unwrap_or(1.0);
    let mut others: Vec<(f64, usize)> = usable
        .iter()
        .filter(|&&j| j != i)
        .filter_map(|&j| {
            let there = posed[j]?;
            let baseline = here.position.distance(there.position) / depth;
            let turn = here.axes.z_axis.angle_between(there.axes.z_axis);
            let short = 0.5 * (1.0 - baseline / SHORT_BASELINE).max(0.0);
            Some((baseline + turn / TURN + short, j))
        })
        .collect();
    let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if others.len() > NEIGHBOURS {
        others.select_nth_unstable_by(NEIGHBOURS - 1, order);
        others.truncate(NEIGHBOURS);
    }
    others.sort_unstable_by(order);
    others.into_iter().map(|(_, j)| j).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::Intrinsics;

    fn line(count: usize) -> Vec<Option<Posed>> {
        let intrinsics = Intrinsics { fx: 10.0, fy: 10.0, cx: 5.0, cy: 5.0, width: 10, height: 10 };
        let camera =
            |i: usize| Posed { intrinsics, axes: DMat3::IDENTITY, position: DVec3::X * (0.1 * i as f64) };
        (0..count).map(|i| Some(camera(i))).collect()
    }

    #[test]
    fn pairs_are_bounded_spread_and_cover_small_sets() {
        let pairs = choose_pairs(&line(20), Some(2.0), 60);
        assert!(pairs.len() <= 60 && pairs.iter().all(|(i, j)| i < j));
        for i in 0..20 {
            let degree = pairs.iter().filter(|(a, b)| *a == i || *b == i).count();
            assert!(degree >= 2, "frame {i} is in {degree} pairs");
        }
        let pairs = choose_pairs(&line(3000), Some(2.0), 60);
        assert_eq!(pairs.len(), 60);
        assert!(pairs[0].0 < 100 && pairs[59].0 > 2900, "{pairs:?}");
        assert!(pairs.windows(2).all(|w| w[1].0 - w[0].0 < 200));
    }

    #[test]
    fn unusable_frames_and_tiny_sets_give_what_there_is() {
        let mut posed = line(4);
        posed[2] = None;
        let pairs = choose_pairs(&posed, None, 60);
        assert!(pairs.contains(&(1, 3)) && pairs.iter().all(|(i, j)| *i != 2 && *j != 2));
        assert_eq!(choose_pairs(&line(1), None, 60), []);
        assert_eq!(choose_pairs(&[], None, 60), []);
        assert_eq!(choose_pairs(&line(5), None, 0), []);
    }
}
