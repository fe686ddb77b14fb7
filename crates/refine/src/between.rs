//! Views between the photographs, for the second half of a long refinement.
//!
//! Six photographs do not show all of the geometry, so many steps explain them wrongly: context views get better to the end, the views between
//! them worse. The second half of the steps therefore also compares the scene, between the photographs, with the mean of what it showed there
//! before the first step and shows at half of the way. This holds it back there, while it goes on to follow the photographs.

use crate::Result;
use glam::{DMat3, DQuat};
use gs_raster::{Rasterizer, RenderSettings, near_plane};
use gs_scene::{Camera, Gaussians, Image, View};

/// How far a camera between two stands from the first, as a share of their distance. Two that are each other's nearest get two cameras.
const SHARE: f64 = 0.4;
/// Name of such a view.
const NAME: &str = "between photographs";

/// For each view a camera with its lens, on the way to its nearest neighbour at another place that looks the same way, within 90 degrees; none for
/// a view that has no such neighbour.
pub(crate) fn cameras(views: &[View]) -> Vec<Camera> {
    let between = |(index, view): (usize, &View)| {
        let from = view.camera();
        let distance = |to: &Camera| to.position().distance_squared(from.position());
        let others =
            views.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, view)| view.camera());
        let to = others
            // A camera at the place of a photograph would only say something else than that.
            .filter(|to| distance(to) > 0.0 && to.forward().dot(from.forward()) > 0.0)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let turn = |camera: &Camera| DQuat::from_mat3(&camera.rotation().transpose());
        let axes = DMat3::from_quat(turn(from).slerp(turn(to), SHARE));
        let position = from.position().lerp(to.position(), SHARE);
        Camera::from_camera_to_world(*from.intrinsics(), axes, position).ok()
    };
    views.iter().enumerate().filter_map(between).collect()
}

/// What two scenes show from `cameras`, on the mean. Pictures that are not finite are left out.
pub(crate) fn views(
    cameras: &[Camera],
    scenes: [&Gaussians; 2],
    rasterizer: &mut Rasterizer,
) -> Result<Vec<View>> {
    let mut views = Vec::with_capacity(cameras.len());
    for camera in cameras {
        let mut render = |scene: &Gaussians| -> Result<Image> {
            let settings = RenderSettings { near: near_plane(scene, camera), ..RenderSettings::default() };
            Ok(rasterizer.render(scene, camera, &settings)?.image)
        };
        let mut mean = render(scenes[0])?;
        let second = render(scenes[1])?;
        for (a, b) in mean.data_mut().iter_mut().zip(second.data()) {
            // As a screen shows them; NaN stays.
            *a = 0.5 * (a.clamp(0.0, 1.0) + b.clamp(0.0, 1.0));
        }
        if mean.data().iter().all(|value| value.is_finite()) {
            views.push(View::new(NAME, mean, *camera, None).expect("of the size of its camera"));
        }
    }
    Ok(views)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{cameras as on_an_arc, disturbed, photographs, wall};
    use glam::DVec3;
    use gs_scene::Intrinsics;

    fn view(position: DVec3, target: DVec3, focal: f64) -> View {
        let lens = Intrinsics { fx: focal, fy: focal, cx: 16.0, cy: 12.0, width: 32, height: 24 };
        let camera = Camera::looking_at(lens, position, target, DVec3::NEG_Y).unwrap();
        View::new("view", Image::filled(32, 24, [0.5; 3]).unwrap(), camera, None).unwrap()
    }

    #[test]
    fn cameras_stand_between_nearest_neighbours_that_look_the_same_way() {
        let ahead = |x: f64| DVec3::new(x, 0.0, 10.0);
        let views = [
            view(DVec3::ZERO, ahead(0.0), 20.0),
            view(DVec3::X, ahead(1.0), 30.0),
            view(DVec3::new(4.0, 0.0, 0.0), ahead(4.0), 40.0),
            // Nearest to the last, but it looks back.
            view(DVec3::new(4.1, 0.0, 0.0), DVec3::new(4.1, 0.0, -10.0), 50.0),
        ];
        let between = cameras(&views);
        let found: Vec<(f64, f64)> =
            between.iter().map(|camera| (camera.position().x, camera.intrinsics().fx)).collect();
        let expected = [(0.4, 20.0), (0.6, 30.0), (2.8, 40.0)];
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found.0 - expected.0).abs() < 1e-12 && found.1 == expected.1, "{found:?}");
        }
        assert!(between.iter().all(|camera| camera.forward().dot(DVec3::Z) > 1.0 - 1e-9));
        assert!(cameras(&views[..1]).is_empty() && cameras(&[]).is_empty());
    }

    #[test]
    fn axes_turn_by_the_same_share_as_the_place() {
        let views = [view(DVec3::ZERO, DVec3::Z, 20.0), view(DVec3::X, DVec3::new(2.0, 0.0, 1.0), 20.0)];
        // The second looks 45 degrees to the side.
        let angle = cameras(&views)[0].forward().dot(DVec3::Z).acos().to_degrees();
        assert!((angle - 18.0).abs() < 1e-6, "{angle}");
    }

    #[test]
    fn photographs_from_one_place_have_nothing_between_them() {
        let here = || view(DVec3::ZERO, DVec3::Z, 20.0);
        assert!(cameras(&[here(), here(), view(DVec3::ZERO, DVec3::new(0.2, 0.0, 1.0), 20.0)]).is_empty());
        let with_one_apart = [here(), here(), view(DVec3::X, DVec3::new(1.0, 0.0, 1.0), 20.0)];
        let positions: Vec<f64> = cameras(&with_one_apart).iter().map(|camera| camera.position().x).collect();
        assert_eq!(positions, [0.4, 0.4, 0.6]);
    }

    #[test]
    fn pictures_are_means_of_what_both_scenes_show() {
        let scenes = [wall(6, 1.0), disturbed(&wall(6, 1.0), 1.0)];
        let cameras = on_an_arc(2, (40, 32), 1.0);
        let views = views(&cameras, [&scenes[0], &scenes[1]], &mut Rasterizer::cpu()).unwrap();
        let [first, second] = scenes.map(|scene| photographs(&scene, &cameras));
        assert_eq!(views.len(), 2);
        for ((mean, first), second) in views.iter().zip(&first).zip(&second) {
            let parts = first.image().data().iter().zip(second.image().data());
            let off = mean.image().data().iter().zip(parts).map(|(m, (a, b))| (m - 0.5 * (a + b)).abs());
            assert!(off.fold(0.0, f32::max) < 1e-6);
            assert_ne!(first.image(), second.image());
        }
    }
}
