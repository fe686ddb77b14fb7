//! Where cameras stand: paths of a person who looks at something.

use crate::Result;
use crate::check::Place;
use glam::DVec3;
use gs_scene::{Camera, Intrinsics};
use serde::{Deserialize, Serialize};

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
        /// What it looks at from each of them.
        targets: Vec<DVec3>,
    },
    /// A path as a hand keeps it.
    Handheld {
        /// Where the hand means to go.
        path: Box<Trajectory>,
        /// How far the camera strays from it, metres (standard deviation).
        sway: f64,
        /// How far its view strays, degrees (standard deviation, about each axis).
        turn: f64,
        /// Which of the endless variants.
        seed: u64,
    },
}

impl Trajectory {
    /// The position at `u` in 0..=1 of the path.
    fn position(&self, u: f64) -> DVec3 {
        match *self {
            Self::Through { .. } | Self::Handheld { .. } => todo!("XX"),
            Self::Arc { target, radius, height, from, to } => {
                let (sine, cosine) = (from + (to - from) * u).to_radians().sin_cos();
                target + DVec3::new(radius * cosine, radius * sine, height)
            }
            Self::Walk { from, to, .. } => from.lerp(to, u),
        }
    }

    /// `count` cameras at equal distances from one end of the path to the other (one camera stands in its
    /// middle).
    ///
    /// # Errors
    /// If a number of the path is not finite, or a camera would stand in, above or below its target.
    pub fn cameras(&self, intrinsics: Intrinsics, count: usize) -> Result<Vec<Camera>> {
        let name = || "trajectory".to_owned();
        let place = Place::new(&name);
        let target = match *self {
            Self::Through { .. } | Self::Handheld { .. } => todo!("XX"),
            Self::Arc { target, radius, height, from, to } => {
                place.extent("radius", radius)?;
                place.point("height, from or to", DVec3::new(height, from, to))?;
                target
            }
            Self::Walk { target, from, to } => {
                place.point("from", from)?;
                place.point("to", to)?;
                target
            }
        };
        place.point("target", target)?;
        (0..count)
            .map(|index| {
                let u = if count == 1 { 0.5 } else { index as f64 / (count - 1) as f64 };
                Ok(Camera::looking_at(intrinsics, self.position(u), target, DVec3::Z)?)
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

    #[test]
    fn paths_that_lead_nowhere_are_errors() {
        let lens = lens(40, 30, 60.0);
        let nan = Trajectory::Walk { target: DVec3::Y, from: DVec3::NAN, to: DVec3::X };
        let message = nan.cameras(lens, 2).unwrap_err().to_string();
        assert_eq!(message, "trajectory: from is NaN, expected finite numbers of magnitude up to 1e9");
        let above = Trajectory::Walk { target: DVec3::ZERO, from: DVec3::Z, to: DVec3::Z };
        assert!(above.cameras(lens, 2).is_err());
    }
}
