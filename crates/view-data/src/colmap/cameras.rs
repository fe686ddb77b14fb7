//! COLMAP's camera models (`src/colmap/sensor/models.h`) as lenses.

use crate::{FormatRule, Lens};
use gs_scene::{Distortion, Intrinsics, LensModel};

/// A camera model: its number in binary files is its place in [`MODELS`].
pub(super) struct CameraModel {
    pub(super) name: &'static str,
    /// One focal length (and then principal point and coefficients), or two.
    focals: usize,
    coefficients: usize,
}

const fn model(name: &'static str, focals: usize, coefficients: usize) -> CameraModel {
    CameraModel { name, focals, coefficients }
}

/// All models of COLMAP 4.
const MODELS: [CameraModel; 18] = [
    model("SIMPLE_PINHOLE", 1, 0),
    model("PINHOLE", 2, 0),
    model("SIMPLE_RADIAL", 1, 1),
    model("RADIAL", 1, 2),
    model("OPENCV", 2, 4),
    model("OPENCV_FISHEYE", 2, 4),
    model("FULL_OPENCV", 2, 8),
    model("FOV", 2, 1),
    model("SIMPLE_RADIAL_FISHEYE", 1, 1),
    model("RADIAL_FISHEYE", 1, 2),
    model("THIN_PRISM_FISHEYE", 2, 8),
    model("RAD_TAN_THIN_PRISM_FISHEYE", 2, 12),
    model("SIMPLE_DIVISION", 1, 1),
    model("DIVISION", 2, 1),
    model("SIMPLE_FISHEYE", 1, 0),
    model("FISHEYE", 2, 0),
    model("EUCM", 2, 2),
    model(PANORAMA, 0, 0),
];

const PANORAMA: &str = "EQUIRECTANGULAR";

impl CameraModel {
    pub(super) fn by_number(number: i32) -> Result<&'static Self, FormatRule> {
        let model = usize::try_from(number).ok().and_then(|number| MODELS.get(number));
        model.ok_or_else(|| FormatRule::UnknownModel { found: number.to_string() })?.perspective()
    }

    pub(super) fn by_name(name: &str) -> Result<&'static Self, FormatRule> {
        let model = MODELS.iter().find(|model| model.name == name);
        let found = || name.chars().take(40).collect();
        model.ok_or_else(|| FormatRule::UnknownModel { found: found() })?.perspective()
    }

    fn perspective(&'static self) -> Result<&'static Self, FormatRule> {
        if self.name == PANORAMA { Err(FormatRule::Panorama { model: self.name }) } else { Ok(self) }
    }

    /// How many parameters it has.
    pub(super) fn parameters(&self) -> usize {
        self.focals + 2 + self.coefficients
    }

    /// The lens of a camera.
    pub(super) fn lens(&self, width: u64, height: u64, parameters: &[f64]) -> Result<Lens, FormatRule> {
        let expected = self.parameters();
        if parameters.len() != expected {
            return Err(FormatRule::Parameters { model: self.name, expected, found: parameters.len() });
        }
        if let Some(&found) = parameters.iter().find(|value| !value.is_finite()) {
            return Err(FormatRule::NotFinite { what: "a camera parameter", found });
        }
        let (pinhole, c) = parameters.split_at(self.focals + 2);
        let (fx, fy) = (pinhole[0], pinhole[self.focals - 1]);
        let (cx, cy) = (pinhole[self.focals], pinhole[self.focals + 1]);
        let side = |side: u64| usize::try_from(side).unwrap_or(usize::MAX);
        let intrinsics = Intrinsics { fx, fy, cx, cy, width: side(width), height: side(height) };
        gs_scene::Camera::new(intrinsics, glam::DMat3::IDENTITY, glam::DVec3::ZERO)
            .map_err(FormatRule::Camera)?;
        let brown = |k1, k2, p1, p2| LensModel::from(Distortion { k1, k2, k3: 0.0, p1, p2 });
        let model = match self.name {
            "SIMPLE_PINHOLE" | "PINHOLE" => LensModel::PINHOLE,
            "SIMPLE_RADIAL" => brown(c[0], 0.0, 0.0, 0.0),
            "RADIAL" => brown(c[0], c[1], 0.0, 0.0),
            "OPENCV" => brown(c[0], c[1], c[2], c[3]),
            "FULL_OPENCV" => LensModel::Rational { k: [c[0], c[1], c[4], c[5], c[6], c[7]], p: [c[2], c[3]] },
            "SIMPLE_FISHEYE" | "FISHEYE" => LensModel::Fisheye { k: [0.0; 4] },
            "SIMPLE_RADIAL_FISHEYE" => LensModel::Fisheye { k: [c[0], 0.0, 0.0, 0.0] },
            "RADIAL_FISHEYE" => LensModel::Fisheye { k: [c[0], c[1], 0.0, 0.0] },
            "OPENCV_FISHEYE" => LensModel::Fisheye { k: [c[0], c[1], c[2], c[3]] },
            "THIN_PRISM_FISHEYE" => {
                LensModel::ThinPrismFisheye { k: [c[0], c[1], c[4], c[5]], p: [c[2], c[3]], s: [c[6], c[7]] }
            }
            "RAD_TAN_THIN_PRISM_FISHEYE" => LensModel::RadTanThinPrismFisheye {
                k: [c[0], c[1], c[2], c[3], c[4], c[5]],
                p: [c[6], c[7]],
                s: [c[8], c[9], c[10], c[11]],
            },
            "FOV" if c[0] == 0.0 => LensModel::PINHOLE,
            "FOV" => LensModel::Fov { omega: c[0].abs() },
            "SIMPLE_DIVISION" | "DIVISION" => LensModel::Division { k: c[0] },
            _ => LensModel::ExtendedUnified { alpha: c[0], beta: c[1] },
        };
        if !model.is_valid() {
            return Err(FormatRule::Coefficients { model: self.name, found: c.to_vec() });
        }
        Ok(Lens { intrinsics, model })
    }
}
