//! The camera's path: paths are drawn until one keeps its distance from all things and sees the scene well.

use crate::random::Random;
use crate::stage::plain;
use crate::trace::{PathRay, Traced};
use crate::trajectory::lens;
use crate::{
    Exposure, Finish, Material, Mesh, MeshSource, Photographs, Primitive, Scene, SensorNoise, Shape,
    Trajectory,
};
use glam::{DMat3, DQuat, DVec2, DVec3, EulerRot};
use gs_scene::Camera;

/// No camera is nearer to a thing than this, metres; a little more than what is promised, for what lies between the
/// places looked at.
const CLEARANCE: f64 = 0.36;
/// Rays of a survey across and down a picture.
const GRID: (usize, usize) = (16, 11);
/// Paths drawn that keep their distance, and paths drawn at all.
const SURVEYED: usize = 12;
const DRAWN: usize = 60;

/// A box in its place, for distances.
struct Extent {
    centre: DVec3,
    half: DVec3,
    to_local: DMat3,
}

impl Extent {
    fn new(centre: DVec3, rotation: DVec3, low: DVec3, high: DVec3) -> Self {
        let [x, y, z] = rotation.to_array().map(f64::to_radians);
        let to_world = DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, z, y, x));
        let middle = to_world * (0.5 * (low + high));
        Self { centre: centre + middle, half: 0.5 * (high - low), to_local: to_world.transpose() }
    }

    fn distance(&self, p: DVec3) -> f64 {
        let q = (self.to_local * (p - self.centre)).abs() - self.half;
        q.max(DVec3::ZERO).length()
    }
}

/// A mesh of more faces than this is surveyed as the box around it.
const FEW_FACES: usize = 64;
/// What is wider than this is background, which a survey leaves out, metres.
const BACKGROUND: f64 = 50.0;

/// The lowest and the highest corner of a mesh in its own axes.
fn corners(mesh: &Mesh) -> Option<(DVec3, DVec3)> {
    let MeshSource::Inline { vertices, .. } = &mesh.source else { return None };
    let first = *vertices.first()?;
    Some(vertices.iter().fold((first, first), |(low, high), p| (low.min(*p), high.max(*p))))
}

/// The scene with boxes for its finer meshes: what a survey takes is a hundredth of the time.
fn stand_ins(scene: &Scene) -> Scene {
    let mut lean = Scene { primitives: scene.primitives.clone(), ..Scene::under(scene.sky) };
    for mesh in &scene.meshes {
        let Some((low, high)) = corners(mesh) else { continue };
        let size = high - low;
        if matches!(&mesh.source, MeshSource::Inline { faces, .. } if faces.len() <= FEW_FACES) {
            lean.meshes.push(mesh.clone());
        } else if size.max_element() < BACKGROUND {
            let extent = Extent::new(mesh.centre, mesh.rotation, low, high);
            lean.primitives.push(Primitive {
                name: String::new(),
                shape: Shape::Box { size },
                centre: extent.centre,
                rotation: mesh.rotation,
                material: Material { pattern: plain([0.5; 3]), mottle: 0.0, seed: 0, finish: Finish::Matte },
            });
        }
    }
    lean
}

/// A box around everything of a scene, thing by thing.
fn extents(scene: &Scene) -> Vec<Extent> {
    let solids = scene.primitives.iter().map(|primitive| {
        let half = match primitive.shape {
            Shape::Rectangle { width, height } => 0.5 * DVec3::new(width, height, 0.0),
            Shape::Box { size } => 0.5 * size,
            Shape::Sphere { radius } => DVec3::splat(radius),
            Shape::Cylinder { radius, height } => DVec3::new(radius, radius, 0.5 * height),
        };
        Extent::new(primitive.centre, primitive.rotation, -half, half)
    });
    let meshes = scene.meshes.iter().filter_map(|mesh| {
        let (low, high) = corners(mesh)?;
        Some(Extent::new(mesh.centre, mesh.rotation, low, high))
    });
    solids.chain(meshes).collect()
}

/// What a path must show.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wish {
    /// Least and most horizontal field of view, degrees.
    pub(crate) field_of_view: [f64; 2],
    /// Least share of every picture that is not sky.
    pub(crate) coverage: f64,
    /// No picture's nearest tenth of depths is nearer than this, metres: nothing blocks the view.
    pub(crate) open: f64,
}

