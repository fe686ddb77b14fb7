//! A case that breaks renderers, and what one makes of it; shared with the example `hard_cases`.

use crate::check::{Row, settings};
use crate::losses::{Compared, compare_gradients, pixels};
use glam::DVec4;
use gs_raster::{Gradients, Rasterizer, RenderStats};
use gs_reference::tolerance::{AMBIGUOUS, F32_ABSOLUTE, F32_WITHOUT_FLOOR, f32_bound};
use gs_reference::{Profile, compare, project};
use gs_scene::{Camera, Gaussians, QUATERNION};

const BACKGROUND: [f32; 3] = [0.1, 0.2, 0.3];

/// A scene that breaks renderers.
pub(crate) struct HardCase {
    pub(crate) name: String,
    /// What is to happen, in words.
    pub(crate) happens: &'static str,
    pub(crate) scene: Gaussians,
    pub(crate) camera: Camera,
    pub(crate) profile: Profile,
    /// Gaussians that are left out and counted.
    pub(crate) rejected: usize,
    /// Whether anything is drawn at all.
    pub(crate) is_drawn: bool,
    /// Pixels in which f32 may take another decision than f64; by the margin of the reference if there is none.
    pub(crate) ambiguous: Option<Vec<bool>>,
}

/// What a renderer makes of a case.
pub(crate) struct Found {
    pub(crate) stats: RenderStats,
    /// Whether any gradient by the scene is not 0.
    pub(crate) has_gradient: bool,
    /// Whether the gradients of what the reference does not project are exactly 0.
    pub(crate) culled_have_none: bool,
    /// Largest share of a quaternion's gradient that lies along the quaternion, which changes nothing.
    pub(crate) along_quaternion: f64,
    /// The pictures, first the image, each with its bound.
    pub(crate) pictures: Vec<Row>,
    /// The gradients by each variable.
    pub(crate) gradients: Vec<Row>,
}

impl HardCase {
    /// Renders and differentiates.
    pub(crate) fn measure(&self, rasterizer: &mut Rasterizer) -> Found {
        let (scene, camera, profile) = (&self.scene, &self.camera, &self.profile);
        let truth = gs_reference::render(scene, camera, BACKGROUND.map(f64::from), profile);
        let by_margin = || truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        let ambiguous = self.ambiguous.clone().unwrap_or_else(by_margin);
        let pixels = pixels(1, &ambiguous, &truth.alpha);
        let settings = settings(profile, BACKGROUND);
        let (views, tape) = rasterizer.record(scene, &[*camera], &settings).expect("it can be rendered");
        let view = &views[0];
        let found = rasterizer.backward(scene, &tape, std::slice::from_ref(&pixels)).expect("the sizes fit");

        let depth = view.depth.as_ref().expect("asked for");
        let outputs = [
            ("image", &truth.image, view.image.data()),
            ("alpha", &truth.alpha, &view.alpha),
            ("depth", &truth.depth, depth),
        ];
        let pictures = outputs.into_iter().map(|(output, expected, found)| {
            let deviation = compare(expected.iter().copied(), found.iter().copied(), &ambiguous);
            let bound = deviation.as_ref().map_or(0.0, |deviation| f32_bound(deviation, None));
            Row { output: output.to_owned(), deviation, bound }
        });
        let gradients = compare_gradients(scene, camera, BACKGROUND, profile, &truth, &pixels, &found);
        let numbers_of = |i: usize| {
            let k = found.sh.len() / scene.len();
            found.geometry[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY]
                .iter()
                .chain(&found.sh[i * k..][..k])
        };
        Found {
            stats: view.stats,
            along_quaternion: (0..scene.len())
                .map(|i| along_quaternion(scene, &found, i))
                .fold(0.0, f64::max),
            pictures: pictures.collect(),
            gradients: gradients.into_iter().map(Compared::row).collect(),
            has_gradient: found.geometry.iter().chain(&found.sh).any(|&value| value != 0.0),
            culled_have_none: (0..scene.len())
                .filter(|&i| project(scene, i, camera, profile).is_none())
                .all(|i| numbers_of(i).all(|&value| value == 0.0)),
        }
    }

    /// What a renderer does with the case that it should not.
    pub(crate) fn complaints(&self, found: &Found) -> Vec<String> {
        let rows = found.pictures.iter().chain(&found.gradients).filter(|row| !row.holds());
        let mut complaints: Vec<String> =
            rows.map(|row| format!("{}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound)).collect();
        if found.stats.rejected != self.rejected {
            complaints.push(format!("{} are left out instead of {}", found.stats.rejected, self.rejected));
        }
        if (found.stats.intersections > 0) != self.is_drawn {
            complaints.push(format!("{} tiles are touched", found.stats.intersections));
        }
        if found.has_gradient != self.is_drawn {
            complaints.push(format!("whether there is a gradient: {}", found.has_gradient));
        }
        if !found.culled_have_none {
            complaints.push("what is not drawn has a gradient".to_owned());
        }
        if found.along_quaternion > F32_WITHOUT_FLOOR {
            complaints.push(format!("{} of a gradient lies along its quaternion", found.along_quaternion));
        }
        complaints
    }
}

/// Share of the gradient of quaternion `i` that lies along it; 0 if there is no gradient but rounding.
fn along_quaternion(scene: &Gaussians, found: &Gradients, i: usize) -> f64 {
    let of = |geometry: &[f32]| {
        let q = &geometry[i * Gaussians::GEOMETRY..][QUATERNION];
        DVec4::new(q[0].into(), q[1].into(), q[2].into(), q[3].into())
    };
    let (q, grad) = (of(scene.geometry()), of(&found.geometry));
    let is_told = grad.length() * q.length() > F32_ABSOLUTE;
    if is_told { (q.normalize().dot(grad) / grad.length()).abs() } else { 0.0 }
}
