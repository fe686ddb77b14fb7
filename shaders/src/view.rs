//! How a view goes through the passes: buffers with their sizes, and commands in order. The one place that says so: hosts in Rust
//! and in a browser carry out the same description.

use crate::{
    BIN, Features, Frame, ITEMS, N_COUNTERS, N_PAIRS, NOWHERE, PROJECT, Pass, RASTERIZE_ELLIPSOIDS,
    RASTERIZE_FORWARD, SCAN, SORT, SORT_DIGIT_BITS, Splat, Surface, TILE_RANGES, WORKGROUP,
};
use serde::Serialize;

/// Most workgroups along one dimension of a dispatch, by WebGPU's defaults.
pub const GRID_MAX: u32 = 65_535;

/// Numbers that a workgroup of `scan` or `sort` takes.
const BLOCK: u32 = WORKGROUP * ITEMS;

/// Bits of a depth key: the sign is set only in keys of what is culled.
const DEPTH_BITS: u32 = u32::BITS;

/// A number that a host knows of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Count {
    /// One.
    One,
    /// Gaussians of the scene.
    Gaussians,
    /// Pairs of Gaussian and tile for which there is room.
    Pairs,
    /// Pixels of the picture.
    Pixels,
    /// Tiles of the picture.
    Tiles,
}

/// A step of a calculation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Operation {
    /// Adds.
    Plus(u32),
    /// Multiplies.
    Times(u32),
    /// Divides, rounded up.
    DividedBy(u32),
}

/// A whole number that follows from a [`Count`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Amount {
    /// Where the calculation starts.
    pub of: Count,
    /// Its steps, in order.
    pub then: Vec<Operation>,
}

/// The counts of one view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Gaussians of the scene.
    pub gaussians: u32,
    /// Pairs of Gaussian and tile for which there is room.
    pub pairs: u32,
    /// Pixels of the picture.
    pub pixels: u32,
    /// Tiles of the picture.
    pub tiles: u32,
}

impl Counts {
    /// The value of a count.
    #[must_use]
    pub fn get(&self, count: Count) -> u32 {
        match count {
            Count::One => 1,
            Count::Gaussians => self.gaussians,
            Count::Pairs => self.pairs,
            Count::Pixels => self.pixels,
            Count::Tiles => self.tiles,
        }
    }
}

impl Amount {
    /// The value in a view.
    #[must_use]
    pub fn value(&self, counts: &Counts) -> u64 {
        self.then.iter().fold(u64::from(counts.get(self.of)), |value, step| match *step {
            Operation::Plus(n) => value + u64::from(n),
            Operation::Times(n) => value * u64::from(n),
            Operation::DividedBy(n) => value.div_ceil(u64::from(n)),
        })
    }

    fn and(&self, step: Operation) -> Self {
        Self { of: self.of, then: self.then.iter().copied().chain([step]).collect() }
    }

    fn plus(&self, n: u32) -> Self {
        self.and(Operation::Plus(n))
    }

    fn times(&self, n: u32) -> Self {
        self.and(Operation::Times(n))
    }

    fn divided_by(&self, n: u32) -> Self {
        self.and(Operation::DividedBy(n))
    }
}

impl From<Count> for Amount {
    fn from(count: Count) -> Self {
        Self { of: count, then: Vec::new() }
    }
}

/// Where the contents of a buffer come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The host writes it for every view: the uniform [`Frame`].
    Frame,
    /// The host writes it once for a scene.
    Scene,
    /// The passes write it.
    Passes,
}

/// A buffer of a view.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Buffer {
    /// Name, by which commands refer to the buffer.
    pub name: &'static str,
    /// Where its contents come from.
    pub source: Source,
    /// Rows; a buffer has room for at least one, because a pass cannot bind an empty array of structs.
    pub rows: Amount,
    /// Bytes of a row.
    pub row: usize,
}

impl Buffer {
    /// Bytes in a view with these counts.
    #[must_use]
    pub fn bytes(&self, counts: &Counts) -> u64 {
        self.rows.value(counts).max(1) * self.row as u64
    }
}

