//! The passes: sources, entry points, bindings and overrides. A test compares every fact here with the shaders.

use crate::Features;

/// Side of a tile, pixels.
pub const TILE: u32 = 16;
/// Invocations of a workgroup in passes over lists. WebGPU clears workgroup memory before every workgroup, and a software adapter
/// does so for each of its invocations: large workgroups cost more there than they save.
pub const WORKGROUP: u32 = 64;
/// Numbers that an invocation of `scan` or `sort` takes. `sort` counts them in four bits: less than 16.
pub const ITEMS: u32 = 8;
/// Bits that one step of `sort` sorts by.
pub const SORT_DIGIT_BITS: u32 = 4;

/// How a shader uses a binding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// A uniform buffer.
    Uniform,
    /// A storage buffer that is only read.
    Read,
    /// A storage buffer that is read and written.
    ReadWrite,
}

/// A buffer that a pass binds; its number is its place in [`Pass::bindings`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Binding {
    /// Name of the variable.
    pub name: &'static str,
    /// How it is used.
    pub access: Access,
}

/// A function that can be dispatched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EntryPoint {
    /// Name of the function.
    pub name: &'static str,
    /// Numbers of the bindings that it uses.
    pub bindings: &'static [u32],
}

/// One shader file and what it needs.
#[derive(Debug)]
pub struct Pass {
    /// Name of the pass and of its file.
    pub name: &'static str,
    /// The file, followed by the common files that it needs.
    files: &'static [&'static str],
    /// Functions that can be dispatched.
    pub entry_points: &'static [EntryPoint],
    /// Buffers, all in group 0.
    pub bindings: &'static [Binding],
    /// Names of the overrides of the module.
    overrides: &'static [&'static str],
}

impl Pass {
    /// The text of the module, as it is compiled.
    #[must_use]
    pub fn source(&self) -> String {
        self.files.join("\n")
    }

    /// The entry point of that name.
    #[must_use]
    pub fn entry_point(&self, name: &str) -> Option<&EntryPoint> {
        self.entry_points.iter().find(|entry_point| entry_point.name == name)
    }

    /// Values of all overrides of the module.
    ///
    /// # Panics
    /// If the table of passes names an override that nobody knows.
    #[must_use]
    pub fn constants(&self, features: Features) -> Vec<(&'static str, f64)> {
        let value = |name: &str| match name {
            "TILE" => f64::from(TILE),
            "WORKGROUP" => f64::from(WORKGROUP),
            "ITEMS" => f64::from(ITEMS),
            "SH_DEGREE" => f64::from(features.sh_degree),
            "ANTIALIAS" => f64::from(u8::from(features.antialias)),
            "DEPTH" => f64::from(u8::from(features.depth)),
            other => panic!("override {other} of pass {} has no value", self.name),
        };
        self.overrides.iter().map(|&name| (name, value(name))).collect()
    }
}

const FRAME: &str = include_str!("../common/frame.wgsl");
const TWO_FLOAT: &str = include_str!("../common/two_float.wgsl");
const GRID: &str = include_str!("../common/grid.wgsl");
const EWA: &str = include_str!("../common/ewa.wgsl");
const SH: &str = include_str!("../common/sh.wgsl");
const ALPHA: &str = include_str!("../common/alpha.wgsl");

const fn uniform(name: &'static str) -> Binding {
    Binding { name, access: Access::Uniform }
}

const fn read(name: &'static str) -> Binding {
    Binding { name, access: Access::Read }
}

const fn read_write(name: &'static str) -> Binding {
    Binding { name, access: Access::ReadWrite }
}

/// Gaussians to footprints.
pub const PROJECT: Pass = Pass {
    name: "project",
    files: &[include_str!("../project.wgsl"), FRAME, TWO_FLOAT, EWA, SH, GRID],
    entry_points: &[
        EntryPoint { name: "project", bindings: &[0, 1, 2, 3, 4, 5, 6] },
        EntryPoint { name: "project_ellipsoids", bindings: &[0, 1, 2, 3, 4, 5, 6, 7] },
    ],
    bindings: &[
        uniform("frame"),
        read("geometry"),
        read("sh"),
        read_write("splats"),
        read_write("depth_keys"),
        read_write("order"),
        read_write("counters"),
        read_write("surfaces"),
    ],
    overrides: &["WORKGROUP", "TILE", "SH_DEGREE", "ANTIALIAS"],
};

/// Prefix sums.
pub const SCAN: Pass = Pass {
    name: "scan",
    files: &[include_str!("../scan.wgsl"), FRAME],
    entry_points: &[
        EntryPoint { name: "scan_reduce", bindings: &[0, 1, 2] },
        EntryPoint { name: "scan_sums", bindings: &[0, 2, 3] },
        EntryPoint { name: "scan_apply", bindings: &[0, 1, 2] },
    ],
    bindings: &[uniform("scan"), read_write("values"), read_write("sums"), read_write("counters")],
    overrides: &["WORKGROUP", "ITEMS"],
};

