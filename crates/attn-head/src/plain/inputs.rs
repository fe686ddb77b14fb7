use crate::inputs::{check_cells, check_neighbours};
use crate::{Config, Error, Inputs, Result};
use candle_core::{DType, Device, Tensor};

/// [`Inputs`] as tensors, any of which may be a `Var` or come from one.
#[derive(Debug, Clone)]
pub struct TensorInputs {
    /// Geometric features g, `[n, config.geometry]`.
    pub geometry: Tensor,
    /// Image features v, `[n, config.image]`.
    pub image: Tensor,
    /// Index of each neighbour, u32 `[n, k]`, the nearest first.
    pub neighbours: Tensor,
    /// p_j - p_i, `[n, k, 3]`.
    pub relative: Tensor,
    /// The cells of each anchor, u32 `[n, 2]`, as in [`Inputs::cells`]; `[0, 2]` for a head that does not look at them.
    pub cells: Tensor,
}

impl TensorInputs {
    /// Copies slices to a device.
    ///
    /// # Errors
    /// Those of [`Inputs::check`], and candle's.
    pub fn new(config: &Config, inputs: &Inputs<'_>, dtype: DType, device: &Device) -> Result<Self> {
        inputs.check(config)?;
        let &Inputs { n, k, .. } = inputs;
        let floats = |values: &[f32], shape: &[usize]| -> Result<Tensor> {
            Ok(Tensor::from_slice(values, shape, device)?.to_dtype(dtype)?)
        };
        Ok(Self {
            geometry: floats(inputs.geometry, &[n, config.geometry])?,
            image: floats(inputs.image, &[n, config.image])?,
            neighbours: Tensor::from_slice(inputs.neighbours, (n, k), device)?,
            relative: floats(inputs.relative.as_flattened(), &[n, k, 3])?,
            cells: Tensor::from_slice(inputs.cells.as_flattened(), (inputs.cells.len(), 2), device)?,
        })
    }

    /// Anchors and neighbours per anchor, if the shapes agree and the neighbours exist.
    pub(super) fn check(&self, config: &Config) -> Result<(usize, usize)> {
        let &[n, k] = self.neighbours.dims() else {
            let found = self.neighbours.dims().to_vec();
            return Err(Error::Rank { what: "neighbours", expected: 2, found });
        };
        config.check_neighbours(k)?;
        let shapes = [
            ("geometry", &self.geometry, vec![n, config.geometry]),
            ("image", &self.image, vec![n, config.image]),
            ("relative", &self.relative, vec![n, k, 3]),
        ];
        for (what, tensor, expected) in shapes {
            if tensor.dims() != expected {
                return Err(Error::Shape { what, expected, found: tensor.dims().to_vec() });
            }
        }
        // Not every device checks an index.
        check_neighbours(&self.neighbours.flatten_all()?.to_vec1()?, n, k)?;
        let &[_, 2] = self.cells.dims() else {
            return Err(Error::Shape {
                what: "cells",
                expected: vec![n, 2],
                found: self.cells.dims().to_vec(),
            });
        };
        check_cells(config, self.cells.flatten_all()?.to_vec1()?.as_chunks().0, n)?;
        Ok((n, k))
    }
}
