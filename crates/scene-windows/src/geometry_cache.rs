//! Cache on disk for depth and features of a frozen backbone: evaluation and training of the same views run it once.

use crate::hash::of_views;
use crate::{Error, Result};
use gs_scene::{DepthMap, FeatureMap, Gaussians, View};
use half::f16;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use sparsesplat::{Features, Geometry, Predictor, ViewGeometry, Wanted};
use std::path::{Path, PathBuf};
use tensor_files::{Kept, KeptFault, KeptTensor, singles, write_kept};

/// Changes when the layout of a file or what a backbone computes does.
const VERSION: u32 = 6;

/// What the files are.
const KIND: &str = "geometry";

/// A folder of files, each what one backbone with its settings says of the context views of one window.
///
/// Features, or the matching cost that they are computed with, are kept with 11 bits. A fresh result is rounded as its file is, so that
/// results do not depend on whether a file was there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct GeometryCache {
    /// The folder.
    pub folder: PathBuf,
}

/// What does not fit a tensor.
#[derive(Serialize, Deserialize)]
struct Header {
    depth_range: (f64, f64),
    /// Schema of the features; empty without.
    schema: String,
}

impl GeometryCache {
    /// As [`Predictor::geometry_with`], from the file of these views if there is one. `name` is what the file's name begins with.
    ///
    /// # Errors
    /// As [`Predictor::geometry_with`]; if a file cannot be read or written.
    pub fn geometry(
        &self,
        name: &str,
        views: &[View],
        predictor: &Predictor,
        wanted: Wanted,
    ) -> Result<Geometry> {
        let path = self.path(name, views, predictor, wanted);
        if !path.exists() {
            write(&path, &predictor.geometry_with(views, wanted)?)?;
        }
        read(&path, views)
    }

    /// The file of these views.
    #[must_use]
    pub fn path(&self, name: &str, views: &[View], predictor: &Predictor, wanted: Wanted) -> PathBuf {
        let (backbone, depth_range) = (predictor.backbone_identity(), predictor.config().depth_range);
        let key = of_views(&format!("{VERSION}\n{backbone}\n{depth_range:?}\n{wanted:?}"), views);
        let name = name.replace(['/', '\\'], "-");
        self.folder.join(format!("{name}-{}.geometry.safetensors", &key[..16]))
    }
}

fn write(path: &Path, geometry: &Geometry) -> Result<()> {
    let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut schema = String::new();
    let mut tensors: Vec<KeptTensor> = Vec::new();
    for (i, view) in geometry.views.iter().enumerate() {
        let shape = vec![view.depth.height(), view.depth.width()];
        tensors.push((format!("{i}.depth"), Dtype::F32, shape.clone(), bytes(view.depth.data())));
        tensors.push((format!("{i}.confidence"), Dtype::F32, shape.clone(), bytes(&view.confidence)));
        if let Some(features) = &view.features {
            features.schema().clone_into(&mut schema);
            let (name, shape, values) = match features {
                Features::Map(map) => {
                    (format!("{i}.features"), vec![map.channels(), map.height(), map.width()], map.data())
                }
                Features::Bank { cost, .. } => (format!("{i}.cost"), shape, &cost[..]),
            };
            let half = values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect();
            tensors.push((name, Dtype::F16, shape, half));
        }
        if let Some(set) = &view.gaussians {
            let (rows, degree) = (set.len(), set.sh_degree());
            let shape = vec![rows, Gaussians::GEOMETRY];
            tensors.push((format!("{i}.gaussians"), Dtype::F32, shape, bytes(set.geometry())));
            let shape = vec![rows, (degree + 1) * (degree + 1), 3];
            tensors.push((format!("{i}.sh"), Dtype::F32, shape, bytes(set.sh())));
        }
    }
    let header = Header { depth_range: geometry.depth_range, schema };
    write_kept(path, KIND, &header, &tensors)
        .map_err(|source| Error::CacheFile { path: path.to_path_buf(), source })
}

fn read(path: &Path, views: &[View]) -> Result<Geometry> {
    let read = || {
        let (header, kept): (Header, Kept) = Kept::read(path, KIND)?;
        let all = views.iter().enumerate().map(|(i, view)| view_of(&kept, &header, i, view));
        let views = all.collect::<std::result::Result<_, KeptFault>>()?;
        Ok(Geometry { views, depth_range: header.depth_range, shared_by: Vec::new() })
    };
    read().map_err(|source| Error::CacheFile { path: path.to_path_buf(), source })
}

