//! DepthSplat's depth network (H. Xu et al., "DepthSplat: connecting Gaussian splatting and depth", 2025): posed
//! photographs to depth and features.
//!
//! | module | part, by its name in the checkpoints |
//! |---|---|
//! | `cnn`, `vit`, `transformer` | `backbone`, `pretrained`, `transformer` |
//! | `cost_volume`, `regressor` | `regressor`, `regressor_residual`, `depth_head` |
//! | `dpt` | `upsampler`, `feature_upsampler` |
//! | `gaussian_head` | `gaussian_regressor`, `gaussian_head` |
//! | `network` | `depth_predictor`: all of them in order, with the pyramids |
//! | `layers`, `kernels` | the layers on tensors; their arithmetic on slices of the CPU |
//! | `variant`, `params`, `checkpoint`, `recipe` | which network it is, and where its weights come from |

mod checkpoint;
mod cnn;
mod cost_volume;
mod dpt;
#[cfg(test)]
mod engine_tests;
mod gaussian_head;
mod kernels;
mod layers;
mod network;
mod params;
mod recipe;
mod regressor;
mod taps;
mod transformer;
mod variant;
mod views;
mod vit;

use gaussian_head::PixelGaussian;
pub use gaussian_head::PixelGaussians;
pub use taps::StageTime;
pub use tensor_files::{WeightFault, WeightProblem};
pub use variant::{Scales, Variant, Vit};

use crate::backbone::check_pixels;
use crate::{
    DepthBackbone, DepthRange, Error, Features, NetworkDevice, Result, ViewGeometry, Wanted, estimate,
};
use candle_core::Device;
use cost_volume::Bounds;
use gs_scene::{Gaussians, View, sh_coefficients};
use layers::Engine;
use network::{Network, NetworkInputs, NetworkOutputs};
use params::Params;
use std::collections::BTreeMap;
use std::path::Path;
use taps::Taps;
use views::Padded;

/// DepthSplat's depth network with its weights.
///
/// Views must have one size, any; there must be two or more. Depth is known at every pixel. The confidence is the largest
/// probability that the network gives to one depth; features are those of its upsampler, 64, 96 or 128 channels.
pub struct DepthSplat {
    network: Network,
    range: DepthRange,
    /// What heads that are trained on its features know them by.
    schema: String,
}

/// What a pass through the network shows of itself.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Maps between the stages, if they were wanted, images as `[views, channels, h, w]`.
    pub maps: Vec<NamedTensor>,
    /// Time of each stage.
    pub stages: Vec<StageTime>,
}

/// A tensor by its name: a map between two stages, or a weight.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedTensor {
    /// What it is: of maps as in the golden files, of weights as in the GS checkpoints, without `encoder.`.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values, row-major.
    pub values: Vec<f32>,
}

