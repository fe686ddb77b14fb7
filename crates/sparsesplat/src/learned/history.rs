//! What looks and a refinement have made of an anchor's Gaussian, in numbers for a corrector. Lengths are in units of the anchor's spacing,
//! directions in the axes of its camera, as for every head. `before` is the scene before the refinement.
//!
//! | numbers | what |
//! |---|---|
//! | 1 | ½ of the logit of the opacity |
//! | 1 | ½ of its change since the closed form |
//! | 3 | logarithms of the scales, smallest first, the first halved |
//! | 3 | how far the mean is from that of the closed form |
//! | 3 | 6 times the change of the colour that the own view sees, since the closed form, rgb |
//! | 1 | 4 times the length of the colour by direction |
//! | 1 | sum of the changes of the logarithms of the scales since the closed form |
//! | 1 | change of the logit since `before` |
//! | 3 | 2 times the changes of the logarithms of the scales since `before` |
//! | 3 | 3 times how far the mean is from that of `before` |
//! | 3 | 6 times the change of the colour that the own view sees, since `before`, rgb |
//! | 1 | 6 times the length of the change of the colour by direction since `before` |
//!
//! None is beyond ±3.

use crate::as_photographed::change;
use crate::harmonics::{DEGREE, TERMS, basis};
use crate::{Anchored, ExposureGain, Result};
use glam::{DVec3, Vec3};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, SH_C0};

/// Numbers per anchor.
pub(super) const HISTORY: usize = 24;
/// None of them is farther from 0.
const LARGEST: f32 = 3.0;
/// Coefficients of a colour, rgb each.
const SH: usize = 3 * TERMS;

/// How the Gaussians of a refined scene came about.
#[derive(Debug, Clone)]
pub(crate) struct History {
    /// The closed form of the anchors, SH degree 0.
    closed_form: Gaussians,
    /// The anchors' Gaussians before the refinement, SH degree 2.
    before: Gaussians,
    /// What brings each view from the exposure of the scene into the common one.
    exposure: Vec<ExposureGain>,
}

impl Anchored {
    /// The same anchors in a refined scene: `now`, which was `before`, both of the anchors in their order and the shell after them. What a head then
    /// sees and corrects is the refined scene instead of the closed form. `exposure` is what brings each view from the exposure of the scene into the
    /// common one.
    ///
    /// # Errors
    /// Those of `Gaussians::new`, which the asserted lengths exclude.
    ///
    /// # Panics
    /// If a scene has another number of Gaussians or an SH degree above 2, or there are not as many exposures as views.
    pub fn refined(self, before: &Gaussians, now: &Gaussians, exposure: Vec<ExposureGain>) -> Result<Self> {
        assert!(before.sh_degree() <= DEGREE && now.sh_degree() <= DEGREE, "colours that a head can make");
        let (n, all) = (self.base.len(), self.base.len() + self.shell.len());
        assert!(before.len() == all && now.len() == all, "Gaussians of the anchors and of the shell");
        assert_eq!(exposure.len(), self.views.len(), "one for each view");
        let rows = |scene: &Gaussians, begin: usize, end: usize| {
            let scene = scene.clone().with_sh_degree(DEGREE)?;
            let geometry = scene.geometry()[begin * Gaussians::GEOMETRY..end * Gaussians::GEOMETRY].to_vec();
            Gaussians::new(DEGREE, geometry, scene.sh()[begin * SH..end * SH].to_vec())
        };
        let history = History {
            closed_form: self.history.map_or(self.base, |known| known.closed_form),
            before: rows(before, 0, n)?,
            exposure,
        };
        Ok(Self { base: rows(now, 0, n)?, shell: rows(now, n, all)?, history: Some(history), ..self })
    }
}

/// Row `i` of a scene: what describes its shape, and its colour.
fn row(scene: &Gaussians, i: usize) -> (&[f32], &[f32]) {
    let width = scene.sh().len() / scene.len();
    (&scene.geometry()[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY], &scene.sh()[i * width..][..width])
}

