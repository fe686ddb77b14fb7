//! Point sets of the shapes that break neighbour searches, from one seed each.

/// SplitMix64, so that a set is the same on every machine.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In -1..1.
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    fn point(&mut self) -> [f32; 3] {
        [self.unit(), self.unit(), self.unit()]
    }

    /// On a rough wall, floor or sphere, as anchors from depth maps lie.
    fn on_a_surface(&mut self, i: usize) -> [f32; 3] {
        let (a, b, noise) = (self.unit(), self.unit(), 2e-3 * self.unit());
        match i % 4 {
            0 => [4.0 * a, 1.0 + noise, 4.0 * b],
            1 => [4.0 * a, b, 4.0 + noise],
            2 => [-4.0 + noise, a, 4.0 * b],
            _ => {
                let (s, c) = (std::f32::consts::PI * a).sin_cos();
                let (r, ring) = (0.5 + noise, (1.0 - b * b).sqrt());
                [r * ring * c, r * b, 2.0 + r * ring * s]
            }
        }
    }
}

pub(crate) const SHAPES: [&str; 13] = [
    "surfaces",
    "uniform",
    "clustered",
    "collinear",
    "coplanar",
    "lattice",
    "all-equal",
    "duplicates",
    "1e6-offset",
    "denormal",
    "mixed-scale",
    "overflow",
    "signed-zeros",
];

pub(crate) fn set(shape: &str, n: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = Random(seed);
    let r = &mut random;
    let line = [r.point(), r.point()];
    let centres: Vec<[f32; 3]> = (0..5).map(|_| r.point()).collect();
    (0..n)
        .map(|i| match shape {
            "surfaces" => r.on_a_surface(i),
            "uniform" => r.point(),
            "clustered" => {
                let (centre, p) = (centres[r.below(5) as usize], r.point());
                std::array::from_fn(|a| centre[a] + 1e-3 * p[a])
            }
            "collinear" => {
                let t = r.unit();
                std::array::from_fn(|a| line[0][a] + t * line[1][a])
            }
            "coplanar" => [r.unit(), 0.25, r.unit()],
            "lattice" => std::array::from_fn(|_| r.below(6) as f32),
            "all-equal" => [0.1, -0.2, 0.3],
            "duplicates" => centres[r.below(5) as usize],
            "1e6-offset" => r.point().map(|c| 1e6 + c),
            "denormal" => r.point().map(|c| c * 1e-22),
            "mixed-scale" => {
                let scale = 10f32.powi(r.below(30) as i32 - 20);
                r.point().map(|c| c * scale)
            }
            "overflow" => r.point().map(|c| c * f32::MAX),
            "signed-zeros" => std::array::from_fn(|a| if (i >> a) & 1 == 0 { 0.0 } else { -0.0 }),
            _ => unreachable!("no set {shape}"),
        })
        .collect()
}
