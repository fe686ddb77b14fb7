use super::super::kernels::{self, Border, Kernel, Maps, Window};
use super::super::params::Params;
use super::{Engine, Linear, Then, Work, tensor, upscaled, values};
use candle_core::{Result, Tensor};
use candle_nn::{Conv2d, Conv2dConfig, Module};

enum Form {
    /// With its bias.
    Kernel(Kernel, Option<Tensor>),
    Composed(Conv2d),
}

/// A convolution with square windows.
pub(in crate::depthsplat) struct Conv {
    form: Form,
    window: Window,
    inputs: usize,
    outputs: usize,
    work: Work,
}

/// A convolution yet to be loaded: `weight` `[out, in, side, side]`, `bias` `[out]`.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct ConvShape {
    inputs: usize,
    outputs: usize,
    window: Window,
    bias: bool,
}

impl ConvShape {
    pub(in crate::depthsplat) fn stride(self, stride: usize) -> Self {
        Self { window: Window { stride, ..self.window }, ..self }
    }

    pub(in crate::depthsplat) fn unpadded(self) -> Self {
        Self { window: Window { padding: 0, ..self.window }, ..self }
    }

    /// Beyond the border lies the nearest pixel, not zero.
    pub(in crate::depthsplat) fn replicate(self) -> Self {
        Self { window: Window { border: Border::Replicate, ..self.window }, ..self }
    }

    pub(in crate::depthsplat) fn without_bias(self) -> Self {
        Self { bias: false, ..self }
    }

    pub(in crate::depthsplat) fn load(self, p: &Params) -> Result<Conv> {
        let Self { inputs, outputs, window, bias } = self;
        let weight = p.get("weight", &[outputs, inputs, window.side, window.side])?;
        let bias = if bias { Some(p.get("bias", &[outputs])?) } else { None };
        let form = match p.engine() {
            Engine::Kernels => Form::Kernel(Kernel::new(&values(&weight)?, outputs, inputs, window), bias),
            Engine::Composed => {
                let padding = if window.border == Border::Zero { window.padding } else { 0 };
                let config = Conv2dConfig { padding, stride: window.stride, ..Conv2dConfig::default() };
                Form::Composed(Conv2d::new(weight, bias, config))
            }
        };
        Ok(Conv { form, window, inputs, outputs, work: p.work().clone() })
    }
}

impl Conv {
    /// Windows of `side` x `side` pixels with bias, stride 1, zeros around the border that keep the size.
    pub(in crate::depthsplat) fn shape(side: usize, inputs: usize, outputs: usize) -> ConvShape {
        let window = Window { side, stride: 1, padding: (side - 1) / 2, border: Border::Zero };
        ConvShape { inputs, outputs, window, bias: true }
    }

    /// `[n, h, w, in]` to `[n, h', w', out]`.
    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_then(x, Then::NOTHING)
    }

    pub(in crate::depthsplat) fn forward_then(&self, x: &Tensor, then: Then<'_>) -> Result<Tensor> {
        let (count, height, width, channels) = x.dims4()?;
        assert_eq!(channels, self.inputs, "channels of a convolution's input");
        let shape = (count, self.window.steps(height), self.window.steps(width), self.outputs);
        let area = self.window.side * self.window.side;
        self.work.add(count * shape.1 * shape.2, area * channels, self.outputs);
        match &self.form {
            Form::Kernel(kernel, bias) => {
                let values = values(x)?;
                let maps = Maps { values: &values, height, width, channels };
                let y = then.on_slices(bias.as_ref(), |finish| {
                    kernels::convolve(maps, self.window, kernel, finish)
                })?;
                tensor(y, shape)
            }
            Form::Composed(conv) => {
                let mut x = x.permute((0, 3, 1, 2))?.contiguous()?;
                if self.window.border == Border::Replicate {
                    let padding = self.window.padding;
                    x = x.pad_with_same(2, padding, padding)?.pad_with_same(3, padding, padding)?;
                }
                let y = conv.forward(&x.contiguous()?)?;
                then.compose(y.permute((0, 2, 3, 1))?.contiguous()?)
            }
        }
    }
}

/// A transposed convolution whose windows do not overlap: `weight` `[in, out, factor, factor]`.
pub(in crate::depthsplat) struct ConvTranspose {
    linear: Linear,
    factor: usize,
}

impl ConvTranspose {
    pub(in crate::depthsplat) fn new(
        p: &Params,
        inputs: usize,
        outputs: usize,
        factor: usize,
    ) -> Result<Self> {
        let weight = p.get("weight", &[inputs, outputs, factor, factor])?;
        let bias = p.get("bias", &[outputs])?;
        let columns = factor * factor * outputs;
        let weight = weight.permute((2, 3, 1, 0))?.reshape((columns, inputs))?.contiguous()?;
        let bias = Tensor::cat(&vec![bias; factor * factor], 0)?;
        Ok(Self { linear: Linear::from_tensors(p, &weight, Some(bias), inputs, columns)?, factor })
    }

    /// `[n, h, w, in]` to `[n, factor h, factor w, out]`.
    pub(in crate::depthsplat) fn forward_then(&self, x: &Tensor, then: Then<'_>) -> Result<Tensor> {
        upscaled(&self.linear.forward_then(x, then)?, self.factor)
    }
}
