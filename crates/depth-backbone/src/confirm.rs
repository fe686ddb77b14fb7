//! Which pixels the views confirm.

use crate::consistency::{Tolerance, Witness, agree};
use crate::plane_sweep::{Matched, witness_views, witnesses};
use crate::range::Planes;
use rayon::prelude::*;
use std::cmp::Ordering;

/// Confirmed pixels must come in connected patches of at least this many.
const SMALLEST_PATCH: usize = 150;
/// Standard deviation of the luma in a window, 8-bit levels, below which an agreement means nothing: clear sky agrees
/// with itself at any depth.
const FLAT: f32 = 1.4;
/// What a view counts that does not see a point because a confirmed surface hides it, where one that disagrees counts 1.
const HIDDEN: f32 = 0.5;
/// Share of the confirmed pixels of a view that lie at an unusual depth, at either end.
const UNUSUAL: f32 = 0.05;

/// How many other views confirm each pixel of each view, and the mean inverse depth of all that do, the pixel's own included.
///
/// Agreement may be chance. It does not count in flat windows, in small patches, and in patches at an unusual depth of whose points
/// more views disagree than agree.
pub(crate) fn confirmed(
    matched: &[Matched],
    inverse_depths: &[Vec<f32>],
    planes: &Planes,
) -> Vec<Vec<(u8, f32)>> {
    let first = |view: usize| {
        let texture = &matched[view].texture;
        let witnesses = witnesses(view, matched, inverse_depths, planes);
        let mut agreed = agree(matched[view].view, &inverse_depths[view], &witnesses, planes);
        for (pixel, (count, _)) in agreed.iter_mut().enumerate() {
            if matched[view].statistics.deviation(pixel) < FLAT {
                *count = 0;
            }
        }
        retain_patches(&mut agreed, texture.width, planes.step(), |patch, _| patch.len() >= SMALLEST_PATCH);
        agreed
    };
    let agreed: Vec<_> = (0..matched.len()).into_par_iter().map(first).collect();
    let second = |view: usize| {
        let disagreeing = disagreeing(view, matched, inverse_depths, &agreed, planes);
        let (farthest, nearest) = usual(&agreed[view]);
        let mut kept = agreed[view].clone();
        retain_patches(&mut kept, matched[view].texture.width, planes.step(), |patch, agreed| {
            let mean =
                patch.iter().map(|&pixel| f64::from(agreed[pixel].1)).sum::<f64>() / patch.len() as f64;
            let balance = |&pixel: &usize| f64::from(f32::from(agreed[pixel].0) - disagreeing(pixel));
            (f64::from(farthest)..=f64::from(nearest)).contains(&mean)
                || patch.iter().map(balance).sum::<f64>() >= 0.0
        });
        kept
    };
    (0..matched.len()).into_par_iter().map(second).collect()
}

/// Inverse depths between which all but [`UNUSUAL`] of the confirmed pixels lie at either end.
fn usual(agreed: &[(u8, f32)]) -> (f32, f32) {
    let mut known: Vec<f32> = agreed.iter().filter(|(count, _)| *count > 0).map(|&(_, mean)| mean).collect();
    if known.is_empty() {
        return (0.0, 0.0);
    }
    let beyond = (UNUSUAL * known.len() as f32) as usize;
    let last = known.len() - 1;
    let mut order_statistic = |rank: usize| *known.select_nth_unstable_by(rank, f32::total_cmp).1;
    (order_statistic(beyond), order_statistic(last - beyond))
}

/// How many of the views into whose pictures the point of a pixel falls do not see it there. A confirmed surface before the point may truly
/// hide it, so it counts [`HIDDEN`].
fn disagreeing<'a>(
    index: usize,
    matched: &'a [Matched],
    inverse_depths: &'a [Vec<f32>],
    agreed: &'a [Vec<(u8, f32)>],
    planes: &'a Planes,
) -> impl Fn(usize) -> f32 + 'a {
    let witnesses: Vec<_> = witness_views(index, matched, planes)
        .map(|other| &agreed[other])
        .zip(witnesses(index, matched, inverse_depths, planes))
        .collect();
    let (width, tolerance) = (matched[index].texture.width, Tolerance::of_step(planes.step()));
    move |pixel| {
        let (u, v) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
        let w = inverse_depths[index][pixel];
        let weight = |(agreed, witness): &(&Vec<(u8, f32)>, Witness)| match witness.order(u, v, w, tolerance)
        {
            Some((pixel, Ordering::Less)) if agreed[pixel].0 > 0 => HIDDEN,
            Some((_, Ordering::Less | Ordering::Greater)) => 1.0,
            Some((_, Ordering::Equal)) | None => 0.0,
        };
        witnesses.iter().map(weight).sum()
    }
}