/// What is bound.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Argument {
    /// The buffer of that name.
    Buffer(&'static str),
    /// A uniform of four words.
    Words([Word; 4]),
}

/// A word of a small uniform.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// Known.
    Is(u32),
    /// Calculated.
    Amount(Amount),
}

/// Workgroups of a dispatch.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Groups {
    /// So many, folded into two dimensions where they exceed [`GRID_MAX`].
    Folded(Amount),
    /// One for every tile, in columns and rows.
    Tiles,
}

/// What a host does.
#[derive(Debug, Clone)]
pub enum Action {
    /// Fills a buffer with zeros.
    Clear(&'static str),
    /// Runs an entry point.
    Dispatch {
        /// The pass.
        pass: &'static Pass,
        /// Name of the entry point.
        entry_point: &'static str,
        /// What is bound, by number; none where the entry point does not use it.
        arguments: Vec<Option<Argument>>,
        /// Workgroups.
        groups: Groups,
    },
    /// Exchanges the names of two buffers.
    Swap(&'static str, &'static str),
}

/// A command of a view.
#[derive(Debug, Clone)]
pub struct Command {
    /// What the command does.
    pub action: Action,
    /// The command is left out where the number of tiles has no bit at this place or above: keys have no more digits.
    pub tile_bit: Option<u32>,
}

/// What a view draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawing {
    /// The Gaussians, blended.
    Blended,
    /// The same, and where each pixel ended: what the backward passes need.
    Recorded,
    /// The Gaussians as solid ellipsoids.
    Ellipsoids,
}

/// The buffers and commands of a view.
#[derive(Debug, Clone)]
pub struct View {
    /// What the passes are specialised for.
    pub features: Features,
    /// The buffers.
    pub buffers: Vec<Buffer>,
    /// The commands, in order.
    pub commands: Vec<Command>,
}

impl View {
    /// How a scene becomes a picture, which is in the buffer `pixels` afterwards.
    #[must_use]
    pub fn new(features: Features, drawing: Drawing) -> Self {
        let mut view = Self { features, buffers: Vec::new(), commands: Vec::new() };
        let solid = drawing == Drawing::Ellipsoids;
        view.list_buffers(solid, drawing == Drawing::Recorded);
        view.push(Action::Clear("counters"));
        let gaussians = Amount::from(Count::Gaussians);
        view.dispatch(
            &PROJECT,
            if solid { "project_ellipsoids" } else { "project" },
            &["frame", "geometry", "sh", "splats", "depth_keys", "order", "counters", "surfaces"],
            gaussians.divided_by(WORKGROUP),
        );
        view.sort(&DEPTH_SORT, &gaussians, NOWHERE);
        view.bin();
        view.sort(&TILE_SORT, &Count::Pairs.into(), N_PAIRS);
        view.push(Action::Clear("ranges"));
        view.dispatch(
            &TILE_RANGES,
            "tile_ranges",
            &["frame", "counters", "pair_tiles", "ranges"],
            Amount::from(Count::Pairs).divided_by(WORKGROUP),
        );
        let (pass, entry_point, names) = match drawing {
            Drawing::Blended => (&RASTERIZE_FORWARD, "rasterize_forward", RASTERIZE),
            Drawing::Recorded => (&RASTERIZE_FORWARD, "rasterize_forward_train", RASTERIZE),
            Drawing::Ellipsoids => (&RASTERIZE_ELLIPSOIDS, "rasterize_ellipsoids", RASTERIZE_SOLID),
        };
        view.dispatch_in(pass, entry_point, &names, Groups::Tiles);
        view
    }

