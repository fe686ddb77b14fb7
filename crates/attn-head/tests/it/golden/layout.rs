//! Golden files of the attention head: inputs, all maps between its layers, gradients. The layout is described in
//! fixtures/attn-head/README.md.

#[cfg(feature = "candle")]
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Config, Head, Inputs, Kind, OUTPUTS, Weights, fused};
#[cfg(feature = "candle")]
use candle_core::{DType, Device, Tensor, Var};
use safetensors::{Dtype, SafeTensors};

/// What can be wrong with a file.
pub(crate) type Failure = Box<dyn std::error::Error>;

/// Relative root mean square that f32 may deviate from f64. Measured are 1e-6 at most; sums in another order and other
/// instructions have room, and an epsilon of 1e-6 in LayerNorm deviates by 1.4e-5.
pub(crate) const RMS: f64 = 1e-5;
/// Largest deviation of one number, in units of the map's root mean square.
pub(crate) const LARGEST: f64 = 1e-4;

/// A case: a head, what it sees, what it should find.
pub(crate) struct Golden {
    pub(crate) weights: Weights,
    pub(crate) n: usize,
    pub(crate) k: usize,
    geometry: Vec<f32>,
    image: Vec<f32>,
    positions: Vec<[f32; 3]>,
    neighbours: Vec<u32>,
    loss_weight: Vec<f32>,
    /// Name and values of each map.
    expected: Vec<(String, Vec<f32>)>,
}

/// How a computed map differs from the file's.
pub(crate) struct Deviation {
    /// What computed it.
    pub(crate) by: &'static str,
    pub(crate) name: String,
    /// Largest absolute difference.
    #[allow(dead_code, reason = "shared with an example, which prints it")]
    pub(crate) absolute: f64,
    /// Root mean square of the difference over that of the map.
    pub(crate) rms: f64,
    /// Largest difference over the root mean square of the map.
    pub(crate) largest: f64,
}

impl Deviation {
    pub(crate) fn within(&self) -> bool {
        // Written so that NaN is outside.
        self.rms <= RMS && self.largest <= LARGEST
    }
}

