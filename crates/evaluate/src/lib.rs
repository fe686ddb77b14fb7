#![doc = include_str!("../README.md")]

mod error;

mod method;
mod render;
mod window;

mod figures;
mod protocol;
mod recipe;

pub use error::{Error, Result};
pub use figures::{
    CurvePoint, Figures, MeanRow, Seconds, Spread, Target, WindowFigures, WindowRow, deviation, mean, means,
    median, optional_mean,
};
pub use image_metrics::Lpips;
pub use method::{Corrected, Method, Refinement};
pub use protocol::{Baselines, Evaluation, Event, NearestView, PROTOCOL, evaluate};
pub use recipe::{Machine, Recipe, peak_rss_bytes, restart_peak_rss};
pub use render::{Rendered, render_as, render_ellipsoids, render_view};
pub use window::{Outcome, Runner, Step, Stopwatch, compare, lpips_of};
