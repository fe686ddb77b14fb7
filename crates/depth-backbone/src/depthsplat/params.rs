//! Parameters by the names of the checkpoints: what a layer asks for is what a file must hold.

use super::layers::{Engine, Work, values};
use super::recipe;
use candle_core::{DType, Device, Result, Tensor};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use tensor_files::{WeightFault, WeightProblem};

/// Where tensors come from.
pub(super) trait Source {
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
    requests: RefCell<Requests>,
    device: Device,
    engine: Engine,
    work: Work,
}

/// Parameters below a prefix.
#[derive(Clone)]
pub(super) struct Params {
    shared: Rc<Shared>,
    prefix: String,
}

impl Params {
    pub(super) fn from_source(source: Box<dyn Source>, device: &Device) -> Self {
        Self::new(Origin::File(source), device, Engine::for_device(device))
    }

    pub(super) fn from_recipe(salt: &str, device: &Device, engine: Engine) -> Self {
        Self::new(Origin::Recipe { salt: salt.to_owned() }, device, engine)
    }

    fn new(origin: Origin, device: &Device, engine: Engine) -> Self {
        let requests = RefCell::default();
        let shared = Shared { origin, requests, device: device.clone(), engine, work: Work::default() };
        Self { shared: Rc::new(shared), prefix: String::new() }
    }

    /// Those below `name`, which may have several parts.
    pub(super) fn pp(&self, name: impl std::fmt::Display) -> Self {
        let prefix = format!("{}{name}.", self.prefix);
        Self { shared: Rc::clone(&self.shared), prefix }
    }

    pub(super) fn device(&self) -> &Device {
        &self.shared.device
    }

    pub(super) fn engine(&self) -> Engine {
        self.shared.engine
    }

    pub(super) fn work(&self) -> &Work {
        &self.shared.work
    }

    /// A parameter, f32 on the CPU. One that does not fit is noted, and zeros take its place.
    pub(super) fn get(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        let name = format!("{}{name}", self.prefix);
        let mut requests = self.shared.requests.borrow_mut();
        requests.all.insert(name.clone(), shape.to_vec());
        let fault = match &self.shared.origin {
            Origin::Recipe { salt } => {
                return Tensor::from_vec(recipe::values(salt, &name, shape), shape, &Device::Cpu);
            }
            Origin::File(source) => match source.shape(&name) {
                Some(found) if found == shape => {
                    let tensor = source.load(&name)?.to_dtype(DType::F32)?.contiguous()?;
                    if values(&tensor)?.iter().all(|v| v.is_finite()) {
                        return Ok(tensor);
                    }
                    WeightFault::NotFinite
                }
                Some(found) => WeightFault::Shape { expected: shape.to_vec(), found },
                None => WeightFault::Missing,
            },
        };
        requests.problems.push(WeightProblem { name, fault });
        Tensor::zeros(shape, DType::F32, &Device::Cpu)
    }

    /// Names and shapes of all that was asked for.
    pub(super) fn requested(&self) -> BTreeMap<String, Vec<usize>> {
        self.shared.requests.borrow().all.clone()
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
        self.shared.requests.borrow().problems.clone()
    }
}
