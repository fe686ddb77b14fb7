//! Views with what stereo knows of them and their exact depth, in memory, and on disk: ray tracing takes seconds a view.

use crate::{Error, Result};
use depth_backbone::{InputParts, Inputs, PlaneSweep};
use gs_scene::View;
use half::f16;
use rayon::prelude::*;
use safetensors::tensor::Dtype;
use scene_windows::{Plan, SimulatedScene, hexadecimal, simulated_context};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use tensor_files::{Kept, KeptFault, KeptTensor, singles, write_kept};

/// Changes when the layout of a file, the sweep or the meaning of the inputs does.
const VERSION: u32 = 1;
/// What the files are.
const KIND: &str = "depth-case";
/// Rays per pixel: coarser than a photograph, as noise is.
const SAMPLES: u32 = 4;

/// One view.
pub(crate) struct DepthCase {
    size: (usize, usize),
    /// Channels of the blocks, half precision.
    blocks: Vec<f16>,
    base: Vec<f32>,
    own: Vec<f32>,
    unit: [f32; 2],
    /// Exact inverse depth, plane steps from the far end; NaN where there is no surface.
    exact: Vec<f32>,
}

/// A part of a view.
pub(crate) struct Crop {
    pub(crate) inputs: Inputs,
    pub(crate) exact: Vec<f32>,
}

impl DepthCase {
    fn new(inputs: &Inputs, view: &View) -> Self {
        let InputParts { size, blocks, base, own, unit } = inputs.to_parts();
        let depth = view.depth().expect("simulated views have depth");
        let exact = |&z: &f32| if z > 0.0 { ((1.0 / z - unit[0]) / unit[1]).max(0.0) } else { f32::NAN };
        let blocks = blocks.into_iter().map(f16::from_f32).collect();
        Self { size, blocks, base, own, unit, exact: depth.data().iter().map(exact).collect() }
    }

    /// Makes the loss of every crop infinite.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self) {
        self.exact.fill(f32::INFINITY);
    }

    /// Width and height in blocks.
    pub(crate) fn blocks(&self) -> (usize, usize) {
        (self.size.0.div_ceil(2), self.size.1.div_ceil(2))
    }

    /// The whole view.
    pub(crate) fn whole(&self) -> Crop {
        let (width, height) = self.blocks();
        self.crop((0, 0), (width, height), false)
    }

    /// `width` × `height` blocks from block (x, y) on, left and right swapped if `mirrored`.
    pub(crate) fn crop(
        &self,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
        mirrored: bool,
    ) -> Crop {
        let columns = self.blocks().0;
        let pixels = ((2 * width).min(self.size.0 - 2 * x), (2 * height).min(self.size.1 - 2 * y));
        // Blocks that are cut at the border must stay there.
        let mirrored = mirrored && pixels.0 == 2 * width;
        let place = |i: usize, n: usize| if mirrored { n - 1 - i } else { i };
        let channels = Inputs::CHANNELS;
        let (mut blocks, mut base) = (Vec::with_capacity(width * height * channels), Vec::new());
        for row in y..y + height {
            for column in 0..width {
                let at = row * columns + x + place(column, width);
                let from = blocks.len();
                blocks.extend(self.blocks[at * channels..][..channels].iter().map(|v| v.to_f32()));
                if mirrored {
                    Inputs::mirror_block(&mut blocks[from..]);
                }
                base.push(self.base[at]);
            }
        }
        let gather = |from: &[f32]| -> Vec<f32> {
            let row = |v: usize| {
                let row = &from[(2 * y + v) * self.size.0 + 2 * x..][..pixels.0];
                (0..pixels.0).map(move |u| row[place(u, pixels.0)])
            };
            (0..pixels.1).flat_map(row).collect()
        };
        let (own, exact) = (gather(&self.own), gather(&self.exact));
        Crop {
            inputs: Inputs::of_parts(InputParts { size: pixels, blocks, base, own, unit: self.unit }),
            exact,
        }
    }

    fn tensors(&self, index: usize) -> Vec<KeptTensor> {
        let (width, height) = self.size;
        let (columns, rows) = self.blocks();
        let singles = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        vec![
            (
                format!("{index}.blocks"),
                Dtype::F16,
                vec![rows, columns, Inputs::CHANNELS],
                self.blocks.iter().flat_map(|v| v.to_le_bytes()).collect(),
            ),
            (format!("{index}.base"), Dtype::F32, vec![rows, columns], singles(&self.base)),
            (format!("{index}.own"), Dtype::F32, vec![height, width], singles(&self.own)),
            (format!("{index}.exact"), Dtype::F32, vec![height, width], singles(&self.exact)),
        ]
    }

    fn read(kept: &Kept, index: usize, kept_view: KeptView) -> Result<Self, KeptFault> {
        let KeptView { size: (width, height), unit } = kept_view;
        let (columns, rows) = (width.div_ceil(2), height.div_ceil(2));
        let blocks =
            kept.expect(&format!("{index}.blocks"), Dtype::F16, &[rows, columns, Inputs::CHANNELS])?;
        let values = |name: &str, shape: &[usize]| {
            Ok::<_, KeptFault>(singles(kept.expect(&format!("{index}.{name}"), Dtype::F32, shape)?))
        };
        Ok(Self {
            size: (width, height),
            blocks: blocks.as_chunks().0.iter().map(|bytes| f16::from_le_bytes(*bytes)).collect(),
            base: values("base", &[rows, columns])?,
            own: values("own", &[height, width])?,
            exact: values("exact", &[height, width])?,
            unit,
        })
    }
}

