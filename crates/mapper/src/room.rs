//! Room in a full map: what is worth least is merged with what is like it, or evicted.

use crate::Result;
use crate::map::{Map, mean};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Gaussians, LOG_SCALE, QUATERNION, rgb_from_dc};
use rayon::prelude::*;
use sparsesplat::{COLOUR_SCALE, Cluster};

/// Of every Gaussian that must go, so many of the least worth are candidates.
const CANDIDATES: usize = 6;
/// Neighbours among the candidates of which the cheapest is the partner.
const NEIGHBOURS: usize = 6;
/// Cosine of the largest angle between the normals of two that are merged: 45 degrees.
const SAME_NORMAL: f64 = 0.7;
/// What evicting a Gaussian costs per pixel of its worth, in the unit of a merge: as much as a merge of two that are equally large, three
/// standard deviations apart.
const EVICTION: f32 = 4.5;
/// Variance of a merged Gaussian over that of its two parts.
const SPREAD: f64 = 1.1;

/// How room was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Reduced {
    /// Pairs that became one.
    pub(crate) merged: usize,
    /// Gaussians that went.
    pub(crate) evicted: usize,
}

/// A Gaussian as merging sees it.
struct Candidate {
    mean: DVec3,
    normal: DVec3,
    /// Geometric mean of the two larger variances, scene units².
    variance: f64,
    colour: [f32; 3],
    worth: f32,
}

impl Candidate {
    fn new(map: &Map, i: usize) -> Self {
        let row = &map.gaussians.geometry()[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        let scales: [f64; 3] = std::array::from_fn(|k| f64::from(row[LOG_SCALE.start + k]));
        let thinnest = (0..3).min_by(|&a, &b| scales[a].total_cmp(&scales[b])).unwrap_or(2);
        let q: [f64; 4] = std::array::from_fn(|k| f64::from(row[QUATERNION.start + k]));
        let axes = DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize());
        let dc = &map.gaussians.sh()[i * 3..][..3];
        Self {
            mean: mean(row),
            normal: axes.col(thinnest),
            variance: (scales.iter().sum::<f64>() - scales[thinnest]).exp(),
            colour: rgb_from_dc([dc[0], dc[1], dc[2]]),
            worth: map.evidence[i].worth(),
        }
    }

    /// What a picture loses if two become one, squared and summed over pixels, up to a common factor; none if they are of two surfaces.
    fn cost(&self, other: &Self) -> Option<f32> {
        if self.normal.dot(other.normal).abs() < SAME_NORMAL {
            return None;
        }
        let step = other.mean - self.mean;
        let mean = 0.5 * (self.variance + other.variance);
        // Along the normal a distance is another surface long before it is so along the surface.
        let across = step.dot(self.normal);
        let distance = (step.length_squared() + 8.0 * across * across) / mean;
        let colour: f32 = (0..3).map(|c| (self.colour[c] - other.colour[c]).powi(2)).sum();
        let weight = self.worth * other.worth / (self.worth + other.worth).max(f32::MIN_POSITIVE);
        let cost = weight * (distance as f32 + colour / (COLOUR_SCALE * COLOUR_SCALE));
        cost.is_finite().then_some(cost)
    }
}

/// What is done to a candidate, with its cost.
#[derive(Debug, Clone, Copy)]
struct Proposal {
    cost: f32,
    candidate: u32,
    /// None evicts.
    partner: Option<u32>,
}

/// Makes room for `new` Gaussians.
///
/// # Errors
/// If a mean is not finite.
pub(crate) fn make_room(map: &mut Map, new: usize) -> Result<Reduced> {
    let surplus = (map.len() + new).saturating_sub(map.most);
    if surplus == 0 {
        return Ok(Reduced::default());
    }
    let count = (CANDIDATES * surplus).min(map.len());
    let mut order: Vec<u32> = (0..map.len() as u32).collect();
    let worth = |i: u32| map.evidence[i as usize].worth();
    if count < order.len() {
        order.select_nth_unstable_by(count, |&i, &j| worth(i).total_cmp(&worth(j)).then(i.cmp(&j)));
    }
    order.truncate(count);
    order.sort_unstable();
    let candidates: Vec<Candidate> = order.par_iter().map(|&i| Candidate::new(map, i as usize)).collect();
    let origin = candidates[0].mean;
    let points: Vec<[f32; 3]> =
        candidates.iter().map(|candidate| (candidate.mean - origin).as_vec3().to_array()).collect();
    let near = knn::knn(&points, NEIGHBOURS)?;
    let merge = |i: usize| {
        let cost = |&j: &u32| Some((candidates[i].cost(&candidates[j as usize])?, j));
        let best = near.row(i).0.iter().filter_map(cost);
        best.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
    };
    let mut proposals: Vec<Proposal> = (0..count)
        .into_par_iter()
        .flat_map_iter(|i| {
            let candidate = i as u32;
            let evict = Proposal { cost: EVICTION * candidates[i].worth, candidate, partner: None };
            let merge = merge(i).map(|(cost, partner)| Proposal { cost, candidate, partner: Some(partner) });
            [Some(evict), merge].into_iter().flatten()
        })
        .collect();
    proposals.par_sort_unstable_by(|a, b| {
        a.cost.total_cmp(&b.cost).then((a.candidate, a.partner).cmp(&(b.candidate, b.partner)))
    });
    let mut keep = vec![true; map.len()];
    let mut taken = vec![false; count];
    let mut reduced = Reduced::default();
    for Proposal { candidate, partner, .. } in proposals {
        if reduced.merged + reduced.evicted == surplus {
            break;
        }
        if taken[candidate as usize] || partner.is_some_and(|partner| taken[partner as usize]) {
            continue;
        }
        taken[candidate as usize] = true;
        keep[order[candidate as usize] as usize] = false;
        match partner {
            None => reduced.evicted += 1,
            Some(partner) => {
                taken[partner as usize] = true;
                reduced.merged += 1;
                merge_into(map, order[partner as usize] as usize, order[candidate as usize] as usize);
            }
        }
    }
    // More than half of a map that must go: what was merged goes as well.
    for &i in &order {
        if reduced.merged + reduced.evicted == surplus {
            break;
        }
        reduced.evicted += usize::from(std::mem::replace(&mut keep[i as usize], false));
    }
    map.retain(&keep);
    Ok(reduced)
}

