//! Choosing the context views of a scene, and the targets between them.

use crate::overlap::{Overlaps, POINTS};
use crate::{Error, Result, SceneDepth};
use gs_scene::Camera;
use rayon::prelude::*;

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
/// *Content* of a view are 3 depths (between near, median and far, evenly in inverse depth) on a 6×6 grid of its pixels;
/// another view *shares* the points that it sees in its image, in front of it and from a direction at most 60
/// degrees apart. Occlusion is not known here. Two views are *connected* if each shares at least half of the other's
/// content; a frame is *covered* if one chosen view shares at least half of its content.
///
/// From every frame as a start, the connected frame that covers most frames is added until there are `n`; equal ones
/// are decided by the sum over all frames of their largest share, then by the lower position. The best result of
/// all starts is kept. Deterministic; quadratic in the number of frames.
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
    let components = component_sizes(&overlaps);
    let connected = components.iter().copied().max().unwrap_or(0);
    if connected < n {
        return Err(Error::Disconnected { wanted: n, connected });
    }
    let starts: Vec<usize> = (0..cameras.len()).filter(|&start| components[start] >= n).collect();
    let best = starts.par_iter().map(|&start| grow(&overlaps, start, n));
    // Later starts must be better, not equal: `max_by_key` would keep the last of equal ones.
    let best = best.reduce_with(|a, b| if (b.score, a.start) > (a.score, b.start) { b } else { a });
    let best = best.expect("a component of at least n frames has a start");
    let mut context = best.chosen;
    context.sort_unstable();
    Ok(Selection {
        targets: targets_between(cameras, &overlaps, &context),
        context,
        uncovered: 1.0 - best.score.covered as f64 / cameras.len() as f64,
    })
}

/// Number of points that make half of a view's content.
const HALF: u8 = (POINTS / 2) as u8;

fn connected(overlaps: &Overlaps, a: usize, b: usize) -> bool {
    a != b && overlaps.seen_by(b)[a] >= HALF && overlaps.seen_by(a)[b] >= HALF
}

/// Size of the connected component of each frame.
fn component_sizes(overlaps: &Overlaps) -> Vec<usize> {
    let count = overlaps.len();
    let mut sizes = vec![0; count];
    for start in 0..count {
        if sizes[start] > 0 {
            continue;
        }
        let mut members = vec![start];
        let mut is_member = vec![false; count];
        is_member[start] = true;
        let mut next = 0;
        while let Some(&member) = members.get(next) {
            next += 1;
            for other in 0..count {
                if !is_member[other] && connected(overlaps, member, other) {
                    is_member[other] = true;
                    members.push(other);
                }
            }
        }
        for &member in &members {
            sizes[member] = members.len();
        }
    }
    sizes
}

/// What a set of views is worth; compared field by field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Score {
    /// Frames with at least half of their content in one chosen view.
    covered: u32,
    /// Sum over all frames of the largest number of points in one chosen view.
    shared: u32,
}

struct Grown {
    start: usize,
    chosen: Vec<usize>,
    score: Score,
}

/// A connected set of `n` views from one start; its component has that many.
fn grow(overlaps: &Overlaps, start: usize, n: usize) -> Grown {
    let count = overlaps.len();
    let mut chosen = vec![start];
    // Per frame: the largest number of its points that one chosen view sees.
    let mut best = overlaps.seen_by(start).to_vec();
    let mut is_candidate: Vec<bool> = (0..count).map(|other| connected(overlaps, start, other)).collect();
    while chosen.len() < n {
        let candidates = (0..count).filter(|&candidate| is_candidate[candidate]);
        let scored = candidates.map(|candidate| (score(&best, overlaps.seen_by(candidate)), candidate));
        let (_, next) = scored
            .reduce(|a, b| if b.0 > a.0 { b } else { a })
            .expect("a component of at least n frames has a connected frame that is not chosen");
        for (best, &seen) in best.iter_mut().zip(overlaps.seen_by(next)) {
            *best = (*best).max(seen);
        }
        chosen.push(next);
        for other in 0..count {
            is_candidate[other] |= connected(overlaps, next, other);
        }
        for &view in &chosen {
            is_candidate[view] = false;
        }
    }
    Grown { start, chosen, score: score(&best, &best) }
}

/// The score of the chosen views, whose points are `best`, with one more view that sees `added`.
fn score(best: &[u8], added: &[u8]) -> Score {
    let mut score = Score { covered: 0, shared: 0 };
    for (&best, &added) in best.iter().zip(added) {
        let seen = best.max(added);
        score.covered += u32::from(seen >= HALF);
        score.shared += u32::from(seen);
    }
    score
}

fn targets_between(cameras: &[Camera], overlaps: &Overlaps, context: &[usize]) -> Vec<usize> {
    let distance = |a: usize, b: usize| cameras[a].position().distance(cameras[b].position());
    let is_between = |&frame: &usize| {
        let near: Vec<usize> =
            context.iter().copied().filter(|&view| overlaps.seen_by(view)[frame] >= HALF).collect();
        near.iter().enumerate().any(|(i, &a)| {
            near[i + 1..].iter().any(|&b| distance(frame, a).max(distance(frame, b)) <= distance(a, b))
        })
    };
    (0..cameras.len()).filter(|frame| !context.contains(frame)).filter(is_between).collect()
}
