//! From frames to views: decode, undistort, resize, crop, attach depth.

use crate::depth::{Counts, read_depth};
use crate::picture::{self, check_pixels};
use crate::undistort::Undistortion;
use crate::{Dataset, DepthFile, Error, Frame, Result};
use glam::DVec2;
use gs_scene::{Camera, DepthMap, Image, Intrinsics, View};
use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb};
use rayon::prelude::*;
use std::ops::Range;

impl Dataset {
    /// Reads the frames at `positions`, in that order and in parallel, each undistorted to a pinhole picture.
    ///
    /// With a `size` (width, height) every picture is resized to cover it (Lanczos-3, widened when it shrinks, in
    /// f32 without rounding to 8 bits, clipped to 0..1) and cut to it around its centre; the intrinsics follow
    /// exactly. Without, pictures stay as they lie on disk. Intrinsics given for another size are scaled to the
    /// file's.
    ///
    /// Undistortion keeps the focal lengths and the pixel grid, samples bicubically, and cuts off border lines until
    /// no pixel shows what the lens did not see: an undistorted picture may be some pixels smaller than its file.
    /// Depth takes the nearest measurement, never a blend of two. A picture that the data set states the turned size of is turned as its EXIF
    /// data ask ([`Frame::picture`]).
    ///
    /// # Errors
    /// If a position does not exist, a file is missing, truncated or of a wrong type or shape, a lens model folds
    /// inside the picture, or, without `size`, the views have different sizes. The first of several errors, in the
    /// order of `positions`, is the one returned.
    pub fn load_views(&self, positions: &[usize], size: Option<(usize, usize)>) -> Result<Vec<View>> {
        if let Some((width, height)) = size {
            check_pixels("target size", width, height)?;
        }
        let frames = positions.iter().map(|&position| self.frame(position)).collect::<Result<Vec<_>>>()?;
        // What a header does not say, loading will.
        let pixels =
            |frame: &&Frame| picture::size(&frame.image, &frame.name).map_or(0, |(w, h)| w.saturating_mul(h));
        let pixels: Vec<usize> = frames.par_iter().map(pixels).collect();
        let mut views = Vec::with_capacity(frames.len());
        for together in batches(&pixels) {
            let loaded: Vec<Result<View>> =
                frames[together].par_iter().map(|frame| load(frame, size)).collect();
            for view in loaded {
                views.push(view?);
            }
        }
        let shape = |view: &View| (view.camera().width(), view.camera().height());
        for pair in views.windows(2) {
            let ((first_width, first_height), (second_width, second_height)) =
                (shape(&pair[0]), shape(&pair[1]));
            if shape(&pair[0]) != shape(&pair[1]) {
                return Err(Error::MixedSizes {
                    first: pair[0].name().to_owned(),
                    first_width,
                    first_height,
                    second: pair[1].name().to_owned(),
                    second_width,
                    second_height,
                });
            }
        }
        Ok(views)
    }
}

/// Pictures that are decoded and undistorted side by side have at most so many pixels in all: some 30 bytes of each are held
/// meanwhile.
const PIXELS_AT_ONCE: usize = 1 << 26;

/// Neighbours in the list that are loaded side by side; one that is too large goes alone.
fn batches(pixels: &[usize]) -> Vec<Range<usize>> {
    let mut batches = Vec::new();
    let (mut first, mut sum) = (0, 0usize);
    for (i, &count) in pixels.iter().enumerate() {
        sum = sum.saturating_add(count);
        if sum > PIXELS_AT_ONCE && i > first {
            batches.push(first..i);
            (first, sum) = (i, count);
        }
    }
    batches.extend((first < pixels.len()).then_some(first..pixels.len()));
    batches
}

pub(crate) fn load(frame: &Frame, size: Option<(usize, usize)>) -> Result<View> {
    let invalid = |source| Error::View { frame: frame.name.clone(), source };
    let image = frame.picture()?;
    let (file_width, file_height) = (image.width(), image.height());
    let Intrinsics { width: stated_width, height: stated_height, .. } = frame.lens.intrinsics;
    let lens = frame.lens.at_size(file_width, file_height).ok_or_else(|| Error::Aspect {
        path: frame.image.path().to_path_buf(),
        width: file_width,
        height: file_height,
        stated_width,
        stated_height,
    })?;
    let undistortion = Undistortion::new(lens, frame.image.path())?;
    let image = undistortion.apply(image, frame.image.path())?;
    let fit = Fit::new(undistortion.intrinsics(), size);
    // A strip that is to cover a target of another shape grows without bound.
    check_pixels(&format!("{} resized", frame.image), fit.resized.0, fit.resized.1)?;
    let image = fit.apply(image).map_err(invalid)?;
    let depth = frame.measured_depth((file_width, file_height), fit.intrinsics, |position| {
        undistortion.source(fit.source(position))
    });
    let camera = Camera::from_camera_to_world(fit.intrinsics, frame.axes, frame.position).map_err(invalid)?;
    View::new(frame.name.clone(), image, camera, depth.transpose()?).map_err(invalid)
}

/// Resizing to cover a target, then cutting to it around the centre.
struct Fit {
    /// Size after resizing, before the cut.
    resized: (usize, usize),
    left: usize,
    top: usize,
    /// Source pixels per resized pixel.
    step: DVec2,
    /// The lens of the result.
    intrinsics: Intrinsics,
}