/// How far a path is from what was wished: 0 is well.
fn fault(scene: &Traced, cameras: &[Camera], wish: Wish) -> f64 {
    let cast = |camera: &Camera, direction: DVec3| {
        scene.nearest(&PathRay { origin: scene.relative(camera.position()), direction }).map(|hit| hit.t)
    };
    let (columns, rows) = GRID;
    let views: Vec<Vec<DVec3>> = cameras
        .iter()
        .map(|camera| {
            let pixels = (0..columns * rows)
                .map(|k| DVec2::new((k % columns) as f64 + 0.5, (k / columns) as f64 + 0.5));
            let rays = pixels.map(|pixel| camera.rotation().transpose() * camera.intrinsics().ray(pixel));
            rays.filter_map(|ray| Some(camera.position() + ray * cast(camera, ray)?)).collect()
        })
        .collect();
    let mut fault = 0.0;
    for (camera, points) in cameras.iter().zip(&views) {
        let coverage = points.len() as f64 / (columns * rows) as f64;
        let mut depths: Vec<f64> = points.iter().map(|p| camera.to_camera(*p).z).collect();
        depths.sort_by(f64::total_cmp);
        let near = depths.get(depths.len() / 10).copied().unwrap_or(0.0);
        fault += (wish.coverage - coverage).max(0.0) + (1.0 - near / wish.open).max(0.0);
    }
    let overlaps = cameras.windows(2).zip(&views).map(|(pair, points)| {
        let next = &pair[1];
        let seen = points.iter().filter(|point| {
            next.project(**point).is_some_and(|pixel| next.contains(pixel))
                && cast(next, **point - next.position()).is_some_and(|t| t > 0.98)
        });
        seen.count() as f64 / points.len().max(1) as f64
    });
    let overlaps: Vec<f64> = overlaps.collect();
    let mean = overlaps.iter().sum::<f64>() / overlaps.len().max(1) as f64;
    let least = overlaps.iter().copied().fold(1.0, f64::min);
    fault + 4.0 * (0.64 - least).max(0.0) + 4.0 * (mean - 0.88).max(0.0) + 4.0 * (0.70 - mean).max(0.0)
}

/// Gives the scene the first of the drawn paths that fulfils the wish, or the best of them. False if none keeps its
/// distance from all things.
pub(crate) fn photograph(
    scene: &mut Scene,
    random: &mut Random,
    wish: Wish,
    mut draw: impl FnMut(&mut Random) -> Trajectory,
) -> bool {
    let traced = Traced::new(&stand_ins(scene)).expect("the generator's numbers are in range");
    let extents = extents(scene);
    let [narrow, wide] = wish.field_of_view;
    let (field_of_view, count) = (random.within(narrow, wide), random.count(10, 12) as usize);
    let survey = lens(GRID.0, GRID.1, field_of_view);
    let mut best: Option<(f64, Trajectory)> = None;
    let mut surveyed = 0;
    for _ in 0..DRAWN {
        let path = draw(random);
        let Ok(steps) = path.cameras(survey, 4 * count) else { continue };
        let clear =
            |camera: &Camera| extents.iter().all(|extent| extent.distance(camera.position()) > CLEARANCE);
        if !steps.iter().all(clear) {
            continue;
        }
        let Ok(cameras) = path.cameras(survey, count) else { continue };
        let found = fault(&traced, &cameras, wish);
        if best.as_ref().is_none_or(|(least, _)| found < *least) {
            best = Some((found, path));
        }
        surveyed += 1;
        if found == 0.0 || surveyed == SURVEYED {
            break;
        }
    }
    let Some((_, path)) = best else { return false };
    // The mass of the pictures is clean and cheap; a few have what cameras do to them.
    let few = |random: &mut Random| random.chance(0.06);
    let motion_blur = few(random).then(|| random.within(0.1, 0.4));
    let exposure = few(random)
        .then(|| Exposure { stops: random.within(0.1, 0.4), white_balance: random.within(0.0, 0.1) });
    let noise = few(random).then(|| SensorNoise { full_well: random.within(2000.0, 10_000.0), read: 4.0 });
    scene.photographs = Some(Photographs {
        width: 480,
        height: 320,
        field_of_view,
        path,
        count,
        samples: 9,
        distortion: None,
        aperture: None,
        motion_blur,
        rolling_shutter: None,
        exposure,
        noise,
        pose_error: None,
    });
    true
}

/// A path as a hand keeps it, in two of three.
pub(crate) fn by_hand(random: &mut Random, path: Trajectory) -> Trajectory {
    if random.chance(0.33) {
        return path;
    }
    let (sway, turn, seed) = (random.within(0.008, 0.025), random.within(0.3, 1.2), u64::from(random.bits()));
    Trajectory::Handheld { path: Box::new(path), sway, turn, seed }
}
