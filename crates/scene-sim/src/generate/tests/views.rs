//! What the pictures of generated scenes show.

use super::{cameras, over, seeds, things};
use crate::generate::{Kind, generate};
use crate::trace::{PathRay, Traced};
use crate::{Scene, render_view};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, View};
use std::collections::BTreeSet;

const SIZE: (usize, usize) = (72, 48);

/// The points of the scene that a picture shows.
fn points(view: &View) -> Vec<DVec3> {
    let camera = view.camera();
    let depths = view.depth().unwrap().data().iter().enumerate().filter(|(_, depth)| **depth > 0.0);
    depths
        .map(|(k, depth)| {
            let pixel = DVec2::new((k % SIZE.0) as f64 + 0.5, (k / SIZE.0) as f64 + 0.5);
            camera.unproject(pixel, f64::from(*depth))
        })
        .collect()
}

/// The share of `points` that another camera sees too.
fn overlap(traced: &Traced, points: &[DVec3], camera: &Camera) -> f64 {
    let sees = |point: &&DVec3| {
        let ray =
            PathRay { origin: traced.relative(camera.position()), direction: **point - camera.position() };
        camera.project(**point).is_some_and(|pixel| camera.contains(pixel))
            && traced.nearest(&ray).is_some_and(|hit| hit.t > 0.98)
    };
    points.iter().filter(sees).count() as f64 / points.len() as f64
}

/// The share of pixels that differ from those to the right and below by less than two grey levels of a hundred.
fn textureless(view: &View) -> f64 {
    let luma = |x: usize, y: usize| view.image().pixel(x, y).iter().sum::<f32>() / 3.0;
    let inner = (0..SIZE.1 - 1).flat_map(|y| (0..SIZE.0 - 1).map(move |x| (x, y)));
    let even = inner.filter(|&(x, y)| {
        let steps = [luma(x + 1, y) - luma(x, y), luma(x, y + 1) - luma(x, y)];
        steps.iter().all(|step| step.abs() < 0.02)
    });
    even.count() as f64 / ((SIZE.0 - 1) * (SIZE.1 - 1)) as f64
}

/// Names of the things that a picture shows: of the boxes that hold a point, the smallest is taken for its thing.
fn names(scene: &Scene, points: &[DVec3]) -> usize {
    let things = things(scene);
    let slack = DVec3::splat(1e-3);
    let seen: BTreeSet<&str> = points
        .iter()
        .step_by(5)
        .filter_map(|point| {
            let holding = things.iter().filter(|thing| {
                (thing.low - slack).cmple(*point).all() && (thing.high + slack).cmpge(*point).all()
            });
            let volume = |extent: DVec3| extent.x * extent.y * extent.z;
            let smallest = holding.min_by(|a, b| volume(a.high - a.low).total_cmp(&volume(b.high - b.low)));
            smallest.map(|thing| thing.name.as_str())
        })
        .collect();
    seen.len()
}

#[test]
fn pictures_overlap_are_filled_and_have_both_detail_and_even_parts() {
    over(seeds(2), |kind, seed| {
        let mut scene = generate(kind, seed);
        let cameras = cameras(&scene, SIZE.0, SIZE.1);
        // What is asked of the pictures does not depend on what costs most rays.
        scene.sky.occlusion = None;
        scene.lamps.clear();
        let traced = Traced::new(&scene).unwrap();
        let render = |camera| render_view(&traced, camera, 1, "view", 0).unwrap();
        let views: Vec<View> = cameras.iter().map(render).collect();
        let mut faults = Vec::new();
        let mut fault = |holds: bool, what: String| faults.extend((!holds).then_some(what));

        let overlaps: Vec<f64> =
            views.windows(2).map(|pair| overlap(&traced, &points(&pair[0]), pair[1].camera())).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        fault((0.6..0.92).contains(&mean(&overlaps)), format!("neighbours overlap by {overlaps:.2?}"));
        fault(overlaps.iter().all(|share| *share > 0.5), format!("neighbours overlap by {overlaps:.2?}"));

        let least = if matches!(kind, Kind::Facade | Kind::Garden | Kind::Wood) { 0.5 } else { 0.95 };
        for (k, view) in views.iter().enumerate() {
            let coverage = view.depth().unwrap().coverage();
            fault(coverage > least, format!("picture {k} is filled by {coverage}"));
        }
        let even: Vec<f64> = views.iter().map(textureless).collect();
        // Without soft shadows in the corners a bare room is more even here than in its pictures.
        fault((0.05..0.75).contains(&mean(&even)), format!("even shares {even:.2?}"));
        let shown = views.iter().map(|view| names(&scene, &points(view))).max().unwrap();
        let sorts = if kind == Kind::Wood { 4 } else { 8 };
        fault(shown >= sorts, format!("{shown} sorts of things are seen"));
        faults
    });
}