/// What the file says of a view.
fn view_of(
    kept: &Kept,
    header: &Header,
    i: usize,
    view: &View,
) -> std::result::Result<ViewGeometry, KeptFault> {
    let (width, height) = (view.image().width(), view.image().height());
    let map = |name: String| Ok::<_, KeptFault>(singles(kept.expect(&name, Dtype::F32, &[height, width])?));
    let depth = DepthMap::new(width, height, map(format!("{i}.depth"))?).map_err(KeptFault::Scene)?;
    let confidence = map(format!("{i}.confidence"))?;
    let halves = |data: &[u8]| -> Vec<f32> {
        data.as_chunks::<2>().0.iter().map(|&v| f16::from_le_bytes(v).to_f32()).collect()
    };
    let schema = header.schema.clone();
    let cost = format!("{i}.cost");
    let features = match kept.tensor(&format!("{i}.features"), Dtype::F16, 3)? {
        Some((shape, data)) => {
            let map =
                FeatureMap::new(shape[0], shape[2], shape[1], halves(data)).map_err(KeptFault::Scene)?;
            Some(Features::Map(map.with_schema(schema)))
        }
        None if kept.tensor(&cost, Dtype::F16, 2)?.is_some() => {
            let cost = halves(kept.expect(&cost, Dtype::F16, &[height, width])?);
            Some(Features::Bank { schema, cost })
        }
        None => None,
    };
    let rows = kept.tensor(&format!("{i}.gaussians"), Dtype::F32, 2)?;
    let sh = kept.tensor(&format!("{i}.sh"), Dtype::F32, 3)?;
    let gaussians = match (rows, sh) {
        (Some((_, rows)), Some((shape, sh))) => {
            let degree =
                (0..=3).find(|d| (d + 1) * (d + 1) == shape[1]).ok_or_else(|| KeptFault::Tensor {
                    name: format!("{i}.sh"),
                    found: format!("{shape:?}"),
                    expected: "1, 4, 9 or 16 coefficients".to_owned(),
                })?;
            Some(Gaussians::new(degree, singles(rows), singles(sh)).map_err(KeptFault::Scene)?)
        }
        _ => None,
    };
    Ok(ViewGeometry { depth, confidence, features, gaussians })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimulatedScene, simulated_window};
    use scene_sim::Kind;
    use sparsesplat::Config;

    fn cache() -> (tempfile::TempDir, GeometryCache, Vec<View>) {
        let folder = tempfile::tempdir().unwrap();
        let cache = GeometryCache { folder: folder.path().to_path_buf() };
        let window = simulated_window(SimulatedScene::Generated(Kind::of_seed(3), 3), (48, 32)).unwrap();
        (folder, cache, window.context[..3].to_vec())
    }

    #[test]
    fn what_is_read_is_what_was_made_and_settings_have_files_of_their_own() {
        let (_folder, cache, views) = cache();
        let predictor = Predictor::new(Config::default()).unwrap();
        let cached = || cache.geometry("room/0", &views, &predictor, Wanted::DepthAndFeatures).unwrap();
        let (made, read) = (cached(), cached());
        let fresh = predictor.geometry_with(&views, Wanted::DepthAndFeatures).unwrap();
        assert_eq!(made.depth_range, read.depth_range);
        for ((made, read), fresh) in made.views.iter().zip(&read.views).zip(&fresh.views) {
            assert_eq!(made.depth.data(), read.depth.data());
            assert_eq!((made.depth.data(), &made.confidence), (fresh.depth.data(), &fresh.confidence));
            let view = &views[0];
            let [a, b, c] = [made, read, fresh].map(|g| g.feature_map(view).unwrap().unwrap());
            assert_eq!((a.data(), a.schema()), (b.data(), c.schema()));
            assert!(a.data().iter().zip(c.data()).all(|(a, c)| (a - c).abs() <= 5e-4 * c.abs().max(1e-4)));
        }
        let path =
            |predictor: &Predictor, views: &[View], wanted| cache.path("room/0", views, predictor, wanted);
        let first = path(&predictor, &views, Wanted::DepthAndFeatures);
        assert!(first.exists());
        let depth_range = sparsesplat::DepthRange::Known { near: 1.0, far: 9.0 };
        let near = predictor.with_config(Config { depth_range, ..Config::default() }).unwrap();
        for other in [
            path(&predictor, &views, Wanted::Depth),
            path(&near, &views, Wanted::DepthAndFeatures),
            path(&predictor, &views[..2], Wanted::DepthAndFeatures),
        ] {
            assert_ne!(first, other);
        }
        // What comes after the backbone has no file of its own.
        let more = predictor.with_config(Config { neighbours: 3, seed: 9, ..Config::default() }).unwrap();
        assert_eq!(path(&more, &views, Wanted::DepthAndFeatures), first);
    }

    #[test]
    fn a_broken_file_is_named() {
        let (_folder, cache, views) = cache();
        let predictor = Predictor::new(Config::default()).unwrap();
        let path = cache.path("room", &views, &predictor, Wanted::Depth);
        cache.geometry("room", &views, &predictor, Wanted::Depth).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let mut garbled = whole.clone();
        garbled[whole.len() - 5] ^= 1;
        for bytes in
            [&garbled, &whole[..whole.len() / 2], &whole[..4], b"", b"nonsense that is longer than a header"]
        {
            std::fs::write(&path, bytes).unwrap();
            let error = cache.geometry("room", &views, &predictor, Wanted::Depth).unwrap_err();
            assert!(matches!(&error, Error::CacheFile { path: named, .. } if *named == path), "{error}");
        }
    }
}
