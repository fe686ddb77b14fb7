//! The chain of all twins, in the order of the passes, with every buffer between them and the host's work in between.

use crate::bin::{Pairs, bin_count, bin_emit};
use crate::frame::frame;
use crate::project::{Footprints, project, project_ellipsoids};
use crate::project_backward::{StoredGradients, project_backward};
use crate::rasterize_backward::rasterize_backward;
use crate::rasterize_ellipsoids::rasterize_ellipsoids;
use crate::rasterize_forward::{Pixels, rasterize_forward};
use crate::scan::scan;
use crate::sort::sort_scatter;
use crate::tile_ranges::tile_ranges;
use crate::{PixelGradients, Profile};
use gs_scene::{Camera, Gaussians};
use gs_shaders::{
    Features, Frame, N_COUNTERS, N_PAIRS, NOWHERE, PIXEL_GRADS, SORT_DIGIT_BITS, Scan, Sort, Surface,
};

/// What a view is rendered from, as the passes bind it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The uniform.
    pub frame: Frame,
    /// `[N, 11]`.
    pub geometry: Vec<f32>,
    /// `[N, (SH_DEGREE + 1)², 3]`.
    pub sh: Vec<f32>,
    /// What is asked for.
    pub features: Features,
}

impl View {
    /// A scene before a camera.
    #[must_use]
    pub fn new(
        gaussians: &Gaussians,
        camera: &Camera,
        background: [f32; 3],
        profile: &Profile,
        depth: bool,
    ) -> Self {
        Self {
            frame: frame(camera, profile, background, gaussians.len()),
            geometry: gaussians.geometry().to_vec(),
            sh: gaussians.sh().to_vec(),
            features: Features {
                sh_degree: gaussians.sh_degree() as u32,
                antialias: profile.antialias,
                depth,
            },
        }
    }
}

/// Which Gaussians lie in which tiles, and every buffer on the way there.
#[derive(Debug, Clone, PartialEq)]
pub struct Lists {
    /// As `project` or `project_ellipsoids` writes them.
    pub footprints: Footprints,
    /// Indices of the Gaussians near to far, the visible ones first.
    pub order: Vec<u32>,
    /// Tiles of each in that order, `[N + 1]`.
    pub counts: Vec<u32>,
    /// Their prefix sums.
    pub offsets: Vec<u32>,
    /// With the number of pairs.
    pub counters: [u32; N_COUNTERS],
    /// As `bin_emit` writes them.
    pub pairs: Pairs,
    /// Tiles of the pairs, ascending.
    pub sorted_tiles: Vec<u32>,
    /// Places of the pairs in that order.
    pub pair_index: Vec<u32>,
    /// Of the tiles.
    pub ranges: Vec<[u32; 2]>,
}

/// Every buffer of a rendering.
#[derive(Debug, Clone, PartialEq)]
pub struct Forward {
    /// What is composited.
    pub lists: Lists,
    /// The picture.
    pub pixels: Pixels,
}

/// Renders a view.
#[must_use]
pub fn forward(view: &View) -> Forward {
    let lists = lists(&view.frame, project(&view.frame, &view.geometry, &view.sh, view.features));
    let Lists { footprints, pairs, pair_index, ranges, .. } = &lists;
    let (splats, pair_splats) = (&footprints.splats, &pairs.splats);
    let pixels = rasterize_forward(&view.frame, splats, pair_splats, pair_index, ranges, view.features);
    Forward { lists, pixels }
}

/// Every buffer of a rendering of ellipsoids.
#[derive(Debug, Clone, PartialEq)]
pub struct Ellipsoids {
    /// What is drawn.
    pub lists: Lists,
    /// As `project_ellipsoids` writes them.
    pub surfaces: Vec<Surface>,
    /// As `rasterize_ellipsoids` writes them.
    pub pixels: Vec<f32>,
}

