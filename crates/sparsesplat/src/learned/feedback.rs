//! Feedback: the closed form is rendered into the photographs that it was made of, and each anchor is told how its Gaussian does there.
//! The paper's head sees no rendering; docs/training.md has what this is worth. Rendered is on the CPU, whatever renders the result, so
//! that a prediction does not depend on the graphics adapter.
//!
//! With e = photograph - rendering (both in the common exposure) and w the share that the Gaussian has in a pixel, summed over the
//! pixels of the anchor's own view, and over those of all others:
//!
//! | numbers | what | tells |
//! |---|---|---|
//! | 1 | ½ ln(Σ w / area + 0.01), area that of the anchor's cell in pixels | whether it is seen at all |
//! | 1 | 4 (Σ w ∣e∣² / W)^½, W = Σ w + area / 10 | how wrong the picture is where it is seen |
//! | 3 | 6 Σ w e / W, rgb | which colour is missing there |
//! | 1 | 60 / W times the descent by the logit of its opacity | whether it is in the way |
//! | 3 | 10 / W times the descent by the logarithms of its scales | whether it is too large |
//! | 3 | 10 / W times the descent by its mean, in its camera's axes and units of its spacing | where it should be |
//!
//! Descent is that of ½ Σ ∣e∣². The factors bring all to the order of 1, and none is above 3.

use crate::Result;
use crate::anchored::Anchored;
use glam::Vec3;
use gs_raster::{PixelGradients, Rasterizer, RenderSettings, near_plane};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, SH_C0};

/// Numbers by the pixels of the own view, and as many by those of the others.
const OF_PART: usize = 12;
/// Numbers per anchor.
pub(super) const FEEDBACK: usize = 2 * OF_PART;
/// None of them is larger.
const LARGEST: f32 = 3.0;
/// Share of the cell's area that is added to Σ w: what is hardly seen is told little.
const AREA_SHARE: f32 = 0.1;

/// Sums over pixels.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    weight: f32,
    squared_error: f32,
    error: Vec3,
    by_opacity: f32,
    by_scale: Vec3,
    by_mean: Vec3,
}

/// Feedback `[n, FEEDBACK]` on the closed form of the anchors.
///
/// # Errors
/// If the closed form cannot be rendered: it covers more tiles of the pictures than memory can hold.
pub(super) fn feedback(anchored: &Anchored) -> Result<Vec<f32>> {
    let mut scene = anchored.base.clone();
    scene.append(&anchored.shell);
    let mut rasterizer = Rasterizer::cpu();
    let mut sums = vec![[Sums::default(); 2]; anchored.base.len()];
    for (index, view) in anchored.views.iter().enumerate() {
        let camera = std::slice::from_ref(view.camera());
        let near = near_plane(&anchored.base, view.camera());
        let (rendered, tape) =
            rasterizer.record(&scene, camera, &RenderSettings { near, ..RenderSettings::default() })?;
        let rendered = rendered[0].image.data();
        let error: Vec<f32> =
            view.image().data().iter().zip(rendered).map(|(photograph, r)| photograph - r).collect();
        // What a pixel sends back to a colour is multiplied by w: of 1 there remains Σ w.
        let counts = error.chunks_exact(3).flat_map(|e| [1.0, e.iter().map(|e| e * e).sum(), 0.0]).collect();
        let pixels = |image| [PixelGradients { image, alpha: None, depth: None }];
        let by_error = rasterizer.backward(&scene, &tape, &pixels(error))?;
        let by_counts = rasterizer.backward(&scene, &tape, &pixels(counts))?;
        let rows = by_error.geometry.chunks_exact(Gaussians::GEOMETRY);
        let rows = rows.zip(by_error.sh.chunks_exact(3)).zip(by_counts.sh.chunks_exact(3));
        for (((geometry, colour), counts), (sums, &own)) in
            rows.zip(sums.iter_mut().zip(&anchored.anchors.views))
        {
            let sums = &mut sums[usize::from(own as usize != index)];
            sums.weight += counts[0] / SH_C0;
            sums.squared_error += counts[1] / SH_C0;
            sums.error += Vec3::from_slice(colour) / SH_C0;
            sums.by_opacity += geometry[OPACITY_LOGIT];
            sums.by_scale += Vec3::from_slice(&geometry[LOG_SCALE]);
            sums.by_mean += Vec3::from_slice(&geometry[MEAN]);
        }
    }
    let of_anchor = |(anchor, sums): (usize, [Sums; 2])| {
        let view = &anchored.views[anchored.anchors.views[anchor] as usize];
        let to_camera = view.camera().rotation().as_mat3() * anchored.spacing[anchor];
        sums.into_iter()
            .flat_map(move |sums| numbers(sums, anchored.cells[anchor].area, to_camera * sums.by_mean))
    };
    Ok(sums.into_iter().enumerate().flat_map(of_anchor).collect())
}

