//! Writes `src/blue_noise.bin`: ranks of a 64×64 square by the void-and-cluster method (Ulichney 1993), half a second.
//! `cargo run --release -p entropy-sampler --example make_blue_noise -- crates/entropy-sampler/src/blue_noise.bin`

const SIDE: usize = 64;
const PIXELS: usize = SIDE * SIDE;
/// Of the Gaussian that says how crowded a place is, pixels.
const SIGMA: f64 = 1.5;
/// Points of the first pattern.
const FIRST: usize = PIXELS / 10;

/// A pattern of points on the square, whose opposite edges meet.
#[derive(Clone)]
struct Pattern {
    /// How crowded it is at an offset from a point, by its index.
    kernel: Vec<f64>,
    points: Vec<bool>,
    crowd: Vec<f64>,
}

impl Pattern {
    fn flip(&mut self, pixel: usize) {
        let sign = if self.points[pixel] { -1.0 } else { 1.0 };
        self.points[pixel] = !self.points[pixel];
        for (other, crowd) in self.crowd.iter_mut().enumerate() {
            let x = (other % SIDE + SIDE - pixel % SIDE) % SIDE;
            let y = (other / SIDE + SIDE - pixel / SIDE) % SIDE;
            *crowd += sign * self.kernel[y * SIDE + x];
        }
    }

    /// Takes the point away that is crowded most.
    fn take_from_cluster(&mut self) -> usize {
        let points = (0..PIXELS).filter(|&i| self.points[i]);
        let pixel =
            points.max_by(|&a, &b| self.crowd[a].total_cmp(&self.crowd[b])).expect("there are points");
        self.flip(pixel);
        pixel
    }

    /// Puts a point where it is crowded least.
    fn fill_void(&mut self) -> usize {
        let free = (0..PIXELS).filter(|&i| !self.points[i]);
        let pixel = free.min_by(|&a, &b| self.crowd[a].total_cmp(&self.crowd[b])).expect("there is room");
        self.flip(pixel);
        pixel
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: make_blue_noise FILE")?;
    let gauss = |i: usize| (-(i.min(SIDE - i).pow(2) as f64) / (2.0 * SIGMA * SIGMA)).exp();
    let kernel = (0..PIXELS).map(|i| gauss(i % SIDE) * gauss(i / SIDE)).collect();
    let mut pattern = Pattern { kernel, points: vec![false; PIXELS], crowd: vec![0.0; PIXELS] };
    let mut random = 5u64;
    let mut placed = 0;
    while placed < FIRST {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let pixel = (random >> 33) as usize % PIXELS;
        if !pattern.points[pixel] {
            pattern.flip(pixel);
            placed += 1;
        }
    }
    while pattern.take_from_cluster() != pattern.fill_void() {}
    let mut ranks = vec![0u16; PIXELS];
    let mut fewer = pattern.clone();
    for rank in (0..FIRST).rev() {
        ranks[fewer.take_from_cluster()] = rank as u16;
    }
    for rank in FIRST..PIXELS {
        ranks[pattern.fill_void()] = rank as u16;
    }
    let bytes: Vec<u8> = ranks.into_iter().flat_map(u16::to_le_bytes).collect();
    std::fs::write(file, bytes)?;
    Ok(())
}
