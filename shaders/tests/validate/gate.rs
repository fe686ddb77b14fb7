//! The naga gate: every pass is valid, keeps to the limits that WebGPU promises, and is what the table of passes says.

use gs_shaders::{Access, EntryPoint, Features, PASSES, Pass, SCAN, TILE_RANGES};
use naga::back::PipelineConstants;
use naga::back::pipeline_constants::process_overrides;
use naga::proc::Layouter;
use naga::valid::{Capabilities, GlobalUse, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, Module, ShaderStage, StorageAccess};
use std::collections::BTreeSet;

/// The default limits of WebGPU (W3C, section "Limits").
const STORAGE_BUFFERS: usize = 8;
const WORKGROUP_BYTES: u32 = 16384;
const INVOCATIONS: u32 = 256;
const WORKGROUP_DIMENSIONS: [u32; 3] = [256, 256, 64];

/// The module of a source text.
pub(crate) fn parse(source: &str) -> Result<Module, String> {
    naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))
}

fn validate(module: &Module) -> Result<ModuleInfo, String> {
    Validator::new(ValidationFlags::all(), Capabilities::default())
        .validate(module)
        .map_err(|error| error.emit_to_string(""))
}

fn holds(condition: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if condition { Ok(()) } else { Err(message()) }
}

/// What is wrong with a source that should be that of `pass`, if its overrides get the values of `constants`.
fn check(pass: &Pass, source: &str, constants: &[(&str, f64)]) -> Result<(), String> {
    let module = parse(source)?;
    let info = validate(&module)?;
    check_overrides(&module, constants)?;
    check_bindings(pass, &module)?;
    let found: Vec<&str> = module.entry_points.iter().map(|entry_point| entry_point.name.as_str()).collect();
    let expected: Vec<&str> = pass.entry_points.iter().map(|entry_point| entry_point.name).collect();
    holds(found == expected, || format!("entry points {found:?}, expected {expected:?}"))?;
    for entry_point in pass.entry_points {
        check_uses(entry_point, pass, &module, &info)?;
        check_specialised(entry_point.name, &module, &info, constants)
            .map_err(|error| format!("{}: {error}", entry_point.name))?;
    }
    Ok(())
}

/// Every override gets a value, none has another one.
fn check_overrides(module: &Module, constants: &[(&str, f64)]) -> Result<(), String> {
    let mut found = BTreeSet::new();
    for (_, declared) in module.overrides.iter() {
        // Sizes of arrays that are computed from overrides have no name.
        let Some(name) = declared.name.as_deref() else { continue };
        holds(declared.init.is_none() && declared.id.is_none(), || format!("override {name} has a default"))?;
        found.insert(name);
    }
    let expected: BTreeSet<&str> = constants.iter().map(|&(name, _)| name).collect();
    holds(found == expected, || format!("overrides {found:?}, expected {expected:?}"))
}

/// Bindings are those of the table, in group 0, numbered without gaps.
fn check_bindings(pass: &Pass, module: &Module) -> Result<(), String> {
    let mut found = Vec::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(place) = variable.binding else { continue };
        let name = variable.name.as_deref().unwrap_or_default();
        holds(place.group == 0, || format!("{name} is in group {}", place.group))?;
        let access = match variable.space {
            AddressSpace::Uniform => Access::Uniform,
            AddressSpace::Storage { access } if access == StorageAccess::LOAD => Access::Read,
            AddressSpace::Storage { .. } => Access::ReadWrite,
            other => return Err(format!("{name} is in {other:?}")),
        };
        found.push((place.binding, name, access));
    }
    let expected: Vec<_> =
        (0..).zip(pass.bindings).map(|(number, binding)| (number, binding.name, binding.access)).collect();
    holds(found == expected, || format!("bindings {found:?}, expected {expected:?}"))?;
    let order = |access| match access {
        Access::Uniform => 0,
        Access::Read => 1,
        Access::ReadWrite => 2,
    };
    let kinds: Vec<_> = pass.bindings.iter().map(|binding| order(binding.access)).collect();
    holds(kinds.is_sorted() && kinds.iter().filter(|&&kind| kind == 0).count() == 1, || {
        format!("one uniform, then what is read, then what is written: {kinds:?}")
    })
}

/// An entry point uses the bindings of the table, through functions too, and no more than a device must offer.
fn check_uses(
    entry_point: &EntryPoint,
    pass: &Pass,
    module: &Module,
    info: &ModuleInfo,
) -> Result<(), String> {
    let index = module.entry_points.iter().position(|found| found.name == entry_point.name);
    let uses = info.get_entry_point(index.expect("the names were compared"));
    let mut found = Vec::new();
    for (handle, variable) in module.global_variables.iter() {
        let Some(place) = variable.binding else { continue };
        let used: GlobalUse = uses[handle];
        if !used.is_empty() {
            found.push(place.binding);
        }
    }
    let EntryPoint { name, bindings } = *entry_point;
    holds(found == bindings, || format!("{name} uses bindings {found:?}, expected {bindings:?}"))?;
    let storage =
        found.iter().filter(|&&number| pass.bindings[number as usize].access != Access::Uniform).count();
    holds(storage <= STORAGE_BUFFERS, || format!("{name} uses {storage} storage buffers"))
}

