//! Golden files of the network: inputs, maps between its stages, depth, computed by another implementation. The layout
//! is described in fixtures/depth-backbone/README.md.

use depth_backbone::{DepthSplat, NamedTensor, Scales, Variant, Vit};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Image, Intrinsics, View};
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use std::collections::HashMap;

/// What can be wrong with a file.
pub(crate) type Failure = Box<dyn std::error::Error>;

/// A map as the file holds it.
#[derive(Debug)]
struct Tap {
    name: String,
    shape: Vec<usize>,
    /// Every which value is stored.
    stride: usize,
    values: Vec<f32>,
    /// Mean and root mean square per channel of the whole map, `[2, channels]`.
    channels: Option<Vec<f32>>,
}

/// A case: a network, what it sees, what it should find.
#[derive(Debug)]
pub(crate) struct Golden {
    pub(crate) variant: Variant,
    pub(crate) salt: String,
    pub(crate) views: Vec<View>,
    /// Near and far plane per view.
    pub(crate) ranges: Vec<(f64, f64)>,
    taps: Vec<Tap>,
}

/// How a computed map differs from the file's.
#[derive(Debug)]
#[allow(dead_code, reason = "shared with an example, which names and judges more")]
pub(crate) struct Deviation {
    pub(crate) name: String,
    /// Root mean square of the difference over that of the map.
    pub(crate) rms: f64,
    /// Largest difference over the root mean square of the map.
    pub(crate) largest: f64,
    /// Largest difference of a channel's mean or root mean square, over that of all channels.
    pub(crate) channels: f64,
    /// Largest difference relative to the value itself.
    pub(crate) relative: f64,
}

fn floats(file: &SafeTensors<'_>, name: &str) -> Result<(Vec<usize>, Vec<f32>), Failure> {
    let tensor = file.tensor(name).map_err(|e| format!("{name}: {e}"))?;
    let values = match tensor.dtype() {
        Dtype::F32 => tensor.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::U8 => tensor.data().iter().map(|&b| f32::from(b) / 255.0).collect(),
        other => return Err(format!("{name} holds {other:?}, expected F32 or U8").into()),
    };
    Ok((tensor.shape().to_vec(), values))
}

/// `shape=2,3;stride=7`.
fn stored_as(text: &str) -> Option<(Vec<usize>, usize)> {
    let (shape, stride) = text.strip_prefix("shape=")?.split_once(";stride=")?;
    let shape = shape.split(',').map(|n| n.parse().ok()).collect::<Option<_>>()?;
    Some((shape, stride.parse().ok()?))
}

impl Golden {
    /// Reads a file.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, Failure> {
        let file = SafeTensors::deserialize(bytes)?;
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let metadata: HashMap<String, String> = metadata.metadata().clone().unwrap_or_default();
        let config: Value =
            serde_json::from_str(metadata.get("config").ok_or("no `config` in the metadata")?)?;
        let text = |key: &str| config[key].as_str().ok_or(format!("no text `{key}` in the configuration"));
        let scales = Scales::ALL.into_iter().find(|s| text("variant") == Ok(s.name()));
        let vit = Vit::ALL.into_iter().find(|v| text("vit") == Ok(v.name()));
        let (Some(scales), Some(vit)) = (scales, vit) else {
            return Err(format!("unknown network {:?} {:?}", config["variant"], config["vit"]).into());
        };
        let mut taps = Vec::new();
        for name in file.names() {
            if name.starts_with("in.") || name.ends_with("#chan") {
                continue;
            }
            let (shape, values) = floats(&file, name)?;
            let stored = metadata.get(name).ok_or(format!("no metadata of {name}"))?;
            let (full, stride) = stored_as(stored).ok_or(format!("metadata of {name}: {stored}"))?;
            if full.iter().product::<usize>().div_ceil(stride) != shape.iter().product::<usize>() {
                return Err(format!("{name} has shape {shape:?}, stored as {stored}").into());
            }
            let channels = floats(&file, &format!("{name}#chan")).ok().map(|(_, values)| values);
            taps.push(Tap { name: name.to_owned(), shape: full, stride, values, channels });
        }
        taps.sort_by(|a, b| a.name.cmp(&b.name));
        let (views, ranges) = inputs(&file)?;
        let variant = Variant { scales, vit };
        Ok(Self { variant, salt: text("salt")?.to_owned(), views, ranges, taps })
    }

    /// Runs the network and compares each map of the file; those that were not computed have no deviation.
    pub(crate) fn compare(&self, network: &DepthSplat) -> Result<Vec<(String, Option<Deviation>)>, Failure> {
        let (geometry, trace) = network.trace(&self.views, &self.ranges, true)?;
        let mut maps: HashMap<String, NamedTensor> =
            trace.maps.into_iter().map(|map| (map.name.clone(), map)).collect();
        let (width, height) = (geometry[0].depth.width(), geometry[0].depth.height());
        let join = |of: &dyn Fn(usize) -> Vec<f32>| (0..geometry.len()).flat_map(of).collect::<Vec<f32>>();
        let mut add = |name: &str, shape: Vec<usize>, values| {
            maps.insert(name.to_owned(), NamedTensor { name: name.to_owned(), shape, values });
        };
        let depth = join(&|i| geometry[i].depth.data().to_vec());
        add("depth.final", vec![1, geometry.len(), height, width], depth);
        if let Some(features) = &geometry[0].features {
            let shape = vec![geometry.len(), features.channels(), height, width];
            let values = join(&|i| match geometry[i].feature_map(&self.views[i]) {
                Ok(Some(map)) => map.data().to_vec(),
                _ => vec![],
            });
            add("head.features", shape, values);
        }
        self.taps
            .iter()
            .map(|tap| {
                let deviation = maps.get(&tap.name).map(|map| tap.deviation(map)).transpose()?;
                Ok((tap.name.clone(), deviation))
            })
            .collect()
    }
}

