use super::{SUN, body, camera, depth, luma, scene, view};
use glam::DVec3;
use scene_sim::{Pattern, Shape};

fn foliage(cover: f32) -> Pattern {
    Pattern::Foliage { dark: [0.1, 0.2, 0.05], light: [0.4, 0.7, 0.2], leaf: 0.1, cover }
}

#[test]
fn the_eye_passes_through_the_holes_and_meets_the_leaves() {
    for (cover, low, high) in [(0.0, 0.0, 0.0), (0.6, 0.54, 0.66), (1.0, 1.0, 1.0)] {
        let mut hedge =
            body("hedge", Shape::Rectangle { width: 30.0, height: 30.0 }, DVec3::Y * 4.0, foliage(cover));
        hedge.rotation.x = 90.0;
        let coverage = depth(&view(&scene(vec![hedge], None), &camera(DVec3::ZERO, DVec3::Y))).coverage();
        assert!((low..=high).contains(&coverage), "{coverage} of the picture are leaves, asked for {cover}");
    }
}

#[test]
fn leaves_cast_a_shadow_with_their_holes() {
    let white = Pattern::Plain { colour: [1.0; 3] };
    let floor = body("floor", Shape::Rectangle { width: 20.0, height: 20.0 }, DVec3::ZERO, white);
    let ceiling = Shape::Rectangle { width: 60.0, height: 60.0 };
    let lit_share = |cover| {
        let roof = body("leaves", ceiling, DVec3::Z * 3.0, foliage(cover));
        let lit = scene_sim::Scene {
            sky: scene_sim::Sky { light: 0.0, ..super::SKY },
            ..scene(vec![floor.clone(), roof], Some(SUN))
        };
        let view = view(&lit, &camera(DVec3::new(0.0, -1.0, 1.5), DVec3::ZERO));
        let shown = depth(&view).data().iter().enumerate().filter(|(_, d)| **d > 0.0);
        let (count, lit) = shown.fold((0, 0), |(count, lit), (i, _)| {
            (count + 1, lit + usize::from(luma(view.image().pixel(i % 61, i / 61)) > 0.1))
        });
        f64::from(lit as u32) / f64::from(count)
    };
    assert!(lit_share(1.0) < 1e-9);
    let half = lit_share(0.6);
    // A pixel with one lit sample of four counts as lit.
    assert!(half > 0.3 && half < 0.75, "{half} of the floor has light");
    assert!(lit_share(0.0) > 0.999);
}