/// Makes one Gaussian of two, at the place of the first.
fn merge_into(map: &mut Map, into: usize, from: usize) {
    let row = |map: &Map, i: usize| {
        let row = &map.gaussians.geometry()[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        Cluster::new(row, 1.0)
    };
    let (a, b) = (row(map, into), row(map, from));
    let share = (b.mass / (a.mass + b.mass)) as f32;
    let (geometry, sh) = map.gaussians.buffers_mut();
    geometry[into * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY].copy_from_slice(&a.joined(&b).row(SPREAD));
    for c in 0..3 {
        let (new, old) = (sh[from * 3 + c], &mut sh[into * 3 + c]);
        *old = (1.0 - share) * *old + share * new;
    }
    let other = map.evidence[from];
    let evidence = &mut map.evidence[into];
    let worth = evidence.worth() + other.worth();
    evidence.looks = evidence.looks.max(other.looks);
    evidence.mass = worth * evidence.looks.max(1.0);
    evidence.weight = evidence.weight.max(other.weight);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::Evidence;
    use gs_scene::{OPACITY_LOGIT, dc_from_rgb};

    /// Discs facing z on a row, one per number: (x, worth, grey).
    fn map(most: usize, discs: &[(f32, f32, f32)]) -> Map {
        let mut map = Map::new(most).unwrap();
        for &(x, worth, grey) in discs {
            let scale = [-2.0, -2.0, -4.0];
            map.gaussians.push([x, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], scale, 1.0, &dc_from_rgb([grey; 3]));
            map.evidence.push(Evidence { mass: worth, looks: 1.0, weight: 1.0 });
        }
        map
    }

    #[test]
    fn two_that_are_alike_become_one_with_their_moments() {
        let mut map = map(3, &[(0.0, 1.0, 0.5), (0.02, 1.0, 0.5), (9.0, 50.0, 0.1)]);
        let before: f64 = [0, 11]
            .map(|start| Cluster::new(&map.gaussians.geometry()[start..start + 11], 1.0).mass)
            .iter()
            .sum();
        assert_eq!(make_room(&mut map, 1).unwrap(), Reduced { merged: 1, evicted: 0 });
        assert_eq!(map.len(), 2);
        let row = &map.gaussians.geometry()[..11];
        assert!((row[0] - 0.01).abs() < 1e-6, "the mean of both");
        let after = Cluster::new(row, 1.0);
        // The spread widens both axes.
        assert!((after.mass / SPREAD / before - 1.0).abs() < 1e-3, "{before} {}", after.mass);
        assert_eq!(map.evidence[0].worth(), 2.0);
    }

    #[test]
    fn what_is_alone_and_worth_least_is_evicted() {
        let mut map = map(3, &[(0.0, 3.0, 0.5), (5.0, 0.1, 0.5), (9.0, 50.0, 0.1)]);
        assert_eq!(make_room(&mut map, 1).unwrap(), Reduced { merged: 0, evicted: 1 });
        assert_eq!(map.evidence.iter().map(|e| e.mass).collect::<Vec<_>>(), [3.0, 50.0]);
        // As much room as there can be.
        make_room(&mut map, 3).unwrap();
        assert_eq!(map.len(), 0);
    }

    #[test]
    fn colours_and_surfaces_are_not_mixed() {
        let discs = [(0.0, 1.0, 0.1), (0.02, 1.0, 0.9), (0.04, 1.0, 0.12), (9.0, 50.0, 0.1)];
        let mut of_one_colour = map(4, &discs);
        assert_eq!(make_room(&mut of_one_colour, 1).unwrap(), Reduced { merged: 1, evicted: 0 });
        let greys: Vec<f32> =
            of_one_colour.gaussians.sh().chunks_exact(3).map(|sh| rgb_from_dc([sh[0]; 3])[0]).collect();
        assert!(greys.iter().any(|grey| (grey - 0.9).abs() < 1e-6), "{greys:?}");
        assert!(greys.iter().any(|grey| (grey - 0.11).abs() < 0.011), "{greys:?}");
        // The same colour, but the second is turned by 90 degrees.
        let mut crossed = map(2, &[(0.0, 1.0, 0.5), (0.01, 1.0, 0.5)]);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        crossed.gaussians.buffers_mut().0[11 + QUATERNION.start..][..4]
            .copy_from_slice(&[half, 0.0, half, 0.0]);
        assert_eq!(make_room(&mut crossed, 1).unwrap(), Reduced { merged: 0, evicted: 1 });
    }

    #[test]
    fn a_map_with_room_stays_as_it_is() {
        let mut map = map(5, &[(0.0, 1.0, 0.5), (0.0, 1.0, 0.5)]);
        let before = map.clone();
        assert_eq!(make_room(&mut map, 3).unwrap(), Reduced::default());
        assert_eq!(map, before);
        assert!(map.gaussians.geometry()[OPACITY_LOGIT] == 1.0);
    }
}
