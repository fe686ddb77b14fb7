#![doc = include_str!("../README.md")]

mod error;

mod dataset;
mod points;

mod nerfstudio;
mod open;

mod load;
mod picture;
mod undistort;

mod index;

mod overlap;
mod scene_depth;
mod select;
mod windows;

mod write;

pub use dataset::{Dataset, DepthFile, DepthPercentiles, Dropped, Format, Frame, ImageSource};
pub use error::{Error, IndexRule, Result, TransformsRule};
pub use gs_scene::{Distortion, Lens, LensModel};
pub use index::{EvaluationIndex, Window, read_index, write_index};
pub use nerfstudio::open_nerfstudio;
pub use open::{Scenes, open, open_all};
pub use points::{Observation, ScenePoint};
pub use scene_depth::{SceneDepth, estimate_scene_depth};
pub use select::{Selection, select_views};
pub use windows::windows_along;
pub use write::{DatasetWriter, Layout, PictureFormat, WriteRule, Written};