/// The numbers of one part; `area` is that of the anchor's cell in pixels, `step` the descent by its mean, in its own axes and unit.
fn numbers(sums: Sums, area: f32, step: Vec3) -> [f32; OF_PART] {
    let area = area.max(1.0);
    let per = 1.0 / (sums.weight + AREA_SHARE * area);
    let seen = 0.5 * (sums.weight / area + 0.01).ln();
    let wrong = 4.0 * (sums.squared_error * per).sqrt();
    let (colour, scale, step) = (6.0 * per * sums.error, 10.0 * per * sums.by_scale, 10.0 * per * step);
    let opacity = 60.0 * per * sums.by_opacity;
    let numbers = [
        seen, wrong, colour.x, colour.y, colour.z, opacity, scale.x, scale.y, scale.z, step.x, step.y, step.z,
    ];
    numbers.map(|number| number.clamp(-LARGEST, LARGEST))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Backbone, Budget, Config, StageSeconds, Wanted, anchor, geometry};
    use glam::DVec3;
    use gs_scene::{Camera, DepthMap, View};
    use scene_sim::{Traced, demo_cameras, demo_scene, render_view};
    use std::sync::LazyLock;

    static COURTYARD: LazyLock<Vec<View>> = LazyLock::new(|| {
        let scene = Traced::new(&demo_scene()).unwrap();
        let cameras = demo_cameras(60, 40).unwrap().0;
        cameras[..3].iter().map(|camera| render_view(&scene, camera, 2, "v", 0).unwrap()).collect()
    });

    fn anchored(views: &[View]) -> Anchored {
        let config =
            Config { backbone: Backbone::GivenDepth, budget: Budget::Gaussians(400), ..Config::default() };
        let (geometry, range) = geometry(views, &config, Wanted::Depth).unwrap();
        anchor(views, &geometry, range.1, &config, &mut StageSeconds::default(), &mut |_| {}).unwrap()
    }

    /// Photographs are what the closed form looks like, and `add` besides.
    fn photograph_itself(anchored: &mut Anchored, add: [f32; 3]) {
        let mut scene = anchored.base.clone();
        scene.append(&anchored.shell);
        for view in &mut anchored.views {
            let near = near_plane(&anchored.base, view.camera());
            let settings = RenderSettings { near, ..RenderSettings::default() };
            let rendered = Rasterizer::cpu().render(&scene, view.camera(), &settings).unwrap();
            let values = rendered.image.data().iter().zip(add.into_iter().cycle());
            view.image_mut().data_mut().iter_mut().zip(values).for_each(|(to, (a, b))| *to = a + b);
        }
    }

    fn parts(features: &[f32]) -> impl Iterator<Item = &[f32; OF_PART]> {
        features.as_chunks().0.iter()
    }

    #[test]
    fn where_nothing_is_wrong_nothing_is_said() {
        let mut anchored = anchored(&COURTYARD);
        photograph_itself(&mut anchored, [0.0; 3]);
        let found = feedback(&anchored).unwrap();
        assert_eq!(found.len(), anchored.base.len() * FEEDBACK);
        assert!(parts(&found).all(|part| part[1..].iter().all(|x| *x == 0.0)));
        assert!(parts(&found).any(|part| part[0] > -0.5), "some are seen");
    }

    #[test]
    fn a_colour_that_is_missing_everywhere_is_missing_at_every_anchor_that_is_seen() {
        let mut anchored = anchored(&COURTYARD);
        photograph_itself(&mut anchored, [0.1, 0.0, -0.05]);
        let found = feedback(&anchored).unwrap();
        let (mut pixels, cells) = (0.0, anchored.cells.iter().flat_map(|cell| [cell.area; 2]));
        for (part, area) in parts(&found).zip(cells) {
            let area = area.max(1.0);
            let weight = area * ((2.0 * part[0]).exp() - 0.01);
            let share = weight / (weight + AREA_SHARE * area);
            let expected = [4.0 * (0.0125 * share).max(0.0).sqrt(), 0.6 * share, 0.0, -0.3 * share];
            for (found, expected) in part[1..].iter().zip(expected) {
                assert!((found - expected).abs() < 2e-3, "{part:?}, expected {expected:?}");
            }
            pixels += weight;
        }
        // No pixel is given away twice.
        assert!(pixels > 0.5 * 7200.0 && pixels < 7200.0 + 1.0, "{pixels}");
    }

    #[test]
    fn what_was_changed_is_to_be_changed_back() {
        let mut honest = anchored(&COURTYARD);
        photograph_itself(&mut honest, [0.0; 3]);
        let visible =
            parts(&feedback(&honest).unwrap()).step_by(2).map(|own| own[0] > -0.7).collect::<Vec<_>>();
        let mut looked_at = 0;
        for anchor in (0..honest.base.len()).step_by(29).filter(|&anchor| visible[anchor]) {
            let camera = *honest.views[honest.anchors.views[anchor] as usize].camera();
            for (number, column, change) in [
                (5, OPACITY_LOGIT, 0.5),
                (6, LOG_SCALE.start, 0.2),
                (7, LOG_SCALE.start + 1, -0.2),
                (9, MEAN.start, 0.2),
                (10, MEAN.start, 0.2),
            ] {
                let mut changed = honest.clone();
                let row = &mut changed.base.buffers_mut().0[anchor * Gaussians::GEOMETRY..];
                if column == MEAN.start {
                    // To the right and down in the picture, in units of the spacing.
                    let axis = camera.rotation().row(number - 9).as_vec3() * honest.spacing[anchor];
                    (0..3).for_each(|i| row[MEAN][i] += change * axis[i]);
                } else {
                    row[column] += change;
                }
                let found = feedback(&changed).unwrap()[anchor * FEEDBACK + number];
                assert!(found * change < 0.0, "anchor {anchor}, number {number}: {found} after {change}");
                looked_at += 1;
            }
        }
        assert!(looked_at >= 25, "{looked_at}");
    }

    #[test]
    fn a_scene_that_is_scaled_is_told_the_same() {
        let scaled = |view: &View| {
            let camera = view.camera();
            let position: DVec3 = camera.position() * 8.0;
            let camera =
                Camera::new(*camera.intrinsics(), camera.rotation(), -(camera.rotation() * position))
                    .unwrap();
            let depth = view.depth().unwrap().data().iter().map(|d| d * 8.0).collect();
            let depth = DepthMap::new(camera.width(), camera.height(), depth).unwrap();
            View::new(view.name(), view.image().clone(), camera, Some(depth)).unwrap()
        };
        let scaled: Vec<View> = COURTYARD.iter().map(scaled).collect();
        let [before, after] = [&COURTYARD[..], &scaled].map(|views| feedback(&anchored(views)).unwrap());
        assert_eq!(before.len(), after.len());
        for (before, after) in before.iter().zip(&after) {
            assert!((before - after).abs() < 1e-2, "{before} {after}");
        }
    }
}
