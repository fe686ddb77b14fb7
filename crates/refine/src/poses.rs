//! Small changes of the cameras, where poses and focal lengths are estimates.
//!
//! The change of a camera is a turn about its centre and a shift of that centre. Adam's steps are taken in the camera's own axes, in units of a
//! pixel: a turn by one moves the picture by a pixel, a shift by one moves what lies at the view's median depth by a pixel. All cameras and the
//! scene may drift together and no picture shows it, so the mean turn and the mean shift of all cameras are held at 0. Views with
//! the same intrinsics share a lens, and so a focal length: its step of one moves the ends of the picture's long side by a pixel.

use glam::{DMat3, DQuat, DVec3};
use gs_raster::CameraGradient;
use gs_scene::{Camera, Gaussians, Intrinsics, MEAN, View};
use serde::Serialize;

/// Decay of the moments of Adam. Half as long as those of Gaussians: a camera is seen in one step of three only.
const DECAY: [f64; 2] = [0.8, 0.99];
/// Added to the root of the second moment; derivatives by pixels are far above it.
const EPSILON: f64 = 1e-12;

/// Largest factor of a focal length, and its inverse the least.
const LARGEST_FACTOR: f64 = 2.0;

/// How a camera was changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseChange {
    /// Angle between the axes before and after, degrees.
    pub degrees: f64,
    /// Distance of the centres, scene units.
    pub shift: f64,
    /// Focal length after over before.
    pub focal: f64,
}

/// The cameras of all views, as changes of what was given.
#[derive(Debug)]
pub(crate) struct Poses {
    changes: Vec<Change>,
    lenses: Vec<Lens>,
    rate: f64,
}

#[derive(Debug)]
struct Change {
    /// Rotation vector about the camera's centre, world axes, radians.
    turn: DVec3,
    /// Of the centre, world axes, scene units.
    shift: DVec3,
    /// By how much one pixel turns and shifts: radians, scene units.
    pixel: [f64; 2],
    moments: Adam<6>,
    /// Position in [`Poses::lenses`].
    lens: usize,
}

/// What views with the same intrinsics share.
#[derive(Debug)]
struct Lens {
    given: Intrinsics,
    /// Logarithm of the focal length over that which was given.
    log: f64,
    moments: Adam<1>,
}

/// The state of Adam for some numbers.
#[derive(Debug)]
struct Adam<const N: usize> {
    moments: [[f64; N]; 2],
    updates: i32,
}

impl Poses {
    /// `rate` is the step size, pixels; with 0 cameras stay where they are.
    pub(crate) fn new(scene: &Gaussians, views: &[View], rate: f32) -> Self {
        let mut lenses: Vec<Lens> = Vec::new();
        let change = |view: &View| {
            let given = *view.camera().intrinsics();
            let lens = lenses.iter().position(|lens| lens.given == given).unwrap_or_else(|| {
                lenses.push(Lens { given, log: 0.0, moments: Adam::new() });
                lenses.len() - 1
            });
            let angle = 1.0 / given.fx;
            let pixel = [angle, angle * median_depth(scene, view.camera())];
            Change { turn: DVec3::ZERO, shift: DVec3::ZERO, pixel, moments: Adam::new(), lens }
        };
        let changes = if rate > 0.0 { views.iter().map(change).collect() } else { Vec::new() };
        Self { changes, lenses, rate: f64::from(rate) }
    }

