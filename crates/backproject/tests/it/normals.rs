use crate::{LENS, any_camera, depth_map};
use backproject::{NormalFit, normals};
use glam::{DMat3, DVec3, Vec3};
use gs_scene::{Camera, DepthMap, Intrinsics};
use proptest::prelude::*;

fn camera() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("a valid camera")
}

fn default_normals(depth: &DepthMap, camera: &Camera) -> Vec<DVec3> {
    let found = normals(depth, camera, NormalFit::default()).expect("sizes fit");
    found.into_iter().map(|n| Vec3::from(n).as_dvec3()).collect()
}

proptest! {
    #[test]
    fn planes_have_their_normal_everywhere(
        camera in any_camera(), tilt_x in -0.7..0.7f64, tilt_y in -0.7..0.7f64, distance in 0.01..1e3f64,
    ) {
        let normal = DVec3::new(tilt_x, tilt_y, -1.0).normalize();
        // normal · (z ray) = -distance
        let depth = depth_map(LENS, |ray| -distance / normal.dot(ray));
        prop_assume!(depth.coverage() == 1.0);
        let expected = camera.rotation().transpose() * normal;
        for found in default_normals(&depth, &camera) {
            prop_assert!((found - expected).length() < 1e-3, "{found} for {expected}");
            prop_assert!((found.length() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn normals_are_units_that_face_the_camera_whatever_the_depth(
        data in prop::collection::vec(prop_oneof![Just(0.0f32), 1e-38..1e38f32, 1.0..1.2f32], 1200),
        camera in any_camera(),
    ) {
        let depth = DepthMap::new(40, 30, data).unwrap();
        for (i, normal) in default_normals(&depth, &camera).into_iter().enumerate() {
            let pixel = glam::DVec2::new((i % 40) as f64 + 0.5, (i / 40) as f64 + 0.5);
            let ray = camera.rotation().transpose() * LENS.ray(pixel);
            prop_assert!((normal.length() - 1.0).abs() < 1e-6);
            prop_assert!(normal.dot(ray) < 1e-6, "{normal} {ray}");
        }
    }
}

#[test]
fn a_step_in_depth_does_not_bend_the_normals() {
    // A near wall, slanted, in front of a far one that faces the camera.
    let slanted = DVec3::new(0.5, 0.0, -1.0).normalize();
    let depth = depth_map(LENS, |ray| if ray.x < 0.1 { -1.0 / slanted.dot(ray) } else { 3.0 });
    let found = default_normals(&depth, &camera());
    for (i, normal) in found.into_iter().enumerate() {
        let ray = LENS.ray(glam::DVec2::new((i % 40) as f64 + 0.5, 0.5));
        let expected = if ray.x < 0.1 { slanted } else { DVec3::NEG_Z };
        assert!((normal - expected).length() < 1e-3, "pixel {i}: {normal}");
    }
}

#[test]
fn the_step_decides_what_is_one_surface() {
    let depth = depth_map(LENS, |ray| if ray.x < 0.1 { 1.0 } else { 1.1 });
    let with = |max_relative_step| {
        normals(&depth, &camera(), NormalFit { max_relative_step, ..NormalFit::default() }).unwrap()
    };
    assert!(with(0.05).iter().all(|n| n[0].abs() < 1e-3));
    assert!(with(0.2).iter().any(|n| n[0].abs() > 0.5));
}

#[test]
fn without_a_surface_normals_point_back_along_the_ray() {
    let back = |pixel: usize| {
        -LENS.ray(glam::DVec2::new((pixel % 40) as f64 + 0.5, (pixel / 40) as f64 + 0.5)).normalize()
    };
    let mut nothing = vec![0.0; 1200];
    let empty = default_normals(&DepthMap::new(40, 30, nothing.clone()).unwrap(), &camera());
    // A line one pixel wide, and two pixels side by side.
    nothing[400..440].fill(1.0);
    nothing[800] = 1.0;
    nothing[801] = 1.01;
    let thin = default_normals(&DepthMap::new(40, 30, nothing).unwrap(), &camera());
    for pixel in 0..1200 {
        assert!((empty[pixel] - back(pixel)).length() < 1e-6);
        assert!((thin[pixel] - back(pixel)).length() < 1e-6, "pixel {pixel}");
    }
}

#[test]
fn bad_settings_name_their_rule() {
    let depth = DepthMap::new(40, 30, vec![1.0; 1200]).unwrap();
    let text = |window, max_relative_step| {
        let fit = NormalFit { window, max_relative_step };
        normals(&depth, &camera(), fit).unwrap_err().to_string()
    };
    for window in [0, 1, 4, 33] {
        let expected = format!("normal window is {window} pixels wide, expected an odd number from 3 to 31");
        assert_eq!(text(window, 0.05), expected);
    }
    assert_eq!(text(5, f32::NAN), "largest relative step in depth is NaN, expected a number above 0");
    assert_eq!(text(5, 0.0), "largest relative step in depth is 0, expected a number above 0");
}

#[test]
fn a_large_window_on_a_small_picture_is_cut() {
    let lens = Intrinsics { width: 3, height: 2, ..LENS };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
    let depth = DepthMap::new(3, 2, vec![2.0; 6]).unwrap();
    let found = normals(&depth, &camera, NormalFit { window: 31, ..NormalFit::default() }).unwrap();
    assert!(found.iter().all(|n| (Vec3::from(*n) - Vec3::NEG_Z).length() < 1e-6));
}
