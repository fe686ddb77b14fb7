//! Inputs made of hashes.

use crate::oracle;
#[cfg(feature = "candle")]
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Config, Inputs, Kind, Weights};
#[cfg(feature = "candle")]
use candle_core::{DType, Device, Tensor};

/// Anchors, their neighbours and features.
#[derive(Debug, Clone)]
pub(crate) struct Case {
    pub(crate) config: Config,
    pub(crate) n: usize,
    pub(crate) geometry: Vec<f32>,
    pub(crate) image: Vec<f32>,
    pub(crate) neighbours: Vec<u32>,
    pub(crate) relative: Vec<[f32; 3]>,
    pub(crate) cells: Vec<[u32; 2]>,
}

/// Numbers in [-1, 1).
pub(crate) fn uniform(seed: u64) -> impl Iterator<Item = f32> {
    (0_u64..).map(move |i| {
        let mut z = (seed << 32).wrapping_add(i).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z >> 40) as f32 / 8_388_608.0 - 1.0
    })
}

impl Case {
    /// Any neighbours, an anchor itself and duplicates included.
    pub(crate) fn new(kind: Kind, n: usize, k: usize, seed: u64) -> Self {
        let config = Config { kind, geometry: 3, image: 2, neighbours: k };
        let mut draws = uniform(seed);
        let mut take = |len| draws.by_ref().take(len).collect::<Vec<f32>>();
        let (geometry, image) = (take(3 * n), take(2 * n));
        let relative = take(3 * n * k).as_chunks().0.to_vec();
        let index = |u: f32| (((u + 1.0) / 2.0 * n as f32) as u32).min(n as u32 - 1);
        let neighbours = take(n * k).into_iter().map(index).collect();
        let cells = take(2 * n).as_chunks().0.iter().map(|cells| cells.map(index)).collect();
        Self { config, n, geometry, image, neighbours, relative, cells }
    }

    pub(crate) fn inputs(&self) -> Inputs<'_> {
        Inputs {
            n: self.n,
            k: self.config.neighbours,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &self.relative,
            cells: &self.cells,
        }
    }

    #[cfg(feature = "candle")]
    pub(crate) fn tensors(&self) -> TensorInputs {
        TensorInputs::new(&self.config, &self.inputs(), DType::F64, &Device::Cpu).unwrap()
    }

    pub(crate) fn weights(&self) -> Weights {
        Weights::recipe(self.config, "case").unwrap()
    }

    /// The same in f64, with the weights.
    pub(crate) fn exact(&self) -> oracle::Case {
        let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect();
        oracle::Case {
            config: self.config,
            n: self.n,
            k: self.config.neighbours,
            weights: wide(&self.weights().values),
            geometry: wide(&self.geometry),
            image: wide(&self.image),
            neighbours: self.neighbours.clone(),
            relative: self.relative.iter().map(|r| r.map(f64::from)).collect(),
            cells: self.cells.clone(),
        }
    }

    /// The outputs of the plain form in f64.
    #[cfg(feature = "candle")]
    pub(crate) fn plain(&self) -> Vec<f64> {
        let values = self.weights().to_tensor(DType::F64, &Device::Cpu).unwrap();
        flat(&Network::new(self.config, &values).unwrap().forward(&self.tensors()).unwrap())
    }
}

#[cfg(feature = "candle")]
pub(crate) fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference, infinite for a NaN.
pub(crate) fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m: f64, (a, b)| {
        let d = (a - b).abs();
        if d.is_nan() { f64::INFINITY } else { m.max(d) }
    })
}
