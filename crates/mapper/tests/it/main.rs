//! What a user of the crate may rely on.

// clippy.toml allows it in test functions; these helpers serve nothing else.
#![allow(clippy::unwrap_used)]

/// The cap, growth, and that nothing looks ahead.
mod bounds;
/// Poses, pictures and times that are wrong.
mod hostile;
/// Pictures of the map.
mod quality;
/// Snapshots, and mappers that go on from them.
mod resume;

use gs_raster::{Rasterizer, RenderSettings, near_plane};
use gs_scene::{Gaussians, View};
use mapper::{Config, Depth, Mapper, Outcome, Update};
use scene_sim::{Kind, Traced, generate, photograph};
use std::sync::LazyLock;

/// A walk through a simulated room and back: the second half shows what the first does.
static WALK: LazyLock<Vec<View>> = LazyLock::new(|| {
    let room = generate(Kind::Room, 1);
    let mut walk = room.photographs.clone().unwrap();
    (walk.width, walk.height, walk.samples, walk.count) = (120, 80, 4, 24);
    let traced = Traced::new(&room).unwrap();
    let there: Vec<View> = (0..walk.count).map(|i| photograph(&traced, &walk, i, 0).unwrap().view).collect();
    there.iter().chain(there.iter().rev()).cloned().collect()
});

fn config() -> Config {
    Config { cap: 20_000, tau: 0.3, ..Config::default() }
}

fn stereo() -> Config {
    Config { depth: Depth::Stereo, ..config() }
}

fn push_all(mapper: &mut Mapper, views: &[View]) -> Vec<Update> {
    views.iter().map(|view| mapper.push(&view.clone().into()).unwrap()).collect()
}

fn is_keyframe(update: &Update) -> bool {
    matches!(update.outcome, Outcome::Keyframe(_))
}

fn psnr(map: &Gaussians, view: &View) -> f64 {
    let settings = RenderSettings { near: near_plane(map, view.camera()), ..RenderSettings::default() };
    let rendering = Rasterizer::cpu().render(map, view.camera(), &settings).unwrap();
    image_metrics::psnr(&rendering.image, view.image()).unwrap()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}
