//! The sensor: exposure, noise, and the encoding of light.

use super::RayCounts;
use super::film::Film;
use crate::noise::{hash, normal};
use crate::texture::encode;
use crate::{Exposure, Photographs, Rgb, SensorNoise};
use glam::Vec3;

/// Exposure, noise and white balance of one picture.
pub(super) struct Sensor {
    /// What exposure multiplies the light by before it arrives: more light, less noise.
    exposure: f32,
    /// What the camera multiplies the channels by after they were read out, noise included.
    balance: Vec3,
    has_gains: bool,
    noise: Option<SensorNoise>,
    /// Of this picture alone.
    seed: u32,
}

impl Sensor {
    /// `None` where the picture is recorded as it is. `seed` is that of the picture.
    pub(super) fn new(photographs: &Photographs, seed: u32) -> Option<Self> {
        let exposure = photographs.exposure.filter(|e| e.stops > 0.0 || e.white_balance > 0.0);
        if exposure.is_none() && photographs.noise.is_none() {
            return None;
        }
        let Exposure { stops, white_balance } =
            exposure.unwrap_or(Exposure { stops: 0.0, white_balance: 0.0 });
        let gain = |deviation: f64, which| (deviation * normal(hash(which, 0, 0x71, seed))).exp2() as f32;
        Some(Self {
            exposure: gain(stops, 0),
            balance: Vec3::new(gain(white_balance, 1), 1.0, gain(white_balance, 2)),
            has_gains: exposure.is_some(),
            noise: photographs.noise,
            seed: hash(0, 1, 0x72, seed),
        })
    }

    /// What linear light is multiplied by.
    pub(super) fn gains(&self) -> Vec3 {
        self.balance * self.exposure
    }
}

impl Film for Sensor {
    fn expose(&self, light: Vec3) -> Vec3 {
        (light * self.gains()).min(Vec3::ONE)
    }

    fn develop(&self, x: usize, y: usize, mean: Vec3, counts: &mut RayCounts) -> Rgb {
        counts.gains += u64::from(self.has_gains);
        let Some(SensorNoise { full_well, read }) = self.noise else { return encode(mean) };
        counts.noise += 3;
        let noisy = std::array::from_fn(|c| {
            let balance = f64::from(self.balance[c]);
            let electrons = f64::from(mean[c]) / balance * full_well;
            // Photons arrive independently of each other: their variance is their number (Poisson, here normal).
            let deviation = (electrons + read * read).sqrt();
            let counted = electrons + deviation * normal(hash(x as u32, y as u32, c as u32, self.seed));
            (counted / full_well * balance) as f32
        });
        encode(Vec3::from_array(noisy))
    }
}
