//! Scenes far from the origin of their world, as surveyors' coordinates are.

use crate::{Dataset, Frame};
use glam::{DAffine3, DVec3};

/// A scene that is farther from the origin than so many times its own size is brought near it: Gaussians are stored as f32, whose
/// 24 bits then are spent on the distance. At a thousand a place is known to 6e-5 of the size, a thirtieth of a pixel.
const FAR: f64 = 1000.0;

impl Dataset {
    /// The data set with its scene near the origin. What is subtracted is a round number, so that parts of one scene mostly share it.
    pub(crate) fn near_origin(mut self) -> Self {
        let Some(offset) = far_offset(&self.frames) else { return self };
        for frame in &mut self.frames {
            frame.position -= offset;
        }
        self.applied_transform =
            self.applied_transform.map(|transform| DAffine3::from_translation(-offset) * transform);
        self.offset = Some(offset);
        self
    }
}

/// What to subtract; `None` where the numbers are small enough.
fn far_offset(frames: &[Frame]) -> Option<DVec3> {
    let mean = frames.iter().map(|frame| frame.position).sum::<DVec3>() / frames.len().max(1) as f64;
    let size = frames.iter().map(|frame| frame.position.distance(mean)).fold(0.0, f64::max);
    // Cameras in one place tell no size; a scene of one unit is what most have.
    let size = if size > 0.0 { size } else { 1.0 };
    if !mean.is_finite() || mean.length() <= FAR * size.max(1.0) {
        return None;
    }
    let grid = 10f64.powf((FAR * size).log10().floor());
    let offset = (mean / grid).round() * grid;
    (offset != DVec3::ZERO).then_some(offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Format, ImageSource, Lens, LensModel};
    use glam::DMat3;
    use gs_scene::Intrinsics;

    fn frames(positions: &[DVec3]) -> Vec<Frame> {
        let intrinsics = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
        let frame = |&position: &DVec3| Frame {
            name: String::new(),
            time: None,
            image: ImageSource::Missing("nowhere".into()),
            depth: None,
            mask_path: None,
            lens: Lens { intrinsics, model: LensModel::PINHOLE },
            axes: DMat3::IDENTITY,
            position,
        };
        positions.iter().map(frame).collect()
    }

    #[test]
    fn far_scenes_come_near_by_a_round_number_and_others_stay() {
        let near = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 0.0, 1.0)];
        for stay in [&near[..], &[], &near.map(|p| p + 500.0), &[near[0] + 500.0]] {
            assert_eq!(far_offset(&frames(stay)), None);
        }
        let utm = DVec3::new(500_000.0, 5_000_000.0, 0.0);
        let far = near.map(|position| position + utm);
        assert_eq!(far_offset(&frames(&far)), Some(utm));
        // Parts of the scene are brought to the same place.
        assert_eq!(far_offset(&frames(&[far[0], far[0] + 2.0])), Some(utm));
        let mut dataset = Dataset::new(Format::Nerfstudio, String::new(), "".into(), "".into(), frames(&far));
        dataset.applied_transform = Some(DAffine3::IDENTITY);
        let dataset = dataset.near_origin();
        assert_eq!(dataset.offset, Some(utm));
        assert_eq!(dataset.applied_transform.unwrap().translation, -utm);
        assert!(dataset.frames.iter().zip(near).all(|(frame, near)| frame.position == near));
        assert_eq!(far_offset(&dataset.frames), None);
        assert_eq!(far_offset(&frames(&[DVec3::splat(f64::MAX); 2])), None);
    }
}
