//! Camera paths, as of a person who looks at something.

use crate::Result;
use crate::check::Place;
use crate::noise::{hash, unit};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Intrinsics};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A path of an upright camera (z up). Metres and degrees. A circle is an arc of 360 degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Trajectory {
    /// A level circular arc.
    Arc {
        /// What the camera looks at.
        target: DVec3,
        /// Horizontal distance to the target.
        radius: f64,
        /// Height above the target.
        height: f64,
        /// Where the arc starts, counter-clockwise from the x axis as seen from above.
        from: f64,
        /// Where it ends.
        to: f64,
    },
    /// A straight walk.
    Walk {
        /// What the camera looks at.
        target: DVec3,
        /// Where the walk starts.
        from: DVec3,
        /// Where it ends.
        to: DVec3,
    },
    /// A smooth curve through given places.
    Through {
        /// Where the camera passes, two places or more, in equal times from one to the next.
        places: Vec<DVec3>,
        /// What it looks at from each of them; between them the target moves on a smooth curve too.
        targets: Vec<DVec3>,
    },
    /// A path as a hand keeps it.
    Handheld {
        /// Where the hand means to go.
        path: Box<Trajectory>,
        /// How far the camera strays from it, metres (standard deviation along each axis of the world).
        sway: f64,
        /// How far its view strays, degrees (standard deviation about each axis of the camera), 0 to 45.
        turn: f64,
        /// Which of the endless variants.
        seed: u64,
    },
}

/// Periods per path of the sines that a hand's motion is made of. They are whole numbers, so that a circle closes and the
/// standard deviation holds on every path, not only in the mean over many; the power falls with the frequency, as that
/// of a body's drift and tremor does.
const PERIODS: [f64; 5] = [1.0, 2.0, 3.0, 5.0, 8.0];

/// Smooth noise along a path, of mean 0 and standard deviation 1. `channel` keeps the uses of one seed apart.
fn drift(u: f64, seed: u64, channel: u32) -> f64 {
    let power: f64 = PERIODS.iter().map(|periods| 0.5 / periods).sum();
    let sines = PERIODS.iter().zip(0..).map(|(periods, harmonic)| {
        let phase = unit(hash(seed as u32, (seed >> 32) as u32, channel, harmonic));
        (TAU * (periods * u + phase)).sin() / periods.sqrt()
    });
    sines.sum::<f64>() / power.sqrt()
}

/// A point of the smooth curve that passes `points` in equal times: cubic, with the slope at each point that of the line
/// through its neighbours (Catmull and Rom 1974), and at the ends that of the first and the last line.
fn curve(points: &[DVec3], u: f64) -> DVec3 {
    let last = points.len() - 1;
    let along = u * last as f64;
    let index = (along.floor() as usize).min(last - 1);
    let t = along - index as f64;
    let slope = |k: usize| {
        let (before, after) = (k.saturating_sub(1), (k + 1).min(last));
        (points[after] - points[before]) / (after - before) as f64
    };
    let (a, b) = (points[index], points[index + 1]);
    let (da, db) = (slope(index), slope(index + 1));
    let bend = t * t * (3.0 - 2.0 * t);
    let (early, late) = (t * (1.0 - t) * (1.0 - t), t * t * (t - 1.0));
    a + (b - a) * bend + da * early + db * late
}

impl Trajectory {
    /// Checks every number of the path.
    fn check(&self, place: &Place<'_>) -> Result<()> {
        match self {
            Self::Arc { target, radius, height, from, to } => {
                place.extent("radius", *radius)?;
                place.point("height, from or to", DVec3::new(*height, *from, *to))?;
                place.point("target", *target)
            }
            Self::Walk { target, from, to } => {
                place.point("from", *from)?;
                place.point("to", *to)?;
                place.point("target", *target)
            }
            Self::Through { places, targets } => {
                let (found, aims) = (places.len(), targets.len());
                place.rule(found >= 2, "number of places", found as f64, "2 or more")?;
                place.rule(aims == found, "number of targets", aims as f64, "as many as places")?;
                places.iter().try_for_each(|point| place.point("places", *point))?;
                targets.iter().try_for_each(|point| place.point("targets", *point))
            }
            Self::Handheld { path, sway, turn, .. } => {
                place.extent("sway", *sway)?;
                place.rule((0.0..=45.0).contains(turn), "turn", *turn, "0 to 45")?;
                path.check(place)
            }
        }
    }

