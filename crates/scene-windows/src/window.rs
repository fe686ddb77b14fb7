//! A window: the views of a scene, and which of them are held out.

use gs_scene::View;

/// Views of one scene: some to reconstruct from, some held out to be measured on.
#[derive(Debug, Clone)]
pub struct Window {
    /// `scene/window`.
    pub name: String,
    /// Context views: all that the method sees.
    pub context: Vec<View>,
    /// Held-out targets.
    pub targets: Vec<View>,
    /// Positions of the context views in the data set's list.
    pub context_positions: Vec<usize>,
    /// Positions of the targets.
    pub target_positions: Vec<usize>,
    /// Time it took to load the views, seconds.
    pub load_seconds: f64,
}
