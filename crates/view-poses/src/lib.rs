#![doc = include_str!("../README.md")]

mod error;

mod exif_data;
mod photographs;
mod sharpness;
mod video;

mod engine;

mod colmap;
#[cfg(feature = "openmvg")]
mod openmvg;
mod program;

mod focal;
mod level;
mod pinhole;
mod turned;
mod verdict;

mod estimate;

pub use colmap::{Colmap, Mapper};
pub use engine::{Engine, Pose, Solution, Step, Task};
pub use error::{Error, LevellingFault, Result};
pub use estimate::{
    Attempt, EngineChoice, Estimate, NotUsed, RECORD, Settings, Source, estimate_poses, is_made_from,
};
pub use level::{Levelling, Up};
#[cfg(feature = "openmvg")]
pub use openmvg::OpenMvg;
pub use photographs::{
    CameraGroup, Listed, MOST, Photograph, Photographs, list_photographs, prepare_photographs,
};
pub use verdict::{Doubt, Verdict};
pub use video::{Cut, is_video};
