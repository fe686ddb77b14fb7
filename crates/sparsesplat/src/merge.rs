//! Merging a set of Gaussians down to a count: the post-processed baseline.
//!
//! It represents the post-processing of GGN and Long-LRM after a pixel-aligned prediction. GGN's Gaussian pooling merges Gaussians of several
//! views within a distance of each other; Long-LRM drops faint ones. Both stop at a threshold, so their count varies, and both are trained with it.
//! Here nothing is trained, the count is given, and similar Gaussians of one view are merged, too, until the count is reached:
//!
//! 1. Gaussians too faint to be drawn are dropped, faintest first, while there are too many.
//! 2. In rounds, each Gaussian proposes a merge to the one of its nearest with the smallest error: Ward's
//!    criterion, the harmonic mean of their weights times their squared distance in colour and in pixels. Proposals are
//!    taken from the cheapest on, each Gaussian once a round, until the count is reached.
//! 3. A pair becomes the Gaussian with its total moments: optical mass, mean, second moments; SH are averaged by mass.
//!
//! Optical mass is -ln(1 - opacity) times the disc's area. With it, two Gaussians in one place transmit as much light as before, and two beside each
//! other keep their opacity.

mod cluster;
mod covariance;

use crate::Result;
pub use cluster::{COLOUR_SCALE, Cluster};
use gs_scene::{Gaussians, OPACITY_LOGIT, sh_coefficients, sigmoid};
use rayon::prelude::*;

/// Neighbours among which a partner is looked for.
const NEIGHBOURS: usize = 5;
/// Opacity below which renderers skip a Gaussian.
const INVISIBLE: f32 = 1.0 / 255.0;

/// A smaller set of Gaussians.
pub(crate) struct Merged {
    /// What is left, in the order of those that it was merged into.
    pub(crate) gaussians: Gaussians,
    /// Places of the others in the set that it was made from, ascending.
    pub(crate) absorbed: Vec<u32>,
}

/// At most `count` Gaussians (at least 1) that stand for the given ones; as they are if there are no more. `widths` are
/// those of the patches that they stand for, scene units: what one pixel is there.
///
/// # Errors
/// If a mean is not finite.
pub(crate) fn merge(mut gaussians: Gaussians, widths: &[f32], count: usize) -> Result<Merged> {
    let n = gaussians.len();
    let mut left = visible(&gaussians, n.saturating_sub(count));
    let rows = gaussians.geometry().par_chunks_exact(Gaussians::GEOMETRY);
    let mut clusters: Vec<Cluster> = rows.zip(widths).map(|(row, &width)| Cluster::new(row, width)).collect();
    let (_, sh) = gaussians.buffers_mut();
    // A patch of the final size weighs as much as the difference of colour that the cells are made by.
    reduce(&mut clusters, sh, &mut left, count, n as f64 / count as f64)?;
    let mut kept = Gaussians::empty(gaussians.sh_degree())?;
    let numbers = sh_coefficients(gaussians.sh_degree()) * 3;
    let mut is_left = vec![false; n];
    for &i in &left {
        is_left[i as usize] = true;
        let i = i as usize;
        let row = &gaussians.geometry()[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        clusters[i].push(row, &gaussians.sh()[i * numbers..][..numbers], &mut kept);
    }
    let absorbed = (0..n as u32).filter(|&i| !is_left[i as usize]).collect();
    Ok(Merged { gaussians: kept, absorbed })
}

/// Places of all but those that cannot be seen, of which at most `surplus` are left out, faintest first.
fn visible(gaussians: &Gaussians, surplus: usize) -> Vec<u32> {
    let opacity = |i: u32| sigmoid(gaussians.geometry()[i as usize * Gaussians::GEOMETRY + OPACITY_LOGIT]);
    let all = 0..gaussians.len() as u32;
    let mut faint: Vec<u32> = all.clone().filter(|&i| opacity(i) < INVISIBLE).collect();
    faint.sort_by(|&i, &j| opacity(i).total_cmp(&opacity(j)));
    faint.truncate(surplus);
    faint.sort_unstable();
    all.filter(|i| faint.binary_search(i).is_err()).collect()
}

/// Merges the clusters at the places `left` (ascending) until there are no more than `count`. A pair's moments and SH
/// are at the place of the heavier one afterwards. `patch` is the size of a patch, pixels, whose width is as far as
/// colours that differ clearly.
fn reduce(
    clusters: &mut [Cluster],
    sh: &mut [f32],
    left: &mut Vec<u32>,
    count: usize,
    patch: f64,
) -> Result<()> {
    let numbers = sh.len() / clusters.len().max(1);
    // Seen from a corner of the set, which does not depend on its order.
    let corner = left.iter().map(|&i| clusters[i as usize].mean).reduce(glam::DVec3::min).unwrap_or_default();
    while left.len() > count {
        let member = |place: usize| &clusters[left[place] as usize];
        let colour = |place: usize| cluster::colour(&sh[left[place] as usize * numbers..]);
        let points: Vec<[f32; 3]> =
            (0..left.len()).into_par_iter().map(|i| (member(i).mean - corner).as_vec3().to_array()).collect();
        let near = knn::knn(&points, NEIGHBOURS)?;
        let best = |i: usize| {
            let cost = |&j: &u32| {
                let j = j as usize;
                (cluster::cost((member(i), colour(i)), (member(j), colour(j)), patch), j as u32)
            };
            near.row(i).0.iter().map(cost).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
        };
        let partners: Vec<Option<(f32, u32)>> = (0..left.len()).into_par_iter().map(best).collect();
        // Costs are at least +0, and such floats order as their bits do.
        let key = |(i, partner): (usize, &Option<(f32, u32)>)| {
            partner.map(|(cost, _)| u64::from(cost.to_bits()) << 32 | i as u64)
        };
        let mut proposals: Vec<u64> = partners.par_iter().enumerate().filter_map(key).collect();
        proposals.par_sort_unstable();

        let most = left.len() - count;
        let mut taken = vec![false; left.len()];
        let mut gone = vec![false; left.len()];
        let mut merged = 0;
        for i in proposals.into_iter().map(|key| key as u32 as usize) {
            let Some((_, j)) = partners[i] else { continue };
            let j = j as usize;
            if merged == most || taken[i] || taken[j] {
                continue;
            }
            (taken[i], taken[j]) = (true, true);
            merged += 1;
            let (a, b) = (left[i.min(j)] as usize, left[i.max(j)] as usize);
            let (into, from) = if clusters[b].weight > clusters[a].weight { (b, a) } else { (a, b) };
            gone[if left[i] as usize == from { i } else { j }] = true;
            let share = (clusters[from].mass / (clusters[from].mass + clusters[into].mass)) as f32;
            for k in 0..numbers {
                let (new, old) = (sh[from * numbers + k], &mut sh[into * numbers + k]);
                *old = (1.0 - share) * *old + share * new;
            }
            clusters[into] = clusters[into].joined(&clusters[from]);
        }
        let mut gone = gone.iter();
        left.retain(|_| gone.next() == Some(&false));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
