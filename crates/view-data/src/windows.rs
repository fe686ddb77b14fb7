//! Windows for a data set without an evaluation index: stretches of its path, context and held-out views in turn, or one about every frame.

use crate::overlap::shared;
use crate::{Dropped, Error, Result, SceneDepth, Window, select_views};
use gs_scene::Camera;

/// A context view is followed by the last frame that still shares this much of its content with it, 0..1.
const SHARED: f64 = 0.7;
/// Where the camera moves so fast that not even the next but one shares that much, this must do.
const LEAST_SHARED: f64 = 0.5;

/// Windows that begin at `count` places, evenly along the list of frames.
///
/// From its beginning a window walks along the list. The next context view is the last frame of a run of frames that share at
/// least 70 % of their content with the context view before it (in the sense of [`select_views`](crate::select_views), the
/// lower of the two directions), two frames on at least, so that a frame lies between; half-way between two context views lies
/// a target. A window ends at `context` views; it needs two, and one that finds fewer than `context` is listed as dropped.
/// Keys are `scene/0`, `scene/1`, ...
///
/// # Errors
/// If `context` is below 2, or the depths are not `0 < near <= median <= far`.
pub fn windows_along(
    scene: &str,
    cameras: &[Camera],
    context: usize,
    count: usize,
    depth: SceneDepth,
) -> Result<(Vec<Window>, Vec<Dropped>)> {
    if context < 2 {
        return Err(Error::NoViews);
    }
    depth.check()?;
    let (mut windows, mut dropped): (Vec<Window>, _) = (Vec::new(), Vec::new());
    // Windows that begin at one frame would be one.
    let count = count.min(cameras.len());
    for number in 0..count {
        let chosen = walk(cameras, number * cameras.len() / count, context, depth);
        let key = format!("{scene}/{number}");
        if chosen.len() < context {
            let (first, found) = (chosen[0], chosen.len());
            let reason = format!(
                "from frame {first} on the views overlap for {found} context views only, expected {context}"
            );
            dropped.push(Dropped { key, reason });
            continue;
        }
        let target = chosen.windows(2).map(|pair| pair[0].midpoint(pair[1])).collect();
        windows.push(Window { key, scene: scene.to_owned(), context: chosen, target });
    }
    Ok((windows, dropped))
}

/// A window about every frame, for training: near together and far apart. Frames need not lie in the order of a path.
///
/// The frames about one are those that share most of their content with it (the lower of the two directions): twice `context` of them
/// about every other frame, three times `context` about the rest. [`select_views`] chooses the context among them, and its targets are
/// the window's. Windows with a context that is there already are left out. Keys are `scene/frame`.
///
/// # Errors
/// If `context` is below 2, or the depths are not `0 < near <= median <= far`.
pub fn windows_around(
    scene: &str,
    cameras: &[Camera],
    context: usize,
    depth: SceneDepth,
) -> Result<(Vec<Window>, Vec<Dropped>)> {
    if context < 2 {
        return Err(Error::NoViews);
    }
    depth.check()?;
    let (mut windows, mut dropped): (Vec<Window>, _) = (Vec::new(), Vec::new());
    for frame in 0..cameras.len() {
        let key = format!("{scene}/{frame}");
        let share = |other: usize| {
            let [a, b] = [&cameras[frame], &cameras[other]];
            shared(a, b, depth).min(shared(b, a, depth))
        };
        let mut others: Vec<(f64, usize)> =
            (0..cameras.len()).filter(|other| *other != frame).map(|other| (share(other), other)).collect();
        others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let most = context * (2 + frame % 2);
        let mut about: Vec<usize> =
            others.iter().take(most - 1).map(|(_, other)| *other).chain([frame]).collect();
        about.sort_unstable();
        let near: Vec<Camera> = about.iter().map(|index| cameras[*index]).collect();
        let selection = match select_views(&near, context, depth) {
            Ok(selection) if selection.targets.is_empty() => {
                dropped.push(Dropped { key, reason: "no frame lies between its context views".to_owned() });
                continue;
            }
            Ok(selection) => selection,
            Err(error) => {
                dropped.push(Dropped { key, reason: error.to_string() });
                continue;
            }
        };
        let [chosen, target] = [selection.context, selection.targets]
            .map(|positions| positions.into_iter().map(|i| about[i]).collect());
        if windows.iter().all(|window| window.context != chosen) {
            windows.push(Window { key, scene: scene.to_owned(), context: chosen, target });
        }
    }
    Ok((windows, dropped))
}

