//! From a picture to pixels: importance, a weight per pixel, an exact count, and a beginning that serves as a preview.
//! `cargo run --release -p entropy-sampler --example sample_view`

use entropy_sampler::{Budget, EntropyWindow, ImportanceMap, Result, Sampler, sample};

const WIDTH: usize = 96;
const HEIGHT: usize = 32;
const COUNT: usize = 400;

fn main() -> Result<()> {
    let map = ImportanceMap::entropy(&picture(), WIDTH, HEIGHT, EntropyWindow::default())?;
    // Depth is missing at the right edge, say: no pixel may come from there.
    let weights = (0..WIDTH * HEIGHT).map(|i| f32::from(u8::from(i % WIDTH < 88))).collect();
    let samples = sample(&[map.with_weights(weights)?], Budget::Count(COUNT), Sampler::Fixed, 0)?;
    println!("{} pixels, tau {:.3}; o: the first {}", samples.count(), samples.probability.tau, COUNT / 4);

    let mut drawing = vec![b' '; WIDTH * HEIGHT];
    for (i, (_, pixel)) in samples.progressive().into_iter().enumerate() {
        drawing[pixel as usize] = if i < COUNT / 4 { b'o' } else { b'.' };
    }
    for row in drawing.chunks_exact(WIDTH) {
        println!("|{}|", String::from_utf8_lossy(row));
    }
    Ok(())
}

/// A smooth sky, and a ground of a texture that grows coarser to the right.
fn picture() -> Vec<u8> {
    let pixel = |i: usize| {
        let (x, y) = (i % WIDTH, i / WIDTH);
        if y < HEIGHT / 3 {
            return 200 + (y / 4) as u8;
        }
        let cell = 1 + x / 24;
        ((x / cell * 37 + y / cell * 101) % 97) as u8
    };
    (0..WIDTH * HEIGHT).map(pixel).collect()
}
