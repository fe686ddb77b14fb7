#![doc = include_str!("../README.md")]

mod error;

mod check;
mod check_lights;
mod demo;
mod exr_files;
mod generate;
mod light;
mod material;
mod mesh;
mod noise;
mod photographs;
mod random;
mod read;
mod render;
mod replica;
mod scene;
mod shape;
mod stage;
mod texture;
mod trace;
mod trajectory;
mod varied;

pub use demo::{demo_cameras, demo_scene};
pub use error::{Error, MeshRule, Result};
pub use exr_files::{write_exr_depth, write_exr_rgb};
pub use generate::{Kind, generate, generate_any, generate_dwelling, generate_in_the_wild};
pub use light::{Lamp, Occlusion, Sky, Sun};
pub use material::{Finish, Material, Pattern, Rgb};
pub use mesh::{Mesh, MeshSource};
pub use photographs::{Aperture, Exposure, Photographs, SensorNoise};
pub use read::{read_photographs, read_scene, write_scene};
pub use render::{Photograph, RayCounts, photograph, photograph_with_light, render_counted, render_view};
pub use replica::replica_scene;
pub use scene::{Primitive, SCENE_VERSION, Scene, Shape};
pub use trace::{Dropped, Omission, Traced};
pub use trajectory::{Trajectory, lens};
pub use varied::{varied_cameras, varied_scene};