/// Renders the ellipsoids of a view.
#[must_use]
pub fn ellipsoids(view: &View) -> Ellipsoids {
    let (footprints, surfaces) = project_ellipsoids(&view.frame, &view.geometry, &view.sh, view.features);
    let lists = lists(&view.frame, footprints);
    let Lists { footprints, pairs, pair_index, ranges, .. } = &lists;
    let (splats, pair_splats) = (&footprints.splats, &pairs.splats);
    let pixels = rasterize_ellipsoids(&view.frame, splats, pair_splats, pair_index, ranges, &surfaces);
    Ellipsoids { lists, surfaces, pixels }
}

/// Sorts footprints by depth and by tile.
fn lists(frame: &Frame, footprints: Footprints) -> Lists {
    let mut counters = footprints.counters;
    let (_, order) = sort(&counters, &footprints.depth_keys, &footprints.order, u32::BITS);
    let counts = bin_count(frame, &footprints.splats, &order, &counters);
    let sums = Scan { n: counts.len() as u32, n_blocks: 0, total: N_PAIRS, padding: 0 };
    let (offsets, n_pairs) = scan(&sums, &counts);
    counters[N_PAIRS as usize] = n_pairs;
    let pairs = bin_emit(frame, &footprints.splats, &order, &counters, &offsets);
    let tile_bits = u32::BITS - (frame.tiles[0] * frame.tiles[1]).leading_zeros();
    let (sorted_tiles, pair_index) = sort(&counters, &pairs.tiles, &pairs.index, tile_bits);
    let ranges = tile_ranges(frame, &counters, &sorted_tiles);
    Lists { footprints, order, counts, offsets, counters, pairs, sorted_tiles, pair_index, ranges }
}

/// Sorts by the lowest `bits` of the keys, digit by digit.
fn sort(counters: &[u32; N_COUNTERS], keys: &[u32], values: &[u32], bits: u32) -> (Vec<u32>, Vec<u32>) {
    let mut sorted = (keys.to_vec(), values.to_vec());
    for shift in (0..bits).step_by(SORT_DIGIT_BITS as usize) {
        let step = Sort { n: keys.len() as u32, n_blocks: 0, count: NOWHERE, shift };
        sorted = sort_scatter(&step, counters, &sorted.0, &sorted.1);
    }
    sorted
}

/// Every buffer of a differentiation.
#[derive(Debug, Clone, PartialEq)]
pub struct Backward {
    /// `[h, w, 6]` as `rasterize_backward` reads them.
    pub pixel_grads: Vec<f32>,
    /// `[pairs, 10]` as it writes them.
    pub pair_grads: Vec<f32>,
    /// By what is stored.
    pub stored: StoredGradients,
}

/// Differentiates a loss, given its derivatives by the pixels.
///
/// # Panics
/// If the pixel gradients do not have the size of the picture.
#[must_use]
pub fn backward(view: &View, rendered: &Forward, pixels: &PixelGradients) -> Backward {
    let (frame, lists) = (&view.frame, &rendered.lists);
    let n_pixels = (frame.size[0] * frame.size[1]) as usize;
    let lengths = [pixels.image.len(), pixels.alpha.len(), pixels.depth_sum.len()];
    assert_eq!(lengths, [n_pixels * 3, n_pixels, n_pixels], "pixel gradients by image, alpha and depth_sum");
    let mut pixel_grads = Vec::with_capacity(n_pixels * PIXEL_GRADS);
    for i in 0..n_pixels {
        pixel_grads.extend(pixels.image[3 * i..][..3].iter().map(|&by| by as f32));
        // Alpha is 1 minus the transmittance.
        pixel_grads.extend([-pixels.alpha[i] as f32, pixels.depth_sum[i] as f32]);
        pixel_grads.push(rendered.pixels.pixels[4 * i + 3]);
    }
    let pair_grads = rasterize_backward(
        frame,
        &lists.footprints.splats,
        &lists.pairs.splats,
        &lists.pair_index,
        &lists.ranges,
        &rendered.pixels.ends,
        &pixel_grads,
        view.features,
    );
    let stored = project_backward(
        frame,
        &view.geometry,
        &view.sh,
        &lists.order,
        &lists.offsets,
        &pair_grads,
        view.features,
    );
    Backward { pixel_grads, pair_grads, stored }
}
