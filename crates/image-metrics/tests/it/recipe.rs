//! Untrained weights of LPIPS by a rule, and files of picture pairs with what PyTorch makes of them; shared with examples.

use gs_scene::Image;
use image_metrics::{Lpips, LpipsNetwork};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize_to_file};
use std::path::{Path, PathBuf};

/// Largest relative deviation from PyTorch in f64: f32 takes some 1e-6, and sums of thousands of products more.
pub(crate) const TOLERANCE: f64 = 1e-5;
/// Of a gradient, relative root mean square. A rounding that changes which pixel of a pool is the largest, or on which
/// side of zero a ReLU stands, moves single elements.
pub(crate) const GRADIENT_TOLERANCE: f64 = 1e-3;

pub(crate) const NETWORKS: [LpipsNetwork; 3] =
    [LpipsNetwork::Vgg16, LpipsNetwork::AlexNet, LpipsNetwork::SqueezeNet];

/// Name in the published program's `state_dict`, and shape, of every tensor.
pub(crate) fn tensors(network: LpipsNetwork) -> Vec<(String, Vec<usize>)> {
    let mut all = Vec::new();
    let mut convolution = |name: String, inputs: usize, outputs: usize, side: usize| {
        all.push((format!("net.slice{name}.weight"), vec![outputs, inputs, side, side]));
        all.push((format!("net.slice{name}.bias"), vec![outputs]));
    };
    let taps: &[usize] = match network {
        LpipsNetwork::Vgg16 => {
            let of = [(1, 0, 3, 64), (1, 2, 64, 64), (2, 5, 64, 128), (2, 7, 128, 128), (3, 10, 128, 256)];
            let more = [(3, 12, 256, 256), (3, 14, 256, 256), (4, 17, 256, 512), (4, 19, 512, 512)];
            let last = [(4, 21, 512, 512), (5, 24, 512, 512), (5, 26, 512, 512), (5, 28, 512, 512)];
            for (slice, index, inputs, outputs) in of.into_iter().chain(more).chain(last) {
                convolution(format!("{slice}.{index}"), inputs, outputs, 3);
            }
            &[64, 128, 256, 512, 512]
        }
        LpipsNetwork::AlexNet => {
            for (slice, index, inputs, outputs, side) in [
                (1, 0, 3, 64, 11),
                (2, 3, 64, 192, 5),
                (3, 6, 192, 384, 3),
                (4, 8, 384, 256, 3),
                (5, 10, 256, 256, 3),
            ] {
                convolution(format!("{slice}.{index}"), inputs, outputs, side);
            }
            &[64, 192, 384, 256, 256]
        }
        _ => {
            convolution("1.0".into(), 3, 64, 3);
            for (slice, index, inputs, squeezed, expanded) in [
                (2, 3, 64, 16, 64),
                (2, 4, 128, 16, 64),
                (3, 6, 128, 32, 128),
                (3, 7, 256, 32, 128),
                (4, 9, 256, 48, 192),
                (5, 10, 384, 48, 192),
                (6, 11, 384, 64, 256),
                (7, 12, 512, 64, 256),
            ] {
                convolution(format!("{slice}.{index}.squeeze"), inputs, squeezed, 1);
                convolution(format!("{slice}.{index}.expand1x1"), squeezed, expanded, 1);
                convolution(format!("{slice}.{index}.expand3x3"), squeezed, expanded, 3);
            }
            &[64, 128, 256, 384, 384, 512, 512]
        }
    };
    all.extend(taps.iter().enumerate().map(|(i, &n)| (format!("lin{i}.model.1.weight"), vec![1, n, 1, 1])));
    all
}

/// Values of a tensor: splitmix64 of FNV-1a of its name and the place, as `fixtures/image-metrics/make_lpips.py` has it.
pub(crate) fn values(name: &str, shape: &[usize]) -> Vec<f32> {
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let fan_in = shape[1..].iter().product::<usize>() as f64;
    let value = |i: usize| {
        let mut z = hash.wrapping_add(i as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let uniform = ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1 << 23) - 1.0;
        let value = match (name.starts_with("lin"), name.ends_with("bias")) {
            (true, _) => uniform.abs(),
            (_, true) => 0.1 * uniform,
            _ => (3.0 / fan_in).sqrt() * uniform,
        };
        value as f32
    };
    (0..shape.iter().product()).map(value).collect()
}

/// Writes tensors as safetensors.
pub(crate) fn write(path: &Path, tensors: &[(String, Vec<usize>, Vec<f32>)]) {
    let bytes: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(_, _, values)| values.iter().flat_map(|value| value.to_le_bytes()).collect())
        .collect();
    let views = tensors.iter().zip(&bytes).map(|((name, shape, _), bytes)| {
        (
            name.clone(),
            TensorView::new(Dtype::F32, shape.clone(), bytes).expect("as many bytes as the shape says"),
        )
    });
    serialize_to_file(views, None, path).expect("the file can be written");
}