/// With its overrides an entry point is still valid and keeps to the limits.
fn check_specialised(
    name: &str,
    module: &Module,
    info: &ModuleInfo,
    constants: &[(&str, f64)],
) -> Result<(), String> {
    let constants: PipelineConstants =
        constants.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
    let (module, _) = process_overrides(module, info, Some((ShaderStage::Compute, name)), &constants)
        .map_err(|error| error.to_string())?;
    let info = validate(&module)?;
    let index = module.entry_points.iter().position(|found| found.name == name);
    let index = index.ok_or("the entry point got lost")?;
    let size = module.entry_points[index].workgroup_size;
    holds(size.iter().zip(WORKGROUP_DIMENSIONS).all(|(&size, limit)| (1..=limit).contains(&size)), || {
        format!("workgroup size {size:?}")
    })?;
    let invocations: u32 = size.iter().product();
    holds(invocations <= INVOCATIONS, || format!("{invocations} invocations"))?;
    let mut layouter = Layouter::default();
    layouter.update(module.to_ctx()).map_err(|error| error.to_string())?;
    let uses = info.get_entry_point(index);
    let bytes: u32 = module
        .global_variables
        .iter()
        .filter(|&(handle, variable)| variable.space == AddressSpace::WorkGroup && !uses[handle].is_empty())
        .map(|(_, variable)| layouter[variable.ty].size.next_multiple_of(16))
        .sum();
    holds(bytes <= WORKGROUP_BYTES, || format!("{bytes} bytes of workgroup memory"))
}

#[test]
fn every_pass_is_what_the_table_says() {
    assert!(!PASSES.is_empty() && Features::all().count() == 16);
    for pass in PASSES {
        assert!(!pass.entry_points.is_empty(), "{}", pass.name);
        for features in Features::all() {
            check(pass, &pass.source(), &pass.constants(features))
                .unwrap_or_else(|error| panic!("{} {features:?}: {error}", pass.name));
        }
    }
}

#[test]
fn names_are_unique_and_found() {
    let mut names = BTreeSet::new();
    for pass in PASSES {
        for entry_point in pass.entry_points {
            assert!(names.insert(entry_point.name), "two entry points {}", entry_point.name);
            assert_eq!(pass.entry_point(entry_point.name), Some(entry_point));
        }
        assert_eq!(pass.entry_point("no_entry_point"), None);
    }
}

#[test]
fn the_gate_rejects() {
    let features = Features { sh_degree: 0, antialias: false, depth: false };
    let rejects = |pass: &Pass, from: &str, to: &str, expected: &str| {
        let source = pass.source().replace(from, to);
        assert_ne!(source, pass.source(), "{from} is in the shader");
        let error = check(pass, &source, &pass.constants(features)).expect_err(to);
        assert!(error.contains(expected), "{to}: {error}");
    };
    let ranges = |from, to, expected| rejects(&TILE_RANGES, from, to, expected);
    ranges("override WORKGROUP: u32;", "override WORKGROUP: u32 = 64;", "has a default");
    ranges("override WORKGROUP: u32;", "override WORKGROUP: u32;\noverride OTHER: u32;", "overrides");
    ranges("fn tile_ranges(", "fn tile_range(", "entry points");
    ranges("<storage, read> pair_tiles", "<storage, read_write> pair_tiles", "bindings");
    ranges("<storage, read_write> ranges", "<storage, read> ranges", "writing to this location");
    ranges("@binding(3)", "@binding(4)", "bindings");
    ranges("@group(0) @binding(3)", "@group(1) @binding(3)", "is in group 1");
    ranges("> pair_tiles:", "> pair_tile:", "no definition in scope");
    ranges("counters[N_PAIRS]", "7u", "uses bindings");
    ranges("workgroup_size(WORKGROUP)", "workgroup_size(WORKGROUP, 5)", "320 invocations");
    ranges("workgroup_size(WORKGROUP)", "workgroup_size(1, 1, 65)", "workgroup size [1, 1, 65]");
    let memory = "partial: array<u32, WORKGROUP * 65u>";
    rejects(&SCAN, "partial: array<u32, WORKGROUP>", memory, "16640 bytes of workgroup memory");
}

#[test]
fn overrides_that_are_missing_or_make_no_sense_are_rejected() {
    let source = TILE_RANGES.source();
    let error = |constants: &[(&str, f64)]| check(&TILE_RANGES, &source, constants).expect_err("rejected");
    assert!(error(&[]).contains("overrides"));
    assert!(error(&[("WORKGROUP", 256.0), ("ITEMS", 8.0)]).contains("overrides"));
    assert!(error(&[("WORKGROUP", 0.0)]).starts_with("tile_ranges: "));
    assert!(error(&[("WORKGROUP", -1.0)]).starts_with("tile_ranges: "));
}
