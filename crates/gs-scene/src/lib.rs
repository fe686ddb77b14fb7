#![doc = include_str!("../README.md")]

mod error;

mod camera;
mod gaussians;
mod image;
mod lens;
mod lock;
mod maps;
mod ply;
mod ply_header;
mod view;
mod write;

pub use camera::{Camera, Intrinsics};
pub use error::{Error, PlyRule, Result};
pub use gaussians::{
    Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0, dc_from_rgb, logit, rgb_from_dc,
    sh_coefficients, sigmoid,
};
pub use image::Image;
pub use lens::{Distortion, Lens, LensModel, MAX_ASPECT_DEVIATION};
pub use lock::lock_file;
pub use maps::{DepthMap, FeatureMap};
pub use ply::{encode_ply, read_ply, read_ply_vertices, write_ply};
pub use ply_header::{PlyElement, PlyEncoding, PlyHeader, PlyKind, PlyProperty, PlyScalar};
pub use view::View;
pub use write::{links, write_atomically, write_durably};
