//! The same scenes photographed the way strangers do.

use super::{Kind, generate};
use crate::random::Random;
use crate::stage::v;
use crate::{Exposure, Scene, SensorNoise, Trajectory};

/// The scene of [`generate`], photographed "in the wild", as collections of photographs are: exposure and white balance that
/// vary in half of the scenes, noise of the sensor in most, motion blur in some, poses that are a little wrong in 40 %; and half of the
/// gardens seen from the air.
/// The same seed gives the same scene.
///
/// # Panics
/// As [`generate`].
#[must_use]
pub fn generate_in_the_wild(kind: Kind, seed: u64) -> Scene {
    let mut scene = generate(kind, seed);
    let photographs = scene.photographs.as_mut().expect("a generated scene has its own");
    let random = &mut Random::new(seed, 0x7769_6c00);
    photographs.exposure = random
        .chance(0.5)
        .then(|| Exposure { stops: random.within(0.03, 0.25), white_balance: random.within(0.0, 0.08) });
    photographs.noise = random.chance(0.6).then(|| SensorNoise {
        full_well: 500.0 * 20f64.powf(random.within(0.0, 1.0)),
        read: random.within(2.0, 10.0),
    });
    photographs.motion_blur = random.chance(0.2).then(|| random.within(0.1, 0.4));
    // A fifth of a degree is a pixel where 60 degrees are 300 pixels.
    photographs.pose_error = random.chance(0.4).then(|| random.within(0.02, 0.25));
    if kind == Kind::Garden && random.chance(0.5) {
        photographs.path = from_the_air(random);
    }
    scene
}

/// Around a garden, higher than its trees and houses: everything is seen from above.
fn from_the_air(random: &mut Random) -> Trajectory {
    let (from, span) = (random.within(-180.0, 180.0), random.within(40.0, 90.0));
    Trajectory::Arc {
        target: v(random.within(-1.0, 1.0), random.within(-0.5, 1.5), 0.5),
        radius: random.within(4.0, 9.0),
        height: random.within(8.0, 12.0),
        from,
        to: from + span,
    }
}
