//! The choice of views, and the depth guessed from poses.

use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Intrinsics};
use proptest::prelude::*;
use view_data::{Error, SceneDepth, estimate_scene_depth, select_views};

const LENS: Intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 160.0, cy: 120.0, width: 320, height: 240 };
const DEPTH: SceneDepth = SceneDepth { near: 4.0, median: 5.0, far: 7.0 };

/// A camera at `position` that looks along +z.
fn ahead(position: DVec3) -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, -position).unwrap()
}

/// Cameras on a line, `step` apart; at depth 5 the picture is 5.3 wide.
fn line(count: usize, step: f64) -> Vec<Camera> {
    (0..count).map(|i| ahead(DVec3::new(i as f64 * step, 0.0, 0.0))).collect()
}

/// Cameras on an arc of `degrees` around the origin, at distance 5.
fn arc(count: usize, degrees: f64) -> Vec<Camera> {
    let at = |i: usize| (degrees * i as f64 / (count - 1) as f64).to_radians();
    let camera = |i| {
        let position = 5.0 * DVec3::new(at(i).sin(), -0.2, -at(i).cos());
        Camera::looking_at(LENS, position, DVec3::ZERO, DVec3::NEG_Y).unwrap()
    };
    (0..count).map(camera).collect()
}

/// Share of what `viewed` shows that `viewer` sees, by the definition in the documentation, on a finer grid.
fn share(viewer: &Camera, viewed: &Camera, depth: SceneDepth) -> f64 {
    let mut seen = 0;
    let between = |a: f64, b: f64| 2.0 / (1.0 / a + 1.0 / b);
    for depth in [between(depth.near, depth.median), depth.median, between(depth.median, depth.far)] {
        for i in 0..24 * 24 {
            let cell = DVec2::new(f64::from(i % 24) + 0.5, f64::from(i / 24) + 0.5) / 24.0;
            let point = viewed.unproject(cell * DVec2::new(320.0, 240.0), depth);
            let angle = (point - viewed.position()).angle_between(point - viewer.position());
            let inside = viewer.project(point).is_some_and(|pixel| viewer.contains(pixel));
            seen += usize::from(inside && angle.to_degrees() <= 25.0);
        }
    }
    seen as f64 / (3.0 * 24.0 * 24.0)
}

#[test]
fn a_line_is_covered_end_to_end_and_targets_lie_between() {
    let cameras = line(29, 0.5);
    let selection = select_views(&cameras, 6, DEPTH).unwrap();
    assert_eq!(selection.context.len(), 6);
    for &view in &selection.context {
        let others = selection.context.iter().filter(|&&other| other != view);
        let best = others.map(|&other| share(&cameras[other], &cameras[view], DEPTH)).fold(0.0, f64::max);
        assert!(best > 0.45, "{view} shares only {best}");
    }
    // Five links of four steps and as much covered beyond either end. Five steps, 2.5, are less than half a picture,
    // but too many of the near points are then seen more than 25 degrees apart.
    assert_eq!(selection.uncovered, 0.0);
    let (first, last) = (selection.context[0], selection.context[5]);
    assert!(selection.targets.iter().all(|target| (first..last).contains(target)));
    assert_eq!(selection.targets.len(), last - first + 1 - 6);
    // A longer line cannot be covered by as few.
    let uncovered = select_views(&line(90, 0.5), 6, DEPTH).unwrap().uncovered;
    assert!((uncovered - 61.0 / 90.0).abs() < 1e-12, "{uncovered}");
}

#[test]
fn the_definition_of_sharing_is_the_documented_one() {
    let cameras = arc(40, 200.0);
    for n in [2, 5, 9] {
        let selection = select_views(&cameras, n, DEPTH).unwrap();
        let shares_half = |view: usize, chosen: &[usize]| {
            let others = chosen.iter().filter(|&&other| other != view);
            others.map(|&other| share(&cameras[other], &cameras[view], DEPTH)).fold(0.0, f64::max)
        };
        assert!(selection.context.iter().all(|&view| shares_half(view, &selection.context) > 0.45));
        // The grid is coarse: frames within 0.05 of half count either way.
        let is_free = |view: &usize| !selection.context.contains(view);
        let shares: Vec<f64> =
            (0..40).filter(is_free).map(|view| shares_half(view, &selection.context)).collect();
        let at_least = shares.iter().filter(|&&share| share < 0.45).count() as f64 / 40.0;
        let at_most = shares.iter().filter(|&&share| share < 0.55).count() as f64 / 40.0;
        let uncovered = selection.uncovered;
        assert!(
            at_least - 1e-9 <= uncovered && uncovered <= at_most + 1e-9,
            "{at_least} {uncovered} {at_most}"
        );
    }
}

