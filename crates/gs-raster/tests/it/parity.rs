//! Every pass by itself: fed with what the twins of the passes before it wrote, and compared with its own twin on every buffer
//! that it writes, so that an early flip cannot cascade. One module per pass, named as the pass. A module offers `rows`, which
//! runs the pass on one chain of buffers and compares it with another, and `perturb`, which makes one input wrong: the
//! comparison must notice that.

mod bin;
mod project;
mod project_backward;
mod rasterize_backward;
mod rasterize_ellipsoids;
mod rasterize_forward;
mod scan;
mod sort;
mod tile_ranges;

use crate::check::Row;
use crate::fixtures::cases;
use crate::gpu::OPTIONS;
use crate::losses::noise;
use glam::{DMat3, DVec3};
use gs_raster::gpu::{Gpu, PassBuffer};
use gs_reference::chain::{Backward, Ellipsoids, Lists, View, backward, ellipsoids, forward};
use gs_reference::rasterize_ellipsoids::rasterize_ellipsoids;
use gs_reference::rasterize_forward::Pixels;
use gs_reference::tolerance::AMBIGUOUS;
use gs_reference::{Deviation, PixelGradients, Profile, compare, compare_exactly};
use gs_scene::{Camera, Gaussians, Intrinsics};
use gs_shaders::{Frame, PASSES, WORKGROUP};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

/// What a pass does not write keeps these bits, which are a NaN.
const UNTOUCHED: u32 = 0x7fc0_1234;

/// A view with every buffer of it, as the twins make them.
#[derive(Clone)]
struct Chain {
    name: String,
    view: View,
    lists: Lists,
    pixels: Pixels,
    backward: Backward,
    ellipsoids: Ellipsoids,
    /// Pixels in which f32 may take another decision than f64.
    masked: Vec<bool>,
    /// The same of the view of ellipsoids.
    ellipsoids_masked: Vec<bool>,
}

impl Chain {
    fn new(name: String, scene: &Gaussians, camera: &Camera, profile: &Profile, depth: bool) -> Self {
        let background = [0.2, 0.5, 0.9];
        let view = View::new(scene, camera, background, profile, depth);
        let truth = gs_reference::render(scene, camera, background.map(f64::from), profile);
        let masked: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        let plane = |seed: u64, channels: usize| -> Vec<f64> {
            let values = 0..masked.len() * channels;
            values.map(|i| if masked[i / channels] { 0.0 } else { noise(seed, i).into() }).collect()
        };
        let pixels = PixelGradients { image: plane(1, 3), alpha: plane(2, 1), depth_sum: plane(3, 1) };
        let forward = forward(&view);
        let backward = backward(&view, &forward, &pixels);
        let ellipsoids = ellipsoids(&view);
        let ellipsoids_masked = uncertain_rims(&view, &ellipsoids);
        let (lists, pixels) = (forward.lists, forward.pixels);
        Self { name, view, lists, pixels, backward, ellipsoids, masked, ellipsoids_masked }
    }

    fn n_gaussians(&self) -> u32 {
        self.view.frame.n_gaussians
    }
}

/// Pixels in which another ellipsoid would be seen if all were a little larger or smaller.
fn uncertain_rims(view: &View, drawn: &Ellipsoids) -> Vec<bool> {
    let Lists { footprints, pairs, pair_index, ranges, .. } = &drawn.lists;
    let depths = |factor: f64| {
        let frame = Frame { alpha_min: (f64::from(view.frame.alpha_min) * factor) as f32, ..view.frame };
        let splats = (&footprints.splats, &pairs.splats);
        let pixels = rasterize_ellipsoids(&frame, splats.0, splats.1, pair_index, ranges, &drawn.surfaces);
        pixels[5 * pixels.len() / 6..].to_vec()
    };
    let (smaller, larger) = (depths(1.0 + AMBIGUOUS), depths(1.0 - AMBIGUOUS));
    smaller.iter().zip(&larger).map(|(a, b)| a != b).collect()
}

/// The golden cases, each with and without compensation and depth, and a scene of several workgroups and many tiles.
static CHAINS: LazyLock<Vec<Chain>> = LazyLock::new(|| {
    let mut chains = Vec::new();
    for (name, case) in cases() {
        for (antialias, depth) in [(false, false), (false, true), (true, false), (true, true)] {
            let profile = Profile { antialias, ..case.profile };
            let name = format!("{name}, antialias {antialias}, depth {depth}");
            chains.push(Chain::new(name, &case.gaussians, &case.camera, &profile, depth));
        }
    }
    let (scene, camera) = crowd();
    chains.push(Chain::new("crowd".to_owned(), &scene, &camera, &Profile::default(), true));
    chains
});

