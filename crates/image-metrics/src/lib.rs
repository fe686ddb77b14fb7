#![doc = include_str!("../README.md")]

mod check;
mod error;
#[cfg(feature = "lpips")]
mod lpips;
mod psnr;
mod ssim;

pub use error::{Error, Result};
#[cfg(feature = "lpips")]
pub use lpips::{Lpips, LpipsNetwork, LpipsTarget, WeightFault, WeightProblem};
pub use psnr::{error_share, psnr, psnr_colour_corrected, psnr_rgb};
pub use ssim::{SSIM_WINDOW, SsimScratch, SsimTarget, ssim, ssim_rgb};