/// Context views from a frame on, `most` of them unless they lose sight of each other before.
fn walk(cameras: &[Camera], start: usize, most: usize, depth: SceneDepth) -> Vec<usize> {
    let mut chosen = vec![start];
    while chosen.len() < most {
        let last = chosen[chosen.len() - 1];
        let share = |next: usize| {
            cameras.get(next).map_or(0.0, |next| {
                let last = &cameras[last];
                shared(last, next, depth).min(shared(next, last, depth))
            })
        };
        let run = (last + 1..cameras.len()).take_while(|next| share(*next) >= SHARED).count();
        let next = if run >= 2 { last + run } else { last + 2 };
        if share(next) < LEAST_SHARED {
            break;
        }
        chosen.push(next);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_scene::Intrinsics;

    fn walk_along(step: f64, count: usize) -> Vec<Camera> {
        let lens = Intrinsics { fx: 100.0, fy: 100.0, cx: 80.0, cy: 60.0, width: 160, height: 120 };
        (0..count)
            .map(|i| {
                let x = i as f64 * step;
                Camera::looking_at(lens, DVec3::new(x, 0.0, 0.0), DVec3::new(x, 4.0, 0.0), DVec3::Z).unwrap()
            })
            .collect()
    }

    const DEPTH: SceneDepth = SceneDepth { near: 3.0, median: 4.0, far: 6.0 };

    #[test]
    fn context_and_targets_take_turns_and_overlap() {
        let cameras = walk_along(0.05, 1000);
        let (windows, dropped) = windows_along("hall", &cameras, 6, 4, DEPTH).unwrap();
        assert_eq!((windows.len(), dropped.len()), (4, 0));
        for (number, window) in windows.iter().enumerate() {
            assert_eq!((window.key.as_str(), window.context[0]), (&*format!("hall/{number}"), number * 250));
            assert_eq!((window.context.len(), window.target.len()), (6, 5));
            for (pair, &target) in window.context.windows(2).zip(&window.target) {
                assert!(pair[0] < target && target < pair[1]);
                let [a, b] = [pair[0], pair[1]].map(|i| &cameras[i]);
                assert!(shared(a, b, DEPTH) >= SHARED && shared(a, &cameras[pair[1] + 1], DEPTH) < SHARED);
            }
        }
    }

    #[test]
    fn fast_cameras_and_ends_of_the_path() {
        // Steps of half a picture: neighbours share too little.
        let (windows, dropped) = windows_along("run", &walk_along(3.2, 40), 6, 2, DEPTH).unwrap();
        assert!(windows.is_empty());
        assert_eq!(
            dropped[0].reason,
            "from frame 0 on the views overlap for 1 context views only, expected 6"
        );
        // The frame between is kept although only the next one shares 70 %.
        let (windows, _) = windows_along("jog", &walk_along(0.8, 40), 3, 1, DEPTH).unwrap();
        assert_eq!(
            (windows[0].context.as_slice(), windows[0].target.as_slice()),
            (&[0, 2, 4][..], &[1, 3][..])
        );
        for (count, cameras) in [(3, 0), (0, 5), (9, 1)] {
            let (windows, _) = windows_along("few", &walk_along(0.1, cameras), 2, count, DEPTH).unwrap();
            assert!(windows.is_empty());
        }
        assert!(windows_along("one", &walk_along(0.1, 9), 1, 1, DEPTH).is_err());
    }

    #[test]
    fn windows_about_frames_are_connected_and_found_in_any_order() {
        let cameras = walk_along(0.3, 60);
        let (windows, dropped) = windows_around("hall", &cameras, 4, DEPTH).unwrap();
        assert!(windows.len() > 30 && dropped.is_empty(), "{} {dropped:?}", windows.len());
        let mut lengths = Vec::new();
        for window in &windows {
            assert_eq!(window.context.len(), 4);
            let held_out = |target: &usize| !window.context.contains(target);
            assert!(!window.target.is_empty() && window.target.iter().all(held_out));
            for pair in window.context.windows(2) {
                assert!(shared(&cameras[pair[0]], &cameras[pair[1]], DEPTH) >= 0.5);
            }
            lengths.push(window.context[3] - window.context[0]);
        }
        assert!(lengths.iter().min() < lengths.iter().max(), "near together and far apart: {lengths:?}");
        // Frames in another order: many of the same windows; a frame takes more or fewer neighbours by its place in the list.
        let turned = |index: usize| (index * 7) % 60;
        let mut mixed = cameras.clone();
        (0..60).for_each(|index| mixed[turned(index)] = cameras[index]);
        let (others, _) = windows_around("hall", &mixed, 4, DEPTH).unwrap();
        let shared = |window: &Window| {
            others.iter().any(|other| {
                let mut there: Vec<usize> = window.context.iter().map(|index| turned(*index)).collect();
                there.sort_unstable();
                there == other.context
            })
        };
        assert!(windows.iter().filter(|window| shared(window)).count() > 10);
    }

    #[test]
    fn frames_without_company_are_told() {
        let far = walk_along(40.0, 5);
        let (windows, dropped) = windows_around("far", &far, 2, DEPTH).unwrap();
        assert_eq!((windows.len(), dropped.len()), (0, 5));
        // As many frames as context views: none is left to compare with.
        let (windows, dropped) = windows_around("few", &walk_along(0.1, 3), 3, DEPTH).unwrap();
        assert!(windows.is_empty() && dropped[0].reason.contains("between"), "{dropped:?}");
        assert_eq!(windows_around("none", &[], 2, DEPTH).unwrap(), (vec![], vec![]));
        assert!(windows_around("one", &far, 1, DEPTH).is_err());
    }
}
