//! Windows with what the frozen backbone says of them, kept on disk: ray tracing and stereo take seconds, a step of
//! training less.

use crate::{Error, Result};
use evaluate::{Plan, Window};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, DepthMap, FeatureMap, Image, Intrinsics, View, write_atomically};
use half::f16;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sparsesplat::{ViewGeometry, Wanted};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Changes when the layout of a file or the code before the head does.
const VERSION: u32 = 1;

/// A window, ready to be trained on.
#[derive(Debug, Clone)]
pub struct Case {
    /// `scene/window`.
    pub name: String,
    /// Context views.
    pub context: Vec<View>,
    /// Held-out views.
    pub targets: Vec<View>,
    /// What the backbone says of the context views, with features.
    pub geometry: Vec<ViewGeometry>,
    /// Depth range, scene units.
    pub depth_range: (f64, f64),
}

/// Windows to train on, each in a file of the cache.
#[derive(Debug, Clone)]
pub struct Cases {
    files: Vec<PathBuf>,
    hash: String,
}

/// What does not fit a tensor.
#[derive(Serialize, Deserialize)]
struct Header {
    name: String,
    context: Vec<Posed>,
    targets: Vec<Posed>,
    depth_range: (f64, f64),
    schema: String,
}

#[derive(Serialize, Deserialize)]
struct Posed {
    name: String,
    lens: Intrinsics,
    rotation: DMat3,
    translation: DVec3,
}

impl Cases {
    /// The cases of `plans`; those that are not in the folder `cache` yet are made. `on_case` is told of each when it is
    /// there, with how many there are to be.
    ///
    /// # Errors
    /// If a window cannot be loaded, has no held-out views, the backbone fails, or a file cannot be written.
    pub fn open(
        plans: &[Plan],
        predict: &sparsesplat::Config,
        cache: &Path,
        on_case: &mut dyn FnMut(usize, usize),
    ) -> Result<Self> {
        if plans.is_empty() {
            return Err(Error::NoWindows);
        }
        let mut files = Vec::with_capacity(plans.len());
        let mut all = Sha256::new();
        for (i, plan) in plans.iter().enumerate() {
            let settings =
                sparsesplat::Config { depth_range: plan.depth_range(predict.depth_range), ..predict.clone() };
            let (described, loaded) = match plan.description() {
                Some(description) => (description, None),
                None => {
                    let window = plan.load(true)?;
                    (window.sha256(), Some(window))
                }
            };
            let key = format!("{VERSION}\n{:?} {:?}\n{described}", settings.backbone, settings.depth_range);
            let key = hexadecimal(Sha256::digest(key.as_bytes()).as_slice());
            all.update(key.as_bytes());
            let file = cache.join(format!("{}-{}.safetensors", plan.name().replace('/', "-"), &key[..16]));
            if !file.exists() {
                let window = match loaded {
                    Some(window) => window,
                    None => plan.load(true)?,
                };
                let case = Case::of_window(window, &settings)?;
                case.write(&file)?;
            }
            files.push(file);
            on_case(i + 1, plans.len());
        }
        Ok(Self { files, hash: hexadecimal(all.finalize().as_slice()) })
    }

