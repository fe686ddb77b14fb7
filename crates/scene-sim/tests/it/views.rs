use super::depth;
use glam::DVec2;
use gs_scene::View;
use scene_sim::{Traced, demo_cameras, demo_scene, render_view, varied_cameras, varied_scene};

/// The demonstration's cameras in the order of the walk.
fn walk() -> Vec<View> {
    let traced = Traced::new(&demo_scene()).unwrap();
    let (context, held_out) = demo_cameras(240, 160).unwrap();
    assert_eq!((context.len(), held_out.len()), (6, 5));
    let mut cameras = context.clone();
    for (index, camera) in held_out.iter().enumerate() {
        cameras.insert(2 * index + 1, *camera);
    }
    cameras.iter().map(|camera| render_view(&traced, camera, 9, "view", 0).unwrap()).collect()
}

/// Colour at a point of the image, bilinear between pixel centres; `None` next to the border.
fn bilinear(view: &View, pixel: DVec2) -> Option<[f32; 3]> {
    let p = pixel - DVec2::splat(0.5);
    let (x, y) = (p.x.floor(), p.y.floor());
    let (width, height) = (view.camera().width() as f64, view.camera().height() as f64);
    if x < 0.0 || y < 0.0 || x + 2.0 > width || y + 2.0 > height {
        return None;
    }
    let (fx, fy) = ((p.x - x) as f32, (p.y - y) as f32);
    let at = |dx, dy| view.image().pixel(x as usize + dx, y as usize + dy);
    Some(std::array::from_fn(|c| {
        let top = at(0, 0)[c] * (1.0 - fx) + at(1, 0)[c] * fx;
        let bottom = at(0, 1)[c] * (1.0 - fx) + at(1, 1)[c] * fx;
        top * (1.0 - fy) + bottom * fy
    }))
}

/// Share of `a` that `b` sees too, and the mean colour difference there, if depths were `stretch` times what
/// they are.
fn compare(a: &View, b: &View, stretch: f64) -> (f64, f64) {
    let (mut seen, mut sum) = (0, 0.0);
    let width = a.camera().width();
    for (i, &z) in depth(a).data().iter().enumerate().filter(|(_, z)| **z > 0.0) {
        let (x, y) = (i % width, i / width);
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let world = a.camera().unproject(pixel, f64::from(z));
        let Some(target) = b.camera().project(world).filter(|p| b.camera().contains(*p)) else { continue };
        let there = depth(b).data()[target.y as usize * width + target.x as usize];
        let expected = b.camera().to_camera(world).z;
        if (f64::from(there) - expected).abs() > 0.02 * expected {
            continue;
        }
        let shifted = b.camera().project(a.camera().unproject(pixel, f64::from(z) * stretch));
        let Some(colour) = shifted.and_then(|p| bilinear(b, p)) else { continue };
        let own = a.image().pixel(x, y);
        seen += 1;
        sum += (0..3).map(|c| f64::from((own[c] - colour[c]).abs())).sum::<f64>() / 3.0;
    }
    let with_depth = depth(a).data().iter().filter(|z| **z > 0.0).count();
    (f64::from(seen) / with_depth as f64, sum / f64::from(seen))
}

#[test]
fn neighbouring_views_share_most_of_what_they_show_and_agree_by_depth() {
    let views = walk();
    for pair in views.iter().step_by(2).collect::<Vec<_>>().windows(2) {
        let (shared, difference) = compare(pair[0], pair[1], 1.0);
        assert!(shared > 0.7, "context views share only {shared:.2}");
        assert!(difference < 0.025, "pictures differ by {difference:.4} where both see the same");
        let (_, wrong) = compare(pair[0], pair[1], 1.05);
        assert!(wrong > 2.0 * difference, "5 % off in depth: {wrong:.4}, exact: {difference:.4}");
    }
    for (index, view) in views.iter().enumerate() {
        let coverage = depth(view).coverage();
        assert!((0.6..0.98).contains(&coverage), "view {index} shows sky on all but {coverage:.2}");
        let nearest = depth(view).data().iter().copied().filter(|d| *d > 0.0).fold(f32::INFINITY, f32::min);
        assert!(nearest > 0.8, "something stands {nearest} m before view {index}");
    }
}

#[test]
fn nothing_of_the_demonstration_is_dropped() {
    assert!(Traced::new(&demo_scene()).unwrap().dropped().is_empty());
}

#[test]
fn varied_scenes_are_different_sound_and_fit_for_stereo() {
    for seed in [0, 1, 2, 7, 13, 1 << 40] {
        let scene = varied_scene(seed);
        assert_eq!(scene, varied_scene(seed));
        assert_ne!(scene, varied_scene(seed + 1));
        let traced = Traced::new(&scene).unwrap();
        assert!(traced.dropped().is_empty());
        let cameras = varied_cameras(seed, 90, 60, 5).unwrap();
        let render = |camera| render_view(&traced, camera, 4, "view", 0).unwrap();
        let views: Vec<View> = cameras.iter().map(render).collect();
        for pair in views.windows(2) {
            let (shared, _) = compare(&pair[0], &pair[1], 1.0);
            assert!(shared > 0.7, "seed {seed}: neighbours share only {shared:.2}");
        }
        for view in &views {
            let depths = depth(view).data().iter().copied().filter(|d| *d > 0.0);
            let (near, far) = depths.fold((f32::MAX, 0f32), |(n, f), d| (n.min(d), f.max(d)));
            assert!(near > 0.8 && far > 1.5 * near, "seed {seed}: depths {near} to {far}");
            assert!(depth(view).coverage() > 0.5, "seed {seed}");
        }
    }
}
