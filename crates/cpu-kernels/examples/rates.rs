//! GFLOP/s of the products, one thread, best of five, per instruction set, beside the `gemm` crate's.
#![allow(unsafe_code)]

use cpu_kernels::{Isa, Packed, Rows, multiply, multiply_transposed};
use std::time::Instant;

fn best(work: &mut dyn FnMut()) -> f64 {
    let mut once = || {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    once();
    (0..5).map(|_| (0..20).map(|_| once()).sum::<f64>() / 20.0).fold(f64::INFINITY, f64::min)
}

fn main() {
    let value = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 8) as f32 / 8_388_608.0 - 1.0;
    for [rows, depth, columns] in [
        [48, 128, 128],
        [48, 128, 512],
        [48, 512, 128],
        [48, 32, 128],
        [96, 384, 384],
        [96, 384, 1152],
        [1024, 1024, 1024],
    ] {
        let a: Vec<f32> = (0..rows * depth).map(value).collect();
        let b: Vec<f32> = (0..depth * columns).map(value).collect();
        let mut c = vec![0.0; rows * columns];
        let flops = 2.0 * (rows * depth * columns) as f64;
        let a_rows = Rows::new(&a, rows, depth);
        let b_rows = Rows::new(&b, depth, columns);
        print!("{rows} {depth} {columns}:");
        let seconds = best(&mut || unsafe {
            gemm::gemm(
                rows,
                columns,
                depth,
                c.as_mut_ptr(),
                1,
                columns as isize,
                true,
                a.as_ptr(),
                1,
                depth as isize,
                b.as_ptr(),
                1,
                columns as isize,
                1.0,
                1.0,
                false,
                false,
                false,
                gemm::Parallelism::None,
            );
        });
        print!(" gemm {:.1}", flops / seconds / 1e9);
        for isa in Isa::available() {
            let packed = Packed::rows(isa, b_rows);
            let seconds = best(&mut || multiply(a_rows, &packed, &mut c, columns, true));
            print!(" {isa} {:.1}", flops / seconds / 1e9);
            // [rows, depth]ᵀ [rows, columns].
            let b: Vec<f32> = (0..rows * columns).map(value).collect();
            let mut c = vec![0.0; depth * columns];
            let seconds =
                best(&mut || multiply_transposed(isa, a_rows, Rows::new(&b, rows, columns), &mut c));
            print!(" transposed {:.1}", flops / seconds / 1e9);
        }
        println!();
    }
}