    /// Where the camera is and what it looks at, at `u` in 0..=1 of a path that has been checked; without the
    /// straying of a hand.
    fn aim(&self, u: f64) -> (DVec3, DVec3) {
        match self {
            &Self::Arc { target, radius, height, from, to } => {
                let (sine, cosine) = (from + (to - from) * u).to_radians().sin_cos();
                (target + DVec3::new(radius * cosine, radius * sine, height), target)
            }
            Self::Walk { target, from, to } => (from.lerp(*to, u), *target),
            Self::Through { places, targets } => (curve(places, u), curve(targets, u)),
            Self::Handheld { path, .. } => path.aim(u),
        }
    }

    /// The camera at `u` of a path that has been checked.
    fn pose(&self, intrinsics: Intrinsics, u: f64, place: &Place<'_>) -> Result<Camera> {
        if let Self::Handheld { path, sway, turn, seed } = self {
            let steady = path.pose(intrinsics, u, place)?;
            let [x, y, z, pitch, yaw, roll] = [0, 1, 2, 3, 4, 5].map(|channel| drift(u, *seed, channel));
            let turn = DVec3::new(pitch, yaw, roll) * turn.to_radians();
            let rotation = DMat3::from_quat(DQuat::from_scaled_axis(turn)) * steady.rotation();
            let position = steady.position() + DVec3::new(x, y, z) * *sway;
            return Ok(Camera::from_camera_to_world(intrinsics, rotation.transpose(), position)?);
        }
        let (position, target) = self.aim(u);
        let (level, sight) = ((target - position).truncate().length(), target - position);
        // Steeper than this the camera's right hand would be a matter of rounding.
        let holds = level > 1e-6 * sight.length();
        place.rule(
            holds,
            "level distance from camera to target",
            level,
            "more than 0 and 1e-6 of the whole",
        )?;
        Ok(Camera::looking_at(intrinsics, position, target, DVec3::Z)?)
    }

    /// The camera at `u`, from 0 at the start of the path to 1 at its end.
    ///
    /// # Errors
    /// As [`Trajectory::cameras`]; if `u` is not in 0..=1.
    pub fn camera_at(&self, intrinsics: Intrinsics, u: f64) -> Result<Camera> {
        let name = || "trajectory".to_owned();
        let place = Place::new(&name);
        self.check(&place)?;
        place.rule((0.0..=1.0).contains(&u), "u", u, "0 to 1")?;
        self.pose(intrinsics, u, &place)
    }

    /// `count` cameras at equal intervals from one end of the path to the other (one camera stands in its middle).
    ///
    /// # Errors
    /// If a number of the path is not finite or out of its range, a path through places has fewer than two or another
    /// number of targets, or a camera would stand in, above or below its target.
    pub fn cameras(&self, intrinsics: Intrinsics, count: usize) -> Result<Vec<Camera>> {
        let name = || "trajectory".to_owned();
        let place = Place::new(&name);
        self.check(&place)?;
        (0..count)
            .map(|index| {
                let u = if count == 1 { 0.5 } else { index as f64 / (count - 1) as f64 };
                self.pose(intrinsics, u, &place)
            })
            .collect()
    }
}