/// One digit of a stable radix sort.
pub const SORT: Pass = Pass {
    name: "sort",
    files: &[include_str!("../sort.wgsl"), FRAME],
    entry_points: &[
        EntryPoint { name: "sort_histogram", bindings: &[0, 1, 2, 4] },
        EntryPoint { name: "sort_scatter", bindings: &[0, 1, 2, 3, 4, 5, 6] },
    ],
    bindings: &[
        uniform("step"),
        read("counters"),
        read("keys_in"),
        read("values_in"),
        read_write("histogram"),
        read_write("keys_out"),
        read_write("values_out"),
    ],
    overrides: &["WORKGROUP", "ITEMS"],
};

/// Pairs of Gaussian and tile.
pub const BIN: Pass = Pass {
    name: "bin",
    files: &[include_str!("../bin.wgsl"), FRAME, GRID],
    entry_points: &[
        EntryPoint { name: "bin_count", bindings: &[0, 1, 2, 3, 4] },
        EntryPoint { name: "bin_emit", bindings: &[0, 1, 2, 3, 4, 5, 6, 7] },
    ],
    bindings: &[
        uniform("frame"),
        read("splats"),
        read("order"),
        read("counters"),
        read_write("offsets"),
        read_write("pair_tiles"),
        read_write("pair_index"),
        read_write("pair_splats"),
    ],
    overrides: &["WORKGROUP", "TILE"],
};

/// Where each tile's pairs lie.
pub const TILE_RANGES: Pass = Pass {
    name: "tile_ranges",
    files: &[include_str!("../tile_ranges.wgsl"), FRAME],
    entry_points: &[EntryPoint { name: "tile_ranges", bindings: &[0, 1, 2, 3] }],
    bindings: &[uniform("frame"), read("counters"), read("pair_tiles"), read_write("ranges")],
    overrides: &["WORKGROUP"],
};

/// Compositing.
pub const RASTERIZE_FORWARD: Pass = Pass {
    name: "rasterize_forward",
    files: &[include_str!("../rasterize_forward.wgsl"), FRAME, TWO_FLOAT, ALPHA, GRID],
    entry_points: &[
        EntryPoint { name: "rasterize_forward", bindings: &[0, 1, 2, 3, 4, 5] },
        EntryPoint { name: "rasterize_forward_train", bindings: &[0, 1, 2, 3, 4, 5, 6] },
    ],
    bindings: &[
        uniform("frame"),
        read("splats"),
        read("pair_splats"),
        read("pair_index"),
        read("ranges"),
        read_write("pixels"),
        read_write("ends"),
    ],
    overrides: &["TILE", "DEPTH"],
};

/// Opaque ellipsoids instead of compositing.
pub const RASTERIZE_ELLIPSOIDS: Pass = Pass {
    name: "rasterize_ellipsoids",
    files: &[include_str!("../rasterize_ellipsoids.wgsl"), FRAME, TWO_FLOAT, ALPHA, GRID],
    entry_points: &[EntryPoint { name: "rasterize_ellipsoids", bindings: &[0, 1, 2, 3, 4, 5, 6] }],
    bindings: &[
        uniform("frame"),
        read("splats"),
        read("pair_splats"),
        read("pair_index"),
        read("ranges"),
        read("surfaces"),
        read_write("pixels"),
    ],
    overrides: &["TILE"],
};

/// Derivatives of compositing.
pub const RASTERIZE_BACKWARD: Pass = Pass {
    name: "rasterize_backward",
    files: &[include_str!("../rasterize_backward.wgsl"), FRAME, TWO_FLOAT, ALPHA, GRID],
    entry_points: &[EntryPoint { name: "rasterize_backward", bindings: &[0, 1, 2, 3, 4, 5, 6, 7] }],
    bindings: &[
        uniform("frame"),
        read("splats"),
        read("pair_splats"),
        read("pair_index"),
        read("ranges"),
        read("ends"),
        read("pixel_grads"),
        read_write("pair_grads"),
    ],
    overrides: &["TILE", "DEPTH"],
};

/// Derivatives of the projection.
pub const PROJECT_BACKWARD: Pass = Pass {
    name: "project_backward",
    files: &[include_str!("../project_backward.wgsl"), FRAME, TWO_FLOAT, EWA, SH],
    entry_points: &[EntryPoint { name: "project_backward", bindings: &[0, 1, 2, 3, 4, 5, 6, 7, 8] }],
    bindings: &[
        uniform("frame"),
        read("geometry"),
        read("sh"),
        read("order"),
        read("offsets"),
        read("pair_grads"),
        read_write("grad_geometry"),
        read_write("grad_sh"),
        read_write("pose_sums"),
    ],
    overrides: &["WORKGROUP", "SH_DEGREE", "ANTIALIAS"],
};

/// Every pass, in the order in which a view goes through them.
pub const PASSES: [&Pass; 9] = [
    &PROJECT,
    &SORT,
    &SCAN,
    &BIN,
    &TILE_RANGES,
    &RASTERIZE_FORWARD,
    &RASTERIZE_ELLIPSOIDS,
    &RASTERIZE_BACKWARD,
    &PROJECT_BACKWARD,
];