/// LPIPS with weights by the rule.
pub(crate) fn lpips(network: LpipsNetwork) -> Lpips {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("weights.safetensors");
    let tensors = tensors(network).into_iter().map(|(name, shape)| {
        let values = values(&name, &shape);
        (name, shape, values)
    });
    write(&path, &tensors.collect::<Vec<_>>());
    Lpips::read(&[path]).expect("weights")
}

/// What a file expects of a network: total, parts and gradient of each pair, or of pictures whose -1..1 is 0..1.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) found: Vec<f64>,
    pub(crate) expected: Vec<f64>,
    pub(crate) is_gradient: bool,
}

impl Case {
    /// Relative deviation: the largest, or of gradients the root mean square.
    pub(crate) fn deviation(&self) -> f64 {
        assert_eq!(self.found.len(), self.expected.len(), "{}", self.name);
        let pairs = || self.found.iter().zip(&self.expected);
        if self.is_gradient {
            let square = |sum: f64| sum.sqrt();
            return square(pairs().map(|(a, b)| (a - b).powi(2)).sum())
                / square(pairs().map(|(_, b)| b * b).sum());
        }
        // Equal pictures are at distance 0 here; PyTorch in f32 finds some 1e-11.
        pairs().map(|(a, b)| (a - b).abs() / b.abs().max(1e-6)).fold(0.0, f64::max)
    }

    pub(crate) fn holds(&self) -> bool {
        // A NaN does not.
        self.deviation() <= if self.is_gradient { GRADIENT_TOLERANCE } else { TOLERANCE }
    }
}

/// Measures all pairs of a file with a network.
pub(crate) fn cases(path: &Path, lpips: &Lpips) -> Vec<Case> {
    let bytes = std::fs::read(path).expect("the file can be read");
    let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let net = lpips.network();
    let Ok(total) = numbers(&file, &format!("{net}/total")) else { return Vec::new() };
    let (a, b) = (pictures(&file, "a"), pictures(&file, "b"));
    let parts = numbers(&file, &format!("{net}/per_layer")).expect("parts beside the total");
    let layers = parts.len() / total.len();
    let mut cases = Vec::new();
    let mut push = |name: &str, i: usize, found: Vec<f64>, expected: &[f64]| {
        let is_gradient = name == "gradient";
        cases.push(Case {
            name: format!("{net} {name} {i}"),
            found,
            expected: expected.to_vec(),
            is_gradient,
        });
    };
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        let target = lpips.target(b).expect("a target");
        push("total", i, vec![target.distance(a.data()).expect("a distance")], &total[i..=i]);
        push("layers", i, target.distances(a.data()).expect("distances"), &parts[i * layers..][..layers]);
        push("swapped", i, vec![lpips.distance(b, a).expect("a distance")], &total[i..=i]);
        if let Ok(unscaled) = numbers(&file, &format!("{net}/total_normalize_false")) {
            let half = |image: &Image| {
                let data = image.data().iter().map(|value| (value + 1.0) / 2.0).collect();
                Image::new(image.width(), image.height(), data).expect("a picture")
            };
            push(
                "from -1",
                i,
                vec![lpips.distance(&half(a), &half(b)).expect("a distance")],
                &unscaled[i..=i],
            );
        }
        if let Ok(gradient) = numbers(&file, &format!("{net}/gradient")) {
            let (distance, found) = target.distance_and_gradient(a.data()).expect("a gradient");
            push("with gradient", i, vec![distance], &total[i..=i]);
            let size = found.len();
            // [3, height, width] there.
            let expected = &gradient[i * size..][..size];
            let expected: Vec<f64> = (0..size).map(|k| expected[k % 3 * (size / 3) + k / 3]).collect();
            push("gradient", i, found.into_iter().map(f64::from).collect(), &expected);
        }
    }
    cases
}

/// Tensors [count, 3, height, width] as interleaved pictures.
fn pictures(file: &SafeTensors, name: &str) -> Vec<Image> {
    let shape = file.tensor(name).expect("pictures").shape().to_vec();
    let &[_, 3, height, width] = shape.as_slice() else { panic!("{name} is not [count, 3, height, width]") };
    let (values, pixels) = (numbers(file, name).expect("pictures"), height * width);
    let picture = |planes: &[f64]| {
        let data = (0..pixels * 3).map(|i| planes[i % 3 * pixels + i / 3] as f32).collect();
        Image::new(width, height, data).expect("a picture")
    };
    values.chunks_exact(3 * pixels).map(picture).collect()
}

fn numbers(file: &SafeTensors, name: &str) -> Result<Vec<f64>, safetensors::SafeTensorError> {
    let tensor = file.tensor(name)?;
    Ok(match tensor.dtype() {
        Dtype::F32 => tensor.data().as_chunks().0.iter().map(|&b| f64::from(f32::from_le_bytes(b))).collect(),
        Dtype::F64 => tensor.data().as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
        other => panic!("{name} is {other:?}, expected F32 or F64"),
    })
}

/// The fixture of this crate.
pub(crate) fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/image-metrics/lpips.safetensors")
}