    fn list_buffers(&mut self, solid: bool, recorded: bool) {
        let gaussians = Amount::from(Count::Gaussians);
        let (pairs, pixels) = (Amount::from(Count::Pairs), Amount::from(Count::Pixels));
        let buffer = |name, source, rows: &Amount, row| Buffer { name, source, rows: rows.clone(), row };
        let one = Amount::from(Count::One);
        let sh = 3 * (self.features.sh_degree as usize + 1).pow(2) * WORD;
        let numbers = if solid || self.features.depth { 6 } else { 4 };
        self.buffers = vec![
            buffer("frame", Source::Frame, &one, size_of::<Frame>()),
            buffer("geometry", Source::Scene, &gaussians, crate::GEOMETRY * WORD),
            buffer("sh", Source::Scene, &gaussians, sh),
            buffer("splats", Source::Passes, &gaussians, size_of::<Splat>()),
            buffer("counters", Source::Passes, &one, N_COUNTERS * WORD),
            buffer("offsets", Source::Passes, &gaussians.plus(1), WORD),
            buffer("offsets_sums", Source::Passes, &gaussians.plus(1).divided_by(BLOCK), WORD),
            buffer("pair_splats", Source::Passes, &pairs, WORD),
            buffer("ranges", Source::Passes, &Count::Tiles.into(), 2 * WORD),
            buffer("pixels", Source::Passes, &pixels, numbers * WORD),
        ];
        for (sort, n) in [(&DEPTH_SORT, &gaussians), (&TILE_SORT, &pairs)] {
            let histogram = histogram_length(n);
            for name in [sort.keys, sort.values, sort.keys_out, sort.values_out] {
                self.buffers.push(buffer(name, Source::Passes, n, WORD));
            }
            self.buffers.push(buffer(sort.histogram, Source::Passes, &histogram, WORD));
            self.buffers.push(buffer(sort.sums, Source::Passes, &histogram.divided_by(BLOCK), WORD));
        }
        if solid {
            self.buffers.push(buffer("surfaces", Source::Passes, &gaussians, size_of::<Surface>()));
        }
        if recorded {
            self.buffers.push(buffer("ends", Source::Passes, &pixels, WORD));
        }
    }

    fn push(&mut self, action: Action) {
        self.commands.push(Command { action, tile_bit: None });
    }

