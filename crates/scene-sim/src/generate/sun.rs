//! Skies and suns.

use crate::random::Random;
use crate::stage::v;
use crate::{Sky, Sun};
use glam::{DVec2, DVec3};

/// The light of a day outside: noon, a low sun, or overcast. The sun stands on the side of `from`.
pub(crate) fn daylight(random: &mut Random, from: DVec3) -> (Sky, Option<Sun>) {
    let side = DVec2::from_angle(random.within(-1.1, 1.1)).rotate(from.truncate());
    let ground = [0.46, 0.45, 0.40];
    match random.count(0, 4) {
        0 => {
            let (zenith, horizon) =
                (random.near([0.78, 0.82, 0.86], 0.03), random.near([0.88, 0.89, 0.90], 0.02));
            (Sky { zenith, horizon, ground, light: random.within(1.0, 1.2) as f32, occlusion: None }, None)
        }
        1 => {
            let (zenith, horizon) = (random.near([0.38, 0.52, 0.78], 0.04), [0.96, 0.86, 0.72]);
            let light = random.within(0.5, 0.65) as f32;
            let towards = side.extend(random.within(0.3, 0.45));
            let sun = Sun { towards, colour: [1.0, 0.86, 0.66], strength: 0.95, diameter: 0.0 };
            (Sky { zenith, horizon, ground, light, occlusion: None }, Some(sun))
        }
        _ => {
            let (zenith, horizon) =
                (random.near([0.34, 0.55, 0.86], 0.05), random.near([0.82, 0.89, 0.95], 0.03));
            let light = random.within(0.5, 0.68) as f32;
            let towards = v(side.x, side.y, random.within(0.7, 1.5));
            let sun = Sun { towards, colour: [1.0, 0.965, 0.9], strength: 0.88, diameter: 0.0 };
            (Sky { zenith, horizon, ground, light, occlusion: None }, Some(sun))
        }
    }
}
