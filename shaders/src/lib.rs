#![doc = include_str!("../README.md")]

mod abi;
mod features;
mod passes;
mod table;
mod view;

pub use abi::{
    AMBIENT, CULLED, Frame, GEOMETRY, LEVEL_SLACK, N_COUNTERS, N_PAIRS, NOWHERE, PAIR_GRADS, PIXEL_GRADS,
    POSE_SUMS, REACH_SLACK, REJECTED, SIGMA_MAX, Scan, Sort, Splat, Surface, VISIBLE,
};
pub use features::Features;
pub use passes::{
    Access, BIN, Binding, EntryPoint, ITEMS, PASSES, PROJECT, PROJECT_BACKWARD, Pass, RASTERIZE_BACKWARD,
    RASTERIZE_ELLIPSOIDS, RASTERIZE_FORWARD, SCAN, SORT, SORT_DIGIT_BITS, TILE, TILE_RANGES, WORKGROUP,
};
pub use table::Table;
pub use view::{
    Action, Amount, Argument, Buffer, Command, Count, Counts, Drawing, GRID_MAX, Groups, Operation, Source,
    View, Word, folded,
};