/// A lens with square pixels, the principal point in the middle and a horizontal field of view in degrees.
#[must_use]
pub fn lens(width: usize, height: usize, field_of_view: f64) -> Intrinsics {
    let focal = 0.5 * width as f64 / (0.5 * field_of_view.to_radians()).tan();
    Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f64, cy: 0.5 * height as f64, width, height }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARC: Trajectory =
        Trajectory::Arc { target: DVec3::ONE, radius: 2.0, height: 1.0, from: -90.0, to: 0.0 };

    #[test]
    fn cameras_stand_on_the_path_and_look_at_the_target() {
        let cameras = ARC.cameras(lens(40, 30, 60.0), 3).unwrap();
        assert!((cameras[0].position() - DVec3::new(1.0, -1.0, 2.0)).length() < 1e-12);
        assert!((cameras[2].position() - DVec3::new(3.0, 1.0, 2.0)).length() < 1e-12);
        for camera in &cameras {
            let seen = camera.project(DVec3::ONE).unwrap();
            assert!((seen - glam::DVec2::new(20.0, 15.0)).length() < 1e-9);
        }
        let walk = Trajectory::Walk { target: DVec3::Y, from: DVec3::ZERO, to: DVec3::X };
        let middle = walk.cameras(lens(40, 30, 60.0), 1).unwrap();
        assert!((middle[0].position() - DVec3::X * 0.5).length() < 1e-12);
        assert!(ARC.cameras(lens(40, 30, 60.0), 0).unwrap().is_empty());
    }

    fn zigzag() -> Trajectory {
        Trajectory::Through {
            places: vec![
                DVec3::ZERO,
                DVec3::new(1.0, 0.5, 0.2),
                DVec3::new(2.0, -0.5, 0.0),
                DVec3::new(3.5, 0.0, 1.0),
            ],
            targets: vec![
                DVec3::Y * 4.0,
                DVec3::new(1.0, 5.0, 0.0),
                DVec3::new(2.0, 4.0, 1.0),
                DVec3::new(3.0, 4.0, 0.0),
            ],
        }
    }

    #[test]
    fn a_curve_passes_its_places_without_a_kink() {
        let path = zigzag();
        let Trajectory::Through { places, targets } = &path else { panic!("a curve") };
        let lens = lens(40, 30, 60.0);
        for (k, (place, target)) in places.iter().zip(targets).enumerate() {
            let camera = path.camera_at(lens, k as f64 / 3.0).unwrap();
            assert!((camera.position() - *place).length() < 1e-12);
            assert!((camera.forward() - (*target - *place).normalize()).length() < 1e-12);
        }
        let position = |u| path.camera_at(lens, u).unwrap().position();
        // The second difference of a function with a continuous slope falls with the step; at a kink it would not.
        for knot in [1.0 / 3.0, 2.0 / 3.0] {
            let step = 1e-5;
            let kink = (position(knot + step) - 2.0 * position(knot) + position(knot - step)) / step;
            assert!(kink.length() < 1e-2, "kink of {kink} at {knot}");
        }
        // Two places: a straight line at constant speed.
        let (from, to) = (DVec3::ZERO, DVec3::new(3.0, 0.0, 1.0));
        let two = Trajectory::Through { places: vec![from, to], targets: vec![DVec3::Y * 9.0; 2] };
        assert!((two.camera_at(lens, 0.3).unwrap().position() - from.lerp(to, 0.3)).length() < 1e-12);
    }

    #[test]
    fn a_hand_strays_as_far_as_stated_and_smoothly() {
        let lens = lens(40, 30, 60.0);
        for seed in [0, 1, 99, u64::MAX] {
            let by_hand = Trajectory::Handheld { path: Box::new(ARC.clone()), sway: 0.02, turn: 1.5, seed };
            let count = 1001;
            let (steady, strayed) =
                (ARC.cameras(lens, count).unwrap(), by_hand.cameras(lens, count).unwrap());
            let offsets = steady.iter().zip(&strayed).map(|(a, b)| b.position() - a.position());
            let turns = steady.iter().zip(&strayed).map(|(a, b)| {
                DQuat::from_mat3(&(b.rotation() * a.rotation().transpose())).to_scaled_axis() * 180.0
                    / std::f64::consts::PI
            });
            let (offsets, turns): (Vec<_>, Vec<_>) = (offsets.collect(), turns.collect());
            for (deviations, stated) in [(&offsets, 0.02), (&turns, 1.5)] {
                let mean = deviations.iter().sum::<DVec3>() / count as f64;
                let variance =
                    deviations.iter().map(|d| (*d - mean) * (*d - mean)).sum::<DVec3>() / count as f64;
                for found in variance.to_array().map(f64::sqrt) {
                    assert!((found / stated - 1.0).abs() < 0.1, "seed {seed}: {found}, stated {stated}");
                }
                for pair in deviations.windows(2) {
                    assert!((pair[1] - pair[0]).length() < 0.2 * stated, "a jump");
                }
            }
            assert_eq!(strayed, by_hand.cameras(lens, count).unwrap());
            let other =
                Trajectory::Handheld { path: Box::new(ARC.clone()), sway: 0.02, turn: 1.5, seed: seed ^ 8 };
            assert_ne!(strayed, other.cameras(lens, count).unwrap());
        }
    }

    #[test]
    fn a_camera_of_the_path_is_the_camera_at_its_share_of_the_path() {
        let lens = lens(40, 30, 60.0);
        let by_hand = Trajectory::Handheld { path: Box::new(zigzag()), sway: 0.02, turn: 1.0, seed: 3 };
        for path in [ARC, zigzag(), by_hand] {
            for (k, camera) in path.cameras(lens, 5).unwrap().into_iter().enumerate() {
                assert_eq!(camera, path.camera_at(lens, k as f64 / 4.0).unwrap());
            }
        }
    }

    #[test]
    fn paths_that_lead_nowhere_are_errors() {
        let lens = lens(40, 30, 60.0);
        let message = |path: &Trajectory| path.cameras(lens, 2).unwrap_err().to_string();
        let nan = Trajectory::Walk { target: DVec3::Y, from: DVec3::NAN, to: DVec3::X };
        assert_eq!(message(&nan), "trajectory: from is NaN, expected finite numbers of magnitude up to 1e9");
        let above = Trajectory::Walk { target: DVec3::ZERO, from: DVec3::Z, to: DVec3::Z };
        let expected = "trajectory: level distance from camera to target is 0, expected more than 0 and 1e-6 of the whole";
        assert_eq!(message(&above), expected);
        let inside = Trajectory::Walk { target: DVec3::X, from: DVec3::X, to: DVec3::Y };
        assert_eq!(message(&inside), expected);

        let through = |places: &[DVec3], targets: &[DVec3]| Trajectory::Through {
            places: places.to_vec(),
            targets: targets.to_vec(),
        };
        let one = through(&[DVec3::X], &[DVec3::Y]);
        assert_eq!(message(&one), "trajectory: number of places is 1, expected 2 or more");
        let uneven = through(&[DVec3::X, DVec3::Z], &[DVec3::Y; 3]);
        assert_eq!(message(&uneven), "trajectory: number of targets is 3, expected as many as places");
        let lost = through(&[DVec3::X, DVec3::INFINITY], &[DVec3::Y; 2]);
        assert!(message(&lost).starts_with("trajectory: places is inf"));

        let by_hand =
            |path: Trajectory, sway, turn| Trajectory::Handheld { path: Box::new(path), sway, turn, seed: 0 };
        assert!(message(&by_hand(ARC, f64::NAN, 1.0)).starts_with("trajectory: sway is NaN"));
        assert!(message(&by_hand(ARC, 0.1, -1.0)).starts_with("trajectory: turn is -1"));
        assert_eq!(message(&by_hand(one, 0.1, 1.0)), "trajectory: number of places is 1, expected 2 or more");
        for u in [-0.1, 1.1, f64::NAN] {
            let error = ARC.camera_at(lens, u).unwrap_err().to_string();
            assert!(error.starts_with("trajectory: u is "), "{error}");
        }
    }
}