impl DepthSplat {
    /// The network of a checkpoint, on the CPU: a published `.pth`, a Lightning `.ckpt`, or a `.safetensors` with the same
    /// names. Which network it is, its tensors tell. If the file's name ends in eight hexadecimal digits, as those of the
    /// published ones do, they must be the first of its SHA-256.
    ///
    /// # Errors
    /// If the file cannot be read, is another than its name promises, holds none of the known networks, or any of its tensors
    /// is missing, unexpected, misshapen or not finite.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_on(path, NetworkDevice::Cpu)
    }

    /// The same on another device.
    ///
    /// # Errors
    /// As [`DepthSplat::open`]; if there is no such device, or this build cannot use it.
    pub fn open_on(path: impl AsRef<Path>, device: NetworkDevice) -> Result<Self> {
        let path = path.as_ref();
        let device = match device {
            NetworkDevice::Cpu => Device::Cpu,
            NetworkDevice::Cuda => Device::new_cuda(0)?,
            NetworkDevice::Metal => Device::new_metal(0)?,
        };
        let opened = checkpoint::open(path, &device)?;
        let network = Network::new(&opened.params, opened.variant, opened.with_heads)
            .map_err(|source| Error::WeightsUnreadable { path: path.to_owned(), source })?;
        checkpoint::check(path, &opened.params, opened.variant)?;
        // Its features are those of these very weights.
        let schema = format!("depthsplat {} {}", opened.variant, opened.sha256_start);
        Ok(Self { network, range: DepthRange::Estimate, schema })
    }

    /// A network whose weights follow a rule instead of training: it computes all that the trained one does, and its
    /// depth means nothing. Another salt gives other weights. For tests of the arithmetic, and for timing.
    ///
    /// # Errors
    /// If a tensor cannot be made.
    pub fn untrained(variant: Variant, salt: &str) -> Result<Self> {
        Self::untrained_with(variant, salt, Engine::Kernels)
    }

    fn untrained_with(variant: Variant, salt: &str, engine: Engine) -> Result<Self> {
        let params = Params::from_recipe(salt, &Device::Cpu, engine);
        let network = Network::new(&params, variant, true)?;
        let schema = format!("depthsplat {variant} by rule {salt:?}");
        Ok(Self { network, range: DepthRange::Estimate, schema })
    }

    /// The weights of an [`untrained`](Self::untrained) network. For files that tests are made of.
    ///
    /// # Errors
    /// If a tensor cannot be made.
    pub fn untrained_weights(variant: Variant, salt: &str) -> Result<Vec<NamedTensor>> {
        let all = Self::parameters(variant)?.into_iter();
        Ok(all
            .map(|(name, shape)| {
                let values = recipe::values(salt, &name, &shape);
                NamedTensor { name, shape, values }
            })
            .collect())
    }

    /// Names and shapes of all parameters of a variant, as in the GS checkpoints without `encoder.`.
    ///
    /// # Errors
    /// If a tensor cannot be made.
    pub fn parameters(variant: Variant) -> Result<BTreeMap<String, Vec<usize>>> {
        let params = Params::from_recipe("", &Device::Cpu, Engine::Composed);
        Network::new(&params, variant, true)?;
        Ok(params.requested())
    }

    /// The same network with another depth range. It is estimated from the views, unless stated; the published models were
    /// trained with 0.5 to 200 (DL3DV) and 0.5 to 100 (RealEstate10K), in the units of these data sets.
    #[must_use]
    pub fn with_range(self, range: DepthRange) -> Self {
        Self { range, ..self }
    }

    /// Which network it is.
    #[must_use]
    pub fn variant(&self) -> Variant {
        self.network.variant()
    }

    /// What the feature maps' schema says: layout and ViT, and the start of the SHA-256 of the weights.
    #[must_use]
    pub fn schema(&self) -> &str {
        &self.schema
    }

    /// Whether the weights for features and Gaussians are there: checkpoints of depth alone lack them.
    #[must_use]
    pub fn has_features(&self) -> bool {
        self.network.has_heads()
    }

    /// Depth, confidence and features as [`DepthBackbone::estimate`] gives them, with a near and a far plane per view, and
    /// what the pass shows of itself; its maps are large.
    ///
    /// # Errors
    /// As [`DepthBackbone::estimate`]; if there is not one range per view.
    pub fn trace(
        &self,
        views: &[View],
        ranges: &[(f64, f64)],
        maps: bool,
    ) -> Result<(Vec<ViewGeometry>, Trace)> {
        let bounds = per_view_bounds(views, ranges)?;
        let mut taps = if maps { Taps::with_maps() } else { Taps::default() };
        let wanted = if self.has_features() { Wanted::DepthAndFeatures } else { Wanted::Depth };
        let pass = self.pass(views, &bounds, wanted, &mut taps)?;
        if maps {
            self.pixel_gaussians(&pass, &bounds, &mut taps)?.note(&mut taps)?;
        }
        let geometry = self.geometry(views, &pass, wanted)?;
        let stages = taps.times().to_vec();
        let traced = |(name, tensor): (String, candle_core::Tensor)| {
            Ok(NamedTensor { name, shape: tensor.dims().to_vec(), values: tensor.flatten_all()?.to_vec1()? })
        };
        let maps = taps.into_maps()?.into_iter().map(traced).collect::<Result<_>>()?;
        Ok((geometry, Trace { maps, stages }))
    }

    /// DepthSplat's own Gaussians, one per pixel, with a near and a far plane per view.
    ///
    /// # Errors
    /// As [`DepthSplat::trace`]; if the weights are for depth alone.
    pub fn gaussians(&self, views: &[View], ranges: &[(f64, f64)]) -> Result<PixelGaussians> {
        let bounds = per_view_bounds(views, ranges)?;
        let taps = &mut Taps::default();
        let pass = self.pass(views, &bounds, Wanted::DepthAndGaussians, taps)?;
        self.pixel_gaussians(&pass, &bounds, taps)
    }

    fn pixel_gaussians(&self, pass: &Pass, bounds: &[Bounds], taps: &mut Taps) -> Result<PixelGaussians> {
        let mut all = PixelGaussians::default();
        let add = &mut |_: usize, pixels: &[PixelGaussian]| pixels.iter().for_each(|pixel| all.push(pixel));
        self.network.gaussians(&pass.inputs(bounds), &pass.outputs, taps, add)?;
        Ok(all)
    }

    /// Depth, confidence and what else is wanted of every view, with one near and far plane, scene units.
    ///
    /// # Errors
    /// As [`DepthBackbone::estimate`].
    pub fn estimate_within(
        &self,
        views: &[View],
        (near, far): (f64, f64),
        wanted: Wanted,
    ) -> Result<Vec<ViewGeometry>> {
        let bounds = vec![views::bounds(near, far)?; views.len()];
        let taps = &mut Taps::default();
        let pass = self.pass(views, &bounds, wanted, taps)?;
        let mut geometry = self.geometry(views, &pass, wanted)?;
        if wanted == Wanted::DepthAndGaussians {
            let mut sets = vec![Gaussians::empty(2)?; views.len()];
            let add = &mut |view: usize, pixels: &[PixelGaussian]| {
                pixels.iter().for_each(|pixel| pixel.push_to(&mut sets[view]));
            };
            self.network.gaussians(&pass.inputs(&bounds), &pass.outputs, taps, add)?;
            for ((view, geometry), set) in views.iter().zip(&mut geometry).zip(sets) {
                let broken =
                    |row: &[f32], values: usize| row.iter().position(|v| !v.is_finite()).map(|i| i / values);
                let sh_row = 3 * sh_coefficients(set.sh_degree());
                let pixel = broken(set.geometry(), Gaussians::GEOMETRY).or_else(|| broken(set.sh(), sh_row));
                if let Some(pixel) = pixel {
                    let (x, y) = (pixel % view.image().width(), pixel / view.image().width());
                    return Err(Error::GaussianNotFinite { view: view.name().to_owned(), x, y });
                }
                geometry.gaussians = Some(set);
            }
        }
        Ok(geometry)
    }

    fn pass(&self, views: &[View], bounds: &[Bounds], wanted: Wanted, taps: &mut Taps) -> Result<Pass> {
        check_pixels(views)?;
        if views.len() < 2 {
            return Err(Error::OneView);
        }
        let with_features = wanted != Wanted::Depth;
        if with_features && !self.has_features() {
            return Err(Error::NoFeatureWeights);
        }
        let padded = Padded::new(views, self.variant().scales.multiple(), self.network.device())?;
        let inputs = NetworkInputs { images: &padded.images, cameras: &padded.cameras, bounds };
        let outputs = self.network.forward(&inputs, with_features, taps)?;
        Ok(Pass { padded, outputs })
    }

    fn geometry(&self, views: &[View], pass: &Pass, wanted: Wanted) -> Result<Vec<ViewGeometry>> {
        let Pass { padded, outputs } = pass;
        let factor = self.variant().scales.upsampling();
        let one = |(i, view): (usize, &View)| {
            Ok(ViewGeometry {
                depth: padded.depth(&outputs.depth, (i, view.name()))?,
                confidence: padded.confidence(&outputs.match_probability, factor, i)?,
                features: match &outputs.features {
                    Some(maps) if wanted == Wanted::DepthAndFeatures => {
                        Some(Features::Map(padded.features(maps, i)?.with_schema(self.schema.clone())))
                    }
                    _ => None,
                },
                gaussians: None,
            })
        };
        views.iter().enumerate().map(one).collect()
    }
}

/// What went into the network and what came out.
struct Pass {
    padded: Padded,
    outputs: NetworkOutputs,
}

impl Pass {
    fn inputs<'a>(&'a self, bounds: &'a [Bounds]) -> NetworkInputs<'a> {
        NetworkInputs { images: &self.padded.images, cameras: &self.padded.cameras, bounds }
    }
}

fn per_view_bounds(views: &[View], ranges: &[(f64, f64)]) -> Result<Vec<Bounds>> {
    if ranges.len() != views.len() {
        let (setting, expected) = ("number of ranges", "one per view");
        return Err(Error::Setting { setting, found: ranges.len() as f64, expected });
    }
    ranges.iter().map(|&(near, far)| views::bounds(near, far)).collect()
}

impl DepthBackbone for DepthSplat {
    fn estimate(&self, views: &[View], wanted: Wanted) -> Result<Vec<ViewGeometry>> {
        check_pixels(views)?;
        if views.len() < 2 {
            return Err(Error::OneView);
        }
        let (near, far) = match self.range {
            DepthRange::Known { near, far } => (near, far),
            DepthRange::Estimate => estimate::depth_range(views)?,
        };
        self.estimate_within(views, (near, far), wanted)
    }
}
