//! Keyframes: a few whose pictures are kept, and the footprints of many.

use crate::Result;
use crate::covisibility::Footprint;
use gs_scene::{Camera, DepthMap, Image, View};

/// Footprints of keyframes that are remembered; of more the oldest are forgotten, and their places may become keyframes again.
pub(crate) const FOOTPRINTS: usize = 512;

/// A keyframe whose picture is kept, with 8 bits per channel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Keyframe {
    pub(crate) name: String,
    pub(crate) footprint: Footprint,
    /// `[height, width, 3]`.
    pub(crate) rgb: Vec<u8>,
    /// Measured depth, `[height, width]`.
    pub(crate) depth: Option<Vec<f32>>,
}

impl Keyframe {
    pub(crate) fn new(view: &View, footprint: Footprint) -> Self {
        Self {
            name: view.name().to_owned(),
            footprint,
            rgb: view.image().to_rgb8(),
            depth: view.depth().map(|depth| depth.data().to_vec()),
        }
    }

    pub(crate) fn camera(&self) -> &Camera {
        &self.footprint.camera
    }

    /// As it came, but for the rounding of its picture.
    pub(crate) fn view(&self) -> Result<View> {
        let (width, height) = (self.camera().width(), self.camera().height());
        let image = Image::from_rgb8(width, height, &self.rgb)?;
        let depth =
            self.depth.as_ref().map(|depth| DepthMap::new(width, height, depth.clone())).transpose()?;
        Ok(View::new(self.name.clone(), image, *self.camera(), depth)?)
    }
}

/// All that is remembered of keyframes.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Keyframes {
    /// Those whose pictures are kept, oldest first.
    pub(crate) kept: Vec<Keyframe>,
    /// Of every keyframe, oldest first.
    pub(crate) footprints: Vec<Footprint>,
    /// How many there were.
    pub(crate) count: usize,
}

impl Keyframes {
    /// Adds one, of which at most `most` keep their pictures: the newer half as they came, and old ones that differ.
    pub(crate) fn push(&mut self, keyframe: Keyframe, most: usize) {
        self.count += 1;
        if self.footprints.len() == FOOTPRINTS {
            self.footprints.remove(0);
        }
        self.footprints.push(keyframe.footprint.clone());
        if self.kept.len() == most {
            let old = most - most / 2;
            let redundancy = |i: usize| {
                let others = self.kept.iter().enumerate().filter(|&(j, _)| j != i);
                others
                    .map(|(_, other)| self.kept[i].footprint.similarity(&other.footprint))
                    .fold(0.0, f64::max)
            };
            let worst = (0..old).max_by(|&i, &j| redundancy(i).total_cmp(&redundancy(j)).then(j.cmp(&i)));
            self.kept.remove(worst.unwrap_or(0));
        }
        self.kept.push(keyframe);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covisibility::POINTS;
    use glam::{DMat3, DVec3};
    use gs_scene::Intrinsics;

    fn keyframe(x: f64) -> Keyframe {
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 12.0, cy: 8.0, width: 24, height: 16 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-x, 0.0, 0.0)).unwrap();
        let view = View::new(format!("{x}"), Image::filled(24, 16, [0.2; 3]).unwrap(), camera, None).unwrap();
        Keyframe::new(&view, Footprint { camera, depths: vec![2.0; POINTS] })
    }

    #[test]
    fn new_ones_are_kept_and_of_the_old_ones_those_that_differ() {
        let mut keyframes = Keyframes::default();
        for x in [0.0, 0.01, 5.0, 7.0, 7.1, 7.2] {
            keyframes.push(keyframe(x), 4);
        }
        let names: Vec<&str> = keyframes.kept.iter().map(|keyframe| keyframe.name.as_str()).collect();
        assert_eq!((names.len(), names[2..].to_vec()), (4, vec!["7.1", "7.2"]));
        assert!(names.contains(&"5"), "{names:?}");
        assert_eq!((keyframes.count, keyframes.footprints.len()), (6, 6));
    }

    #[test]
    fn footprints_do_not_grow_without_bound() {
        let mut keyframes = Keyframes::default();
        for i in 0..FOOTPRINTS + 3 {
            keyframes.push(keyframe(i as f64), 2);
        }
        assert_eq!((keyframes.footprints.len(), keyframes.count), (FOOTPRINTS, FOOTPRINTS + 3));
        assert_eq!(keyframes.footprints[0].camera.position().x, 3.0);
    }

    #[test]
    fn a_kept_picture_has_eight_bits() {
        let view = keyframe(1.0).view().unwrap();
        assert_eq!(view.image().data()[0], 51.0 / 255.0);
        assert!(view.depth().is_none());
    }
}
