//! Cases for the fused form, from hashes of a seed.

use crate::oracle::Case;
use attn_head::{Config, Inputs, Kind, Layout};

/// The numbers of a case in f32, which inputs borrow from.
#[derive(Debug)]
pub(crate) struct Single {
    pub(crate) config: Config,
    n: usize,
    k: usize,
    pub(crate) weights: Vec<f32>,
    geometry: Vec<f32>,
    image: Vec<f32>,
    neighbours: Vec<u32>,
    relative: Vec<[f32; 3]>,
    cells: Vec<[u32; 2]>,
}

impl Single {
    pub(crate) fn new(case: &Case) -> Self {
        let narrow = |values: &[f64]| values.iter().map(|&v| v as f32).collect();
        Self {
            config: case.config,
            n: case.n,
            k: case.k,
            weights: narrow(&case.weights),
            geometry: narrow(&case.geometry),
            image: narrow(&case.image),
            neighbours: case.neighbours.clone(),
            relative: case.relative.iter().map(|r| r.map(|v| v as f32)).collect(),
            cells: case.cells.clone(),
        }
    }

    pub(crate) fn inputs(&self) -> Inputs<'_> {
        let inputs = Inputs {
            n: self.n,
            k: self.k,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &self.relative,
            cells: &self.cells,
        };
        inputs.check(&self.config).expect("a valid case");
        inputs
    }
}

/// Uniform numbers in [-1, 1), each exact in f32.
pub(crate) fn uniform(seed: u64, stream: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03);
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f64 / 8_388_608.0 - 1.0
    }
}

/// Weights, features and neighbours at random. Weights have the usual size, 1 / sqrt(inputs).
pub(crate) fn random(kind: Kind, n: usize, k: usize, image: usize, seed: u64) -> Case {
    let config = Config { kind, geometry: 9, image, neighbours: k };
    let single = |v: f64| f64::from(v as f32);
    let mut weights = Vec::new();
    for (i, p) in Layout::new(&config).parameters.iter().enumerate() {
        let mut u = uniform(seed, 100 + i as u64);
        let norm = p.name.contains("norm") && p.name.ends_with("weight");
        let size = if p.shape.len() == 2 { (3.0 / p.shape[1] as f64).sqrt() } else { 0.1 };
        weights.extend((0..p.len()).map(|_| single(if norm { 1.0 } else { 0.0 } + size * u())));
    }
    let (mut g, mut v, mut r, mut j) =
        (uniform(seed, 1), uniform(seed, 2), uniform(seed, 3), uniform(seed, 4));
    // A quarter as many fine cells as anchors, and three coarse ones at most.
    let mut c = uniform(seed, 5);
    let mut cell = |among: usize| ((c() + 1.0) / 2.0 * among.clamp(1, n.max(1)) as f64) as u32;
    Case {
        config,
        n,
        k,
        weights,
        geometry: (0..n * config.geometry).map(|_| 2.0 * g()).collect(),
        image: (0..n * image).map(|_| 2.0 * v()).collect(),
        neighbours: (0..n * k).map(|_| ((j() + 1.0) / 2.0 * n as f64) as u32).collect(),
        relative: (0..n * k).map(|_| [r(), r(), r()]).collect(),
        cells: (0..n).map(|_| [cell(n / 4), cell(3)]).collect(),
    }
}

/// With neighbours that are given several times, and with the anchor itself among them; for k = 6.
pub(crate) fn repeated(mut case: Case) -> Case {
    let most = case.n as u32 - 1;
    for (i, list) in case.neighbours.chunks_exact_mut(6).enumerate() {
        let (first, own) = (list[0], i as u32);
        list.copy_from_slice(&[first, first, own, own, first, most - own]);
    }
    case
}

/// With neighbours that are all the same at the same place: every maximum is shared by them.
pub(crate) fn alike(mut case: Case) -> Case {
    case.relative.fill([0.0; 3]);
    case.neighbours.fill(case.n as u32 / 4);
    case
}
