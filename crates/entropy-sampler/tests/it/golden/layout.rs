//! Reads golden entropies (layout: `fixtures/entropy-sampler/README.md`) and compares.

use entropy_sampler::{Border, EntropyWindow, entropy};
use safetensors::{SafeTensorError, SafeTensors};

/// Bits; the files store f32.
pub(crate) const TOLERANCE: f32 = 1e-6;

pub(crate) struct Picture {
    pub(crate) name: String,
    pub(crate) width: usize,
    pub(crate) height: usize,
    grey: Vec<u8>,
    pub(crate) expected: [(Border, Vec<f32>); 2],
}

pub(crate) fn read(bytes: &[u8]) -> Result<Vec<Picture>, SafeTensorError> {
    let file = SafeTensors::deserialize(bytes)?;
    let mut names: Vec<&str> = file.names().into_iter().filter_map(|n| n.strip_suffix("/grey")).collect();
    names.sort_unstable();
    let bits = |name: String| -> Result<Vec<f32>, SafeTensorError> {
        let data = file.tensor(&name)?.data();
        Ok(data.chunks_exact(4).map(|w| f32::from_le_bytes([w[0], w[1], w[2], w[3]])).collect())
    };
    names
        .into_iter()
        .map(|name| {
            let grey = file.tensor(&format!("{name}/grey"))?;
            Ok(Picture {
                name: name.to_owned(),
                width: grey.shape()[1],
                height: grey.shape()[0],
                grey: grey.data().to_vec(),
                expected: [
                    (Border::Reflect, bits(format!("{name}/entropy_reflect"))?),
                    (Border::Clip, bits(format!("{name}/entropy_clip"))?),
                ],
            })
        })
        .collect()
}

impl Picture {
    /// Largest deviation from `expected`, bits.
    pub(crate) fn worst_deviation(&self, border: Border, expected: &[f32]) -> entropy_sampler::Result<f32> {
        let window = EntropyWindow { border, ..EntropyWindow::default() };
        let found = entropy(&self.grey, self.width, self.height, window)?;
        assert_eq!(found.len(), expected.len(), "{}", self.name);
        Ok(found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max))
    }
}