/// The numbers of anchor `i`.
pub(super) fn history(anchored: &Anchored, history: &History, i: usize) -> [f32; HISTORY] {
    let view = anchored.anchors.views[i] as usize;
    let camera = anchored.views[view].camera();
    let spacing = anchored.spacing[i].max(f32::MIN_POSITIVE);
    let (now, now_sh) = row(&anchored.base, i);
    let (before, before_sh) = row(&history.before, i);
    let (closed, closed_sh) = row(&history.closed_form, i);

    let moved = |since: &[f32]| {
        camera.rotation().as_mat3() * (Vec3::from_slice(&now[MEAN]) - Vec3::from_slice(&since[MEAN]))
            / spacing
    };
    let scaled = |since: &[f32]| [0, 1, 2].map(|k| now[LOG_SCALE.start + k] - since[LOG_SCALE.start + k]);
    // Without the ½ that is added to every colour.
    let seen = |geometry: &[f32], sh: &[f32]| {
        let mean = DVec3::from(Vec3::from_slice(&geometry[MEAN]));
        let basis = basis((mean - camera.position()).normalize_or(DVec3::Z));
        let (sh, _) = sh.as_chunks::<3>();
        [0, 1, 2].map(|c| basis.iter().zip(sh).map(|(y, sh)| y * f64::from(sh[c])).sum::<f64>() as f32)
    };
    let colour = seen(now, now_sh);
    let colour_before = seen(before, before_sh);
    let [factor, offset] = change(history.exposure[view]).map(|x| x as f32);
    let photographed = |c: usize| {
        let common = 0.5 + SH_C0 * closed_sh[c];
        common + factor * common + offset - 0.5
    };
    let length = |values: &mut dyn Iterator<Item = f32>| values.map(|v| v * v).sum::<f32>().sqrt();

    let mut scales = [0, 1, 2].map(|k| now[LOG_SCALE.start + k] - spacing.ln());
    scales.sort_by(f32::total_cmp);
    let (from_closed, from_before) = (moved(closed), moved(before));
    let by_direction = length(&mut now_sh[3..].iter().copied());
    let by_direction_changed = length(&mut now_sh[3..].iter().zip(&before_sh[3..]).map(|(a, b)| a - b));
    let scaled_before = scaled(before);
    let numbers = [
        0.5 * now[OPACITY_LOGIT],
        0.5 * (now[OPACITY_LOGIT] - closed[OPACITY_LOGIT]),
        0.5 * scales[0],
        scales[1],
        scales[2],
        from_closed.x,
        from_closed.y,
        from_closed.z,
        6.0 * (colour[0] - photographed(0)),
        6.0 * (colour[1] - photographed(1)),
        6.0 * (colour[2] - photographed(2)),
        4.0 * by_direction,
        scaled(closed).iter().sum(),
        now[OPACITY_LOGIT] - before[OPACITY_LOGIT],
        2.0 * scaled_before[0],
        2.0 * scaled_before[1],
        2.0 * scaled_before[2],
        3.0 * from_before.x,
        3.0 * from_before.y,
        3.0 * from_before.z,
        6.0 * (colour[0] - colour_before[0]),
        6.0 * (colour[1] - colour_before[1]),
        6.0 * (colour[2] - colour_before[2]),
        6.0 * by_direction_changed,
    ];
    numbers.map(|number| if number.is_finite() { number.clamp(-LARGEST, LARGEST) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backbone::{Networks, geometry};
    use crate::{Backbone, Budget, Config, Stages, Wanted, anchor};
    use gs_scene::View;
    use scene_sim::{Traced, demo_cameras, demo_scene, render_view};

    fn anchored() -> Anchored {
        let scene = Traced::new(&demo_scene()).unwrap();
        let cameras = demo_cameras(60, 40).unwrap().0;
        let views: Vec<View> =
            cameras[..3].iter().map(|camera| render_view(&scene, camera, 2, "v", 0).unwrap()).collect();
        let budget = Budget::Gaussians(400);
        let config = Config { backbone: Backbone::GivenDepth, budget, ..Config::default() };
        let geometry = geometry(&views, &config, &Networks::default(), Wanted::Depth).unwrap();
        anchor(&views, &geometry, &config, 0, &mut Stages::new(&mut |_| {})).unwrap()
    }

    fn scene(anchored: &Anchored) -> Gaussians {
        let mut scene = anchored.base.clone();
        scene.append(&anchored.shell);
        scene.with_sh_degree(DEGREE).unwrap()
    }

    fn numbers(
        anchored: &Anchored,
        before: &Gaussians,
        now: &Gaussians,
        exposure: ExposureGain,
    ) -> Vec<[f32; HISTORY]> {
        let exposure = vec![exposure; anchored.views.len()];
        let refined = anchored.clone().refined(before, now, exposure).unwrap();
        let known = refined.history.as_ref().unwrap();
        (0..refined.base.len()).map(|i| history(&refined, known, i)).collect()
    }

    #[test]
    fn the_closed_form_has_no_history() {
        let anchored = anchored();
        let same = scene(&anchored);
        for numbers in numbers(&anchored, &same, &same, ExposureGain::NONE) {
            let changes = [&numbers[1..2], &numbers[5..]].concat();
            assert!(changes.iter().all(|x| x.abs() < 1e-5), "{numbers:?}");
        }
        // In another exposure the closed form has the colours that the photograph had.
        let brighter = ExposureGain { gain: 2.0, bias: 0.1 };
        let found = numbers(&anchored, &same, &same, brighter)[0];
        let rgb = 0.5 + SH_C0 * same.sh()[0];
        assert!((found[8] - (6.0 * (rgb - (rgb - 0.1) / 2.0)).clamp(-3.0, 3.0)).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn every_change_shows_in_its_numbers_in_units_of_the_anchor() {
        let anchored = anchored();
        let before = scene(&anchored);
        let i = 7;
        let view = anchored.anchors.views[i] as usize;
        let spacing = anchored.spacing[i];
        let mut now = before.clone();
        let (geometry, sh) = now.buffers_mut();
        let row = &mut geometry[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        row[OPACITY_LOGIT] += 0.5;
        row[LOG_SCALE.start + 1] += 0.25;
        // A fifth of its spacing to the right in the picture.
        let right = anchored.views[view].camera().rotation().transpose().x_axis.as_vec3() * 0.2 * spacing;
        row[MEAN].iter_mut().zip(right.to_array()).for_each(|(value, by)| *value += by);
        // Red from everywhere.
        sh[i * SH] += 0.1 / SH_C0;
        let found = numbers(&anchored, &before, &now, ExposureGain::NONE);
        let expected = [
            0.25, 0.2, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 0.25, 0.5, 0.0, 0.5, 0.0, 0.6, 0.0, 0.0, 0.6, 0.0, 0.0,
            0.0,
        ];
        let shown = [&found[i][1..2], &found[i][5..]].concat();
        for (k, (found, expected)) in shown.iter().zip(expected).enumerate() {
            assert!((found - expected).abs() < 2e-3, "{k}: {shown:?}");
        }
        assert!(found[i + 1][13..].iter().all(|x| *x == 0.0), "the next one has not changed");
    }

    #[test]
    fn values_that_are_none_and_huge_ones_stay_within_bounds() {
        let anchored = anchored();
        let before = scene(&anchored);
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30] {
            let mut now = before.clone();
            now.buffers_mut().0[..Gaussians::GEOMETRY].fill(value);
            now.buffers_mut().1[..SH].fill(value);
            let of_first = numbers(&anchored, &before, &now, ExposureGain { gain: 0.0, bias: 1e30 })[0];
            assert!(of_first.iter().all(|x| x.abs() <= LARGEST), "{value}: {of_first:?}");
        }
    }
}