    /// Number of cases.
    #[must_use]
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there are none; never.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// SHA-256 of what decides the content of all of them.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.hash
    }

    /// Reads a case.
    ///
    /// # Errors
    /// If its file is gone or broken.
    pub fn read(&self, index: usize) -> Result<Case> {
        Case::read(&self.files[index])
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Case {
    /// Runs the backbone on a window.
    ///
    /// # Errors
    /// If the window has no held-out views, or the backbone fails.
    pub fn of_window(window: Window, predict: &sparsesplat::Config) -> Result<Self> {
        if window.targets.is_empty() {
            return Err(Error::NoTargets { window: window.name });
        }
        let (geometry, depth_range) =
            sparsesplat::geometry(&window.context, predict, Wanted::DepthAndFeatures)?;
        // Features are kept with 11 bits: to train on what was read is to train on what was written.
        Ok(Self {
            name: window.name,
            context: window.context,
            targets: window.targets,
            geometry,
            depth_range,
        })
    }

    fn write(&self, path: &Path) -> Result<()> {
        let posed = |view: &View| Posed {
            name: view.name().to_owned(),
            lens: *view.camera().intrinsics(),
            rotation: view.camera().rotation(),
            translation: view.camera().translation(),
        };
        let features =
            |geometry: &ViewGeometry| geometry.features.as_ref().map(FeatureMap::schema).map(str::to_owned);
        let header = Header {
            name: self.name.clone(),
            context: self.context.iter().map(posed).collect(),
            targets: self.targets.iter().map(posed).collect(),
            depth_range: self.depth_range,
            schema: self.geometry.first().and_then(features).unwrap_or_default(),
        };
        let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
        let mut pictures = |kind: &str, views: &[View]| {
            for (i, view) in views.iter().enumerate() {
                let (width, height) = (view.image().width(), view.image().height());
                tensors.push((
                    format!("{kind}.{i}.image"),
                    Dtype::U8,
                    vec![height, width, 3],
                    view.image().to_rgb8(),
                ));
            }
        };
        pictures("context", &self.context);
        pictures("targets", &self.targets);
        for (i, geometry) in self.geometry.iter().enumerate() {
            let (width, height) = (geometry.depth.width(), geometry.depth.height());
            let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
            let shape = vec![height, width];
            tensors.push((
                format!("context.{i}.depth"),
                Dtype::F32,
                shape.clone(),
                bytes(geometry.depth.data()),
            ));
            tensors.push((format!("context.{i}.confidence"), Dtype::F32, shape, bytes(&geometry.confidence)));
            if let Some(map) = &geometry.features {
                let half = map.data().iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect();
                let shape = vec![map.channels(), map.height(), map.width()];
                tensors.push((format!("context.{i}.features"), Dtype::F16, shape, half));
            }
        }
        let broken = |problem: String| Error::Broken { path: path.to_path_buf(), problem };
        let views = tensors
            .iter()
            .map(|(name, dtype, shape, data)| {
                Ok((
                    name.as_str(),
                    TensorView::new(*dtype, shape.clone(), data).map_err(|e| broken(e.to_string()))?,
                ))
            })
            .collect::<Result<Vec<_>>>()?;
        let header = serde_json::to_string(&header).map_err(|e| broken(e.to_string()))?;
        let bytes = serialize(views, Some(HashMap::from([("case".to_owned(), header)])))
            .map_err(|e| broken(e.to_string()))?;
        Ok(write_atomically(path, |out| out.write_all(&bytes))?)
    }

    fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        Self::from_bytes(&bytes).map_err(|problem| Error::Broken { path: path.to_path_buf(), problem })
    }

    fn from_bytes(bytes: &[u8]) -> std::result::Result<Self, String> {
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| e.to_string())?;
        let header = metadata.metadata().as_ref().and_then(|m| m.get("case")).ok_or("no header")?;
        let header: Header = serde_json::from_str(header).map_err(|e| e.to_string())?;
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
        let tensor = |name: String, dtype: Dtype| -> std::result::Result<&[u8], String> {
            let found = tensors.tensor(&name).map_err(|e| format!("{name}: {e}"))?;
            if found.dtype() == dtype {
                Ok(found.data())
            } else {
                Err(format!("{name}: {:?}", found.dtype()))
            }
        };
        let floats = |name: String| -> std::result::Result<Vec<f32>, String> {
            let (values, _) = tensor(name, Dtype::F32)?.as_chunks::<4>();
            Ok(values.iter().map(|&v| f32::from_le_bytes(v)).collect())
        };
        let views = |kind: &str, posed: &[Posed]| -> std::result::Result<Vec<View>, String> {
            let view = |(i, posed): (usize, &Posed)| {
                let bytes = tensor(format!("{kind}.{i}.image"), Dtype::U8)?;
                let image = Image::from_rgb8(posed.lens.width, posed.lens.height, bytes)
                    .map_err(|e| e.to_string())?;
                let camera =
                    Camera::new(posed.lens, posed.rotation, posed.translation).map_err(|e| e.to_string())?;
                View::new(posed.name.clone(), image, camera, None).map_err(|e| e.to_string())
            };
            posed.iter().enumerate().map(view).collect()
        };
        let context = views("context", &header.context)?;
        let geometry = |(i, view): (usize, &View)| {
            let (width, height) = (view.image().width(), view.image().height());
            let depth = DepthMap::new(width, height, floats(format!("context.{i}.depth"))?)
                .map_err(|e| e.to_string())?;
            let confidence = floats(format!("context.{i}.confidence"))?;
            if confidence.len() != width * height {
                return Err(format!("context.{i}.confidence: {} numbers", confidence.len()));
            }
            let (halves, _) = tensor(format!("context.{i}.features"), Dtype::F16)?.as_chunks::<2>();
            let features: Vec<f32> = halves.iter().map(|&v| f16::from_le_bytes(v).to_f32()).collect();
            let map = FeatureMap::new(features.len() / (width * height), width, height, features)
                .map_err(|e| e.to_string())?
                .with_schema(header.schema.clone());
            Ok(ViewGeometry { depth, confidence, features: Some(map) })
        };
        let geometry =
            context.iter().enumerate().map(geometry).collect::<std::result::Result<_, String>>()?;
        Ok(Self {
            name: header.name,
            targets: views("targets", &header.targets)?,
            context,
            geometry,
            depth_range: header.depth_range,
        })
    }
}
