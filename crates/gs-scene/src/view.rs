use crate::{Camera, DepthMap, Error, Image, Result};

/// A posed photograph: what every reader of a data set yields and every backbone takes.
#[derive(Debug, Clone)]
pub struct View {
    name: String,
    image: Image,
    camera: Camera,
    depth: Option<DepthMap>,
}

impl View {
    /// A view; image and depth must have the camera's size.
    ///
    /// # Errors
    /// If a size differs.
    pub fn new(
        name: impl Into<String>,
        image: Image,
        camera: Camera,
        depth: Option<DepthMap>,
    ) -> Result<Self> {
        let name = name.into();
        let sizes = [
            Some(("image", image.width(), image.height())),
            depth.as_ref().map(|d| ("depth", d.width(), d.height())),
        ];
        for (what, found_width, found_height) in sizes.into_iter().flatten() {
            let (width, height) = (camera.width(), camera.height());
            if (found_width, found_height) != (width, height) {
                return Err(Error::SizeMismatch {
                    view: name,
                    what,
                    width,
                    height,
                    found_width,
                    found_height,
                });
            }
        }
        Ok(Self { name, image, camera, depth })
    }

    /// Name of the view (the file's stem, usually).
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The photograph.
    #[must_use]
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// The photograph, to change in place.
    pub fn image_mut(&mut self) -> &mut Image {
        &mut self.image
    }

    /// Where it was taken from.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Measured z-depth, where the data has it.
    #[must_use]
    pub fn depth(&self) -> Option<&DepthMap> {
        self.depth.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;
    use glam::{DMat3, DVec3};

    #[test]
    fn sizes_must_agree() {
        let lens = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.0, cy: 1.5, width: 4, height: 3 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let image = Image::filled(4, 3, [0.5; 3]).unwrap();
        assert!(View::new("a", image.clone(), camera, None).is_ok());
        let wrong = View::new("a", image.clone(), camera, Some(DepthMap::new(3, 3, vec![1.0; 9]).unwrap()));
        assert_eq!(wrong.unwrap_err().to_string(), "view a: depth is 3x3, the camera says 4x3");
        assert!(View::new("a", Image::filled(3, 4, [0.5; 3]).unwrap(), camera, None).is_err());
    }
}
