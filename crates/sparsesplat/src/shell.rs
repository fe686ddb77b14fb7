//! The far shell: large Gaussians behind everything, for what no view covers (borders, disocclusions, sky), and for what shines through
//! where anchors are sparse. It is the pictures of all views, repeated beyond their borders, on a coarse grid of cells. A cell stands close behind
//! the surface that its view sees there, so that other cameras see it in nearly the right place; if that would hide what another view sees, it stands
//! behind the scene.

use depth_backbone::{FAR_MARGIN, ViewGeometry};
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_scene::{Gaussians, Image, View, dc_from_rgb, logit};
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_4;
use std::ops::RangeInclusive;

/// Share of the budget that the shell may take. Of its figures and of those below, docs/journal/2026-11-shell.md has the measurements.
const SHARE: f64 = 0.08;
/// Smallest cell, pixels.
const SMALLEST_CELL: f64 = 20.0;
/// The grid goes beyond the picture by this part of its size, on every side.
const PADDING: f64 = 0.35;
/// Standard deviation over cell size.
const SPREAD: f64 = 0.6;
const OPACITY: f32 = 0.9;
/// z-depth of the cells behind the scene over the farthest that stereo finds: in front of that they would hide what lies there (at the far
/// end of the range, herzjesu loses 1.1 dB).
const BEHIND_SCENE: f64 = 1.28;
/// z-depth of a cell behind a surface over that of the surface.
const BEHIND_SURFACE: f64 = 1.5;
/// Share of a cell's usable pixels that lie farther than the surface that it stands behind: a few wrong depths do not count.
const FARTHER: f64 = 0.1;
/// Fewest usable pixels that tell a surface.
const FEWEST: usize = 8;
/// Radius, in cells, of the circle about a cell's centre on which other views are asked: there a Gaussian has faded.
const REACH: f64 = 2.0;

/// Cells along an axis of `length` pixels.
fn cells_along(length: usize, cell: f64) -> usize {
    ((length as f64 * (1.0 + 2.0 * PADDING)) / cell).ceil().max(1.0) as usize
}

fn count(views: &[View], cell: f64) -> usize {
    let cells =
        |view: &View| cells_along(view.image().width(), cell) * cells_along(view.image().height(), cell);
    views.iter().map(cells).sum()
}

/// Cell size, pixels, for which the shell of all views takes at most its share of `budget` Gaussians.
fn cell_size(views: &[View], budget: usize) -> Option<f64> {
    let limit = (budget as f64 * SHARE) as usize;
    let mut cell = SMALLEST_CELL;
    while count(views, cell) > limit {
        cell *= 1.02;
        if cell > 1e5 {
            return None;
        }
    }
    Some(cell)
}

/// Pixels, along an axis, of the square of `cell` pixels around `centre`, of the picture repeated beyond its border.
fn span(centre: f64, cell: f64, length: usize) -> RangeInclusive<usize> {
    let last = length as f64 - 1.0;
    let from = (centre - cell / 2.0).round().clamp(0.0, last) as usize;
    let to = (centre + cell / 2.0).round().clamp(0.0, last) as usize;
    from..=to
}

/// Mean colour of the square of `cell` pixels around a place.
fn mean_colour(image: &Image, place: DVec2, cell: f64) -> [f32; 3] {
    let (mut sum, mut n) = ([0.0_f64; 3], 0.0);
    for y in span(place.y, cell, image.height()) {
        for x in span(place.x, cell, image.width()) {
            let rgb = image.pixel(x, y);
            (0..3).for_each(|c| sum[c] += f64::from(rgb[c]));
            n += 1.0;
        }
    }
    sum.map(|s| (s / n) as f32)
}

/// z-depth of a pixel (row-major index) that may become a Gaussian: it has a depth, with a confidence above 0.
pub(crate) fn surface(geometry: &ViewGeometry, pixel: usize) -> Option<f64> {
    let depth = geometry.depth.data()[pixel];
    (depth > 0.0 && geometry.confidence[pixel] > 0.0).then_some(f64::from(depth))
}

/// z-depth of the farthest surface in the square of `cell` pixels around a place in the picture.
fn farthest_surface(geometry: &ViewGeometry, place: DVec2, cell: f64) -> Option<f64> {
    let (width, height) = (geometry.depth.width(), geometry.depth.height());
    let columns = || span(place.x, cell, width);
    let pixels = span(place.y, cell, height).flat_map(|y| columns().map(move |x| y * width + x));
    let mut depths: Vec<f64> = pixels.filter_map(|pixel| surface(geometry, pixel)).collect();
    if depths.len() < FEWEST {
        return None;
    }
    let farther = (depths.len() as f64 * FARTHER) as usize;
    Some(*depths.select_nth_unstable_by(farther, |a, b| b.total_cmp(a)).1)
}

