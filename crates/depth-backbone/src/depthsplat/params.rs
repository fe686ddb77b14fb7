//! Parameters by the names of the checkpoints: what a layer asks for is what a file must hold.

use super::layers::{Engine, Work, values};
use super::recipe;
use candle_core::{DType, Device, Result, Shape, Tensor, bail};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tensor_files::{WeightFault, WeightProblem};

/// Where tensors come from.
pub(super) trait Source: Send + Sync {
    /// Names of all tensors.
    fn names(&self) -> Vec<String>;
    /// Shape of a tensor, if there is one of that name.
    fn shape(&self, name: &str) -> Option<Vec<usize>>;
    /// A tensor that is there, on the CPU.
    fn load(&self, name: &str) -> Result<Tensor>;
}

enum Origin {
    File(Box<dyn Source>),
    /// Weights by the rule of [`recipe`]: every tensor that is asked for.
    Recipe {
        salt: String,
    },
}

/// What was asked for.
#[derive(Debug, Default)]
struct Requests {
    /// Name to shape.
    all: BTreeMap<String, Vec<usize>>,
    problems: Vec<WeightProblem>,
}

struct Shared {
    origin: Origin,
    requests: Mutex<Requests>,
}

impl Shared {
    fn requests(&self) -> MutexGuard<'_, Requests> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A parameter, f32 on the CPU.
    fn find(&self, name: &str, shape: &[usize]) -> Result<std::result::Result<Tensor, WeightFault>> {
        let source = match &self.origin {
            Origin::Recipe { salt } => {
                let values = recipe::values(salt, name, shape);
                return Tensor::from_vec(values, shape, &Device::Cpu).map(Ok);
            }
            Origin::File(source) => source,
        };
        Ok(match source.shape(name) {
            Some(found) if found == shape => {
                let tensor = source.load(name)?.to_dtype(DType::F32)?.contiguous()?;
                let finite = values(&tensor)?.iter().all(|v| v.is_finite());
                if finite { Ok(tensor) } else { Err(WeightFault::NotFinite) }
            }
            Some(found) => Err(WeightFault::Shape { expected: shape.to_vec(), found }),
            None => Err(WeightFault::Missing),
        })
    }
}

/// What a `VarBuilder` gets tensors from. One that does not fit is noted, and zeros take its place.
struct Noting(Arc<Shared>);

impl SimpleBackend for Noting {
    fn get(&self, shape: Shape, name: &str, _: Init, dtype: DType, device: &Device) -> Result<Tensor> {
        let found = self.0.find(name, shape.dims())?;
        let mut requests = self.0.requests();
        requests.all.insert(name.to_owned(), shape.dims().to_vec());
        match found {
            Ok(tensor) => tensor.to_device(device)?.to_dtype(dtype),
            Err(fault) => {
                requests.problems.push(WeightProblem { name: name.to_owned(), fault });
                Tensor::zeros(shape, dtype, device)
            }
        }
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> Result<Tensor> {
        bail!("{name}: a parameter is asked for with its shape")
    }

    fn contains_tensor(&self, name: &str) -> bool {
        match &self.0.origin {
            Origin::File(source) => source.shape(name).is_some(),
            Origin::Recipe { .. } => true,
        }
    }
}

/// Parameters below a prefix, and what computes with them.
#[derive(Clone)]
pub(super) struct Params {
    vb: VarBuilder<'static>,
    shared: Arc<Shared>,
    engine: Engine,
    work: Work,
}

impl Params {
    pub(super) fn from_source(source: Box<dyn Source>, device: &Device) -> Self {
        Self::new(Origin::File(source), device, Engine::for_device(device))
    }

    pub(super) fn from_recipe(salt: &str, device: &Device, engine: Engine) -> Self {
        Self::new(Origin::Recipe { salt: salt.to_owned() }, device, engine)
    }

    fn new(origin: Origin, device: &Device, engine: Engine) -> Self {
        let shared = Arc::new(Shared { origin, requests: Mutex::default() });
        let backend = Box::new(Noting(Arc::clone(&shared)));
        let vb = VarBuilder::from_backend(backend, DType::F32, device.clone());
        Self { vb, shared, engine, work: Work::default() }
    }

    /// Those below `name`, which may have several parts.
    pub(super) fn pp(&self, name: impl ToString) -> Self {
        Self { vb: self.vb.pp(name), ..self.clone() }
    }

    pub(super) fn device(&self) -> &Device {
        self.vb.device()
    }

    pub(super) fn engine(&self) -> Engine {
        self.engine
    }

    pub(super) fn work(&self) -> &Work {
        &self.work
    }

    /// A parameter, f32 on the device.
    pub(super) fn get(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        self.vb.get(shape, name)
    }

    /// Names and shapes of all that was asked for.
    pub(super) fn requested(&self) -> BTreeMap<String, Vec<usize>> {
        self.shared.requests().all.clone()
    }

    /// Names of all that the file holds.
    pub(super) fn stored(&self) -> Vec<String> {
        match &self.shared.origin {
            Origin::File(source) => source.names(),
            Origin::Recipe { .. } => Vec::new(),
        }
    }

    /// What did not fit.
    pub(super) fn problems(&self) -> Vec<WeightProblem> {
        self.shared.requests().problems.clone()
    }
}
