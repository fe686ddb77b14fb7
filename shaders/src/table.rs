//! Everything that a host in another language needs to draw a view, as one value that serialises to JSON.

use crate::view::{Action, Argument, Buffer, GRID_MAX, Groups, View};
use crate::{Access, Frame, GEOMETRY, N_COUNTERS, N_PAIRS, Pass, REJECTED, TILE, VISIBLE};
use serde::Serialize;
use std::collections::BTreeMap;
use std::mem::offset_of;

/// The shaders, their pipelines, and views as commands. Numbers of bindings, overrides, and offsets of structs are in
/// it; a host adds nothing but its device.
#[derive(Debug, Serialize)]
pub struct Table {
    /// Texts of the shader modules, by the name of the pass.
    modules: BTreeMap<&'static str, String>,
    /// Entry points with their overrides.
    pipelines: Vec<Pipeline>,
    /// Views, by name.
    views: BTreeMap<String, ViewTable>,
    frame: FrameTable,
    counters: Slots,
    /// Numbers of a row of the buffer `geometry`.
    geometry: usize,
    /// Side of a tile, pixels.
    tile: u32,
    /// Most workgroups along one dimension of a dispatch.
    grid_max: u32,
}

/// An entry point that is specialised.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Pipeline {
    module: &'static str,
    entry_point: &'static str,
    /// Values of the overrides, by name.
    constants: BTreeMap<&'static str, f64>,
    /// Bindings of group 0 by number.
    bindings: BTreeMap<u32, &'static str>,
}

#[derive(Debug, Serialize)]
struct ViewTable {
    buffers: Vec<Buffer>,
    commands: Vec<CommandTable>,
}

#[derive(Debug, Serialize)]
struct CommandTable {
    #[serde(skip_serializing_if = "Option::is_none")]
    tile_bit: Option<u32>,
    #[serde(flatten)]
    action: ActionTable,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum ActionTable {
    Clear(&'static str),
    Swap(&'static str, &'static str),
    Dispatch { pipeline: usize, arguments: BTreeMap<u32, Argument>, groups: Groups },
}

/// The uniform that the host writes for every view.
#[derive(Debug, Serialize)]
struct FrameTable {
    bytes: usize,
    fields: BTreeMap<&'static str, Field>,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Field {
    offset: usize,
    #[serde(rename = "type")]
    kind: &'static str,
}

/// Slots of the buffer `counters`.
#[derive(Debug, Serialize)]
struct Slots {
    visible: u32,
    rejected: u32,
    pairs: u32,
    all: usize,
}

impl Table {
    /// The table of some views, each with its name.
    #[must_use]
    pub fn new(views: Vec<(String, View)>) -> Self {
        let mut table = Self {
            modules: BTreeMap::new(),
            pipelines: Vec::new(),
            views: BTreeMap::new(),
            frame: FrameTable { bytes: size_of::<Frame>(), fields: frame_fields() },
            counters: Slots { visible: VISIBLE, rejected: REJECTED, pairs: N_PAIRS, all: N_COUNTERS },
            geometry: GEOMETRY,
            tile: TILE,
            grid_max: GRID_MAX,
        };
        for (name, view) in views {
            let commands = view.commands.iter().map(|command| CommandTable {
                tile_bit: command.tile_bit,
                action: table.action(&view, &command.action),
            });
            let commands = commands.collect();
            table.views.insert(name, ViewTable { buffers: view.buffers, commands });
        }
        table
    }

    fn action(&mut self, view: &View, action: &Action) -> ActionTable {
        match action {
            Action::Clear(name) => ActionTable::Clear(name),
            Action::Swap(a, b) => ActionTable::Swap(a, b),
            Action::Dispatch { pass, entry_point, arguments, groups } => {
                let numbered = arguments.iter().enumerate();
                let arguments = numbered
                    .filter_map(|(number, argument)| Some((number as u32, argument.clone()?)))
                    .collect();
                let pipeline = self.pipeline(view, pass, entry_point);
                ActionTable::Dispatch { pipeline, arguments, groups: groups.clone() }
            }
        }
    }

    /// The place of a pipeline, which is added if it is new.
    fn pipeline(&mut self, view: &View, pass: &'static Pass, entry_point: &'static str) -> usize {
        let used = pass.entry_point(entry_point).expect("a view names entry points of the table").bindings;
        let constants: BTreeMap<_, _> = pass.constants(view.features).into_iter().collect();
        let pipeline = Pipeline {
            module: pass.name,
            entry_point,
            constants,
            bindings: used
                .iter()
                .map(|&number| match pass.bindings[number as usize].access {
                    Access::Uniform => (number, "uniform"),
                    Access::Read => (number, "read-only-storage"),
                    Access::ReadWrite => (number, "storage"),
                })
                .collect(),
        };
        if let Some(place) = self.pipelines.iter().position(|other| *other == pipeline) {
            return place;
        }
        self.modules.entry(pass.name).or_insert_with(|| pass.source());
        self.pipelines.push(pipeline);
        self.pipelines.len() - 1
    }
}

/// Offset and type of every field of [`Frame`].
fn frame_fields() -> BTreeMap<&'static str, Field> {
    macro_rules! fields {
        ($($name:ident: $kind:literal),* $(,)?) => {
            [$((stringify!($name), Field { offset: offset_of!(Frame, $name), kind: $kind })),*]
        };
    }
    BTreeMap::from(fields![
        pose: "f32",
        pose_low: "f32",
        position: "f32",
        n_gaussians: "u32",
        position_low: "f32",
        near: "f32",
        focal: "f32",
        focal_low: "f32",
        centre: "f32",
        centre_low: "f32",
        slope_min: "f32",
        slope_max: "f32",
        size: "u32",
        tiles: "u32",
        background: "f32",
        far: "f32",
        eps2d: "f32",
        alpha_max: "f32",
        alpha_min: "f32",
        transmittance_min: "f32",
        compensation_min: "f32",
        pair_capacity: "u32",
        zero: "u32",
        ellipsoid_sigma: "f32",
    ])
}
