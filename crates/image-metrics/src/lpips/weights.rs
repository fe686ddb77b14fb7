//! Published weights: a network's file of torchvision and the metric's linear layers, or both in one file.

use super::architecture::{ConvolutionPlan, LayerPlan, LpipsNetwork, StepPlan};
use super::convolution::Convolution;
use super::network::Network;
use crate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use tensor_files::{StoredTensor, TensorFile, TensorFileError, WeightFault, WeightProblem};

/// Of the metric's colours in -1..1, before the network.
pub(super) const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
pub(super) const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// What the metric is made of.
pub(super) struct Weights {
    pub(super) network: LpipsNetwork,
    pub(super) layers: Network,
    /// Of each output that is compared, by channel.
    pub(super) linear: Vec<Vec<f32>>,
}

pub(super) fn read(paths: &[PathBuf]) -> Result<Weights> {
    let mut files = Files { sources: Vec::new(), tensors: BTreeMap::new(), problems: Vec::new() };
    for path in paths {
        files.open(path)?;
    }
    let Some(network) = files.network() else {
        let found = files.tensors.len() + files.problems.len();
        return Err(Error::WeightsUnknown { paths: paths.to_vec(), found });
    };
    let plan = network.plan();
    let mut wanted = BTreeSet::new();
    let layers = Network::new(&plan, |plan| files.convolution(plan, &mut wanted))?;
    let mut linear = Vec::new();
    for (tap, channels) in taps(&plan).into_iter().enumerate() {
        linear.push(files.take(&format!("lin{tap}.weight"), &[channels], &mut wanted)?);
    }
    for (name, published) in [("shift", SHIFT), ("scale", SCALE)] {
        let name = format!("scaling.{name}");
        if files.tensors.contains_key(&name) {
            let found = files.take(&name, &[3], &mut wanted)?;
            if found.iter().zip(published).any(|(found, published)| (found - published).abs() > 1e-6) {
                files.problems.push(WeightProblem { name, fault: WeightFault::Constant });
            }
        }
    }
    let unexpected = files.tensors.iter().filter(|(name, _)| !wanted.contains(*name));
    let unexpected = unexpected
        .map(|(_, (_, stored))| WeightProblem { name: stored.name.clone(), fault: WeightFault::Unexpected });
    files.problems.extend(unexpected.collect::<Vec<_>>());
    if files.problems.is_empty() {
        return Ok(Weights { network, layers, linear });
    }
    Err(Error::Weights { paths: paths.to_vec(), network, problems: files.problems })
}

/// Channels of the outputs that are compared.
fn taps(plan: &[StepPlan]) -> Vec<usize> {
    let channels = plan.iter().filter(|(_, is_tap)| *is_tap).map(|(layer, _)| match layer {
        LayerPlan::Convolution(layer) => layer.outputs,
        LayerPlan::Fire { expand: [one, three], .. } => one.outputs + three.outputs,
        LayerPlan::Pool(_) => 0,
    });
    channels.collect()
}

struct Files {
    sources: Vec<TensorFile>,
    /// By the metric's names: position of the source, and what it holds.
    tensors: BTreeMap<String, (usize, StoredTensor)>,
    problems: Vec<WeightProblem>,
}

impl Files {
    fn open(&mut self, path: &Path) -> Result<()> {
        let (source, tensors) = TensorFile::open(path).map_err(|source| unusable(path, source))?;
        for stored in tensors {
            let Some(name) = known_name(&stored.name) else { continue };
            let entry = (self.sources.len(), stored);
            if self.tensors.insert(name.clone(), entry).is_some() {
                self.problems.push(WeightProblem { name, fault: WeightFault::Twice });
            }
        }
        self.sources.push(source);
        Ok(())
    }

    /// The network that shapes and names tell.
    fn network(&self) -> Option<LpipsNetwork> {
        let shape = |name: &str| self.tensors.get(name).map(|(_, stored)| stored.shape.as_slice());
        match shape("features.0.weight")? {
            [64, 3, 11, 11] => Some(LpipsNetwork::AlexNet),
            [64, 3, 3, 3] if shape("features.3.squeeze.weight").is_some() => Some(LpipsNetwork::SqueezeNet),
            [64, 3, 3, 3] if shape("features.2.weight").is_some() => Some(LpipsNetwork::Vgg16),
            _ => None,
        }
    }

    fn convolution(&mut self, plan: &ConvolutionPlan, wanted: &mut BTreeSet<String>) -> Result<Convolution> {
        let side = plan.window.side;
        let shape = [plan.outputs, plan.inputs, side, side];
        let weight = self.take(&format!("{}.weight", plan.name), &shape, wanted)?;
        let bias = self.take(&format!("{}.bias", plan.name), &[plan.outputs], wanted)?;
        Ok(Convolution::new(plan.window, plan.inputs, &weight, bias))
    }

    /// A tensor's values. One that does not fit is noted, and zeros take its place.
    fn take(&mut self, name: &str, expected: &[usize], wanted: &mut BTreeSet<String>) -> Result<Vec<f32>> {
        wanted.insert(name.to_owned());
        let fault = match self.tensors.get(name) {
            None => WeightFault::Missing,
            Some((_, stored)) if !is_shape(&stored.shape, expected) => {
                WeightFault::Shape { expected: expected.to_vec(), found: stored.shape.clone() }
            }
            Some((source, stored)) => {
                let file = &mut self.sources[*source];
                let values = file.values(stored).map_err(|source| unusable(file.path(), source))?;
                if values.iter().all(|value| value.is_finite()) {
                    return Ok(values);
                }
                WeightFault::NotFinite
            }
        };
        self.problems.push(WeightProblem { name: name.to_owned(), fault });
        Ok(vec![0.0; expected.iter().product()])
    }
}

/// With the whole chain of reasons: the error is compared and copied, which its sources are not.
fn unusable(path: &Path, source: TensorFileError) -> Error {
    let path = path.to_owned();
    match source {
        TensorFileError::NoTensors => Error::WeightsNone { path },
        TensorFileError::Type { name } => Error::WeightsType { path, name },
        source => {
            let causes =
                std::iter::successors(Some(&source as &dyn std::error::Error), |cause| cause.source());
            let reason = causes.map(ToString::to_string).collect::<Vec<_>>().join(": ");
            Error::WeightsUnreadable { path, reason }
        }
    }
}

/// Whether a shape is the expected one, or, of a vector, that with ones about it: `[1, channels, 1, 1]`.
fn is_shape(found: &[usize], expected: &[usize]) -> bool {
    let wide = |&&n: &&usize| n != 1;
    found == expected || expected.len() == 1 && found.iter().filter(wide).eq(expected)
}

/// The metric's name of a tensor; none for those that it is known not to need.
fn known_name(stored: &str) -> Option<String> {
    // Classifiers of torchvision's files; the published program holds its linear layers twice.
    if stored.starts_with("classifier.") || stored.starts_with("lins.") {
        return None;
    }
    if let Some(constant) = stored.strip_prefix("scaling_layer.") {
        return Some(format!("scaling.{constant}"));
    }
    if let Some(linear) = stored.strip_suffix(".model.1.weight").filter(|name| name.starts_with("lin")) {
        return Some(format!("{linear}.weight"));
    }
    let name = stored.strip_prefix("net.").unwrap_or(stored);
    // `slice2.5.weight` is what torchvision calls `features.5.weight`.
    if let Some((slice, rest)) = name.strip_prefix("slice").and_then(|name| name.split_once('.'))
        && slice.bytes().all(|byte| byte.is_ascii_digit())
    {
        return Some(format!("features.{rest}"));
    }
    Some(name.to_owned())
}