    fn dispatch(
        &mut self,
        pass: &'static Pass,
        entry_point: &'static str,
        names: &[&'static str],
        n: Amount,
    ) {
        self.dispatch_in(pass, entry_point, names, Groups::Folded(n));
    }

    fn dispatch_in(
        &mut self,
        pass: &'static Pass,
        entry_point: &'static str,
        names: &[&'static str],
        groups: Groups,
    ) {
        let arguments = names.iter().map(|name| Argument::Buffer(name)).collect();
        self.run(pass, entry_point, arguments, groups);
    }

    /// Adds a dispatch that binds what the entry point uses of `arguments`.
    fn run(
        &mut self,
        pass: &'static Pass,
        entry_point: &'static str,
        arguments: Vec<Argument>,
        groups: Groups,
    ) {
        let used = pass.entry_point(entry_point).expect("a view names entry points of the table").bindings;
        let arguments = arguments.into_iter().enumerate();
        let arguments =
            arguments.map(|(number, argument)| used.contains(&(number as u32)).then_some(argument)).collect();
        self.push(Action::Dispatch { pass, entry_point, arguments, groups });
    }

    /// Pairs of Gaussian and tile, near to far.
    fn bin(&mut self) {
        const NAMES: [&str; 8] =
            ["frame", "splats", "order", "counters", "offsets", "pair_tiles", "pair_index", "pair_splats"];
        // One more than there are Gaussians: the last offset is the number of pairs.
        let n = Amount::from(Count::Gaussians).plus(1);
        self.dispatch(&BIN, "bin_count", &NAMES, n.divided_by(WORKGROUP));
        self.scan("offsets", "offsets_sums", &n, N_PAIRS);
        self.dispatch(&BIN, "bin_emit", &NAMES, n.divided_by(WORKGROUP));
    }

    /// Replaces the first `n` values by what precedes each; the total goes to a slot of the counters, or nowhere.
    fn scan(&mut self, values: &'static str, sums: &'static str, n: &Amount, total: u32) {
        let blocks = n.divided_by(BLOCK);
        let words = [Word::Amount(n.clone()), Word::Amount(blocks.clone()), Word::Is(total), Word::Is(0)];
        let arguments: Vec<Argument> = [Argument::Words(words)]
            .into_iter()
            .chain([values, sums, "counters"].map(Argument::Buffer))
            .collect();
        for (entry_point, groups) in
            [("scan_reduce", &blocks), ("scan_sums", &Count::One.into()), ("scan_apply", &blocks)]
        {
            self.run(&SCAN, entry_point, arguments.clone(), Groups::Folded(groups.clone()));
        }
    }

    /// Sorts keys with their values, digit by digit; equal keys keep their order. Their number is in slot `count` of the
    /// counters, or all that there is room for.
    fn sort(&mut self, sort: &Sorting, n: &Amount, count: u32) {
        let blocks = n.divided_by(BLOCK);
        for shift in (0..sort.bits).step_by(SORT_DIGIT_BITS as usize) {
            let first = self.commands.len();
            let words =
                [Word::Amount(n.clone()), Word::Amount(blocks.clone()), Word::Is(count), Word::Is(shift)];
            let names = ["counters", sort.keys, sort.values, sort.histogram, sort.keys_out, sort.values_out];
            let arguments: Vec<Argument> =
                [Argument::Words(words)].into_iter().chain(names.map(Argument::Buffer)).collect();
            self.run(&SORT, "sort_histogram", arguments.clone(), Groups::Folded(blocks.clone()));
            self.scan(sort.histogram, sort.sums, &histogram_length(n), NOWHERE);
            self.run(&SORT, "sort_scatter", arguments, Groups::Folded(blocks.clone()));
            self.push(Action::Swap(sort.keys, sort.keys_out));
            self.push(Action::Swap(sort.values, sort.values_out));
            if sort.by_tile {
                // Tiles are numbered from 0; the number after the last marks a pair that does not exist.
                self.commands[first..].iter_mut().for_each(|command| command.tile_bit = Some(shift));
            }
        }
    }
}

const WORD: usize = size_of::<u32>();

/// Bindings of `rasterize_forward`.
const RASTERIZE: [&str; 7] = ["frame", "splats", "pair_splats", "pair_index", "ranges", "pixels", "ends"];
/// Bindings of `rasterize_ellipsoids`.
const RASTERIZE_SOLID: [&str; 7] =
    ["frame", "splats", "pair_splats", "pair_index", "ranges", "surfaces", "pixels"];

/// Names of the buffers of a sort.
struct Sorting {
    keys: &'static str,
    values: &'static str,
    keys_out: &'static str,
    values_out: &'static str,
    histogram: &'static str,
    sums: &'static str,
    bits: u32,
    by_tile: bool,
}

const DEPTH_SORT: Sorting = Sorting {
    keys: "depth_keys",
    values: "order",
    keys_out: "depth_keys_out",
    values_out: "order_out",
    histogram: "depth_histogram",
    sums: "depth_sums",
    bits: DEPTH_BITS,
    by_tile: false,
};

const TILE_SORT: Sorting = Sorting {
    keys: "pair_tiles",
    values: "pair_index",
    keys_out: "pair_tiles_out",
    values_out: "pair_index_out",
    histogram: "pair_histogram",
    sums: "pair_sums",
    bits: u32::BITS,
    by_tile: true,
};

/// Numbers in the histogram of a sort of `n` keys.
fn histogram_length(n: &Amount) -> Amount {
    n.divided_by(BLOCK).times(1 << SORT_DIGIT_BITS)
}

/// A one-dimensional grid of `n` workgroups, folded where it is longer than a dimension may be.
#[must_use]
pub fn folded(n: u32) -> [u32; 2] {
    if n <= GRID_MAX { [n, 1] } else { [GRID_MAX, n.div_ceil(GRID_MAX)] }
}

impl Command {
    /// Whether the command is carried out in a view with so many tiles.
    #[must_use]
    pub fn applies(&self, tiles: u32) -> bool {
        self.tile_bit.is_none_or(|bit| tiles >> bit != 0)
    }
}
