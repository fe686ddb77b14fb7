//! What a head sees of the anchors. Nothing of it changes when the scene is moved, turned or scaled: directions are in
//! the axes of the anchor's camera, lengths in units of the anchor's spacing (the width of the patch that it stands
//! for), so that a head trained in a room works in a street. (Which anchors share a cell of the grid does change when it is turned or scaled.)
//! Absolute are colours, confidence, and where in its picture
//! an anchor lies (the viewing ray): there lenses and stereo have their habits. (What rendering says of an anchor changes as far as its
//! Gaussian does, whose mean is rounded to f32.)

use super::feedback::FEEDBACK;
use super::grid;
use super::history::{HISTORY, history};
use super::support::support;
use crate::anchored::Anchored;
use attn_head::{Inputs, Kind};
use depth_backbone::ViewGeometry;
use glam::DVec3;
use gs_scene::View;
use rayon::prelude::*;

/// Geometric features g per anchor that need no rendering: normal 3, viewing ray 3, logarithm of the patch's area, logarithm of the surface
/// per anchor over the patch's, elongation of the patch and its direction 2, whether the depth is confirmed, cosine
/// between normal and ray, share of the neighbours from other views, and what other views say: agree, see through, are
/// hidden from, differ in colour.
const OWN: usize = 17;
/// Image features v beside those of the backbone: mean colour of the patch.
const COLOUR: usize = 3;
/// A neighbour farther than this, in units of spacing, counts as that far.
const FARTHEST: f64 = 8.0;
/// Largest logarithm of a ratio of areas.
const LARGEST_RATIO: f32 = 4.0;
/// Anchors per parallel task.
const CHUNK: usize = 512;

/// Geometric features g per anchor, with what rendering the closed form says or without.
#[must_use]
pub fn geometry_features(feedback: bool) -> usize {
    if feedback { OWN + FEEDBACK } else { OWN }
}

/// Geometric features g per anchor for a corrector: with what rendering the refined scene says, and how the scene came about.
#[must_use]
pub fn corrector_features() -> usize {
    OWN + FEEDBACK + HISTORY
}

/// Image features v per anchor where the backbone gives `channels`.
#[must_use]
pub fn image_features(channels: usize) -> usize {
    channels + COLOUR
}

/// The inputs of a head, as [`attn_head::Inputs`] describes them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadInputs {
    /// Number of anchors.
    pub n: usize,
    /// Neighbours of each; none for a grid.
    pub k: usize,
    /// g, `[n, geometry_features]`, with feedback or without; of a refined scene `[n, corrector_features]`.
    pub geometry: Vec<f32>,
    /// v, `[n, channels + 3]`.
    pub image: Vec<f32>,
    /// Neighbours, `[n, k]`: the nearest in space first; of weights trained with co-visible neighbours those come first.
    pub neighbours: Vec<u32>,
    /// Where they lie: the anchor's camera's axes, units of its spacing.
    pub relative: Vec<[f32; 3]>,
    /// The fine and the coarse cell of each, `[n, 2]`; only for a grid.
    pub cells: Vec<[u32; 2]>,
}