/// Takes the confirmation from connected patches that `keep` refuses. Pixels are connected if their inverse depths differ by less than
/// `step`.
fn retain_patches(
    agreed: &mut [(u8, f32)],
    width: usize,
    step: f32,
    keep: impl Fn(&[usize], &[(u8, f32)]) -> bool,
) {
    let mut seen = vec![false; agreed.len()];
    let mut patch = Vec::new();
    for start in 0..agreed.len() {
        if seen[start] || agreed[start].0 == 0 {
            continue;
        }
        patch.clear();
        patch.push(start);
        seen[start] = true;
        let mut next = 0;
        while next < patch.len() {
            let i = patch[next];
            next += 1;
            let (x, w) = (i % width, agreed[i].1);
            let neighbours = [
                (x > 0).then(|| i - 1),
                (x + 1 < width).then(|| i + 1),
                i.checked_sub(width),
                (i + width < agreed.len()).then(|| i + width),
            ];
            for j in neighbours.into_iter().flatten() {
                if !seen[j] && agreed[j].0 > 0 && (agreed[j].1 - w).abs() < step {
                    seen[j] = true;
                    patch.push(j);
                }
            }
        }
        if !keep(&patch, agreed) {
            patch.iter().for_each(|&i| agreed[i].0 = 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Image, Intrinsics, View};

    const WIDTH: usize = 96;
    const HEIGHT: usize = 64;

    /// How many views confirm a patch, the wall beside it, both in the first of four views whose cameras stand side by side: at
    /// inverse depth w a point lies 60 w pixels farther left in the next view. `surface` is the inverse depth of a view on the patch, if
    /// it is one at inverse depth `w`, and of the rest of the view.
    fn confirmed_of(w: f32, surface: impl Fn(usize) -> (Option<f32>, f32)) -> (u8, u8) {
        let lens = Intrinsics { fx: 60.0, fy: 60.0, cx: 48.0, cy: 32.0, width: WIDTH, height: HEIGHT };
        let view = |i: usize| {
            let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-(i as f64), 0.0, 0.0)).unwrap();
            let texture = (0..3 * WIDTH * HEIGHT).map(|i| (i / 3 * 7919 % 256) as f32 / 255.0).collect();
            View::new(i.to_string(), Image::new(WIDTH, HEIGHT, texture).unwrap(), camera, None).unwrap()
        };
        let views: Vec<View> = (0..4).map(view).collect();
        let matched = Matched::all(&views, &vec![Vec::new(); 4]);
        let pixel = |view: usize, pixel: usize| {
            let (x, y) = (pixel % WIDTH + view * (60.0 * w).round() as usize, pixel / WIDTH);
            let (patch, rest) = surface(view);
            patch.filter(|_| (50..65).contains(&x) && (24..40).contains(&y)).unwrap_or(rest)
        };
        let surfaces: Vec<Vec<f32>> =
            (0..4).map(|view| (0..WIDTH * HEIGHT).map(|p| pixel(view, p)).collect()).collect();
        let agreed = &confirmed(&matched, &surfaces, &Planes::new(3.0, 20.0, 64).unwrap())[0];
        (agreed[32 * WIDTH + 57].0, agreed[32 * WIDTH + 80].0)
    }

    #[test]
    fn a_patch_before_a_wall_that_more_views_see_through_than_see_is_chance() {
        for (seeing, expected) in [(2, 0), (3, 2), (4, 3)] {
            let found = confirmed_of(0.2, |view| ((view < seeing).then_some(0.2), 0.1));
            assert_eq!(found, (expected, 3), "{seeing} views see it");
        }
    }

    #[test]
    fn a_patch_behind_a_wall_is_hidden_if_the_wall_is_confirmed() {
        let found = confirmed_of(0.05, |view| ((view < 2).then_some(0.05), 0.1));
        assert_eq!(found, (1, 3));
        // The other two views have surfaces that nothing confirms.
        let found = confirmed_of(0.05, |view| ((view < 2).then_some(0.05), [0.1, 0.1, 0.2, 0.3][view]));
        assert_eq!(found, (0, 1));
    }

    #[test]
    fn nothing_agreed_has_no_usual_depth_and_few_pixels_are_all_usual() {
        assert_eq!(usual(&[]), (0.0, 0.0));
        assert_eq!(usual(&[(0, 3.0), (1, 2.0)]), (2.0, 2.0));
        assert_eq!(usual(&[(1, 1.0), (2, 4.0), (1, 3.0)]), (1.0, 4.0));
    }

    #[test]
    fn small_patches_lose_their_confirmation_and_steps_part_patches() {
        // Left: 20 columns at 1; right: 20 columns at 2, cut off by one column without confirmation; one lone pixel.
        let (width, height) = (45, 20);
        let mut agreed: Vec<(u8, f32)> = (0..width * height)
            .map(|i| match i % width {
                0..20 => (2, 1.0),
                20..40 => (1, 2.0),
                _ => (0, 2.0),
            })
            .collect();
        agreed[10 * width + 43].0 = 3;
        // A patch of 5 x 5 at another depth inside the left one.
        for i in 0..25 {
            agreed[(5 + i / 5) * width + 5 + i % 5].1 = 1.5;
        }
        retain_patches(&mut agreed, width, 0.1, |patch, _| patch.len() >= SMALLEST_PATCH);
        for (i, &(count, w)) in agreed.iter().enumerate() {
            let expected = match i % width {
                0..20 if w == 1.0 => 2,
                20..40 => 1,
                _ => 0,
            };
            assert_eq!(count, expected, "pixel {i}");
        }
    }
}
