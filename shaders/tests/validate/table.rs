//! Views name what the passes have, and their table says what the shaders say.

use crate::gate::parse;
use gs_shaders::{
    Access, Action, Argument, Counts, Drawing, Features, Frame, Groups, ITEMS, PASSES, Source, Table, View,
    WORKGROUP, Word,
};

const DRAWINGS: [Drawing; 3] = [Drawing::Blended, Drawing::Recorded, Drawing::Ellipsoids];

fn views() -> impl Iterator<Item = View> {
    Features::all().flat_map(|features| DRAWINGS.map(|drawing| View::new(features, drawing)))
}

#[test]
fn commands_bind_buffers_of_the_view_as_the_entry_points_use_them() {
    for view in views() {
        let known = |name: &str| view.buffers.iter().find(|buffer| buffer.name == name);
        let mut names: Vec<&str> = view.buffers.iter().map(|buffer| buffer.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), view.buffers.len(), "names are unique");
        for command in &view.commands {
            match &command.action {
                Action::Clear(name) => assert!(known(name).is_some(), "{name}"),
                Action::Swap(a, b) => {
                    let (a, b) = (known(a).expect("listed"), known(b).expect("listed"));
                    assert_eq!((&a.rows, a.row), (&b.rows, b.row), "{} and {}", a.name, b.name);
                }
                Action::Dispatch { pass, entry_point, arguments, .. } => {
                    let used = pass.entry_point(entry_point).expect("it exists").bindings;
                    assert_eq!(arguments.len(), pass.bindings.len(), "{entry_point}");
                    for (number, binding) in pass.bindings.iter().enumerate() {
                        let argument = &arguments[number];
                        assert_eq!(
                            argument.is_some(),
                            used.contains(&(number as u32)),
                            "{entry_point} {number}"
                        );
                        match argument {
                            None => {}
                            Some(Argument::Words(_)) => assert_eq!(binding.access, Access::Uniform),
                            Some(Argument::Buffer(name)) => {
                                let buffer = known(name).unwrap_or_else(|| panic!("{entry_point}: {name}"));
                                let uniform = binding.access == Access::Uniform;
                                assert_eq!(uniform, buffer.source == Source::Frame, "{entry_point}: {name}");
                                let written = binding.access == Access::ReadWrite;
                                assert!(!written || buffer.source == Source::Passes, "{entry_point}: {name}");
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Every digit of a key is sorted by once, and never more digits than keys have.
#[test]
fn sorts_stop_after_the_last_digit_of_a_tile() {
    let view = View::new(Features { sh_degree: 1, antialias: false, depth: true }, Drawing::Blended);
    for tiles in [1u32, 15, 16, 17, 255, 256, 4096, 1 << 27] {
        let counts = Counts { gaussians: 5000, pairs: 70_000, pixels: 256 * tiles.min(9), tiles };
        let shifts: Vec<u32> = view
            .commands
            .iter()
            .filter(|command| command.applies(tiles))
            .filter_map(|command| match &command.action {
                Action::Dispatch { entry_point: "sort_scatter", arguments, groups, .. } => {
                    let Some(Argument::Words([n, blocks, _, Word::Is(shift)])) = &arguments[0] else {
                        panic!("a sort has a uniform")
                    };
                    let value = |word: &Word| match word {
                        Word::Is(value) => u64::from(*value),
                        Word::Amount(amount) => amount.value(&counts),
                    };
                    let Groups::Folded(groups) = groups else { panic!("a sort goes over blocks") };
                    assert_eq!(value(blocks), value(n).div_ceil(u64::from(WORKGROUP * ITEMS)));
                    assert_eq!(groups.value(&counts), value(blocks));
                    Some(*shift)
                }
                _ => None,
            })
            .collect();
        let bits = 32 - tiles.leading_zeros();
        let expected: Vec<u32> = (0..32).step_by(4).chain((0..bits).step_by(4)).collect();
        assert_eq!(shifts, expected, "{tiles} tiles");
    }
}

#[test]
fn the_table_says_what_the_shaders_say() {
    let features = Features { sh_degree: 2, antialias: true, depth: true };
    let views = DRAWINGS.map(|drawing| (format!("{drawing:?}"), View::new(features, drawing)));
    let table = Table::new(views.into());
    let table = serde_json::to_value(table).expect("plain data");
    // The frame: as naga lays it out.
    let project = PASSES.into_iter().find(|pass| pass.name == "project").expect("it exists");
    let module = parse(&project.source()).expect("valid");
    let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some("Frame"));
    let naga::TypeInner::Struct { members, span } = &found.expect("a struct").1.inner else {
        panic!("a struct")
    };
    assert_eq!(table["frame"]["bytes"], *span);
    assert_eq!(table["frame"]["bytes"], size_of::<Frame>());
    let fields = table["frame"]["fields"].as_object().expect("an object");
    assert_eq!(fields.len(), members.len());
    for member in members {
        let field = &fields[member.name.as_deref().expect("named")];
        assert_eq!(field["offset"], member.offset);
        let mut inner = &module.types[member.ty].inner;
        if let naga::TypeInner::Array { base, .. } = inner {
            inner = &module.types[*base].inner;
        }
        let (naga::TypeInner::Scalar(scalar) | naga::TypeInner::Vector { scalar, .. }) = inner else {
            panic!("numbers")
        };
        let kind = if scalar.kind == naga::ScalarKind::Float { "f32" } else { "u32" };
        assert_eq!(field["type"], kind, "{:?}", member.name);
    }
    // Pipelines: every override and every binding of the entry point.
    for pipeline in table["pipelines"].as_array().expect("a list") {
        let source = table["modules"][pipeline["module"].as_str().expect("a name")].as_str().expect("a text");
        assert!(source.contains(&format!("fn {}(", pipeline["entry_point"].as_str().expect("a name"))));
        let overrides = source.lines().filter(|line| line.starts_with("override ")).count();
        assert_eq!(pipeline["constants"].as_object().map(serde_json::Map::len), Some(overrides));
        for number in pipeline["bindings"].as_object().expect("an object").keys() {
            assert!(source.contains(&format!("@binding({number})")));
        }
    }
    let commands = table["views"]["Ellipsoids"]["commands"].as_array().expect("a list");
    let dispatched = |name: &str| {
        commands.iter().filter_map(|command| command.get("dispatch")).any(|dispatch| {
            let place = dispatch["pipeline"].as_u64().expect("a place") as usize;
            table["pipelines"][place]["entry_point"] == name
        })
    };
    assert!(dispatched("project_ellipsoids") && dispatched("rasterize_ellipsoids") && !dispatched("project"));
}
