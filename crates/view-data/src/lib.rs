#![doc = include_str!("../README.md")]

mod error;

mod dataset;
mod nerfstudio;

mod load;
mod picture;
mod undistort;

mod index;

mod overlap;
mod scene_depth;
mod select;
mod windows;

mod write;

pub use dataset::{Dataset, DepthFile, DepthPercentiles, Frame};
pub use error::{Error, IndexRule, Result, TransformsRule};
pub use gs_scene::{Distortion, Lens};
pub use index::{Dropped, EvaluationIndex, Window, read_index, write_index};
pub use nerfstudio::open_nerfstudio;
pub use scene_depth::{SceneDepth, estimate_scene_depth};
pub use select::{Selection, select_views};
pub use windows::windows_along;
pub use write::{DatasetWriter, Layout, PictureFormat, WriteRule, Written};
