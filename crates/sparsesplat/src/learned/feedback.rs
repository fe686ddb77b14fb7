//! Feedback: the closed form is rendered into the photographs that it was made of, and each anchor is told how its Gaussian does there. A corrector
//! is told the same of a refined scene.
//! The paper's head sees no rendering; docs/training.md has what this is worth. The CPU renders it, whatever renders the result, so that a
//! prediction does not depend on the graphics adapter.
//!
//! With e = photograph - rendering (both in the exposure of the scene) and w the share that the Gaussian has in a pixel, summed over the
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
//! Descent is that of ½ Σ ∣e∣². The factors bring all to the order of 1, and none is beyond ±3.

use crate::anchored::Anchored;
use crate::{Error, Result};
use glam::Vec3;
use gs_raster::{Gradients, PixelGradients, Rasterizer, RenderSettings, near_plane};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, SH_C0, View, sh_coefficients};
use rayon::prelude::*;

/// Numbers by the pixels of the own view, and as many by those of the others.
const OF_PART: usize = 12;
/// Numbers per anchor.
pub(super) const FEEDBACK: usize = 2 * OF_PART;
/// None of them is farther from 0.
const LARGEST: f32 = 3.0;
/// Colours are drawn no darker than this: one that is cut at 0 would have no gradient, from which Σ w e is read.
const DARKEST: f32 = 1e-4;
/// Views that are rendered side by side, as many as the renderer walks back at once.
const AT_ONCE: usize = 2;
/// Anchors per parallel task.
const ROWS: usize = 4096;
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

/// Feedback `[n, FEEDBACK]` on the closed form of the anchors, or on the refined scene that has taken its place. `views` are those of the anchors, in
/// the exposure of the scene.
///
/// # Errors
/// If the scene covers more tiles of a picture than the renderer takes.
pub(super) fn feedback(anchored: &Anchored, views: &[View]) -> Result<Vec<f32>> {
    let scene = rendered(anchored);
    let width = 3 * sh_coefficients(scene.sh_degree());
    let mut rasterizers: [Rasterizer; AT_ONCE] = std::array::from_fn(|_| Rasterizer::cpu());
    let mut sums = vec![[Sums::default(); 2]; anchored.base.len()];
    for (first, views) in (0..).step_by(AT_ONCE).zip(views.chunks(AT_ONCE)) {
        let work = views.par_iter().zip(&mut rasterizers);
        let found: Vec<_> =
            work.map(|(view, rasterizer)| descent(&scene, &anchored.base, view, rasterizer)).collect();
        for (index, found) in (first..).zip(found) {
            let (gradients, shares) = found?;
            let rows = gradients.geometry.par_chunks_exact(Gaussians::GEOMETRY);
            let rows = rows.zip(gradients.sh.par_chunks_exact(width)).zip(&shares);
            let sums = sums.par_iter_mut().with_min_len(ROWS).zip(&anchored.anchors.views);
            sums.zip(rows).for_each(|((sums, &home), ((geometry, colour), [weight, squared_error]))| {
                let sums = &mut sums[usize::from(home as usize != index)];
                sums.weight += weight;
                sums.squared_error += squared_error;
                sums.error += Vec3::from_slice(&colour[..3]) / SH_C0;
                sums.by_opacity += geometry[OPACITY_LOGIT];
                sums.by_scale += Vec3::from_slice(&geometry[LOG_SCALE]);
                sums.by_mean += Vec3::from_slice(&geometry[MEAN]);
            });
        }
    }
    let mut told = vec![0.0; sums.len() * FEEDBACK];
    let rows = told.par_chunks_exact_mut(FEEDBACK).with_min_len(ROWS);
    rows.zip(&sums).enumerate().for_each(|(anchor, (told, sums))| {
        let view = &anchored.views[anchored.anchors.views[anchor] as usize];
        let to_camera = view.camera().rotation().as_mat3() * anchored.spacing[anchor];
        for (told, sums) in told.chunks_exact_mut(OF_PART).zip(sums) {
            let step = to_camera * sums.by_mean;
            told.copy_from_slice(&numbers(sums, anchored.cells[anchor].area, step));
        }
    });
    Ok(told)
}

/// The descent of ½ Σ ∣e∣² of a view, and (Σ w, Σ w ∣e∣²) of every Gaussian. The near plane is that of `base`.
fn descent(
    scene: &Gaussians,
    base: &Gaussians,
    view: &View,
    rasterizer: &mut Rasterizer,
) -> Result<(Gradients, Vec<[f32; 2]>)> {
    let camera = std::slice::from_ref(view.camera());
    let settings = RenderSettings { near: near_plane(base, view.camera()), ..RenderSettings::default() };
    let failed = |error| Error::Feedback { view: view.name().to_owned(), source: Box::new(error) };
    let (rendered, tape) = rasterizer.record(scene, camera, &settings).map_err(failed)?;
    let rendered = rendered[0].image.data();
    let error: Vec<f32> =
        view.image().data().iter().zip(rendered).map(|(photograph, r)| photograph - r).collect();
    let squares = error.chunks_exact(3).map(|e| e.iter().map(|e| e * e).sum()).collect();
    let pixels = PixelGradients { image: error.into(), alpha: None, depth: None };
    rasterizer.backward_with_shares(scene, &tape, &[pixels], &[squares]).map_err(failed)
}