    /// The camera of a view, given in any size, where it is now.
    pub(crate) fn moved(&self, view: usize, given: &Camera) -> Camera {
        let Some(change) = self.changes.get(view) else { return *given };
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(change.turn));
        let axes = turn * given.rotation().transpose();
        let (lens, factor) = (*given.intrinsics(), self.lenses[change.lens].log.exp());
        let lens = Intrinsics { fx: lens.fx * factor, fy: lens.fy * factor, ..lens };
        // Rounding alone stands between a product of rotations and a rotation; NaN never gets in.
        Camera::from_camera_to_world(lens, axes, given.position() + change.shift).unwrap_or(*given)
    }

    /// One step of Adam on some views; `factor` scales the step size. Derivatives that are not finite change nothing.
    pub(crate) fn update(&mut self, gradients: &[(usize, Camera, CameraGradient)], factor: f32) {
        if self.changes.is_empty() {
            return;
        }
        let rate = self.rate * f64::from(factor);
        let mut by_focal = vec![None; self.lenses.len()];
        for (view, camera, gradient) in gradients {
            let twist = gradient.twist(camera);
            if twist.iter().chain([&gradient.focal]).all(|number| number.is_finite()) {
                let change = &mut self.changes[*view];
                change.step(camera, twist, rate);
                *by_focal[change.lens].get_or_insert(0.0) += gradient.focal;
            }
        }
        for (lens, by_focal) in self.lenses.iter_mut().zip(by_focal) {
            if let Some(by_focal) = by_focal {
                lens.step(by_focal, rate);
            }
        }
        let count = self.changes.len() as f64;
        let mean = |part: fn(&Change) -> DVec3| self.changes.iter().map(part).sum::<DVec3>() / count;
        let (turn, shift) = (mean(|change| change.turn), mean(|change| change.shift));
        for change in &mut self.changes {
            change.turn -= turn;
            change.shift -= shift;
        }
    }

    /// All changes; none where cameras stay.
    pub(crate) fn all(&self) -> Vec<PoseChange> {
        let pose_change = |change: &Change| PoseChange {
            degrees: change.turn.length().to_degrees(),
            shift: change.shift.length(),
            focal: self.lenses[change.lens].log.exp(),
        };
        self.changes.iter().map(pose_change).collect()
    }
}

impl Change {
    /// `twist` is by (shift, turn) of the camera's frame: T ← exp(ξ^) T.
    fn step(&mut self, camera: &Camera, twist: [f64; 6], rate: f64) {
        let [angle, length] = self.pixel;
        let units = [length, length, length, angle, angle, angle];
        let step = self.moments.step(twist, units, rate);
        let to_world = camera.rotation().transpose();
        let [shift, turn] = [DVec3::from_slice(&step[..3]), DVec3::from_slice(&step[3..])];
        // What a camera turns by one way, the world in front of it turns by the other.
        self.turn -= to_world * turn;
        self.shift -= to_world * shift;
    }
}

impl Lens {
    /// `by_focal` is by the logarithm of the focal length.
    fn step(&mut self, by_focal: f64, rate: f64) {
        let pixel = 2.0 / self.given.width.max(self.given.height) as f64;
        let [step] = self.moments.step([by_focal], [pixel], rate);
        self.log = (self.log + step).clamp(-LARGEST_FACTOR.ln(), LARGEST_FACTOR.ln());
    }
}

impl<const N: usize> Adam<N> {
    fn new() -> Self {
        Self { moments: [[0.0; N]; 2], updates: 0 }
    }

    /// One step of Adam: `units` are the sizes of a pixel, and `rate` the step in pixels.
    fn step(&mut self, gradients: [f64; N], units: [f64; N], rate: f64) -> [f64; N] {
        self.updates += 1;
        std::array::from_fn(|i| {
            let gradient = gradients[i] * units[i];
            let [first, second] = [0, 1].map(|moment| {
                let (decay, value) =
                    (DECAY[moment], if moment == 0 { gradient } else { gradient * gradient });
                let mean = &mut self.moments[moment][i];
                *mean = decay * *mean + (1.0 - decay) * value;
                *mean / (1.0 - decay.powi(self.updates))
            });
            -rate * units[i] * first / (second.sqrt() + EPSILON)
        })
    }
}

