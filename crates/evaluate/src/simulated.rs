//! Simulated windows: ray-traced, nothing to download.

use crate::{Result, Window};
use gs_scene::{Camera, View};
use scene_sim::{Kind, Traced, demo_cameras, demo_scene, generate, photograph, render_view};
use std::fmt;

/// Size of the simulated photographs, pixels.
pub const SIMULATED_SIZE: (usize, usize) = (480, 320);

/// A simulated scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimulatedScene {
    /// The scene of the demonstration.
    Courtyard,
    /// A scene of the generator, by its seed.
    Generated(Kind, u64),
}

impl fmt::Display for SimulatedScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Courtyard => f.write_str("courtyard"),
            Self::Generated(kind, seed) => write!(f, "{}-{seed}", kind.name()),
        }
    }
}

/// Rays per pixel of the demonstration: enough that edges are smooth.
const SAMPLES: u32 = 9;

/// Seed of the rays: a photograph does not depend on how it is sampled later.
const SEED: u64 = 0;

/// Frames of a window of a generated scene: context and held-out views take turns.
const FRAMES: usize = 11;

/// A simulated scene as a window: six context views and the five held-out views between them, with exact depth. Ray tracing
/// stands for taking the photographs: it does not count as loading.
///
/// # Errors
/// If the size is empty.
pub fn simulated_window(scene: SimulatedScene, size: (usize, usize)) -> Result<Window> {
    let views = match scene {
        SimulatedScene::Courtyard => courtyard(size)?,
        SimulatedScene::Generated(kind, seed) => generated(kind, seed, size)?,
    };
    let mut window = Window {
        name: format!("{scene}/0"),
        context: Vec::new(),
        targets: Vec::new(),
        context_positions: (0..views.len()).step_by(2).collect(),
        target_positions: (1..views.len()).step_by(2).collect(),
        load_seconds: 0.0,
    };
    for (position, view) in views.into_iter().enumerate() {
        let list = if position.is_multiple_of(2) { &mut window.context } else { &mut window.targets };
        list.push(eight_bits(view)?);
    }
    Ok(window)
}

/// Everything that decides what the views look like, as text.
pub(crate) fn description(scene: SimulatedScene, (width, height): (usize, usize)) -> String {
    let described = match scene {
        SimulatedScene::Courtyard => demo_scene(),
        SimulatedScene::Generated(kind, seed) => generate(kind, seed),
    };
    format!("{scene} {width}x{height} frames {FRAMES} samples {SAMPLES} seed {SEED}\n{}", described.to_ron())
}

fn courtyard(size: (usize, usize)) -> Result<Vec<View>> {
    let scene = Traced::new(&demo_scene())?;
    let (context, targets) = demo_cameras(size.0, size.1)?;
    let camera = |position: usize| {
        if position.is_multiple_of(2) { context[position / 2] } else { targets[position / 2] }
    };
    let view = |position| -> Result<View> {
        let camera: Camera = camera(position);
        Ok(render_view(&scene, &camera, SAMPLES, format!("view-{position:02}"), SEED)?)
    };
    (0..context.len() + targets.len()).map(view).collect()
}

/// Pictures as the scene has them taken, without distortion: a window has pinhole views.
fn generated(kind: Kind, seed: u64, (width, height): (usize, usize)) -> Result<Vec<View>> {
    let scene = generate(kind, seed);
    let traced = Traced::new(&scene)?;
    let photographs = scene.photographs.ok_or(crate::Error::NoContext)?;
    let photographs =
        scene_sim::Photographs { width, height, count: FRAMES, distortion: None, ..photographs };
    (0..FRAMES).map(|index| Ok(photograph(&traced, &photographs, index, SEED)?.view)).collect()
}

/// A view as a camera would store it: the tables compare with 8-bit photographs.
fn eight_bits(mut view: View) -> Result<View> {
    let (width, height) = (view.image().width(), view.image().height());
    *view.image_mut() = gs_scene::Image::from_rgb8(width, height, &view.image().to_rgb8())?;
    Ok(view)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_lie_between_context_views() {
        let window = simulated_window(SimulatedScene::Courtyard, (24, 16)).unwrap();
        assert_eq!((window.context.len(), window.targets.len()), (6, 5));
        let x = |view: &View| view.camera().position().x;
        for (i, target) in window.targets.iter().enumerate() {
            let (a, b) = (x(&window.context[i]), x(&window.context[i + 1]));
            assert!((a.min(b)..a.max(b)).contains(&x(target)), "target {i}");
        }
        assert!(window.context.iter().all(|view| view.depth().is_some()));
    }
}