impl Fit {
    fn new(from: Intrinsics, size: Option<(usize, usize)>) -> Self {
        let (width, height) = size.unwrap_or((from.width, from.height));
        let scale = (width as f64 / from.width as f64).max(height as f64 / from.height as f64);
        let cover = |from: usize, to: usize| ((from as f64 * scale).round() as usize).max(to);
        let resized = (cover(from.width, width), cover(from.height, height));
        let (left, top) = ((resized.0 - width) / 2, (resized.1 - height) / 2);
        Self {
            resized,
            left,
            top,
            step: DVec2::new(from.width as f64 / resized.0 as f64, from.height as f64 / resized.1 as f64),
            intrinsics: from.resized(resized.0, resized.1).cropped(left, top, width, height),
        }
    }

    /// Position in the result to position in the picture given, pixels.
    fn source(&self, position: DVec2) -> DVec2 {
        (position + DVec2::new(self.left as f64, self.top as f64)) * self.step
    }

    fn apply(&self, image: Image) -> gs_scene::Result<Image> {
        let (from_width, from_height) = (image.width(), image.height());
        let Intrinsics { width, height, .. } = self.intrinsics;
        if (from_width, from_height) == (width, height) {
            return Ok(image);
        }
        let source =
            ImageBuffer::<Rgb<f32>, _>::from_raw(from_width as u32, from_height as u32, image.data())
                .expect("an Image holds as many values as its size says");
        let resized = resize(&source, self.resized.0 as u32, self.resized.1 as u32, FilterType::Lanczos3);
        let row_length = self.resized.0 * 3;
        let rows = resized.as_raw().chunks_exact(row_length).skip(self.top).take(height);
        let cut = rows.flat_map(|row| &row[self.left * 3..(self.left + width) * 3]);
        Image::new(width, height, cut.map(|value| value.clamp(0.0, 1.0)).collect())
    }
}

impl Frame {
    /// The measured depth, if there is a file of it, on the pixels of a view: the nearest measurement, 0 where there is none.
    /// `picture` is the size of the picture in its file, and `to_picture` takes pixel positions of the view there.
    #[must_use]
    pub fn measured_depth(
        &self,
        picture: (usize, usize),
        view: Intrinsics,
        to_picture: impl Fn(DVec2) -> DVec2,
    ) -> Option<Result<DepthMap>> {
        let file = self.depth.as_ref()?;
        Some(DepthGrid { file, frame: &self.name, picture }.sample(view, to_picture))
    }
}

/// Measured depth on its way to a view.
struct DepthGrid<'a> {
    file: &'a DepthFile,
    frame: &'a str,
    /// Size of the picture that it belongs to; the file may be finer or coarser.
    picture: (usize, usize),
}

impl DepthGrid<'_> {
    /// The depth map of a view, whose pixel positions `to_picture` takes to the undistorted picture's file.
    fn sample(&self, view: Intrinsics, to_picture: impl Fn(DVec2) -> DVec2) -> Result<DepthMap> {
        let Counts { width, height, values } = read_depth(&self.file.path, self.frame)?;
        // The size that pixel positions are for: of the depth's own pinhole, or of the picture.
        let stated = self.file.intrinsics.map_or(self.picture, |pinhole| (pinhole.width, pinhole.height));
        let scale = DVec2::new(width as f64 / stated.0 as f64, height as f64 / stated.1 as f64);
        if (scale.x / scale.y - 1.0).abs() > gs_scene::MAX_ASPECT_DEVIATION {
            return Err(Error::Aspect {
                path: self.file.path.clone(),
                width,
                height,
                stated_width: stated.0,
                stated_height: stated.1,
            });
        }
        let mut data = Vec::with_capacity(view.width * view.height);
        for y in 0..view.height {
            for x in 0..view.width {
                let position = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let position = match &self.file.intrinsics {
                    None => to_picture(position).max(DVec2::ZERO),
                    Some(Intrinsics { fx, fy, cx, cy, .. }) => {
                        let ray = view.ray(position);
                        DVec2::new(fx * ray.x + cx, fy * ray.y + cy)
                    }
                };
                let place = position * scale;
                // A depth camera of its own may see less than the picture.
                let inside = place.x >= 0.0 && place.y >= 0.0;
                let inside = inside
                    && (self.file.intrinsics.is_none() || place.x < width as f64 && place.y < height as f64);
                let (column, row) = ((place.x as usize).min(width - 1), (place.y as usize).min(height - 1));
                let count = f64::from(values[row * width + column]);
                let measured = inside && count > 0.0 && count <= self.file.max_count && count.is_finite();
                data.push(if measured { (count * self.file.unit) as f32 } else { 0.0 });
            }
        }
        DepthMap::new(view.width, view.height, data)
            .map_err(|source| Error::View { frame: self.frame.to_owned(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_pictures_are_loaded_alone_and_small_ones_together() {
        let large = PIXELS_AT_ONCE + 1;
        assert_eq!(batches(&[]), []);
        assert_eq!(batches(&[0, 10, 20]), vec![Range { start: 0, end: 3 }]);
        assert_eq!(batches(&[large, large, 5, 5]), [0..1, 1..2, 2..4]);
        assert_eq!(batches(&[PIXELS_AT_ONCE, 1, usize::MAX, 1]), [0..1, 1..2, 2..3, 3..4]);
    }
}