/// Of the Gaussians in a camera's picture, scene units; 1 where there is none.
fn median_depth(scene: &Gaussians, camera: &Camera) -> f64 {
    let mean = |row: &[f32]| DVec3::from(std::array::from_fn(|axis| f64::from(row[MEAN.start + axis])));
    let seen = |row: &[f32]| {
        let pixel = camera.project(mean(row)).filter(|&pixel| camera.contains(pixel));
        pixel.map(|_| camera.to_camera(mean(row)).z)
    };
    let mut depths: Vec<f64> = scene.geometry().chunks_exact(Gaussians::GEOMETRY).filter_map(seen).collect();
    if depths.is_empty() {
        return 1.0;
    }
    let middle = depths.len() / 2;
    *depths.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{cameras, photographs, wall};
    use glam::DVec3;

    #[test]
    fn a_step_lowers_what_its_twist_is_the_derivative_of() {
        // The loss is the squared distance of the pixel of a point from where it was.
        let camera = cameras(3, (40, 32), 1.0)[0];
        let views = photographs(&wall(4, 1.0), &cameras(3, (40, 32), 1.0));
        let point = DVec3::new(0.3, -0.2, 4.1);
        let aim = camera.project(point).unwrap() + glam::DVec2::new(0.7, -0.4);
        let mut poses = Poses::new(&wall(4, 1.0), &views, 0.02);
        let loss = |camera: &Camera| (camera.project(point).unwrap() - aim).length_squared();
        let before = loss(&camera);
        for _ in 0..40 {
            let now = poses.moved(0, &camera);
            let difference = now.project(point).unwrap() - aim;
            let seen = now.to_camera(point);
            let (fx, fy) = (now.intrinsics().fx, now.intrinsics().fy);
            let by_seen = DVec3::new(
                2.0 * difference.x * fx / seen.z,
                2.0 * difference.y * fy / seen.z,
                -2.0 * (difference.x * fx * seen.x + difference.y * fy * seen.y) / (seen.z * seen.z),
            );
            let rotation = DMat3::from_cols(by_seen * point.x, by_seen * point.y, by_seen * point.z);
            poses.update(&[(0, now, CameraGradient { rotation, translation: by_seen, focal: 0.0 })], 1.0);
        }
        let after = loss(&poses.moved(0, &camera));
        assert!(after < 0.2 * before, "{before} {after}");
        // The others moved the other way, and all together nowhere.
        let sum = |part: fn(&Change) -> DVec3| poses.changes.iter().map(part).sum::<DVec3>().length();
        assert!(sum(|change| change.turn) < 1e-12 && sum(|change| change.shift) < 1e-12);
        assert!(poses.all().iter().all(|change| change.degrees > 0.0 && change.shift > 0.0));
    }

    #[test]
    fn without_a_rate_and_with_derivatives_that_are_not_finite_cameras_stay() {
        let given = cameras(2, (40, 32), 1.0);
        let views = photographs(&wall(4, 1.0), &given);
        let gradient = |value: f64| CameraGradient {
            rotation: DMat3::from_diagonal(DVec3::splat(value)),
            translation: DVec3::ONE,
            focal: 1.0,
        };
        for (rate, value) in [(0.0, 1.0), (0.1, f64::NAN), (0.1, f64::INFINITY)] {
            let mut poses = Poses::new(&wall(4, 1.0), &views, rate);
            poses.update(&[(1, given[1], gradient(value))], 1.0);
            assert!(poses.moved(1, &given[1]).position().distance(given[1].position()) < 1e-12);
            assert_eq!(poses.moved(1, &given[1]).intrinsics(), given[1].intrinsics());
            assert_eq!(poses.all().len(), if rate > 0.0 { 2 } else { 0 });
        }
        // A derivative by the focal length alone that is not finite; one that is, taken very often: of one lens, and only so far.
        let other = Intrinsics { fx: 50.0, ..*given[1].intrinsics() };
        let other = Camera::new(other, given[1].rotation(), given[1].translation()).unwrap();
        let views = [views[0].clone(), View::new("other", views[1].image().clone(), other, None).unwrap()];
        let mut poses = Poses::new(&wall(4, 1.0), &views, 0.1);
        let by_focal = |focal| CameraGradient { rotation: DMat3::ZERO, translation: DVec3::ZERO, focal };
        poses.update(&[(0, given[0], by_focal(f64::NAN))], 1.0);
        assert_eq!(poses.all()[0].focal, 1.0);
        for _ in 0..1000 {
            poses.update(&[(0, given[0], by_focal(-1.0))], 1.0);
        }
        assert_eq!([0, 1].map(|view| poses.all()[view].focal), [LARGEST_FACTOR, 1.0]);
        // Nothing to see: still a unit.
        assert_eq!(median_depth(&Gaussians::empty(0).unwrap(), &given[0]), 1.0);
    }
}
