#![doc = include_str!("../README.md")]

mod check;
mod error;
mod psnr;
mod ssim;

pub use error::{Error, Result};
pub use psnr::psnr;
pub use ssim::{SSIM_WINDOW, ssim};
