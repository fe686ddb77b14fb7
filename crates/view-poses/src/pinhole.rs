//! Photographs without the distortion of their lens.

use crate::engine::{Solution, Task};
use crate::photographs::write_picture;
use crate::{Error, Result};
use gs_scene::{Distortion, Intrinsics, Lens};
use image::{DynamicImage, RgbImage};
use rayon::prelude::*;
use std::path::Path;
use view_data::open_nerfstudio;

/// Replaces the photographs of the data set in `folder`, which was written from this solution, by pinhole pictures, and lenses and
/// observations of the solution by theirs. Photographs of one lens get one size; all may lose some pixels at the border.
///
/// # Errors
/// If a lens folds inside the picture, or a picture cannot be read or written.
pub(crate) fn undistort(solution: &mut Solution, task: &Task<'_>, folder: &Path) -> Result<()> {
    let dataset = open_nerfstudio(folder)?;
    let posed: Vec<usize> =
        (0..task.photographs.len()).filter(|&index| solution.poses[index].is_some()).collect();
    let pinholes: Vec<Intrinsics> = posed
        .par_iter()
        .enumerate()
        .map(|(frame, &index)| {
            let lens = &solution.lenses[task.photographs[index].camera];
            if lens.model.is_pinhole() {
                return Ok(lens.intrinsics);
            }
            let view = dataset.load_views(&[frame], None)?.swap_remove(0);
            let image = view.image();
            let (width, height) = (image.width() as u32, image.height() as u32);
            let target = folder.join("images").join(&task.photographs[index].name);
            let picture = RgbImage::from_raw(width, height, image.to_rgb8()).ok_or_else(|| Error::File {
                action: "write",
                path: target.clone(),
                source: std::io::Error::other("its size does not fit its pixels"),
            })?;
            write_picture(&DynamicImage::ImageRgb8(picture), &target)?;
            Ok(*view.camera().intrinsics())
        })
        .collect::<Result<_>>()?;

    let before = solution.lenses.clone();
    for (&index, &intrinsics) in posed.iter().zip(&pinholes) {
        let model = Distortion::default().into();
        solution.lenses[task.photographs[index].camera] = Lens { intrinsics, model };
    }
    for point in &mut solution.points {
        point.observations.retain_mut(|seen| {
            let camera = task.photographs[seen.frame].camera;
            let Some(direction) = before[camera].undistort(seen.pixel) else { return false };
            let Intrinsics { fx, fy, cx, cy, width, height } = solution.lenses[camera].intrinsics;
            seen.pixel = glam::DVec2::new(fx * direction.x + cx, fy * direction.y + cy);
            // What lies on lines that were cut off is no longer in the picture.
            (0.0..=width as f64).contains(&seen.pixel.x) && (0.0..=height as f64).contains(&seen.pixel.y)
        });
    }
    solution.points.retain(|point| point.observations.len() > 1);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Pose;
    use crate::verdict::write_data_set;
    use crate::{CameraGroup, Photograph};
    use glam::{DMat3, DVec2, DVec3};
    use view_data::{Observation, ScenePoint, open_colmap};

    const SIZE: [usize; 2] = [120, 90];

    /// A picture whose colours tell where a pixel is.
    fn ramp() -> RgbImage {
        RgbImage::from_fn(SIZE[0] as u32, SIZE[1] as u32, |x, y| image::Rgb([2 * x as u8, 2 * y as u8, 9]))
    }

    #[test]
    fn what_was_seen_at_a_pixel_is_where_its_point_is_now() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("images")).unwrap();
        let photographs = ["a.png", "b.png", "c.png"].map(|name| Photograph::of_size(name, SIZE));
        for photograph in &photographs {
            ramp().save(folder.path().join("images").join(&photograph.name)).unwrap();
        }
        let [width, height] = SIZE;
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 60.0, cy: 45.0, width, height };
        let lens = Lens { intrinsics, model: Distortion { k1: 0.12, ..Distortion::default() }.into() };
        let pose = |x: f64| Some(Pose { axes: DMat3::IDENTITY, position: DVec3::new(x, 0.0, 0.0) });
        let mut points = Vec::new();
        for (x, y) in [(-0.9, -0.7), (0.0, 0.0), (0.5, 0.3), (1.3, 1.0)] {
            let position = DVec3::new(x, y, 3.0);
            let seen = |(frame, shift): (usize, f64)| {
                let direction = DVec2::new(position.x - shift, position.y) / position.z;
                Observation { frame, pixel: lens.distort(direction) }
            };
            let observations = [(0, 0.0), (2, 0.2)].map(seen).to_vec();
            points.push(ScenePoint { position, colour: None, error: None, observations });
        }
        let before = points.clone();
        // The second photograph has no pose.
        let mut solution = Solution {
            lenses: vec![lens],
            poses: vec![pose(0.0), None, pose(0.2)],
            reasons: vec![None; 3],
            points,
        };
        let camera =
            CameraGroup { width, height, name: None, focal_mm: None, focal_pixels: None, photographs: 3 };
        let task = Task {
            images: &folder.path().join("images"),
            photographs: &photographs,
            cameras: &[camera],
            sequence: false,
            seed: 0,
            work: folder.path(),
        };
        write_data_set(&solution, &task, folder.path()).unwrap();
        undistort(&mut solution, &task, folder.path()).unwrap();
        write_data_set(&solution, &task, folder.path()).unwrap();

        assert_eq!(solution.points.len(), before.len());
        let dataset = open_colmap(&folder.path().join("sparse/0")).unwrap();
        assert_eq!(dataset.frames.len(), 2);
        for (frame, index) in dataset.frames.iter().zip([0, 2]) {
            assert!(frame.lens.model.is_pinhole());
            let picture =
                image::open(folder.path().join("images").join(&photographs[index].name)).unwrap().to_rgb8();
            let found = &frame.lens.intrinsics;
            assert_eq!((found.width, found.height), (picture.width() as usize, picture.height() as usize));
            assert!(found.width <= width && found.height < height, "{found:?}");
            for (point, old) in solution.points.iter().zip(&before) {
                let seen = |point: &ScenePoint| {
                    point.observations.iter().find(|seen| seen.frame == index).map(|seen| seen.pixel).unwrap()
                };
                let camera = frame.camera().unwrap();
                let pixel = camera.project(point.position).unwrap();
                assert!((pixel - seen(point)).length() < 1e-6);
                // Colours count pixels by their corner, positions by their middle.
                let shown = picture.get_pixel(pixel.x as u32, pixel.y as u32).0;
                let source = seen(old) - DVec2::splat(0.5);
                let error = (DVec2::new(f64::from(shown[0]), f64::from(shown[1])) / 2.0 - source).abs();
                assert!(error.max_element() < 1.0, "{shown:?} at {pixel}, seen at {source}");
            }
        }
    }
}
