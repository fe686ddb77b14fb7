//! What a user of the crate may rely on.

// clippy.toml allows it in test functions; these helpers serve nothing else.
#![allow(clippy::unwrap_used)]

/// Depth against closed forms, at the origin and far from it, and scenes at the edge of what is allowed.
mod depth;
/// What each effect takes, all of them at once, and their wrong descriptions.
mod effects;
/// Descriptions that are wrong, and the error each of them gets.
mod errors;
/// Descriptions and meshes in files, sound and broken.
mod files;
/// Leaves and their holes.
mod foliage;
/// Light, shadow, ray counts and determinism.
mod light;
/// Photographs: lens, shutter, exposure, noise.
mod photographs;
/// Rooms of the Replica data set, made up here.
mod replica;
/// Lamps, soft shadows, occlusion, mirrors and glass against closed forms.
mod shading;
/// The views of the demonstration: overlap and agreement between them.
mod views;

use glam::DVec3;
use gs_scene::{Camera, DepthMap, View};
use scene_sim::{
    Finish, Material, Pattern, Primitive, Rgb, Scene, Shape, Sky, Sun, Traced, lens, render_view,
};

const GREY: Pattern = Pattern::Plain { colour: [0.5; 3] };
const SKY: Sky =
    Sky { zenith: [0.3, 0.5, 0.9], horizon: [0.8, 0.9, 1.0], ground: [0.4; 3], light: 0.5, occlusion: None };
const SUN: Sun = Sun { towards: DVec3::new(-0.6, -0.3, 0.8), colour: [1.0; 3], strength: 0.8, diameter: 0.0 };

fn body(name: &str, shape: Shape, centre: DVec3, pattern: Pattern) -> Primitive {
    let material = Material { pattern, mottle: 0.0, seed: 1, finish: Finish::Matte };
    Primitive { name: name.into(), shape, centre, rotation: DVec3::ZERO, material }
}

fn scene(primitives: Vec<Primitive>, sun: Option<Sun>) -> Scene {
    Scene { primitives, sun, ..Scene::under(SKY) }
}

fn camera(position: DVec3, target: DVec3) -> Camera {
    Camera::looking_at(lens(61, 41, 60.0), position, target, DVec3::Z).unwrap()
}

fn view(scene: &Scene, camera: &Camera) -> View {
    render_view(&Traced::new(scene).unwrap(), camera, 4, "view", 0).unwrap()
}

fn depth(view: &View) -> &DepthMap {
    view.depth().unwrap()
}

fn luma(rgb: Rgb) -> f32 {
    rgb.iter().sum::<f32>() / 3.0
}
