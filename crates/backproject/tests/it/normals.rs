use crate::{LENS, PIXELS, any_camera, camera, centre, depth_map, view};
use backproject::{NormalFit, Settings, anchors, normals};
use glam::{DMat3, DVec3, Vec3};
use gs_scene::{Camera, Intrinsics};
use proptest::prelude::*;

fn default_normals(depth: &[f32], camera: &Camera) -> Vec<DVec3> {
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
        let depth = depth_map(|ray| -distance / normal.dot(ray));
        prop_assume!(depth.iter().all(|&z| z > 0.0));
        let expected = camera.rotation().transpose() * normal;
        for found in default_normals(&depth, &camera) {
            prop_assert!((found - expected).length() < 1e-3, "{found} for {expected}");
            prop_assert!((found.length() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn normals_are_units_that_face_the_camera_whatever_the_depth(
        depth in prop::collection::vec(
            prop_oneof![
                Just(0.0f32), 1e-45..1e-38f32, 1e-38..1e38f32, 1.0..1.2f32, 1.0..1.2f32,
                Just(f32::NAN), Just(f32::INFINITY), Just(-1.1f32),
            ],
            PIXELS,
        ),
        camera in any_camera(), window in prop::sample::select(vec![3, 5, 31]), step in prop_oneof![Just(0.05f32), 1e-3..1e38f32],
    ) {
        let fit = NormalFit { window, max_relative_step: step };
        let found = normals(&depth, &camera, fit).unwrap();
        for (i, normal) in found.into_iter().map(|n| Vec3::from(n).as_dvec3()).enumerate() {
            let ray = camera.rotation().transpose() * LENS.ray(centre(i));
            prop_assert!((normal.length() - 1.0).abs() < 1e-6);
            prop_assert!(normal.dot(ray) < 1e-6, "{normal} {ray}");
        }
    }
}

#[test]
fn a_step_in_depth_does_not_bend_the_normals() {
    // A near wall, slanted, in front of a far one that faces the camera.
    let slanted = DVec3::new(0.5, 0.0, -1.0).normalize();
    let depth = depth_map(|ray| if ray.x < 0.1 { -1.0 / slanted.dot(ray) } else { 3.0 });
    let found = default_normals(&depth, &camera());
    for (i, normal) in found.into_iter().enumerate() {
        let ray = LENS.ray(centre(i));
        let expected = if ray.x < 0.1 { slanted } else { DVec3::NEG_Z };
        assert!((normal - expected).length() < 1e-3, "pixel {i}: {normal}");
    }
}

#[test]
fn the_step_decides_what_is_one_surface() {
    let depth = depth_map(|ray| if ray.x < 0.1 { 1.0 } else { 1.1 });
    let with = |max_relative_step| {
        normals(&depth, &camera(), NormalFit { max_relative_step, ..NormalFit::default() }).unwrap()
    };
    assert!(with(0.05).iter().all(|n| n[0].abs() < 1e-3));
    assert!(with(0.2).iter().any(|n| n[0].abs() > 0.5));
}

#[test]
fn without_a_surface_normals_point_back_along_the_ray() {
    let back = |pixel: usize| -LENS.ray(centre(pixel)).normalize();
    let mut nothing = vec![0.0; 1200];
    let empty = default_normals(&nothing, &camera());
    // A line one pixel wide, and two pixels side by side.
    nothing[400..440].fill(1.0);
    nothing[800] = 1.0;
    nothing[801] = 1.01;
    let thin = default_normals(&nothing, &camera());
    for pixel in 0..1200 {
        assert!((empty[pixel] - back(pixel)).length() < 1e-6);
        assert!((thin[pixel] - back(pixel)).length() < 1e-6, "pixel {pixel}");
    }
}

#[test]
fn bad_settings_name_their_rule() {
    let depth = vec![1.0; PIXELS];
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
    let depth = vec![2.0; 6];
    let found = normals(&depth, &camera, NormalFit { window: 31, ..NormalFit::default() }).unwrap();
    assert!(found.iter().all(|n| (Vec3::from(*n) - Vec3::NEG_Z).length() < 1e-6));
}

/// A depth that is none, but not too far from others for a large step.
const HOLE: f32 = -0.5;

/// The definition: least squares over the neighbours on the same surface, by Cramer's rule, in f64. `None` where the
/// number of neighbours or the surface behind the camera leaves no plane.
fn plain_fit(depth: &[f32], (x, y): (usize, usize), fit: NormalFit) -> Option<DVec3> {
    let radius = fit.window as isize / 2;
    let z = depth[y * LENS.width + x];
    // Normal equations of a + b dx + c dy.
    let (mut matrix, mut right, mut n) = (DMat3::ZERO, DVec3::ZERO, 0);
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            let (u, v) = (x as isize + dx, y as isize + dy);
            if u < 0 || v < 0 || u >= LENS.width as isize || v >= LENS.height as isize {
                continue;
            }
            let other = depth[v as usize * LENS.width + u as usize];
            if other > 0.0 && z > 0.0 && (other - z).abs() <= fit.max_relative_step * z {
                let row = DVec3::new(1.0, dx as f64, dy as f64);
                matrix += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                right += row / f64::from(other);
                n += 1;
            }
        }
    }
    // Of whole numbers: below 1, it is 0.
    let determinant = matrix.determinant();
    if n < 4 || determinant < 0.5 {
        return None;
    }
    let solved = matrix.inverse() * right;
    let (mx, my) = (solved.y * LENS.fx, solved.z * LENS.fy);
    let ray = LENS.ray(centre(y * LENS.width + x));
    (solved.x > 0.0).then(|| -DVec3::new(mx, my, solved.x - mx * ray.x - my * ray.y).normalize())
}

proptest! {
    #[test]
    fn normals_are_the_plain_fit(
        noise in prop::collection::vec(prop_oneof![9 => 0.0..1.0f32, 1 => Just(HOLE)], PIXELS),
        roughness in -5.0..-1.0f32, scale in -3.0..3.0f32,
        window in prop::sample::select(vec![3, 5, 7, 9, 31]), max_relative_step in prop_oneof![0.01..0.5f32, 1.0..3.0f32],
    ) {
        // A slanted wall, a step, roughness and holes.
        let depth: Vec<f32> = (0..PIXELS)
            .map(|i| {
                let base = 2.0 + 0.02 * (i % 40) as f32 + if i / 40 > 17 { 0.6 } else { 0.0 };
                let rough = if noise[i] == HOLE { noise[i] } else { base + 10f32.powf(roughness) * noise[i] };
                10f32.powf(scale) * rough
            })
            .collect();
        let fit = NormalFit { window, max_relative_step };
        for (i, found) in normals(&depth, &camera(), fit).unwrap().into_iter().enumerate() {
            let expected = plain_fit(&depth, (i % 40, i / 40), fit).unwrap_or(-LENS.ray(centre(i)).normalize());
            let error = (Vec3::from(found).as_dvec3() - expected).length();
            // What one unit in the last place of a depth does to a window of four pixels, and f32 on top.
            prop_assert!(error < 3e-5, "pixel {i}: {found:?} for {expected}");
        }
    }

    #[test]
    fn chosen_pixels_have_the_normals_of_the_whole_map(
        noise in prop::collection::vec(prop_oneof![4 => 1.0..1.1f32, 1 => Just(0.0f32)], PIXELS),
        pixels in prop::collection::vec(0..PIXELS as u32, 1..600), camera in any_camera(), window in 1..8usize,
    ) {
        let fit = NormalFit { window: 2 * window + 1, ..NormalFit::default() };
        let all = normals(&noise, &camera, fit).unwrap();
        let settings = Settings { normals: Some(fit), ..Settings::default() };
        let found = anchors(&[view(&camera, &noise, &pixels)], &settings).unwrap().anchors;
        for (&pixel, normal) in found.pixels.iter().zip(&found.normals) {
            prop_assert_eq!(*normal, all[pixel as usize]);
        }
    }
}
