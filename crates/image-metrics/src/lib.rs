#![doc = include_str!("../README.md")]

mod check;
mod error;
mod psnr;
mod ssim;

pub use error::{Error, Result};
pub use psnr::{psnr, psnr_rgb};
pub use ssim::{SSIM_WINDOW, SsimScratch, SsimTarget, ssim, ssim_rgb};
