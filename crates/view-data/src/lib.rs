#![doc = include_str!("../README.md")]

mod error;
mod exr_depth;

mod dataset;
mod points;

mod files;

mod camera_row;
mod chunk;
mod colmap;
mod dl3dv;
mod nerfstudio;
mod open;
mod origin;
mod ply;
mod re10k;
mod replica;
mod scannet;
mod scene_list;
mod trajectory;
mod tum;

mod depth;
mod jpeg;
mod load;
mod picture;
mod stream;
mod undistort;

mod index;

mod overlap;
mod scene_depth;
mod select;
mod windows;

mod write;

pub use camera_row::CameraRule;
pub use chunk::{ChunkRule, list_chunks, open_chunks};
pub use colmap::open_colmap;
pub use dataset::{Dataset, DepthFile, DepthPercentiles, Dropped, Format, Frame, ImageSource};
pub use dl3dv::{Dl3dvRule, list_dl3dv, open_dl3dv};
pub use error::{Error, FormatRule, Place, PoseRule, Result, TransformsRule};
pub use gs_scene::{Distortion, Lens, LensModel};
pub use index::{EvaluationIndex, IndexRule, Window, read_index, write_index};
pub use jpeg::JpegRule;
pub use nerfstudio::open_nerfstudio;
pub use open::{Scenes, Unposed, open, open_all};
pub use overlap::Overlaps;
pub use picture::decode_picture;
pub use points::{Observation, ScenePoint};
pub use re10k::{Re10kRule, list_re10k, open_re10k};
pub use replica::open_replica;
pub use scannet::open_scannet;
pub use scene_depth::{SceneDepth, estimate_scene_depth};
pub use scene_list::{SceneEntry, SceneList};
pub use select::{Selection, select_views};
pub use stream::ViewStream;
pub use tum::{open_tum, open_tum_within};
pub use windows::{windows_along, windows_around};
pub use write::{DatasetWriter, Layout, PictureFormat, PosedFrame, Staging, WriteRule, Written, write_posed};

pub use tensor_files::TorchRule;