type Inputs = (Vec<View>, Vec<(f64, f64)>);

fn inputs(file: &SafeTensors<'_>) -> Result<Inputs, Failure> {
    let (shape, images) = floats(file, "in.images").or_else(|_| floats(file, "in.images_u8"))?;
    let [1, count, 3, height, width] = shape[..] else {
        return Err(format!("in.images has shape {shape:?}, expected [1, views, 3, h, w]").into());
    };
    let per_view = |name: &str, size: usize| -> Result<Vec<f64>, Failure> {
        let (shape, values) = floats(file, name)?;
        if values.len() != count * size {
            return Err(format!("{name} has shape {shape:?}, expected {size} numbers per view").into());
        }
        Ok(values.into_iter().map(f64::from).collect())
    };
    let (lenses, poses) = (per_view("in.intrinsics", 9)?, per_view("in.extrinsics", 16)?);
    let (near, far) = (per_view("in.near", 1)?, per_view("in.far", 1)?);
    let mut views = Vec::new();
    for i in 0..count {
        let k = &lenses[i * 9..][..9];
        if k[1] != 0.0 || k[3..4] != [0.0] || k[6..] != [0.0, 0.0, 1.0] {
            return Err(format!(
                "intrinsics of view {i} are {k:?}: neither skew nor perspective is expected"
            )
            .into());
        }
        let (w, h) = (width as f64, height as f64);
        let lens = Intrinsics { fx: k[0] * w, fy: k[4] * h, cx: k[2] * w, cy: k[5] * h, width, height };
        let e = &poses[i * 16..][..16];
        let axes = DMat3::from_cols_array(&[e[0], e[4], e[8], e[1], e[5], e[9], e[2], e[6], e[10]]);
        let camera = Camera::from_camera_to_world(lens, axes, DVec3::new(e[3], e[7], e[11]))?;
        let planes = &images[i * 3 * height * width..][..3 * height * width];
        let pixels = (0..height * width).flat_map(|p| [0, 1, 2].map(|c| planes[c * height * width + p]));
        let image = Image::new(width, height, pixels.collect())?;
        views.push(View::new(i.to_string(), image, camera, None)?);
    }
    Ok((views, near.into_iter().zip(far).collect()))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), v| (sum + v * v, count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

impl Tap {
    fn deviation(&self, map: &NamedTensor) -> Result<Deviation, Failure> {
        let computed: usize = map.shape.iter().product();
        if computed != self.shape.iter().product::<usize>() || map.values.len() != computed {
            return Err(
                format!("{} has shape {:?}, the file's {:?}", self.name, map.shape, self.shape).into()
            );
        }
        let found = map.values.iter().step_by(self.stride);
        let pairs: Vec<(f64, f64)> =
            found.zip(&self.values).map(|(&a, &b)| (f64::from(a), f64::from(b))).collect();
        let size = rms(pairs.iter().map(|(_, b)| *b));
        // `max` would drop a NaN.
        let largest = |f: &dyn Fn(&(f64, f64)) -> f64| {
            pairs.iter().map(f).fold(0.0, |m: f64, v| if v.is_nan() || v > m { v } else { m })
        };
        Ok(Deviation {
            name: self.name.clone(),
            rms: rms(pairs.iter().map(|(a, b)| a - b)) / size,
            largest: largest(&|(a, b)| (a - b).abs()) / size,
            channels: self.channels.as_ref().map_or(0.0, |expected| channel_deviation(map, expected)),
            relative: largest(&|(a, b)| if a == b { 0.0 } else { ((a - b) / b).abs() }),
        })
    }
}

/// Of maps `[n, channels, h, w]`.
fn channel_deviation(map: &NamedTensor, expected: &[f32]) -> f64 {
    let (channels, pixels) = (map.shape[1], map.shape[2] * map.shape[3]);
    let scale = rms(expected[channels..].iter().map(|&v| f64::from(v)));
    let of = |c: usize| {
        let values = || {
            let planes = map.values.chunks_exact(pixels).skip(c).step_by(channels);
            planes.flatten().map(|&v| f64::from(v))
        };
        let mean = values().sum::<f64>() / (map.values.len() / channels) as f64;
        let (expected_mean, size) = (f64::from(expected[c]), f64::from(expected[channels + c]));
        let worst = (mean - expected_mean).abs().max((rms(values()) - size).abs());
        if worst == 0.0 { 0.0 } else { worst / scale }
    };
    (0..channels).map(of).fold(0.0, |m: f64, v| if v.is_nan() || v > m { v } else { m })
}
