#![doc = include_str!("../README.md")]

mod error;

mod plan;
mod simulated;

mod geometry_cache;
mod method;
mod render;
mod window;

mod figures;
mod hash;
mod kept;
mod protocol;
mod recipe;
mod table;

mod chart;
mod colour;
mod labels;
mod page;
mod picture;
mod plot;
mod report;
mod training_plot;

pub mod tradeoff;

pub use error::{Error, Result};
pub use figures::{
    CurvePoint, Dropped, Figures, MeanRow, Seconds, Spread, Target, WindowFigures, WindowRow, means,
};
pub use geometry_cache::GeometryCache;
pub use hash::{file_sha256, hexadecimal};
pub use image_metrics::Lpips;
pub use kept::{Kept, KeptFault, KeptTensor, Stored, singles, write_kept};
pub use method::{Method, Refinement};
pub use picture::{DepthScale, ERROR_GAIN, Picture};
pub use plan::{ALONG_A_VIDEO, Choice, Plan, Reading, Windows};
pub use plot::refinement_plot;
pub use protocol::{Baselines, Evaluation, Event, NearestView, PROTOCOL, evaluate};
pub use recipe::{Machine, Recipe, peak_rss_bytes, restart_peak_rss};
pub use render::{Rendered, render_ellipsoids, render_view};
pub use report::{PictureLimits, Report};
pub use simulated::{SIMULATED_SIZE, SimulatedScene, simulated_window};
pub use table::{Table, count, decibel, figures_table, lpips_column, number};
pub use training_plot::training_plot;
pub use window::{Outcome, Step, Window, reconstruct_window, run_window};
