//! The network's operations on slices of the CPU, channels last. They know nothing of tensors and parameters.

mod attention;
mod convolution;
mod correlation;
mod dense;
mod finish;
mod norm;
mod resize;
mod winograd;

pub(super) use cpu_kernels::{Activation, Packed};

pub(super) use attention::{Attention, Heads, Labels, attend, softmax_rows};
pub(super) use convolution::{Border, Kernel, Maps, Window, convolve};
pub(super) use correlation::{Correlation, Pairing};
pub(super) use dense::{Joined, dense};
pub(super) use finish::Finish;
pub(super) use norm::{GroupNorm, layer_norm};
pub(super) use resize::{bilinear, nearest, spread};
