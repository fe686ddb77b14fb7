//! The simulated window: ray-traced, nothing to download.

use crate::{Result, Window};
use gs_scene::{Camera, View};
use scene_sim::{Traced, demo_cameras, demo_scene, render_view};

/// Size of the simulated photographs, pixels.
pub const SIMULATED_SIZE: (usize, usize) = (480, 320);

/// Name of the window.
pub(crate) const NAME: &str = "courtyard/0";

/// Rays per pixel: enough that edges are smooth.
const SAMPLES: u32 = 9;

/// Seed of the rays: a photograph does not depend on how it is sampled later.
const SEED: u64 = 0;

/// The demonstration as a window: six context views and the held-out views between them, with exact depth. Ray tracing
/// stands for taking the photographs: it does not count as loading.
///
/// # Errors
/// If the size is empty.
pub fn simulated_window(size: (usize, usize)) -> Result<Window> {
    let scene = Traced::new(&demo_scene())?;
    let (context_cameras, target_cameras) = demo_cameras(size.0, size.1)?;
    // Along the path, context and target views take turns.
    let context_positions: Vec<usize> = (0..context_cameras.len()).map(|i| 2 * i).collect();
    let target_positions: Vec<usize> = (0..target_cameras.len()).map(|i| 2 * i + 1).collect();
    let views = |cameras: &[Camera], positions: &[usize]| -> Result<Vec<View>> {
        let view = |(camera, position): (&Camera, &usize)| {
            Ok(render_view(&scene, camera, SAMPLES, format!("view-{position:02}"), SEED)?)
        };
        cameras.iter().zip(positions).map(view).collect()
    };
    Ok(Window {
        context: views(&context_cameras, &context_positions)?
            .into_iter()
            .map(eight_bits)
            .collect::<Result<_>>()?,
        targets: views(&target_cameras, &target_positions)?
            .into_iter()
            .map(eight_bits)
            .collect::<Result<_>>()?,
        name: NAME.to_owned(),
        context_positions,
        target_positions,
        load_seconds: 0.0,
    })
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
        let window = simulated_window((24, 16)).unwrap();
        assert_eq!((window.context.len(), window.targets.len()), (6, 5));
        let x = |view: &View| view.camera().position().x;
        for (i, target) in window.targets.iter().enumerate() {
            let (a, b) = (x(&window.context[i]), x(&window.context[i + 1]));
            assert!((a.min(b)..a.max(b)).contains(&x(target)), "target {i}");
        }
        assert!(window.context.iter().all(|view| view.depth().is_some()));
    }
}
