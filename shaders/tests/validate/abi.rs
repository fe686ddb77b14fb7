//! What Rust and WGSL share is the same on both sides: structs, and constants.

use crate::gate::parse;
use gs_shaders::{
    AMBIENT, BIN, CULLED, Frame, ITEMS, LEVEL_SLACK, N_COUNTERS, N_PAIRS, NOWHERE, PASSES, POSE_SUMS,
    PROJECT, PROJECT_BACKWARD, Pass, RASTERIZE_ELLIPSOIDS, REACH_SLACK, REJECTED, SCAN, SIGMA_MAX, SORT,
    SORT_DIGIT_BITS, Scan, Sort, Splat, Surface, VISIBLE, WORKGROUP,
};
use naga::{Expression, Literal, TypeInner};
use std::f64::consts::{LN_2, LOG2_E, PI};
use std::mem::offset_of;

/// Size and members (with their offsets) of a struct of a pass, bytes.
fn layout(pass: &Pass, name: &str) -> (usize, Vec<(String, usize)>) {
    let module = parse(&pass.source()).expect("a valid pass");
    let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name));
    let (_, ty) = found.unwrap_or_else(|| panic!("{} has a struct {name}", pass.name));
    let TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is a struct") };
    let members =
        members.iter().map(|m| (m.name.clone().expect("members have names"), m.offset as usize)).collect();
    (*span as usize, members)
}

/// Checks size and offsets of a struct whose members have the same names on both sides.
macro_rules! assert_layout {
    ($passes:expr, $name:ident, [$($field:ident),* $(,)?] $(, $more:expr)?) => {
        let mut expected = vec![$((stringify!($field).to_owned(), offset_of!($name, $field))),*];
        $(expected.extend($more.map(|(field, offset): (&str, usize)| (field.to_owned(), offset)));)?
        expected.sort_by_key(|&(_, offset)| offset);
        for pass in $passes {
            let (size, members) = layout(pass, stringify!($name));
            assert_eq!(size, size_of::<$name>(), "size of {} in {}", stringify!($name), pass.name);
            assert_eq!(members, expected, "members of {} in {}", stringify!($name), pass.name);
        }
    };
}

#[test]
fn structs_have_the_same_layout() {
    let of_views: Vec<&Pass> = PASSES.into_iter().filter(|pass| pass.bindings[0].name == "frame").collect();
    assert_eq!(of_views.len(), 7, "passes that bind a frame");
    assert_layout!(
        of_views,
        Frame,
        [
            pose,
            pose_low,
            position,
            n_gaussians,
            position_low,
            near,
            focal,
            focal_low,
            centre,
            centre_low,
            slope_min,
            slope_max,
            size,
            tiles,
            background,
            far,
            eps2d,
            alpha_max,
            alpha_min,
            transmittance_min,
            compensation_min,
            pair_capacity,
            zero,
            ellipsoid_sigma,
        ]
    );
    let rgb = offset_of!(Splat, rgb);
    assert_layout!(
        [&PROJECT, &BIN],
        Splat,
        [mean, mean_low, falloff, shear, shear_low, log2_opacity, depth, padding],
        [("red", rgb), ("green", rgb + 4), ("blue", rgb + 8)]
    );
    assert_layout!([&PROJECT, &RASTERIZE_ELLIPSOIDS], Surface, [slope_e, slope_y, sigma_z, padding]);
    assert_layout!([&SCAN], Scan, [n, n_blocks, total, padding]);
    assert_layout!([&SORT], Sort, [n, n_blocks, count, shift]);
}

/// A constant of a pass.
fn constant(pass: &Pass, name: &str) -> Literal {
    let module = parse(&pass.source()).expect("a valid pass");
    let found = module.constants.iter().find(|(_, constant)| constant.name.as_deref() == Some(name));
    let (_, constant) = found.unwrap_or_else(|| panic!("{} has a constant {name}", pass.name));
    match module.global_expressions[constant.init] {
        Expression::Literal(literal) => literal,
        ref other => panic!("{name} is {other:?}"),
    }
}

#[test]
fn whole_numbers_are_the_same() {
    let numbers = [
        (&PROJECT, "VISIBLE", VISIBLE),
        (&PROJECT, "REJECTED", REJECTED),
        (&PROJECT, "CULLED", CULLED),
        (&SCAN, "N_PAIRS", N_PAIRS),
        (&SCAN, "NOWHERE", NOWHERE),
        (&SORT, "NOWHERE", NOWHERE),
        (&SORT, "DIGITS", 1 << SORT_DIGIT_BITS),
        (&PROJECT_BACKWARD, "POSE_SUMS", POSE_SUMS as u32),
    ];
    for (pass, name, expected) in numbers {
        assert_eq!(constant(pass, name), Literal::U32(expected), "{name} of {}", pass.name);
    }
    // `sort` counts the keys of an invocation in 4 bits, and those of as many invocations as there are digits in 8.
    const {
        assert!(
            ITEMS < 1 << 4
                && ITEMS << SORT_DIGIT_BITS < 1 << 8
                && WORKGROUP.is_multiple_of(1 << SORT_DIGIT_BITS)
        );
    };
    assert!([VISIBLE, REJECTED, N_PAIRS].iter().all(|&slot| (slot as usize) < N_COUNTERS));
}

#[test]
fn real_numbers_are_the_same() {
    let root = |numerator: f64, denominator: f64| (numerator / (denominator * PI)).sqrt();
    let numbers = [
        ("SIGMA_MAX", f64::from(SIGMA_MAX)),
        ("LEVEL_SLACK", f64::from(LEVEL_SLACK)),
        ("REACH_SLACK", f64::from(REACH_SLACK)),
        ("LOG2_E", LOG2_E),
        // The real spherical harmonics by their normalisation.
        ("SH_C0", root(1.0, 4.0)),
        ("SH_C1", root(3.0, 4.0)),
        ("SH_C2_XY", root(15.0, 4.0)),
        ("SH_C2_ZZ", root(5.0, 16.0)),
        ("SH_C2_XX", root(15.0, 16.0)),
        ("SH_C3_Y3", -root(35.0, 32.0)),
        ("SH_C3_XYZ", root(105.0, 4.0)),
        ("SH_C3_YZZ", -root(21.0, 32.0)),
        ("SH_C3_ZZZ", root(7.0, 16.0)),
        ("SH_C3_ZXX", root(105.0, 16.0)),
    ];
    for (name, expected) in numbers {
        assert_eq!(constant(&PROJECT, name), Literal::F32(expected as f32), "{name}");
    }
    assert_eq!(constant(&PROJECT_BACKWARD, "LN_2"), Literal::F32(LN_2 as f32));
    assert_eq!(constant(&RASTERIZE_ELLIPSOIDS, "LN_2"), Literal::F32(LN_2 as f32));
    assert_eq!(constant(&RASTERIZE_ELLIPSOIDS, "AMBIENT"), Literal::F32(AMBIENT));
    assert_eq!(constant(&PROJECT, "SH_C0"), Literal::F32(gs_scene::SH_C0));
}