#[test]
fn what_cannot_be_chosen_is_said() {
    let cameras = line(4, 0.5);
    assert!(matches!(select_views(&cameras, 0, DEPTH), Err(Error::NoViews)));
    assert!(matches!(select_views(&cameras, 5, DEPTH), Err(Error::TooFewFrames { wanted: 5, frames: 4 })));
    assert!(matches!(select_views(&[], 1, DEPTH), Err(Error::TooFewFrames { .. })));
    for (near, median, far) in
        [(0.0, 1.0, 2.0), (1.0, f64::NAN, 2.0), (2.0, 1.0, 3.0), (1.0, 2.0, f64::INFINITY)]
    {
        let error = select_views(&cameras, 2, SceneDepth { near, median, far }).unwrap_err();
        assert!(matches!(error, Error::SceneDepth { .. }), "{error}");
    }
    // Two groups that see nothing of each other, of three and five.
    let far_away = |i: usize| ahead(DVec3::new(1e4 + i as f64 * 0.5, 0.0, 0.0));
    let groups: Vec<Camera> = line(3, 0.5).into_iter().chain((0..5).map(far_away)).collect();
    let message = select_views(&groups, 6, DEPTH).unwrap_err().to_string();
    assert!(message.starts_with("6 views asked for, but at most 5 frames are connected"), "{message}");
    assert!(message.contains("ask for at most 5"), "{message}");
    assert_eq!(select_views(&groups, 5, DEPTH).unwrap().context, [3, 4, 5, 6, 7]);
    // A group that no evenly spread start hits.
    let lone = |i: usize| ahead(DVec3::new(100.0 * i as f64, 0.0, 0.0));
    let mut scattered: Vec<Camera> = (0..128).map(lone).collect();
    (scattered[62], scattered[63]) = (lone(61), lone(61));
    assert_eq!(select_views(&scattered, 3, DEPTH).unwrap().context, [61, 62, 63]);
    assert!(matches!(select_views(&scattered, 4, DEPTH), Err(Error::Disconnected { connected: 3, .. })));
    // Back to back.
    let apart = [
        ahead(DVec3::ZERO),
        Camera::new(LENS, DMat3::from_rotation_y(std::f64::consts::PI), DVec3::ZERO).unwrap(),
    ];
    assert!(matches!(select_views(&apart, 2, DEPTH), Err(Error::Disconnected { connected: 1, .. })));
}

#[test]
fn one_view_and_all_views_are_selections_too() {
    let cameras = line(9, 1.0);
    let one = select_views(&cameras, 1, DEPTH).unwrap();
    assert_eq!((one.context, one.targets), (vec![4], vec![]));
    let all = select_views(&cameras, 9, DEPTH).unwrap();
    assert_eq!((all.context, all.targets, all.uncovered), ((0..9).collect(), vec![], 0.0));
    // The same camera many times: the lowest positions.
    let same = vec![ahead(DVec3::ZERO); 5];
    assert_eq!(select_views(&same, 3, DEPTH).unwrap().context, [0, 1, 2]);
}

#[test]
fn the_selection_does_not_depend_on_threads_or_on_where_the_origin_is() {
    let cameras = arc(60, 300.0);
    let choose = |threads, cameras: &[Camera]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| select_views(cameras, 7, DEPTH)).unwrap()
    };
    assert_eq!(choose(1, &cameras), choose(4, &cameras));
    let moved = |camera: &Camera| {
        let axes = camera.rotation().transpose();
        Camera::from_camera_to_world(LENS, axes, camera.position() + DVec3::splat(1e4)).unwrap()
    };
    let moved: Vec<Camera> = cameras.iter().map(moved).collect();
    assert_eq!(choose(2, &cameras).context, choose(2, &moved).context);
}

#[test]
fn depth_is_where_the_axes_meet_or_a_multiple_of_the_spread() {
    let estimate = |cameras: &[Camera]| estimate_scene_depth(cameras).map(|depth| depth.median);
    let distance = 5.0 * (1.0_f64 + 0.04).sqrt();
    for degrees in [40.0, 120.0, 320.0] {
        let found = estimate(&arc(20, degrees)).unwrap();
        assert!((found - distance).abs() < 1e-9, "{degrees}: {found}");
    }
    // Parallel axes: positions -1 and 1 and their like spread by 1.
    let spread = |cameras: &[Camera]| estimate(cameras).unwrap();
    assert!((spread(&line(2, 2.0)) - 2.0).abs() < 1e-12);
    // A long walk: 30 steps.
    assert!((spread(&line(1000, 0.5)) - 15.0).abs() < 1e-12);
    // Looking outwards from a ring, the axes meet behind.
    let outward: Vec<Camera> = (0..12)
        .map(|i| {
            let direction = DMat3::from_rotation_y(f64::from(i) * std::f64::consts::TAU / 12.0) * DVec3::Z;
            Camera::looking_at(LENS, direction, direction * 2.0, DVec3::NEG_Y).unwrap()
        })
        .collect();
    assert!((spread(&outward) - 2.0).abs() < 1e-9);
    assert_eq!(estimate(&[]), None);
    assert_eq!(estimate(&line(1, 1.0)), None);
    assert_eq!(estimate(&vec![ahead(DVec3::ONE); 6]), None);
}

proptest! {
    #[test]
    fn any_cameras_give_a_selection_or_an_error(
        poses in prop::collection::vec((prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-2.0..2.0f64)), 1..12),
        n in 0usize..8, scale in prop::sample::select(vec![1e-9, 1.0, 1e9, 1e150]),
    ) {
        let camera = |&(angles, offset): &([f64; 3], [f64; 3])| {
            let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0] * 0.1, angles[1] * 0.1, angles[2]);
            Camera::new(LENS, rotation, DVec3::from(offset) * scale).unwrap()
        };
        let cameras: Vec<Camera> = poses.iter().map(camera).collect();
        if let Some(depth) = estimate_scene_depth(&cameras) {
            prop_assert!(depth.near > 0.0 && depth.near < depth.median && depth.median < depth.far && depth.far.is_finite());
            if let Ok(selection) = select_views(&cameras, n, depth) {
                prop_assert_eq!(selection.context.len(), n);
                prop_assert!(selection.context.is_sorted() && selection.targets.is_sorted());
                prop_assert!(selection.targets.iter().all(|target| !selection.context.contains(target)));
                prop_assert!((0.0..1.0).contains(&selection.uncovered));
            }
        }
    }
}
