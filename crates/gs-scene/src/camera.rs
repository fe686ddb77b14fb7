use crate::{Error, Result};
use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Pinhole intrinsics in pixels. The centre of the top-left pixel is (0.5, 0.5).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Principal point, pixels from the left image edge.
    pub cx: f64,
    /// Principal point, pixels from the top image edge.
    pub cy: f64,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
}

impl Intrinsics {
    /// The same lens on an image scaled to `width` × `height` (each axis by its own factor).
    #[must_use]
    pub fn resized(self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, width, height }
    }

    /// The same lens on the `width` × `height` window whose top-left pixel is (`left`, `top`).
    #[must_use]
    pub fn cropped(self, left: usize, top: usize, width: usize, height: usize) -> Self {
        Self { cx: self.cx - left as f64, cy: self.cy - top as f64, width, height, ..self }
    }

    /// Pixel position to the ray (x/z, y/z, 1) in camera axes.
    #[must_use]
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        DVec3::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy, 1.0)
    }
}

/// A validated pinhole camera: OpenCV axes (x right, y down, z forward), world-to-camera pose in f64, so that
/// scenes far from the origin keep their precision.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawCamera", into = "RawCamera")]
pub struct Camera {
    intrinsics: Intrinsics,
    rotation: DMat3,
    translation: DVec3,
}

/// What a file says of a camera, before it is checked.
#[derive(Serialize, Deserialize)]
struct RawCamera {
    intrinsics: Intrinsics,
    rotation: DMat3,
    translation: DVec3,
}

impl From<Camera> for RawCamera {
    fn from(camera: Camera) -> Self {
        Self { intrinsics: camera.intrinsics, rotation: camera.rotation, translation: camera.translation }
    }
}

impl TryFrom<RawCamera> for Camera {
    type Error = Error;
    fn try_from(raw: RawCamera) -> Result<Self> {
        Self::new(raw.intrinsics, raw.rotation, raw.translation)
    }
}

/// Largest deviation of `R Rᵀ` from the identity that still counts as a rotation.
const ORTHONORMAL_TOLERANCE: f64 = 1e-4;

impl Camera {
    /// A camera from intrinsics and a world-to-camera pose: `p_camera = rotation · p_world + translation`.
    ///
    /// # Errors
    /// If a number is not finite, a focal length is not positive, the image is empty, or the rotation is not
    /// orthonormal within 1e-4 with determinant +1.
    pub fn new(intrinsics: Intrinsics, rotation: DMat3, translation: DVec3) -> Result<Self> {
        let Intrinsics { fx, fy, cx, cy, width, height } = intrinsics;
        for (name, found) in [("fx", fx), ("fy", fy)] {
            if !(found.is_finite() && found > 0.0) {
                return Err(Error::Focal { name, found });
            }
        }
        for (name, found) in [("cx", cx), ("cy", cy)] {
            if !found.is_finite() {
                return Err(Error::PrincipalPoint { name, found });
            }
        }
        crate::image::check_size(width, height)?;
        if !(rotation.is_finite() && translation.is_finite()) {
            return Err(Error::PoseNotFinite);
        }
        let gram = rotation * rotation.transpose() - DMat3::IDENTITY;
        let deviation =
            gram.to_cols_array().into_iter().fold(0.0, |worst: f64, entry| worst.max(entry.abs()));
        if deviation > ORTHONORMAL_TOLERANCE {
            return Err(Error::NotOrthonormal { deviation });
        }
        if rotation.determinant() < 0.0 {
            return Err(Error::Mirrored);
        }
        Ok(Self { intrinsics, rotation, translation })
    }

