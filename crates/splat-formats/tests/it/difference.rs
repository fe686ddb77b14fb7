//! Drawn scenes, how far two scenes are apart, and how far a format may move them. Shared by the tests and the example `interchange`.

use gs_scene::{Gaussians, SH_C0, sh_coefficients, sigmoid};

/// Largest differences of two scenes of the same order.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct Difference {
    pub(crate) position: f64,
    pub(crate) log_scale: f64,
    /// Angle of the turn that brings one ellipsoid's axes to the other's, radians.
    pub(crate) angle: f64,
    pub(crate) opacity: f64,
    /// As brightness from 0 to 1.
    pub(crate) colour: f64,
    pub(crate) sh: f64,
}

/// What rounding of f32 adds, for numbers of these magnitudes.
const FLOAT: f64 = 4e-6;

impl Difference {
    /// Whether nothing is above a bound; else what is.
    pub(crate) fn within(&self, bound: &Self) -> Result<(), String> {
        for (what, found, bound) in [
            ("position", self.position, bound.position),
            ("log-scale", self.log_scale, bound.log_scale),
            ("angle", self.angle, bound.angle),
            ("opacity", self.opacity, bound.opacity),
            ("colour", self.colour, bound.colour),
            ("spherical harmonics", self.sh, bound.sh),
        ] {
            if found > bound + FLOAT {
                return Err(format!("{what} differs by {found}, expected at most {bound}"));
            }
        }
        Ok(())
    }
}

/// The largest differences; the SH coefficients that both have are compared.
pub(crate) fn difference(a: &Gaussians, b: &Gaussians) -> Difference {
    assert_eq!(a.len(), b.len());
    let mut worst = Difference::default();
    let add =
        |worst: &mut f64, value: f64| *worst = worst.max(if value.is_nan() { f64::INFINITY } else { value });
    for (a, b) in a.geometry().chunks_exact(11).zip(b.geometry().chunks_exact(11)) {
        let apart = |i: usize| f64::from(a[i]) - f64::from(b[i]);
        (0..3).for_each(|i| add(&mut worst.position, apart(i).abs()));
        (7..10).for_each(|i| add(&mut worst.log_scale, apart(i).abs()));
        let norm = |q: &[f32]| q[3..7].iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let (na, nb) = (norm(a), norm(b));
        // A half turn about an axis of the ellipsoid changes nothing; which of the four rotations a file has depends on how its
        // axes were converted. The chord between unit quaternions keeps its digits for small angles, unlike the arc cosine.
        let [w, x, y, z] = [3, 4, 5, 6].map(|i| f64::from(b[i]) / nb);
        let same = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
        let chord = |q: [f64; 4], sign: f64| {
            (0..4).map(|i| (f64::from(a[3 + i]) / na - sign * q[i]).powi(2)).sum::<f64>().sqrt()
        };
        let chords = same.into_iter().flat_map(|q| [chord(q, 1.0), chord(q, -1.0)]);
        let least =
            chords.fold(2.0, |least: f64, chord| if chord.is_nan() { chord } else { least.min(chord) });
        add(&mut worst.angle, 4.0 * (0.5 * least).min(1.0).asin());
        add(&mut worst.opacity, f64::from((sigmoid(a[10]) - sigmoid(b[10])).abs()));
    }
    let (width, other) = (a.sh().len() / a.len(), b.sh().len() / b.len());
    for (a, b) in a.sh().chunks_exact(width).zip(b.sh().chunks_exact(other)) {
        for (i, (a, b)) in a.iter().zip(b).enumerate() {
            let apart = (f64::from(*a) - f64::from(*b)).abs();
            if i < 3 {
                add(&mut worst.colour, apart * f64::from(SH_C0));
            } else {
                add(&mut worst.sh, apart);
            }
        }
    }
    worst
}

/// The turn by which a rotation can be off if each of three components of its quaternion is off by `step`. The fourth, the
/// largest, is at least 1/2, so it is off by at most √3 times the length of the error of the others.
pub(crate) fn turn(step: f64) -> f64 {
    let others = 3.0_f64.sqrt() * step;
    4.0 * (0.5 * (others * others + 3.0 * others * others).sqrt()).asin()
}

/// Gaussians in the order in which another scene has them: each of `other` is matched to the nearest mean.
pub(crate) fn ordered_as(scene: &Gaussians, other: &Gaussians) -> Gaussians {
    let width = scene.sh().len() / scene.len();
    let (mut geometry, mut sh) = (Vec::new(), Vec::new());
    for row in other.geometry().chunks_exact(11) {
        let distance = |i: usize| {
            let mean = &scene.geometry()[11 * i..][..3];
            mean.iter().zip(row).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
        };
        let nearest = (0..scene.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap();
        geometry.extend_from_slice(&scene.geometry()[11 * nearest..][..11]);
        sh.extend_from_slice(&scene.sh()[width * nearest..][..width]);
    }
    Gaussians::new(scene.sh_degree(), geometry, sh).unwrap()
}

/// `n` Gaussians within the ranges of all formats, drawn from a seed.
pub(crate) fn scene(degree: usize, n: usize, seed: u64) -> Gaussians {
    let mut state = seed;
    // SplitMix64, from -1 to 1.
    let mut draw = move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    let mut scene = Gaussians::empty(degree).unwrap();
    for _ in 0..n {
        let mean = [0; 3].map(|_| 30.0 * draw());
        let quaternion = loop {
            let q = [0; 4].map(|_| draw());
            if q.iter().map(|v| v * v).sum::<f32>() > 1e-4 {
                break q;
            }
        };
        let log_scale = [0; 3].map(|_| 6.0 * draw() - 2.0);
        let opacity = 8.0 * draw();
        let mut sh: Vec<f32> = (0..sh_coefficients(degree) * 3).map(|_| 0.95 * draw()).collect();
        // Colours from 0 to 1.
        sh[..3].iter_mut().for_each(|value| *value *= 0.5 / gs_scene::SH_C0);
        scene.push(mean, quaternion, log_scale, opacity, &sh);
    }
    scene
}