/// Gaussians of all sizes before a picture whose sides are not multiples of a tile.
pub(crate) fn crowd() -> (Gaussians, Camera) {
    let n = 21 * WORKGROUP as usize + 13;
    let mut scene = Gaussians::empty(1).expect("degree 1 exists");
    for i in 0..n {
        let value = |k: usize| noise(7, i * 32 + k);
        // Far apart in depth, in scrambled order; some behind the camera, some beside the picture.
        let z = -0.3 + 6.0 * ((i * 769) % n) as f32 / n as f32;
        let mean = [1.2 * z * value(0), 1.2 * z * value(1), z];
        let quaternion = [value(2), value(3), value(4), value(5)];
        let log_scale = [6, 7, 8].map(|k| -4.0 + 2.0 * value(k));
        let sh: Vec<f32> = (9..21).map(|k| 0.8 * value(k)).collect();
        scene.push(mean, quaternion, log_scale, -1.0 + 4.0 * value(21), &sh);
    }
    let lens = Intrinsics { fx: 110.0, fy: 104.0, cx: 60.5, cy: 51.0, width: 125, height: 93 };
    (scene, Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid"))
}

/// The GPU of these tests, whose buffers are filled with NaN before use. Without an adapter they fail.
fn gpu() -> MutexGuard<'static, Gpu> {
    static GPU: LazyLock<Mutex<Gpu>> = LazyLock::new(|| Mutex::new(Gpu::new(&OPTIONS).expect("an adapter")));
    GPU.lock().unwrap_or_else(PoisonError::into_inner)
}

type Rows = fn(&mut Gpu, &Chain, &Chain) -> Vec<Row>;

fn equals(rows: Rows) {
    for chain in CHAINS.iter() {
        for row in rows(&mut gpu(), chain, chain) {
            let (name, Row { output, deviation, bound }) = (&chain.name, &row);
            assert!(row.holds(), "{name}, {output}: {deviation:?}, bound {bound:.1e}");
        }
    }
}

fn rejects(rows: Rows, perturb: fn(&mut Chain)) {
    let found = CHAINS.iter().find(|chain| chain.name == "c_rand200_sh1, antialias true, depth true");
    let truth = found.expect("a golden case");
    let mut wrong = truth.clone();
    perturb(&mut wrong);
    assert!(rows(&mut gpu(), &wrong, truth).iter().any(|row| !row.holds()));
}

macro_rules! parity {
    ($($pass:ident),*) => {
        mod equals_its_twin {
            $(#[test]
            #[ignore = "gpu"]
            fn $pass() {
                super::equals(super::$pass::rows);
            })*
        }

        mod notices_a_wrong_input {
            $(#[test]
            #[ignore = "gpu"]
            fn $pass() {
                super::rejects(super::$pass::rows, super::$pass::perturb);
            })*
        }

        #[test]
        fn every_pass_is_compared() {
            let compared = [$(stringify!($pass)),*];
            assert!(PASSES.iter().all(|pass| compared.contains(&pass.name)));
            assert_eq!(PASSES.len(), compared.len());
        }
    };
}

parity!(
    project,
    sort,
    scan,
    bin,
    tile_ranges,
    rasterize_forward,
    rasterize_ellipsoids,
    rasterize_backward,
    project_backward
);

/// A buffer with this in it.
fn of<T: bytemuck::Pod>(data: &[T]) -> PassBuffer<'_> {
    PassBuffer::Bytes(bytemuck::cast_slice(data))
}

/// A uniform buffer with this in it.
fn one<T: bytemuck::Pod>(data: &T) -> PassBuffer<'_> {
    PassBuffer::Bytes(bytemuck::bytes_of(data))
}

/// What is in a buffer.
fn words<T: bytemuck::Pod>(bytes: &[u8]) -> Vec<T> {
    bytemuck::pod_collect_to_vec(bytes)
}

/// Workgroups for `n` invocations, in a grid as narrow as a folded one never is: passes must not care.
fn groups(n: usize) -> [u32; 2] {
    let groups = (n as u32).div_ceil(WORKGROUP);
    [groups.min(3), groups.div_ceil(3)]
}

/// Whole numbers beside those expected; nothing if there are none.
fn exact(output: &str, expected: &[u32], found: &[u32]) -> Option<Row> {
    let signed = |numbers: &[u32]| -> Vec<i32> { numbers.iter().map(|&number| number as i32).collect() };
    if expected.is_empty() && found.is_empty() {
        return None;
    }
    let equal = Deviation { max_abs: 0.0, worst: 0, largest: 0.0, relative_l2: 0.0, cosine: 1.0 };
    let deviation = compare_exactly(&signed(expected), &signed(found)).map(|()| equal);
    Some(Row { output: output.to_owned(), deviation, bound: 0.0 })
}

/// Numbers beside those expected, outside what is masked; nothing if there are none.
fn close(
    output: &str,
    expected: &[impl Copy + Into<f64>],
    found: &[impl Copy + Into<f64>],
    masked: &[bool],
    bound: impl Fn(&Deviation) -> f64,
) -> Option<Row> {
    if expected.is_empty() && found.is_empty() || !masked.is_empty() && !masked.contains(&false) {
        return None;
    }
    let deviation = compare(expected.iter().copied(), found.iter().copied(), masked);
    let bound = deviation.as_ref().map_or(0.0, bound);
    Some(Row { output: output.to_owned(), deviation, bound })
}