    /// A camera from its position and axes: the columns of `axes` are the camera's x, y and z axis in the world.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn from_camera_to_world(intrinsics: Intrinsics, axes: DMat3, position: DVec3) -> Result<Self> {
        let rotation = axes.transpose();
        Self::new(intrinsics, rotation, -(rotation * position))
    }

    /// A camera at `position` that looks at `target`, with `up` upwards in its image.
    ///
    /// # Errors
    /// As [`Camera::new`]; a `target` at the position, or `up` along the line of sight, is a pose that is not finite.
    pub fn looking_at(intrinsics: Intrinsics, position: DVec3, target: DVec3, up: DVec3) -> Result<Self> {
        let forward = (target - position).normalize();
        let right = forward.cross(up).normalize();
        let down = forward.cross(right);
        Self::from_camera_to_world(intrinsics, DMat3::from_cols(right, down, forward), position)
    }

    /// The pinhole intrinsics, pixels.
    #[must_use]
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// World-to-camera rotation.
    #[must_use]
    pub fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// World-to-camera translation, scene units.
    #[must_use]
    pub fn translation(&self) -> DVec3 {
        self.translation
    }

    /// Image width, pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.intrinsics.width
    }

    /// Image height, pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.intrinsics.height
    }

    /// The camera centre in the world, scene units.
    #[must_use]
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The viewing direction (camera z axis) in the world, unit length.
    #[must_use]
    pub fn forward(&self) -> DVec3 {
        self.rotation.row(2)
    }

    /// The same pose with other intrinsics.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn with_intrinsics(&self, intrinsics: Intrinsics) -> Result<Self> {
        Self::new(intrinsics, self.rotation, self.translation)
    }

    /// World to camera axes; z of the result is the depth.
    #[must_use]
    pub fn to_camera(&self, world: DVec3) -> DVec3 {
        self.rotation * world + self.translation
    }

    /// Camera axes to world.
    #[must_use]
    pub fn to_world(&self, camera: DVec3) -> DVec3 {
        self.rotation.transpose() * (camera - self.translation)
    }

    /// World point to pixel position, `None` at or behind the camera plane.
    #[must_use]
    pub fn project(&self, world: DVec3) -> Option<DVec2> {
        let p = self.to_camera(world);
        (p.z > 0.0).then(|| {
            let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
            DVec2::new(fx * p.x / p.z + cx, fy * p.y / p.z + cy)
        })
    }

    /// The world point seen at `pixel` at z-depth `depth`.
    #[must_use]
    pub fn unproject(&self, pixel: DVec2, depth: f64) -> DVec3 {
        self.to_world(self.intrinsics.ray(pixel) * depth)
    }

    /// Whether a pixel position lies inside the image.
    #[must_use]
    pub fn contains(&self, pixel: DVec2) -> bool {
        let (width, height) = (self.width() as f64, self.height() as f64);
        pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LENS: Intrinsics =
        Intrinsics { fx: 300.0, fy: 280.0, cx: 150.5, cy: 99.0, width: 320, height: 200 };

    #[test]
    fn bad_cameras_name_their_rule() {
        let nan = Camera::new(LENS, DMat3::IDENTITY, DVec3::new(f64::NAN, 0.0, 0.0));
        assert_eq!(nan.unwrap_err().to_string(), "pose is not finite");
        let zero = Camera::new(Intrinsics { fx: 0.0, ..LENS }, DMat3::IDENTITY, DVec3::ZERO);
        assert_eq!(zero.unwrap_err().to_string(), "focal length fx is 0, expected a finite number above 0");
        let centre = Camera::new(Intrinsics { cy: f64::INFINITY, ..LENS }, DMat3::IDENTITY, DVec3::ZERO);
        assert!(matches!(centre, Err(Error::PrincipalPoint { name: "cy", .. })));
        let size = Camera::new(Intrinsics { width: 0, ..LENS }, DMat3::IDENTITY, DVec3::ZERO);
        assert!(matches!(size, Err(Error::Size { .. })));
        let scaled = Camera::new(LENS, DMat3::IDENTITY * 1.001, DVec3::ZERO);
        assert!(matches!(scaled, Err(Error::NotOrthonormal { .. })));
        let mirror = Camera::new(LENS, DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)), DVec3::ZERO);
        assert!(matches!(mirror, Err(Error::Mirrored)));
        assert!(Camera::looking_at(LENS, DVec3::ONE, DVec3::ONE, DVec3::Z).is_err());
        assert!(Camera::new(LENS, DMat3::from_rotation_x(0.3) * (1.0 + 1e-5), DVec3::ZERO).is_ok());
    }

    #[test]
    fn a_saved_camera_is_checked_when_read() {
        let camera = Camera::new(LENS, DMat3::from_rotation_y(0.4), DVec3::new(1.0, 2.0, 3.0)).unwrap();
        let text = serde_json::to_string(&camera).unwrap();
        assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), camera);
        assert!(serde_json::from_str::<Camera>(&text.replace("300.0", "-300.0")).is_err());
    }

    #[test]
    fn looking_at_puts_the_target_in_the_principal_point_and_up_upwards() {
        let camera = Camera::looking_at(LENS, DVec3::new(3.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z).unwrap();
        let centre = camera.project(DVec3::ZERO).unwrap();
        assert!((centre - DVec2::new(LENS.cx, LENS.cy)).length() < 1e-9);
        assert!(camera.project(DVec3::new(0.0, 0.0, 0.1)).unwrap().y < centre.y);
        assert!((camera.position() - DVec3::new(3.0, -2.0, 1.0)).length() < 1e-12);
    }

    proptest! {
        #[test]
        fn unproject_inverts_project(
            angles in prop::array::uniform3(-3.0..3.0f64), offset in prop::array::uniform3(-1e4..1e4f64),
            x in 0.0..320.0f64, y in 0.0..200.0f64, depth in 0.01..1e3f64,
        ) {
            let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
            let camera = Camera::new(LENS, rotation, DVec3::from(offset)).unwrap();
            let world = camera.unproject(DVec2::new(x, y), depth);
            prop_assert!((camera.to_camera(world).z - depth).abs() < 1e-9 * 1e4);
            let back = camera.project(world).unwrap();
            prop_assert!((back - DVec2::new(x, y)).length() < 1e-4);
        }
    }
}