/// What is rendered: Gaussians of the anchors and the far shell.
fn rendered(anchored: &Anchored) -> Gaussians {
    let mut scene = anchored.base.clone();
    scene.append(&anchored.shell);
    if anchored.history.is_some() {
        return scene;
    }
    let darkest = (DARKEST - 0.5) / SH_C0;
    scene.buffers_mut().1.iter_mut().for_each(|coefficient| *coefficient = coefficient.max(darkest));
    scene
}

/// The numbers of one part; `area` is that of the anchor's cell in pixels, `step` the descent by its mean, in its own axes and unit.
fn numbers(sums: &Sums, area: f32, step: Vec3) -> [f32; OF_PART] {
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
    use crate::backbone::{Networks, geometry};
    use crate::learned::{HeadInputs, geometry_features};
    use crate::{Allocation, Backbone, Budget, Config, Stages, Wanted, anchor};
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, DepthMap, View};
    use scene_sim::{Traced, demo_cameras, demo_scene, render_view};
    use std::sync::LazyLock;

    static COURTYARD: LazyLock<Vec<View>> = LazyLock::new(|| {
        let scene = Traced::new(&demo_scene()).unwrap();
        let cameras = demo_cameras(60, 40).unwrap().0;
        cameras[..3].iter().map(|camera| render_view(&scene, camera, 2, "v", 0).unwrap()).collect()
    });

    /// On the closed form.
    fn feedback(anchored: &Anchored) -> Result<Vec<f32>> {
        super::feedback(anchored, &anchored.views)
    }

    fn config(allocation: Allocation, gaussians: usize) -> Config {
        let budget = Budget::Gaussians(gaussians);
        Config { backbone: Backbone::GivenDepth, budget, allocation, ..Config::default() }
    }

    fn anchored(views: &[View]) -> Anchored {
        allocated(views, Allocation::Entropy, 400)
    }

    fn allocated(views: &[View], allocation: Allocation, gaussians: usize) -> Anchored {
        let config = config(allocation, gaussians);
        let geometry = geometry(views, &config, &Networks::default(), Wanted::Depth).unwrap();
        anchor(views, &geometry, &config, 0, &mut Stages::new(&mut |_| {})).unwrap()
    }

    /// The views with other pictures.
    fn repainted(views: &[View], paint: impl Fn(usize, &mut f32)) -> Vec<View> {
        let mut views = views.to_vec();
        for view in &mut views {
            view.image_mut().data_mut().iter_mut().enumerate().for_each(|(i, value)| paint(i % 3, value));
        }
        views
    }

    /// The same photographs of a world that was scaled, turned and moved.
    fn elsewhere(views: &[View], scale: f64, turn: DMat3, to: DVec3) -> Vec<View> {
        let elsewhere = |view: &View| {
            let camera = view.camera();
            let rotation = camera.rotation() * turn.transpose();
            let position = turn * camera.position() * scale + to;
            let camera = Camera::new(*camera.intrinsics(), rotation, -(rotation * position)).unwrap();
            let depth = view.depth().unwrap().data().iter().map(|d| d * scale as f32).collect();
            let depth = DepthMap::new(camera.width(), camera.height(), depth).unwrap();
            View::new(view.name(), view.image().clone(), camera, Some(depth)).unwrap()
        };
        views.iter().map(elsewhere).collect()
    }

    /// Photographs are what the closed form looks like, and `add` besides.
    fn photograph_itself(anchored: &mut Anchored, add: [f32; 3]) {
        let scene = rendered(anchored);
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
        // In red light, without any, and in none: what is cut at 0 is seen as well as the rest.
        for paint in [[1.0, 1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 0.0, 0.0], [0.0; 3]] {
            let mut anchored = anchored(&repainted(&COURTYARD, |channel, value| *value *= paint[channel]));
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
    }

    #[test]
    fn what_is_wrong_in_one_view_is_told_to_its_anchors_as_their_own() {
        let mut anchored = anchored(&COURTYARD);
        photograph_itself(&mut anchored, [0.0; 3]);
        anchored.views[1].image_mut().data_mut().iter_mut().for_each(|value| *value += 0.1);
        let found = feedback(&anchored).unwrap();
        let mut told = [0, 0];
        for (parts, &view) in found.as_chunks::<OF_PART>().0.chunks_exact(2).zip(&anchored.anchors.views) {
            let of_others = usize::from(view != 1);
            told[of_others] += usize::from(parts[of_others][1..5].iter().all(|number| *number > 0.1));
            assert!(parts[1 - of_others][1..].iter().all(|number| *number == 0.0), "{parts:?}");
        }
        assert!(told.iter().all(|told| *told > 50), "{told:?}");
    }

    #[test]
    fn a_head_sees_it_after_all_else() {
        let config = config(Allocation::Entropy, 400);
        let geometry = geometry(&COURTYARD, &config, &Networks::default(), Wanted::Depth).unwrap();
        let anchored = anchor(&COURTYARD, &geometry, &config, 0, &mut Stages::new(&mut |_| {})).unwrap();
        assert!(anchored.feedback(false).unwrap().is_empty());
        let feedback = anchored.feedback(true).unwrap();
        let [without, with] = [&[][..], &feedback]
            .map(|feedback| anchored.inputs(attn_head::Kind::Attention, &geometry.views, feedback));
        assert_eq!(with.geometry.len(), with.n * geometry_features(true));
        let rows =
            without.geometry.chunks_exact(geometry_features(false)).zip(feedback.chunks_exact(FEEDBACK));
        let expected: Vec<f32> = rows.flat_map(|(features, told)| [features, told].concat()).collect();
        assert_eq!(with.geometry, expected);
        let rest = |inputs| HeadInputs { geometry: Vec::new(), ..inputs };
        assert_eq!(rest(with), rest(without));
    }

    #[test]
    fn factors_are_those_of_the_table() {
        let sums = Sums {
            weight: 6.0,
            squared_error: 0.28,
            error: Vec3::new(0.7, -1.4, 2.1),
            by_opacity: -0.07,
            by_scale: Vec3::new(0.14, -0.21, 0.28),
            by_mean: Vec3::ZERO,
        };
        let found = numbers(&sums, 10.0, Vec3::new(0.35, -0.42, 70.0));
        let expected = [0.5 * 0.61_f32.ln(), 0.8, 0.6, -1.2, 1.8, -0.6, 0.2, -0.3, 0.4, 0.5, -0.6, LARGEST];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }

    #[test]
    fn hard_scenes_are_told_finite_numbers() {
        let (still, here) = (DMat3::IDENTITY, DVec3::ZERO);
        let [black, glaring] = [0.0, 1.0].map(|light| repainted(&COURTYARD, |_, value| *value = light));
        let noise = repainted(&COURTYARD, |channel, value| *value = (1e4 * *value + channel as f32).fract());
        for (name, views) in [
            ("black", black),
            ("white", glaring),
            ("noise", noise),
            ("tiny", elsewhere(&COURTYARD, 1e-6, still, here)),
            ("huge", elsewhere(&COURTYARD, 1e7, still, here)),
            ("far away", elsewhere(&COURTYARD, 1.0, still, DVec3::splat(1e4))),
            ("the same view", vec![COURTYARD[0].clone(), COURTYARD[0].clone()]),
        ] {
            use Allocation::{Entropy, Merged, PixelAligned, VoxelAligned};
            // The least that there is, and as many as there are.
            for (allocation, n) in [
                (Entropy, 400),
                (Entropy, 1),
                (PixelAligned, 400),
                (Merged, 400),
                (VoxelAligned, 400),
                (VoxelAligned, 1),
            ] {
                let anchored = allocated(&views, allocation, n);
                let found = feedback(&anchored).unwrap();
                assert_eq!(found.len(), anchored.base.len() * FEEDBACK);
                let bounded = |number: &f32| number.abs() <= LARGEST;
                assert!(found.iter().all(bounded), "{name}, {allocation:?}");
            }
        }
    }

    #[test]
    fn what_was_changed_is_to_be_changed_back() {
        let mut honest = anchored(&COURTYARD);
        photograph_itself(&mut honest, [0.0; 3]);
        let visible =
            parts(&feedback(&honest).unwrap()).step_by(2).map(|part| part[0] > -0.7).collect::<Vec<_>>();
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
    fn a_scene_that_is_scaled_turned_and_moved_is_told_the_same() {
        let before = feedback(&anchored(&COURTYARD)).unwrap();
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.5, -1.0, 2.0);
        for (scale, turn, to, within) in
            [(8.0, DMat3::IDENTITY, DVec3::ZERO, 1e-2), (3.0, turn, DVec3::new(5.0, -2.0, 7.0), 2e-2)]
        {
            let after = feedback(&anchored(&elsewhere(&COURTYARD, scale, turn, to))).unwrap();
            assert_eq!(before.len(), after.len());
            for (before, after) in before.iter().zip(&after) {
                assert!((before - after).abs() < within, "{before} {after}");
            }
        }
    }
}
