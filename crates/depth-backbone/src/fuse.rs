//! Surfaces that several views see, joined.

use crate::backbone::ViewGeometry;
use crate::consistency::{Opinion, Tolerance, Witness};
use crate::{Error, Result};
use gs_scene::{DepthMap, View};
use rayon::prelude::*;

/// One view's depth, joined with that of the others.
#[derive(Debug, Clone, PartialEq)]
pub struct FusedView {
    /// z-depth, scene units; 0 where there is none.
    pub depth: DepthMap,
    /// How many other views have a pixel's surface, too, `[height, width]`.
    pub shared_by: Vec<u8>,
}

/// Moves each pixel along its ray to where all views that see its surface have it: the mean of their inverse depths, weighted by their
/// confidence. Another view sees the surface if the point falls on one of its pixels whose inverse depth differs by at most 1.5 %; one that has a surface before
/// the point, or looks through it, has no say. Pixels without depth or confidence stay as they are and have no say either.
///
/// # Errors
/// If `views` and `geometry` are not as many, or a depth map has another size than its view.
pub fn fuse(views: &[View], geometry: &[ViewGeometry]) -> Result<Vec<FusedView>> {
    if views.len() != geometry.len() {
        return Err(Error::ViewCount { views: views.len(), geometry: geometry.len() });
    }
    for (view, geometry) in views.iter().zip(geometry) {
        let expected = (view.camera().width(), view.camera().height());
        let found = (geometry.depth.width(), geometry.depth.height());
        if found != expected || geometry.confidence.len() != expected.0 * expected.1 {
            return Err(Error::GeometrySize { view: view.name().to_owned(), expected, found });
        }
    }
    let inverse = |geometry: &ViewGeometry| -> Vec<f32> {
        let usable = geometry.depth.data().iter().zip(&geometry.confidence);
        usable.map(|(&z, &confidence)| if z > 0.0 && confidence > 0.0 { 1.0 / z } else { 0.0 }).collect()
    };
    let inverse_depths: Vec<Vec<f32>> = geometry.par_iter().map(inverse).collect();
    let fused = |index: usize| {
        let view = &views[index];
        let others: Vec<(Witness, &[f32])> = (0..views.len())
            .filter(|&other| other != index)
            .map(|other| {
                let witness = Witness::new(view, &views[other], &inverse_depths[other]);
                (witness, &geometry[other].confidence[..])
            })
            .collect();
        let (width, height) = (view.camera().width(), view.camera().height());
        let mut depth = geometry[index].depth.data().to_vec();
        let mut shared_by = vec![0_u8; width * height];
        for (pixel, &w) in inverse_depths[index].iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let (u, v) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
            let own = geometry[index].confidence[pixel];
            let (mut sum, mut weight) = (own * w, own);
            for (witness, confidence) in &others {
                if let Opinion::Agrees { pixel: theirs, inverse_depth } =
                    witness.opinion(u, v, w, Tolerance::default())
                {
                    sum += confidence[theirs] * inverse_depth;
                    weight += confidence[theirs];
                    shared_by[pixel] = shared_by[pixel].saturating_add(1);
                }
            }
            if shared_by[pixel] > 0 {
                depth[pixel] = weight / sum;
            }
        }
        Ok(FusedView { depth: DepthMap::new(width, height, depth)?, shared_by })
    };
    (0..views.len()).into_par_iter().map(fused).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Wanted;
    use crate::backbone::DepthBackbone;
    use crate::given_depth::GivenDepth;
    use glam::DVec3;
    use gs_scene::{Camera, Image, Intrinsics};
    use proptest::prelude::*;

    const SIZE: (usize, usize) = (24, 16);

    /// Views in a row along x of a wall at z = 4, whose depth is wrong by a factor in each.
    fn wall(factors: &[f32]) -> (Vec<View>, Vec<ViewGeometry>) {
        let lens = Intrinsics { fx: 24.0, fy: 24.0, cx: 12.0, cy: 8.0, width: SIZE.0, height: SIZE.1 };
        let view = |(i, factor): (usize, &f32)| {
            let position = DVec3::new(1e4 + 0.2 * i as f64, 0.0, 0.0);
            let camera = Camera::looking_at(lens, position, position + DVec3::Z, DVec3::NEG_Y).unwrap();
            let depth = DepthMap::new(SIZE.0, SIZE.1, vec![4.0 * factor; SIZE.0 * SIZE.1]).unwrap();
            View::new(format!("{i}"), Image::filled(SIZE.0, SIZE.1, [0.5; 3]).unwrap(), camera, Some(depth))
                .unwrap()
        };
        let views: Vec<View> = factors.iter().enumerate().map(view).collect();
        let geometry = GivenDepth.estimate(&views, Wanted::Depth).unwrap();
        (views, geometry)
    }

    /// The pixel in the middle.
    const MIDDLE: usize = 8 * 24 + 12;

    #[test]
    fn what_all_see_lies_where_they_see_it_in_the_mean() {
        let (views, mut geometry) = wall(&[0.995, 1.0, 1.005]);
        geometry[2].confidence.fill(0.5);
        let fused = fuse(&views, &geometry).unwrap();
        let expected = 4.0 * 2.5 / (1.0 / 0.995 + 1.0 + 0.5 / 1.005);
        for view in &fused {
            assert!((view.depth.data()[MIDDLE] - expected).abs() < 1e-4, "{}", view.depth.data()[MIDDLE]);
            assert_eq!(view.shared_by[MIDDLE], 2);
        }
        // The left border of the first view is beyond the others' pictures.
        assert_eq!((fused[0].shared_by[8 * 24], fused[0].depth.data()[8 * 24]), (0, 4.0 * 0.995));
    }

    #[test]
    fn surfaces_apart_stay_apart() {
        let (views, geometry) = wall(&[1.0, 1.1, 0.5]);
        for (fused, geometry) in fuse(&views, &geometry).unwrap().iter().zip(&geometry) {
            assert_eq!(fused.depth, geometry.depth);
            assert!(fused.shared_by.iter().all(|n| *n == 0));
        }
    }

    #[test]
    fn hard_cases_are_defined() {
        assert_eq!(fuse(&[], &[]).unwrap(), []);
        let (views, mut geometry) = wall(&[1.0, 1.0]);
        let alone = fuse(&views[..1], &geometry[..1]).unwrap();
        assert_eq!(alone[0].depth, geometry[0].depth);
        let error = fuse(&views, &geometry[..1]).unwrap_err();
        assert!(matches!(error, Error::ViewCount { views: 2, geometry: 1 }), "{error}");
        // What has no depth or no confidence has no say.
        geometry[1].confidence.fill(0.0);
        assert!(fuse(&views, &geometry).unwrap().iter().all(|view| view.shared_by.iter().all(|n| *n == 0)));
        geometry[1].confidence.fill(1.0);
        geometry[1].depth = DepthMap::new(24, 16, vec![0.0; 24 * 16]).unwrap();
        let fused = fuse(&views, &geometry).unwrap();
        assert!(fused[1].depth.data().iter().all(|z| *z == 0.0) && fused[0].depth == geometry[0].depth);
        geometry[1].depth = DepthMap::new(2, 1, vec![1.0; 2]).unwrap();
        let error = fuse(&views, &geometry).unwrap_err();
        assert!(error.to_string().contains("24x16"), "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn joined_depth_stays_among_what_was_joined(factors in prop::collection::vec(0.9f32..1.1, 1..5)) {
            let (views, geometry) = wall(&factors);
            let (least, most) = factors.iter().fold((f32::MAX, 0.0_f32), |(a, b), f| (a.min(*f), b.max(*f)));
            for view in fuse(&views, &geometry).unwrap() {
                for z in view.depth.data() {
                    prop_assert!((3.9999 * least..=4.0001 * most).contains(z), "{z}");
                }
            }
        }
    }
}
