//! How a scene is photographed: the path, the lens, and what a real camera adds to the picture.

use crate::{Error, Result, Trajectory, lens};
use glam::DVec2;
use gs_scene::{Distortion, Lens};
use serde::{Deserialize, Serialize};

/// A camera on its way. What is left out is not simulated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photographs {
    /// Size of a picture, pixels.
    pub width: usize,
    /// Size of a picture, pixels.
    pub height: usize,
    /// Horizontal field of view, degrees.
    pub field_of_view: f64,
    /// Where the camera goes.
    pub path: Trajectory,
    /// How many pictures it takes on the way, at equal intervals.
    pub count: usize,
    /// Colour samples per pixel; a square number is best.
    #[serde(default = "nine")]
    pub samples: u32,
    /// OpenCV distortion of the lens. Pictures are distorted; their depth belongs to the distorted pixels.
    #[serde(default)]
    pub distortion: Option<Distortion>,
    /// A lens of finite size: what is not at the focus is blurred.
    #[serde(default)]
    pub aperture: Option<Aperture>,
    /// The shutter's open time as a share of the interval between two pictures, 0 to 1: what moves past is blurred.
    /// The pose of a picture is that at the middle of the open time, and so is its depth. Before the start and after
    /// the end of the path the camera stands still; one picture alone has the whole path as its interval.
    #[serde(default)]
    pub motion_blur: Option<f64>,
    /// Time from the first to the last row as a share of that interval, 0 to 1. The pose is that of the middle row;
    /// the depth of a row is in the camera as it was for that row.
    #[serde(default)]
    pub rolling_shutter: Option<f64>,
    /// Pictures that differ in exposure.
    #[serde(default)]
    pub exposure: Option<Exposure>,
    /// Noise of the sensor.
    #[serde(default)]
    pub noise: Option<SensorNoise>,
    /// Poses that are stated a little wrong, as those are that were found from pictures: standard deviation of the camera's
    /// turn about each of its axes, degrees, 0 to 10. The place is right, and the depth is that of the true pose.
    #[serde(default)]
    pub pose_error: Option<f64>,
}

fn nine() -> u32 {
    9
}

impl Photographs {
    /// Intrinsics and distortion of the lens.
    #[must_use]
    pub fn lens(&self) -> Lens {
        let intrinsics = lens(self.width, self.height, self.field_of_view);
        Lens { intrinsics, model: self.distortion.unwrap_or_default().into() }
    }

    /// Where on the path a picture is taken, 0..=1; a single picture is taken in its middle.
    pub(crate) fn u(&self, index: usize) -> f64 {
        if self.count == 1 { 0.5 } else { index as f64 * self.interval() }
    }

    /// From one picture to the next, as a share of the path.
    pub(crate) fn interval(&self) -> f64 {
        1.0 / (self.count - 1).max(1) as f64
    }

    /// Checks that the distortion takes no two directions inside the picture to one place: along lines from its
    /// middle to its border.
    pub(crate) fn check_lens(&self) -> Result<()> {
        /// Places on a side of the border, and on the line to each of them.
        const STEPS: u32 = 32;
        let lens = self.lens();
        if lens.model.is_pinhole() {
            return Ok(());
        }
        let (width, height) = (self.width as f64, self.height as f64);
        for step in 0..=STEPS {
            let along = f64::from(step) / f64::from(STEPS);
            let (x, y) = (along * width, along * height);
            for (x, y) in [(x, 0.0), (x, height), (0.0, y), (width, y)] {
                let folded = Error::Folded { x, y };
                let Some(direction) = lens.undistort(DVec2::new(x, y)) else { return Err(folded) };
                let line = (1..=STEPS).map(|k| direction * (f64::from(k) / f64::from(STEPS)));
                if !line.into_iter().all(|place| lens.distort_one_to_one(place).is_some()) {
                    return Err(folded);
                }
            }
        }
        Ok(())
    }
}

/// A lens of finite size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Aperture {
    /// Diameter of the opening, metres.
    pub diameter: f64,
    /// Depth at which the picture is sharp, metres. The depth map is that of a pinhole in the middle of the opening.
    pub focus: f64,
}

/// How exposure and white balance vary from picture to picture, at random. Exposure changes how much light arrives,
/// before noise; white balance multiplies what was read out, noise included. What ends above display white is clipped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exposure {
    /// Standard deviation of the exposure, stops (factors of two of linear light).
    pub stops: f64,
    /// Standard deviation of the gain of red and of blue, stops.
    #[serde(default)]
    pub white_balance: f64,
}

/// Noise of the sensor: photons that arrive at random, and what reading them out adds. Every pixel has a sensor for
/// each colour (no mosaic of colour filters); the number of photons is normally distributed, which is close above
/// twenty or so.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorNoise {
    /// Electrons in a pixel at display white: noise is the square root of their number. 10000 for a good camera, 1000
    /// for a telephone indoors.
    pub full_well: f64,
    /// Standard deviation of the read-out, electrons.
    #[serde(default)]
    pub read: f64,
}