impl HeadInputs {
    /// As the head takes them.
    #[must_use]
    pub fn as_inputs(&self) -> Inputs<'_> {
        Inputs {
            n: self.n,
            k: self.k,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &self.relative,
            cells: &self.cells,
        }
    }

    /// What a head of this kind looks at, of anchors with features; `views` are in the common exposure, `feedback` is `[n, FEEDBACK]` or empty.
    pub(crate) fn new(
        anchored: &Anchored,
        views: &[View],
        geometry: &[ViewGeometry],
        feedback: &[f32],
        kind: Kind,
    ) -> Self {
        let of_rendering = if feedback.is_empty() { 0 } else { FEEDBACK };
        let of_history = if anchored.history.is_some() { HISTORY } else { 0 };
        let width = OWN + of_rendering + of_history;
        let anchors = &anchored.anchors;
        let (n, channels) = (anchors.len(), anchors.channels);
        let (k, neighbours) = anchored.neighbours.as_ref().map_or((0, &[][..]), |nearest| {
            (nearest.k, anchored.gathered.as_ref().unwrap_or(&nearest.indices).as_slice())
        });
        let mut inputs = Self {
            n,
            k: 0,
            geometry: vec![0.0; n * width],
            image: vec![0.0; n * image_features(channels)],
            ..Self::default()
        };
        inputs
            .geometry
            .par_chunks_mut(CHUNK * width)
            .zip(inputs.image.par_chunks_mut(CHUNK * image_features(channels)))
            .enumerate()
            .for_each(|(chunk, (geometric, image))| {
                let rows = geometric.chunks_exact_mut(width);
                let rows = rows.zip(image.chunks_exact_mut(image_features(channels)));
                for ((row, image), i) in rows.zip(chunk * CHUNK..) {
                    let (own_features, others) = row.split_at_mut(OWN);
                    let (rendered, changed) = others.split_at_mut(of_rendering);
                    rendered.copy_from_slice(&feedback[i * of_rendering..][..of_rendering]);
                    if let Some(known) = &anchored.history {
                        changed.copy_from_slice(&history(anchored, known, i));
                    }
                    own_features.copy_from_slice(&geometric_features(
                        anchored,
                        i,
                        &neighbours[i * k..][..k],
                        views,
                        geometry,
                    ));
                    let (features, colour) = image.split_at_mut(channels);
                    features.copy_from_slice(&anchors.features[i * channels..][..channels]);
                    colour.copy_from_slice(&anchored.cells[i].colour);
                }
            });
        if kind == Kind::Grid {
            inputs.cells = grid::cells(anchored);
        } else if k > 0 {
            (inputs.k, inputs.neighbours) = (k, neighbours.to_vec());
            inputs.relative = vec![[0.0; 3]; n * k];
            inputs.relative.par_chunks_mut(k).zip(neighbours.par_chunks(k)).enumerate().for_each(
                |(i, (relative, neighbours))| {
                    for (relative, &j) in relative.iter_mut().zip(neighbours) {
                        *relative = seen_from(anchored, views, i, j as usize);
                    }
                },
            );
        }
        inputs
    }
}

/// Where anchor `j` lies as seen from anchor `i`.
fn seen_from(anchored: &Anchored, views: &[View], i: usize, j: usize) -> [f32; 3] {
    let anchors = &anchored.anchors;
    let rotation = views[anchors.views[i] as usize].camera().rotation();
    let step = DVec3::from(anchors.positions[j]) - DVec3::from(anchors.positions[i]);
    let step = rotation * step / f64::from(anchored.spacing[i]);
    step.clamp_length_max(FARTHEST).as_vec3().to_array()
}

fn geometric_features(
    anchored: &Anchored,
    i: usize,
    neighbours: &[u32],
    views: &[View],
    geometry: &[ViewGeometry],
) -> [f32; OWN] {
    let (anchors, cell) = (&anchored.anchors, &anchored.cells[i]);
    let view = anchors.views[i] as usize;
    let rotation = views[view].camera().rotation().as_mat3();
    let normal = rotation * glam::Vec3::from(anchors.normals[i]);
    let ray = rotation * glam::Vec3::from(anchors.rays[i]);
    let patch = anchored.spacing[i] * anchored.spacing[i];
    let ratio = anchored.area_per_anchor(i).map_or(0.0, |area| {
        // Of duplicates the area is 0.
        ((area as f32 / patch).max(f32::MIN_POSITIVE)).ln().clamp(-LARGEST_RATIO, LARGEST_RATIO)
    });
    let [xx, xy, yy] = cell.covariance;
    let others = neighbours.iter().filter(|&&j| anchors.views[j as usize] as usize != view).count();
    let others = others as f32 / neighbours.len().max(1) as f32;
    let confirmed = geometry[view].is_confirmed(anchors.pixels[i] as usize);
    let point = DVec3::from(anchors.positions[i]);
    let pixel = anchors.pixels[i] as usize;
    let width = views[view].image().width();
    let rgb = views[view].image().pixel(pixel % width, pixel / width);
    let support = support(point, rgb, view, views, geometry);
    [
        normal.x,
        normal.y,
        normal.z,
        ray.x,
        ray.y,
        ray.z,
        0.25 * cell.area.max(1.0).ln(),
        0.5 * ratio,
        (xx - yy) / (xx + yy),
        2.0 * xy / (xx + yy),
        f32::from(u8::from(confirmed)),
        -normal.dot(ray),
        others,
        support.agree,
        support.front,
        support.behind,
        4.0 * support.colour,
    ]
}
