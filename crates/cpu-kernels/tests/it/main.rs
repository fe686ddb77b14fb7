//! Every kernel on every instruction set of the machine, against f64.

mod activations;
mod norms;
mod products;
mod rows;

use cpu_kernels::Isa;

/// Numbers in -1..1 that depend on seed and place alone.
fn numbers(count: usize, seed: u32) -> Vec<f32> {
    let number = |i: usize| {
        let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
        ((mixed ^ (mixed >> 15)) >> 8) as f32 / 8_388_608.0 - 1.0
    };
    (0..count).map(number).collect()
}

/// The sets that this machine can be held to.
fn sets() -> Vec<Isa> {
    Isa::available()
}
