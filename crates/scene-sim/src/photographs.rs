//! How a scene is photographed: the path, the lens, and what a real camera adds to the picture.

use crate::Trajectory;
use gs_scene::Distortion;
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
    /// The pose of a picture is that at the middle of the open time.
    #[serde(default)]
    pub motion_blur: Option<f64>,
    /// Time from the first to the last row as a share of that interval, 0 to 1. The pose is that of the middle row.
    #[serde(default)]
    pub rolling_shutter: Option<f64>,
    /// Pictures that differ in exposure.
    #[serde(default)]
    pub exposure: Option<Exposure>,
    /// Noise of the sensor.
    #[serde(default)]
    pub noise: Option<SensorNoise>,
}

fn nine() -> u32 {
    9
}

/// A lens of finite size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Aperture {
    /// Diameter of the opening, metres.
    pub diameter: f64,
    /// Depth at which the picture is sharp, metres.
    pub focus: f64,
}

/// How exposure and white balance vary from picture to picture, at random.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exposure {
    /// Standard deviation of the exposure, stops (factors of two of linear light).
    pub stops: f64,
    /// Standard deviation of the gain of red and of blue, stops.
    #[serde(default)]
    pub white_balance: f64,
}

/// Noise of the sensor: photons that arrive at random, and what reading them out adds.
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