/// What does not fit a tensor.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct KeptView {
    size: (usize, usize),
    unit: [f32; 2],
}

/// Views to train on.
pub struct DepthCases {
    pub(crate) views: Vec<DepthCase>,
    hash: String,
}

impl DepthCases {
    /// The context views of generated scenes, at a size; those that are not in the folder `cache` yet are made. `on_scene` is told the
    /// name of each when it is there, or with the reason when it is left out because its views do not suffice for stereo.
    ///
    /// # Errors
    /// If a file cannot be read or written, or no scene is left.
    pub fn open(
        scenes: &[SimulatedScene],
        size: (usize, usize),
        cache: &Path,
        on_scene: &(dyn Fn(&str, Option<&depth_backbone::Error>) + Sync),
    ) -> Result<Self> {
        let made: Vec<Option<Vec<DepthCase>>> = scenes
            .par_iter()
            .map(|&scene| match scene_cases(scene, size, cache)? {
                Ok(views) => {
                    on_scene(&scene.to_string(), None);
                    Ok(Some(views))
                }
                Err(why) => {
                    on_scene(&scene.to_string(), Some(&why));
                    Ok(None)
                }
            })
            .collect::<Result<_>>()?;
        let mut all = Sha256::new();
        for (&scene, made) in scenes.iter().zip(&made) {
            all.update(format!("{} {}\n", key(scene, size), made.is_some()));
        }
        let views: Vec<DepthCase> = made.into_iter().flatten().flatten().collect();
        if views.is_empty() {
            return Err(Error::NoWindows);
        }
        Ok(Self { views, hash: hexadecimal(&all.finalize()) })
    }

    /// Number of views.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none; never.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// SHA-256 of what decides the content of all of them.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.hash
    }
}

/// SHA-256 of what decides the views of a scene and what is made of them.
fn key(scene: SimulatedScene, size: (usize, usize)) -> String {
    let described = Plan::simulated(scene, size).description();
    hexadecimal(&Sha256::digest(format!("{VERSION} {SAMPLES} {described:?}")))
}

/// The views of a scene from the cache, or made; or why stereo refuses them.
fn scene_cases(
    scene: SimulatedScene,
    size: (usize, usize),
    cache: &Path,
) -> Result<std::result::Result<Vec<DepthCase>, depth_backbone::Error>> {
    let path: PathBuf = cache.join(format!("{scene}-{}.depth.safetensors", &key(scene, size)[..16]));
    let fault = |source| Error::CacheFile { path: path.clone(), source };
    if path.exists() {
        let (header, kept): (Vec<KeptView>, Kept) = Kept::read(&path, KIND).map_err(fault)?;
        let views = header.into_iter().enumerate().map(|(i, view)| DepthCase::read(&kept, i, view));
        return Ok(Ok(views.collect::<Result<_, KeptFault>>().map_err(fault)?));
    }
    let views = simulated_context(scene, size, SAMPLES)?;
    let inputs = match PlaneSweep::default().inputs(&views) {
        Ok(inputs) => inputs,
        Err(why) => return Ok(Err(why)),
    };
    let cases: Vec<DepthCase> =
        inputs.iter().zip(&views).map(|(inputs, view)| DepthCase::new(inputs, view)).collect();
    let header: Vec<KeptView> =
        cases.iter().map(|case| KeptView { size: case.size, unit: case.unit }).collect();
    let tensors: Vec<KeptTensor> = cases.iter().enumerate().flat_map(|(i, case)| case.tensors(i)).collect();
    write_kept(&path, KIND, &header, &tensors).map_err(fault)?;
    Ok(Ok(cases))
}
