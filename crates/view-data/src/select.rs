//! Choosing the context views of a scene, and the targets between them.

use crate::overlap::{HALF, Overlaps};
use crate::{Error, Result, SceneDepth};
use gs_scene::Camera;
use rayon::prelude::*;
use std::cmp::Reverse;

/// Chosen views, as positions in the list of cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// The chosen views, increasing.
    pub context: Vec<usize>,
    /// The frames between them, increasing: not chosen, sharing at least half of their content with two chosen views
    /// and nearer to both than those are to each other.
    pub targets: Vec<usize>,
    /// Share of the frames, 0..1, that have less than half of their content in any one chosen view.
    pub uncovered: f64,
}

/// Chooses `n` connected context views that cover as many frames as that allows.
///
/// *Content* of a view are 3 depths (between near, median and far, evenly in inverse depth) on a 6×6 grid of its
/// pixels; another view *shares* the points that it sees in its image, in front of it and from a direction at most 25
/// degrees apart. Occlusion is not known here. A frame is *covered* if one chosen view shares at least half of its
/// content, and a covered frame is what may be chosen next; the first two views cover each other. So every chosen
/// view shares at least half of its content with another chosen one.
///
/// From up to 32 starts, evenly along the list, the covered frame that makes most frames covered is added until there are `n`. Equal
/// ones are decided by how far all frames are from the nearest chosen view (the sum over frames of the share not seen
/// plus the distance of the centres in median depths), which spreads the views, then by the lower position. The best
/// result of all starts is kept. Deterministic; quadratic in the number of frames.
///
/// # Errors
/// If `n` is 0 or more than the number of cameras, no `n` frames are connected (the error says how many are), or
/// the depths are not `0 < near <= median <= far`.
pub fn select_views(cameras: &[Camera], n: usize, depth: SceneDepth) -> Result<Selection> {
    if n == 0 {
        return Err(Error::NoViews);
    }
    if n > cameras.len() {
        return Err(Error::TooFewFrames { wanted: n, frames: cameras.len() });
    }
    depth.check()?;
    let overlaps = Overlaps::new(cameras, depth);
    let count = cameras.len();
    let spread: Vec<usize> = (0..count.min(STARTS)).map(|i| i * count / count.min(STARTS)).collect();
    let best = grow_from(&overlaps, &spread, n).filter(|grown| grown.chosen.len() == n);
    // A small connected group may lie between the starts.
    let best =
        best.or_else(|| grow_from(&overlaps, &(0..count).collect::<Vec<_>>(), n)).ok_or(Error::NoViews)?;
    let score = best.score_with(&overlaps, best.chosen[0]);
    let mut context = best.chosen;
    if context.len() < n {
        return Err(Error::Disconnected { wanted: n, connected: context.len() });
    }
    context.sort_unstable();
    Ok(Selection {
        targets: targets_between(cameras, &overlaps, &context),
        context,
        uncovered: 1.0 - f64::from(score.covered) / count as f64,
    })
}

/// Sets are grown from so many frames at most: more change little and cost in proportion.
const STARTS: usize = 32;

/// What a set of views is worth; compared field by field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Score {
    /// Frames with at least half of their content in one chosen view.
    covered: u32,
    /// Sum over all frames of the distance to the nearest chosen view, [`Overlaps::distances`].
    distance: Reverse<u32>,
}

/// A connected set of views, in the order in which they were added.
struct Grown {
    chosen: Vec<usize>,
    /// Per frame: the largest number of its points that one chosen view sees.
    seen: Vec<u8>,
    /// Per frame: the distance to the nearest chosen view.
    distances: Vec<u16>,
}

impl Grown {
    /// Grows a set from `start` to `n` views, or to fewer if no more are connected.
    fn from(overlaps: &Overlaps, start: usize, n: usize) -> Self {
        let seen = overlaps.seen_by(start).to_vec();
        let mut grown = Self { chosen: vec![start], seen, distances: overlaps.distances(start).to_vec() };
        while grown.chosen.len() < n {
            let covers_start = |frame| grown.chosen.len() > 1 || overlaps.seen_by(frame)[start] >= HALF;
            let candidates = (0..overlaps.len()).filter(|frame| {
                grown.seen[*frame] >= HALF && !grown.chosen.contains(frame) && covers_start(*frame)
            });
            let scored = candidates.map(|frame| (grown.score_with(overlaps, frame), frame));
            let Some((_, next)) = scored.reduce(|a, b| if b.0 > a.0 { b } else { a }) else { break };
            for (seen, &added) in grown.seen.iter_mut().zip(overlaps.seen_by(next)) {
                *seen = (*seen).max(added);
            }
            for (distance, &added) in grown.distances.iter_mut().zip(overlaps.distances(next)) {
                *distance = (*distance).min(added);
            }
            grown.chosen.push(next);
        }
        grown
    }

    /// The score that the set has with `frame` added, which may be a member.
    fn score_with(&self, overlaps: &Overlaps, frame: usize) -> Score {
        let pairs = self.seen.iter().zip(overlaps.seen_by(frame));
        let covered = pairs.map(|(&seen, &added)| u32::from(seen.max(added) >= HALF)).sum();
        let pairs = self.distances.iter().zip(overlaps.distances(frame));
        let distance = pairs.map(|(&distance, &added)| u32::from(distance.min(added))).sum();
        Score { covered, distance: Reverse(distance) }
    }
}

/// The best of the sets grown from `starts`: most views first, then the score, then the earliest start.
fn grow_from(overlaps: &Overlaps, starts: &[usize], n: usize) -> Option<Grown> {
    let grown = starts.par_iter().map(|&start| {
        let grown = Grown::from(overlaps, start, n);
        ((grown.chosen.len(), grown.score_with(overlaps, start), Reverse(start)), grown)
    });
    grown.reduce_with(|a, b| if b.0 > a.0 { b } else { a }).map(|(_, grown)| grown)
}

fn targets_between(cameras: &[Camera], overlaps: &Overlaps, context: &[usize]) -> Vec<usize> {
    let distance = |a: usize, b: usize| cameras[a].position().distance(cameras[b].position());
    let is_between = |&frame: &usize| {
        let sharing = context.iter().copied().filter(|&view| overlaps.seen_by(view)[frame] >= HALF);
        let sharing: Vec<usize> = sharing.collect();
        sharing.iter().enumerate().any(|(i, &a)| {
            sharing[i + 1..].iter().any(|&b| distance(frame, a).max(distance(frame, b)) <= distance(a, b))
        })
    };
    (0..cameras.len()).filter(|frame| !context.contains(frame)).filter(is_between).collect()
}