/// The numbers of a tensor `[n, .., last]`, which has `len` of them.
fn floats(file: &SafeTensors<'_>, name: &str, len: usize) -> Result<Vec<f32>, Failure> {
    let tensor = file.tensor(name).map_err(|e| format!("{name}: {e}"))?;
    if tensor.dtype() != Dtype::F32 || tensor.data().len() != 4 * len {
        let (dtype, shape) = (tensor.dtype(), tensor.shape());
        return Err(format!("{name} holds {dtype:?} {shape:?}, expected {len} of F32").into());
    }
    Ok(tensor.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
}

/// Rows and columns of a tensor.
fn shape(file: &SafeTensors<'_>, name: &str) -> Result<[usize; 2], Failure> {
    let tensor = file.tensor(name).map_err(|e| format!("{name}: {e}"))?;
    let shape = tensor.shape().try_into();
    Ok(shape.map_err(|_| format!("{name} has shape {:?}, expected two dimensions", tensor.shape()))?)
}

impl Golden {
    /// Reads a file.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, Failure> {
        let file = SafeTensors::deserialize(bytes)?;
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let salt = header.metadata().as_ref().and_then(|metadata| metadata.get("salt"));
        let salt = salt.ok_or("no `salt` in the metadata")?;
        let ([n, geometry], [_, image]) = (shape(&file, "geometry")?, shape(&file, "image")?);
        let [_, k] = shape(&file, "neighbors")?;
        let config = Config { kind: Kind::Attention, geometry, image, neighbours: k };
        let neighbours = file.tensor("neighbors")?;
        if neighbours.dtype() != Dtype::I64 {
            return Err(format!("neighbors holds {:?}, expected I64", neighbours.dtype()).into());
        }
        let index = |bytes: &[u8; 8]| u32::try_from(i64::from_le_bytes(*bytes));
        let neighbours = neighbours.data().as_chunks().0.iter().map(index).collect::<Result<_, _>>()?;
        let mut expected = Vec::new();
        for (name, len) in [
            ("f0", 128 * n),
            ("block0", 128 * n),
            ("alpha0", 4 * n * (k + 1)),
            ("block1", 128 * n),
            ("alpha1", 4 * n * (k + 1)),
            ("block2", 128 * n),
            ("alpha2", 4 * n * (k + 1)),
            ("out", OUTPUTS * n),
            ("grad_geometry", geometry * n),
            ("grad_image", image * n),
            ("grad_positions", 3 * n),
        ] {
            expected.push((name.to_owned(), floats(&file, name, len)?));
        }
        Ok(Self {
            weights: Weights::recipe(config, salt)?,
            n,
            k,
            geometry: floats(&file, "geometry", n * geometry)?,
            image: floats(&file, "image", n * image)?,
            positions: floats(&file, "positions", 3 * n)?.as_chunks().0.to_vec(),
            neighbours,
            loss_weight: floats(&file, "loss_weight", OUTPUTS * n)?,
            expected,
        })
    }

    fn relative(&self) -> Result<Vec<[f32; 3]>, Failure> {
        let pairs = self.neighbours.iter().enumerate().map(|(at, &j)| {
            let (i, p) = (at / self.k, self.positions.get(j as usize));
            let p = p.ok_or_else(|| format!("anchor {i} has neighbour {j}, of {}", self.n))?;
            Ok([0, 1, 2].map(|c| p[c] - self.positions[i][c]))
        });
        pairs.collect()
    }

    fn judge(&self, by: &'static str, name: &str, found: &[f32]) -> Result<Deviation, Failure> {
        let (name, expected) = self.expected.iter().find(|(n, _)| n == name).ok_or("an unknown map")?;
        assert_eq!(found.len(), expected.len(), "{name}");
        let difference = |(a, b): (&f32, &f32)| f64::from(*a) - f64::from(*b);
        let rms = |squares: f64| (squares / expected.len().max(1) as f64).sqrt();
        // Where all should be zero, deviations are absolute.
        let size = match rms(expected.iter().map(|v| f64::from(*v).powi(2)).sum()) {
            0.0 => 1.0,
            size => size,
        };
        let differences = || found.iter().zip(expected).map(difference);
        // `f64::max` would drop a NaN.
        let larger = |m: f64, d: f64| if d.abs() <= m { m } else { d.abs() };
        let absolute = differences().fold(0.0, larger);
        let rms = rms(differences().map(|d| d * d).sum()) / size;
        Ok(Deviation { by, name: name.clone(), absolute, rms, largest: absolute / size })
    }

    /// Compares every map and gradient of the plain form, where it is built, with the file, the outputs of [`Head`], and the
    /// outputs and gradients of the fused form.
    pub(crate) fn compare(&self) -> Result<Vec<Deviation>, Failure> {
        let relative = self.relative()?;
        #[cfg(feature = "candle")]
        let mut deviations = self.compare_plain()?;
        #[cfg(not(feature = "candle"))]
        let mut deviations = Vec::new();
        let inputs = Inputs {
            n: self.n,
            k: self.k,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &relative,
            cells: &[],
        };
        let out = Head::new(self.weights.clone())?.run(&inputs)?;
        deviations.push(self.judge("head", "out", &out)?);
        let (config, weights) = (&self.weights.config, &self.weights.values);
        let (out, tape) = fused::forward_recorded(config, weights, &inputs);
        deviations.push(self.judge("fused", "out", &out)?);
        let gradients = fused::backward(config, weights, &inputs, &tape, &self.loss_weight);
        deviations.push(self.judge("fused", "grad_geometry", &gradients.geometry)?);
        deviations.push(self.judge("fused", "grad_image", &gradients.image)?);
        Ok(deviations)
    }

    /// Neighbours exist.
    #[cfg(feature = "candle")]
    fn compare_plain(&self) -> Result<Vec<Deviation>, Failure> {
        let (n, k, config) = (self.n, self.k, self.weights.config);
        let var = |values: &[f32], width: usize| {
            Var::from_tensor(&Tensor::from_slice(values, (n, width), &Device::Cpu)?)
        };
        let (geometry, image) = (var(&self.geometry, config.geometry)?, var(&self.image, config.image)?);
        let positions = var(self.positions.as_flattened(), 3)?;
        let neighbours = Tensor::from_slice(&self.neighbours, (n, k), &Device::Cpu)?;
        let relative = if k == 0 {
            Tensor::zeros((n, 0, 3), DType::F32, &Device::Cpu)?
        } else {
            let p = positions.index_select(&neighbours.flatten_all()?, 0)?.reshape((n, k, 3))?;
            p.broadcast_sub(&positions.unsqueeze(1)?)?
        };
        let inputs = TensorInputs {
            geometry: geometry.as_tensor().clone(),
            image: image.as_tensor().clone(),
            neighbours,
            relative,
            cells: Tensor::zeros((0, 2), DType::U32, &Device::Cpu)?,
        };
        let network = Network::new(config, &self.weights.to_tensor(DType::F32, &Device::Cpu)?)?;
        let trace = network.trace(&inputs)?;
        let loss = (&trace.out * Tensor::from_slice(&self.loss_weight, (n, OUTPUTS), &Device::Cpu)?)?;
        let gradients = loss.sum_all()?.backward()?;
        let mut deviations = Vec::new();
        let mut add = |name: &str, map: &Tensor| {
            deviations.push(self.judge("plain", name, &map.flatten_all()?.to_vec1()?)?);
            Ok::<_, Failure>(())
        };
        add("f0", &trace.embedding)?;
        for (layer, (block, alpha)) in trace.blocks.iter().zip(&trace.alphas).enumerate() {
            add(&format!("block{layer}"), block)?;
            add(&format!("alpha{layer}"), alpha)?;
        }
        add("out", &trace.out)?;
        for (name, input) in
            [("grad_geometry", &geometry), ("grad_image", &image), ("grad_positions", &positions)]
        {
            match gradients.get(input) {
                Some(gradient) => add(name, gradient)?,
                // Without neighbours positions have no part in the result.
                None => add(name, &input.zeros_like()?)?,
            }
        }
        Ok(deviations)
    }
}