/// Whether a point is in front of what a view sees there. Where the view has no depth it may see anything.
fn hides(point: DVec3, view: &View, geometry: &ViewGeometry) -> bool {
    let camera = view.camera();
    let Some(pixel) = camera.project(point).filter(|&pixel| camera.contains(pixel)) else { return false };
    let index = pixel.y as usize * camera.width() + pixel.x as usize;
    surface(geometry, index).is_none_or(|depth| camera.to_camera(point).z < depth)
}

/// The shell of all views, of at most its share of `budget`, its farthest cells behind z-depth `far`; none if not even one cell per view fits.
pub(crate) fn shell(
    views: &[View],
    geometry: &[ViewGeometry],
    far: f64,
    budget: usize,
) -> gs_scene::Result<Gaussians> {
    let mut shell = Gaussians::empty(0)?;
    let Some(cell) = cell_size(views, budget) else { return Ok(shell) };
    let of_view = |index| of_view(index, views, geometry, far, cell);
    let parts: Vec<Gaussians> =
        (0..views.len()).into_par_iter().map(of_view).collect::<gs_scene::Result<_>>()?;
    parts.iter().for_each(|part| shell.append(part));
    Ok(shell)
}

/// The part of one view, of cells of `cell` pixels.
fn of_view(
    index: usize,
    views: &[View],
    geometry: &[ViewGeometry],
    far: f64,
    cell: f64,
) -> gs_scene::Result<Gaussians> {
    let (camera, image) = (views[index].camera(), views[index].image());
    let lens = camera.intrinsics();
    let (columns, rows) = (cells_along(image.width(), cell), cells_along(image.height(), cell));
    let axes: DMat3 = camera.rotation().transpose();
    let rotation = DQuat::from_mat3(&axes).normalize();
    // A cell may not hide anything from any other view, neither with its centre nor with its rim.
    let around = (0..8).map(|i| DVec2::from_angle(f64::from(i) * FRAC_PI_4) * REACH * cell);
    let reach: Vec<DVec2> = std::iter::once(DVec2::ZERO).chain(around).collect();
    let others = || views.iter().zip(geometry).enumerate().filter(|&(other, _)| other != index);
    let hides_at = |place: DVec2, depth: f64| {
        let points: Vec<DVec3> = reach.iter().map(|&to| camera.unproject(place + to, depth)).collect();
        others().any(|(_, (view, geometry))| points.iter().any(|&point| hides(point, view, geometry)))
    };
    let behind_scene = far * FAR_MARGIN * BEHIND_SCENE;
    let depth_at = |place: DVec2| {
        let surface = camera.contains(place).then(|| farthest_surface(&geometry[index], place, cell));
        let behind = surface.flatten().map(|depth| (BEHIND_SURFACE * depth).min(behind_scene));
        behind.filter(|&depth| !hides_at(place, depth)).unwrap_or(behind_scene)
    };

    let mut part = Gaussians::empty(0)?;
    for row in 0..rows {
        for column in 0..columns {
            // The grid is centred on the picture.
            let along = |i: usize, n: usize, length: usize| {
                length as f64 / 2.0 + (i as f64 + 0.5 - n as f64 / 2.0) * cell
            };
            let place = DVec2::new(along(column, columns, image.width()), along(row, rows, image.height()));
            let depth = depth_at(place);
            let scale = |focal: f64| (SPREAD * cell * depth / focal) as f32;
            let thin = scale(lens.fx) * 0.05;
            part.push(
                camera.unproject(place, depth).as_vec3().to_array(),
                [rotation.w as f32, rotation.x as f32, rotation.y as f32, rotation.z as f32],
                [scale(lens.fx).ln(), scale(lens.fy).ln(), thin.ln()],
                logit(OPACITY),
                &dc_from_rgb(mean_colour(image, place, cell)),
            );
        }
    }
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_scene::{Camera, DepthMap, Intrinsics, MEAN};

    const LENS: Intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 55.0, cy: 35.0, width: 110, height: 70 };
    const FAR: f64 = 4.0;
    const BEHIND_ALL: f64 = FAR * FAR_MARGIN * BEHIND_SCENE;

    /// A grey view from (x, 0, 0) along z.
    fn view_from(x: f64) -> View {
        let camera = Camera::new(LENS, DMat3::IDENTITY, DVec3::new(-x, 0.0, 0.0)).unwrap();
        let image = Image::new(LENS.width, LENS.height, vec![0.5; LENS.width * LENS.height * 3]).unwrap();
        View::new("grey", image, camera, None).unwrap()
    }

    fn seeing(depth: impl Fn(usize, usize) -> f32, confidence: f32) -> ViewGeometry {
        let (w, h) = (LENS.width, LENS.height);
        let depth = DepthMap::new(w, h, (0..w * h).map(|i| depth(i % w, i / w)).collect()).unwrap();
        ViewGeometry { depth, confidence: vec![confidence; w * h], features: None, gaussians: None }
    }

    /// z of the Gaussians of the first view, and where each stands in its picture.
    fn of_first(views: &[View], geometry: &[ViewGeometry]) -> Vec<(f64, DVec2)> {
        let all = shell(views, geometry, FAR, usize::MAX).unwrap();
        assert!(all.geometry().iter().chain(all.sh()).all(|v| v.is_finite()));
        let rows = all.geometry().chunks_exact(Gaussians::GEOMETRY).take(all.len() / views.len());
        let point =
            |row: &[f32]| DVec3::from_slice(&row[MEAN].iter().map(|&v| v.into()).collect::<Vec<f64>>());
        rows.map(|row| (point(row).z, views[0].camera().project(point(row)).unwrap())).collect()
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-5 * b
    }

    #[test]
    fn cells_stand_behind_the_surface_in_the_picture_and_behind_the_scene_beyond_it() {
        let views = [view_from(0.0), view_from(0.3)];
        let wall = || seeing(|_, _| 2.0, 1.0);
        let found = of_first(&views, &[wall(), wall()]);
        let inside = |at: DVec2| views[0].camera().contains(at);
        assert!(found.iter().any(|&(_, at)| inside(at)) && found.iter().any(|&(_, at)| !inside(at)));
        for (z, at) in found {
            let expected = if inside(at) { BEHIND_SURFACE * 2.0 } else { BEHIND_ALL };
            assert!(close(z, expected), "{z} at {at}");
        }
    }

    #[test]
    fn no_cell_hides_what_another_view_sees() {
        let views = [view_from(0.0), view_from(2.0)];
        let wall = seeing(|_, _| 2.0, 1.0);
        // The other view sees past the wall, or does not know.
        for other in [seeing(|_, _| 3.5, 1.0), seeing(|_, _| 0.0, 1.0), seeing(|_, _| 2.0, 0.0)] {
            let found = of_first(&views, &[wall.clone(), other]);
            let stays: Vec<_> = found.iter().filter(|(z, _)| close(*z, BEHIND_SURFACE * 2.0)).collect();
            assert!(
                !stays.is_empty()
                    && found.iter().any(|(z, at)| views[0].camera().contains(*at) && close(*z, BEHIND_ALL))
            );
            for (z, at) in stays {
                let seen = views[1].camera().project(views[0].camera().unproject(*at, *z)).unwrap();
                assert!(!views[1].camera().contains(seen), "{seen}");
            }
        }
    }

    #[test]
    fn a_cell_stands_behind_the_farther_of_two_surfaces_but_not_behind_a_few_wrong_pixels() {
        let view = [view_from(0.0)];
        let of = |depth: &dyn Fn(usize, usize) -> f32| of_first(&view, &[seeing(depth, 1.0)]);
        // Cells are of 20 pixels. The farther surface has a third of them or more, or one column.
        let stripes = of(&|x, _| if x % 20 < 10 { 1.0 } else { 2.0 });
        let few = of(&|x, _| if x % 20 == 7 { 2.5 } else { 1.0 });
        for (found, expected) in [(stripes, 3.0), (few, 1.5)] {
            let inside = found.iter().filter(|(_, at)| view[0].camera().contains(*at));
            inside.for_each(|(z, at)| assert!(close(*z, expected), "{z} at {at}"));
        }
    }

    #[test]
    fn without_a_surface_and_far_away_it_is_behind_the_scene() {
        let view = [view_from(0.0)];
        for geometry in [seeing(|_, _| 0.0, 1.0), seeing(|_, _| 2.0, 0.0), seeing(|_, _| f32::MAX, 1.0)] {
            assert!(of_first(&view, &[geometry]).iter().all(|(z, _)| close(*z, BEHIND_ALL)));
        }
    }

    #[test]
    fn it_takes_its_share_and_no_more() {
        let views = [view_from(0.0), view_from(0.3)];
        let geometry = [seeing(|_, _| 2.0, 1.0), seeing(|_, _| 2.0, 1.0)];
        for budget in [0, 1, 20, 30, 100, 1_000, 10_000] {
            let found = shell(&views, &geometry, FAR, budget).unwrap().len();
            assert!(found as f64 <= SHARE * budget as f64, "{found} of {budget}");
            assert_eq!(found > 0, budget >= 30, "{found} of {budget}");
        }
    }
}
