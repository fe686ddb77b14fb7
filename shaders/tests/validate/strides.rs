//! Flat buffers have as many numbers per row on both sides.

use crate::gate::parse;
use gs_shaders::{
    GEOMETRY, PAIR_GRADS, PIXEL_GRADS, POSE_SUMS, PROJECT, PROJECT_BACKWARD, Pass, RASTERIZE_BACKWARD,
};
use naga::{Arena, BinaryOperator, Expression, Function, Handle, Literal, Module};
use std::collections::BTreeSet;

/// The whole numbers that an index is multiplied by where a pass accesses the buffer `name`.
fn strides(module: &Module, name: &str) -> BTreeSet<u32> {
    let functions = module.functions.iter().map(|(_, function)| function);
    let entry_points = module.entry_points.iter().map(|entry_point| &entry_point.function);
    let mut found = BTreeSet::new();
    for Function { expressions, .. } in functions.chain(entry_points) {
        for (_, expression) in expressions.iter() {
            let Expression::Access { base, index } = *expression else { continue };
            let Expression::GlobalVariable(variable) = expressions[base] else { continue };
            if module.global_variables[variable].name.as_deref() == Some(name) {
                factors(module, expressions, index, &mut found);
            }
        }
    }
    found
}

fn factors(
    module: &Module,
    expressions: &Arena<Expression>,
    handle: Handle<Expression>,
    found: &mut BTreeSet<u32>,
) {
    let Expression::Binary { op, left, right } = expressions[handle] else { return };
    for side in [left, right] {
        factors(module, expressions, side, found);
        let literal = match expressions[side] {
            Expression::Literal(literal) => Some(literal),
            Expression::Constant(constant) => {
                match module.global_expressions[module.constants[constant].init] {
                    Expression::Literal(literal) => Some(literal),
                    _ => None,
                }
            }
            _ => None,
        };
        if let (BinaryOperator::Multiply, Some(Literal::U32(factor))) = (op, literal) {
            found.insert(factor);
        }
    }
}

#[test]
fn rows_have_as_many_numbers() {
    let buffers: [(&Pass, &str, usize); 10] = [
        (&PROJECT, "geometry", GEOMETRY),
        (&PROJECT, "sh", 3),
        (&RASTERIZE_BACKWARD, "pixel_grads", PIXEL_GRADS),
        (&RASTERIZE_BACKWARD, "pair_grads", PAIR_GRADS),
        (&PROJECT_BACKWARD, "geometry", GEOMETRY),
        (&PROJECT_BACKWARD, "sh", 3),
        (&PROJECT_BACKWARD, "pair_grads", PAIR_GRADS),
        (&PROJECT_BACKWARD, "grad_geometry", GEOMETRY),
        (&PROJECT_BACKWARD, "grad_sh", 3),
        (&PROJECT_BACKWARD, "pose_sums", POSE_SUMS),
    ];
    for (pass, name, expected) in buffers {
        let module = parse(&pass.source()).expect("a valid pass");
        let found = strides(&module, name);
        assert_eq!(found, BTreeSet::from([expected as u32]), "strides of {name} in {}", pass.name);
    }
    assert_eq!(GEOMETRY, gs_scene::Gaussians::GEOMETRY);
}

#[test]
fn another_stride_is_noticed() {
    let source = PROJECT.source().replace("index * 11u + column", "index * 12u + column");
    assert_ne!(source, PROJECT.source());
    assert_eq!(strides(&parse(&source).expect("a valid shader"), "geometry"), BTreeSet::from([11, 12]));
}
