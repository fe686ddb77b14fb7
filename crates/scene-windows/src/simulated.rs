//! Simulated windows: ray-traced, nothing to download.

use crate::{Result, Window};
use gs_scene::{Camera, View};
use scene_sim::{
    Kind, Scene, Traced, demo_cameras, demo_scene, generate, generate_in_the_wild, photograph, render_view,
};
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
    /// The same, photographed in the wild, with the context views farther apart and held-out views beside the path as well.
    InTheWild(Kind, u64),
}

impl fmt::Display for SimulatedScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Courtyard => f.write_str("courtyard"),
            Self::Generated(kind, seed) => write!(f, "{}-{seed}", kind.name()),
            Self::InTheWild(kind, seed) => write!(f, "wild-{}-{seed}", kind.name()),
        }
    }
}

impl SimulatedScene {
    fn scene(self) -> Scene {
        match self {
            Self::Courtyard => demo_scene(),
            Self::Generated(kind, seed) => generate(kind, seed),
            Self::InTheWild(kind, seed) => generate_in_the_wild(kind, seed),
        }
    }

    /// First frame that is a context view, and how many frames it is to the next; all others are held out.
    fn context(self) -> (usize, usize) {
        match self {
            Self::Courtyard | Self::Generated(..) => (0, 2),
            // Half, a third or a quarter of the frames, from the first or the second.
            Self::InTheWild(_, seed) => ((seed / 3 % 2) as usize, (2 + seed % 3) as usize),
        }
    }
}

/// Rays per pixel of the demonstration: enough that edges are smooth.
const SAMPLES: u32 = 9;

/// Seed of the rays: a photograph does not depend on how it is sampled later.
const SEED: u64 = 0;

/// Frames of a window of a generated scene.
const FRAMES: usize = 11;

/// A simulated scene as a window, with exact depth: six context views and the five held-out views between them (in the wild three
/// to six context views, and held-out ones before and behind them too). Ray tracing stands for taking the photographs: it does not
/// count as loading.
///
/// # Errors
/// If the size is empty.
pub fn simulated_window(scene: SimulatedScene, size: (usize, usize)) -> Result<Window> {
    let views = match scene {
        SimulatedScene::Courtyard => courtyard(size)?,
        SimulatedScene::Generated(..) | SimulatedScene::InTheWild(..) => generated(&scene.scene(), size)?,
    };
    let (first, step) = scene.context();
    let is_context = |position: &usize| *position >= first && (position - first).is_multiple_of(step);
    let (context_positions, target_positions) = (0..views.len()).partition(is_context);
    let mut window = Window {
        name: format!("{scene}/0"),
        context: Vec::new(),
        targets: Vec::new(),
        context_positions,
        target_positions,
        load_seconds: 0.0,
    };
    for (position, view) in views.into_iter().enumerate() {
        let list = if is_context(&position) { &mut window.context } else { &mut window.targets };
        list.push(eight_bits(view)?);
    }
    Ok(window)
}

/// Everything that decides what the views look like, as text.
pub(crate) fn description(scene: SimulatedScene, (width, height): (usize, usize)) -> String {
    let described = scene.scene().to_ron();
    let views = match scene {
        SimulatedScene::InTheWild(..) => format!(" context {:?}", scene.context()),
        SimulatedScene::Courtyard | SimulatedScene::Generated(..) => String::new(),
    };
    format!("{scene} {width}x{height} frames {FRAMES}{views} samples {SAMPLES} seed {SEED}\n{described}")
}

/// The context views of a generated scene's window alone, with exact depth and this many rays per pixel: what stereo is trained on.
///
/// # Errors
/// If the size is empty.
pub fn simulated_context(scene: SimulatedScene, size: (usize, usize), samples: u32) -> Result<Vec<View>> {
    let described = scene.scene();
    let traced = Traced::new(&described)?;
    let photographs = taken(&described, size)?;
    let photographs = scene_sim::Photographs { samples, ..photographs };
    let (first, step) = scene.context();
    let views = (first..FRAMES).step_by(step);
    views.map(|index| eight_bits(photograph(&traced, &photographs, index, SEED)?.view)).collect()
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
fn generated(scene: &Scene, size: (usize, usize)) -> Result<Vec<View>> {
    let traced = Traced::new(scene)?;
    let photographs = taken(scene, size)?;
    (0..FRAMES).map(|index| Ok(photograph(&traced, &photographs, index, SEED)?.view)).collect()
}

/// How a generated scene is photographed.
fn taken(scene: &Scene, (width, height): (usize, usize)) -> Result<scene_sim::Photographs> {
    let photographs = scene.photographs.clone().ok_or(crate::Error::NoContext)?;
    Ok(scene_sim::Photographs { width, height, count: FRAMES, distortion: None, ..photographs })
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

    #[test]
    fn in_the_wild_views_are_farther_apart_and_all_others_are_held_out() {
        for seed in 0..12 {
            let (first, step) = SimulatedScene::InTheWild(Kind::Desk, seed).context();
            assert!(first < 2 && (2..=4).contains(&step), "seed {seed}");
        }
        let (tame, wild) =
            (SimulatedScene::Generated(Kind::Desk, 7), SimulatedScene::InTheWild(Kind::Desk, 7));
        assert_ne!(description(tame, (24, 16)), description(wild, (24, 16)));
        let window = simulated_window(wild, (24, 16)).unwrap();
        assert_eq!(window.name, "wild-desk-7/0");
        assert_eq!(window.context_positions, [0, 3, 6, 9]);
        assert_eq!(window.target_positions, [1, 2, 4, 5, 7, 8, 10]);
        let names = |views: &[View]| views.iter().map(|view| view.name().to_owned()).collect::<Vec<_>>();
        let (context, targets) = (names(&window.context), names(&window.targets));
        assert_eq!((context.len(), targets.len()), (4, 7));
        assert!(context.iter().all(|name| !targets.contains(name)));
    }
}
