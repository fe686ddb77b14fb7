use crate::{LENS, any_camera, depth_map};
use backproject::{Anchors, Error, NormalFit, anchors, normals};
use glam::{DMat3, DVec3, Vec3};
use gs_scene::{Camera, DepthMap, Intrinsics};
use proptest::prelude::*;

proptest! {
    #[test]
    fn anchors_project_to_their_pixel_centres(camera in any_camera(), near in 0.1..50.0f64, wave in 0.0..0.5f64) {
        let depth = depth_map(LENS, |ray| near * (1.5 + wave * (9.0 * ray.x).sin() * (7.0 * ray.y).cos()));
        let up = vec![[0.0, 1.0, 0.0]; depth.data().len()];
        let pixels: Vec<u32> = (0..LENS.width as u32 * LENS.height as u32).collect();
        let found = anchors(3, &pixels, &depth, &camera, &up).unwrap();
        prop_assert_eq!(found.len(), pixels.len());
        for (i, position) in found.positions.iter().enumerate() {
            let world = Vec3::from(*position).as_dvec3();
            let z = f64::from(depth.data()[i]);
            // Half a unit in the last place of each coordinate, as pixels; f64 adds nothing to speak of.
            let rounding = world.abs().max_element() * f64::from(f32::EPSILON);
            let allowed = 1e-6 + 3.0 * LENS.fx * rounding / z;
            let pixel = camera.project(world).unwrap();
            let centre = ((i % LENS.width) as f64 + 0.5, (i / LENS.width) as f64 + 0.5);
            prop_assert!((pixel.x - centre.0).abs() < allowed && (pixel.y - centre.1).abs() < allowed);
            let ray = Vec3::from(found.rays[i]).as_dvec3();
            let along = (world - camera.position()).normalize();
            prop_assert!((ray.length() - 1.0).abs() < 1e-6);
            prop_assert!((ray - along).length() < 1e-6 + 3.0 * rounding / z);
            prop_assert_eq!(found.depths[i], depth.data()[i]);
            prop_assert!((f64::from(found.footprints[i]) * (90.0f64 * 75.0).sqrt() / z - 1.0).abs() < 1e-6);
        }
        prop_assert!(found.views.iter().all(|&view| view == 3));
        prop_assert_eq!(found.pixels, pixels);
    }
}

fn camera() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("a valid camera")
}

#[test]
fn what_has_no_place_is_refused_by_name() {
    let mut data = vec![1.0; 1200];
    data[7] = 0.0;
    let depth = DepthMap::new(40, 30, data).unwrap();
    let up = vec![[0.0, 1.0, 0.0]; 1200];
    let text =
        |pixels: &[u32], up: &[[f32; 3]]| anchors(2, pixels, &depth, &camera(), up).unwrap_err().to_string();
    assert_eq!(
        text(&[1, 7], &up),
        "pixel 7 of view 2 has no depth: give it weight 0 when sampling, or fill the hole"
    );
    assert_eq!(text(&[1200], &up), "pixel 1200 of view 2 is outside the image of 1200 pixels");
    assert_eq!(text(&[1], &up[1..]), "1199 normals, expected one for each of 1200 pixels");
    let other = DepthMap::new(30, 40, vec![1.0; 1200]).unwrap();
    let sizes = anchors(0, &[], &other, &camera(), &up).unwrap_err();
    assert_eq!(sizes.to_string(), "depth map is 30x40, its camera is 40x30");
    assert_eq!(normals(&other, &camera(), NormalFit::default()).unwrap_err(), sizes);
}

#[test]
fn a_single_pixel_is_enough() {
    let lens = Intrinsics { fx: 2.0, fy: 2.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0)).unwrap();
    let depth = DepthMap::new(1, 1, vec![4.0]).unwrap();
    let normals = normals(&depth, &camera, NormalFit::default()).unwrap();
    let found = anchors(0, &[0], &depth, &camera, &normals).unwrap();
    assert_eq!(found.positions, [[-1.0, -2.0, 1.0]]);
    assert_eq!((found.normals[0], found.rays[0]), ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]));
    assert_eq!(found.footprints, [2.0]);
}

#[test]
fn views_join_in_order() {
    let depth = DepthMap::new(40, 30, vec![1.0; 1200]).unwrap();
    let up = vec![[0.0, 1.0, 0.0]; 1200];
    let of = |view, pixels: &[u32]| anchors(view, pixels, &depth, &camera(), &up).unwrap();
    let all = Anchors::concat([of(0, &[3, 4]), of(1, &[]), of(2, &[5])]);
    assert_eq!((all.len(), all.is_empty()), (3, false));
    assert_eq!((&all.views[..], &all.pixels[..]), (&[0, 0, 2][..], &[3, 4, 5][..]));
    assert_eq!(all.positions[2], of(2, &[5]).positions[0]);
    for n in [all.normals.len(), all.rays.len(), all.depths.len(), all.footprints.len()] {
        assert_eq!(n, 3);
    }
    assert!(Anchors::concat([]).is_empty());
    let none = DepthMap::new(40, 30, vec![0.0; 1200]).unwrap();
    assert_eq!(anchors(0, &[9], &none, &camera(), &up), Err(Error::NoDepth { view: 0, pixel: 9 }));
}
