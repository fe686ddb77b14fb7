#![doc = include_str!("../README.md")]

mod error;
mod journal;
mod shard;

mod measure;
mod pictures;
mod run;
mod sweep;

mod front;
mod share;
mod summary;

mod breakdown;
mod document;
mod page;
mod paper;
mod plot;

pub use document::{comparison_markdown, csv, points_table, share_table, stated, statements, to_markdown};
pub use error::SweepError;
pub use front::{Knee, pareto_front};
pub use journal::{Entry, Failed, Header, Journal, Shards, journal_name};
pub use measure::{MEASURED_AS, Measured, Views};
pub use page::tradeoff_page;
pub use paper::{Compared, Comparison, PaperTable};
pub use pictures::Pictures;
pub use plot::tradeoff_plots;
pub use run::{Progress, Sweep};
pub use shard::Shard;
pub use share::{Reached, reaches};
pub use summary::{Row, Share, Summary};
pub use sweep::{Axis, Cuts, Extent, Label, Point, points};
